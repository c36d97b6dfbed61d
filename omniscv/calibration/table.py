"""The forms of lens files that are declared; :mod:`omniscv.calibration.keys` says how to read one.

Sources: the programs' own readers and writers, as of 2026; those of the half pixel in docs/calibration.md.
"""

from omniscv.calibration import documents, parts
from omniscv.calibration.forms import (
    Form,
    Layout,
    PoseKeys,
    PoseMatrix,
    Reading,
    Readout,
    TimeOffset,
    Writing,
)
from omniscv.calibration.keys import (
    ANY,
    FISHEYE4,
    MATRIX,
    RADTAN4,
    RADTAN5,
    RADTAN8,
    Key,
    Model,
    ModelName,
    Number,
    array,
    scalar,
    scalars,
)
from omniscv.calibration.nodes import Paths

UPRIGHT: tuple[Number | int, ...] = ("fx", 0, "cx", 0, "fy", "cy", 0, 0, 1)
"""A matrix K without skew, row by row."""

_RADTAN14: tuple[Number | int, ...] = (*RADTAN8, "s1", "s2", "s3", "s4", 0, 0)


def distortion(paths: Paths, *, optional: bool = False, or_none: bool = False) -> Key:
    """Return the key of a list of OpenCV's 4, 5, 8, 12 or 14 coefficients of a plain lens.

    The last two of 14 tilt the sensor, and are 0.

    Args:
        paths: its place.
        optional: whether it may be missing.
        or_none: whether the list may be empty.
    """
    counts = (4, 5, 8, 12, 14)
    return array(paths, *_RADTAN14, counts=(0, *counts) if or_none else counts, optional=optional)


CAMODOCAL = Form(
    "camodocal",
    "camodocal, VINS-Mono, VINS-Fusion, KITTI-360's fisheyes",
    marks=("model_type", ("projection_parameters", "poly_parameters")),
    layout=Layout(
        models=(
            Model(
                "unified",
                words=("MEI",),
                keys=(
                    scalar("projection_parameters.gamma1", "fx"),
                    scalar("projection_parameters.gamma2", "fy"),
                    scalar("projection_parameters.u0", "cx"),
                    scalar("projection_parameters.v0", "cy"),
                    scalar("mirror_parameters.xi", "xi"),
                    *scalars(*RADTAN4, below="distortion_parameters", optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=("KANNALA_BRANDT",),
                keys=(
                    scalar("projection_parameters.mu", "fx"),
                    scalar("projection_parameters.mv", "fy"),
                    scalar("projection_parameters.u0", "cx"),
                    scalar("projection_parameters.v0", "cy"),
                    scalar(("projection_parameters.k2", "distortion_parameters.k2"), "k1"),
                    scalar(("projection_parameters.k3", "distortion_parameters.k3"), "k2"),
                    scalar(("projection_parameters.k4", "distortion_parameters.k4"), "k3"),
                    scalar(("projection_parameters.k5", "distortion_parameters.k5"), "k4"),
                ),
            ),
            Model(
                "pinhole",
                words=("PINHOLE",),
                keys=(
                    *scalars(*MATRIX, below="projection_parameters"),
                    *scalars(*RADTAN4, below="distortion_parameters", optional=True),
                ),
            ),
            Model(
                "pinhole",
                words=("PINHOLE_FULL",),
                keys=(
                    *scalars(*MATRIX, below="projection_parameters"),
                    *scalars(*RADTAN8, below="distortion_parameters", optional=True),
                ),
            ),
            Model(
                "scaramuzza",
                words=("SCARAMUZZA",),
                keys=(
                    scalar("poly_parameters.p0", "a0"),
                    scalar("poly_parameters.p1", "a1"),
                    scalar("poly_parameters.p2", "a2"),
                    scalar("poly_parameters.p3", "a3"),
                    scalar("poly_parameters.p4", "a4"),
                    scalar("affine_parameters.ac", "c"),
                    scalar("affine_parameters.ad", "d"),
                    scalar("affine_parameters.ae", "e"),
                    scalar("affine_parameters.cx", "cx"),
                    scalar("affine_parameters.cy", "cy"),
                ),
                read_only=True,
            ),
        ),
        word=("model_type",),
        time=TimeOffset("td"),
        readouts=(Readout("rolling_shutter_tr"),),
        harmless="^invpoly|^rollingshutter$",
    ),
    reading=Reading(finish=parts.shutter),
    writing=Writing("opencv-yaml", constant={"camera_name": "camera"}),
    refused="SCARAMUZZA is read only",
)


def _of_first(*numbers: Number, optional: bool = False) -> tuple[Key, ...]:
    """Return ORB-SLAM's keys of its first camera, or of its only one."""
    keys = []
    for number in numbers:
        keys.append(scalar((f"Camera1.{number}", f"Camera.{number}"), number, optional=optional))
    return tuple(keys)


ORB = Form(
    "orb-slam",
    "ORB-SLAM2, ORB-SLAM3",
    marks=(("Camera1.fx", "Camera.fx"),),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("PinHole", "none"),
                keys=(*_of_first(*MATRIX), *_of_first(*RADTAN5, optional=True)),
            ),
            Model(
                "kannala-brandt",
                words=("KannalaBrandt8",),
                keys=_of_first(*MATRIX, *FISHEYE4),
            ),
        ),
        word=("Camera.type",),
        size=("Camera.width", "Camera.height"),
        poses=(PoseMatrix(("Stereo.T_c1_c2", "Tlr"), "T_b_c"),),
    ),
    reading=Reading(split=parts.orb_cameras, stereo=parts.by_baseline),
    writing=Writing("opencv-yaml", join=parts.join_orb, from_first=True),
)

