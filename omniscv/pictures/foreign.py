"""Pictures that anybody may have made, read with care: what would come in otherwise is refused."""

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.pictures import MAX_PIXELS, color_tags, hdf5, npy, png
from omniscv.pictures.forms import ARRAY, FORMS, Pixels
from omniscv.storage.bounded import MOST_PICTURE_BYTES, library_error, open_regular

_IMAGES = [f".{suffix}" for suffix in FORMS if suffix != ARRAY]
SUFFIXES = (*_IMAGES, *hdf5.SUFFIXES)
"""Of the pictures that :func:`read` reads."""

_MOST_PARTS = 64  # of a file that are looked at
_JPEG = b"\xff\xd8\xff"
_END = b"\xff\xd9"
_JPEG_END = 0xD9
_JPEG_PROGRESSIVE = 0xC2
_JPEG_SCAN = 0xDA
"""Kinds of segments of a JPEG."""
_GREY = ("y", "l", "i", "luminance")
_DEPTH = ("z", "depth", "distance")
_IDS = ("indexob",)
_FINAL = ("composite.combined", "combined", "beauty", "rgba", "image")
"""Layers of colours, by the ends of their names, which others only lead to; the first one counts."""
_FORMATS = ("uint8", "uint16", "half", "float", "double")
_KEPT = ("uint8", "uint16", "uint32", "half")  # types of pixels that come as they are; others as float32
_TURNED = "an orientation in its EXIF; turn its pixels, as 'mogrify -auto-orient' does, and import it again"
_LOSSY = ("jpeg", "dwa", "b44", "pxr24", "webp", "lerc")


def environment(file: Path) -> str:
    """Return the word by which an EXR says which faces it holds, or that it is a panorama; empty without."""
    import OpenImageIO

    open_regular(file).close()
    try:
        return str(_opened(file, OpenImageIO.ImageSpec()).spec().get_string_attribute("textureformat"))
    except UnicodeDecodeError:
        return ""


class Parts(NamedTuple):
    """What an EXR holds beside its colours: kinds that :func:`read` reads, and names of other layers."""

    kinds: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


def parts_of(file: Path) -> Parts:
    """Return what a file of several layers, such as Blender's, holds beside its colours."""
    import OpenImageIO

    if file.suffix.lower() != ".exr" or not file.exists():
        return Parts()
    open_regular(file).close()
    with closing(_opened(file, OpenImageIO.ImageSpec())) as source:
        channels = _channels(_parts(source))
    layers = dict.fromkeys(channel.rpartition(".")[0] for channel in channels)
    if len(layers) < 2:
        return Parts()
    read_layers = {channels[i].rpartition(".")[0] for i in _colors(channels)}
    kinds = []
    for kind, names in (("depth", _DEPTH), ("object_mask", _IDS)):
        i = _named_layer(channels, names)
        if i is not None:
            kinds.append(kind)
            read_layers.add(channels[i].rpartition(".")[0])
    others = [layer.rpartition(".")[2] for layer in layers if layer and layer not in read_layers]
    return Parts(tuple(kinds), tuple(others))


def _channels(parts: Sequence[Any]) -> list[str]:
    """Return the names of the channels of all parts as ``LAYER.CHANNEL``; a part may be named as its
    layer."""
    channels = []
    for spec in parts:
        part = spec.get_string_attribute("oiio:subimagename")
        for name in spec.channelnames:
            channels.append(f"{part}.{name}" if len(parts) > 1 and "." not in name else name)
    return channels


def _named_layer(channels: Sequence[str], names: Sequence[str]) -> int | None:
    """Return the index of the only channel whose layer has one of some names; None for none or several."""
    matches = []
    for i, channel in enumerate(channels):
        if _layer(channel).rpartition(".")[2] in names:
            matches.append(i)
    return matches[0] if len(matches) == 1 else None


def _layer(channel: str) -> str:
    """Return the layer of a channel in lower case, empty for none."""
    return channel.lower().rpartition(".")[0]


def _parts(source: Any) -> list[Any]:
    """Return the descriptions of the parts of an open file; the frames of a WebP are none."""
    parts = [source.spec()]
    while source.format_name() != "webp" and len(parts) < _MOST_PARTS and source.seek_subimage(len(parts), 0):
        parts.append(source.spec())
    return parts


