"""How an image is captured and composed, and the options of truths that are keys of jobs; light to import."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Literal, NamedTuple, TypedDict, get_args

from omniscv.arguments import flag, number, numbers, one_of, optional_number, text, texts, whole_number, wrong
from omniscv.errors import ArgumentError
from omniscv.records import checked, optional, record, word

Filter = Literal["auto", "nearest", "bilinear", "bicubic", "area"]
FILTERS: tuple[str, ...] = get_args(Filter)
Normals = Literal["captured", "from-depth"]
Seams = Literal["keep", "gains", "close"]
Checks = Literal["none", "light", "beat"]
Unseen = Literal["refuse", "blank"]
FINEST_TRUTH = 8  # times the size of colours
COMPARED = ("depth", "object_mask")
"""Modes that ``checks: beat`` captures once more."""
PRICE = (5.0, 25.0)
"""Of :class:`Price`, unless it was measured."""
COLOR_RAYS = (0, 1, 4, 9, 16)
"""Rays of a pixel that its colour may be the mean of; 0: it is captured."""
MEAN_RAYS = 4
"""The same, of ``auto``, where captures are the worse way."""
LARGEST_FACE_PX = 8192
MOST_VIEWPOINTS = 1_000_000
"""As an image has columns, at most."""

LayoutSource = Literal["scene", "fitted"]
layout_source = partial(one_of, words=get_args(LayoutSource))


class Price(NamedTuple):
    """What captures cost a source, ms.

    Attributes:
        request: of every request.
        megapixel: of every megapixel.
    """

    request: float
    megapixel: float

    def of(self, requests: Any, pixels: Any) -> Any:
        """Return the ms of requests and of all their pixels."""
        return self.request * requests + self.megapixel * 1e-6 * pixels


def _face_size(name: str, value: object) -> Any:
    """Return ``auto``, or a number of pixels."""
    if value == "auto" or (type(value) is int and 1 <= value <= LARGEST_FACE_PX):
        return value
    raise wrong(name, f"'auto' or 1 to {LARGEST_FACE_PX} px", value)


def _color_rays(name: str, value: object) -> Any:
    """Return ``auto``, or how many rays a pixel's colour is the mean of."""
    if value == "auto" or (type(value) is int and value in COLOR_RAYS):
        return value
    raise wrong(name, f"'auto' or one of {', '.join(map(str, COLOR_RAYS))}", value)


def _accuracy(name: str, value: object) -> float | None:
    """Return a share of the pixels, which may be given in percent; None for None."""
    if value is None:
        return None
    share = value
    whole = 1
    if isinstance(value, str):
        share = value.strip().removesuffix("%")
        whole = 100 if value.strip().endswith("%") else 1
    try:
        return number(name, share, above=0, below=whole) / whole
    except ArgumentError:
        raise wrong(name, "a share of the pixels, such as 0.1% or 0.001", value) from None


def _names(name: str, value: object) -> tuple[str, ...]:
    """Return names of objects; none of what is empty."""
    return texts(name, value) if value else ()


def _price(name: str, value: object) -> tuple[float, float]:
    """Return ms of a request and of a megapixel, neither negative."""
    request, megapixel = numbers(name, value, (2,)).tolist()
    return number(f"{name}[0]", request, least=0), number(f"{name}[1]", megapixel, least=0)


