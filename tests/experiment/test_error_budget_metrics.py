"""The error budget: known changes of the rig come out as what they are, and the parts add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.error_budget import (
    CAUSES,
    CUT_PERIODS,
    Signals,
    exceeds,
    fitted_factors,
    friction_in_samples,
    significant,
    split,
)
from rths_cli.analysis.metrics import test_band as band_of
from rths_cli.analysis.predicted_error import friction_samples
from rths_cli.analysis.sim import simulate
from rths_cli.case.load import load_cases
from rths_cli.experiment import run_metrics
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run
from rths_cli.experiment.run_signals import on_record_clock, whole_building
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.results import Friction, Identification
from rths_cli.quantities import Values, metrics_of
from rths_cli.structure import Building, Specimen, assemble

CASE = "el_centro_low_ff_fb"
CHANGED = "table.after_identification."
PLAIN = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"  # friction is a cause


def setup_with(*settings: str) -> Setup:
    return make_setup(load_cases([CASE], (PLAIN, *settings))[0])


def budget_of(
    setup: Setup, identified: Identification, believed: Identification | None = None
) -> tuple[Values, np.ndarray]:
    """Return the budget of a run whose blocks are designed from `identified`, judged with what is `believed`; and the
    error series (n_storeys, n)."""
    design, dt = design_blocks(setup, identified), setup.rig.dt_s
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    series = on_record_clock(outcome, design.blocks.lead_samples, dt, len(setup.motion.time_s))
    reported = whole_building(setup.building, series, setup.motion.accel_m_s2, dt, setup.case.integration)[2]
    sim = simulate(setup.building, dt, setup.motion.accel_m_s2)
    known = judge(setup, believed or identified, design).known
    found, _ = run_metrics.of_exp_rths(known, series, reported, sim)
    return found, sim.abs_accel_m_s2 - reported


def value(found: Values, path: str) -> float:
    return float(np.max(np.asarray(found[f"budget.{path}"])))


@pytest.fixture(scope="module")
def default(memory: Memory) -> tuple[Values, np.ndarray, Identification]:
    setup = setup_with()
    identified = memory.identify(setup, lambda _: None)
    return *budget_of(setup, identified), identified


@pytest.mark.campaign
def test_the_parts_add_up_to_the_measured_error(
    default: tuple[Values, np.ndarray, Identification],
) -> None:
    found, error, _ = default
    assert value(found, "unexplained_rms_m_s2") < 1e-5 * np.sqrt(np.mean(error**2))
    powers = [value(found, f"rms_error_{name}_m_s2") for name in CAUSES]
    assert max(powers) > 2e-4
    known = metrics_of("budget")
    assert set(found) == {path for path in known if not path.endswith(("_lost_m_s2", "_drift_m_s2"))}
    for path, found_value in found.items():
        assert np.ndim(found_value) == (known[path].over == "storey")


@pytest.mark.campaign
def test_tracking_is_the_measured_one_and_its_parts_add_up(memory: Memory) -> None:
    """And friction is what the prediction makes of it: pushes of the command, each made from its own series."""
    setup = setup_with()
    identified = memory.identify(setup, lambda _: None)
    design, dt = design_blocks(setup, identified), setup.rig.dt_s
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    series = on_record_clock(outcome, design.blocks.lead_samples, dt, len(setup.motion.time_s))
    sim, known = simulate(setup.building, dt, setup.motion.accel_m_s2), judge(setup, identified, design).known
    assert known is not None and known.friction is not None
    below = np.zeros((0, series.desired.shape[1]))  # the table is the lowest floor
    signals = Signals(series.desired, series.measured, series.command_v, below, sim.abs_accel_m_s2)
    found = split(known, signals)
    error = band_of(series.desired[0] - series.measured[0], dt)[: -round(CUT_PERIODS / 40.0 / dt)]
    assert found.measured.tracking == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-2)
    assert found.unexplained.tracking < 1e-5 * found.measured.tracking
    velocity = series.desired[1]
    command, disturbed = (known.lines.of(row) / known.loop.ahead for row in (series.command_v, series.measured))
    disturbed = disturbed - known.loop.rig * command
    speed, scale = float(np.sqrt(np.mean(velocity**2))), known.friction.scale_m_s
    made = [
        friction_samples(replace(known, friction=friction, velocity_m_s=velocity))
        for friction in (known.friction, Friction(1.0, 0.0, speed, 0.0, scale), Friction(1.0, 0.0, 1e9, 0.0, scale))
    ]
    answer = known.loop.rig[0] * command
    rows = (made[1][0], answer, 2j * np.pi * known.lines.frequency_hz * answer)
    more = fitted_factors(known, disturbed[0] - made[0][0], rows, np.ones(known.lines.count))[0]
    assert found.friction_v == pytest.approx(known.friction.command_v + more, rel=1e-9)
    acting, fitted, off = friction_in_samples(known, disturbed, command, velocity)
    sure = more * max(1.0 - (2.0 * off / fitted) ** 2, 0.0)
    assert np.abs(acting - made[0] - sure * made[2]).max() < 1e-9 * np.abs(acting).max()


def test_what_two_standard_uncertainties_explain_of_a_fitted_value_is_no_part() -> None:
    assert [significant(x, 1.0) for x in (0.0, 1.2, -2.0)] == [0.0, 0.0, 0.0]
    assert significant(-4.0, 1.0) == pytest.approx(-3.0) and significant(1.0, 0.0) == 1.0
    assert significant(100.0, 1.0) == pytest.approx(100.0, rel=1e-3)


def test_a_part_larger_than_the_whole_error_is_no_cause() -> None:
    """It cancels another one; a storey alone may be above what is measured there."""
    whole = np.array([1.0, 2.0])
    assert exceeds(np.array([3.8, 3.3]), whole) and not exceeds(np.array([1.5, 1.5]), whole)


@pytest.mark.campaign
def test_friction_is_the_identified_one_and_three_times_that_when_it_is_tripled(
    default: tuple[Values, np.ndarray, Identification],
) -> None:
    found, _, identified = default
    assert identified.friction is not None
    assert value(found, "friction_v") == pytest.approx(identified.friction.command_v, rel=0.05)
    # what friction, gain and delay do not explain of the table is little beside it
    assert value(found, "tracking_rms_rest_m_s2") < 0.3 * value(found, "tracking_rms_friction_m_s2")
    tripled, _ = budget_of(setup_with(CHANGED + "coulomb_factor=3"), identified)
    assert value(tripled, "friction_v") == pytest.approx(3.0 * identified.friction.command_v, rel=0.05)
    ratio = value(tripled, "rms_error_friction_m_s2") / value(found, "rms_error_friction_m_s2")
    assert 3.0 < ratio < 4.5  # three times what sign(v) does, and the linear part that the model does not hold
    assert abs(value(tripled, "table_delay_error_s")) < 1e-5
    assert value(tripled, "rms_error_rest_m_s2") < 0.1 * value(tripled, "rms_error_friction_m_s2")


@pytest.mark.campaign
def test_friction_that_was_not_identified_is_found_in_the_run(
    default: tuple[Values, np.ndarray, Identification],
) -> None:
    _, _, identified = default
    assert identified.friction is not None
    found, _ = budget_of(setup_with(), replace(identified, friction=None))
    assert value(found, "friction_v") == pytest.approx(identified.friction.command_v, rel=0.2)


@pytest.mark.campaign
def test_a_softer_specimen_is_the_specimens_error(
    default: tuple[Values, np.ndarray, Identification],
) -> None:
    _, _, identified = default
    found, error = budget_of(setup_with(CHANGED + "specimen_stiffness_factor=0.85"), identified)
    roof = float(np.sqrt(np.mean(error[-1] ** 2)))
    assert value(found, "rms_error_specimen_m_s2") == pytest.approx(roof, rel=0.05)
    for name in ("model", "friction", "coupling", "latency", "declared", "rounding"):
        assert value(found, f"rms_error_{name}_m_s2") < 0.05 * roof


@pytest.mark.campaign
@parametrize_first(1, ("gain", "late_s"), [(1.01, 0.0), (1.0, 5e-5), (0.98, -1e-4)])
def test_a_wrong_gain_and_delay_of_the_model_are_named(
    default: tuple[Values, np.ndarray, Identification], gain: float, late_s: float
) -> None:
    """The table is what it was; the model that judges it has another gain, or another delay."""
    found, _, identified = default
    best = replace(identified.best, gain=gain * identified.best.gain, delay_s=identified.best.delay_s + late_s)
    believed, _ = budget_of(setup_with(), identified, replace(identified, best=best))
    gain_error = value(believed, "table_gain_error") - value(found, "table_gain_error")
    assert gain_error == pytest.approx(1.0 / gain - 1.0, abs=3e-4)
    late = value(believed, "table_delay_error_s") - value(found, "table_delay_error_s")
    assert late == pytest.approx(-late_s, abs=1e-5)
    assert value(believed, "rms_error_rest_m_s2") < 0.5 * value(believed, "rms_error_model_m_s2")


@pytest.mark.campaign
def test_another_specimen_than_declared_is_the_declared_ones_error(memory: Memory) -> None:
    """SIM keeps the declared building: what it differs by from the identified one is stated by itself."""
    setup = setup_with()
    identified = memory.identify(setup, lambda _: None)
    assert identified.specimen is not None
    specimen = identified.specimen.specimen
    stiffer = replace(identified.specimen, specimen=replace(specimen, K=1.02 * specimen.K))
    found, _ = budget_of(setup, identified, replace(identified, specimen=stiffer))
    buildings = (setup.building, with_specimen(setup.building, stiffer.specimen))
    sims = [simulate(b, setup.rig.dt_s, setup.motion.accel_m_s2).abs_accel_m_s2 for b in buildings]
    wanted = float(np.sqrt(np.mean((sims[0] - sims[1])[-1] ** 2)))
    assert np.asarray(found["budget.rms_error_declared_m_s2"])[-1] == pytest.approx(wanted, rel=0.03)


def with_specimen(building: Building, specimen: Specimen) -> Building:
    mass = building.interface_experimental_mass_kg
    matrices = assemble(building.numerical, specimen, mass)
    return replace(building, specimen=specimen, **dict(zip("MCK", matrices, strict=True)))


@pytest.mark.campaign
def test_a_run_that_was_cut_or_a_loop_that_is_unstable_has_no_budget(memory: Memory) -> None:
    setup = setup_with("controller=none")
    identified = memory.identify(setup, lambda _: None)
    design = design_blocks(setup, identified)
    assert judge(setup, identified, design).known is None
    assert run_metrics.of_exp_rths(None, None, np.zeros((3, 10)), None) == ({}, ())  # type: ignore[arg-type]