class Read(NamedTuple):
    """A picture that was read.

    Attributes:
        pixels: (H, W, 1 or 3).
        payload: the bytes of the file where it is a PNG that holds exactly these pixels, else empty.
        tags: what the file says of its colours.
        lines: what was done, for people.
    """

    pixels: Pixels
    payload: bytes = b""
    tags: color_tags.Colors = color_tags.Colors()
    lines: tuple[str, ...] = ()


def read(file: Path, kind: str = "lit") -> Read:
    """Return the pixels of a file as they are; floats are float32, or float16 where the file has those.

    Args:
        file: of a suffix of :data:`SUFFIXES`. Alpha is ignored.
        kind: ``lit``, ``depth`` or ``object_mask``: its channels are taken.

    Raises:
        ArgumentError: no regular file, damaged, too large, or not of a form that the kind can have.
    """
    suffix = file.suffix.lower()
    with open_regular(file, most=MOST_PICTURE_BYTES) as opened:
        head = opened.read(png.HEADER_BYTES)
        is_decoded_here = suffix == ".npy" or head.startswith((png.SIGNATURE, _JPEG))
        payload = head + opened.read() if is_decoded_here else b""
    lines = _check_jpeg(payload) if head.startswith(_JPEG) else ()
    tags: color_tags.Colors | None = None
    try:
        if suffix == ".npy":
            return Read(_of_array(npy.decode(payload)))
        if suffix in hdf5.SUFFIXES:
            return Read(_of_array(hdf5.read(file)))
        if head.startswith(png.SIGNATURE):
            tags = color_tags.of_png(payload)
            pixels = _plain_png(payload, kind)
            if pixels is not None:
                return Read(pixels, _kept_png(payload, kind), tags)
    except BadReplyError as cause:
        raise ArgumentError(str(cause)) from cause
    try:
        pixels, of_spec = _by_openimageio(file, kind, b"VP8 " in head)
    except UnicodeDecodeError as cause:  # of names, or of the library's own message
        raise ArgumentError("expected a picture, got one whose header is damaged: no UTF-8") from cause
    return Read(pixels, b"", of_spec if tags is None else tags, lines)


def palette_indices(file: Path) -> Pixels | None:
    """Return (H, W) uint8 the indices of a picture with a palette, which :func:`read` has read; None without
    one."""
    from PIL import Image

    if file.suffix.lower() in (".exr", ".hdr", ".npy", *hdf5.SUFFIXES):
        return None
    with open_regular(file, most=MOST_PICTURE_BYTES) as opened, Image.open(opened) as image:
        return np.array(image) if image.mode == "P" else None


def _plain_png(payload: bytes, kind: str) -> Pixels | None:
    """Return the pixels of a PNG that this package decodes; None for others, whose chunks are whole."""
    width, height, channels, bits, interlaced = png.header(payload)
    _check_size(width, height)
    if bits < 8 and channels == 1 and kind != "lit":
        raise ArgumentError(f"expected 8 or 16 bits, got {bits}, which programs scale")
    if bits < 8 or interlaced or b"eXIf" in payload:
        png.check(payload)
        return None
    return png.decode(payload, bits)[..., : 3 if channels >= 3 else 1]


def _kept_png(payload: bytes, kind: str) -> bytes:
    """Return the bytes of a PNG; none where no codec of ids or depth decodes it, as grey with alpha."""
    return b"" if kind != "lit" and png.header(payload).channels == 2 else payload


def _check_jpeg(payload: bytes) -> tuple[str, ...]:
    """Refuse a JPEG that is not whole; return what to say of bytes behind it."""
    behind = len(payload) - _end_of_jpeg(payload)
    return (f"{behind} bytes behind the picture are ignored",) if behind else ()


def _end_of_jpeg(payload: bytes) -> int:
    """Return where a JPEG ends; ArgumentError for one without its end, or a progressive one without its last
    scans.

    A scan brings some of the 64 coefficients of its components down to a bit ``low``; at last all are at 0.
    Phones append videos and further pictures.
    """
    low: dict[int, list[int]] = {}
    at = 2
    while True:
        at = payload.find(b"\xff", at)
        if at < 0 or at + 2 > len(payload):
            break
        kind = payload[at + 1]
        size = int.from_bytes(payload[at + 2 : at + 4], "big")
        if kind == _JPEG_END:
            break
        if kind in (0x00, 0x01, 0xFF) or 0xD0 <= kind <= 0xD8:  # within the data of a scan
            at += 1 if kind == 0xFF else 2
            continue
        _note_scan(low, kind, payload[at + 4 : at + 2 + size])
        at += 2 + size
    if any(map(any, low.values())):
        raise ArgumentError("expected a whole picture, got a progressive JPEG without its last scans")
    if payload[at : at + 2] != _END or at < 0:
        raise ArgumentError("expected a whole picture, got a JPEG without its end")
    return at + 2