STELLA = Form(
    "stella-vslam",
    "stella_vslam, OpenVSLAM",
    marks=("Camera.cols", "Camera.model"),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("perspective",),
                keys=(
                    *scalars(*MATRIX, below="Camera"),
                    *scalars(*RADTAN5, below="Camera", optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=("fisheye",),
                keys=scalars(*MATRIX, *FISHEYE4, below="Camera"),
            ),
            Model(
                "division",
                words=("radial_division",),
                keys=(*scalars(*MATRIX, below="Camera"), scalar("Camera.distortion", "k")),
            ),
            Model("equirectangular", words=("equirectangular",)),
        ),
        word=("Camera.model",),
        size=("Camera.cols", "Camera.rows"),
        harmless="^stereorectifier",
    ),
    reading=Reading(stereo=parts.by_baseline),
    writing=Writing(
        constant={
            "Camera.name": "camera",
            "Camera.setup": "monocular",
            "Camera.fps": 30.0,
            "Camera.color_order": "RGB",
        }
    ),
)

_CENTER_AND_DISTORTION = scalars("cx", "cy", "k1", "k2", "k3", "p1", "p2", optional=True)
NERFSTUDIO = Form(
    "nerfstudio",
    "nerfstudio, instant-ngp, NeRF's transforms.json",
    marks=("frames", ("fl_x", "camera_angle_x", "x_fov")),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("PINHOLE", "OPENCV", "SIMPLE_PINHOLE", "PERSPECTIVE", "none"),
                keys=(scalar("fl_x", "fx"), scalar("fl_y", "fy"), *scalars("cx", "cy")),
            ),
            Model(
                "pinhole",
                words=("OPENCV", "PINHOLE", "PERSPECTIVE", "none"),
                keys=(scalar("fl_x", "fx"), scalar("fl_y", "fy"), *_CENTER_AND_DISTORTION),
            ),
            Model(
                "pinhole",
                words=("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "none"),
                keys=(scalar("fl_x", "f"), *_CENTER_AND_DISTORTION),
                read_only=True,
            ),
            Model(
                "pinhole",
                words=("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "none"),
                keys=(
                    scalar("camera_angle_x", "angle"),
                    scalar("camera_angle_y", "angle_y", optional=True),
                    *_CENTER_AND_DISTORTION,
                ),
                read_only=True,
            ),
            Model(
                "kannala-brandt",
                words=("OPENCV_FISHEYE",),
                keys=(
                    scalar("fl_x", "fx"),
                    scalar("fl_y", "fy"),
                    *scalars("cx", "cy"),
                    *scalars(*FISHEYE4, optional=True),
                ),
            ),
            Model(
                "equirectangular",
                words=("EQUIRECTANGULAR",),
                keys=(
                    scalar("fl_x", "W/2", optional=True),
                    scalar("fl_y", "H", optional=True),
                    scalar("cx", "W/2", optional=True),
                    scalar("cy", "H/2", optional=True),
                ),
            ),
        ),
        word=("camera_model",),
        size=("w", "h"),
        shift_px=0.0,
        harmless="^aabb|^(n|max|min)k$|^up$",
    ),
    reading=Reading(split=parts.frames, finish=parts.agreeing),
    writing=Writing("json", constant={"frames": []}),
)

