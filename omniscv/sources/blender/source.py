"""The source: captures of a scene that Blender renders, read from the files that it writes."""

import logging
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, whole_number
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.sources import codecs
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    ProcessBound,
    Request,
    SceneIdentity,
    Source,
    View,
    closed_error,
)
from omniscv.sources.blender import Settings, blender_command, read_address
from omniscv.sources.blender.process import RETRIES, TIMEOUT_S, Blender
from omniscv.sources.codecs import check_depth, decode_png
from omniscv.sources.pool import SourcePool
from omniscv.sources.rendered import Rendered
from omniscv.storage.bounded import library_error, read_bytes

_DATA = ("object_mask", "depth", "normals")  # modalities that one render of a view gives together
_AHEAD = 24  # requests that are read ahead, to render a view once for all its data
# Of a side, as Blender has it:
_LEAST_PX = 4
_MOST_PX = 65_536
CAPABILITIES = Capabilities(
    frozenset(("lit", *_DATA)),
    min_size=_LEAST_PX,
    dialect="blender",
    varies=frozenset(("objects", "lights", "materials")),
)
_TO_BLENDER = np.diag([1.0, -1.0, -1.0])
"""From the axes of Blender's cameras (x right, y up, z back) to ours (x right, y down, z forward)."""

_log = logging.getLogger("omniscv")

_SKY = 0.99e10  # Blender's depth where there is no surface is 1e10, in units of the scene
_MOST_ID = 0xFFFF
_MOST_HEADER = 1 << 16  # bytes of a PNG besides its pixels
# of an EXR file
_MOST_PARTS = 16
_MOST_CHANNELS = 16
Pixels = dict[str, NDArray[Any]]
"""Pixels by modality."""


Measured = tuple[dict[str, Array], dict[str, ObjectBox]]
"""By name, where objects are, metres, and the boxes of those with a shape."""


