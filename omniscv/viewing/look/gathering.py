"""Frames to look at: of a dataset, a folder of images, one image, a picture, or a recording."""

import glob
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omniscv import dataset, modalities, storage
from omniscv.arguments import within
from omniscv.cameras import Camera, create, from_dict
from omniscv.compose.files import OBJECTS
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.dataset.manifest import DATASET, FRAMES
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError, MissingCaptureError, RecordingError
from omniscv.frame import Frame, ImageFiles
from omniscv.geometry import Pose
from omniscv.progress import Steps, counted
from omniscv.sources.registry import is_recording, open_source
from omniscv.storage.bounded import MOST_JSON_BYTES, open_regular, parse_json, read_bytes

PICTURES = (".png", ".jpg", ".jpeg")
_CUBE_FACES = 6


@dataclass(frozen=True)
class Gathered:
    """Frames that one page shows.

    Attributes:
        frames: grouped by camera, ordered by time or key.
        placed: whether their poses are known.
        flat: whether the directions of their pixels are unknown.
        mask_colors: ``#rrggbb`` of an object in ``object_mask``, by its name.
    """

    frames: Sequence[Frame]
    placed: bool = True
    flat: bool = False
    mask_colors: Mapping[str, str] = field(default_factory=dict)


@contextmanager
def open_frames(
    what: str | Path,
    size: tuple[int, int],
    progress: Steps | None = None,
    warn: Callable[[str], None] | None = None,
) -> Iterator[Gathered]:
    """Yield the frames of a dataset, folder, file or recording, which is composed in a temporary folder.

    Args:
        what: as of :func:`omniscv.viewing.look.look`.
        size: of panoramas that are composed of a recording, px.
        progress: called with (viewpoints done, viewpoints in all) of a recording.
        warn: called with a line if viewpoints of a recording are left out.

    Raises:
        ArgumentError: nothing is there that can be shown.
    """
    folder = storage.folder(what)
    if folder.exists(DATASET) or folder.exists(FRAMES):
        frames: list[Frame] = []
        for sequence in by_camera(dataset.open(folder)).values():
            frames += sequence
        if not frames:
            raise ArgumentError(f"{folder}: expected a dataset with frames, got one without")
        yield Gathered(frames)
        return
    path = folder.local or storage.fetch_file(what)
    if not is_recording(path):
        yield gather(path)
        return
    with TemporaryDirectory() as composed:
        left_out = _compose(path, Path(composed), size, progress)
        if left_out and warn:
            warn(left_out)
        yield gather(Path(composed))


def gather(path: Path) -> Gathered:
    """Return the frames of a folder of images as ``render`` writes them, of the ``STEM.json`` or any layer of
    one, or of a picture."""
    if path.is_dir():
        if descriptions := list(filter(_files, sorted(path.glob("*.json")))):
            return _of_images(path, descriptions)
        inner = sorted({file.parent.name for file in path.glob("*/*.json") if _files(file)})
        other = f"folders of images: choose one of {', '.join(inner)}" if inner else "none"
        raise ArgumentError(f"{path}: expected images of 'render' or a dataset, got {other}")
    if not path.is_file():
        other = "a device or a pipe" if path.exists() else "nothing there"
        raise ArgumentError(f"{path}: expected a folder, an image or a recording, got {other}")
    if path.suffix == ".json":
        return _of_images(path.parent, [path])
    description = path.with_name(f"{path.name.split('.')[0]}.json")
    if description.is_file() and _layer_of(path, description.stem):
        return _of_images(path.parent, [description])
    return _of_picture(path)


def _of_images(folder: Path, descriptions: Iterable[Path]) -> Gathered:
    labels, colors = _objects(folder / OBJECTS)
    return Gathered([_image_frame(path, labels) for path in descriptions], mask_colors=colors)


def _image_frame(path: Path, labels: Mapping[str, int]) -> Frame:
    """The frame of a ``STEM.json``."""
    data = _json(path)
    files = _files(path)
    if not isinstance(data, dict) or not {"camera", "pose"} <= data.keys() or not files:
        raise ArgumentError(f"{path}: expected the STEM.json of an image with its layers, got another file")
    try:
        with within(path):
            camera = from_dict(data["camera"])
            pose = Pose.from_dict(data["pose"])
        frame = data.get("frame") or {}
        name = frame.get("camera", camera.name)
        time = frame.get("time_ns")
    except (TypeError, KeyError, AttributeError) as cause:
        raise ArgumentError(f"{path}: expected a camera and a pose, got: {cause}") from cause
    layers = ImageFiles(files, (camera.width, camera.height))
    return Frame(path.stem, name, camera, pose, layers, labels, time_ns=time)


