"""What a server is, and what would spoil captures there: measured, not assumed; what this installation lacks.

Names are imported when they are first used: what the installation lacks may be what the others need.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniscv.diagnostics.asking import replies_to
    from omniscv.diagnostics.doctor import examine_address
    from omniscv.diagnostics.finding import Finding
    from omniscv.diagnostics.installation import examine_installation

_HOMES = {
    "Finding": "omniscv.diagnostics.finding:Finding",
    "examine_address": "omniscv.diagnostics.doctor:examine_address",
    "examine_installation": "omniscv.diagnostics.installation:examine_installation",
    "replies_to": "omniscv.diagnostics.asking:replies_to",
}

__all__ = ["Finding", "examine_address", "examine_installation", "replies_to"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'omniscv.diagnostics' has no attribute {name!r}")
    globals()[name] = resolve_name(_HOMES[name])
    return globals()[name]
