"""Projects of Hugin and PTGui, ``.pto``: panotools' lenses, which are read only; and OCamCalib.

OCamCalib's ``calib_results.txt``: Scaramuzza's polynomial, its inverse, centre, affine part, size.

Half pixel: the centre is written "starting from 0 (C convention)", so pixel centres are at whole
numbers and its centre is ours minus 0.5. (In MATLAB ``xc``, ``yc`` start from 1: subtract 1 more.)

Rows come first: x runs down the rows, y along the columns, and z **against** the view (``f(0) = a0 < 0``)::

    OCamCalib   row = xc + c x + d y              ours   u = u_0 + c' u'' + d' v''
                column = yc + e x + y                    v = v_0 + e' u'' + v''
                ray (x, y, f(rho))                       ray (u'', v'', -f(rho))

The camera frames are half a turn apart: (our x, our y, our z) = (y, x, -z). OCamCalib's affine part does not
scale columns, and ours does not scale rows, so ``(c', d', e') = (1, e, d) / c``; the rays stay the same if
``a_k' = a_k c^(1-k)``. The same two formulas lead back.

The inverse polynomial is ignored in reading, and fitted in writing to within 0.01 px, as OCamCalib does.
"""

import re
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval

from omniscv.arguments import number, numbers, shown, wrong
from omniscv.calibration.documents import Content, put_once
from omniscv.calibration.forms import Form, Layout, LensNumbers, Reading, Writing
from omniscv.calibration.keys import Model, array, scalar
from omniscv.calibration.nodes import Node, Values, whole
from omniscv.cameras.base import Array
from omniscv.errors import ArgumentError

_IMAGE = re.compile(r"([A-Za-z]+)(\S*)")
_CORRECTIONS = set("abcdegt")
"""Keys of radial terms, shift and shear, of which an image has all or none."""


def _images(content: Content) -> dict[str, Any]:
    """Return the lenses of a project's images, each once; ``v=0`` is the value of image 0."""
    images: list[dict[str, str]] = []
    if not re.search(r"^p .*\bf\d", content.text, re.MULTILINE):
        return {}
    for line in content.text.split("\n"):
        if line.startswith(("i ", "o ")):
            images.append(_image(line, images))
    cameras: dict[str, Any] = {}
    for image in images:
        lens: Values = {key: number(key, image.get(key, 0)) for key in "whvabcdegt"}
        lens["f"] = image.get("f", "0")
        if lens not in cameras.values():
            cameras[f"cam{len(cameras)}"] = lens
    return cameras


def _image(line: str, images: list[dict[str, str]]) -> dict[str, str]:
    """Return the words of an image's line by key; ``images`` are those of the lines before it."""
    words: dict[str, str] = {}
    for key, value in _IMAGE.findall(line.partition(' n"')[0][2:]):
        put_once(words, key, value)
    if words.keys() & _CORRECTIONS not in (set(), _CORRECTIONS):
        raise ArgumentError(f"expected all of a, b, c, d, e, g, t or none, got {shown(line)}")
    for key, value in words.items():
        if value.startswith("="):
            words[key] = _value_of(images, value[1:], key)
    return words


def _value_of(images: list[dict[str, str]], index: str, key: str) -> str:
    """Return the value of an image by its index; ``nan``, which is refused, if there is no such image."""
    for i, image in enumerate(images):
        if str(i) == index:
            return image.get(key, "0")
    return "nan"


