"""Noise is a function of what a frame is: known answers of Philox, distributions, tiles."""

import numpy as np
import pytest
from scipy import stats

from omniscv.sensor import Sensor

NOISY = Sensor(
    seed=5, electrons=2000, full_well=4000, read_noise=4, row_noise=2, prnu=0.02, dsnu=3, dark_current=50,
    black_level=64, mosaic="rggb",
)  # fmt: skip


@pytest.mark.parametrize("mean", [0.3, 4.0, 9.99, 10.0, 30.0, 1000.0])
def test_shot_noise_is_poisson(mean):
    sensor = Sensor(electrons=4000, full_well=8000, gain=1, bits=16)
    light = np.full((256, 256, 3), mean / 4000, np.float32)
    drawn = sensor.expose(light).ravel()
    mean = float(light[0, 0, 0]) * 4000
    most = int(mean + 8 * np.sqrt(mean) + 8)
    counted = np.bincount(drawn, minlength=most + 1)[: most + 1].cumsum() / drawn.size
    due = stats.poisson.cdf(np.arange(most + 1), mean)
    assert np.abs(counted - due).max() < 1.95 / np.sqrt(drawn.size) + 3e-4
    assert drawn.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / drawn.size))


def test_read_noise_is_normal_to_its_tails():
    sensor = Sensor(electrons=1, full_well=1e6, read_noise=500, gain=1, bits=16, black_level=3e4)
    codes = sensor.expose(np.zeros((256, 256, 3), np.float32)).ravel()
    spread = codes - 3e4 + np.random.default_rng(3).uniform(-0.5, 0.5, codes.size)
    assert stats.kstest(spread / 500, "norm").pvalue > 1e-3


def test_threads_change_nothing(monkeypatch):
    light = np.random.default_rng(2).random((64, 96, 3), np.float32)
    alone = NOISY.expose(light)
    monkeypatch.setattr("omniscv.parallel.cores", lambda: 7)
    monkeypatch.setattr("omniscv.parallel.MIN_PARALLEL_ELEMENTS", 1)
    np.testing.assert_array_equal(NOISY.expose(light), alone)


def test_another_seed_camera_or_frame_is_other_noise():
    light, fine = np.full((64, 64, 3), 0.5, np.float32), {**NOISY.to_dict(), "gain": 10, "bits": 16}
    one = Sensor(**fine).expose(light, camera="left", frame="f")
    for seed, camera, frame in ((6, "left", "f"), (5, "right", "f"), (5, "left", "g")):
        other = Sensor(**{**fine, "seed": seed}).expose(light, camera, frame)
        assert (one != other).mean() > 0.99


def test_frames_of_a_camera_share_fixed_patterns_alone():
    light = np.full((128, 128, 3), 0.5, np.float32)
    still = Sensor(electrons=2000, full_well=4000, prnu=0.05, gain=8, bits=16)
    a, b = (still.expose(light, "c", frame)[..., 1].astype(float) / 8 for frame in "ab")
    shared = np.cov(a.ravel(), b.ravel())
    assert np.sqrt(shared[0, 1]) == pytest.approx(0.05 * 1000, rel=0.05)
    temporal = (a - b) / np.sqrt(2)
    assert temporal.var() == pytest.approx(1000, rel=0.05)
    assert abs(np.corrcoef(temporal[:-1].ravel(), temporal[1:].ravel())[0, 1]) < 4 / 128


def test_the_noise_of_a_frame_stays_the_same():
    """Golden codes: a change of it changes every dataset that is resumed."""
    codes = NOISY.expose(np.full((4, 8, 3), 0.25, np.float32), "front", ["pose", 1.5])
    assert codes[0].tolist() == [535, 610, 580, 575, 563, 613, 583, 588]