def _note_scan(low: dict[int, list[int]], kind: int, segment: bytes) -> None:
    """Note down to which bit a scan of a progressive JPEG brings the coefficients of its components.

    Args:
        low: by component, for each of its 64 coefficients the lowest bit so far; filled by the frame's
            header.
        kind: of the segment.
        segment: its bytes behind its length.
    """
    if kind == _JPEG_PROGRESSIVE:
        low.clear()
        for component in segment[6::3]:
            low[component] = [99] * 64
    elif kind == _JPEG_SCAN and low and len(segment) == 4 + 2 * segment[0]:
        first, last, bits = segment[-3:]
        for component in low.keys() & {*segment[1:-3:2]}:
            low[component][first : last + 1] = [bits & 15] * (last + 1 - first)


def _check_size(width: int, height: int) -> None:
    """Raise ArgumentError for a picture without pixels, or with too many."""
    if not 0 < width * height <= MAX_PIXELS:
        raise ArgumentError(f"expected 1 to {MAX_PIXELS} pixels, got {width} x {height}")


def _opened(file: Path, config: Any) -> Any:
    """Return a picture opened by OpenImageIO; ArgumentError for what it cannot read."""
    import OpenImageIO

    opened = OpenImageIO.ImageInput.open(str(file), config)
    if opened is None:
        raise ArgumentError(f"expected a picture, got: {shown(library_error(OpenImageIO))}")
    return opened


def _by_openimageio(file: Path, kind: str, lossy: bool) -> tuple[Pixels, color_tags.Colors]:
    """Return the pixels of the one part, and of its channels, that the kind needs, and what its tags say."""
    import OpenImageIO

    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # colours are not multiplied by alpha
    with closing(_opened(file, config)) as source:
        if source.has_error:  # as of a progressive JPEG, which is read when it is opened
            raise ArgumentError(f"expected a whole picture, got: {shown(library_error(source))}")
        parts = _parts(source)
        name = source.format_name()
        part, channels = _part_of(parts, kind)
        spec = parts[part]
        _check_size(spec.width, spec.height)
        _check_spec(spec, name, kind, lossy)
        source.geterror()
        first = min(channels)
        stored = str(spec.channelformat(first))  # a file may have halves beside floats
        form = stored if stored in _KEPT else "float"
        pixels = source.read_image(part, 0, first, max(channels) + 1, form)
        if pixels is None or source.has_error:  # half a JPEG has pixels
            raise ArgumentError(f"expected a whole picture, got: {shown(library_error(source))}")
        chosen = _some_channels(pixels, [channel - first for channel in channels])
        if spec.get_int_attribute("tiff:PhotometricInterpretation", 1) == 0 and form == "uint16":
            chosen = 0xFFFF - chosen  # white is 0, which the library knows of 8 bits only
        return chosen, color_tags.of_spec(file, spec, name)


def _some_channels(pixels: Pixels, chosen: Sequence[int]) -> Pixels:
    """Return some channels of pixels; the pixels themselves where these are all, in their order."""
    count = len(chosen)
    if list(chosen) == list(range(count)):
        return np.ascontiguousarray(pixels[..., :count])
    return np.ascontiguousarray(pixels[..., np.array(chosen)])


def _part_of(parts: Sequence[Any], kind: str) -> tuple[int, tuple[int, ...]]:
    """Return the index of the only part that has a kind, and its channels; ArgumentError for none or
    several."""
    fitting: dict[int, tuple[int, ...]] = {}
    for find in (partial(_special, kind=kind), _colors):
        for i, spec in enumerate(parts):
            channels = find(spec.channelnames)
            if channels:
                fitting[i] = channels
        if fitting:
            break
    if len(fitting) != 1:
        names = "; ".join(", ".join(spec.channelnames[:12]) for spec in parts[:4])
        wanted = "depth in one channel, as Z" if kind == "depth" else "one part with channels R, G, B"
        raise ArgumentError(f"expected {wanted}, got {len(fitting)} among {shown(names)}")
    ((part, channels),) = fitting.items()
    return part, channels


