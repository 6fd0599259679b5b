"""Excitation plans against spectra by an independent estimate and against the limits they must keep."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from made_records import make_info, make_specimen
from scipy.signal import periodogram, welch

from rths_cli.errors import InputError
from rths_cli.identification.excitation import Excitation, ExcitationSettings, Kind, make_signal, multisine, plan

SPECIMEN = make_specimen()
SMOOTH = make_info(SPECIMEN, bits=0)
SHORT = ExcitationSettings(duration_s=60.0)
KINDS: tuple[Kind, ...] = ("noise", "multisine", "sweep", "step")
MASS_KG = 7.0 + 6.91 + 6.95


def power(command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies and the power spectral density in V^2/Hz."""
    return welch(command, 1.0 / SMOOTH.dt_s, nperseg=20000)


def motion(command: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nominal displacement, velocity and acceleration of a command."""
    place = SMOOTH.gain_m_per_v * command
    velocity = np.gradient(place, SMOOTH.dt_s)
    return place, velocity, np.gradient(velocity, SMOOTH.dt_s)


def rms_below_12_hz(made: Excitation) -> float:
    """Return the level of a plan's signal by the periodogram of its acceleration."""
    accel = motion(made.command_v)[2][made.parts.noise]
    f, density = periodogram(accel, 1.0 / made.dt_s)
    return float(np.sqrt(density[f <= 12.0].sum() * f[1]))


def test_default_plan_keeps_its_bytes() -> None:
    made = plan(make_info(SPECIMEN), ExcitationSettings(), 0)
    digest = "c5f9e0c3de4d3d0faaffa7e87728cf5bb86a33761b32c7aff84706d8302ede5a"  # results made so far depend on it
    assert hashlib.sha256(made.command_v.tobytes()).hexdigest() == digest
    assert (made.parts.noise, made.parts.free_vibration) == (slice(4000, 244000), slice(253000, 285000))
    assert made.parts.period_samples == 0
    assert made.accel_rms_m_s2 == 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_the_level_asked_for(kind: Kind) -> None:
    made = plan(SMOOTH, replace(SHORT, kind=kind, accel_rms_m_s2=0.7), 3)
    assert made.notes == ()
    assert made.accel_rms_m_s2 == 0.7
    # np.gradient twice sees the acceleration through cos(pi f dt)^2, 0.04 % less at 12 Hz
    assert rms_below_12_hz(made) == pytest.approx(0.7, rel=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_given_level_replaces_that_of_the_settings(kind: Kind) -> None:
    settings = replace(SHORT, kind=kind)
    made = plan(SMOOTH, settings, 1, level=0.5)
    assert rms_below_12_hz(made) == pytest.approx(0.5, rel=2e-3)
    assert np.array_equal(made.command_v, plan(SMOOTH, replace(settings, accel_rms_m_s2=0.5), 1).command_v)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("field", "limit"), [("stroke_m", 0.01), ("velocity_m_s", 0.1)])
def test_every_kind_keeps_its_share_of_what_its_command_says(kind: Kind, seed: int, field: str, limit: float) -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, **{field: limit}))
    made = plan(info, replace(SHORT, duration_s=42.0, period_s=14.0, kind=kind, accel_rms_m_s2=4.0), seed)
    place, velocity, _ = (np.abs(values).max() for values in motion(made.command_v))
    predicted = {"stroke_m": place, "velocity_m_s": velocity}
    # 2 % for what np.gradient loses of the peaks near 60 Hz
    assert predicted[field] == pytest.approx(0.6 * limit, rel=0.02)
    assert place <= 0.6 * 0.079 * 1.0001
    name = field.split("_")[0]
    assert f"60 % of the {name} limit" in str(made.notes[-1])
    assert made.reach[name].share == pytest.approx(0.6)


@pytest.mark.parametrize("kind", KINDS)
def test_reach_tells_the_peaks_of_the_whole_plan(kind: Kind) -> None:
    made = plan(SMOOTH, replace(SHORT, kind=kind), 2)
    place, velocity, accel = (float(np.abs(values).max()) for values in motion(made.command_v))
    expected = {
        "stroke": (place, 0.079, "m"),
        "velocity": (velocity, 1.0, "m/s"),
        "acceleration": (2.0 * accel, 45.0, "m/s^2"),
        "sensor range": (2.0 * accel, 5.0 * 9.80665, "m/s^2"),
        "force": (MASS_KG * accel, 445.0, "N"),
        "command range": (np.abs(made.command_v).max(), 10.0, "V"),
    }
    assert made.reach.keys() == expected.keys()
    for name, (predicted, limit, unit) in expected.items():
        assert made.reach[name].predicted == pytest.approx(predicted, rel=0.02), name
        assert made.reach[name][1:] == (pytest.approx(limit), unit)
        assert made.reach[name].share == made.reach[name].predicted / made.reach[name].limit
        assert made.reach[name].share <= 0.6 * (1.0 + 1e-12) or name in ("acceleration", "sensor range", "force")


