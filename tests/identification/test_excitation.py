"""Excitation plans against spectra by an independent estimate and against the limits they must keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_records import make_info, make_specimen
from scipy.signal import welch

from rths_cli.errors import InputError
from rths_cli.identification.excitation import ExcitationSettings, plan

SPECIMEN = make_specimen()
SMOOTH = make_info(SPECIMEN, bits=0)
SHORT = ExcitationSettings(duration_s=60.0)


def power(command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies and the power spectral density in V^2/Hz."""
    return welch(command, 1.0 / SMOOTH.dt_s, nperseg=20000)


def test_noise_has_the_level_asked_for() -> None:
    made = plan(SMOOTH, SHORT, 3)
    f, density = power(made.command_v[made.parts.noise])
    below = (f > 0.2) & (f <= 12.0)
    accel = (2.0 * np.pi * f[below]) ** 4 * density[below] * SMOOTH.gain_m_per_v**2
    assert made.notes == ()
    assert np.sqrt(np.trapezoid(accel, f[below])) == pytest.approx(2.0, rel=0.03)


def test_noise_falls_as_stated() -> None:
    made = plan(SMOOTH, ExcitationSettings(duration_s=200.0), 4)
    f, density = power(made.command_v[made.parts.noise])
    for low, high, slope in ((1.0, 10.0, -3.0), (14.0, 55.0, -7.0)):
        inside = (f >= low) & (f <= high)
        assert np.polyfit(np.log(f[inside]), np.log(density[inside]), 1)[0] == pytest.approx(slope, abs=0.15)
    assert density[f > 65.0].max() < 1e-6 * density[(f > 50.0) & (f < 58.0)].mean()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_plan_keeps_its_share_of_every_limit(seed: int) -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, force_n=200.0))
    made = plan(info, SHORT, seed)
    place = info.gain_m_per_v * made.command_v
    velocity, accel = np.gradient(place, info.dt_s), np.gradient(np.gradient(place, info.dt_s), info.dt_s)
    assert len(made.notes) == 1
    assert "force" in made.notes[0]
    assert np.abs(accel).max() * 20.86 == pytest.approx(0.6 * 200.0, rel=0.02)
    assert np.abs(place).max() <= 0.6 * 0.079
    assert np.abs(velocity).max() <= 0.6


def test_small_stroke_scales_the_noise_down() -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, stroke_m=0.02))
    made = plan(info, SHORT, 0)
    assert "stroke" in made.notes[0]
    assert made.accel_rms_m_s2 < 1.5
    assert info.gain_m_per_v * np.abs(made.command_v).max() == pytest.approx(0.012, rel=1e-6)


def test_parts_are_silence_noise_and_hold() -> None:
    made = plan(SMOOTH, SHORT, 0)
    parts = made.parts
    assert np.all(made.command_v[parts.silence] == 0.0)
    assert np.ptp(made.command_v[parts.free_vibration]) == 0.0
    assert (parts.free_vibration.stop - parts.free_vibration.start) * made.dt_s >= 15.0
    assert (parts.noise.stop - parts.noise.start) * made.dt_s == pytest.approx(60.0)
    before = made.command_v[parts.free_vibration.start - 4000 : parts.free_vibration.start]
    assert before.std() > 0.05  # the burst
    assert np.abs(np.diff(made.command_v)).max() * SMOOTH.gain_m_per_v < 0.6 * 1.0 * SMOOTH.dt_s


def test_command_is_a_whole_number_of_bits_and_repeats_with_its_seed() -> None:
    info = make_info(SPECIMEN)
    made, again, other = plan(info, SHORT, 5), plan(info, SHORT, 5), plan(info, SHORT, 6)
    bits = made.command_v / (20.0 / 65536)
    assert np.abs(bits - np.round(bits)).max() < 1e-6
    assert np.abs(made.command_v - plan(SMOOTH, SHORT, 5).command_v).max() <= 0.5001 * 20.0 / 65536
    assert np.array_equal(made.command_v, again.command_v)
    assert np.corrcoef(made.command_v, other.command_v)[0, 1] < 0.5


@pytest.mark.parametrize(
    ("field", "value"),
    [("duration_s", 20.0), ("low_hz", 5.0), ("high_hz", 15.0), ("high_hz", 900.0), ("accel_rms_m_s2", -1.0)],
)
def test_settings_out_of_range_are_named(field: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        plan(SMOOTH, replace(SHORT, **{field: value}), 0)
    assert len(caught.value.faults) == 1
    assert f"identification.{field}: {value:g}" in caught.value.faults[0]


def test_level_that_drowns_in_the_bits_is_refused() -> None:
    info = make_info(SPECIMEN, stroke_m=0.002)
    with pytest.raises(InputError, match="stroke limit"):
        plan(info, SHORT, 0)
