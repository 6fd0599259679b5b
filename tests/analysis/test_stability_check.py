"""Stability, tolerance, reach and verdict of the pre-flight check."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench import DT_S, ideal_info, rig_info
from hybrid import best_like, paper_like, storeys
from open_loop import points, rig_as_identified
from portfolio import parametrize_first
from scipy.linalg import block_diag

from rths_cli.analysis.closed_loop import CriticalDelay, closed_loop_matrix, loop_response, slow_roots, spectral_radius
from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.analysis.stability_check import (
    SAFE,
    UNSAFE,
    UNSTABLE,
    Beyond,
    Preflight,
    Reach,
    Stability,
    Strays,
    faults_of_loop,
    judge,
    reach,
    required,
    required_delay_s,
    stability,
    unpaired_zeros,
    unseen,
)
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.margins import Margins
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.identification.results import LevelBand
from rths_cli.numerics.lti import ComplexArray, Frf, Model
from rths_cli.rigs.description import RigInfo

CRITICAL = CriticalDelay(8e-3, 9.3, 0.0)
MARGINS = Margins(2.0, 3.0, 40.0, 4e-3, 1.5, 9.0, 12.0)
STABLE = Stability(0.9995, 1e-4, MARGINS, MARGINS, 0.2, 0.06, 9.3)
LEVELS = (LevelBand(0.7, 2.0, 1.02 + 0j, 1e-3), LevelBand(2.0, 5.0, 1.0 + 0.01j, 1e-3))
GAIN = 0.1 / 3.0
ROWS = (Reach("velocity", 0.3, 1.0, "m/s"), Reach("command", 5.0, 10.0, "V"))


def verdict(found: Stability = STABLE, rows: tuple[Reach, ...] = ROWS, scaling: float = 0.3) -> Preflight:
    return judge(CRITICAL, found, rows, scaling, None)


def test_a_stable_loop_within_reach_is_safe() -> None:
    found = verdict()
    assert (found.verdict, found.reasons) == (SAFE, ())
    assert found.largest_scaling == pytest.approx(0.3 * 0.9 / 0.5)
    assert (found.critical, found.stability, found.reach) == (CRITICAL, STABLE, ROWS)


def test_a_loop_that_grows_a_thousandfold_is_unstable() -> None:
    found = verdict(replace(STABLE, radius=1.0003, growth=1e4), (Reach("velocity", 2.0, 1.0, "m/s"),))
    assert found.verdict == UNSTABLE
    assert len(found.reasons) == 1  # what an unstable loop would reach says nothing
    assert "spectral radius is 1.000300" in found.reasons[0]
    assert "factor 1e+04" in found.reasons[0]


@pytest.mark.parametrize(("radius", "growth"), [(1.0, 1.0), (1.00001, 1.5), (1.0002, 999.0)])
def test_slow_growth_is_unsafe_because_nobody_can_be_sure(radius: float, growth: float) -> None:
    found = verdict(replace(STABLE, radius=radius, growth=growth))
    assert found.verdict == UNSAFE
    assert "unstable" in found.reasons[0]
    assert verdict(replace(STABLE, radius=1.0002, growth=1000.0)).verdict == UNSTABLE


def test_too_little_tolerance_is_unsafe() -> None:
    found = verdict(replace(STABLE, tolerates=0.0312))
    assert found.verdict == UNSAFE
    assert found.reasons == (
        "the loop tolerates only 3.12 % error of the table at 9.3 Hz, 6.00 % is required; add damping "
        "to the structure, cut the building higher up, or use FF+FB",
    )
    fragile = replace(STABLE, tolerates=0.0312)
    (fed_back,) = judge(CRITICAL, fragile, ROWS, 0.3, None, feedback=True).reasons
    assert "FF+FB" not in fed_back  # it is what the controller is
    above = verdict(replace(STABLE, tolerates=0.3, required=0.9, at_hz=120.0))
    assert "less of the interface floor's mass on the table" in above.reasons[0]
    assert verdict(replace(STABLE, tolerates=0.06)).verdict == SAFE
    (weak,) = verdict(replace(fragile, gain=0.923)).reasons
    assert weak.startswith(
        "with 0.923 times the table's gain the loop tolerates only 3.12 % error of the table at 9.3 Hz, 6"
    )


def test_less_than_a_millisecond_of_delay_margin_is_unsafe() -> None:
    short = replace(MARGINS, delay_margin_s=0.99e-3)
    found = verdict(replace(STABLE, measured=short))
    assert found.verdict == UNSAFE
    assert "tolerates only 0.99 ms of further delay, 1 ms are required; put less" in found.reasons[0]
    assert verdict(replace(STABLE, modelled=short)).verdict == SAFE  # the measured response counts
    assert verdict(replace(STABLE, measured=replace(short, delay_margin_s=1.01e-3))).verdict == SAFE


def test_beyond_nine_tenths_of_a_limit_is_unsafe_and_names_the_largest_scaling() -> None:
    rows = (
        Reach("velocity", 0.91, 1.0, "m/s"),
        Reach("command", 12.0, 10.0, "V"),
        Reach("actuator force", 1.0, 9.0, "N"),
    )
    found = verdict(rows=rows, scaling=0.4)
    assert found.verdict == UNSAFE
    assert found.largest_scaling == pytest.approx(0.3)
    assert found.reasons[0] == (
        "velocity: 0.91 m/s is predicted, the limit is 1 m/s and a tenth of it is kept in reserve"
    )
    assert found.reasons[1].endswith("a tenth of it is kept in reserve; the largest safe scaling is 0.3")
    assert [reason.split(":")[0] for reason in found.reasons] == ["velocity", "command"]
    assert verdict(rows=(Reach("velocity", 0.9, 1.0, "m/s"),)).verdict == SAFE
    assert verdict(rows=(Reach("velocity", math.nan, 1.0, "m/s"),)).verdict == UNSAFE


def test_nothing_moving_has_no_largest_scaling() -> None:
    assert verdict(rows=(Reach("velocity", 0.0, 1.0, "m/s"),)).largest_scaling == math.inf


def test_a_feedback_that_depends_on_the_model_beyond_its_band_is_a_reason_of_its_own() -> None:
    (reason,) = verdict(replace(STABLE, feedback=Beyond(2.6, 3.0, 208.0))).reasons
    assert reason.startswith(
        "the feedback by itself tolerates only 260 % error of the table at 208 Hz, beyond the ident"
    )
    assert verdict(replace(STABLE, feedback=Beyond(3.1, 3.0, 208.0))).verdict == SAFE


def test_several_reasons_are_all_given() -> None:
    bad = replace(STABLE, tolerates=0.01, measured=replace(MARGINS, delay_margin_s=1e-4))
    assert len(verdict(bad, (Reach("velocity", 2.0, 1.0, "m/s"),)).reasons) == 3


def test_the_required_tolerance_is_what_identification_and_verification_leave_open() -> None:
    f = np.array([0.1, 11.0, 30.0, 60.0, 120.0, 500.0])
    exact = np.zeros(len(f))
    calm, band = (LevelBand(0.7, 2.0, 1.0 + 0j, 0.0),), (0.7, 60.0)
    beyond = np.where(f > 60.0, (f / 120.0) ** 2, 0.0)  # up to 60 Hz the response was measured
    unseen = np.array([0.06, 0.01, 0.06, 0.06, 0.06, 0.06])  # compared finely from the band's start to 11 Hz
    assert required(f, band, exact, calm) == pytest.approx(np.minimum(unseen + beyond, 1.0))
    assert required(f, band, exact, ()) == pytest.approx(np.minimum(0.06 + beyond, 1.0))
    held = np.where(unseen > 0.01, 0.02, 0.01)
    assert required(f, band, exact, calm, unchecked=0.02) == pytest.approx(np.minimum(held + beyond, 1.0))
    assert required(f, band, exact, (), unchecked=0.02) == pytest.approx(np.minimum(0.06 + beyond, 1.0))
    assert required(f, band, exact + 0.02, calm) == pytest.approx(np.minimum(unseen + 0.06 + beyond, 1.0))
    assert required(f, (0.7, 5.0), exact, calm)[1] == pytest.approx(0.26)  # never below the band compared


def test_a_mode_of_the_specimen_beyond_the_band_counts_with_its_resonance() -> None:
    """An oscillator of 2 % damping at and above its frequency; within the band the response was measured."""
    f, exact, band = np.array([20.0, 40.0, 60.0]), np.zeros(3), (0.7, 35.0)
    mode = 2.0 * np.pi * 40.0 * np.exp(1j * (np.pi - np.arccos(0.02)) * np.array([1.0, -1.0]))
    found = required(f, band, exact, (), mode[:1])
    assert found == pytest.approx([0.06, 25.0, 2.25 / abs(1.25 - 0.06j)], rel=1e-9)


def test_a_zero_beyond_the_band_is_not_charged_where_its_pole_was_measured() -> None:
    """A band to 35 Hz; each zero belongs to the pole of the same mode, if that is in the band and near."""

    def charged(zeros_hz: list[float], poles_hz: list[float]) -> list[float]:
        zeros, poles = (
            2.0 * np.pi * np.concatenate([np.array(hz) * sign for sign in (1j, -1j)]) for hz in (zeros_hz, poles_hz)
        )
        model = Model(np.append(zeros, [0.0, 0.0]), np.append(poles, -9.0), 1.0, 0.0, (0.7, 35.0), 0.0, 1, DT_S)
        return sorted((unpaired_zeros(model).imag / (2.0 * np.pi)).round(9))

    assert charged([10.0, 36.0], [9.9, 34.5]) == []
    assert charged([10.0, 36.0], [9.9, 37.0]) == [36.0]  # its pole was not measured
    assert charged([34.0, 36.0], [33.9, 90.0]) == [36.0]  # the pole belongs to another zero
    assert charged([10.0, 60.0], [9.9, 34.0]) == [60.0]  # too far apart for one mode
    assert charged([10.0, 34.0], []) == []


def test_a_poor_record_at_low_level_is_no_better_than_none() -> None:
    """The noisier it is the more is left open, up to what is asked without it."""
    f, found = np.array([3.0]), []
    for error in (0.0, 0.005, 0.01, 0.1):
        levels = (LevelBand(0.7, 11.0, 1.12 + 0j, error),)
        found.append(required(f, (0.7, 1e9), np.zeros(1), levels)[0])
    assert found == pytest.approx([0.13, 0.13, 0.13, 0.06])
    bare = required(f, (0.7, 1e9), np.zeros(1), (LevelBand(0.7, 11.0, 1.0 + 0j, 0.01),))
    assert bare == pytest.approx(0.04) and required(f, (0.7, 1e9), np.zeros(1), ()) == pytest.approx(0.06)


def test_what_is_no_number_is_no_margin() -> None:
    for broken in ({"apart": math.nan}, {"tolerates": math.nan}, {"required": math.nan}):
        assert verdict(replace(STABLE, **broken)).verdict == UNSAFE, broken
    assert verdict(replace(STABLE, measured=replace(MARGINS, delay_margin_s=math.nan))).verdict == UNSAFE


def test_what_friction_changes_is_left_open() -> None:
    """Between the centres of two bands, 1.18 and 3.16 Hz; the same beyond them."""
    f = np.sqrt([0.01, 1.4, np.sqrt(14.0), 10.0, 100.0])
    changes = required(f, (0.01, 1e9), np.zeros(len(f)), LEVELS) - 0.01
    assert changes == pytest.approx([0.02, 0.02, 0.015, 0.01, 0.01], abs=1e-6)


def the_rig(latency: int = 1) -> IdentifiedRig:
    return replace(rig_as_identified(ideal_info(latency_samples=latency))[0], ripple_m_s2_per_v=0.0)


def found_for(blocks: Blocks, factor: float = 1.0, samples: int = 20000, gain: float = GAIN) -> Stability:
    """Return the stability on the true rig, whose measured response is the model's times a factor; `gain`: standard
    uncertainty of the table's gain."""
    model = rig_as_identified(ideal_info())[1]
    f = np.arange(5, 600) * 0.1
    data = Frf(f, factor * model.sampled_response(f), np.ones(len(f)), np.full(len(f), 1e-3), 10)
    parts = all_storeys(storeys(), DT_S)
    return stability(the_rig(), blocks, parts, model, data, samples, LEVELS, gain_uncertainty=gain)


