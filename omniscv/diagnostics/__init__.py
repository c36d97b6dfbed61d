"""What a server is, and what would spoil captures there: measured, not assumed."""

from omniscv.diagnostics.asking import replies_to
from omniscv.diagnostics.doctor import examine_address
from omniscv.diagnostics.finding import Finding

__all__ = ["Finding", "examine_address", "replies_to"]
