"""Cameras that the formats of calibration files carry, and their texts."""

from omniscv import calibration, cameras

SIZE = {"width": 40, "height": 30}
BENDS = [0.1, -0.02, 0.0, 1e-5]
LENS = cameras.create("kannala-brandt", **SIZE, fx=15.0, fy=15.5, cx=20.25, cy=14.0, k=BENDS)
BENT = cameras.create("scaramuzza", **SIZE, coefficients=[-15.0, 0.0, 0.01], affine=(1.01, 0.001, -0.002))
PINHOLE = cameras.create("pinhole", **SIZE, focal=25.0, center=(19, 16))
SPHERE = cameras.create("equirectangular", **SIZE)
OMNI = cameras.create("unified", **SIZE, fx=200.0, fy=201.0, xi=0.9)
MIRROR = cameras.create("catadioptric-parabolic", **SIZE, semi_latus_rectum=0.1, focal=200.0)

DISTORTED = cameras.create(
    "pinhole", **SIZE, fx=25.0, fy=26.0, cx=19.5, cy=15.0, distortion=(-0.2, 0.03, 1e-3, -2e-3, 0.01)
)
MEI = cameras.create("unified", **SIZE, fx=20.0, fy=21.0, xi=1.1, distortion=(0.01, 0, 1e-3, 0), skew=0.01)
DOUBLE = cameras.create("double-sphere", **SIZE, fx=15.0, fy=16.0, xi=-0.2, alpha=0.6)
ELLIPSOID = cameras.create("extended-unified", **SIZE, fx=15.0, fy=16.0, alpha=0.6, beta=1.1)
ARIA = cameras.create(
    "fisheye624", width=640, height=480, fx=240.0, fy=240.0, k=(0.01, -2e-3, 0, 0, 0, 0), p=(1e-4, 2e-4)
)
THETA = cameras.create(
    "ftheta", **SIZE, polynomial=(0, 0.05, 0, 1e-6, 0), reference="pixel-to-angle", max_angle_deg=95
)

SAVED = {
    "json": {"cam0": MIRROR},
    "opencv": {"cam0": DISTORTED},
    "opencv-fisheye": {"cam0": LENS},
    "opencv-omnidir": {"cam0": MEI},
    "kalibr": {"cam0": LENS, "cam1": PINHOLE, "cam2": OMNI, "cam3": DOUBLE, "cam4": ELLIPSOID},
    "colmap": {"1": LENS, "5": PINHOLE, "6": SPHERE, "7": DISTORTED, "8": ELLIPSOID},
    "ocamcalib": {"cam0": BENT},
    "aria": {"camera-slam-left": ARIA},
    "isaac": {"front": LENS, "rear": PINHOLE, "roof": THETA},
    "ncore": {"cam0": THETA},
}

TEXTS = {name: calibration.dumps(saved, name) for name, saved in SAVED.items()}
