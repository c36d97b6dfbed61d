"""OCamCalib's calib_results.txt, judged by its cam2world written from its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyval
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


def parsed(text: str) -> list[list[float]]:
    """The rows of numbers; those of polynomials without their counts."""
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    rows = [[float(word) for word in line.split()] for line in lines]
    for polynomial in rows[:2]:
        assert polynomial.pop(0) == len(polynomial)
    return rows


def cam2world(text: str, pixels: np.ndarray) -> np.ndarray:
    """Rays of pixels: theirs are rows and columns from 0, x down the rows and -z ahead."""
    pol, _, (xc, yc), (c, d, e), _ = parsed(text)
    columns, rows = pixels.T - 0.5
    x, y = np.linalg.solve([[c, d], [e, 1]], [rows - xc, columns - yc])
    rays = np.stack([y, x, -polyval(np.hypot(x, y), pol)], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


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
    pixels = camera.pixels()[::40, ::40].reshape(-1, 2)
    rays = camera.unproject(pixels)
    assert rays.valid.mean() > 0.9
    theirs = cam2world(TEXT, pixels)[rays.valid]
    np.testing.assert_allclose(rays.directions[rays.valid], theirs, rtol=0, atol=1e-14)


@cases(12)
@given(scaramuzzas)
def test_a_file_means_the_rays_of_the_camera_and_its_inverse_polynomial_their_pixels(
    camera: cameras.Camera,
) -> None:
    """Programs that only have the file use ``rho = p(atan(z / |(x, y)|))``."""
    text = calibration.dumps({"cam0": camera}, "ocamcalib")
    rays = camera.unproject()
    pixels = camera.pixels()[rays.valid]
    np.testing.assert_allclose(rays.directions[rays.valid], cam2world(text, pixels), rtol=0, atol=1e-13)
    assert_same_rays(camera, calibration.loads(text, "ocamcalib")["cam0"])
    _, invpol, (xc, yc), (c, d, e), size = parsed(text)
    assert size == [45, 80]
    y, x, minus_z = rays.directions[rays.valid].T
    across = np.hypot(x, y)
    rho = polyval(np.arctan2(-minus_z, across), invpol)
    x, y = np.stack([x, y]) / np.where(across > 0, across, 1) * rho
    theirs = np.stack([e * x + y + yc, c * x + d * y + xc], axis=-1) + 0.5
    apart = np.linalg.norm(theirs - pixels, axis=-1)
    # The fit promises 0.01 px of rho; the affine part stretches it by less than 1.4. On the axis itself,
    # where x and y give no direction, programs answer the centre without the polynomial.
    assert apart[across > 0].max() < 0.014


def test_what_a_file_cannot_hold_is_refused() -> None:
    """f(rho) / rho has its extreme at 27 px: rho is the square root of the angle there, no polynomial."""
    turning = cameras.create("scaramuzza", **SIZE, coefficients=[-20.0, 0.0, -0.027])
    with pytest.raises(ArgumentError, match=r"cam0: OCamCalib: .*no nearer than [0-9.e-]+ px"):
        calibration.dumps({"cam0": turning}, "ocamcalib")
    mirrored = cameras.create("scaramuzza", **SIZE, coefficients=[-30.0], affine=(-1, 0, 0))
    with pytest.raises(ArgumentError, match="cam0: affine: expected c > 0"):
        calibration.dumps({"cam0": mirrored}, "ocamcalib")