def of_gain(rig: IdentifiedRig, gain: float) -> IdentifiedRig:
    """Return the rig whose command acts so many times as strongly."""
    return replace(rig, plant=replace(rig.plant, B=gain * rig.plant.B, D=gain * rig.plant.D))


def with_error(rig: IdentifiedRig, size: complex, at_hz: float) -> IdentifiedRig:
    """Return the rig whose command goes through 1 + E(z), E a real filter of one step of memory with E = size there."""
    z = points(np.array([at_hz]), DT_S)[0]
    late = float(size.imag / (1.0 / z).imag)
    now = float((size - late / z).real)
    n, plant = len(rig.plant.A), rig.plant
    a = np.block([[plant.A, late * plant.B], [np.zeros((1, n + 1))]])
    b = np.vstack([(1.0 + now) * plant.B, [[1.0]]])
    c = np.hstack([plant.C, late * plant.D])
    return replace(rig, plant=replace(plant, A=a, B=b, C=c, D=(1.0 + now) * plant.D))


@pytest.mark.parametrize("make", [best_like, paper_like])
def test_an_error_of_the_table_of_what_it_tolerates_puts_a_root_on_the_circle(
    make: Callable[[RigInfo], Blocks],
) -> None:
    """At the frequency named, of the gain named, and in the direction of -1."""
    blocks = replace(make(ideal_info()), ripple_m_s2_per_v=0.0, ripple_sum_m_s2_per_v=0.0)
    found = found_for(blocks)
    z = points(np.array([found.at_hz]), DT_S)
    loop = found.gain * loop_response(the_rig(), blocks, all_storeys(storeys(), DT_S), z).loop[0]
    worst, rig = -(1.0 + loop) / loop, of_gain(the_rig(), found.gain)
    matrix = closed_loop_matrix(with_error(rig, found.tolerates * worst / abs(worst), found.at_hz), blocks)
    assert np.abs(np.linalg.eigvals(matrix) - z).min() < 1e-6
    half = closed_loop_matrix(with_error(rig, 0.5 * found.tolerates * worst / abs(worst), found.at_hz), blocks)
    assert np.abs(np.linalg.eigvals(half) - z).min() > 4e-5


