"""The claims of docs/stability.png: every model, every approach to its limits."""

import numpy as np
import pytest

from omniscv import cameras
from omniscv.chart import stability
from omniscv.chart.limits import approaches


@pytest.mark.parametrize("name", cameras.names())
@pytest.mark.parametrize("every", [32, pytest.param(1, marks=pytest.mark.soak)])
def test_every_model_keeps_its_promise_up_to_its_limits(name, every):
    """1e-6 px, or what float64 keeps of the points themselves where that is more."""
    steps = stability.STEPS[::-every]  # the last among them
    for way in approaches(name):
        errors = np.array([way.error_px(left) for left in steps])
        allowed = np.maximum(stability.BOUND_PX, way.known_px(steps) if way.known_px else 0 * steps)
        drawn = np.isfinite(errors)
        assert drawn.any(), way.limit
        assert (errors[drawn] <= allowed[drawn]).all(), (way.limit, errors.tolist())
        assert way.beyond() in ("refused", "marked", "in domain")
