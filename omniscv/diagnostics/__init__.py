"""The doctor: measurements of a server before recording, and checks of this installation."""

from dataclasses import dataclass
from typing import Literal, Self


@dataclass(frozen=True)
class Finding:
    """One property of a server, or of this installation.

    Attributes:
        name: what was measured.
        value: the result, with its unit.
        verdict: ``ok``; ``warning``: captures are right, but at a price, or the measurement failed here;
            ``bad``: captures are wrong.
        remedy: what to do, where the verdict is not ``ok``.
    """

    name: str
    value: str
    verdict: Literal["ok", "warning", "bad"] = "ok"
    remedy: str = ""

    @classmethod
    def unless(cls, ok: bool, name: str, value: str, verdict: Literal["warning", "bad"], remedy: str) -> Self:
        """Return a finding that is fine if ``ok``, or else has a verdict and a remedy.

        Args:
            ok: whether it is fine.
            name: what was measured.
            value: the result, with its unit.
            verdict: if it is not fine.
            remedy: likewise: what to do.
        """
        return cls(name, value) if ok else cls(name, value, verdict, remedy)