def test_the_radius_and_its_growth() -> None:
    blocks = best_like(ideal_info())
    found = found_for(blocks, samples=5000)
    assert found.radius == pytest.approx(spectral_radius(closed_loop_matrix(the_rig(), blocks)), rel=1e-12)
    assert found.growth == pytest.approx(found.radius**5000)
    assert 0.0 < found.growth < 1.0


def test_an_endless_growth_stays_a_number() -> None:
    blocks = replace(paper_like(ideal_info()), feedforward=best_like(ideal_info()).feedforward)
    force = blocks.interface.force
    louder = replace(force, estimates=40.0 * force.estimates)
    loud = replace(blocks, interface=replace(blocks.interface, force=louder))
    found = found_for(loud, samples=10**8)
    assert found.radius > 1.0
    assert found.growth == pytest.approx(1e99)


@pytest.mark.campaign
@parametrize_first(1, "gain", [GAIN, 0.01, 0.0])
@parametrize_first(1, "make", [best_like, paper_like])
def test_the_grid_finds_the_peak_that_a_fine_one_finds(make: Callable[[RigInfo], Blocks], gain: float) -> None:
    """And margins on the measured response are those of the model where both agree."""
    blocks = make(ideal_info())
    found = found_for(blocks, gain=gain)
    f = np.geomspace(0.05, 800.0, 60000)
    loop = loop_response(the_rig(), blocks, all_storeys(storeys(), DT_S), points(f, DT_S)).loop
    assert found.modelled.sensitivity_peak == pytest.approx(np.abs(1.0 / (1.0 + loop)).max(), rel=5e-3)
    assert found.measured.sensitivity_peak == pytest.approx(found.modelled.sensitivity_peak, rel=1e-3)
    gains = np.where(f <= 60.0, np.linspace(1.0 - 3.0 * gain, 1.0 + 3.0 * gain, 201)[:, None], 1.0)
    scatter = np.where(f < 60.0, 1e-3 / math.sqrt(5.0), 0.0)  # the mean of 5 lines of one part in a thousand
    errors = np.abs(1.0 + gains * loop) / np.abs(gains * loop)
    unchecked = max(2.0 * gain, 0.01)
    band_hz = rig_as_identified(ideal_info())[1].band_hz
    tolerated = errors.min(axis=0) / required(f, band_hz, scatter, LEVELS, unchecked=min(unchecked, 0.06))
    assert found.tolerates / found.required == pytest.approx(tolerated.min(), rel=1e-2)
    assert found.at_hz == pytest.approx(f[tolerated.argmin()], rel=1e-2)
    parts = loop_response(the_rig(), blocks, all_storeys(storeys(), DT_S), points(f, DT_S))
    alone = parts.feedback * parts.rig[0]
    beyond = np.where(f > 60.0, np.minimum((f / 120.0) ** 2, 3.0), 0.0)
    least = np.max(beyond * np.abs(alone) / np.abs(1.0 + alone))
    assert found.feedback.required / found.feedback.tolerates == pytest.approx(least, rel=1e-2, abs=1e-11)