def _numbers(node: Node, lens: LensNumbers) -> LensNumbers:
    """Return the numbers of panotools' ``r' = r (a r^3 + b r^2 + c r + 1 - a - b - c)``.

    r is 1 at half the shorter side; it is ``tan`` of the angle off the axis (0), or the angle itself (2, 3).

    Args:
        node: the image's values.
        lens: its shift from the middle, ``du`` and ``dv``, and the word for its projection.
    """
    a, b, c, g, t, v = (number(key, node.take(key, 0)) for key in "abcgtv")
    if g or t:
        raise ArgumentError(f"g, t: expected no shear (it is not modelled), got {g:.15g} and {t:.15g}")
    width = lens.width
    half_px = min(width, lens.height) / 2
    angle = np.radians(number("v", v, above=0, most=360))
    first = 1 - a - b - c
    numbers = dict(lens.values)
    if lens.word == "0":
        if a or c:
            raise wrong("a, c", "0 (odd powers of f0 are not modelled)", [a, c])
        focal = width / 2 / np.tan(number("v", v, below=180) * np.pi / 360)
        numbers["fx"] = focal * first
        numbers["fy"] = focal * first
        numbers["k1"] = b / first * (focal / half_px) ** 2
        return lens._replace(values=numbers)
    if lens.word == "4":
        is_centred = not numbers["du"] and not numbers["dv"]
        is_full = abs(v - 360) <= 1e-9 and width == 2 * lens.height
        if a or b or c or not is_centred or not is_full:
            raise ArgumentError("f4: expected a full panorama, 2:1, without a, b, c, d, e; got another")
        return lens._replace(values={})
    scale = width / angle / half_px  # of an angle to r
    for power, term in enumerate((first, c, b, a), start=1):
        numbers[f"c{power}"] = float(half_px * term * scale**power)
    return lens._replace(values=numbers)


_SHIFT = (scalar("d", "du"), scalar("e", "dv"))
HUGIN = Form(
    "hugin",
    "Hugin, PTGui, panotools: .pto",
    marks=("p-lines", "i-lines"),
    layout=Layout(
        models=(
            Model("pinhole", _SHIFT, words=("0",), read_only=True),
            Model("ftheta", _SHIFT, words=("2", "3"), read_only=True),
            Model("equirectangular", _SHIFT, words=("4",), read_only=True),
        ),
        word=("f",),
        size=("w", "h"),
        shift_px=0.0,
    ),
    reading=Reading(split=_images, finish=_numbers),
    refused="other projections, shear, odd powers of rectilinear lenses; read only",
)


_INVERSE_ERROR_PX = 0.01  # of the inverse polynomial, at most


def _read(content: Content) -> dict[str, Values]:
    """Return the numbers of a ``calib_results.txt``, columns first."""
    if not re.search(r"^#[ \t]*polynomial coefficients", content.text, re.MULTILINE):
        return {}
    words: list[str] = []
    for line in content.text.splitlines():
        words += line.partition("#")[0].split()
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
    text = ""
    for title, values in sections.items():
        # The blank lines are OCamCalib's: many readers count lines.
        text += f"#{title}\n\n{' '.join(map(str, values))}\n\n"
    return text


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
    rho = rho[rising]
    angle = angle[rising]
    error = np.inf
    for degree in range(3, 33):
        inverse = Polynomial.fit(angle, rho, degree).convert().coef
        error = min(error, float(np.abs(polyval(angle, inverse) - rho).max()))
        if error <= _INVERSE_ERROR_PX:
            return np.asarray(inverse, dtype=np.float64)
    wanted = f"expected a polynomial whose inverse is one within {_INVERSE_ERROR_PX} px"
    raise ArgumentError(f"OCamCalib: {wanted}, got no nearer than {error:.3g} px")


OCAMCALIB = Form(
    "ocamcalib",
    "OCamCalib: calib_results.txt",
    marks=("polynomial", "coefficients"),
    layout=Layout(
        models=(
            Model(
                "scaramuzza",
                keys=(
                    array(
                        "polynomial",
                        *("a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7", "a8", "a9"),
                        *("a10", "a11", "a12", "a13", "a14", "a15", "a16", "a17", "a18", "a19"),
                        counts=tuple(range(1, 21)),
                    ),
                    array("affine", "c", "d", "e"),
                    array("center", "cx", "cy"),
                ),
            ),
        ),
        size=("width", "height"),
    ),
    reading=Reading(split=_read),
    writing=Writing(dump=_write),
    refused="an affine part that mirrors",
)
