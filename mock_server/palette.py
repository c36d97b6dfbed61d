"""The plugin's default mask colours (protocol reference, section 5.1)."""

import itertools
from collections.abc import Iterator

Color = tuple[int, int, int]

_CHANNEL = (0, 255, 127, 63, 191, 31, 95, 159, 223, 15, 47, 79, 111, 143, 175, 207,
            239, 7, 23, 39, 55, 71, 87, 103, 119, 135, 151, 167, 183, 199, 215, 231)  # fmt: skip
_FIXED = ((False, False, True), (False, True, False), (False, True, True), (True, False, False),
          (True, False, True), (True, True, False), (True, True, True))  # fmt: skip


def palette() -> Iterator[Color]:
    """Yield the colours in order."""
    for m, value in enumerate(_CHANNEL):
        for fixed in _FIXED:
            choices = [(value,) if is_fixed else _CHANNEL[:m] for is_fixed in fixed]
            yield from itertools.product(*choices)
