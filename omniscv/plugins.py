"""Modules of other packages that register cameras, strategies, modalities and file formats.

A package names its module as an entry point of the group ``omniscv.plugins``. The modules are imported when a
name is not registered, or when all names are listed. Sources have another group, by scheme:
:mod:`omniscv.sources.registry`.
"""

from functools import cache
from importlib.metadata import entry_points

_GROUP = "omniscv.plugins"


@cache
def load() -> None:
    """Import the modules, once."""
    for entry in entry_points(group=_GROUP):
        entry.load()