KITTI = Form(
    "kitti",
    "KITTI's calib_cam_to_cam.txt and calib.txt, KITTI-360's perspective.txt",
    marks=(parts.KITTI_MATRICES,),
    layout=Layout(
        models=(Model("pinhole", keys=(array("K", *UPRIGHT), array("D", *RADTAN5, counts=(0, 4, 5)))),),
        size=("S",),
        poses=(PoseMatrix("T", "T_c_b"),),
    ),
    reading=Reading(split=parts.kitti),
    writing=Writing("lines", join=parts.join_kitti, label="0{0}"),
    refused="projections that are no camera's",
)

# Half pixel of Middlebury and nuScenes: documented nowhere; both were calibrated by programs that take whole
# numbers.
MIDDLEBURY = Form(
    "middlebury",
    "Middlebury's calib.txt, ETH3D's stereo",
    marks=("cam0", "width", "height"),
    layout=Layout(
        models=(Model("pinhole", keys=(array("K", *UPRIGHT),), read_only=True),),
        size=("width", "height"),
        poses=(PoseMatrix("T", "T_b_c"),),
    ),
    reading=Reading(split=parts.middlebury),
)

D = (
    "distortion_coefficients", "D", "dist", "distCoeffs", "dist_coeff", "dist_coefs", "dist_coef",
    "distortion_coeffs", "distortion_coeff", "distortion", "coeffs", "coefficients", "distortion_coef",
    "distortions", "distortion_parameters", "distortion_params", "dist_params", "distortion_vector",
    "distCoefs", "dist_coefficients", "distort",
)  # fmt: skip
"""What people call a list of coefficients."""
WIDTH = (
    "image_width", "width", "image.width", "img_width", "w", "cols", "resolution.width", "image_size.width",
    "size.width", "image_size.w", "size.w",
)  # fmt: skip
HEIGHT = (
    "image_height", "height", "image.height", "img_height", "h", "rows", "resolution.height",
    "image_size.height", "size.height", "image_size.h", "size.h",
)  # fmt: skip
_FOCAL_X = ("fx", "focal_x", "focal_length_x", "f_x")
_FOCAL_Y = ("fy", "focal_y", "focal_length_y", "f_y")
_CENTER_X = ("cx", "ppx", "c_x", "principal_x", "center_x", "x0")
_CENTER_Y = ("cy", "ppy", "c_y", "principal_y", "center_y", "y0")
_FOUR = (scalar(_FOCAL_X, "fx"), scalar(_FOCAL_Y, "fy"), scalar(_CENTER_X, "cx"), scalar(_CENTER_Y, "cy"))


def _one_by_one(*numbers: Number, optional: bool = False) -> tuple[Key, ...]:
    """Return the keys of coefficients that stand one by one, beside the focal lengths or in a mapping."""
    keys = []
    for number in numbers:
        paths = (number, f"distortion.{number}", f"distortion_coeffs.{number}")
        keys.append(scalar(paths, number, optional=optional))
    return tuple(keys)