def _special(names: Sequence[str], kind: str) -> tuple[int, ...]:
    """Return the channel that holds depth or ids only; empty for none."""
    channel: int | None = None
    if kind == "depth":
        channel = _of_depth([name.lower() for name in names])
    elif kind == "object_mask":
        channel = 0 if len(names) == 1 else _named_layer(names, _IDS)
    return () if channel is None else (channel,)


def _colors(channels: Sequence[str]) -> tuple[int, ...]:
    """Return the channels that hold colours or grey; none where there are several such, or no such."""
    names = [name.lower() for name in channels]
    layers = _layers_of_colors(names)
    if "" in layers:
        layers = [""]
    elif len(layers) > 1:
        layers = _final_layer(layers)
    if len(layers) == 1:
        return tuple(names.index(f"{layers[0]}{color}") for color in "rgb")
    is_grey = not layers and len({*names} - {"a"}) == 1 and names[0] in _GREY
    return (0,) if is_grey else ()


def _layers_of_colors(names: Sequence[str]) -> list[str]:
    """Return the layers that have channels r, g and b, as ``LAYER.``, or "" for those without a layer."""
    layers = []
    for name in names:
        layer = name.removesuffix("r")
        is_red = name == "r" or name.endswith(".r")
        if is_red and f"{layer}g" in names and f"{layer}b" in names and "crypto" not in layer:
            layers.append(layer)
    return layers


def _final_layer(layers: list[str]) -> list[str]:
    """Return the layer of several that others only lead to; all of them if none is known to be that."""
    for end in _FINAL:
        for layer in layers:
            if f".{layer}".endswith(f".{end}."):
                return [layer]
    return layers


def _of_depth(names: Sequence[str]) -> int | None:
    """Return the index of the channel of depth: that of a layer of this name, else the only one of such a
    name, or that there is; None for several."""
    by_layer = _named_layer(names, _DEPTH)
    if by_layer is not None:
        return by_layer
    by_name = [i for i, name in enumerate(names) if name.rpartition(".")[2] in _DEPTH]
    if len(by_name) == 1:
        return by_name[0]
    return 0 if len(names) == 1 else None


def _check_spec(spec: Any, name: str, kind: str, lossy: bool) -> None:
    """Raise ArgumentError for what would come in otherwise than its maker sees it."""
    window = (spec.x, spec.y, spec.width, spec.height)
    display = (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    is_cropped = name == "openexr" and window != display and not spec.get_string_attribute("textureformat")
    bits = spec.get_int_attribute("oiio:BitsPerSample", 8)
    is_ids = kind == "object_mask" and str(spec.format) == "uint32"
    is_odd = (str(spec.format) not in _FORMATS and not is_ids) or bits not in (8, 16, 32, 64)
    lossy |= name == "jpeg" or str(spec.get_string_attribute("compression")).startswith(_LOSSY)
    meaning = spec.get_int_attribute("tiff:PhotometricInterpretation", 2)
    cmyk = meaning == 5 or "CMYK" in spec.get_string_attribute("jpeg:ColorSpace")
    turned = spec.get_int_attribute("Orientation", 1)
    is_floats = str(spec.format) not in ("uint8", "uint16")
    for is_wrong, expected, found in (
        (is_cropped, f"pixels in all of the display window {display}", window),
        (cmyk, "grey or RGB", "CMYK"),
        (meaning in (8, 9, 10), "grey or RGB", "Lab"),
        (meaning == 0 and is_floats, "black at 0", "floats with white at 0"),
        (turned != 1, "an upright picture", _TURNED),
        (spec.get_int_attribute("oiio:Movie", 0), "one picture", "several frames"),
        (is_odd, "8 or 16 bits, or floats", f"{bits} bits"),
        (lossy and kind != "lit", "masks and depth without loss, as PNG", f"lossy {name}"),
    ):
        if is_wrong:
            raise ArgumentError(f"expected {expected}, got {found}")


def _of_array(array: Pixels) -> Pixels:
    """Return the array of a file as pixels."""
    is_picture = array.ndim > 1 and array.shape[2:] in ((), (1,), (3,), (4,))
    if array.dtype.kind not in "iuf" or not is_picture:
        raise ArgumentError(f"expected numbers (H, W) or (H, W, 3), got {array.dtype} of shape {array.shape}")
    _check_size(array.shape[1], array.shape[0])
    pixels = array.reshape(*array.shape[:2], -1)[..., :3]
    pixels = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("="))
    with np.errstate(over="ignore"):  # 1e300 becomes infinite, and is counted
        return pixels.astype(np.float32) if array.dtype == np.float64 else pixels
