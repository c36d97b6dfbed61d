"""Frames of datasets, exact: their layers are traced, not composed."""

import numpy as np
import OpenEXR

from omniscv.compose.files import write
from omniscv.dataset import Frame


def traced(scene, camera, pose):
    """The layers of an image of a scene, each value that of the ray through the pixel's centre."""
    rays = camera.unproject()
    hits = scene.trace(pose.to_world(np.nan_to_num(rays.origins)), rays.directions @ pose.R_w_c.T)
    outside = ~rays.valid
    return {
        "lit": np.rint(255 * np.where(outside[..., None], 0, hits.color)).astype(np.uint8),
        "depth": np.where(outside, 0, hits.distance).astype(np.float32),
        "normals": np.where(outside[..., None], 0, hits.normal @ pose.R_w_c).astype(np.float32),
        "labels": np.where(outside, 0, hits.label).astype(np.uint16),
    }


def frame_of(folder, layers, camera, pose, camera_name="cam", key="cam", scene=None, **more):
    """A frame whose layers are written below a folder."""
    paths = write(layers, {}, None, folder, key)
    files = {path.name.split(".")[1]: path for path in paths if path.suffix != ".json"}
    instances = {} if scene is None else {name: scene.label(name) for name in scene.objects}
    return Frame(key, camera_name, camera, pose, files, instances, **more)


def traced_frame(folder, scene, camera, pose, camera_name="cam", key="cam", **more):
    return frame_of(folder, traced(scene, camera, pose), camera, pose, camera_name, key, scene, **more)


def black_frame(folder, camera, pose, camera_name="cam", key="cam", **more):
    """A frame of which only camera and pose matter."""
    lit = np.zeros((camera.height, camera.width, 3), np.uint8)
    return frame_of(folder, {"lit": lit}, camera, pose, camera_name, key, **more)


def channels(path):
    """The channels of an EXR file, by another reader."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}
