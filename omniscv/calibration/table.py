"""The forms of lens files as rows; :mod:`omniscv.calibration.forms` says how to read one.

Sources: the programs' own readers and writers, as of 2026; those of the half pixel in docs/calibration.md.
"""

# A row is a block of few long lines.
# fmt: off
# ruff: noqa: E501

from omniscv.calibration import documents, parts
from omniscv.calibration.forms import Form

_K = "fx,0,cx,0,fy,cy,0,0,1"
PLAIN = "k1,k2,p1,p2;k3;k4,k5,k6;s1,s2,s3,s4;0,0"
CAMODOCAL = Form("camodocal", "camodocal, VINS-Mono, VINS-Fusion, KITTI-360's fisheyes",
    "model_type projection_parameters|poly_parameters", """
    MEI unified projection_parameters.gamma1=fx .gamma2=fy .u0=cx .v0=cy mirror_parameters.xi=xi distortion_parameters.k1? .k2? .p1? .p2?
    KANNALA_BRANDT kannala-brandt projection_parameters.mu=fx .mv=fy .u0=cx .v0=cy .k2|distortion_parameters.k2=k1 projection_parameters.k3|distortion_parameters.k3=k2 projection_parameters.k4|distortion_parameters.k4=k3 projection_parameters.k5|distortion_parameters.k5=k4
    PINHOLE pinhole projection_parameters.fx .fy .cx .cy distortion_parameters.k1? .k2? .p1? .p2?
    PINHOLE_FULL pinhole projection_parameters.fx .fy .cx .cy distortion_parameters.k1? .k2? .p1? .p2? .k3? .k4? .k5? .k6?
    < SCARAMUZZA scaramuzza poly_parameters.p0=a0 .p1=a1 .p2=a2 .p3=a3 .p4=a4 affine_parameters.ac=c .ad=d .ae=e .cx=cx .cy=cy
    """,
    word="model_type", syntax="opencv-yaml", readout=(("rolling_shutter_tr", 1.0, False),), time=("td", 1.0), harmless="^invpoly|^rollingshutter$",
    constant={"camera_name": "camera"}, finish=parts.shutter, refused="SCARAMUZZA is read only")

_ORB_NUMBERS = "Camera1.fx|Camera.fx Camera1.fy|Camera.fy Camera1.cx|Camera.cx Camera1.cy|Camera.cy"
def _orb_optional(names: str) -> str:
    return " ".join(f"Camera1.{name}|Camera.{name}?" for name in names.split())
ORB = Form("orb-slam", "ORB-SLAM2, ORB-SLAM3",
    "Camera1.fx|Camera.fx", f"""
    PinHole|none pinhole {_ORB_NUMBERS} {_orb_optional("k1 k2 p1 p2 k3")}
    KannalaBrandt8 kannala-brandt {_ORB_NUMBERS} {_orb_optional("k1 k2 k3 k4").replace("?", "")}
    """,
    word="Camera.type", size="Camera.width Camera.height", syntax="opencv-yaml", poses=(("Stereo.T_c1_c2|Tlr", "T_b_c"),), split=parts.orb_cameras,
    join=parts.join_orb, stereo=parts.by_baseline, from_first=True)

STELLA = Form("stella-vslam", "stella_vslam, OpenVSLAM",
    "Camera.cols Camera.model", """
    perspective pinhole Camera.fx .fy .cx .cy .k1? .k2? .p1? .p2? .k3?
    fisheye kannala-brandt Camera.fx .fy .cx .cy .k1 .k2 .k3 .k4
    radial_division division Camera.fx .fy .cx .cy .distortion=k
    equirectangular equirectangular
    """,
    word="Camera.model", size="Camera.cols Camera.rows",
    constant={"Camera.name": "camera", "Camera.setup": "monocular", "Camera.fps": 30.0, "Camera.color_order": "RGB"}, harmless="^stereorectifier",
    stereo=parts.by_baseline)

