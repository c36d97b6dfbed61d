"""What a server is, and what would spoil captures there, measured; what this installation lacks.

Functions are imported when they are first used: what the installation lacks may be what the others need.
"""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, Self

if TYPE_CHECKING:
    from omniscv.diagnostics.doctor import examine_address
    from omniscv.diagnostics.installation import examine_installation
    from omniscv.diagnostics.server import replies_to

__all__ = ["Finding", "examine_address", "examine_installation", "replies_to"]

_FUNCTIONS = {
    "examine_address": "omniscv.diagnostics.doctor:examine_address",
    "examine_installation": "omniscv.diagnostics.installation:examine_installation",
    "replies_to": "omniscv.diagnostics.server:replies_to",
}


@dataclass(frozen=True)
class Finding:
    """One property of a server, or of this installation.

    Attributes:
        name: what was measured.
        value: the result, with its unit.
        verdict: ``ok``; ``warning``: captures are right, but at a price, or it could not be measured here;
            ``bad``: captures are spoiled.
        remedy: what to do, where the verdict is not ``ok``.
    """

    name: str
    value: str
    verdict: Literal["ok", "warning", "bad"] = "ok"
    remedy: str = ""

    @classmethod
    def unless(cls, ok: bool, name: str, value: str, verdict: Literal["warning", "bad"], remedy: str) -> Self:
        """Return a finding that is ok, or else has a verdict and a remedy."""
        return cls(name, value) if ok else cls(name, value, verdict, remedy)


def __getattr__(name: str) -> Any:
    if name not in _FUNCTIONS:
        raise AttributeError(f"module 'omniscv.diagnostics' has no attribute {name!r}")
    globals()[name] = resolve_name(_FUNCTIONS[name])
    return globals()[name]