_MODEL_WORDS = (
    "model", "distortion_model", "camera_model", "distortion_type", "model_type", "camera_type",
    "distortion.model", "distortion.type",
)  # fmt: skip
_BROWN_CONRADY = ("Brown_Conrady", "pinhole", "perspective", "none", "opencv", "pinhole_opencv")
INTRINSICS = parts.OfOthers(
    "intrinsics",
    "RealSense, Orbbec and other depth cameras: fx, fy, cx or ppx in JSON or YAML",
    marks=(_FOCAL_X, _FOCAL_Y, _CENTER_X, _CENTER_Y),
    layout=Layout(
        models=(
            Model("pinhole", words=_BROWN_CONRADY, keys=(*_FOUR, distortion(D, or_none=True))),
            Model(
                "pinhole",
                words=_BROWN_CONRADY,
                keys=(*_FOUR, *_one_by_one(*RADTAN5, optional=True)),
                read_only=True,
            ),
            Model("pinhole", words=_BROWN_CONRADY, keys=(*_FOUR, *_one_by_one(*RADTAN8)), read_only=True),
            Model(
                "pinhole",
                words=("Modified_Brown_Conrady", "Inverse_Brown_Conrady", "inverse", "modified"),
                keys=(*_FOUR, array(D, 0, 0, 0, 0, 0, counts=(0, 5))),
                read_only=True,
            ),
            Model(
                "kannala-brandt",
                words=("Kannala_Brandt4", "fisheye"),
                keys=(*_FOUR, array(D, *FISHEYE4, 0, counts=(4, 5))),
            ),
            Model(
                "kannala-brandt",
                words=("Kannala_Brandt4", "fisheye"),
                keys=(*_FOUR, *_one_by_one(*FISHEYE4)),
                read_only=True,
            ),
        ),
        word=(_MODEL_WORDS,),
        size=(("width", *WIDTH), ("height", *HEIGHT)),
    ),
    writing=Writing("json"),
)

OPEN3D = Form(
    "open3d",
    "Open3D: PinholeCameraIntrinsic, Azure Kinect's recorder; DepthAI's calibration",
    marks=("intrinsic_matrix", "width", "height"),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                keys=(
                    array("intrinsic_matrix", *UPRIGHT),
                    distortion(D, optional=True, or_none=True),
                    scalar("cameraType", 0, optional=True),
                ),
                read_only=True,
            ),
            Model("pinhole", keys=(array("intrinsic_matrix", "fx", 0, 0, 0, "fy", 0, "cx", "cy", 1),)),
        ),
        size=("width", "height"),
        harmless="^stereorectif",
    ),
    writing=Writing("json"),
)

_COEFFICIENTS = ("distortion_coefficients", "distortion_parameters")
SENSOR = Form(
    "sensor",
    "EuRoC's sensor.yaml, ASL, Kimera",
    marks=("intrinsics", ("camera_model", "distortion_model"), ("distortion_coefficients", "T_BS")),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=(("pinhole", "radial-tangential"), ("none", "radtan")),
                keys=(
                    array("intrinsics", *MATRIX),
                    array(_COEFFICIENTS, *RADTAN8, counts=(4, 5, 8)),
                ),
            ),
            Model(
                "pinhole",
                words=(("pinhole", "none"), ("none", "none")),
                keys=(
                    array("intrinsics", *MATRIX),
                    array(_COEFFICIENTS, 0, 0, 0, 0, counts=(0, 4), optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=(("pinhole", "equidistant"), ("none", "equidistant"), ("fisheye", "equidistant")),
                keys=(array("intrinsics", *MATRIX), array(_COEFFICIENTS, *FISHEYE4)),
            ),
            Model(
                "unified",
                words=(("omni", "radial-tangential"),),
                keys=(array("intrinsics", "xi", *MATRIX), array(_COEFFICIENTS, *RADTAN4)),
            ),
        ),
        word=("camera_model", "distortion_model"),
        size=("resolution",),
        poses=(PoseMatrix("T_BS", "T_b_c"),),
    ),
    writing=Writing(constant={"sensor_type": "camera", "comment": "omniscv", "rate_hz": 20}),
)


def _basalt(word: str, name: ModelName, *keys: Key) -> Model:
    """Return a model by basalt's word for it, our name, and the keys of its numbers beside those of K."""
    return Model(name, (*scalars(*MATRIX, below="intrinsics"), *keys), (word,), read_only=True)


