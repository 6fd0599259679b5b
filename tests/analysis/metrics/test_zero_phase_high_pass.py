"""The zero-phase high pass of errors. Oracles: its closed form for sines, scipy's filter, parabolas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from rths_cli.analysis.metrics import error_figures, figures_of_pairs, high_passed, rms

DT_S, CORNER_HZ = 1e-3, 0.1
TIME_S = DT_S * np.arange(54_321)
INSIDE = slice(10_000, -10_000)


def noise(seed: int) -> np.ndarray:
    sections = butter(4, [0.15, 8.0], "band", fs=1.0 / DT_S, output="sos")
    return np.asarray(sosfiltfilt(sections, np.random.default_rng(seed).standard_normal(TIME_S.size)))


@pytest.mark.parametrize("frequency_hz", [0.1, 0.2, 0.5, 2.0, 40.0])
def test_a_sine_keeps_its_phase_and_loses_what_the_formula_says(frequency_hz: float) -> None:
    wave = np.sin(2.0 * np.pi * frequency_hz * TIME_S)
    expected = wave / (1.0 + (CORNER_HZ / frequency_hz) ** 4)
    assert np.abs(high_passed(wave, CORNER_HZ, DT_S) - expected)[INSIDE].max() < 0.03


def test_it_is_scipys_filter_forward_and_backward() -> None:
    series = noise(1)
    sections = butter(2, CORNER_HZ, "high", fs=1.0 / DT_S, output="sos")
    expected = sosfiltfilt(sections, series, padtype="even", padlen=30_000)
    assert rms((high_passed(series, CORNER_HZ, DT_S) - expected)[INSIDE]) < 2e-3 * rms(series)


@pytest.mark.parametrize("power", [0, 1, 2])
def test_offset_line_and_parabola_leave_nothing_not_even_at_the_ends(power: int) -> None:
    series = noise(2)
    drifting = series + 50.0 * rms(series) * (TIME_S / TIME_S[-1]) ** power
    off = high_passed(drifting, CORNER_HZ, DT_S) - high_passed(series, CORNER_HZ, DT_S)
    assert np.abs(off).max() < 1e-3 * rms(series)


def test_errors_of_drifting_samples_are_those_of_the_others_in_both_bands_and_ways() -> None:
    reference, value = np.array([noise(3), noise(4)]), np.array([noise(5), noise(6)])
    parabola = 0.2 * (TIME_S / TIME_S[-1]) ** 2
    clean = error_figures(reference, value, DT_S, CORNER_HZ)
    found = error_figures(reference, value + parabola, DT_S, CORNER_HZ)
    for name in ("rms", "maximum", "rms_full", "maximum_full"):
        assert getattr(found, name) == pytest.approx(getattr(clean, name), rel=1e-5)
    assert clean.rms_full == pytest.approx(rms(high_passed(reference - value, CORNER_HZ, DT_S)), rel=1e-9)
    pairs = figures_of_pairs(list(zip(reference, value, strict=True)), DT_S, high_pass_hz=CORNER_HZ)
    assert np.array_equal(pairs.rms, clean.rms)
    offset = error_figures(reference, value + 0.1, DT_S)
    assert np.all(offset.rms > 0.09)  # without a high pass, an offset shows


def test_a_corner_of_zero_is_none_a_short_series_is_taken_and_a_cut_one_stays_cut() -> None:
    series = noise(7)
    assert np.array_equal(high_passed(series, 0.0, DT_S), series)
    assert np.abs(high_passed(np.full(3, 2.0), CORNER_HZ, DT_S)).max() < 1e-12
    series[-5:] = np.nan
    assert np.isnan(high_passed([series, noise(8)], CORNER_HZ, DT_S)).all(axis=1).tolist() == [True, False]
