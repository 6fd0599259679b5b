"""The check of buildings whose computed storeys have laws: verdicts at tangents, and the simulated test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis.predicted_error import predict
from rths_cli.analysis.stability_check import SAFE, UNSAFE, reach, strays
from rths_cli.case.load import load_cases
from rths_cli.control.numerical_substructure import interface
from rths_cli.errors import InputError
from rths_cli.experiment import run_metrics
from rths_cli.experiment.check import (
    Judged,
    TangentVerdict,
    as_identified,
    faults_at_tangents,
    judge,
    preflight_of,
    stated_ends,
    tangent_verdicts,
)
from rths_cli.experiment.check_command import check_figures
from rths_cli.experiment.design import design_blocks, loop_stability
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run, run_of
from rths_cli.experiment.run_case import sim_of
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.results import Identification
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.structure import storey_values

HARDENING = 0.05
BILINEAR = f"{{kind: bilinear, yield_displacement_m: 0.002, hardening: {HARDENING}}}"
NEVER = "{kind: elastic_gap, contact_n_per_m: 5e6, gap_m: 1.0}"  # touched by no record, not safe if it were


PLAIN = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"


def setup_of(*settings: str, law: str = "") -> Setup:
    laws = (f"structure.numerical.law=[{law}]",) if law else ()
    return make_setup(load_cases(["el_centro_low_ff_fb"], (*laws, PLAIN, *settings))[0])


def tangents_of(setup: Setup, identified: Identification) -> tuple[TangentVerdict, ...]:
    building = replace(as_identified(setup, identified.specimen.specimen), laws=setup.building.laws)
    blocks = design_blocks(setup, identified).blocks.linearised()
    ends = stated_ends(setup.case, blocks.counters_reaction)
    return tangent_verdicts(setup, identified, blocks, building, SharedValues(), ends)


def judged(setup: Setup, identified: Identification) -> Judged:
    return judge(setup, identified, design_blocks(setup, identified))


@pytest.fixture(scope="module")
def yielding(default_identification: Identification) -> tuple[Setup, Judged]:
    setup = setup_of("runs=[sim, exp_rths]", law=BILINEAR)
    return setup, judged(setup, default_identification)


def measured_error(setup: Setup, identified: Identification) -> np.ndarray:
    """Return the RMS errors (n_storeys,) of EXP-RTHS on the virtual rig against SIM of the declared building."""
    design = design_blocks(setup, identified)
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), seed=1)
    run = run_of(outcome, setup, HYBRID_TEST, design.blocks.lead_samples, None)
    storeys = sim_of(setup, SharedValues()).abs_accel_m_s2, run.abs_accel_m_s2, None
    found = run_metrics.errors("exp_rths", None, storeys, setup.rig.dt_s, lowest_reliable_hz(setup))
    return np.asarray(found["exp_rths.rms_error_m_s2"])


@pytest.mark.campaign
def test_a_tangents_verdict_is_that_of_the_linear_building(default_identification: Identification) -> None:
    """The linear building with the law's second stiffness, stated in its case, by the way of every case."""
    setup = setup_of(law=BILINEAR)
    at_rest, softest = tangents_of(setup, default_identification)
    k, c = (float(storey_values(one)[0]) for one in (setup.building.numerical.K, setup.building.numerical.C))
    soft = setup_of(
        f"structure.numerical.stiffness_n_per_m=[{HARDENING * k!r}]", f"damping.dashpots_n_s_per_m=[{c!r}]",
        "damping.first_mode_ratio=null",
    )  # fmt: skip
    for verdict, linear in ((at_rest, setup_of()), (softest, soft)):
        design = design_blocks(linear, default_identification)
        found = preflight_of(linear, default_identification, design)
        wanted = found.stability
        assert verdict.stability.radius == pytest.approx(wanted.radius, abs=1e-12)
        for name in ("tolerates", "required", "at_hz", "in_band", "apart"):
            assert getattr(verdict.stability, name) == pytest.approx(getattr(wanted, name), rel=1e-9)
        assert verdict.stability.measured.delay_margin_s == pytest.approx(wanted.measured.delay_margin_s, rel=1e-9)
        assert verdict.critical.delay_s == pytest.approx(found.critical.delay_s, rel=1e-9)
    assert softest.stability.radius < at_rest.stability.radius


