"""Hugin's and PTGui's projects, ``.pto``: panotools' lenses, which are read only."""

import re
from typing import Any

import numpy as np

from omniscv.arguments import number, shown
from omniscv.calibration.documents import Content, put_once
from omniscv.calibration.forms import Form
from omniscv.calibration.nodes import Node, Values
from omniscv.calibration.parts import Sized
from omniscv.cameras.lens_parameters import Numbers
from omniscv.errors import ArgumentError

_IMAGE = re.compile(r"([A-Za-z]+)(\S*)")


def _images(content: Content) -> dict[str, Any]:
    """Return the images of a project; ``v=0`` is the value of image 0."""
    images: list[dict[str, str]] = []
    if not re.search(r"^p .*\bf\d", content.text, re.MULTILINE):
        return {}
    for line in content.text.split("\n"):
        if line.startswith(("i ", "o ")):
            words: dict[str, str] = {}
            for key, value in _IMAGE.findall(line.partition(' n"')[0][2:]):
                put_once(words, key, value)
            if len(words.keys() & set("abcdegt")) not in (0, 7):
                raise ArgumentError(f"expected all of a, b, c, d, e, g, t or none, got {shown(line)}")
            for key, value in words.items():
                if value.startswith("="):
                    known = {str(i): image for i, image in enumerate(images)}.get(value[1:], {key: "nan"})
                    words[key] = known.get(key, "0")
            images.append(words)
    cameras: dict[str, Any] = {}
    for image in images:
        lens: Values = {key: number(key, image.get(key, 0)) for key in "whvabcdegt"}
        lens["f"] = image.get("f", "0")
        if lens not in cameras.values():
            cameras[f"cam{len(cameras)}"] = lens
    return cameras


def _numbers(node: Node, word: str, values: Numbers, width: int, height: int) -> Sized:
    """Panotools: ``r (a r^3 + b r^2 + c r + 1 - a - b - c)``, r = 1 at half the shorter side."""
    a, b, c, g, t, v = (number(key, node.take(key, 0)) for key in "abcgtv")
    if g or t:
        raise ArgumentError(f"g, t: expected no shear (it is not modelled), got {g:.15g} and {t:.15g}")
    unit, angle = min(width, height) / 2, np.radians(number("v", v, above=0, most=360))
    first = 1 - a - b - c
    if word == "0":
        if a or c:
            got = f"{a:.15g} and {c:.15g}"
            raise ArgumentError(f"a, c: expected 0 (odd powers of f0 are not modelled), got {got}")
        focal = width / 2 / np.tan(number("v", v, below=180) * np.pi / 360)
        own = {"fx": focal * first, "fy": focal * first, "k1": b / first * (focal / unit) ** 2}
    elif word == "4":
        if a or b or c or abs(v - 360) > 1e-9 or width != 2 * height or values["du"] or values["dv"]:
            raise ArgumentError(
                "f4: expected a full panorama of 360 degrees, 2:1, without a, b, c, d, e, got another"
            )
        return {}, (width, height)
    else:
        scale = width / angle / unit  # of an angle to r
        own = {f"c{i}": float(unit * term * scale**i) for i, term in enumerate((first, c, b, a), 1)}
    return values | own, (width, height)


HUGIN = Form(
    "hugin",
    "Hugin, PTGui, panotools: .pto",
    "p-lines i-lines",
    """
    < 0 pinhole d=du e=dv
    < 2|3 ftheta d=du e=dv
    < 4 equirectangular d=du e=dv
    """,
    word="f",
    size="w h",
    shift=0.0,
    split=_images,
    finish=_numbers,
    refused="other projections, shear, odd powers of rectilinear lenses; read only",
)
