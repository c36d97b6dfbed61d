"""OCamCalib's ``calib_results.txt``: Scaramuzza's polynomial, its inverse, centre, affine part, size.

Half pixel: the centre is written "starting from 0 (C convention)", so pixel centres are at whole
numbers and its centre is ours minus 0.5. (In MATLAB ``xc``, ``yc`` start from 1: subtract 1 more.)

Rows come first: x runs down the rows, y along the columns, and z **against** the view (``f(0) = a0 < 0``)::

    OCamCalib   row = xc + c x + d y              ours   u = u_0 + c' u'' + d' v''
                column = yc + e x + y                    v = v_0 + e' u'' + v''
                ray (x, y, f(rho))                       ray (u'', v'', -f(rho))

The camera frames are half a turn apart: (our x, our y, our z) = (y, x, -z). OCamCalib's affine part does not
scale columns, and ours does not scale rows, so ``(c', d', e') = (1, e, d) / c``; the rays stay the same if
``a_k' = a_k c^(1-k)``. The same two formulas lead back.

Not carried: an affine part that mirrors (c <= 0). The inverse polynomial is an approximation: it is ignored
in reading, and fitted in writing to within 0.01 px, as OCamCalib does.
"""

import re

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

from omniscv.arguments import numbers, shown
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import Form
from omniscv.calibration.nodes import Values, whole
from omniscv.cameras import Scaramuzza
from omniscv.cameras.base import Array
from omniscv.errors import ArgumentError

_INVERSE_ERROR_PX = 0.01


def _read(content: Content) -> dict[str, Values]:
    """Return the numbers of a ``calib_results.txt``, columns first."""
    if not re.search(r"^#[ \t]*polynomial coefficients", content.text, re.MULTILINE):
        return {}
    words = [word for line in content.text.splitlines() for word in line.partition("#")[0].split()]
    polynomial, words = _counted("polynomial", words)
    _, words = _counted("inverse polynomial", words)
    row, column = numbers("center, row and column", words[:2], (2,)).tolist()
    affine = numbers("affine parameters c, d, e", words[2:5], (3,))
    if len(words) != 7:
        raise ArgumentError(f"image size: expected height and width at the end, got {shown(words[5:])}")
    coefficients, affine = _exchange_axes(polynomial, affine)
    lens = {"polynomial": coefficients.tolist(), "affine": affine.tolist(), "center": [column, row]}
    return {"cam0": lens | {"width": words[6], "height": words[5]}}


def _write(lens: Values) -> str:
    """Return the text of numbers that are columns first."""
    polynomial, affine = _exchange_axes(np.array(lens["polynomial"]), np.array(lens["affine"]))
    column, row = lens["center"]
    inverse = _inverse(polynomial, affine, (row, column), (lens["height"], lens["width"]))
    sections = {
        "polynomial coefficients for the DIRECT mapping function (cam2world)": [len(polynomial), *polynomial],
        "polynomial coefficients for the inverse mapping function (world2cam)": [len(inverse), *inverse],
        'center: "row" and "column", starting from 0 (C convention)': [row, column],
        'affine parameters "c", "d", "e"': [*affine],
        'image size: "height" and "width"': [lens["height"], lens["width"]],
    }
    # The blank lines are OCamCalib's: many readers count lines.
    return "".join(
        f"#{title}\n\n{' '.join(str(value) for value in values)}\n\n" for title, values in sections.items()
    )


def _counted(key: str, words: list[str]) -> tuple[Array, list[str]]:
    """Return the numbers that follow their count, and the rest of the words."""
    count = whole(f"number of coefficients of the {key}", words[0] if words else None)
    return numbers(key, words[1 : count + 1], (count,)), words[count + 1 :]


def _exchange_axes(coefficients: Array, affine: Array) -> tuple[Array, Array]:
    """Return coefficients and affine part with rows and columns exchanged."""
    c, d, e = affine
    if not c > 0:
        raise ArgumentError(f"affine: expected c > 0, which does not mirror the image, got c = {c:.15g}")
    with np.errstate(over="ignore", invalid="ignore"):  # cameras refuse what is not finite
        powers = c ** (1.0 - np.arange(len(coefficients)))
        return coefficients * powers, np.array([1.0, e, d]) / c


def _inverse(polynomial: Array, affine: Array, center: tuple[float, float], size: tuple[int, int]) -> Array:
    """Return the polynomial of rho by the angle ``atan(z / |(x, y)|)``, least degree first; rows first."""
    c, d, e = affine
    corners = np.array([[0, 0], [0, size[1]], [size[0], 0], [*size]]) - 0.5 - np.array(center)
    farthest = np.hypot(*np.linalg.solve(np.array([[c, d], [e, 1.0]]), corners.T)).max()
    rho = np.linspace(0, farthest, 500)
    angle = np.arctan2(polyval(rho, polynomial), rho)
    # Beyond its maximum the angle repeats rays of other pixels.
    rising = np.logical_and.accumulate(np.diff(angle, prepend=-np.inf) > 0)
    rho, angle = rho[rising], angle[rising]
    error = np.inf
    for degree in range(3, 33):
        inverse = Polynomial.fit(angle, rho, degree).convert().coef
        error = min(error, float(np.abs(polyval(angle, inverse) - rho).max()))
        if error <= _INVERSE_ERROR_PX:
            return np.asarray(inverse, dtype=np.float64)
    raise ArgumentError(
        f"OCamCalib: expected a polynomial whose inverse is one within {_INVERSE_ERROR_PX} px, "
        f"got no nearer than {error:.3g} px"
    )


OCAMCALIB = Form(
    "ocamcalib",
    "OCamCalib: calib_results.txt",
    "polynomial coefficients",
    f"- scaramuzza polynomial={';'.join(Scaramuzza.lens.distortion[0].names)} affine=c,d,e center=cx,cy",
    size="width height",
    split=_read,
    dump=_write,
    refused="an affine part that mirrors",
)