BASALT = Form(
    "basalt",
    "basalt",
    marks=("value0.intrinsics",),
    layout=Layout(
        models=(
            _basalt("pinhole", "pinhole"),
            _basalt(
                "pinhole-radtan8",
                "pinhole",
                *scalars(*RADTAN8, below="intrinsics"),
                scalar("intrinsics.rpmax", ANY, optional=True),
            ),
            _basalt("kb4", "kannala-brandt", *scalars(*FISHEYE4, below="intrinsics")),
            _basalt("ds", "double-sphere", *scalars("xi", "alpha", below="intrinsics")),
            _basalt("eucm", "extended-unified", *scalars("alpha", "beta", below="intrinsics")),
            _basalt("ucm", "extended-unified", *scalars("alpha", below="intrinsics")),
            _basalt("fov", "field-of-view", scalar("intrinsics.w", "omega")),
        ),
        word=("camera_type",),
        size=("resolution",),
        poses=(
            PoseKeys(
                "T_imu_cam",
                keys=(
                    scalar("T_imu_cam.px", "x"),
                    scalar("T_imu_cam.py", "y"),
                    scalar("T_imu_cam.pz", "z"),
                    *scalars("qx", "qy", "qz", "qw", below="T_imu_cam"),
                ),
            ),
        ),
        time=TimeOffset("cam_time_offset_ns", 1e-9),
    ),
    reading=Reading(split=parts.basalt, finish=parts.basalt_unified),
)

WOODSCAPE = Form(
    "woodscape",
    "WoodScape",
    marks=("intrinsic.cx_offset", "intrinsic.k1"),
    layout=Layout(
        models=(
            Model(
                "ftheta",
                words=("radial_poly",),
                keys=(
                    scalar("intrinsic.k1", "c1"),
                    scalar("intrinsic.k2", "c2"),
                    scalar("intrinsic.k3", "c3"),
                    scalar("intrinsic.k4", "c4"),
                    scalar("intrinsic.cx_offset", "du"),
                    scalar("intrinsic.cy_offset", "dv"),
                    scalar("intrinsic.aspect_ratio", 1, optional=True),
                    scalar("intrinsic.poly_order", 4, optional=True),
                ),
            ),
        ),
        word=("intrinsic.model",),
        size=("intrinsic.width", "intrinsic.height"),
        poses=(
            PoseKeys(
                "extrinsic",
                keys=(
                    array("extrinsic.translation", "x", "y", "z"),
                    array("extrinsic.quaternion", "qx", "qy", "qz", "qw"),
                ),
            ),
        ),
    ),
    writing=Writing(
        "json", constant={"intrinsic.aspect_ratio": 1.0, "intrinsic.poly_order": 4, "name": "cam0"}
    ),
    refused="an aspect ratio other than 1",
)

_FISHEYE62: tuple[Number, ...] = ("f", "cx", "cy", "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1")
ARIA = Form(
    "aria",
    "Project Aria's device and online calibrations",
    marks=("CameraCalibrations",),
    layout=Layout(
        models=(
            Model(
                "fisheye624",
                words=("FisheyeRadTanThinPrism",),
                keys=(array("Projection.Params", *_FISHEYE62, "s0", "s1", "s2", "s3"),),
            ),
            Model(
                "kannala-brandt",
                words=("KannalaBrandtK3",),
                keys=(array("Projection.Params", *MATRIX, *FISHEYE4),),
            ),
            Model(
                "fisheye624",
                words=("Fisheye62",),
                keys=(array("Projection.Params", *_FISHEYE62),),
                read_only=True,
            ),
            Model(
                "pinhole",
                words=("Linear",),
                keys=(array("Projection.Params", *MATRIX),),
                read_only=True,
            ),
        ),
        word=("Projection.Name",),
        size=("ImageSize",),
        poses=(
            PoseKeys(
                "T_Device_Camera",
                keys=(
                    array("T_Device_Camera.Translation", "x", "y", "z"),
                    array("T_Device_Camera.UnitQuaternion", "qw", "qx", "qy", "qz"),
                ),
            ),
        ),
        time=TimeOffset("TimeOffsetSec_Device_Camera"),
    ),
    reading=Reading(split=parts.aria),
    writing=Writing("json", join=parts.join_aria),
)

