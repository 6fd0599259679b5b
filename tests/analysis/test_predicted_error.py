"""Predicted errors, cause by cause, against compiled runs on a linear virtual table with that one fault."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from bench import DT_S, ideal_info, specimen
from hybrid import best_like, open_limits, paper_like, storeys, true_model
from open_loop import floors_per_table, rig_as_identified, true_rig
from scipy.signal import dlsim
from scipy.signal.windows import tukey

from rths_cli.analysis.closed_loop import loop_response
from rths_cli.analysis.fourier_lines import Lines, lines_for
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.metrics import test_band as band_of
from rths_cli.analysis.predicted_error import (
    CAUSES,
    Errors,
    PredictionInputs,
    at_once,
    data_ratio,
    predict,
    weight_of_few_bits,
)
from rths_cli.analysis.sim import simulate
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.numerical_substructure import all_storeys, interface
from rths_cli.identification.results import Friction
from rths_cli.loop.simulated_time_run import play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.rigs.description import Converters, RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant, inverse
from rths_cli.structure import Building, assemble

SAMPLES = 40000
NOISE_M_S2 = 4e-3
BELOW = storeys(dashpot_n_s_per_m=120.0)  # 8 % or so, so that random errors settle within a short run
KAPPA_V = 0.3 / ((7.0 + 13.86) * (2.0 * np.pi * 14.0) ** 2 * 0.0079)  # friction over the gain of F_ref


@dataclass(frozen=True)
class Fault:
    """What a run has beyond the linear table; bits of 0 leave a converter out."""

    noise_m_s2: float = 0.0
    coulomb_n: float = 0.0
    gain: float = 1.0
    sample_bits: int = 0
    command_bits: int = 0
    shaped: bool = True
    high_pass_hz: float = 0.0


@cache
def motion() -> Array:
    """Return ground displacement, velocity, acceleration (3, n) of 0.4-6 Hz, at rest at both ends."""
    spectrum = np.fft.rfft(np.random.default_rng(4).standard_normal(SAMPLES))
    f = np.fft.rfftfreq(SAMPLES, DT_S)
    place = np.fft.irfft(np.where((f > 0.4) & (f < 6.0), spectrum / np.maximum(f, 0.1) ** 2, 0.0), SAMPLES)
    lines = np.fft.rfft(place * tukey(SAMPLES, 0.2) ** 2)
    found = np.fft.irfft([lines * (2j * np.pi * f) ** k for k in range(3)], SAMPLES)
    return found / np.abs(found[2]).max()


def bench_info(bits: int = 0, high_pass_hz: float = 0.0) -> RigInfo:
    info = ideal_info(high_pass_hz=high_pass_hz)
    return replace(info, converters=Converters(bits, 10.0))


@cache
def bench_blocks(fault: Fault, paper: bool = False) -> Blocks:
    info = bench_info(16, fault.high_pass_hz)
    blocks = replace(paper_like(info) if paper else best_like(info), numerical=interface(BELOW, DT_S))
    return replace(blocks, shaping_step_v=info.converters.step_v if fault.shaped and fault.command_bits else 0.0)


def errors_of(fault: Fault, ground: Array, seed: int = 0, paper: bool = False, true: bool = False) -> Array:
    """Return the signals (4, n) of a run that errors are made of, on the record's clock: storeys, tracking.

    `true`: the storeys as the logged command moves a rig without noise, instead of what the channels show.
    """
    info = bench_info(0, fault.high_pass_hz)
    physics = VirtualPhysics(coulomb_n=fault.coulomb_n, force_limit_n=1e8, gain_m_per_v=0.0079 * fault.gain)
    sensor, command = (Converters(bits, 10.0).step_v for bits in (fault.sample_bits, fault.command_bits))
    plant = build_plant(info, physics, specimen(), fault.noise_m_s2)._replace(
        sensor_step_v=sensor,
        sensor_steps_per_v=inverse(sensor),
        command_step_v=command,
        command_steps_per_v=inverse(command),
    )
    blocks = bench_blocks(fault, paper)
    log = play(VirtualRig(info, plant, (seed,)), info, blocks, NUMERICAL, ground[::-1].T, open_limits(info)).log
    lead = blocks.lead_samples
    shown = log.corrected
    if true:
        rig = true_rig(info)
        size = info.channels[0].sensitivity_v_per_unit
        shown = dlsim((rig.A, rig.B, rig.C, rig.D, DT_S), log.command_v)[1].T / size
    corrected, desired = shown[:, lead:], log.desired[0, : SAMPLES - lead or None]
    return np.vstack([corrected, desired[: corrected.shape[1]] - corrected[0]])


def building() -> Building:
    return Building(BELOW, specimen(), 0.0, *assemble(BELOW, specimen(), 0.0), ())


@cache
def known(fault: Fault, paper: bool = False, interface_friction: float = 0.0) -> PredictionInputs:
    info = bench_info(fault.sample_bits or 16, fault.high_pass_hz)
    blocks = bench_blocks(fault, paper)
    rig, model = rig_as_identified(info)
    lines = lines_for(SAMPLES, DT_S, 20.0)
    place, velocity, accel = motion()
    sim, ground = simulate(building(), DT_S, accel), lines.of_motion(accel, velocity, place)
    f = np.arange(1, 600) * 0.1
    measured = Frf(f, fault.gain * model.sampled_response(f), np.ones(599), np.full(599, 1e-4), 10)
    return PredictionInputs(
        loop=loop_response(replace(rig, ripple_m_s2_per_v=0.0), blocks, all_storeys(BELOW, DT_S), lines.z),
        lines=lines,
        model=model,
        measured=measured,
        friction=Friction(interface_friction, 0.0, 1e9, 0.9, 1e-3) if interface_friction else None,
        floors=floors_per_table(lines.frequency_hz),
        ground=ground,
        sim=rung_out(lines, ground[0]),
        velocity_m_s=sim.rel_vel_m_s[0] + velocity,
        noise_m_s2=np.full(3, fault.noise_m_s2),
        rig=info,
        correction=blocks.correction,
        shaped=fault.shaped,
    )


def rung_out(lines: Lines, accel: ComplexArray) -> ComplexArray:
    """Return the lines of SIM, whose building rings on after the record: the second of two turns of the same ground."""
    once = np.fft.irfft(np.append(accel, np.zeros(lines.padded // 2 + 1 - lines.count)), lines.padded)
    twice = simulate(building(), DT_S, np.concatenate([once, once])).abs_accel_m_s2
    return np.fft.rfft(twice[:, lines.padded :])[:, : lines.count]


def figures(errors: Errors) -> Array:
    return np.append(errors.storeys, errors.tracking)


def change(fault: Fault, without: Fault, ground: Array, seeds: int = 1, margin: int = 0, true: bool = False) -> Array:
    """Return the rms (4,) in the test band of the difference that a fault makes, over runs with several seeds.

    `margin`: samples left out at both ends, where the band's filter smears what it cannot know. `true` as in
    `errors_of`.
    """
    pairs = [[errors_of(one, ground, seed, true=true) for one in (fault, without)] for seed in range(seeds)]
    banded = [band_of(one - other, DT_S)[:, margin : -margin or None] for one, other in pairs]
    return np.sqrt(np.mean([rms(each) ** 2 for each in banded], axis=0))


@pytest.mark.parametrize("paper", [False, True])
def test_without_faults_coupling_and_latency_are_all(paper: bool) -> None:
    """The two parts have errors of opposite sign: their sum is what is left; the table tracks on its own."""
    start = known(Fault(), paper)
    found = predict(replace(start, rig=bench_info(0)))
    run = errors_of(Fault(), motion(), paper=paper)
    sim = simulate(building(), DT_S, motion()[2]).abs_accel_m_s2[:, : run.shape[1]]
    wanted = rms(band_of(np.vstack([sim - run[:3], run[3:]]), DT_S))
    assert figures(found.total) == pytest.approx(wanted, rel=0.01)
    assert found.causes["latency"].tracking == pytest.approx(wanted[3], rel=0.01)
    assert found.causes["coupling"].tracking == 0.0
    for cause in ("model", "friction", "rounding", "noise", "quantisation"):
        assert figures(found.causes[cause]) == pytest.approx(np.zeros(4), abs=1e-12)


@pytest.mark.parametrize("high_pass_hz", [0.0, 0.024])
def test_noise(high_pass_hz: float) -> None:
    fault = Fault(noise_m_s2=NOISE_M_S2, high_pass_hz=high_pass_hz)
    found = figures(predict(known(fault)).causes["noise"])
    still = replace(fault, noise_m_s2=0.0)
    assert found == pytest.approx(change(fault, still, 0.0 * motion(), 2, 1000), rel=0.07)


@pytest.mark.campaign
def test_the_true_motions_hold_only_the_noise_that_the_loop_passes_on() -> None:
    fault = Fault(noise_m_s2=NOISE_M_S2)
    start = known(fault)
    found = predict(replace(start, rig=bench_info(0), sim=0.0 * start.sim, ground=0.0 * start.ground))
    made = change(fault, replace(fault, noise_m_s2=0.0), 0.0 * motion(), 2, 1000, true=True)[:3]
    assert found.true == pytest.approx(made, rel=0.07)
    assert np.all(found.true[1:] < 0.95 * found.total.storeys[1:])


def test_noise_of_one_channel_counts_by_itself() -> None:
    """In proportion to its size, in power over channels."""
    start = replace(known(Fault(noise_m_s2=NOISE_M_S2)), rig=bench_info(0))
    each = [figures(predict(replace(start, noise_m_s2=row)).causes["noise"]) for row in NOISE_M_S2 * np.eye(3)]
    assert np.sqrt(np.sum(np.square(each), axis=0)) == pytest.approx(figures(predict(start).causes["noise"]))
    assert not np.allclose(each[0], each[1], rtol=0.05)
    twice = figures(predict(replace(start, noise_m_s2=np.array([2.0 * NOISE_M_S2, 0.0, 0.0]))).causes["noise"])
    assert twice == pytest.approx(2.0 * each[0])


def test_rounding_of_samples() -> None:
    """With noise of more than a bit, without which rounding errors of a smooth motion are no noise."""
    fault = Fault(sample_bits=16, noise_m_s2=NOISE_M_S2)
    found = figures(predict(known(fault)).causes["quantisation"])
    assert found == pytest.approx(change(fault, replace(fault, sample_bits=0), motion(), 2, 1000), rel=0.06)


def test_rounding_of_samples_to_coarse_bits() -> None:
    """Without noise errors of rounding follow the motion: as white noise they would be half of what they are."""
    fault = Fault(sample_bits=12, shaped=False)
    found = figures(predict(known(fault)).causes["quantisation"])
    made = change(fault, replace(fault, sample_bits=0), motion(), 1, 1000)
    assert found == pytest.approx(made, rel=0.4)


def small(fault: Fault, size: float) -> PredictionInputs:
    """Return the inputs of a motion of another size."""
    start = known(fault)
    return replace(start, ground=size * start.ground, sim=size * start.sim)


def weight(start: PredictionInputs) -> float:
    return weight_of_few_bits(start, predict(start))


def test_rounding_of_a_motion_of_a_few_bits_is_no_noise_unless_noise_moves_it() -> None:
    assert weight(small(Fault(sample_bits=12, command_bits=12, shaped=False), 0.06)) == 1.0
    assert weight(small(Fault(sample_bits=16), 1.0)) == 0.0
    assert weight(small(Fault(sample_bits=12, shaped=False, noise_m_s2=0.06), 0.02)) == 0.0


@pytest.mark.campaign
@pytest.mark.parametrize("shaped", [True, False])
def test_rounding_of_commands(shaped: bool) -> None:
    fault = Fault(command_bits=16, shaped=shaped, noise_m_s2=NOISE_M_S2)
    found, exact = figures(predict(known(fault)).causes["rounding"]), replace(fault, command_bits=0)
    assert found == pytest.approx(change(fault, exact, motion(), 6, 1000), rel=0.04 if shaped else 0.1)


def test_friction() -> None:
    fault = Fault(coulomb_n=0.3)
    found = figures(predict(known(fault, interface_friction=KAPPA_V)).causes["friction"])
    assert found == pytest.approx(change(fault, Fault(), motion()), rel=0.03)


def test_a_model_with_the_wrong_gain() -> None:
    fault = Fault(gain=1.01)
    found = figures(predict(known(fault)).causes["model"])
    assert found == pytest.approx(change(fault, Fault(), motion()), rel=0.02)


def test_causes_that_are_series_add_up_in_time_and_others_in_power() -> None:
    """Model and friction cancel here when the gain's error has the friction's sign: the total is no sum of powers."""
    start = replace(known(Fault(gain=1.01)), noise_m_s2=np.full(3, 0.05))
    found = predict(start)
    still = predict(replace(start, noise_m_s2=np.zeros(3), rig=bench_info(0)))
    random = [figures(found.causes[cause]) for cause in ("rounding", "noise", "quantisation")]
    both = np.sqrt(figures(still.total) ** 2 + np.sum(np.square(random), axis=0))
    assert figures(found.total) == pytest.approx(both)
    series = start.sim - found.nominal.storeys
    change_of_gain = predict(
        replace(start, measured=known(Fault()).measured, noise_m_s2=np.zeros(3), rig=bench_info(0))
    )
    alone = rms(start.lines.series(series * start.lines.test_band()))
    assert change_of_gain.total.storeys == pytest.approx(alone)
    assert (np.abs(still.total.storeys**2 - alone**2 - found.causes["model"].storeys ** 2) > 1e-9 * alone**2).any()


def test_every_cause_is_explained() -> None:
    assert set(predict(known(Fault())).causes) == set(CAUSES)


def frf(f: Array, response: ComplexArray) -> Frf:
    return Frf(f, response, np.ones(len(f)), np.full(len(f), 1e-4), 10)


def test_a_known_ratio_of_measured_to_model_is_found() -> None:
    """Also where the staircase adds its alias; one outside the band of model and data."""
    model: Model = replace(true_model(1.5 * DT_S), ripple_m_s2_per_v=-1.35)
    f = np.arange(1, 1000) * 0.05
    ratio = 1.02 - 0.001 * f + 0.002j * f
    data = frf(f, ratio * model.response(f) + model.sampled_response(f) - model.response(f))
    asked = np.array([0.2, 2.0, 7.3, 31.0, 49.0, 55.0])
    found = data_ratio(model, data, asked)
    assert found[1:5] == pytest.approx(1.02 - 0.001 * asked[1:5] + 0.002j * asked[1:5], abs=2e-5)
    assert found[[0, 5]] == pytest.approx(1.0)
    narrow = data_ratio(replace(model, band_hz=(3.0, 20.0)), data, asked)
    assert narrow[[0, 1, 3, 4, 5]] == pytest.approx(1.0)
    assert narrow[2] == pytest.approx(found[2])


def test_scatter_of_single_lines_is_averaged_over_half_a_hertz() -> None:
    model = true_model(1.5 * DT_S)
    f = np.arange(1, 4000) * 0.01
    scatter = 0.01 * np.random.default_rng(2).standard_normal(len(f))
    inside = f[(f > 2.0) & (f < 38.0)]
    found = data_ratio(model, frf(f, (1.0 + scatter) * model.sampled_response(f)), inside) - 1.0
    assert np.std(found.real) == pytest.approx(0.01 / np.sqrt(50.0), rel=0.25)


def test_friction_acts_without_the_commands_delay() -> None:
    """Equations of motion of the linear table, no hold and no delay."""
    model, f = true_model(3.5 * DT_S), np.linspace(0.5, 40.0, 50)
    exact = replace(true_model(0.0), dt_s=0.0).response(f)
    assert at_once(model, f) == pytest.approx(exact, rel=1e-9)
    assert np.abs(at_once(model, f) / model.response(f) - 1.0).max() > 0.3