@pytest.mark.parametrize("kind", ["multisine", "sweep"])
def test_periodic_kinds_repeat_bit_by_bit_after_a_period_to_settle(kind: Kind) -> None:
    made = plan(make_info(SPECIMEN), replace(SHORT, duration_s=75.0, period_s=20.0, kind=kind), 0)
    parts, n = made.parts, 40000
    steady = made.command_v[parts.noise]
    assert str(made.notes[0]) == "excitation of 60 instead of 75 s: whole periods of 20 s"
    assert (parts.period_samples, parts.segment_samples) == ((n, 0) if kind == "multisine" else (0, n // 10))
    assert len(steady) == 3 * n
    assert np.array_equal(steady[:n], steady[n : 2 * n])
    assert np.array_equal(steady[:n], steady[2 * n :])
    settling = made.command_v[parts.noise.start - n : parts.noise.start]
    assert parts.noise.start - n == parts.silence.stop == 4000
    assert np.array_equal(settling[4000:], steady[4000:n])  # all but the fade of 2 s
    assert np.abs(np.diff(made.command_v[: parts.noise.start + 1])).max() < 0.1
    assert np.ptp(made.command_v[parts.free_vibration]) == 0.0


@pytest.mark.parametrize("kind", ["multisine", "sweep"])
def test_steady_periods_hold_lines_of_the_period_only(kind: Kind) -> None:
    made = plan(SMOOTH, replace(SHORT, kind=kind), 0)
    lines = np.abs(np.fft.rfft(made.command_v[made.parts.noise]))
    lines[::3] = 0.0
    assert lines.max() < 1e-9 * np.abs(np.fft.rfft(made.command_v)).max()


def test_multisine_draws_reach_a_higher_level_than_one() -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, stroke_m=0.01))
    random = np.random.default_rng(99)
    periods = [multisine(20.0, info.dt_s, 0.3, 60.0, random) for _ in range(20)]
    crest = [np.abs(p).max() / p.std() for p in periods]
    found = [
        make_signal(info, replace(SHORT, kind="multisine"), np.random.default_rng(seed)).command_v[40000:80000]
        for seed in range(4)
    ]
    gain = np.median(crest) / np.array([np.abs(p).max() / p.std() for p in found])
    assert 1.15 < gain.mean() < 1.35


def test_burst_keeps_its_share_when_the_signal_could_be_louder() -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, velocity_m_s=0.1))
    made = plan(info, replace(SHORT, kind="multisine", accel_rms_m_s2=4.0), 2)
    signal, burst = made.stretches
    velocities = [np.abs(motion(made.command_v[part.samples])[1]).max() for part in (signal, burst)]
    assert velocities == pytest.approx([0.06, 0.06], rel=0.005)
    assert burst.level_m_s2 < 0.98 * signal.level_m_s2


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


@pytest.mark.parametrize("limits", [{"force_n": 20.0}, {"acceleration_m_s2": 1.0}])
def test_what_a_command_does_not_say_is_left_to_the_probe(limits: dict[str, float]) -> None:
    made = plan(replace(SMOOTH, limits=replace(SMOOTH.limits, **limits)), SHORT, 0)
    assert made.accel_rms_m_s2 == 2.0
    assert made.notes == ()


def test_small_stroke_scales_the_noise_down() -> None:
    info = replace(SMOOTH, limits=replace(SMOOTH.limits, stroke_m=0.02))
    made = plan(info, SHORT, 0)
    assert "stroke" in str(made.notes[0])
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


def test_a_small_stroke_and_a_coarse_converter_leave_a_small_plan() -> None:
    made = plan(make_info(SPECIMEN, bits=12, stroke_m=0.002), SHORT, 0)
    assert 0.0 < made.accel_rms_m_s2 < 0.2
    assert "stroke limit" in str(made.notes[0])


@pytest.mark.parametrize(
    ("change", "sentences"),
    [
        ({"kind": "chirp"}, ["identification.kind: 'chirp' must be one of noise, multisine, sweep, step"]),
        (
            {"kind": "multisine", "duration_s": 59.0},
            [
                "identification.duration_s: 59 s must hold 3 periods of period_s 20 s for a multisine; "
                "give at least 60 s"
            ],
        ),
        (
            {"kind": "sweep", "period_s": 10.0},
            ["identification.period_s: 10 s must hold 4 cycles of low_hz 0.3 Hz; give at least 13.34 s"],
        ),
        (
            {"kind": "sweep", "period_s": float("nan")},
            ["identification.period_s: nan s must hold 4 cycles of low_hz 0.3 Hz; give at least 13.34 s"],
        ),
    ],
)
def test_kinds_and_periods_that_cannot_be_are_named(change: dict[str, object], sentences: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        plan(SMOOTH, replace(SHORT, **change), 0)
    assert list(caught.value.faults) == sentences


def test_all_faults_are_named_at_once() -> None:
    settings = ExcitationSettings(30.0, 0.0, 2.0, 10.0, kind="sweep", period_s=-5.0)
    with pytest.raises(InputError) as caught:
        plan(SMOOTH, settings, 0)
    named = {fault.partition(":")[0].removeprefix("identification.") for fault in caught.value.faults}
    assert named == {"duration_s", "accel_rms_m_s2", "low_hz", "high_hz", "period_s"}


def test_period_does_not_matter_to_noise() -> None:
    assert np.array_equal(plan(SMOOTH, replace(SHORT, period_s=0.0), 0).command_v, plan(SMOOTH, SHORT, 0).command_v)


def test_a_plan_that_would_be_too_large_is_refused_before_it_is_made() -> None:
    fast = replace(SMOOTH, dt_s=1.0 / 50_000.0)
    with pytest.raises(InputError, match=r"identification.duration_s: 3600 s at 50000 Hz make 7.2e\+08 values"):
        plan(fast, replace(SHORT, duration_s=3600.0), 0)
    tall = replace(SMOOTH, channels=SMOOTH.channels[:1] * 42)
    with pytest.raises(InputError, match=r"structure.experimental: 41 floors on the table, at most 40"):
        plan(tall, SHORT, 0)