NERFSTUDIO = Form("nerfstudio", "nerfstudio, instant-ngp, NeRF's transforms.json",
    "frames fl_x|camera_angle_x", """
    PINHOLE|OPENCV|SIMPLE_PINHOLE|PERSPECTIVE|none pinhole fl_x=fx fl_y=fy cx cy
    OPENCV|PINHOLE|PERSPECTIVE|none pinhole fl_x=fx fl_y=fy cx? cy? k1? k2? k3? p1? p2?
    < OPENCV|PINHOLE|SIMPLE_PINHOLE|PERSPECTIVE|none pinhole fl_x=f cx? cy? k1? k2? k3? p1? p2?
    < OPENCV|PINHOLE|SIMPLE_PINHOLE|PERSPECTIVE|none pinhole camera_angle_x=angle camera_angle_y?=angle_y cx? cy? k1? k2? k3? p1? p2?
    OPENCV_FISHEYE kannala-brandt fl_x=fx fl_y=fy cx cy k1? k2? k3? k4?
    EQUIRECTANGULAR equirectangular fl_x?=W/2 fl_y?=H cx?=W/2 cy?=H/2
    """,
    word="camera_model", size="w h", shift=0.0, syntax="json", split=parts.frames, finish=parts.angle, constant={"frames": []},
    harmless="^camera_?angle|^aabb|^(n|max|min)?k$")

KITTI = Form("kitti", "KITTI's calib_cam_to_cam.txt and calib.txt, KITTI-360's perspective.txt",
    "K_00|K_01|K_02|P_rect_00|P_rect_02|P0|P2", f"- pinhole K={_K} D=;k1,k2,p1,p2;k3",
    size="S", syntax="lines", poses=(("T", "T_c_b"),), split=parts.kitti, join=parts.join_kitti, label="0{0}", refused="projections that are no camera's")

# Half pixel of Middlebury and nuScenes: documented nowhere; both were calibrated by programs that take whole numbers.
MIDDLEBURY = Form("middlebury", "Middlebury's calib.txt, ETH3D's stereo",
    "cam0 width height", f"< - pinhole K={_K}",
    size="width height", poses=(("T", "T_b_c"),), split=parts.middlebury)

D = (
    "distortion_coefficients|D|dist|distCoeffs|dist_coeff|dist_coefs|dist_coef|distortion_coeffs|distortion_coeff|"
    "distortion|coeffs|coefficients|distortion_coef|distortions|distortion_parameters|distortion_params|dist_params|"
    "distortion_vector|distCoefs|dist_coefficients|distort"
)
WIDTH = "image_width|width|image.width|img_width|w|cols|resolution.width|image_size.width|size.width|image_size.w|size.w"
HEIGHT = "image_height|height|image.height|img_height|h|rows|resolution.height|image_size.height|size.height|image_size.h|size.h"
_FOCALS = "fx|focal_x|focal_length_x|f_x fy|focal_y|focal_length_y|f_y"
_CENTERS = "cx|ppx|c_x|principal_x|center_x|x0 cy|ppy|c_y|principal_y|center_y|y0"
def _named(paths: str, names: str) -> str:
    return " ".join(f"{path}={name}" for path, name in zip(paths.split(), names.split(), strict=True))
_FOUR = f"{_named(_FOCALS, 'fx fy')} {_named(_CENTERS, 'cx cy')}"
_FLAT5, _FLAT8, _FOUR_K = (
    " ".join(f"{name}|distortion.{name}|distortion_coeffs.{name}{end}" for name in names.split())
    for names, end in (("k1 k2 p1 p2 k3", "?"), ("k1 k2 p1 p2 k3 k4 k5 k6", ""), ("k1 k2 k3 k4", ""))
)
_BC = "Brown_Conrady|pinhole|perspective|none|opencv|pinhole_opencv"
INTRINSICS = parts.OfOthers("intrinsics", "RealSense, Orbbec and other depth cameras: fx, fy, cx or ppx in JSON or YAML",
    f"{_FOCALS} {_CENTERS}", f"""
    {_BC} pinhole {_FOUR} {D}=;{PLAIN}
    < {_BC} pinhole {_FOUR} {_FLAT5}
    < {_BC} pinhole {_FOUR} {_FLAT8}
    < Modified_Brown_Conrady|Inverse_Brown_Conrady|inverse|modified pinhole {_FOUR} {D}=;0,0,0,0,0
    Kannala_Brandt4|fisheye kannala-brandt {_FOUR} {D}=k1,k2,k3,k4;0
    < Kannala_Brandt4|fisheye kannala-brandt {_FOUR} {_FOUR_K}
    """,
    word="model|distortion_model|camera_model|distortion_type|model_type|camera_type|distortion.model|distortion.type", size=f"width|{WIDTH} height|{HEIGHT}", syntax="json")