def test_the_measured_response_has_margins_of_its_own() -> None:
    """A table 20 % too large has as much less gain margin, wherever the response was measured."""
    blocks = paper_like(ideal_info())
    exact, large = found_for(blocks), found_for(blocks, 1.2)
    assert large.modelled == exact.modelled
    assert exact.modelled.gain_margin > 1.0
    assert large.measured.gain_margin == pytest.approx(exact.modelled.gain_margin / 1.2, rel=0.02)


def scaled(rig: IdentifiedRig, factor: float, blocks: Blocks) -> IdentifiedRig:
    """Return the rig times a factor, what is left of the alias included."""
    change, total = factor * np.array(rig.alias_left(blocks))
    plant = replace(rig.plant, C=factor * rig.plant.C, D=factor * rig.plant.D)
    change, total = change + blocks.ripple_m_s2_per_v, total + blocks.ripple_sum_m_s2_per_v
    return replace(rig, plant=plant, ripple_m_s2_per_v=change, ripple_sum_m_s2_per_v=total)


@pytest.mark.parametrize("make", [best_like, paper_like])
def test_the_gain_margin_is_where_the_radius_passes_one(make: Callable[[RigInfo], Blocks]) -> None:
    blocks = make(ideal_info())
    margin = found_for(blocks).modelled.gain_margin
    below, above = (scaled(the_rig(), share * margin, blocks) for share in (0.995, 1.005))
    assert spectral_radius(closed_loop_matrix(below, blocks)) < 1.0
    assert spectral_radius(closed_loop_matrix(above, blocks)) > 1.0


