"""What docs/stability.png claims, as a test: every model, every way into its limits."""

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import numpy as np
import pytest

from omniscv import cameras

SCRIPT = Path(__file__).parents[2] / "scripts" / "draw-stability"


def load_script():
    loader = SourceFileLoader("draw_stability", str(SCRIPT))
    module = module_from_spec(spec_from_loader(loader.name, loader))
    sys.modules[loader.name] = module  # dataclasses look their module up
    loader.exec_module(module)
    return module


picture = load_script()


@pytest.mark.parametrize("name", cameras.names())
def test_every_model_keeps_its_promise_up_to_its_limits(name):
    """1e-6 px, or what float64 keeps of the points themselves where that is more."""
    for approach in picture.approaches(name):
        errors = np.array([approach.error_px(left) for left in picture.STEPS])
        allowed = np.full(len(errors), picture.BOUND_PX)
        if approach.known_px:
            allowed = np.maximum(allowed, approach.known_px(picture.STEPS))
        drawn = np.isfinite(errors)
        assert drawn.any(), approach.limit
        assert (errors[drawn] <= allowed[drawn]).all(), (approach.limit, errors.tolist())
        assert approach.beyond() in ("refused", "marked", "in domain")