@record
class RenderOptions:
    """How an image is captured and composed.

    ``filter`` is of blended modalities: ``area`` averages what a pixel spans, and ``auto`` takes it where
    most pixels span two of a view's or more, else ``bilinear``. ``accuracy`` makes captures finer where the
    image needs it; if it is not given, ``auto`` aims at 3 % for cameras with several optical centres.
    """

    strategy: str = checked(text, default="auto", help="which views are captured: auto, exact or cube")
    viewpoints: int | None = checked(
        optional(partial(whole_number, most=MOST_VIEWPOINTS)),
        default=None,
        help="optical centres of a non-central camera; null: the strategy's choice",
    )
    face_size: int | Literal["auto"] = checked(
        _face_size, default="auto", help="px of a 90 degree face, or auto"
    )
    filter: Filter = word(Filter, default="auto", help="auto, nearest, bilinear, bicubic or area")
    truth_scale: int = checked(
        whole_number,
        default=1,
        most=FINEST_TRUTH,
        help="how many times finer masks, depth and normals are captured, 1 to 8",
    )
    normals: Normals = word(
        Normals, default="captured", help="captured, or from-depth: of planes fitted to depth"
    )
    color_rays: int | Literal["auto"] = checked(
        _color_rays,
        default="auto",
        help="rays of a pixel that colours are the mean of: 1, 4, 9, 16; 0: captures; or auto: 4 for cameras "
        "with several optical centres, of a source that shades rays",
    )

    seams: Seams = word(
        Seams,
        default="keep",
        help="keep, gains (of exposure, where proven) or close, where faces differ at their edges",
    )
    straighten: bool = checked(
        flag,
        default=False,
        help="resample faces of a recording that are measurably turned against the others",
    )
    checks: Checks = word(
        Checks,
        default="none",
        help="none; light: mark what light makes doubtful, in the layer light; or beat: capture depth and "
        "masks in a second size, and mark structures that one size hides",
    )
    unseen: Unseen = word(
        Unseen,
        default="refuse",
        help="refuse an image with rays that no recorded view sees, or blank: make their pixels invalid",
    )
    sky: tuple[str, ...] = checked(_names, default=(), help="objects that stand for the sky")
    accuracy: float | None = checked(
        _accuracy, default=None, help="share of the valid pixels that may be doubtful, such as 0.1%"
    )
    most_captures: int | None = checked(
        optional(whole_number), default=None, help="captures of an image at which accuracy stops"
    )
    most_megapixels: float | None = checked(
        optional_number, default=None, above=0, help="captured megapixels at which accuracy stops"
    )
    capture_ms: tuple[float, float] = checked(
        _price,
        default=PRICE,
        help="ms that the source takes for a request and for a megapixel, as plan --measure finds them",
    )

    def sampled(self, modes: Sequence[str]) -> tuple[str, ...]:
        """Return the modalities that are sampled for those that an image shows: normals may come from
        depth.

        Raises:
            ArgumentError: ``checks`` compares modes that are not among them, or masks, which show the
                objects of ``sky``, are not among them though other ground truth is.
        """
        if self.checks == "beat" and not set(COMPARED) & set(modes):
            raise ArgumentError(f"checks: beat expects depth or object_mask in modes, got {', '.join(modes)}")
        shows_surfaces = bool({"depth", "normals"} & set(modes))
        if self.sky and shows_surfaces and "object_mask" not in modes:
            expected = "expected object_mask in modes, which shows where these objects are"
            raise ArgumentError(f"sky: {expected}, got {', '.join(modes)}")
        other = {"normals": "normals_from_depth"} if self.normals == "from-depth" else {}
        return tuple(other.get(mode, mode) for mode in modes)


class RenderKeywords(TypedDict, total=False):
    """The options of :class:`RenderOptions` as keyword arguments."""

    strategy: str
    viewpoints: int | None
    face_size: int | Literal["auto"]
    filter: Filter
    truth_scale: int
    normals: Normals
    color_rays: int | Literal["auto"]
    seams: Seams
    straighten: bool
    checks: Checks
    unseen: Unseen
    sky: tuple[str, ...]
    accuracy: Any  # a number, or a text such as "0.1%"
    most_captures: int | None
    most_megapixels: float | None
    capture_ms: tuple[float, float]


@record
class Tolerance:
    """How far two depths along a ray may differ and still be taken for one; the larger of both limits counts.

    It is the key ``tolerance`` under a job's ``truth:``.
    """

    abs_m: float = checked(number, least=0, default=0.02, help="metres within which depths are equal")
    rel: float = checked(number, least=0, default=0.01, help="the same, as a share of the depth")