def sinusoid(amplitude: float, line: int, lines: Lines) -> ComplexArray:
    found = np.zeros(lines.count, dtype=complex)
    found[line] = -0.5j * amplitude * lines.padded
    return found


def test_what_a_sinusoid_asks_of_the_table() -> None:
    """Command and accelerations of one frequency: every peak in closed form."""
    lines, info = Lines(8000, 8000, DT_S), rig_info()
    line = 22
    w = 2.0 * np.pi * lines.frequency_hz[line]
    command, accel = 3.0, np.array([0.02, 4.0, 1.5])
    corrected = np.array([sinusoid(a, line, lines) for a in accel])
    nominal = SimpleNamespace(command_v=sinusoid(command, line, lines), corrected=corrected)
    masses = np.array([7.0, 6.91, 6.95])
    known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.zeros(0), shaped=False)
    rows = {r.name: r for r in reach(known, SimpleNamespace(nominal=nominal), info, masses)}
    place, speed = 0.0079 * command, 0.0079 * command * w
    # x + v |v| / (2 b) is largest at a phase found by looking at all
    angle = np.linspace(0.0, 2.0 * np.pi, 100001)
    bit = 20.0 / 2**16
    swift = speed * np.cos(angle) + 0.0079 * bit / DT_S
    braked = place * np.sin(angle) + swift * np.abs(swift) / (2.0 * 0.45 * 45.0)
    assert rows["displacement_m"].peak == pytest.approx(braked.max(), rel=2e-3)
    assert braked.max() > 1.01 * place
    assert rows["velocity_m_s"].peak == pytest.approx(speed + 0.0079 * bit / DT_S, rel=2e-3)
    assert rows["acceleration_m_s2"].peak == pytest.approx(4.0, rel=2e-3)
    assert rows["sensor_m_s2"].peak == pytest.approx(4.0, rel=2e-3)
    assert rows["force_n"].peak == pytest.approx(masses @ accel, rel=2e-3)
    assert rows["command_v"].peak == pytest.approx(command, rel=2e-3)
    limits = {name: row.limit for name, row in rows.items()}
    assert limits == pytest.approx({
        "displacement_m": 0.079, "velocity_m_s": 1.0, "acceleration_m_s2": 45.0,
        "sensor_m_s2": 5.0 * 9.80665, "force_n": 445.0, "command_v": 10.0,
    })  # fmt: skip
    assert rows["command_v"].share == pytest.approx(0.3, rel=2e-3)


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0, 1.5])
def test_a_peak_between_the_points_of_the_reduced_series_is_seen(phase: float) -> None:
    """Near the highest line there are two points a period: a sinusoid may pass zero at both of them."""
    lines = Lines(8000, 8000, DT_S)
    accel = np.exp(1j * phase) * sinusoid(4.0, lines.count - 2, lines)
    nominal = SimpleNamespace(command_v=0.0 * accel, corrected=np.array([accel]))
    known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.zeros(0), shaped=False)
    rows = {row.name: row for row in reach(known, SimpleNamespace(nominal=nominal), rig_info(), np.ones(1))}
    assert rows["acceleration_m_s2"].peak == pytest.approx(4.0, rel=0.025)