OPEN3D = Form("open3d", "Open3D: PinholeCameraIntrinsic, Azure Kinect's recorder; DepthAI's calibration",
    "intrinsic_matrix width height", f"< - pinhole intrinsic_matrix={_K} {D}?=;{PLAIN} cameraType?=0\n- pinhole intrinsic_matrix=fx,0,0,0,fy,0,cx,cy,1",
    size="width height", syntax="json", harmless="^stereorectif")

SENSOR = Form("sensor", "EuRoC's sensor.yaml, ASL, Kimera",
    "intrinsics camera_model|distortion_model distortion_coefficients|T_BS", """
    pinhole+radial-tangential|none+radtan pinhole intrinsics=fx,fy,cx,cy distortion_coefficients|distortion_parameters=k1,k2,p1,p2;k3;k4,k5,k6
    pinhole+none|none+none pinhole intrinsics=fx,fy,cx,cy distortion_coefficients|distortion_parameters?=;0,0,0,0
    pinhole+equidistant|none+equidistant|fisheye+equidistant kannala-brandt intrinsics=fx,fy,cx,cy distortion_coefficients|distortion_parameters=k1,k2,k3,k4
    omni+radial-tangential unified intrinsics=xi,fx,fy,cx,cy distortion_coefficients|distortion_parameters=k1,k2,p1,p2
    """,
    word="camera_model distortion_model", size="resolution", poses=(("T_BS", "T_b_c"),),
    constant={"sensor_type": "camera", "comment": "omniscv", "rate_hz": 20})

_FXY = "intrinsics.fx .fy .cx .cy"
BASALT = Form("basalt", "basalt",
    "value0.intrinsics", f"""
    < pinhole pinhole {_FXY}
    < pinhole-radtan8 pinhole {_FXY} .k1 .k2 .p1 .p2 .k3 .k4 .k5 .k6 .rpmax?=_
    < kb4 kannala-brandt {_FXY} .k1 .k2 .k3 .k4
    < ds double-sphere {_FXY} .xi .alpha
    < eucm extended-unified {_FXY} .alpha .beta
    < ucm extended-unified {_FXY} .alpha
    < fov field-of-view {_FXY} .w=omega
    """,
    word="camera_type", size="resolution", time=("cam_time_offset_ns", 1e-9), split=parts.basalt,
    poses=(("T_imu_cam", "T_imu_cam.px=x .py=y .pz=z .qx .qy .qz .qw"),),
    finish=lambda node, word, values, w, h: (values | ({"beta": 1.0} if word == "ucm" else {}), (w, h)))

WOODSCAPE = Form("woodscape", "WoodScape",
    "intrinsic.cx_offset intrinsic.k1", "radial_poly ftheta intrinsic.k1=c1 .k2=c2 .k3=c3 .k4=c4 .cx_offset=du .cy_offset=dv .aspect_ratio?=1 .poly_order?=4",
    word="intrinsic.model", size="intrinsic.width intrinsic.height", syntax="json", poses=(("extrinsic", "extrinsic.translation=x,y,z extrinsic.quaternion=qx,qy,qz,qw"),),
    constant={"intrinsic.aspect_ratio": 1.0, "intrinsic.poly_order": 4, "name": "cam0"}, refused="an aspect ratio other than 1")

