"""The correction of known sensor corners, as a frequency response."""

from __future__ import annotations

import numpy as np
import pytest
from bench import rig_info
from numpy.testing import assert_allclose

from rths_cli.control.latency_budget import converter_s, hold_s, sensor_s
from rths_cli.control.sensor_correction import correction

BAND_HZ = np.linspace(0.05, 12.0, 240)


def sensor(frequency_hz: np.ndarray, high_pass_hz: float, low_pass_hz: float) -> np.ndarray:
    """Return the accelerometer's response in V per m/s^2, 1000 mV/g."""
    s = 2j * np.pi * frequency_hz
    value = s / (s + 2.0 * np.pi * high_pass_hz) / 9.80665
    return value / (1.0 + s / (2.0 * np.pi * low_pass_hz)) if low_pass_hz else value


@pytest.mark.parametrize(
    ("rate_hz", "gain_limit", "degrees_limit"),
    [(500.0, 1e-5, 0.0038), (1000.0, 1.2e-6, 9.5e-4), (2000.0, 2e-7, 2.5e-4), (4000.0, 5e-8, 7e-5)],
)
def test_correction_times_sensor_is_one_in_the_band(rate_hz: float, gain_limit: float, degrees_limit: float) -> None:
    info = rig_info(dt_s=1.0 / rate_hz)
    block = correction(info.channels, info.dt_s)
    product = block.response(BAND_HZ) * sensor(BAND_HZ, 0.024, 1549.0)
    for channel in range(3):
        assert np.abs(np.abs(product[channel, channel]) - 1.0).max() < gain_limit
        assert np.degrees(np.abs(np.angle(product[channel, channel]))).max() < degrees_limit
    off = product[~np.eye(3, dtype=bool)]
    assert np.abs(off).max() == 0.0


@pytest.mark.parametrize(("high_pass_hz", "low_pass_hz"), [(0.0, 0.0), (0.024, 0.0), (0.0, 1549.0)])
def test_a_corner_that_is_not_there_is_not_corrected(high_pass_hz: float, low_pass_hz: float) -> None:
    info = rig_info(high_pass_hz=high_pass_hz, low_pass_hz=low_pass_hz)
    product = correction(info.channels, info.dt_s).response(BAND_HZ)[0, 0] * sensor(BAND_HZ, high_pass_hz, low_pass_hz)
    limit = 5e-6 if low_pass_hz else 3e-6
    assert np.abs(product - 1.0).max() < (limit if high_pass_hz or low_pass_hz else 1e-12)


def test_a_constant_that_the_sensor_forgets_comes_back() -> None:
    """AC coupling lets a step decay with 6.6 s; corrected, it stands."""
    info = rig_info(low_pass_hz=0.0)
    block = correction(info.channels, info.dt_s)
    time = np.arange(40000) * info.dt_s
    sample = np.exp(-2.0 * np.pi * 0.024 * time) / 9.80665
    state, corrected = np.zeros(len(block.A)), np.zeros(40000)
    for k in range(40000):
        u = np.full(3, sample[k])
        corrected[k] = block.C[0] @ state + block.D[0] @ u
        state = block.A @ state + block.B @ u
    assert_allclose(corrected[1:], np.ones(39999), rtol=0, atol=1e-4)


def test_latencies_are_those_of_the_rig() -> None:
    info = rig_info(latency_samples=2)
    assert converter_s(info) == pytest.approx(1e-3)
    assert hold_s(info) == pytest.approx(0.25e-3)
    assert sensor_s(info) == pytest.approx(0.10275e-3, rel=1e-4)
    assert sensor_s(rig_info(low_pass_hz=0.0)) == 0.0