def _files(path: Path) -> dict[str, Path]:
    """The layers and records beside a ``STEM.json``, by kind."""
    stem = path.stem
    files = {}
    for file in sorted(path.parent.glob(f"{glob.escape(stem)}.*.*")):
        if layer := _layer_of(file, stem):
            files[layer] = file
    if files:
        for kind in ("truth", "layout"):
            record = path.with_name(f"{stem}.{kind}.json")
            if record.is_file():
                files[kind] = record
    return files


def _layer_of(path: Path, stem: str) -> str:
    """The layer that a file ``STEM.LAYER.SUFFIX`` holds; empty for others."""
    layer = path.name.removeprefix(f"{stem}.").removesuffix(path.suffix)
    return layer if layer in {modality.name for modality in modalities.layers()} else ""


def _objects(path: Path) -> tuple[dict[str, int], dict[str, str]]:
    """Object name to label, and to mask colour, of ``objects.json``; empty without the file."""
    if not path.is_file():
        return {}, {}
    labels = {}
    colors = {}
    try:
        for label, values in _json(path).items():
            name = values["name"]
            labels[name] = int(label)
            colors[name] = "#{:02x}{:02x}{:02x}".format(*values["mask_color"])
    except (TypeError, KeyError, AttributeError, ValueError, IndexError) as cause:
        raise ArgumentError(f"{path}: expected labels and their objects, got: {cause!r}") from cause
    return labels, colors


def _of_picture(path: Path) -> Gathered:
    """A picture without a description: a panorama if it is twice as wide as high, else flat."""
    from PIL import Image

    try:
        with open_regular(path) as file, Image.open(file) as picture:
            width, height = picture.size
    except (OSError, Image.DecompressionBombError) as cause:
        expected = "expected a folder of images, a STEM.json, a picture or a recording"
        raise ArgumentError(f"{path}: {expected}, got: {cause}") from cause
    if path.suffix.lower() not in PICTURES:
        suffix = path.suffix or "no suffix"
        raise ArgumentError(f"{path}: expected a picture {', '.join(PICTURES)}, got {suffix}")
    camera = create("equirectangular", width=width, height=height)
    files = ImageFiles({"lit": path}, (width, height))
    frame = Frame(path.stem, "picture", camera, Pose.from_angles((0, 0, 0)), files, {})
    return Gathered([frame], placed=False, flat=width != 2 * height)


def _json(path: Path) -> Any:
    with within(path):
        return parse_json(read_bytes(path, MOST_JSON_BYTES))


def _compose(path: Path, out: Path, size: tuple[int, int], progress: Steps | None) -> str:
    """Save level panoramas, with all their modes, at the viewpoints that a recording shows all around in the
    first of its modes, colour where it has any; return the number of others, in words; empty for none."""
    camera = create("equirectangular", width=size[0], height=size[1])
    with open_source(str(path)) as source:
        views = Counter[tuple[float, ...]]()
        for view in source.recorded_views() or ():
            views[tuple(view.pose.position.tolist())] += 1
        centers = [center for center, count in views.items() if count >= _CUBE_FACES]
        modes = [mode for mode in modalities.names() if mode in source.capabilities.modes]
        renderer = Renderer(source)
        left_out = 0
        for number, center in enumerate(counted(centers, progress)):
            image = _recorded_image(renderer, camera, Pose.from_angles(center), modes)
            if image is None:
                left_out += 1
            else:
                image.save(out, stem=f"place-{number:04d}")
    why = f"{left_out} of {len(centers)} optical centres are not recorded in {modes[0]} all around"
    if left_out == len(centers):
        raise RecordingError(f"{path}: expected a place that is recorded all around, got none: {why}")
    return why if left_out else ""


def _recorded_image(renderer: Renderer, camera: Camera, pose: Pose, modes: Sequence[str]) -> OmniImage | None:
    """Return an image in the modes that are recorded all around; None if the first mode is not."""
    with suppress(MissingCaptureError):
        return renderer.render(camera, pose, modes)
    recorded = list[str]()
    for mode in modes:
        with suppress(MissingCaptureError):
            renderer.render(camera, pose, [mode])
            recorded.append(mode)
    return renderer.render(camera, pose, recorded) if modes[0] in recorded else None
