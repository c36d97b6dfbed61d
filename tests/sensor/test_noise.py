"""Noise is a function of what a frame is; EMVA 1288's own software measures what a sensor was set to."""

import numpy as np
import pytest
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.results import Results1288
from scipy import stats

from omniscv.sensor import Sensor

NOISY = Sensor(
    seed=5, electrons=2000, full_well=4000, read_noise=4, row_noise=2, prnu=0.02, dsnu=3, dark_current=50,
    black_level=64, mosaic="rggb",
)  # fmt: skip


@pytest.mark.parametrize("mean", [0.3, 9.99, 10.0, 1000.0])
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


def test_noise_stays_the_same_but_of_another_seed_camera_or_frame():
    """Golden codes: a change of it changes every dataset that is resumed."""
    codes = NOISY.expose(np.full((4, 8, 3), 0.25, np.float32), "front", ["pose", 1.5])
    assert codes[0].tolist() == [535, 610, 580, 575, 563, 613, 583, 588]
    light = np.full((64, 64, 3), 0.5, np.float32)
    fine = {**NOISY.to_dict(), "gain": 10, "bits": 16}
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


SIZE = 256
QUANTUM_EFFICIENCY = 0.5


def frames(sensor, electrons, count, first=0):
    """Codes of evenly lit frames with so many electrons a pixel."""
    light = np.full((SIZE, SIZE, 3), electrons / sensor.electrons, np.float32)
    return [sensor.expose(light, "dut", first + i) for i in range(count)]


def measured(sensor, levels, folder, spatial=16):
    """What the software reads of frames: two of each level, stacks at half of saturation and in the dark."""

    def stack(electrons, count):
        paths = [folder / f"{electrons}-{i}.npy" for i in range(count)]
        for path, codes in zip(paths, frames(sensor, electrons, count, int(electrons) * 1000), strict=True):
            np.save(path, codes)
        return [str(path) for path in paths]

    photons = {level / QUANTUM_EFFICIENCY: stack(level, 2) for level in levels}
    half = max(levels) / 2 + 1
    stacks = {0.0: stack(0.25, spatial), half / QUANTUM_EFFICIENCY: stack(half, spatial)}
    images = {"temporal": {1.0: photons}, "spatial": {1.0: stacks}, "width": SIZE, "height": SIZE, "bits": 12}
    loaded = LoadImageData(images, fload=np.load)
    return Results1288(Data1288(loaded.data).data)


def test_the_standards_software_measures_the_parameters(tmp_path, monkeypatch):
    # The software calls what NumPy 2 has no more.
    monkeypatch.setattr(np, "asfarray", lambda values: np.asarray(values, float), raising=False)
    noise = {"read_noise": 5, "prnu": 0.01, "dsnu": 4}
    sensor = Sensor(electrons=10_000, full_well=10_000, gain=0.2, black_level=20, mosaic="mono", **noise)
    results = measured(sensor, [*np.linspace(0, 9_000, 13), 9_600, 9_700, 9_800, 10_500], tmp_path)
    assert pytest.approx(0.2, rel=0.01) == results.K
    assert results.sigma_d == pytest.approx(5, rel=0.02)
    assert pytest.approx(50, rel=0.01) == results.QE
    assert results.sigma_y_dark**2 == pytest.approx(1.08333, rel=0.02)
    assert pytest.approx(1.0, rel=0.03) == results.PRNU1288
    assert pytest.approx(4, rel=0.03) == results.DSNU1288
    assert results.u_p_min == pytest.approx(11.408, rel=0.02)
    # Saturation is the level of most variance: the well clips noise from 3 standard deviations below it on.
    assert results.DR_dB() == pytest.approx(64.88, abs=0.4)
    assert results.SNR_max_dB() == pytest.approx(40, abs=0.2)


def test_dark_current_row_noise_and_a_full_well():
    dark = {"dark_current": 2000, "exposure_s": 0.5, "black_level": 50}
    sensor = Sensor(full_well=5000, gain=2, bits=16, mosaic="mono", **dark)
    a, b = (codes.astype(float) / 2 for codes in frames(sensor, 0, 2))
    assert a.mean() - 25 == pytest.approx(1000, rel=2e-3)
    assert (a - b).var() / 2 == pytest.approx(1000, rel=0.03)
    sensor = Sensor(row_noise=30, full_well=10_000, gain=2, bits=16, black_level=500, mosaic="mono")
    (codes,) = frames(sensor, 0, 1)
    assert (codes == codes[:, :1]).all()
    assert codes[:, 0].std() / 2 == pytest.approx(30, rel=4 / np.sqrt(2 * SIZE))
    (codes,) = frames(Sensor(electrons=20_000, full_well=10_000, gain=0.2, black_level=20), 20_000, 1)
    assert (codes == 2020).all()


def test_a_global_shutters_preset_has_its_data_sheets_dynamic_range():
    for name, decibel, snr in (("imx250", 71.2, 40.3), ("imx249", 73.0, 45.1)):
        sensor = Sensor(preset=name)
        dark = np.sqrt(sensor.read_noise**2 + 1 / 12 / sensor.gain**2)
        assert 20 * np.log10(sensor.full_well / (dark + 0.5)) == pytest.approx(decibel, abs=0.05)
        assert 10 * np.log10(sensor.full_well) == pytest.approx(snr, abs=0.01)