def test_motion_above_the_lines_is_not_taken_for_none() -> None:
    """SIM knows all frequencies: its peaks count, and a check that sees too little of them says so."""
    lines = Lines(8000, 8000, DT_S)
    accel = sinusoid(4.0, 22, lines)
    nominal = SimpleNamespace(command_v=0.0 * accel, corrected=np.array([accel]), desired=accel)
    prediction = SimpleNamespace(nominal=nominal)
    for peak, said in ((4.2, False), (8.0, True)):
        sim, floors = np.array([accel, accel]), np.ones((2, lines.count))
        known = SimpleNamespace(
            lines=lines, peaks_m_s2=np.array([peak, 1.0]), sim=sim, floors=floors, slow_roots=(), shaped=False
        )
        rows = {row.name: row for row in reach(known, prediction, rig_info(), np.ones(1))}
        assert rows["acceleration_m_s2"].peak == peak
        sentences = unseen(known)
        assert bool(sentences) == said
        found = judge(CRITICAL, STABLE, tuple(rows.values()), 0.3, None, sentences)
        assert found.verdict == (UNSAFE if said else SAFE)
    assert "50 % of the interface floor's peak acceleration lies above 40 Hz" in str(sentences[0])


def test_a_measured_response_that_may_go_round_the_point_otherwise_is_unsafe() -> None:
    found = verdict(replace(STABLE, apart=1.01))
    assert found.verdict == UNSAFE and "identify again" in found.reasons[0]
    assert verdict(replace(STABLE, apart=0.99)).verdict == SAFE


def test_what_does_not_grow_with_the_record_is_left_to_no_scaling() -> None:
    """Of 0.6, 0.2 is there at any scaling: 0.9 is reached at 1.75 times the scaling; 0.95 that is there, by none."""
    row = Reach("displacement", 0.6, 1.0, "m", fixed=0.2, cause="zeros", advice=("controller_ff",))
    assert row.largest(0.3) == pytest.approx(0.3 * 0.7 / 0.4)
    assert replace(row, peak=0.2).largest(0.3) == math.inf
    lost = replace(row, peak=1.2, fixed=0.95)
    assert lost.largest(0.3) == 0.0
    assert replace(lost, peak=0.95).largest(0.3) == 0.0
    found = judge(CRITICAL, STABLE, (row, lost), 0.3, None)
    assert found.largest_scaling == 0.0 and found.verdict == UNSAFE
    (reason,) = found.reasons
    assert "0.95 m of it because a channel's zero" in reason
    assert "largest safe scaling" not in reason
    (reason,) = judge(CRITICAL, STABLE, (replace(row, peak=1.0),), 0.3, None).reasons
    assert reason.endswith("a part of a bit only: controller FF; the largest safe scaling is 0.262")


