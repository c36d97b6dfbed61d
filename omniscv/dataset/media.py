"""Videos of a dataset's frames, to look at, and metadata that makes viewers show panoramas as spheres.

Pictures get GPano fields, https://developers.google.com/streetview/spherical-metadata, videos the boxes of
Spherical Video V2, https://github.com/google/spatial-media. Pixels stay as they are.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence
from fractions import Fraction
from html import escape
from io import BytesIO
from pathlib import Path

from omniscv import storage
from omniscv.arguments import number
from omniscv.cameras import Camera
from omniscv.compose.pictures import uint8_colors
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.progress import Steps, counted

PICTURE_SUFFIXES = ("png", "jpg")
"""Of the files that can hold the metadata."""

_NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_END = 8 + 25  # the signature, and IHDR
_JPEG_START = b"\xff\xd8"
_JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_JPEG_JFIF = b"\xff\xe0"

_RATE_FACTOR = "18"  # of H.264: 0 is lossless, 51 worst
_BT709 = 1
"""Matrix, primaries and transfer in H.264: what players take for large pictures that say nothing."""
BT601 = 5
"""Matrix of BT.601 in H.264: what readers of frames take that do not look at the tags."""
_LIMITED = 1
_FULL = 2
"""Ranges of codes in H.264: of luma 16 to 235, or 0 to 255."""
_MONO = 0
_TO_ENTRY = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd")
"""The boxes around the sample entry of a track, outermost first."""
_BOX_HEADER = 8
_LIST_HEADER = 16


def refuses(camera: Camera) -> str | None:
    """Return why a camera's pictures cannot be spheres, in one line; None where they can."""
    if camera.name != "equirectangular":
        return f"Photo Sphere metadata: expected an equirectangular camera, got {camera.name}"
    return None


def photo_sphere_fields(camera: Camera, pose: Pose, north_deg: float = 0.0) -> dict[str, str]:
    """Return the GPano fields of a picture.

    Args:
        camera: equirectangular.
        pose: of the camera, world frame.
        north_deg: the compass heading of the world's X axis, degrees clockwise from north.
    """
    yaw, pitch, roll = pose.angles()
    width = str(camera.width)
    height = str(camera.height)
    return {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaLeftPixels": "0",
        "CroppedAreaTopPixels": "0",
        "PoseHeadingDegrees": _degrees((number("north_deg", north_deg) - yaw) % 360),
        "PosePitchDegrees": _degrees(pitch),
        "PoseRollDegrees": _degrees(roll),
    }


def with_photo_sphere(picture: bytes, fields: Mapping[str, str]) -> bytes:
    """Return a file with the pixels of ``picture``, and an XMP packet that holds GPano ``fields``.

    ``picture`` is the content of a PNG or JPEG file without such a packet.
    """
    attributes = []
    for name, value in fields.items():
        attributes.append(f'GPano:{name}="{escape(value)}"')
    written = " ".join(attributes)
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:GPano="{_NAMESPACE}" {written}/></rdf:RDF></x:xmpmeta>'
    ).encode()
    if picture.startswith(_PNG_SIGNATURE):
        not_compressed_no_language = bytes(4)
        chunk = b"iTXt" + b"XML:com.adobe.xmp\0" + not_compressed_no_language + xmp
        added = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return picture[:_PNG_HEADER_END] + added + picture[_PNG_HEADER_END:]
    start = len(_JPEG_START)
    if picture[start : start + 2] == _JPEG_JFIF:  # JFIF's own segment comes first
        start += 2 + struct.unpack_from(">H", picture, start + 2)[0]
    segment = b"\xff\xe1" + struct.pack(">H", 2 + len(_JPEG_XMP) + len(xmp)) + _JPEG_XMP + xmp
    return picture[:start] + segment + picture[start:]


def _degrees(value: float) -> str:
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


# -- videos ----------------------------------------------------------------------------------------------


def video_boxes() -> bytes:
    """Return the boxes of a full equirectangular video that looks along its middle."""
    head = _box(b"svhd", bytes(4) + b"omniscv" + b"\0")
    projection = _box(b"proj", _box(b"prhd", bytes(16)) + _box(b"equi", bytes(20)))
    return _box(b"st3d", bytes(4) + bytes([_MONO])) + _box(b"sv3d", head + projection)


