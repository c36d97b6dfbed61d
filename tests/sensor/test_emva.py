"""EMVA 1288's own software measures what a sensor was set to."""

import numpy as np
import pytest
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.results import Results1288

from omniscv.sensor import Sensor

SIZE, QUANTUM_EFFICIENCY = 256, 0.5


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


def test_dark_current_adds_its_own_shot_noise():
    dark = {"dark_current": 2000, "exposure_s": 0.5, "black_level": 50}
    sensor = Sensor(full_well=5000, gain=2, bits=16, mosaic="mono", **dark)
    a, b = (codes.astype(float) / 2 for codes in frames(sensor, 0, 2))
    assert a.mean() - 25 == pytest.approx(1000, rel=2e-3)
    assert (a - b).var() / 2 == pytest.approx(1000, rel=0.03)


def test_row_noise_is_one_draw_a_row():
    sensor = Sensor(row_noise=30, full_well=10_000, gain=2, bits=16, black_level=500, mosaic="mono")
    (codes,) = frames(sensor, 0, 1)
    assert (codes == codes[:, :1]).all()
    assert codes[:, 0].std() / 2 == pytest.approx(30, rel=4 / np.sqrt(2 * SIZE))


def test_a_full_well_holds_no_more():
    sensor = Sensor(electrons=20_000, full_well=10_000, gain=0.2, black_level=20)
    (codes,) = frames(sensor, 20_000, 1)
    assert (codes == 2020).all()


def test_a_global_shutters_preset_has_its_data_sheets_dynamic_range():
    for name, decibel, snr in (("imx250", 71.2, 40.3), ("imx249", 73.0, 45.1)):
        sensor = Sensor(preset=name)
        dark = np.sqrt(sensor.read_noise**2 + 1 / 12 / sensor.gain**2)
        assert 20 * np.log10(sensor.full_well / (dark + 0.5)) == pytest.approx(decibel, abs=0.05)
        assert 10 * np.log10(sensor.full_well) == pytest.approx(snr, abs=0.01)