NUSCENES = Form(
    "nuscenes",
    "nuScenes: calibrated_sensor.json, whose pictures are 1600 x 900",
    marks=("camera_intrinsic", "translation", "rotation"),
    layout=Layout(
        models=(Model("pinhole", keys=(array("camera_intrinsic", *UPRIGHT),), read_only=True),),
        size=("width", "height"),
        poses=(
            PoseKeys(
                "rotation",
                keys=(array("translation", "x", "y", "z"), array("rotation", "qw", "qx", "qy", "qz")),
            ),
        ),
    ),
    reading=Reading(split=parts.nuscenes),
)

_METASHAPE = (
    scalar("f", "f_y"),
    scalar("cx", "du", optional=True),
    scalar("cy", "dv", optional=True),
    scalar("b1", "b1", optional=True),
    scalar("b2", "s", optional=True),
)
METASHAPE = Form(
    "metashape",
    "Agisoft Metashape and PhotoScan: lenses and cameras in XML",
    marks=("calibration",),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("frame",),
                keys=(
                    *_METASHAPE,
                    *scalars("k1", "k2", "k3", optional=True),
                    scalar("p1", "p2", optional=True),
                    scalar("p2", "p1", optional=True),
                    scalar("k4", 0, optional=True),
                    scalar("p3", 0, optional=True),
                    scalar("p4", 0, optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=("fisheye",),
                keys=(
                    *_METASHAPE,
                    *scalars(*FISHEYE4, optional=True),
                    scalar("p1", 0, optional=True),
                    scalar("p2", 0, optional=True),
                    scalar("p3", 0, optional=True),
                    scalar("p4", 0, optional=True),
                ),
            ),
            Model(
                "equirectangular",
                words=("spherical",),
                keys=(
                    scalar("f", ANY, optional=True),
                    scalar("cx", 0, optional=True),
                    scalar("cy", 0, optional=True),
                ),
            ),
        ),
        word=(("projection", "type"),),
        size=(("width", "resolution.width"), ("height", "resolution.height")),
        shift_px=0.0,
        harmless="covariance",
    ),
    reading=Reading(split=parts.metashape, sparse=True),
    writing=Writing("xml", dump=lambda lens: documents.SYNTAXES["xml"]({"calibration": lens})),
    refused="K4 of frames, P3, P4; P1 and P2 of fisheyes",
)

_NORMED = (
    scalar("focal_x", "nfx"),
    scalar("focal_y", "nfy"),
    scalar("c_x", "ncx", optional=True),
    scalar("c_y", "ncy", optional=True),
)
_NORMED_FISHEYE62 = (
    *_NORMED,
    scalar("k1", "k0"),
    scalar("k2", "k1"),
    scalar("k3", "k2"),
    scalar("k4", "k3"),
    scalar("k5", "k4"),
    scalar("k6", "k5"),
    scalar("p1", "p0"),
    scalar("p2", "p1"),
)
OPENSFM = Form(
    "opensfm",
    "OpenSfM, OpenDroneMap: camera_models.json, reconstruction.json",
    marks=("projection_type", "width"),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("perspective",),
                keys=(scalar("focal", "nf"), *scalars("k1", "k2", optional=True)),
            ),
            Model(
                "pinhole",
                words=("brown",),
                keys=(*_NORMED, *scalars("k1", "k2", "k3", "p1", "p2", optional=True)),
            ),
            Model(
                "pinhole",
                words=("simple_radial", "radial"),
                keys=(*_NORMED, *scalars("k1", "k2", optional=True)),
                read_only=True,
            ),
            Model(
                "kannala-brandt",
                words=("fisheye",),
                keys=(scalar("focal", "nf"), *scalars("k1", "k2", optional=True)),
            ),
            Model(
                "kannala-brandt",
                words=("fisheye_opencv",),
                keys=(*_NORMED, *scalars(*FISHEYE4, optional=True)),
            ),
            Model(
                "fisheye624",
                words=("fisheye624",),
                keys=(*_NORMED_FISHEYE62, *scalars("s0", "s1", "s2", "s3", optional=True)),
            ),
            Model("fisheye624", words=("fisheye62",), keys=_NORMED_FISHEYE62, read_only=True),
            Model("equirectangular", words=("spherical", "equirectangular")),
        ),
        word=("projection_type",),
        size=("width", "height"),
        shift_px=0.0,
    ),
    writing=Writing("json", join=dict),
    refused="dual",
)

