"""Fourier lines of records: back and forth, motions stay motions, the test band is the metrics' one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from rths_cli.analysis.fourier_lines import HIGHEST_HZ, Lines, lines_for
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.metrics import test_band as band_of
from rths_cli.numerics.lti import Array

DT_S = 1e-3


def slow(samples: int, seed: int = 3, high_hz: float = 20.0) -> Array:
    """Return a random series (2, n) without content above `high_hz`, at rest at both ends."""
    white = np.random.default_rng(seed).standard_normal((2, samples))
    smooth = sosfiltfilt(butter(6, high_hz, fs=1.0 / DT_S, output="sos"), white)
    return smooth * np.hanning(samples) ** 2


def test_the_series_of_the_lines_is_the_series() -> None:
    lines, given = lines_for(6000, DT_S, 2.0), slow(6000)
    found = lines.series(lines.of(given))
    at = np.arange(found.shape[1]) * lines.reduced_dt_s
    assert at[-1] < 6.0 <= at[-1] + lines.reduced_dt_s
    assert lines.reduced_dt_s > 10.0 * DT_S
    exact = np.array([np.interp(at, np.arange(6000) * DT_S, row) for row in given])
    assert np.abs(found - exact).max() < 3e-3 * np.abs(given).max()  # what straight lines between samples miss
    assert rms(found) == pytest.approx(rms(given), rel=2e-3)


def test_a_line_is_a_sinusoid_of_its_frequency() -> None:
    """Parseval too: amplitude a at line i is n a / 2 there and nothing elsewhere."""
    lines = Lines(4000, 4000, DT_S)
    i, a = 17, 0.3
    time = np.arange(4000) * DT_S
    found = np.fft.rfft(a * np.cos(2.0 * np.pi * lines.frequency_hz[i] * time))[: lines.count]
    assert lines.frequency_hz[i] == pytest.approx(i / 4.0)
    assert lines.z[i] == pytest.approx(np.exp(2j * np.pi * i / 4000))
    assert found[i] == pytest.approx(4000 * a / 2.0)
    assert rms(lines.series(found)) == pytest.approx(a / np.sqrt(2.0), rel=1e-9)
    assert lines.series(found)[0] == pytest.approx(a)


def test_what_does_not_end_at_zero_is_led_there() -> None:
    """A constant: half a cosine over half of the room that was added, so that no step is left."""
    lines = lines_for(4000, DT_S, 4.0)
    rest = lines.padded - 4000
    assert rest >= 4000
    whole = np.fft.irfft(np.concatenate([lines.of(np.ones(4000)), np.zeros(lines.padded // 2 + 1 - lines.count)]),
                         lines.padded)  # fmt: skip
    assert whole[500:3500] == pytest.approx(np.ones(3000), abs=0.01)
    assert whole[4000 + rest // 4] == pytest.approx(0.5, abs=0.01)
    assert whole[4000 + rest // 2 + 200 : -200] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("ring_s", [4.0, 4.001, 9.0])
def test_the_lines_are_those_of_the_whole_padded_transform(ring_s: float) -> None:
    """To rounding, for room of an even and an odd number of samples."""
    lines, given = lines_for(4000, DT_S, ring_s), np.random.default_rng(8).standard_normal((2, 4000)) + 1.0
    rest = lines.padded - 4000
    fade = [0.5 + 0.5 * np.cos(np.pi * min(2.0 * i / rest, 1.0)) for i in range(1, rest + 1)]
    exact = np.fft.rfft(np.hstack([given, np.outer(given[:, -1], fade)]))[:, : lines.count]
    assert np.abs(lines.of(given) - exact).max() < 1e-13 * np.abs(given).sum()


def test_a_motion_stays_one_beyond_its_end() -> None:
    """Velocity and acceleration are the derivatives of the displacement, on every line."""
    time = np.arange(5000) * DT_S
    w = 2.0 * np.pi * 1.24
    ramp = np.clip(time, 0.0, 1.0)
    rise, up, bend = ramp**3 * (10 - 15 * ramp + 6 * ramp**2), 30 * ramp**2 * (1 - ramp) ** 2, 60 * ramp * (1 - ramp)
    bend = bend * (1 - 2 * ramp)
    assert abs(np.sin(w * time[-1])) > 0.5
    wave, slope = np.sin(w * time), w * np.cos(w * time)
    displacement = rise * wave
    velocity = up * wave + rise * slope
    accel = bend * wave + 2 * up * slope - rise * w**2 * wave
    lines = lines_for(5000, DT_S, 5.0)
    a, v, d = lines.of_motion(accel, velocity, displacement)
    s = 2j * np.pi * lines.frequency_hz
    low = slice(1, round(15.0 * lines.padded * DT_S))
    assert np.abs(s * d - v)[low].max() < 1e-4 * np.abs(v).max()
    assert np.abs(s * v - a)[low].max() < 1e-4 * np.abs(a).max()
    found, step = lines.series(np.array([a, v, d])), lines.reduced_dt_s
    inside = np.arange(found.shape[1]) * step < 4.9
    for row, exact in zip(found, (accel, velocity, displacement), strict=True):
        wanted = np.interp(np.arange(found.shape[1]) * step, time, exact)
        assert np.abs(row - wanted)[inside].max() < 5e-3 * np.abs(exact).max()


def test_the_motion_is_at_rest_in_the_second_half_of_the_room() -> None:
    lines = lines_for(3000, DT_S, 3.0)
    time = np.arange(3000) * DT_S
    place = 0.5 * time**2
    found = lines.of_motion(np.ones(3000), time, place)[2]
    whole = np.fft.irfft(np.concatenate([found, np.zeros(lines.padded // 2 + 1 - lines.count)]), lines.padded)
    assert np.abs(whole[3000 + (lines.padded - 3000) // 2 + 200 : -200]).max() < 5e-3 * place[-1]
    assert whole[:2900] == pytest.approx(place[:2900], abs=5e-3 * place[-1])


@pytest.mark.parametrize("high_hz", [6.0, 20.0])
def test_the_test_band_is_that_of_the_metrics(high_hz: float) -> None:
    given = slow(8000, high_hz=high_hz)
    lines = lines_for(8000, DT_S, 2.0)
    found = lines.series(lines.of(given) * lines.test_band())
    assert rms(found) == pytest.approx(rms(band_of(given, DT_S)), rel=2e-3)
    if high_hz > 12.0:
        assert (rms(found) < 0.9 * rms(given)).all()


def test_the_gain_of_the_errors_high_pass_is_the_closed_form() -> None:
    lines = lines_for(20_000, DT_S, 10.0, 0.25)
    frequency_hz = np.maximum(lines.frequency_hz, 1e-9)
    assert lines.above_slow() == pytest.approx(1.0 / (1.0 + (0.25 / frequency_hz) ** 4), abs=1e-6)
    assert (lines_for(20_000, DT_S, 10.0).above_slow() == 1.0).all()


@pytest.mark.parametrize(("ring_s", "least", "most"), [(0.1, 2000, 2200), (3.0, 3000, 3300), (100.0, 6000, 6600)])
def test_room_is_between_one_and_three_records(ring_s: float, least: int, most: int) -> None:
    lines = lines_for(2000, DT_S, ring_s)
    assert least <= lines.padded - 2000 <= most
    assert lines.samples == 2000


def test_lines_end_at_the_highest_frequency_or_half_the_sample_rate() -> None:
    assert lines_for(2000, DT_S, 2.0).frequency_hz[-1] == pytest.approx(HIGHEST_HZ, abs=0.3)
    coarse = lines_for(600, 0.02, 2.0)
    assert coarse.count == coarse.padded // 2  # all but the line at half the sample rate, which has no phase