@pytest.mark.campaign
def test_a_building_that_is_not_safe_at_a_tangent_is_not_called_safe(default_identification: Identification) -> None:
    """The record does not reach the tangent, the simulated test is fine: the verdicts still have to agree."""
    setup = setup_of("runs=[sim, exp_rths]", law=NEVER)
    found = judged(setup, default_identification)
    assert found.preflight.verdict == UNSAFE
    assert [one.name for one in found.tangents if one.faults] == ["storey 1 stiffest"]
    assert len(found.preflight.reasons) == 1
    assert found.preflight.reasons[0].startswith("with storey 1 stiffest: ")
    assert found.simulated is not None and found.simulated.faults == ()
    assert found.largest_scaling == 0.0
    linear = predict(found.known)  # the law that never acts: the simulated test is the linear one
    assert found.preflight.prediction is not None
    # the rounding of samples, a third of the error, is one draw here: with the friction's part it adds or cancels
    assert_allclose(found.preflight.prediction.total.storeys, linear.total.storeys, rtol=0.2)
    for cause in ("model", "friction"):
        assert_allclose(found.simulated.causes[cause].storeys, linear.causes[cause].storeys, rtol=0.01)
    assert_allclose(found.simulated.causes["latency"].tracking, linear.causes["latency"].tracking, rtol=0.1)
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    added = strays(found.known, found.preflight.stability)
    for row, same in zip(found.preflight.reach, reach(found.known, linear, setup.rig, masses, added), strict=True):
        assert row.name == same.name
        assert row.peak == pytest.approx(same.peak, rel=2e-3)


def test_a_tangent_at_which_the_loop_diverges_says_so(default_identification: Identification) -> None:
    """On a rig as identified with 14 samples more, the stiffer building has a shorter critical delay than that."""
    setup = setup_of("controller=FF", law="{kind: elastic_gap, contact_n_per_m: 1e4, gap_m: 0.01}")
    best = default_identification.best
    late = replace(default_identification, best=replace(best, delay_s=best.delay_s + 14 * setup.rig.dt_s))
    blocks = design_blocks(setup, default_identification).blocks.linearised()
    building = replace(as_identified(setup, late.specimen.specimen), laws=setup.building.laws)
    at_rest, stiffest = tangent_verdicts(setup, late, blocks, building, SharedValues())
    assert at_rest.stability.radius < 1.0 < stiffest.stability.radius
    assert [fault.code for fault in stiffest.faults] == ["loop.unstable"]
    (told,) = faults_at_tangents((at_rest, stiffest))
    assert "spectral radius" in str(told) and "storey 1 stiffest" in str(told)


@pytest.mark.campaign
def test_the_prediction_of_a_yielding_building_is_that_of_the_virtual_rig(
    yielding: tuple[Setup, Judged], default_identification: Identification
) -> None:
    setup, found = yielding
    assert (found.preflight.verdict, found.preflight.reasons) == (SAFE, ())
    prediction = found.preflight.prediction
    assert prediction is not None
    ratio = prediction.total.storeys / measured_error(setup, default_identification)
    assert (np.abs(np.log(ratio)) < np.log(2.0)).all()
    assert found.largest_scaling == setup.case.scaling


@pytest.mark.campaign
def test_the_metrics_of_a_yielding_building(yielding: tuple[Setup, Judged]) -> None:
    setup, found = yielding
    values = check_figures(found)
    sim = sim_of(setup, SharedValues()).rel_disp_m
    assert values["check.peak_inter_storey_drift_m"][0] == pytest.approx(np.abs(sim[0]).max(), rel=0.02)
    assert values["check.ductility"][0] == pytest.approx(values["check.peak_inter_storey_drift_m"][0] / 0.002)
    assert values["check.residual_drift_m"][0] == pytest.approx(sim[0, -1], abs=0.05 * np.abs(sim[0]).max())
    assert values["check.tangent_faults"].tolist() == [0.0, 0.0]
    assert values["check.critical_delay_least_s"] == values["check.critical_delay_s"]
    assert values["check.critical_delay_most_s"] > 1.2 * values["check.critical_delay_least_s"]