ARIA = Form("aria", "Project Aria's device and online calibrations",
    "CameraCalibrations", """
    FisheyeRadTanThinPrism fisheye624 Projection.Params=f,cx,cy,k0,k1,k2,k3,k4,k5,p0,p1,s0,s1,s2,s3
    KannalaBrandtK3 kannala-brandt Projection.Params=fx,fy,cx,cy,k1,k2,k3,k4
    < Fisheye62 fisheye624 Projection.Params=f,cx,cy,k0,k1,k2,k3,k4,k5,p0,p1
    < Linear pinhole Projection.Params=fx,fy,cx,cy
    """,
    word="Projection.Name", size="ImageSize", syntax="json", time=("TimeOffsetSec_Device_Camera", 1.0),
    poses=(("T_Device_Camera", "T_Device_Camera.Translation=x,y,z T_Device_Camera.UnitQuaternion=qw,qx,qy,qz"),),
    split=parts.aria, join=parts.join_aria)

NUSCENES = Form("nuscenes", "nuScenes: calibrated_sensor.json, whose pictures are 1600 x 900",
    "camera_intrinsic translation rotation", f"< - pinhole camera_intrinsic={_K}",
    size="width height", poses=(("rotation", "translation=x,y,z rotation=qw,qx,qy,qz"),), split=parts.nuscenes)

_TERMS = "k1? k2? k3? p1?=p2 p2?=p1 k4?=0 p3?=0 p4?=0"
METASHAPE = Form("metashape", "Agisoft Metashape and PhotoScan: lenses and cameras in XML",
    "calibration", f"""
    frame pinhole f=f_y cx?=du cy?=dv b1?=b1 b2?=s {_TERMS}
    fisheye kannala-brandt f=f_y cx?=du cy?=dv b1?=b1 b2?=s k1? k2? k3? k4? p1?=0 p2?=0 p3?=0 p4?=0
    spherical equirectangular f?=_ cx?=0 cy?=0
    """,
    word="projection|type", size="width|resolution.width height|resolution.height", shift=0.0, syntax="xml", split=parts.metashape, harmless="covariance",
    dump=lambda lens: documents.SYNTAXES["xml"]({"calibration": lens}), sparse=True, refused="K4 of frames, P3, P4; P1 and P2 of fisheyes")

_NORMED = "focal_x=nfx focal_y=nfy c_x?=ncx c_y?=ncy"
OPENSFM = Form("opensfm", "OpenSfM, OpenDroneMap: camera_models.json, reconstruction.json",
    "projection_type width", f"""
    perspective pinhole focal=nf k1? k2?
    brown pinhole {_NORMED} k1? k2? k3? p1? p2?
    < simple_radial|radial pinhole {_NORMED} k1? k2?
    fisheye kannala-brandt focal=nf k1? k2?
    fisheye_opencv kannala-brandt {_NORMED} k1? k2? k3? k4?
    fisheye624 fisheye624 {_NORMED} k1=k0 k2=k1 k3=k2 k4=k3 k5=k4 k6=k5 p1=p0 p2=p1 s0? s1? s2? s3?
    < fisheye62 fisheye624 {_NORMED} k1=k0 k2=k1 k3=k2 k4=k3 k5=k4 k6=k5 p1=p0 p2=p1
    spherical|equirectangular equirectangular
    """,
    word="projection_type", size="width height", shift=0.0, syntax="json", join=dict, refused="dual")

_MVG = "focal_length=f principal_point=cx,cy"
# Half pixel: openMVG, issue 1271 and pull request 1812: centres at whole numbers.
OPENMVG = Form("openmvg", "OpenMVG: sfm_data.json",
    "intrinsics", f"""
    < pinhole pinhole {_MVG}
    < pinhole_radial_k1 pinhole {_MVG} disto_k1=k1
    < pinhole_radial_k3 pinhole {_MVG} disto_k3=k1,k2,k3
    < pinhole_brown_t2 pinhole {_MVG} disto_t2=k1,k2,k3,p1,p2
    < fisheye kannala-brandt {_MVG} fisheye|disto_fisheye=k1,k2,k3,k4
    < spherical equirectangular
    """,
    word="model", size="width height", split=parts.openmvg)