@pytest.mark.parametrize("feedback", [True, False])
def test_noise_takes_room_to_brake_and_the_advice_suits_its_cause(feedback: bool) -> None:
    """A table at rest, by hand: 60 V/s of noise, or the two bits of a shaped command, 0.62 m/s with 10 bits."""
    lines, gain, to_brake = Lines(2000, 2000, DT_S), 0.0079, 2.0 * 0.45 * 10.0
    nothing = SimpleNamespace(command_v=np.zeros(lines.count) + 0j, corrected=np.zeros((3, lines.count)) + 0j)
    known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.zeros(0), shaped=True)

    def of(bits: int, strays: Strays) -> tuple[Reach, Reach]:
        info = replace(rig_info(), converters=replace(rig_info().converters, bits=bits))
        info = replace(info, limits=replace(info.limits, acceleration_m_s2=10.0))
        rows = reach(known, SimpleNamespace(nominal=nothing), info, np.ones(3), strays)
        return rows[0], rows[1]

    far, fast = of(0, Strays(0.2, 60.0, feedback))
    assert fast.peak == fast.fixed == pytest.approx(gain * 60.0)
    assert far.peak == far.fixed == pytest.approx(gain * 0.2 + (gain * 60.0) ** 2 / to_brake)
    assert far.cause == fast.cause == "rounding"
    assert ("controller_ff" in fast.advice) == feedback
    far, fast = of(10, Strays(2.0, 0.0, feedback))
    rounding = 2.0 * gain * 20.0 / 2**10 / DT_S
    assert fast.peak == pytest.approx(rounding) and "controller_ff" not in fast.advice
    assert far.peak == pytest.approx(gain * 2.0 + rounding**2 / to_brake)
    far, _ = of(16, Strays(2.0, 0.0, feedback))
    assert far.cause == "zeros" and ("controller_ff" in far.advice) == feedback


def test_a_converter_narrower_than_stroke_or_sensor_is_the_limit() -> None:
    lines = Lines(2000, 2000, DT_S)
    info = replace(rig_info(range_v=2.0), limits=replace(rig_info().limits, stroke_m=0.079))
    nothing = SimpleNamespace(command_v=np.zeros(lines.count) + 0j, corrected=np.zeros((3, lines.count)) + 0j)
    known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.zeros(0), shaped=False)
    rows = reach(known, SimpleNamespace(nominal=nothing), info, np.ones(3))
    limits = {row.name: row.limit for row in rows}
    assert limits["displacement_m"] == pytest.approx(2.0 * 0.0079)
    assert limits["sensor_m_s2"] == pytest.approx(2.0 * 9.80665)
    assert limits["command_v"] == 2.0


def test_the_velocity_is_limited_by_the_rate_of_the_command_and_takes_up_its_bits() -> None:
    """Rounding that carries its error over: 0.4 bits held for long become 0, 1, 0, 0, 1; two bits at the most."""
    lines, info = Lines(2000, 2000, DT_S), rig_info()
    nothing = SimpleNamespace(command_v=np.zeros(lines.count) + 0j, corrected=np.zeros((3, lines.count)) + 0j)
    known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.zeros(0), shaped=True)
    info = replace(info, limits=replace(info.limits, command_rate_v_s=20.0))
    velocity = next(
        row for row in reach(known, SimpleNamespace(nominal=nothing), info, np.ones(3)) if "vel" in row.name
    )
    assert velocity.limit == pytest.approx(0.0079 * 20.0)
    bit, rng = info.converters.step_v, np.random.default_rng(1)
    carried, sent = 0.0, []
    for wanted in bit * rng.uniform(-0.5, 0.5, 2000):
        sent.append(bit * np.floor((wanted + carried) / bit + 0.5))
        carried += wanted - sent[-1]
    steepest = 0.0079 * np.abs(np.diff(sent)).max() / DT_S
    assert 0.5 * velocity.peak < steepest <= velocity.peak + 1e-12


