"""Camera models: classes, and the registry of them by name. ``base.py`` has the recipe for a new one."""

from omniscv.cameras.base import Camera, CentralCamera, Parameter, Rays, Viewpoints
from omniscv.cameras.registry import create, from_dict, model, names, register

# isort: off
# Modules register their models: the order of the documentation.
from omniscv.cameras.panoramas import Cylindrical, Equirectangular
from omniscv.cameras.panoramas import CubeMap, EquiangularCube, Octahedral
from omniscv.cameras.fisheyes import (
    FisheyeEquidistant,
    FisheyeEquisolid,
    FisheyeOrthographic,
    FisheyeStereographic,
)
from omniscv.cameras.central_mirrors import CatadioptricHyperbolic, CatadioptricParabolic, CatadioptricPlanar
from omniscv.cameras.polynomials import Fisheye624, FTheta, KannalaBrandt, Scaramuzza
from omniscv.cameras.spheres import Division, DoubleSphere, ExtendedUnified, FieldOfView, Unified
from omniscv.cameras.circle_panoramas import NoncentralPanorama, OmnidirectionalStereo, Vr180
from omniscv.cameras.noncentral_mirrors import NoncentralConicalMirror, NoncentralSphericalMirror
from omniscv.cameras.lidar import Lidar
from omniscv.cameras.rolling_shutter import RollingShutter
from omniscv.cameras.parallel_rays import Orthographic, PushBroom
from omniscv.cameras.pinhole import Pinhole
# isort: on

__all__ = [
    "Camera", "CatadioptricHyperbolic", "CatadioptricParabolic", "CatadioptricPlanar", "CentralCamera",
    "CubeMap", "Cylindrical", "Division", "DoubleSphere", "EquiangularCube", "Equirectangular",
    "ExtendedUnified", "FTheta", "FieldOfView", "Fisheye624", "FisheyeEquidistant", "FisheyeEquisolid",
    "FisheyeOrthographic", "FisheyeStereographic", "KannalaBrandt", "Lidar", "NoncentralConicalMirror",
    "NoncentralPanorama", "NoncentralSphericalMirror", "Octahedral", "OmnidirectionalStereo",
    "Orthographic", "Parameter", "Pinhole", "PushBroom", "Rays", "RollingShutter", "Scaramuzza", "Unified",
    "Viewpoints", "Vr180", "create", "from_dict", "model", "names", "register"
]  # fmt: skip
