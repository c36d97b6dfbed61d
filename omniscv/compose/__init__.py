"""From captures to the layers of an image."""

from omniscv.compose.composer import FILTERS, Composer
from omniscv.compose.layers import Layers

__all__ = ["FILTERS", "Composer", "Layers"]
