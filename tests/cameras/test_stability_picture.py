"""What docs/stability.png claims, as a test: every model, every way into its limits."""

import json

import numpy as np
import pytest
from PIL import Image

from omniscv import cameras
from omniscv.chart import stability


@pytest.mark.parametrize("name", cameras.names())
def test_every_model_keeps_its_promise_up_to_its_limits(name):
    """1e-6 px, or what float64 keeps of the points themselves where that is more."""
    for row in stability.measure(models=[name]):
        errors = np.array(row.error_px)
        allowed = np.maximum(stability.BOUND_PX, row.known_px or np.zeros(len(errors)))
        drawn = np.isfinite(errors)
        assert drawn.any(), row.limit
        assert (errors[drawn] <= allowed[drawn]).all(), (row.limit, errors.tolist())
        assert row.beyond in ("refused", "marked", "in domain")


def test_it_is_written_and_drawn(tmp_path):
    data, drawn, picture = stability.write(stability.measure(**stability.QUICK), tmp_path)
    assert json.loads(data.read_text())[0]["model"] == "equirectangular"
    assert "division" in drawn.read_text()
    with Image.open(picture) as opened:
        assert opened.width == 1320
