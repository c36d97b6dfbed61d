"""Sources by address: the scheme of an address chooses the opener.

Other packages add schemes by :func:`register`, or by an entry point of the group ``omniscv.sources``: its
name is the scheme, and its value is the opener, ``opener(address, **options) -> Source``.
"""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, TypedDict, Unpack
from urllib.parse import parse_qsl

from omniscv import storage
from omniscv.arguments import one_of, shown
from omniscv.errors import ArgumentError, SourceError
from omniscv.modalities import TRANSFERS, Transfer
from omniscv.sources.base import Capabilities, Source, SourceWrapper
from omniscv.sources.world import CameraExposure, Freeze
from omniscv.storage.bounded import open_regular

Opener = Callable[..., Source]
"""``opener(address, **options)``: ``address`` is the whole text, with its scheme."""

_ENTRY_POINTS = "omniscv.sources"
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):")
_HOST_AND_PORT = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\]):\d+")

_SQLITE = b"SQLite format 3\0"

_UNREAL = "omniscv.sources.unreal"
_RECORDING = "omniscv.sources.recording.replay:RecordedSource"
_openers: dict[str, Opener | str] = {
    "unreal": f"{_UNREAL}:open_unreal",
    "unreal+unix": f"{_UNREAL}:open_unreal",
    "launch": f"{_UNREAL}:open_launched",
    "mock": f"{_UNREAL}:open_mock",
    "scene": "omniscv.sources.scene:open_scene",
    "blender": "omniscv.sources.blender.source:open_blender",
    "mujoco": "omniscv.sources.mujoco:open_mujoco",
    "mesh": "omniscv.sources.mesh:open_mesh",
    **dict.fromkeys(storage.SCHEMES, _RECORDING),
}
"""By scheme; ``module:function`` is imported when the scheme is opened first."""


class Deadlines(TypedDict, total=False):
    """How long, in seconds, to wait for a live server.

    Attributes:
        timeout_s: connecting, and each reply, may take so long; 15 if not given.
        patience_s: connect and send again so long after a fault, until there is a reply; 10.
    """

    timeout_s: float
    patience_s: float


class SourceOptions(Deadlines, total=False):
    """Options of :func:`open_source`; an opener refuses those that it does not know.

    Attributes:
        retries: how often, with exponential backoff; 5 times.
        fix_exposure: switch off vignette and auto exposure in the running game.
        exposure: of the camera that is spawned, by plugins from 2026-03 (N2): ``auto``, manual exposure that
            matches the game's own; manual exposure with a bias in stops; or ``game``, the game's own. If it
            is not given, ``auto`` where the plugin can set it.
        warmup: frames of colour to drop after each move, of plugin 1.x, where temporal effects blend them;
            the doctor measures how many.
        freeze: how a game is kept at an instant while it is captured (:data:`omniscv.sources.world.Freeze`);
            ``auto`` if not given. If it is given, the world moves, and captures are checked for motion.
        transfer: what 8-bit colours say of light (:mod:`omniscv.light`), in place of what the source
            declares; of any source.
    """

    retries: int
    fix_exposure: bool
    exposure: CameraExposure
    warmup: int
    freeze: Freeze
    transfer: Transfer


class _WithTransfer(SourceWrapper):
    """A source whose 8-bit colours are known to say something else of light than it declares."""

    def __init__(self, source: Source, transfer: Transfer) -> None:
        super().__init__(source)
        self._transfer: Transfer = transfer

    @property
    def capabilities(self) -> Capabilities:
        return replace(self._source.capabilities, transfer=self._transfer)

    def around(self, source: Source) -> Source:
        return _WithTransfer(source, self._transfer)


def register(scheme: str, opener: Opener) -> None:
    """Open addresses of a scheme with ``opener(address, **options) -> Source``."""
    if not isinstance(scheme, str) or not _SCHEME.fullmatch(f"{scheme}:"):
        raise ArgumentError(f"scheme: expected a name such as 'blender', got {shown(scheme)}")
    if not callable(opener):
        raise ArgumentError(f"opener: expected a function opener(address, **options), got {shown(opener)}")
    _openers[scheme] = opener


def schemes() -> list[str]:
    """Return every scheme that an address may have, also those of other packages."""
    return sorted({*_openers, *(entry.name for entry in entry_points(group=_ENTRY_POINTS))})


def scheme_of(address: str) -> str | None:
    """Return the scheme of an address; None for the path of a recording."""
    match = _SCHEME.match(address)
    return match[1] if match and ("://" in address or match[1] in _openers) else None


def is_recording(path: Path) -> bool:
    """Return whether a path is that of a file that begins as recordings do."""
    try:
        with open_regular(path) as file:
            return file.read(len(_SQLITE)) == _SQLITE
    except (OSError, ArgumentError):
        return False


def advice_on(address: str) -> str:
    """Return ``; write ADDRESS``, with a scheme, for a host and port or a scene's name; else nothing."""
    from mock_server import scene_names

    if _HOST_AND_PORT.fullmatch(address):
        return f"; write unreal://{address}"
    return f"; write mock://{address}" if address in scene_names() else ""


