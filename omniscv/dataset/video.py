"""A video of a dataset's frames, to look at: the frames are the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from io import BytesIO
from pathlib import Path

from omniscv import storage
from omniscv.arguments import number, whole_number
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset import spherical_metadata
from omniscv.errors import ArgumentError
from omniscv.frame import Frame


def write_video(
    frames: Sequence[Frame],
    path: str | Path,
    *,
    rate: float = 30.0,
    quality: int = 18,
    progress: Callable[[int, int], None] | None = None,
) -> str | Path:
    """Write the colour of frames as an H.264 video in an MP4 file; players show panoramas as spheres.

    Args:
        frames: in their order, of one camera.
        path: the file, or its URL; it appears when it is complete.
        rate: frames a second.
        quality: the constant rate factor of H.264: 0 lossless of its YUV 4:2:0, 51 worst.
        progress: called with (frames done, frames in all).

    Returns:
        ``path``.

    Raises:
        ArgumentError: no frame, frames of several cameras or without colour, a picture whose width or height
            is odd, or PyAV is missing.
    """
    number("rate", rate, above=0)
    whole_number("quality", quality, least=0, most=51)
    names = {frame.camera_name for frame in frames}
    if len(names) != 1:
        got = ", ".join(sorted(names)) or "none"
        raise ArgumentError(f"video: expected the frames of one camera, got {got}; choose a camera")
    camera = frames[0].camera
    if camera.width % 2 or camera.height % 2:
        wanted = "expected an even width and height, as H.264 needs"
        raise ArgumentError(f"video: {wanted}, got {camera.width} x {camera.height}")
    data = _encoded(frames, rate, quality, progress)
    if spherical_metadata.refuses(camera) is None:
        data = spherical_metadata.with_video_boxes(data)
    place = storage.file_at(path)
    place.folder.put(place.name, data)
    return path


def _encoded(
    frames: Sequence[Frame], rate: float, quality: int, progress: Callable[[int, int], None] | None
) -> bytes:
    try:
        import av
    except ImportError as missing:
        raise ArgumentError("video: expected PyAV, got none; install omniscv[video]") from missing
    file = BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = (
            frames[0].camera.width,
            frames[0].camera.height,
            "yuv420p",
        )
        stream.options = {"crf": str(quality), "preset": "medium"}
        for done, frame in enumerate(frames, start=1):
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(uint8_colors(frame.layer("lit")), format="rgb24"))
            )
            if progress:
                progress(done, len(frames))
        container.mux(stream.encode())
    return file.getvalue()