def with_video_boxes(video: bytes) -> bytes:
    """Return an MP4 file of one track, whose tables lie behind its pictures, with the boxes in its track."""
    added = video_boxes()
    result = bytearray(video)
    start = 0
    end = len(video)
    for kind in _TO_ENTRY:
        first, end = _find(video, start, end, kind)
        struct.pack_into(">I", result, first, end - first + len(added))
        start = first + (_LIST_HEADER if kind == b"stsd" else _BOX_HEADER)
    (size,) = struct.unpack_from(">I", video, start)
    struct.pack_into(">I", result, start, size + len(added))
    result[start + size : start + size] = added
    return bytes(result)


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", _BOX_HEADER + len(content)) + kind + content


def _find(data: bytes, start: int, end: int, kind: bytes) -> tuple[int, int]:
    """Return start and end of the first box of a kind between two offsets."""
    while start < end:
        size, found = struct.unpack_from(">I4s", data, start)
        if size == 1:  # 64 bits, as of media beyond 4 GB
            (size,) = struct.unpack_from(">Q", data, start + _BOX_HEADER)
        if found == kind:
            return start, start + size
        start += max(size, _BOX_HEADER)
    raise AssertionError(f"a video without {kind!r}")


def write_video(
    frames: Sequence[Frame], path: str | Path, *, rate: float = 30.0, progress: Steps | None = None
) -> str | Path:
    """Write the colour of frames as an H.264 video in an MP4 file; players show panoramas as spheres.

    Colours are coded by BT.709 in the limited range, and tagged so.

    Args:
        frames: in their order, of one camera.
        path: the file, or its URL; it appears when it is complete.
        rate: frames a second.
        progress: called with (frames done, frames in all).

    Returns:
        ``path``.

    Raises:
        ArgumentError: no frame, frames of several cameras or without colour, a picture whose width or height
            is odd, or PyAV is missing.
    """
    number("rate", rate, above=0)
    names = {frame.camera_name for frame in frames}
    if len(names) != 1:
        listed = ", ".join(sorted(names)) or "none"
        raise ArgumentError(f"video: expected the frames of one camera, got {listed}; choose a camera")
    camera = frames[0].camera
    if camera.width % 2 or camera.height % 2:
        wanted = "expected an even width and height, as H.264 needs"
        raise ArgumentError(f"video: {wanted}, got {camera.width} x {camera.height}")
    data = encoded_video(frames, rate, progress)
    if refuses(camera) is None:
        data = with_video_boxes(data)
    place = storage.file_at(path)
    place.folder.put(place.name, data)
    return path


def encoded_video(
    frames: Sequence[Frame],
    rate: float,
    progress: Steps | None = None,
    *,
    group: int | None = None,
    matrix: int = _BT709,
) -> bytes:
    """Return an MP4 file (H.264) of the frames' colours.

    Args:
        frames: of one camera, in their order.
        rate: frames a second.
        progress: called with (frames done, frames in all).
        group: how many frames follow each other from one that is coded alone to the next; the encoder's own
            number if not given.
        matrix: from colours to luma and chroma, tagged so: BT.709 or :data:`BT601`.

    Raises:
        ArgumentError: PyAV is missing.
    """
    try:
        import av
    except ImportError as missing:
        raise ArgumentError("video: expected PyAV, got none; install omniscv[video]") from missing
    file = BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width = frames[0].camera.width
        stream.height = frames[0].camera.height
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": _RATE_FACTOR, "preset": "medium"}
        if group is not None:
            stream.options |= {"g": str(group)}
        coding = stream.codec_context
        coding.colorspace = matrix
        coding.color_primaries = coding.color_trc = _BT709
        coding.color_range = _LIMITED
        for frame in counted(frames, progress):
            colors = uint8_colors(frame.layer("lit"))
            picture = av.VideoFrame.from_ndarray(colors, format="rgb24").reformat(
                format="yuv420p",
                src_colorspace=matrix,
                dst_colorspace=matrix,
                src_color_range=_FULL,
                dst_color_range=_LIMITED,
            )
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return file.getvalue()