def open_source(uri: str | Path, **options: Unpack[SourceOptions]) -> Source:
    """Open a source of captures.

    Args:
        uri: ``unreal://host:port`` or ``unreal+unix:///path``, a live server; ``launch:PATH``, a packaged
            game, started for this source; ``mock://four-wall``, the mock server, started for it, with
            options behind a question mark (``mock://four-wall?latency_ms=5&depth=float32``;
            ``dialect=0.3.10&size=512x512``; ``fault=delay=0.2@0.05``, repeatable, and their ``seed``);
            ``scene://four-wall``, a scene traced in this process; ``blender://SCENE.blend?samples=64``, a
            scene that Blender renders; ``mesh://room.glb?unit=cm``, triangles of a file; an address of a
            registered scheme; the path of a recording, or its URL in a store,
            ``s3://bucket/room.sqlite``, from which it is fetched once into the local cache.
        options: see :class:`SourceOptions`.

    Raises:
        ArgumentError: an address of another form, or an option that the source does not take.
        SourceError: no server reachable at the address, or the package of a scheme cannot be imported.
        RecordingError: the file is not there, or is no recording.
        StorageError: it cannot be fetched.
    """
    if not isinstance(uri, str | Path) or not str(uri):
        raise ArgumentError(f"source: expected an address or the path of a recording, got {shown(uri)}")
    text = str(uri)
    scheme = scheme_of(text)
    if scheme is None:
        advice = advice_on(Path(text).name)
        if advice and not Path(text).exists():
            raise ArgumentError(f"source: expected an address or a recording, got {shown(text)}{advice}")
    transfer = options.pop("transfer", None)
    opener = resolve_name(_RECORDING) if scheme is None else _opener(scheme, text)
    try:
        inspect.signature(opener).bind(text, **options)
    except TypeError:
        known = list(inspect.signature(opener).parameters)[1:]
        expected = f"options among {', '.join(known)}" if known else "no options"
        actual = ", ".join(sorted(options))
        address = shown(storage.without_secrets(text))
        raise ArgumentError(f"options: expected {expected} for {address}, got {actual}") from None
    if transfer is not None:
        one_of("transfer", transfer, TRANSFERS)
    source = opener(text, **options)
    if not isinstance(source, Source):
        expected = f"expected it to return a Source for {shown(text)}"
        raise ArgumentError(f"{scheme}: {expected}, got {shown(source)}")
    try:
        source.require_one_numbering()
    except ArgumentError:
        source.close()
        raise
    return source if transfer is None else _WithTransfer(source, transfer)


def open_sources(uris: Sequence[str], **options: Unpack[SourceOptions]) -> Source:
    """Open one source, or a pool of replicas of one scene, as :func:`open_source`; all or none.

    Raises ArgumentError for no address, or replicas that differ (:class:`omniscv.sources.pool.SourcePool`).
    """
    from omniscv.sources.pool import SourcePool

    with ExitStack() as opened:
        sources = [opened.enter_context(open_source(uri, **options)) for uri in uris]
        source = sources[0] if len(sources) == 1 else SourcePool(sources)
        opened.pop_all()
        return source


def split_address(
    address: str, readers: Mapping[str, Callable[[str], Any]], repeatable: Sequence[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Return the part of an address behind its scheme, and the options behind its question mark.

    Args:
        address: such as ``scene://four-wall?lit=float32``.
        readers: by option, a function that parses its text, and raises ValueError for a wrong one.
        repeatable: options that may be given several times; their values are lists.

    Raises:
        ArgumentError: an unknown option, one that is given twice, or a value of another form.
    """
    path, _, query = address.partition("?")
    path = path.partition(":")[2].removeprefix("//")
    options: dict[str, Any] = {}
    for key, text in parse_qsl(query, keep_blank_values=True):
        if key not in readers:
            known = ", ".join(readers)
            expected = f"expected options among {known} in {shown(address)}"
            raise ArgumentError(f"source: {expected}, got {shown(key)}")
        try:
            value = readers[key](text)
        except ValueError as wrong:
            expected = f"expected a value of {key}, got {shown(text)}"
            raise ArgumentError(f"source: {shown(address)}: {expected}") from wrong
        if key in repeatable:
            options.setdefault(key, []).append(value)
        elif key in options:
            raise ArgumentError(f"source: {shown(address)}: expected {key} once, got it twice")
        else:
            options[key] = value
    return path, options


def read_size(text: str) -> tuple[int, int]:
    """Return width and height of a text such as ``640x480``; ValueError for another text."""
    width, height = text.split("x")
    return int(width), int(height)


def _opener(scheme: str, address: str) -> Opener:
    opener = _openers.get(scheme)
    if opener is None:
        for entry in entry_points(group=_ENTRY_POINTS, name=scheme):
            try:
                opener = entry.load()
            except (ImportError, AttributeError) as cause:
                expected = f"expected the entry point {entry.value!r} to be importable"
                raise SourceError(f"{address}: {expected}, got: {cause}") from cause
    if opener is None:
        forms = []
        for name in schemes():
            if name not in storage.SCHEMES:
                forms.append(f"{name}:" if name == "launch" else f"{name}://")
        expected = f"expected {', '.join(forms)} or the path or URL of a recording"
        raise ArgumentError(f"source: {expected}; got {shown(address)}")
    return resolve_name(opener) if isinstance(opener, str) else opener