def test_a_loop_must_tolerate_a_lost_and_a_late_sample_where_none_is_bridged() -> None:
    assert required_delay_s(2e-3, bridged=True) == 1e-3
    assert required_delay_s(2e-3, bridged=False) == 4e-3
    assert required_delay_s(1e-4, bridged=False) == 1e-3
    assert required_delay_s(1e-4, bridged=True, error_s=1e-4) == pytest.approx(3e-4 + 0.01 / (2.0 * math.pi * 11.0))
    assert required_delay_s(1e-4, True, 1e-6, compared=False) == pytest.approx(3e-6 + 0.06 / (2.0 * math.pi * 11.0))
    assert required_delay_s(1e-4, bridged=True, error_s=1e-3) == 1e-3
    assert required_delay_s(2e-3, bridged=False, error_s=1e-4) == 4e-3
    late = replace(STABLE, measured=replace(STABLE.measured, delay_margin_s=3e-3))
    assert faults_of_loop(late, least_delay_s=1e-3) == []
    (reason,) = faults_of_loop(late, least_delay_s=4e-3)
    assert str(reason).startswith("the loop tolerates only 3 ms of further delay, 4 ms are required")


def test_a_test_starts_at_rest_whatever_a_leak_keeps_of_the_record_before() -> None:
    """A leak of 140 s in a loop whose lines have room for 15 s after a record of 5 s, against its solution in time."""
    lines, root = Lines(10000, 40000, DT_S), -1.0 / 140.0
    time_s = np.arange(lines.padded) * DT_S
    pushed = np.where(time_s < 4.0, np.sin(2.0 * np.pi * time_s) + 0.5 - 0.5 * np.cos(0.5 * np.pi * time_s), 0.0)
    values = lines.of(pushed) / (2j * np.pi * lines.frequency_hz - root)
    exact = np.exp(root * time_s) * np.cumsum(np.exp(-root * time_s) * pushed) * DT_S
    motion = SimpleNamespace(command_v=values, corrected=np.stack([values]))

    def peak(roots: list[complex]) -> float:
        known = SimpleNamespace(lines=lines, peaks_m_s2=None, slow_roots=np.array(roots, dtype=complex), shaped=False)
        rows = {row.name: row.peak for row in reach(known, SimpleNamespace(nominal=motion), rig_info(), np.ones(1))}
        assert rows["acceleration_m_s2"] == pytest.approx(rows["command_v"])
        return rows["command_v"]

    assert peak([root + 0j]) == pytest.approx(np.abs(exact[: lines.samples]).max(), rel=5e-3)
    assert peak([]) > 5.0 * np.abs(exact).max()


def test_slow_roots_are_those_that_are_left_after_a_time() -> None:
    """A leak of 140 s and a motion of 0.016 Hz and 50 s, but not one of 2 s, nor one of 1.9 Hz."""
    roots = np.array([-1.0 / 140.0, -0.5 + 0.3j, -0.01 + 12.0j, -0.02 + 0.1j])
    z = np.exp(roots * DT_S)
    blocks = [np.array([[each.real, -each.imag], [each.imag, each.real]]) for each in z]
    found = slow_roots(block_diag(blocks[0][:1, :1], *blocks[1:]), DT_S, 80.0)
    assert np.sort_complex(found) == pytest.approx(roots[[3, 0]], abs=1e-9)


def test_a_loop_that_is_weak_at_half_the_sample_rate_is_found() -> None:
    """An alias of the held command puts the loop at -0.6 there; with 1 / 0.6 times the gain a root is at -1."""
    blocks = replace(best_like(ideal_info()), ripple_m_s2_per_v=0.0, ripple_sum_m_s2_per_v=0.0)
    parts = all_storeys(storeys(), DT_S)

    def rig_with(ripple: float) -> IdentifiedRig:
        return replace(the_rig(), ripple_m_s2_per_v=ripple)

    without, one = (loop_response(rig_with(r), blocks, parts, np.array([-1.0 + 0j])).loop[0].real for r in (0.0, 1.0))
    weak = rig_with((-0.6 - without) / (one - without))
    model = rig_as_identified(ideal_info())[1]
    f = np.arange(5, 600) * 0.1
    data = Frf(f, model.sampled_response(f), np.ones(len(f)), np.full(len(f), 1e-3), 10)
    found = stability(weak, blocks, parts, model, data, 20000, LEVELS)
    assert found.at_hz == pytest.approx(0.5 / DT_S)
    assert (found.tolerates, found.required) == pytest.approx((0.4 / 0.6, 1.0), rel=1e-6)
    louder = replace(of_gain(weak, 1.0 / 0.6), ripple_m_s2_per_v=weak.ripple_m_s2_per_v / 0.6)
    assert np.abs(np.linalg.eigvals(closed_loop_matrix(louder, blocks)) + 1.0).min() < 1e-9
