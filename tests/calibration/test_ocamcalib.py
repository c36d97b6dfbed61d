"""OCamCalib's calib_results.txt, judged by its world2cam and cam2world written from their definitions."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp, mpf
from support.cases import cases
from support.same_rays import assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 80, "height": 45}
# A file as OCamCalib lays it out, with a made-up camera of about 190 degrees.
TEXT = """#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB).

5 -2.100000e+02 0.000000e+00 2.100000e-03 -4.500000e-06 1.800000e-08

#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB).

3 294.0 152.0 -12.0

#center: "row" and "column", starting from 0 (C convention)

241.250000 394.750000

#affine parameters "c", "d", "e"

1.010000 0.002000 -0.003000

#image size: "height" and "width"

480 752

"""


class Ocam(NamedTuple):
    """The numbers of a file, as its header names them."""

    pol: list[float]
    invpol: list[float]
    xc: float
    yc: float
    c: float
    d: float
    e: float
    height: int
    width: int


def parsed(text: str) -> Ocam:
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    (_, *pol), (_, *invpol), center, affine, size = rows
    assert (int(rows[0][0]), int(rows[1][0])) == (len(pol), len(invpol))
    floats = [float(word) for word in center + affine]
    return Ocam(list(map(float, pol)), list(map(float, invpol)), *floats, *map(int, size))


def world2cam(model: Ocam, x: float, y: float, z: float) -> list[float]:
    """Row and column of the point (x, y, z), x down the rows; f(rho) / rho = z / |(x, y)| by bisection."""
    with mp.workdps(30):
        across = mp.hypot(mpf(x), mpf(y))
        if across == 0:
            return [model.xc, model.yc]

        def too_far(rho: Any) -> bool:
            f = sum(mpf(a) * rho**k for k, a in enumerate(model.pol))
            return bool(f * across > mpf(z) * rho)

        low, high = mpf(0), mpf(2 * (model.width + model.height))
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (low, middle) if too_far(middle) else (middle, high)
        x_, y_ = low * x / across, low * y / across
        return [float(model.c * x_ + model.d * y_ + model.xc), float(model.e * x_ + y_ + model.yc)]


def assert_ocam_sees_our_pixels(model: Ocam, camera: cameras.Camera) -> None:
    rays = camera.unproject()
    step = max(1, np.count_nonzero(rays.valid) // 12)
    pixels, directions = camera.pixels()[rays.valid][::step], rays.directions[rays.valid][::step]
    rows_columns = [world2cam(model, y, x, -z) for x, y, z in directions.tolist()]
    # Directions are right to a few 1e-16, and rho / theta stays below 1e4 px.
    np.testing.assert_allclose(np.array(rows_columns)[:, ::-1], pixels - 0.5, rtol=0, atol=1e-9)


scaramuzzas = st.builds(
    lambda focal, bend, c, d, e, u, v: cameras.create(
        "scaramuzza",
        **SIZE,
        # a2 and a4 above 0: the ray turns on as rho grows, nowhere back.
        coefficients=[-focal, 0.0, bend / focal, 0.0, 0.1 * bend / focal**3],
        affine=(c, d, e),
        center=(u, v),
    ),
    *(st.floats(15, 300), st.floats(0, 0.6), st.floats(0.8, 1.25), st.floats(-0.05, 0.05)),
    *(st.floats(-0.05, 0.05), st.floats(20, 60), st.floats(10, 35)),
)


def test_a_file_is_read_rows_first() -> None:
    camera = calibration.loads(TEXT, "ocamcalib")["cam0"]
    assert (camera.width, camera.height, camera.center.tolist()) == (752, 480, [395.25, 241.75])
    assert_ocam_sees_our_pixels(parsed(TEXT), camera)
    # Down is +x there and +y here; ahead is -z there and +z here.
    (below, right), valid = camera.project([[0, 1, 5], [1, 0, 5]])
    assert valid.all()
    assert below[1] > camera.center[1] + 30
    assert right[0] > camera.center[0] + 30


@cases(6)  # bisection in mpmath is slow
@given(scaramuzzas)
def test_a_file_means_the_rays_of_the_camera(camera: cameras.Camera) -> None:
    text = calibration.dumps({"cam0": camera}, "ocamcalib")
    model = parsed(text)
    assert (model.width, model.height) == (80, 45)
    assert_ocam_sees_our_pixels(model, camera)
    assert_same_rays(camera, calibration.loads(text, "ocamcalib")["cam0"])


@cases(12)
@given(scaramuzzas)
def test_the_inverse_polynomial_finds_the_pixel(camera: cameras.Camera) -> None:
    """What programs use that only have the file: ``rho = p(atan(z / |(x, y)|))``."""
    model = parsed(calibration.dumps({"cam0": camera}, "ocamcalib"))
    rays = camera.unproject()
    pixels = camera.pixels()[rays.valid]
    y, x, minus_z = rays.directions[rays.valid].T
    across = np.hypot(x, y)
    rho = np.polynomial.polynomial.polyval(np.arctan2(-minus_z, across), model.invpol)
    x_image, y_image = np.stack([x, y]) / np.where(across > 0, across, 1) * rho
    rows = model.c * x_image + model.d * y_image + model.xc
    columns = model.e * x_image + y_image + model.yc
    apart = np.hypot(columns - (pixels[:, 0] - 0.5), rows - (pixels[:, 1] - 0.5))
    # The fit promises 0.01 px of rho; the affine part stretches it by less than 1.4. On the axis itself,
    # where x and y give no direction, programs answer the centre without the polynomial.
    assert apart[across > 0].max() < 0.014


def test_a_polynomial_that_turns_back_is_written_up_to_there_or_refused() -> None:
    """f(rho) / rho has its extreme at 27 px: rho is the square root of the angle there, no polynomial."""
    camera = cameras.create("scaramuzza", **SIZE, coefficients=[-20.0, 0.0, -0.027])
    with pytest.raises(ArgumentError, match=r"cam0: OCamCalib: .*no nearer than [0-9.e-]+ px"):
        calibration.dumps({"cam0": camera}, "ocamcalib")


def test_an_affine_part_that_mirrors_is_refused() -> None:
    camera = cameras.create("scaramuzza", **SIZE, coefficients=[-30.0], affine=(-1, 0, 0))
    with pytest.raises(ArgumentError, match="cam0: affine: expected c > 0"):
        calibration.dumps({"cam0": camera}, "ocamcalib")