_OPENMVG = (scalar("focal_length", "f"), array("principal_point", "cx", "cy"))
# Half pixel: openMVG, issue 1271 and pull request 1812: centres at whole numbers.
OPENMVG = Form(
    "openmvg",
    "OpenMVG: sfm_data.json",
    marks=("intrinsics",),
    layout=Layout(
        models=(
            Model("pinhole", words=("pinhole",), keys=_OPENMVG, read_only=True),
            Model(
                "pinhole",
                words=("pinhole_radial_k1",),
                keys=(*_OPENMVG, array("disto_k1", "k1")),
                read_only=True,
            ),
            Model(
                "pinhole",
                words=("pinhole_radial_k3",),
                keys=(*_OPENMVG, array("disto_k3", "k1", "k2", "k3")),
                read_only=True,
            ),
            Model(
                "pinhole",
                words=("pinhole_brown_t2",),
                keys=(*_OPENMVG, array("disto_t2", "k1", "k2", "k3", "p1", "p2")),
                read_only=True,
            ),
            Model(
                "kannala-brandt",
                words=("fisheye",),
                keys=(*_OPENMVG, array(("fisheye", "disto_fisheye"), *FISHEYE4)),
                read_only=True,
            ),
            Model("equirectangular", words=("spherical",), read_only=True),
        ),
        word=("model",),
        size=("width", "height"),
    ),
    reading=Reading(split=parts.openmvg),
)


def _alicevision(*matrix: Key) -> tuple[Model, ...]:
    """Return AliceVision's models, by the keys of focal length and centre."""
    radial1 = array("distortionParams", "k1")
    radial3 = array("distortionParams", "k1", "k2", "k3")
    brown = array("distortionParams", "k1", "k2", "k3", "p1", "p2")
    fisheye4 = array("distortionParams", *FISHEYE4)
    return (
        Model("pinhole", matrix, (("pinhole", "none"),), read_only=True),
        Model("pinhole", (*matrix, radial1), (("radial1", "none"), ("pinhole", "radialk1")), read_only=True),
        Model("pinhole", (*matrix, radial3), (("radial3", "none"), ("pinhole", "radialk3")), read_only=True),
        Model("pinhole", (*matrix, brown), (("brown", "none"), ("pinhole", "brown")), read_only=True),
        Model(
            "kannala-brandt",
            (*matrix, fisheye4),
            (("fisheye4", "none"), ("pinhole", "fisheye4")),
            read_only=True,
        ),
    )


# Sources: AliceVision, sfmDataIO/jsonIO.cpp (centres from the middle since 1.2.1, focal lengths in mm since
# 1.2.2); its lens code is OpenMVG's. pixelRatio changed its meaning in 1.2.5: only 1 is read.
ALICEVISION = Form(
    "alicevision",
    "AliceVision, Meshroom: .sfm, .mg",
    marks=("intrinsicId", "principalPoint"),
    layout=Layout(
        models=(
            *_alicevision(
                scalar("sensorWidth", "sensor"),
                scalar("focalLength", "mm"),
                array("principalPoint", "du0", "dv0"),
                scalar("pixelRatio", 1, optional=True),
            ),
            *_alicevision(scalar("pxFocalLength", "f"), array("principalPoint", "cx", "cy")),
        ),
        word=("type", "distortionType"),
        size=("width", "height"),
        harmless="^sensorwidth$",
    ),
    refused="3DE's models, fisheye1, equidistant; a pixel ratio other than 1",
)

