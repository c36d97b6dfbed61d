"""What plugin 0.3.10 makes of mask colours.

It paints vertices with ``floor((c/255)^2.2 * 255.999)``, which show as ``round((v/255)^(1/2.2) * 255)``
(protocol reference, section 5.2). Black stays black, and from 122 up only 145 is changed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def bent(colors: NDArray[np.int64]) -> NDArray[np.int64]:
    """(..., 3) what plugin 0.3.10 shows for colours 0..255."""
    painted = np.floor((colors / 255) ** 2.2 * 255.999)
    return np.asarray(np.rint((painted / 255) ** (1 / 2.2) * 255), dtype=np.int64)
