"""Colours of a page: of objects and classes, and of numbers from near to far."""

from __future__ import annotations

import numpy as np

from omniscv.viewing.look.arrays import text

_BASE = ("#3b82b5", "#e0a43a", "#2f9e7e", "#c986ae", "#7cbfe6", "#cf6a32", "#e3d85e", "#9a8ee0")
"""After Okabe and Ito, whose colours people with any kind of colour vision tell apart, a little paler, with a
violet for their black, which a dark page would hide."""
_TURNS = ((0.0, 0), (0.4, 255), (0.4, 0), (0.65, 255), (0.52, 0), (0.2, 255), (0.2, 0))
"""Mixed into the base colours in each further turn: how much, of white or black."""


def color(index: int) -> str:
    """Return the colour ``#rrggbb`` of the object or class with an index from 1: the base ones, then paler
    and darker ones."""
    turn, base = divmod(index - 1, len(_BASE))
    share, grey = _TURNS[turn % len(_TURNS)]
    parts = (int(_BASE[base][i : i + 2], 16) for i in (1, 3, 5))
    return "#{:02x}{:02x}{:02x}".format(*(round((1 - share) * part + share * grey) for part in parts))


def ramps() -> dict[str, str]:
    """Return turbo, red near, and cividis, yellow near: 256 RGB bytes each, as base64."""
    from matplotlib import colormaps

    places = np.linspace(0, 1, 256)
    return {
        name: text(colormaps[f"{name}_r"](places, bytes=True)[:, :3].tobytes())
        for name in ("turbo", "cividis")
    }