_OPENICC = (
    scalar("intrinsics.focal_length", "fx"),
    scalar("intrinsics.aspect_ratio", "ratio"),
    scalar("intrinsics.principal_pt_x", "cx"),
    scalar("intrinsics.principal_pt_y", "cy"),
    scalar("intrinsics.skew", "s", optional=True),
)
OPENICC = Form(
    "openicc",
    "OpenImuCameraCalibrator",
    marks=("intrinsic_type", "intrinsics.focal_length"),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("PINHOLE",),
                keys=(
                    *_OPENICC,
                    scalar("intrinsics.radial_distortion_1", "k1", optional=True),
                    scalar("intrinsics.radial_distortion_2", "k2", optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=("FISHEYE",),
                keys=(
                    *_OPENICC,
                    scalar("intrinsics.radial_distortion_1", "k1"),
                    scalar("intrinsics.radial_distortion_2", "k2"),
                    scalar("intrinsics.radial_distortion_3", "k3"),
                    scalar("intrinsics.radial_distortion_4", "k4"),
                ),
            ),
            Model(
                "double-sphere",
                words=("DOUBLE_SPHERE",),
                keys=(*_OPENICC, *scalars("xi", "alpha", below="intrinsics")),
            ),
            Model(
                "extended-unified",
                words=("EXTENDED_UNIFIED",),
                keys=(*_OPENICC, *scalars("alpha", "beta", below="intrinsics")),
            ),
        ),
        word=("intrinsic_type",),
    ),
    writing=Writing("json"),
    refused="DIVISION_UNDISTORTION",
)

DSO = Form(
    "dso",
    "DSO, LSD-SLAM, TUM monoVO: camera.txt",
    marks=("model", "numbers", "size"),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                words=("Pinhole", "FOV", "ATAN", "none"),
                keys=(array("numbers", *MATRIX, 0, counts=(4, 5)),),
            ),
            Model(
                "field-of-view",
                words=("FOV", "ATAN", "none"),
                keys=(array("numbers", *MATRIX, "omega"),),
            ),
            Model("pinhole", words=("RadTan", "none"), keys=(array("numbers", *MATRIX, *RADTAN4),)),
            Model(
                "kannala-brandt",
                words=("EquiDistant", "KannalaBrandt"),
                keys=(array("numbers", *MATRIX, *FISHEYE4),),
            ),
        ),
        word=("model",),
        size=("size",),
    ),
    reading=Reading(split=parts.dso),
    writing=Writing(dump=parts.write_dso),
)

ZED = Form(
    "zed",
    "ZED: SN.conf",
    marks=("LEFT_CAM_HD",),
    layout=Layout(
        models=(
            Model(
                "pinhole",
                keys=(
                    *scalars(*MATRIX, "k1", "k2"),
                    *scalars("p1", "p2", "k3", "k4", "k5", "k6", optional=True),
                ),
                read_only=True,
            ),
        ),
        size=("size",),
    ),
    reading=Reading(split=parts.zed),
    refused="poses: the signs of RX, CV and RZ are documented nowhere",
)

GYROFLOW = Form(
    "gyroflow",
    "gyroflow's lens profiles",
    marks=("fisheye_params.camera_matrix", "calib_dimension.w"),
    layout=Layout(
        models=(
            Model(
                "kannala-brandt",
                words=("opencv_fisheye", "none"),
                keys=(
                    array("fisheye_params.camera_matrix", *UPRIGHT),
                    array("fisheye_params.distortion_coeffs", *FISHEYE4, counts=(0, 4)),
                ),
                read_only=True,
            ),
            Model(
                "pinhole",
                words=("opencv_standard",),
                keys=(
                    array("fisheye_params.camera_matrix", *UPRIGHT),
                    distortion("fisheye_params.distortion_coeffs", or_none=True),
                ),
                read_only=True,
            ),
        ),
        word=("distortion_model",),
        size=("calib_dimension.w", "calib_dimension.h"),
        readouts=(Readout("frame_readout_time", 1e-3),),
        harmless="radialdistortionlimit|^crop$|readoutdirection",
    ),
    reading=Reading(finish=parts.gyroflow),
    refused="poly3, poly5, ptlens, gopro, sony, insta360; stretches, digital lenses",
)