# Sources: AliceVision, sfmDataIO/jsonIO.cpp (centres from the middle since 1.2.1, focal lengths in mm since 1.2.2); its lens code
# is OpenMVG's. pixelRatio changed its meaning in 1.2.5: only 1 is read.
_AV = "sensorWidth=sensor focalLength=mm principalPoint=du0,dv0 pixelRatio?=1"
_AV_OLD = "pxFocalLength=f principalPoint=cx,cy"
ALICEVISION = Form("alicevision", "AliceVision, Meshroom: .sfm, .mg",
    "intrinsicId principalPoint", "\n".join(f"""
    < pinhole+none pinhole {_matrix}
    < radial1+none|pinhole+radialk1 pinhole {_matrix} distortionParams=k1
    < radial3+none|pinhole+radialk3 pinhole {_matrix} distortionParams=k1,k2,k3
    < brown+none|pinhole+brown pinhole {_matrix} distortionParams=k1,k2,k3,p1,p2
    < fisheye4+none|pinhole+fisheye4 kannala-brandt {_matrix} distortionParams=k1,k2,k3,k4
    """.strip() for _matrix in (_AV, _AV_OLD)),
    word="type distortionType", size="width height", harmless="^sensorwidth$", refused="3DE's models, fisheye1, equidistant; a pixel ratio other than 1")

_ICC = "intrinsics.focal_length=fx .aspect_ratio=ratio .principal_pt_x=cx .principal_pt_y=cy .skew?=s"
OPENICC = Form("openicc", "OpenImuCameraCalibrator",
    "intrinsic_type intrinsics.focal_length", f"""
    PINHOLE pinhole {_ICC} .radial_distortion_1?=k1 .radial_distortion_2?=k2
    FISHEYE kannala-brandt {_ICC} .radial_distortion_1=k1 .radial_distortion_2=k2 .radial_distortion_3=k3 .radial_distortion_4=k4
    DOUBLE_SPHERE double-sphere {_ICC} .xi .alpha
    EXTENDED_UNIFIED extended-unified {_ICC} .alpha .beta
    """,
    word="intrinsic_type", syntax="json", refused="DIVISION_UNDISTORTION")

DSO = Form("dso", "DSO, LSD-SLAM, TUM monoVO: camera.txt",
    "model numbers size", """
    Pinhole|FOV|ATAN|none pinhole numbers=fx,fy,cx,cy;0
    FOV|ATAN|none field-of-view numbers=fx,fy,cx,cy,omega
    RadTan|none pinhole numbers=fx,fy,cx,cy,k1,k2,p1,p2
    EquiDistant|KannalaBrandt kannala-brandt numbers=fx,fy,cx,cy,k1,k2,k3,k4
    """,
    word="model", size="size", split=parts.dso, dump=parts.write_dso)

ZED = Form("zed", "ZED: SN.conf",
    "LEFT_CAM_HD", "< - pinhole fx fy cx cy k1 k2 p1? p2? k3? k4? k5? k6?",
    size="size", split=parts.zed, refused="poses: the signs of RX, CV and RZ are documented nowhere")

GYROFLOW = Form("gyroflow", "gyroflow's lens profiles",
    "fisheye_params.camera_matrix calib_dimension.w", f"""
    < opencv_fisheye|none kannala-brandt fisheye_params.camera_matrix={_K} .distortion_coeffs=;k1,k2,k3,k4
    < opencv_standard pinhole fisheye_params.camera_matrix={_K} .distortion_coeffs=;{PLAIN}
    """,
    word="distortion_model", size="calib_dimension.w calib_dimension.h", readout=(("frame_readout_time", 1e-3, False),),
    harmless="radialdistortionlimit|^crop$|readoutdirection", finish=parts.gyroflow,
    refused="poly3, poly5, ptlens, gopro, sony, insta360; stretches, digital lenses")
