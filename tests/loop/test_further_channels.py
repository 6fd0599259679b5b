"""Channels beside the accelerometers: what the table shows in them, what the step makes of a load cell, what the guard
does with a displacement sensor and a load cell that are wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bare_rig import BareRig
from bench import LINEAR, ideal_info, rig_info, specimen
from faulty_rig import bench_info, guard_of
from further_channels import (
    PLATE_KG,
    SpoiltRig,
    best_with_cell,
    cell,
    displacement,
    five,
    paper_with_cell,
    strain,
    with_channels,
)
from hybrid import best_like, ground, open_limits
from portfolio import parametrize_first
from scipy.signal import butter, sosfiltfilt

from rths_cli.control import feedback, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits, further_limits
from rths_cli.loop.reference_step import ReferenceStep
from rths_cli.loop.simulated_time_run import Outcome, Stillness, play
from rths_cli.loop.step_arrays import NUMERICAL, RECORD
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Channel, RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

SPECIMEN_KG = np.concatenate([[0.0], specimen().masses_kg])


def rig_of(info: RigInfo, noise: float = 0.0, interface_mass_kg: float = 0.0) -> VirtualRig:
    plant = build_plant(info, LINEAR, specimen(), noise, interface_mass_kg=interface_mass_kg)
    return VirtualRig(info, plant, (0, 3))


@pytest.mark.parametrize("interface_mass", [0.0, 1.2])
def test_a_perfect_load_cell_gives_equation_2_6(interface_mass: float) -> None:
    """The force of the first storey follows from its drift and rate; the cell also carries plate and interface."""
    info = with_channels(ideal_info(low_pass_hz=0.0), (cell(),))
    info = replace(info, further=(replace(info.further[0], range=1e6),))
    rig, parts, rows = rig_of(info, 0.0, interface_mass), specimen(), []
    rig.arm()
    for command in 2.0 * np.sin(0.02 * np.arange(3000)) * np.tanh(np.arange(3000) / 500.0):
        samples = rig.exchange(float(command)) / [c.sensitivity_v_per_unit for c in info.all_channels]
        storey = float((parts.K @ rig.state.state[3:5] + parts.C @ rig.state.state[5:7]).sum())
        accel, force = samples[:3], samples[3] - PLATE_KG * samples[0]
        rows.append(
            (storey - interface_mass * accel[0], -force, -interface_mass * accel[0] - parts.masses_kg @ accel[1:])
        )
    by_storey, by_cell, by_accelerations = np.array(rows).T
    peak = np.abs(by_storey).max()
    assert peak > 5.0
    assert np.abs(by_cell - by_storey).max() <= 1e-9 * peak
    assert np.abs(by_cell - by_accelerations).max() <= 1e-9 * peak


@pytest.mark.parametrize("interface_mass", [0.0, 1.2])
def test_the_base_shear_of_a_run_by_a_perfect_cell_is_equation_2_6(interface_mass: float) -> None:
    """The cell alone (weight 1), in closed loop, against masses times the accelerations of the same run."""
    info = with_channels(ideal_info(low_pass_hz=0.0), (replace(cell(), range=1e6),))
    blocks = paper_with_cell(info, interface_mass, 1.0)
    log = play(rig_of(info, 0.0, interface_mass), info, blocks, NUMERICAL, ground(1500), open_limits(info)).log
    wanted = -(interface_mass * log.corrected[0] + specimen().masses_kg @ log.corrected[1:])
    assert np.abs(wanted).max() > 1.0
    assert np.abs(log.base_shear_n - wanted).max() <= 1e-9 * np.abs(wanted).max()


@pytest.mark.campaign
@parametrize_first(1, "make", [best_with_cell, paper_with_cell])
@parametrize_first(1, "interface_mass", [0.0, 1.2])
def test_the_compiled_step_takes_the_load_cell_as_the_reference_does(
    make: Callable[..., Blocks], interface_mass: float
) -> None:
    """The cell is wrong by a tenth and stands behind another channel: what it changes is really its doing."""
    info = with_channels(ideal_info(), (strain(), replace(cell(), range=1e6)))
    blocks, drive = make(info, interface_mass), ground(1500)
    plant = build_plant(info, LINEAR, specimen(), 0.0, interface_mass_kg=interface_mass)
    rig = TenthMore(VirtualRig(info, plant, (0,)))
    outcome = play(rig, info, blocks, NUMERICAL, drive, open_limits(info))
    step, shears, commands, cells = ReferenceStep(blocks), [], [], []
    for samples, source in zip(rig.samples, drive, strict=False):
        command = step(samples, source)
        step.note_sent(command)
        shears.append(step.force_n[0])
        commands.append(command[0])
        cells.append(step.corrected[4])
    assert outcome.log.base_shear_n == pytest.approx(shears, abs=1e-11 * np.abs(shears).max())
    assert outcome.log.command_v == pytest.approx(commands, abs=1e-11 * np.abs(commands).max())
    assert outcome.log.further[1] == pytest.approx(cells, abs=1e-11 * np.abs(cells).max())
    without = ReferenceStep(replace(blocks, cell=None))
    other = [without(samples, source)[0] for samples, source in zip(rig.samples, drive, strict=False)]
    assert np.abs(np.array(other) - commands).max() > 1e-3


class TenthMore(BareRig):
    """A rig whose last channel shows a tenth more than it must."""

    def shown(self, samples: Array) -> Array:
        return samples * np.where(np.arange(samples.size) == samples.size - 1, 1.1, 1.0)


def test_channels_that_are_only_logged_change_nothing() -> None:
    further = tuple(replace(channel, uses=("log",), noise_rms=0.01) for channel in five())
    info = rig_info()
    beside, drive = with_channels(info, further), ground(600)
    blocks = best_like(info)
    correction = sensor_correction.further_correction(further, info.dt_s)
    still = Stillness(100, 0, 0)
    alone = play(rig_of(info, 3e-4), info, blocks, NUMERICAL, drive, open_limits(info), still=still)
    more = play(
        rig_of(beside, 3e-4), beside, replace(blocks, further=correction), NUMERICAL, drive, open_limits(info),
        still=still,
    )  # fmt: skip
    assert more.log.further.shape == (5, 600) and np.isfinite(more.log.further).all()
    for name in ("corrected", "desired", "command_v", "estimated", "true_velocity_m_s", "true_displacement_m"):
        assert np.array_equal(getattr(more.log, name), getattr(alone.log, name)), name
    assert alone.whole is not None and more.whole is not None
    assert np.array_equal(more.whole.before_v, alone.whole.before_v)
    place = more.log.further[0]
    assert np.abs(place - more.log.true_displacement_m).max() < 0.06


# --- the guard


def watched(info: RigInfo) -> GuardLimits:
    return guard_of(info)._replace(further=further_limits(info, SPECIMEN_KG))


def forward(info: RigInfo) -> Blocks:
    """Return feedforward alone, which leaves a changed gain as it is."""
    blocks = replace(best_like(info), feedback=feedback.none(info.dt_s), specimen=specimen())
    return replace(blocks, further=sensor_correction.further_correction(info.further, info.dt_s))


def run(
    further: tuple[Channel, ...],
    spoil: Callable[[int, Array], Array] | None = None,
    wire: Callable[[int, float], float] | None = None,
    stroke_m: float = 0.079,
    drive: Array | None = None,
) -> tuple[Outcome, SpoiltRig, RigInfo]:
    """Return a shake-table run at 1 kHz with spoilt samples or commands from its third second on."""
    info = with_channels(bench_info(), further)
    rig = SpoiltRig(info)
    info = replace(info, limits=replace(info.limits, stroke_m=stroke_m))
    rig.spoil, rig.wire = spoil or rig.spoil, wire or rig.wire
    motion = slow() if drive is None else drive
    outcome = play(rig, info, forward(info), RECORD, motion, watched(info), still=Stillness(0, 1500, 0))
    return outcome, rig, info


def slow() -> Array:
    """Return a motion (n, 3) of 0.5 to 3 Hz that reaches 20 mm, 6 s long."""
    white, count = np.random.default_rng(4).standard_normal(6000), 6000
    window = np.tanh(np.arange(count) / 700.0) * np.tanh(np.arange(count)[::-1] / 700.0)
    place = window * sosfiltfilt(butter(2, (0.5, 3.0), "bandpass", fs=1000.0, output="sos"), white)
    place *= 20e-3 / np.abs(place).max()
    velocity = np.gradient(place, 1e-3)
    return np.column_stack([np.gradient(velocity, 1e-3), velocity, place])


def sine(place_m: float) -> Array:
    """Return a motion (n, 3) of 1 Hz, 6 s long."""
    time_s, rate = 1e-3 * np.arange(6000), 2.0 * np.pi
    place = place_m * np.tanh(time_s / 0.7) ** 2 * np.tanh(time_s[::-1] / 0.7) ** 2 * np.sin(rate * time_s)
    velocity = np.gradient(place, 1e-3)
    return np.column_stack([np.gradient(velocity, 1e-3), velocity, place])


AT = 2500
BESIDE = (displacement(), cell())


def changed(channel: int, change: Callable[[float], float]) -> Callable[[int, Array], Array]:
    def spoil(k: int, samples: Array) -> Array:
        if k >= AT:
            samples[channel] = change(samples[channel])
        return samples

    return spoil


def kept(channel: int) -> Callable[[int, Array], Array]:
    last: list[float] = []

    def spoil(k: int, samples: Array) -> Array:
        if k >= AT:
            last.append(samples[channel])
            samples[channel] = last[0]
        return samples

    return spoil


def test_a_healthy_run_ends_with_its_record() -> None:
    outcome, rig, _ = run(BESIDE)
    assert outcome.stopped_by_limit == "" and outcome.played
    assert np.abs(rig.place_m).max() > 0.018


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (changed(3, lambda v: -v), "the sensor of channel table_displacement is wrong, its sign is reversed"),
        (kept(3), "the sensor of channel table_displacement is wrong, its value does not change"),
        (changed(3, lambda v: v + 1.5), "the sensor of channel table_displacement is wrong, it is off by 0.01"),
        (changed(4, lambda v: -v), "the sensor of channel table_force is wrong, its sign is reversed"),
        (kept(4), "the sensor of channel table_force is wrong, its value does not change"),
        (changed(4, lambda v: v + 0.6), "the sensor of channel table_force is wrong, it is off by 30 N"),
        (changed(4, lambda v: 2.0 * v), "the sensor of channel table_force is wrong, it shows 2 times what it must"),
        (changed(4, lambda v: 0.0), "the sensor of channel table_force is wrong, its value does not change"),
    ],
)
def test_a_wrong_sensor_is_found_and_named(spoil: Callable[[int, Array], Array], told: str) -> None:
    outcome, rig, info = run(BESIDE, spoil)
    assert outcome.stopped_by_limit.startswith(told)
    assert outcome.reason == g.DISAGREES and AT * 1e-3 < outcome.stopped_at_s < AT * 1e-3 + 1.5
    assert rig.commands_v[-1] == 0.0 and abs(rig.place_m[-1]) < 2e-3
    assert np.abs(rig.place_m).max() < info.limits.stroke_m


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (changed(4, lambda v: -v), "channel table_force is wrong, its sign is reversed"),
        (kept(4), "channel table_force is wrong, its value does not change"),
        (changed(4, lambda v: v + 1.2), "channel table_force is wrong, it is off by 60"),
        (changed(4, lambda v: 2.0 * v), "channel table_force is wrong, it shows 2 times what it must"),
        (changed(3, lambda v: -v), "channel table_displacement is wrong, its sign is reversed"),
        (kept(3), "channel table_displacement is wrong, its value does not change"),
    ],
)
def test_a_wrong_sensor_in_the_loop_is_named_and_leaves_the_table_within_its_limits(
    spoil: Callable[[int, Array], Array], told: str
) -> None:
    """The hybrid building feels the load cell; a fault of it moves the table before it is found."""
    info = with_channels(bench_info(), BESIDE)
    rig = SpoiltRig(info)
    rig.spoil = spoil
    outcome = play(
        rig, info, best_with_cell(info), NUMERICAL, 2.0 * ground(6000), watched(info), still=Stillness(0, 1500, 0)
    )  # fmt: skip
    assert outcome.reason == g.DISAGREES and told in outcome.stopped_by_limit
    assert rig.commands_v[-1] == 0.0 and abs(rig.place_m[-1]) < 2e-3
    assert np.abs(rig.place_m).max() < info.limits.stroke_m


def test_an_amplifier_whose_gain_drifts_is_stopped_by_the_measured_stroke() -> None:
    """The command alone stays within the stroke: without the sensor the table would leave it."""

    def drifting(k: int, command: float) -> float:
        return command * (1.0 + 0.2 * min(max(k - 1000, 0) / 1500.0, 1.0))

    drive = sine(0.02)
    outcome, rig, info = run(BESIDE[:1], None, drifting, 0.0215, drive)
    assert outcome.reason == g.MEASURED_STROKE
    assert "times as commanded: the gain of amplifier or table" in outcome.stopped_by_limit
    assert "limits.stroke_m is 0.0215" in outcome.stopped_by_limit
    assert rig.commands_v[-1] == 0.0 and abs(rig.place_m[-1]) < 2e-3
    assert np.abs(rig.place_m).max() < info.limits.stroke_m
    blind, other, _ = run((replace(displacement(), uses=("log",)),), None, drifting, 0.0215, drive)
    assert blind.stopped_by_limit == "" and np.abs(other.place_m).max() > 0.0215


def test_a_level_of_a_further_channel_stops_the_test() -> None:
    level = replace(strain(("guard",)), abort=1e-3)
    outcome, rig, _ = run((level,))
    assert outcome.reason == g.LEVEL and "channel channel_1_strain" in outcome.stopped_by_limit
    assert "its abort is 0.001" in outcome.stopped_by_limit
    assert rig.commands_v[-1] == 0.0
    other, _, _ = run((replace(level, uses=("log",)),))
    assert other.stopped_by_limit == ""


def test_a_channel_that_is_only_logged_may_be_no_number() -> None:
    outcome, _, _ = run((strain(),), changed(3, lambda v: np.nan))
    assert outcome.stopped_by_limit == "" and np.isnan(outcome.log.further[0, -1])
    watched_one, _, _ = run((strain(("guard",)),), changed(3, lambda v: np.nan))
    assert watched_one.reason == g.NOT_A_NUMBER and "channel_1_strain" in watched_one.stopped_by_limit


def test_a_wrong_accelerometer_is_not_laid_on_the_load_cell() -> None:
    """Floor 2 shows its acceleration reversed: the cell then differs from the masses times accelerations as well."""
    info = with_channels(bench_info(), (cell(("guard",)),))
    rig = SpoiltRig(info)
    rig.spoil = changed(2, lambda v: -v)
    blocks = forward(info)
    limits = watched(info)
    outcome = play(rig, info, blocks, RECORD, slow(), limits, still=Stillness(0, 1500, 0))
    assert "channel_2" in outcome.stopped_by_limit.split(":")[0]
