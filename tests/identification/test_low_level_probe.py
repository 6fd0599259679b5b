"""Probe and choice of level against a made-up linear rig whose gain, delay and floors are known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from made_records import make_info, make_specimen
from portfolio import parametrize_first
from scipy.signal import bilinear, lfilter, periodogram

from rths_cli.errors import InputError
from rths_cli.findings import sentences
from rths_cli.identification.excitation import Excitation, ExcitationSettings, Kind, plan, shaped_noise
from rths_cli.identification.low_level_probe import choose_level, expected, measured_gain, overdriven, probe_plan
from rths_cli.identification.record_parts import Record
from rths_cli.rigs.description import RigInfo

INFO = make_info(make_specimen(stiffness=(7331.56,), ratios=(0.04,)))  # a table and one floor
MASS_KG = 7.0 + 6.91
DT = INFO.dt_s
SETTINGS = ExcitationSettings(duration_s=60.0)
RANGE_M_S2 = 5.0 * 9.80665


@dataclass(frozen=True)
class MadeRig:
    """A table that is late by 4 samples and follows with a loop of 14 Hz, and a floor that resonates on it."""

    gain_ratio: float = 1.0
    floor_hz: float = 5.0
    floor_damping: float = 0.04
    loop_hz: float = 14.0
    noise_m_s2: float = 1e-3
    most_m_s2: float = np.inf  # at which the actuator's force ends
    friction_m_s2: float = 0.0

    def play(self, command_v: np.ndarray) -> np.ndarray:
        """Return the accelerations (2, n) of table and floor in m/s^2."""
        w, z = 2.0 * np.pi * self.loop_hz, 0.6
        late = np.concatenate([np.zeros(4), command_v])[: len(command_v)]
        b, a = bilinear([w * w, 0.0, 0.0], [1.0, 2.0 * z * w, w * w], 1.0 / DT)
        table = lfilter(b, a, 0.0079 * self.gain_ratio * late).clip(-self.most_m_s2, self.most_m_s2)
        table = table - self.friction_m_s2 * np.tanh(np.cumsum(table) * DT / 1e-3)
        v, y = 2.0 * np.pi * self.floor_hz, self.floor_damping
        b, a = bilinear([2.0 * y * v, v * v], [1.0, 2.0 * y * v, v * v], 1.0 / DT)
        noise = np.random.default_rng(5).standard_normal((2, len(command_v)))
        return np.vstack([table, lfilter(b, a, table)]) + self.noise_m_s2 * noise


def chosen(rig: MadeRig, info: RigInfo = INFO, kind: Kind = "noise", wanted: float = 2.0) -> tuple[object, Excitation]:
    """Return the level chosen from a probe of a rig, and the plan made with it."""
    settings = replace(SETTINGS, kind=kind, accel_rms_m_s2=wanted)
    probe = probe_plan(info, settings, 0)
    level = choose_level(info, probe, rig.play(probe.command_v), wanted, plan(info, settings, 0))
    return level, plan(info, settings, 0, level.accel_rms_m_s2)


def rms_below_12_hz(command_v: np.ndarray) -> float:
    """Return the level of a smooth command by the periodogram of its acceleration."""
    accel = 0.0079 * np.gradient(np.gradient(command_v, DT), DT)
    f, density = periodogram(accel, 1.0 / DT)
    return float(np.sqrt(density[f <= 12.0].sum() * f[1]))


def test_probe_is_a_fifth_of_the_level_between_rests() -> None:
    smooth = replace(INFO, converters=replace(INFO.converters, bits=0))
    probe = probe_plan(smooth, SETTINGS, 0)
    assert (probe.parts.silence, probe.parts.noise) == (slice(0, 4000), slice(4000, 44000))
    assert probe.parts.free_vibration is None
    assert len(probe.command_v) == 50000
    assert np.all(probe.command_v[:4000] == 0.0)
    assert np.all(probe.command_v[44000:] == 0.0)
    assert rms_below_12_hz(probe.command_v[probe.parts.noise]) == pytest.approx(0.4, rel=2e-3)
    assert probe.accel_rms_m_s2 == pytest.approx(0.4)
    assert probe.notes == ()
    place = 0.0079 * np.abs(probe.command_v).max()
    assert probe.reach["stroke"].predicted == pytest.approx(place, rel=1e-9)


def test_probe_has_a_random_stream_of_its_own() -> None:
    probe, again, other = (probe_plan(INFO, SETTINGS, seed).command_v for seed in (0, 0, 1))
    noise = shaped_noise(20.0, DT, 0.3, 60.0, np.random.default_rng(0))
    assert np.array_equal(probe, again)
    assert abs(np.corrcoef(probe, other)[0, 1]) < 0.5
    assert abs(np.corrcoef(probe[4000:44000], noise)[0, 1]) < 0.5


def test_a_coarse_converter_asks_for_a_louder_probe_but_never_for_more_than_half() -> None:
    bit = (20.0 / 4096) * 9.80665
    coarse = replace(INFO, converters=replace(INFO.converters, bits=12))
    probe = probe_plan(coarse, SETTINGS, 0)
    assert probe.accel_rms_m_s2 == pytest.approx(10.0 * bit)
    assert sentences(probe.notes) == (
        "probe played at 0.48 m/s^2 rms, more than 20 % of the 2 wanted or of what the limits allow: the converters "
        "are coarse",
    )
    assert probe_plan(coarse, replace(SETTINGS, accel_rms_m_s2=0.5), 0).accel_rms_m_s2 == pytest.approx(0.25)
    assert probe_plan(INFO, replace(SETTINGS, accel_rms_m_s2=0.2), 0).accel_rms_m_s2 == pytest.approx(0.04)


def test_probe_is_a_fifth_of_what_the_limits_allow() -> None:
    smooth = replace(INFO, converters=replace(INFO.converters, bits=0))
    probe = probe_plan(smooth, replace(SETTINGS, accel_rms_m_s2=1e3), 0)
    place = 0.0079 * probe.command_v
    accel = np.gradient(np.gradient(place, DT), DT)
    shares = np.abs(place).max() / 0.079, MASS_KG * np.abs(accel).max() / 445.0, 2.0 * np.abs(accel).max() / 45.0
    assert max(shares) == pytest.approx(0.2 * 0.6, rel=0.02)
    assert max(entry.share for entry in probe.reach.values()) == pytest.approx(0.12)


@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.7])
def test_gain_is_measured(ratio: float) -> None:
    probe = probe_plan(INFO, SETTINGS, 0)
    found = measured_gain(INFO, probe, MadeRig(ratio).play(probe.command_v)[0])
    f = np.linspace(0.7, 2.0, 50) / 14.0
    loop = np.abs(1.0 / (1.0 - f**2 + 1.2j * f)).mean()
    assert found == pytest.approx(0.0079 * ratio * loop, rel=1e-3)


@pytest.mark.parametrize("kind", ["noise", "multisine", "sweep", "step"])
def test_channels_show_what_was_expected_of_them(kind: Kind) -> None:
    rig, probe, loud = MadeRig(), probe_plan(INFO, SETTINGS, 0), plan(INFO, replace(SETTINGS, kind=kind), 0)
    lines = np.fft.rfft(rig.play(loud.command_v))
    lines[:, np.fft.rfftfreq(len(loud.command_v), DT) > 60.0] = 0.0
    played = np.fft.irfft(lines, len(loud.command_v))
    error = np.abs(expected(INFO, probe, rig.play(probe.command_v), loud) - played).max(axis=1)
    assert np.all(error < 0.01 * np.abs(played).max(axis=1))


def test_nothing_limits_a_level_that_fits() -> None:
    level, _ = chosen(MadeRig())
    assert level.accel_rms_m_s2 == 2.0
    assert level.limited_by == ""
    assert level.notes == ()


def test_weak_table_is_never_driven_louder() -> None:
    level, _ = chosen(MadeRig(gain_ratio=0.5))
    assert level.accel_rms_m_s2 == 2.0
    assert level.limited_by == ""
    assert level.notes == ()  # its gain is judged by the model, not by a response at 0.7-2 Hz


def test_plan_that_limits_scaled_down_is_not_raised_again() -> None:
    info = replace(INFO, limits=replace(INFO.limits, stroke_m=0.02))
    probe, loud = probe_plan(info, SETTINGS, 0), plan(info, SETTINGS, 0)
    level = choose_level(info, probe, MadeRig(gain_ratio=0.9).play(probe.command_v), 2.0, loud)
    assert loud.accel_rms_m_s2 < 1.5
    assert level.accel_rms_m_s2 == loud.accel_rms_m_s2
    lower = choose_level(info, probe, MadeRig(gain_ratio=0.9).play(probe.command_v), 0.5, loud)
    assert lower.accel_rms_m_s2 == 0.5


def test_lower_level_than_the_limits_allow_is_kept() -> None:
    info = replace(INFO, limits=replace(INFO.limits, stroke_m=0.02))
    probe, loud = probe_plan(info, SETTINGS, 0), plan(info, SETTINGS, 0)
    accel = MadeRig(gain_ratio=1.5).play(probe.command_v)
    assert choose_level(info, probe, accel, 2.0, loud).limited_by == "stroke limit"
    level = choose_level(info, probe, accel, 0.5, loud)
    assert (level.accel_rms_m_s2, level.limited_by, len(level.notes)) == (0.5, "", 0)


def test_burst_that_limits_hold_down_lowers_nothing() -> None:
    info = replace(INFO, limits=replace(INFO.limits, velocity_m_s=0.1))
    settings = replace(SETTINGS, kind="multisine", accel_rms_m_s2=4.0)
    probe, loud = probe_plan(info, settings, 2), plan(info, settings, 2)
    signal, burst = loud.stretches
    assert burst.level_m_s2 < 0.98 * signal.level_m_s2
    level = choose_level(info, probe, MadeRig(gain_ratio=0.985).play(probe.command_v), 4.0, loud)
    assert level.accel_rms_m_s2 == loud.accel_rms_m_s2
    assert level.limited_by == ""


@pytest.mark.campaign
@parametrize_first(2, "kind", ["noise", "multisine", "sweep", "step"])
@parametrize_first(
    2,
    ("name", "limits"),
    [
        ("stroke", {"stroke_m": 0.012}),
        ("velocity", {"velocity_m_s": 0.15}),
        ("acceleration", {"acceleration_m_s2": 9.0}),
        ("force", {"force_n": 60.0}),
    ],
)
def test_limits_are_kept_with_the_measured_gain(kind: Kind, name: str, limits: dict[str, float]) -> None:
    smooth = replace(INFO, converters=replace(INFO.converters, bits=0), limits=replace(INFO.limits, **limits))
    level, loud = chosen(MadeRig(gain_ratio=1.5), smooth, kind, wanted=4.0)
    place = 1.5 * 0.0079 * loud.command_v
    velocity = np.gradient(place, DT)
    played = np.abs(MadeRig(gain_ratio=1.5).play(loud.command_v)).max(axis=1)
    peaks = np.abs(place).max(), np.abs(velocity).max(), played.max(), MASS_KG * played[0]
    names = "stroke", "velocity", "acceleration", "force"
    limit = next(iter(limits.values()))
    assert level.limited_by == f"{name} limit"
    assert peaks[names.index(name)] == pytest.approx(0.6 * limit, rel=0.03)
    (lowered,) = level.notes
    assert f"to {level.accel_rms_m_s2:.2f} m/s^2 rms: {name} limit, " in str(lowered)
    assert min(level.allowed_m_s2.values()) == level.allowed_m_s2[f"{name} limit"] == level.accel_rms_m_s2


@pytest.mark.parametrize("kind", ["noise", "multisine", "sweep"])
def test_floor_that_resonates_keeps_its_share_of_the_sensor(kind: Kind) -> None:
    info = with_floor(range_m_s2=20.0)
    rig = MadeRig(floor_hz=6.0, floor_damping=0.03)
    level, loud = chosen(rig, info, kind)
    played = np.abs(rig.play(loud.command_v)[1]).max()
    assert level.limited_by == "range of channel floor_1"
    assert played == pytest.approx(0.7 * 20.0, rel=0.01)
    assert "at most 70 % of 20 m/s^2 is used" in str(level.notes[0])


def test_converter_can_end_before_the_sensor() -> None:
    info = with_floor(sensitivity_v_per_m_s2=2.0)  # 10 V are 5 m/s^2
    level, loud = chosen(MadeRig(), info)
    assert level.limited_by == "range of channel floor_1"
    assert np.abs(MadeRig().play(loud.command_v)[1]).max() == pytest.approx(0.7 * 5.0, rel=0.01)


def with_floor(range_m_s2: float = RANGE_M_S2, sensitivity_v_per_m_s2: float = 1.0 / 9.80665) -> RigInfo:
    """Return the rig with another sensor on its floor; its table has limits of no concern."""
    table, floor = INFO.channels
    other = replace(floor, range=range_m_s2, sensitivity_v_per_unit=sensitivity_v_per_m_s2)
    return replace(INFO, channels=(table, other), limits=replace(INFO.limits, stroke_m=1.0, force_n=1e4))


def test_acceleration_and_force_are_what_the_table_answers_not_what_the_command_asks() -> None:
    """A loop of 4 Hz answers a quarter of the command's acceleration above it: no level is taken for what it does not
    do."""
    slow = replace(INFO, limits=replace(INFO.limits, force_n=200.0))
    nominal = plan(slow, SETTINGS, 0).reach["force"]
    assert nominal.share > 0.6
    level, loud = chosen(MadeRig(loop_hz=4.0), slow)
    force = MASS_KG * np.abs(MadeRig(loop_hz=4.0).play(loud.command_v)[0]).max()
    assert (level.accel_rms_m_s2, level.limited_by) == (2.0, "")
    assert level.reach["force"].predicted == pytest.approx(force, rel=0.02)
    assert level.reach["force"].predicted < 0.5 * nominal.predicted


def test_force_of_table_and_floors_together() -> None:
    probe, loud = probe_plan(INFO, SETTINGS, 0), plan(INFO, SETTINGS, 0)
    level = choose_level(INFO, probe, MadeRig().play(probe.command_v), 2.0, loud, np.array([6.91]))
    force = np.abs(np.array([7.0, 6.91]) @ MadeRig().play(loud.command_v)).max()
    assert level.reach["force"].predicted == pytest.approx(force, rel=0.02)


def test_channels_that_show_nothing_and_lost_samples_are_named() -> None:
    probe, loud = probe_plan(INFO, SETTINGS, 0), plan(INFO, SETTINGS, 0)
    accel = MadeRig().play(probe.command_v)
    dead = accel.copy()
    dead[1] = 1e-3 * np.random.default_rng(1).standard_normal(dead.shape[1])
    still = np.zeros_like(accel)
    coarse = replace(INFO, converters=replace(INFO.converters, bits=6))  # a bit of 3 m/s^2
    with pytest.raises(InputError, match="channel floor_1: nothing but noise") as caught:
        choose_level(INFO, probe, dead, 2.0, loud)
    assert len(caught.value.faults) == 1
    for info, samples in ((INFO, still), (coarse, accel)):
        with pytest.raises(InputError, match="channel table: nothing but noise"):
            choose_level(info, probe, samples, 2.0, loud)
    lost = accel.copy()
    lost[0, 100] = np.nan
    for wrong in (accel[:, :-1], accel[:1], lost):
        with pytest.raises(InputError, match="the record ends early or a channel was lost"):
            choose_level(INFO, probe, wrong, 2.0, loud)
    choose_level(INFO, probe, accel, 2.0, loud)


@pytest.mark.parametrize(
    ("rig", "seen"),
    [
        (MadeRig(), False),
        (MadeRig(noise_m_s2=0.05), False),
        (MadeRig(friction_m_s2=0.1), False),
        (MadeRig(most_m_s2=6.0), True),  # 3 times the rms
        (MadeRig(most_m_s2=4.0, friction_m_s2=0.02), True),
    ],
)
def test_only_a_nonlinearity_that_grows_with_the_motion_overdrives(rig: MadeRig, seen: bool) -> None:
    probe, loud = probe_plan(INFO, SETTINGS, 0), plan(INFO, SETTINGS, 0)
    quiet, full = (Record(each.command_v, rig.play(each.command_v), each.parts) for each in (probe, loud))
    found = overdriven(quiet, full, DT)
    assert (found is not None) == seen
    if found:
        assert found[1] > found[0] > 0.0


def test_half_a_level_takes_half_of_every_limit() -> None:
    level, _ = chosen(MadeRig())
    half = level.at(1.0)
    assert half.accel_rms_m_s2 == 1.0
    assert half.reach["force"].predicted == pytest.approx(0.5 * level.reach["force"].predicted)
    assert half.reach["force"].limit == level.reach["force"].limit


def test_a_floor_that_rings_on_is_expected_to_ring_more_in_a_longer_excitation() -> None:
    """0.1 % at 1 Hz: a time constant of 160 s, so that 20 s of noise show less than half of what 300 s make of it."""
    rig, long = MadeRig(floor_hz=1.0, floor_damping=0.001), replace(SETTINGS, duration_s=300.0)
    probe, loud = probe_plan(INFO, long, 0), plan(INFO, long, 0)
    made = np.abs(rig.play(loud.command_v)).max(axis=1)
    told = np.abs(expected(INFO, probe, rig.play(probe.command_v), loud)).max(axis=1)
    assert told[1] > 0.9 * made[1]
    assert told[0] == pytest.approx(made[0], rel=0.01)