class BlenderSource(Rendered):
    """Captures of one scene. Threads take turns, one picture at a time.

    Data (ids, depth, normals) have one sample at the centre of each pixel; colours have as many as the
    settings say, and a fixed seed: the same request gives the same pixels. ``blender`` renders.
    """

    def __init__(self, blender: Blender, settings: Settings) -> None:
        self.blender = blender
        self._settings = settings
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._name = blender.name
        self._objects = ObjectTable({}, ids=dict(blender.scene.objects))
        level = f"{blender.scene.scene}, frame {blender.scene.frame}"
        self._identity = SceneIdentity(Path(settings.path).stem, level, blender.digest)

    @property
    def capabilities(self) -> Capabilities:
        """Those of Blender; floating-point colours are light, those of 8 bits passed a view transform."""
        is_light = self._settings.lit == "float32"
        return replace(CAPABILITIES, transfer="linear" if is_light else self.blender.scene.transfer)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; ArgumentError for a mode, lens or size that Blender does not have."""
        remaining = iter(requests)
        while window := list(islice(remaining, _AHEAD)):
            for request in window:
                self._check(request)
            rendered: dict[Request, Any] = {}
            for index, request in enumerate(window):
                if request not in rendered:
                    pixels = self._render(request)
                    for later in window[index:]:
                        if later.view == request.view and later.mode in pixels:
                            rendered[later] = pixels[later.mode]
                again = request in window[index + 1 :]
                picture = rendered[request] if again else rendered.pop(request)
                encoding = codecs.NEAR_MIDDLE if request.mode == "depth" else None
                yield Capture(request, request.view, picture, self._provenance(request), encoding=encoding)

    def _check(self, request: Request) -> None:
        super()._check(request)
        view = request.view
        if view.lens is not None:
            raise ArgumentError(f"lens: expected none of Blender, got {view.lens}")
        if not _LEAST_PX <= min(view.width, view.height) <= max(view.width, view.height) <= _MOST_PX:
            expected = f"expected sides of {_LEAST_PX} to {_MOST_PX} px"
            raise ArgumentError(f"size: {expected}, got {view.width} x {view.height}")

    def geometry(self) -> SceneGeometry:
        """The boxes of all objects that have a shape, around their vertices and in their own axes."""
        _, boxes = self._measured()
        return SceneGeometry(MappingProxyType(dict(sorted(boxes.items()))))

    def variable(self, kind: str) -> Mapping[str, Mapping[str, int]]:
        scene = self.blender.scene
        known = {"lights": scene.lights, "materials": scene.materials}
        return known[kind] if kind in known else super().variable(kind)

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        if objects is None:
            return self._moved
        places, boxes = self._measured()
        poses = {}
        for name in objects:
            if name in boxes:
                poses[name] = Pose(places[name], boxes[name].R_w_b)
        return poses

    def _measured(self) -> Measured:
        with self._lock:
            self._check_open()
            message = {"do": "boxes", **self._world_state()}
            return self.blender.ask("measure its objects", message, _read_measured)

    def _world_state(self) -> dict[str, Any]:
        """Return what a request says of the world."""
        poses = {}
        for name, pose in self._moved.items():
            poses[name] = [pose.R_w_c.tolist(), pose.position.tolist()]
        return {"hidden": sorted(self._hidden), "poses": poses, "varied": self._instant.varied}

    def close(self) -> None:
        with self._lock:
            self._closed.set()
            self.blender.close()

    def _render(self, request: Request) -> Pixels:
        """Render a view, and return its pixels, read-only, by the modalities that come together."""
        view = request.view
        is_lit = request.mode == "lit"
        is_png = is_lit and self._settings.lit == "uint8"
        file = f"picture.{'png' if is_png else 'exr'}"

        def read(reply: dict[str, Any], folder: Path) -> Pixels:
            """Read the picture of a ``reply`` from its file in a ``folder``, and remove the file."""
            path = folder / file
            metres = float(reply["metres"])
            pixels = read_colors(path, view) if is_lit else read_data(path, view, metres)
            path.unlink()
            return pixels

        message = {
            "do": "render",
            "kind": "lit" if is_lit else "data",
            "file": file,
            **self._world_state(),
            "R_w_b": (view.pose.rotation @ _TO_BLENDER).tolist(),
            "position": view.pose.position.tolist(),
            "tan_half_fov": float(np.tan(np.radians(view.fov_deg) / 2)),
            "size": [view.width, view.height],
        }
        with self._lock:
            self._check_open()
            what = f"render {view.width} x {view.height} px"
            pixels = self.blender.ask(what, message, read)
        for array in pixels.values():
            array.flags.writeable = False
        return pixels

    def _provenance(self, request: Request) -> dict[str, Any]:
        settings = self._settings
        look = {"samples": settings.samples, "seed": settings.seed, "denoiser": settings.denoiser}
        server = f"Blender {self.blender.version}"
        provenance = {"server": server, "scene": self._identity.name, "dialect": CAPABILITIES.dialect}
        return {**provenance, **look} if request.mode == "lit" else provenance

    def _check_open(self) -> None:
        if self._closed.is_set():
            raise closed_error(self.blender.name)


def _read_measured(reply: dict[str, Any], folder: Path) -> Measured:
    """Return the places and boxes of a reply to ``boxes``."""
    places = {}
    for name, place in reply["places"].items():
        places[name] = np.array(place, np.float64)
    boxes = {}
    for name, (center, axes, size) in reply["boxes"].items():
        boxes[name] = ObjectBox.of(_floats(center), _floats(axes), _floats(size), "vertices")
    return places, boxes


def _floats(values: Any) -> Array:
    return np.array(values, np.float64)


def open_blender(address: str, timeout_s: float = TIMEOUT_S, retries: int = RETRIES) -> Source:
    """Open a scene that Blender renders.

    Args:
        address: ``blender://SCENE.blend``, with options of :class:`omniscv.sources.blender.Settings` behind a
            question mark. ``blender=PATH`` names Blender, and ``processes=2`` renders in several at once.
        timeout_s: how long starting and loading, and each picture, may take.
        retries: how often in a row Blender is started again after it has ended.

    Raises:
        ArgumentError: an option that is unknown or out of its range, or no such file.
        SourceError: there is no Blender, or it is too old, or does not open the scene.
    """
    _, _, processes = read_address(address)
    with ExitStack() as opened:
        sources = [opened.enter_context(open_process(address, timeout_s, retries)) for _ in range(processes)]
        source = sources[0] if processes == 1 else SourcePool(sources)
        opened.pop_all()
    blender = sources[0].blender
    if not blender.scene.world:
        _log.warning("%s: the scene has no world: pixels without an object are black", blender.name)
    return ProcessBound(source, blender.name)


def open_process(address: str, timeout_s: float = TIMEOUT_S, retries: int = RETRIES) -> BlenderSource:
    """As :func:`open_blender`, but one process, whatever the address says.

    Args:
        address: see :func:`open_blender`.
        timeout_s: likewise.
        retries: likewise.
    """
    number("timeout_s", timeout_s, above=0)
    whole_number("retries", retries, least=0)
    settings, program, _ = read_address(address)
    return BlenderSource(Blender(blender_command(program), settings, timeout_s, retries), settings)


def read_colors(path: Path, view: View) -> Pixels:
    """Return ``lit``, (H, W, 3) RGB: uint8 of a PNG, float32 of an EXR.

    ``path`` is the file; BadReplyError if it is no such picture of the size of ``view``.
    """
    _check_regular(path)
    if path.suffix == ".exr":
        return {"lit": _pass(_passes(path, view), "Combined.RGB", path)}
    most = 8 * view.width * view.height + _MOST_HEADER
    return {"lit": decode_png(read_bytes(path, most), view)}


def read_data(path: Path, view: View, metres: float) -> Pixels:
    """Return object masks, depth and normals of a multi-part EXR file of Blender's passes.

    ``object_mask`` is uint16 ids (H, W); ``depth`` planar metres (H, W), +inf where there is no surface;
    ``normals`` (H, W, 3) unit vectors in world axes, 0 where there is no surface.

    Args:
        path: the file.
        view: what was rendered.
        metres: of a unit of the scene.

    Raises:
        BadReplyError: the file has no such passes, or not of the view's size.
    """
    _check_regular(path)
    passes = _passes(path, view)
    ids = _pass(passes, "Object Index.X", path)
    z = _pass(passes, "Depth.Z", path)
    normals = _pass(passes, "Normal.XYZ", path)
    check_depth(z)
    if not ((ids >= 0) & (ids <= _MOST_ID)).all() or not np.isfinite(normals).all():
        raise BadReplyError(f"{path.name}: expected ids up to {_MOST_ID} and finite normals, got others")
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.where((length > 0) & (z < _SKY)[..., None], normals / length, 0)
    return {
        "object_mask": np.rint(ids).astype(np.uint16),
        "depth": np.where(z < _SKY, z * np.float32(metres), np.inf).astype(np.float32),
        "normals": unit.astype(np.float32),
    }


def _check_regular(path: Path) -> None:
    """Raise BadReplyError for no picture, and for a link, a FIFO or a device, which may have no end."""
    if path.is_symlink() or not path.is_file():
        raise BadReplyError(f"{path.name}: expected a picture, got none, or no regular file")


def _passes(path: Path, view: View) -> Pixels:
    """Return passes by name and channels: ``Depth.Z`` (H, W), ``Normal.XYZ``, ``Combined.RGB`` (H, W, 3)."""
    import OpenImageIO

    passes: Pixels = {}
    file = OpenImageIO.ImageInput.open(str(path))
    if file is None:
        raise BadReplyError(f"expected an EXR file of Blender, got: {library_error(OpenImageIO)}")
    try:
        part = 0
        while part < _MOST_PARTS and file.seek_subimage(part, 0):
            spec = file.spec()
            if (spec.width, spec.height) != (view.width, view.height) or spec.nchannels > _MOST_CHANNELS:
                expected = f"{path.name}: expected a picture of {view.width} x {view.height} px"
                raise BadReplyError(f"{expected}, got {spec.width} x {spec.height} px")
            pixels = file.read_image(part, 0, 0, spec.nchannels, "float")
            if pixels is not None:
                passes |= _passes_of_part(pixels, spec.channelnames)
            part += 1
    finally:
        file.close()
    return passes


def _passes_of_part(pixels: NDArray[Any], channels: Sequence[str]) -> Pixels:
    """Return the passes of (H, W, N) pixels; a channel is ``ViewLayer.Normal.X``, its pass ``Normal.XYZ``."""
    letters: dict[str, list[str]] = {}
    indices: dict[str, list[int]] = {}
    for index, channel in enumerate(channels):
        name, letter = channel.rsplit(".", 1)
        letters.setdefault(name, []).append(letter)
        indices.setdefault(name, []).append(index)
    passes: Pixels = {}
    for name in letters:
        first_three = indices[name][:3]  # without alpha
        picture = pixels[..., first_three[0]] if len(first_three) == 1 else pixels[..., first_three]
        passes[f"{name.rpartition('.')[2]}.{''.join(letters[name][:3])}"] = picture
    return passes


def _pass(passes: Pixels, name: str, path: Path) -> NDArray[Any]:
    if name not in passes:
        raise BadReplyError(f"{path.name}: expected the pass {name}, got none")
    return passes[name]