@pytest.mark.campaign
def test_disturbances_of_a_replay_act_beside_those_before_them(yielding: tuple[Setup, Judged]) -> None:
    """Parts of an error budget add up: two disturbances after each other change what both at once change."""
    found = yielding[1]
    assert found.replay is not None and found.known is not None
    one_by_one, at_once = found.replay(), found.replay()
    random, shape = np.random.default_rng(1), found.known.loop.rig.shape
    first, second = (20.0 * (random.normal(size=shape) + 1j * random.normal(size=shape)) for _ in range(2))
    parts = one_by_one.disturb(first, None), one_by_one.disturb(second, None)
    both = at_once.disturb(first + second, None)
    for part, other, whole in zip(*parts, both, strict=True):
        assert_allclose(part + other, whole, atol=1e-9 * np.abs(whole).max())
    alone = found.replay().disturb(second, None)[0]
    assert np.abs(alone - parts[1][0]).max() > 1e-3 * np.abs(alone).max()  # the storey yields: not the same beside it


@pytest.mark.campaign
def test_a_test_that_the_guard_stops_in_the_simulation_is_not_safe(default_identification: Identification) -> None:
    setup = setup_of("runs=[sim, exp_rths]", "limits.tracking_error_m_s2=0.0005", law=BILINEAR)
    found = judged(setup, default_identification)
    assert found.preflight.verdict == UNSAFE
    assert "simulated on the identified rig" in found.preflight.reasons[0]
    assert "tracking error" in found.preflight.reasons[0]
    assert "check.rms_error_m_s2" not in check_figures(found)


def test_a_range_of_the_specimens_stiffness_is_judged_at_both_ends(default_identification: Identification) -> None:
    setup = setup_of("check.specimen_range=[0.7, 1.2]", law=BILINEAR)
    found = {one.name: one for one in tangents_of(setup, default_identification)}
    assert len(found) == 6
    verdict = found["specimen at 70 % of its stiffness, storey 1 softest"]
    identified = default_identification.specimen
    specimen = replace(identified.specimen, K=0.7 * identified.specimen.K)
    softer = replace(default_identification, specimen=replace(identified, specimen=specimen))
    numerical = replace(setup.building.numerical, K=HARDENING * setup.building.numerical.K)
    linear = replace(setup, building=replace(setup.building, numerical=numerical))
    blocks = design_blocks(linear, default_identification).blocks
    blocks = replace(blocks, numerical=interface(numerical, setup.rig.dt_s))
    wanted = loop_stability(linear, softer, blocks)
    assert verdict.stability.radius == pytest.approx(wanted.radius, abs=1e-12)
    # the table beyond its band is that with which the specimen was identified, under the softer one
    beyond = loop_stability(linear, default_identification, blocks, there=specimen)
    assert verdict.stability.tolerates == pytest.approx(beyond.tolerates, rel=1e-9)
    assert verdict.stability.tolerates == pytest.approx(wanted.tolerates, rel=5e-3)


def test_a_linear_building_has_tangents_only_with_a_range(default_identification: Identification) -> None:
    assert tangents_of(setup_of(), default_identification) == ()
    found = tangents_of(setup_of("check.specimen_range=[0.5, 1.0]"), default_identification)
    assert [one.name for one in found] == ["at rest", "specimen at 50 % of its stiffness, at rest"]


@pytest.mark.parametrize(("given", "told"), [("[1.2, 0.8]", "must contain 1"), ("[0.5]", "got 1 entries")])
def test_a_range_that_is_none_is_refused(given: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        setup_of(f"check.specimen_range={given}")
