"""Opens ``blender://SCENE.blend?samples=64``."""

from __future__ import annotations

import logging
from contextlib import ExitStack

from omniscv.arguments import number, whole_number
from omniscv.sources.base import Source
from omniscv.sources.blender.finding import blender_command
from omniscv.sources.blender.server import RETRIES, TIMEOUT_S, Blender
from omniscv.sources.blender.settings import read_address
from omniscv.sources.blender.source import CAPABILITIES, BlenderSource
from omniscv.sources.pool import SourcePool

_log = logging.getLogger("omniscv")


def open_blender(address: str, timeout_s: float = TIMEOUT_S, retries: int = RETRIES) -> Source:
    """Start Blender, and open a scene in it.

    Args:
        address: ``blender://SCENE.blend``, with options behind a question mark: those of
            :class:`omniscv.sources.blender.settings.Settings`; ``blender=PATH`` names Blender, and
            ``processes=2`` renders in several at once.
        timeout_s: how long loading the scene, and each picture, may take.
        retries: how often in a row to start Blender again after it has ended.

    Raises:
        ArgumentError: an option that is unknown or out of its range, or no such file.
        SourceError: there is no Blender, or it is too old, or does not open the scene.
    """
    _, _, processes = read_address(address)
    with ExitStack() as opened:
        sources = [opened.enter_context(open_process(address, timeout_s, retries)) for _ in range(processes)]
        opened.pop_all()
    if not sources[0].blender.scene["world"]:
        name = sources[0].blender.name
        _log.warning("%s: the scene has no world: what shows no object is black", name)
    return sources[0] if processes == 1 else SourcePool(sources)


def open_process(address: str, timeout_s: float = TIMEOUT_S, retries: int = RETRIES) -> BlenderSource:
    """As :func:`open_blender`, but one process, however many the address says."""
    number("timeout_s", timeout_s, above=0)
    whole_number("retries", retries, least=0)
    settings, named, _ = read_address(address)
    return BlenderSource(Blender(blender_command(named), settings, timeout_s, retries), settings)


open_blender.capabilities = lambda address: CAPABILITIES  # type: ignore[attr-defined]  # for the registry
