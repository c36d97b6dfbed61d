"""Vignettes of other programs."""

import cv2
import numpy as np
import pytest

from omniscv.errors import ArgumentError
from omniscv.sensor import optics


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_vignette_of_another_program_is_relative_to_its_largest_value(tmp_path, dtype):
    pixels = np.random.default_rng(1).integers(40, 200, (6, 9)).astype(dtype)
    cv2.imwrite(str(tmp_path / "vignette.png"), pixels)
    shares = optics.read_vignette(tmp_path / "vignette.png", (6, 9))
    np.testing.assert_allclose(shares, pixels / pixels.max(), atol=1e-6)
    with pytest.raises(ArgumentError, match="expected a vignette of the image's size, 9 x 5, got 9 x 6"):
        optics.read_vignette(tmp_path / "vignette.png", (5, 9))
