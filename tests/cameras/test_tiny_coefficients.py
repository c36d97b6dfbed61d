"""Coefficients so small that they say nothing.

A calibration that ended at k4 = 5e-324 instead of 0 once stopped the constructor with a ``LinAlgError``;
1e-200 leaked overflow warnings; and 1e-100 hid the place where the lens turns back, so that wrong rays came
out as valid: next to roots of 1e100 the solver lost the root at 3.
"""

import numpy as np
import pytest

from omniscv import cameras
from omniscv.errors import ArgumentError

TINY = [5e-324, -5e-324, 1e-300, -1e-200, 1e-120, -1e-100]


@pytest.mark.parametrize("tiny", TINY)
@pytest.mark.parametrize("first", [0.1, -0.1])
def test_kannala_brandt_is_as_without_them(tiny: float, first: float) -> None:
    shape = {"width": 41, "height": 31, "fx": 10.0, "fy": 10.0}
    with_them = cameras.create("kannala-brandt", **shape, k=[first, 0, tiny, tiny])
    without = cameras.create("kannala-brandt", **shape, k=[first, 0, 0, 0])
    np.testing.assert_array_equal(with_them.unproject().directions, without.unproject().directions)


@pytest.mark.parametrize("tiny", TINY)
@pytest.mark.parametrize("second", [0.01, -0.02])
def test_scaramuzza_is_as_without_them(tiny: float, second: float) -> None:
    with_them = cameras.create("scaramuzza", width=41, height=31, coefficients=[-20.0, 0.0, second, tiny])
    without = cameras.create("scaramuzza", width=41, height=31, coefficients=[-20.0, 0.0, second])
    np.testing.assert_array_equal(with_them.unproject().directions, without.unproject().directions)


@pytest.mark.parametrize("c", [5e-324, -1e-310])
def test_an_affine_part_of_next_to_nothing_is_refused(c: float) -> None:
    """It put the image's corners at infinity, and warned; no ray of such a camera is finite."""
    with pytest.raises(ArgumentError, match="affine: expected c - d e further from 0"):
        cameras.create("scaramuzza", width=41, height=31, coefficients=[-20.0], affine=(c, 0, 0))
