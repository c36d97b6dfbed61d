"""What the doctor finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "bad"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        name: what was looked at.
        value: what was found, with its unit.
        verdict: ``ok``; ``warning``: captures come out right, but at a price, or it could not be measured
            here; ``bad``: captures are spoiled.
        cure: what to do, where the verdict is not ``ok``.
    """

    name: str
    value: str
    verdict: Verdict = "ok"
    cure: str = ""
