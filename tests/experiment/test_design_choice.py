"""The design that a case gets: whether the command counters the specimen's reaction, and the filter of the floors, the
usual one, or one that trusts the identified specimen where the rounding of the samples would be most of the error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.predicted_error import predict
from rths_cli.analysis.stability_check import SAFE
from rths_cli.case.load import load_cases
from rths_cli.control.interface import PartDesign
from rths_cli.errors import InputError
from rths_cli.experiment import check_command
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check import changed_specimen_error, judge, stiffness_uncertainty
from rths_cli.experiment.check_command import check_cases, choose_design, verdict_on
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.findings import sentences
from rths_cli.identification.results import Identification
from rths_cli.numerics.content_key import content_key
from rths_cli.studies.sweep_runs import Shared

COARSE = ("scaling=0.064", "table.converters.bits=14", "runs=[sim, sim_delay, exp_rths]")
CASE = "el_centro_low_ff_fb"


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases([CASE], settings)[0])


def true_ratio(setup: Setup, memory: Memory, path: Path) -> float:
    """Return the error of the true accelerations over that of SIM-DELAY, both on the specimen as it is."""
    path.unlink(missing_ok=True)
    ended = run_case(setup, path, memory, "test", lambda _: None, series="none")
    assert ended.status == "complete", ended.reason
    return float(np.max(read_result(path).metrics["exp_rths.true_reference_ratio"]))


@pytest.mark.campaign
def test_with_coarse_samples_the_specimen_is_trusted(tmp_path: Path, memory: Memory) -> None:
    """Also where the specimen has changed by as much as the choice allows for, the true error is smaller than with the
    usual filter; the check sees no change."""
    for changed in ((), ("table.after_identification.specimen_stiffness_factor=0.995",)):
        chosen = true_ratio(setup_of(*COARSE, *changed), memory, tmp_path / "chosen.h5")
        usual = true_ratio(setup_of(*COARSE, *changed, "kalman.choice=stated"), memory, tmp_path / "usual.h5")
        assert usual > 0.14 and chosen < 0.8 * usual, (changed, chosen, usual)
        if not changed:
            assert chosen < 0.08
            values = read_result(tmp_path / "chosen.h5").metrics
            expected = np.asarray(values["check.rms_error_m_s2"]) / np.asarray(values["sim_delay.rms_error_m_s2"])
            assert 1.0 / 1.7 < expected.max() / chosen < 1.7
            assert float(values["controller.chosen_kalman_q"]) < 1.0
            assert values["controller.reaction_feedforward"] == 0.0 < values["controller.friction_compensation"] == 1.0


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("settings", "factor"),
    [
        (("kalman={q: 0.001, residual_hz: 0.4}", "controller.reaction_feedforward=false"), 1.005),
        (("controller.reaction_feedforward=false",), 0.97),
        (("controller.reaction_feedforward=true",), 0.7),
        (("controller.reaction_feedforward=true",), 1.3),
    ],
)
def test_a_changed_specimen_costs_what_is_expected(
    settings: tuple[str, ...], factor: float, tmp_path: Path, memory: Memory
) -> None:
    """Against runs on a rig without noise, bits and friction, by the true error. A trusting filter has 15 times the
    error of the usual one; with a countered reaction it takes 30 % to see any."""
    exact = (
        "table.sensors.noise_rms_m_s2=0", "table.converters.bits=0", "table.physics.coulomb_n=0",
        "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0}",
    )  # fmt: skip
    setup = setup_of(*exact, *settings, "runs=[sim, sim_delay, exp_rths]")
    there = f"table.after_identification.specimen_stiffness_factor={factor}"
    path = tmp_path / "changed.h5"
    run = setup_of(*exact, *settings, "runs=[sim, sim_delay, exp_rths]", there)
    assert run_case(run, path, memory, "test", lambda _: None).status == "complete"
    measured = np.asarray(read_result(path).metrics["exp_rths.true_reference_rms_error_m_s2"])
    found = memory.identify(setup, lambda _: None)
    design = design_blocks(setup, found)
    known = judge(setup, found, design).known
    assert known is not None
    without = predict(known)
    changed = changed_specimen_error(setup, found, design.blocks.linearised(), known, without, factor)
    np.testing.assert_allclose(measured, np.hypot(changed, without.total.storeys), rtol=0.1)


@pytest.mark.campaign
def test_the_choice_is_told_and_repeats_as_stated(memory: Memory) -> None:
    setup = setup_of(*COARSE)
    known = memory.at_rest(setup, lambda _: None)
    design = verdict_on(setup, known).design
    assert design is not None and design.chosen_filter is not None
    (told,) = [one for one in sentences(of_case(setup, known.found, design)) if one.startswith("kalman:")]
    q, hz = design.chosen_filter.q, design.chosen_filter.residual_hz
    assert f"q: {q:g}, residual_hz: {hz:.3g}" in told
    again = setup_of(*COARSE, f"kalman={{q: {q}, residual_hz: {hz}}}")
    assert again.case.kalman.choice == "stated"
    same = verdict_on(again, known).design
    assert same is not None and same.chosen_filter is None
    np.testing.assert_array_equal(same.blocks.estimator.A, design.blocks.estimator.A)


@pytest.mark.campaign
@parametrize_first(
    1,
    "settings",
    [
        (),  # as it is: no choice is needed
        (*COARSE, "kalman.r=1.0", "kalman.choice=stated"),
        (*COARSE, "kalman.q=1000.0"),
        (*COARSE, "kalman.residual_hz=40.0"),
        (*COARSE, "check.specimen_range=[0.8, 1.0]"),  # a specimen that may change cannot be trusted
        (*COARSE, "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0, specimen: 0.05}"),
        (*COARSE, "method=paper"),
    ],
)
def test_the_usual_filter_stays(settings: tuple[str, ...], memory: Memory) -> None:
    setup = setup_of(*settings)
    design = verdict_on(setup, memory.at_rest(setup, lambda _: None)).design
    assert design is not None and design.chosen_filter is None


@pytest.mark.campaign
def test_a_filter_that_a_damaged_specimen_makes_unstable_is_not_chosen(
    memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All filters that trust the specimen are unstable at 0.7 of its stiffness; then the reaction is countered."""
    monkeypatch.setattr(check_command, "KNOWN_RANGE", (0.7, 1.0))
    found = designed(memory, *COARSE)
    assert found.chosen_filter is None and found.blocks.counters_reaction


@pytest.mark.campaign
def test_a_specimen_whose_stiffness_depends_on_the_level_is_trusted_less(memory: Memory) -> None:
    """Frequencies that differ between rest and the identification's level by more than they are known to."""
    setup = setup_of(*COARSE)
    found = memory.identify(setup, lambda _: None)
    fit = found.specimen
    assert fit is not None
    bent = replace(found, specimen=replace(fit, frequency_error_hz=0.006 * fit.natural_frequency_hz))
    assert stiffness_uncertainty(setup, bent) == pytest.approx(np.hypot(0.012, setup.rig.uncertainty.specimen))
    trusted = [choose_design(setup, one, design_blocks(setup, one))[0].chosen_filter for one in (found, bent)]
    assert trusted[0] is not None and trusted[0].q < 1.0
    assert trusted[1] is None or trusted[1].q > trusted[0].q


@pytest.mark.campaign
def test_without_a_better_filter_the_reaction_is_countered(memory: Memory) -> None:
    unsure = "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0, specimen: 0.05}"
    found = designed(memory, *COARSE, unsure)
    assert found.chosen_filter is None and found.blocks.counters_reaction


def test_a_resolved_case_leaves_the_same_choice() -> None:
    """The case as resolved states every key; loaded again it must not be taken for one that states the weights."""
    case = setup_of(*COARSE).case
    assert case.kalman.choice == "automatic"
    assert case.kalman.model_dump() == {"q": 1000.0, "r": 1.0, "residual_hz": 40.0, "choice": "automatic"}


def designed(memory: Memory, *settings: str) -> Design:
    """Return the design that a case gets, from the identification of its rig."""
    setup = setup_of(*settings)
    design = verdict_on(setup, memory.at_rest(setup, lambda _: None)).design
    assert design is not None
    return design


@pytest.mark.campaign
def test_automatic_counters_the_reaction_where_the_test_is_safe_with_it(memory: Memory) -> None:
    """The design is that of a case that asks for it, and it is told as a metric only."""
    design, asked = designed(memory), designed(memory, "controller.reaction_feedforward=true")
    assert design.blocks.counters_reaction and design.plain is None
    assert content_key(design.blocks) == content_key(asked.blocks)
    setup = setup_of()
    (checked,) = check_cases([setup.case], (), lambda _: None, memory)
    assert checked.verdict == SAFE and not checked.tangents
    assert checked.metrics["controller.reaction_feedforward"] == 1.0
    assert checked.metrics["controller.friction_compensation"] == 1.0
    assert not [told for told in checked.warnings if "reaction" in told or "friction" in told]


@pytest.mark.campaign
@parametrize_first(1, "settings", [COARSE, ("method=paper",), ("controller=none",), ("runs=[shake_table]",)])
def test_automatic_leaves_the_design_as_it_is_without(settings: tuple[str, ...], memory: Memory) -> None:
    """With coarse samples another filter is chosen; the others have no such feedforward, or no check that judges it."""
    off = "controller.reaction_feedforward=false"
    setups = [setup_of(*settings, *more) for more in ((), (off,))]
    known = memory.at_rest(setups[0], lambda _: None)
    found, without = (verdict_on(one, known, "exp_rths" in one.case.runs) for one in setups)
    assert found.design is not None and without.design is not None
    assert not found.design.blocks.counters_reaction and found.design.reaction_left is None
    assert content_key(found.design.blocks) == content_key(without.design.blocks)
    assert (found.verdict, found.reasons) == (without.verdict, without.reasons)
    assert {path: np.asarray(value).tolist() for path, value in found.figures.items()} == {
        path: np.asarray(value).tolist() for path, value in without.figures.items()
    }


@pytest.mark.campaign
def test_a_table_that_does_not_show_its_compliance_is_told(default_identification: Identification) -> None:
    best, setup = default_identification.best, setup_of("controller=FF")
    zeros = np.where(best.zeros != 0.0, 1.2 * best.zeros, 0.0)  # no table with this specimen has them
    strange = replace(default_identification, best=replace(best, zeros=zeros))
    design = design_blocks(setup, strange)
    assert design.plain is None and not design.blocks.counters_reaction
    (told,) = [
        one for one in sentences(of_case(setup, strange, design)) if one.startswith("controller.reaction_feedforward:")
    ]
    assert "automatic leaves it off: the identified table does not show" in told
    with pytest.raises(InputError, match="does not show"):
        design_blocks(setup_of("controller=FF", "controller.reaction_feedforward=true"), strange)
    sampled = replace(default_identification, samples=(strange,))  # the reaction needs every sample's compliance
    found, judged = choose_design(setup, sampled, design_blocks(setup, sampled))
    assert not found.blocks.counters_reaction and len(judged.samples) == 1


def test_a_feedforward_of_the_callers_own_gets_the_plain_one(default_identification: Identification) -> None:
    """And takes its place: nothing is countered, and nothing is said."""
    seen: list[PartDesign] = []

    def same(designed: PartDesign) -> PartDesign:
        seen.append(designed)
        return designed

    setup = make_setup(load_cases([CASE])[0], parts={"feedforward": same})
    design = design_blocks(setup, default_identification)
    assert design.plain is None and not design.blocks.counters_reaction and design.reaction_left is None
    off = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"
    plain = design_blocks(setup_of(off), default_identification)
    assert content_key(seen[0]) == content_key(plain.blocks.feedforward) and len(seen) == 1


@pytest.mark.campaign
def test_a_loop_that_is_not_safe_with_another_specimen_is_judged_without(
    default_identification: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thirty times as stiff, to have one: without the reaction the table's response is taken as it was identified."""
    monkeypatch.setattr(check_command, "REACTION_RANGE", (30.0, 1.0))
    words = "controller={{kind: FF+FB, command_weight: 0.0047, reaction_feedforward: {}}}"
    automatic, off = (
        make_setup(load_cases(["el_centro_bare_ff_fb"], (words.format(key),))[0]) for key in ("automatic", "false")
    )
    identified = default_identification
    found, judged = choose_design(automatic, identified, design_blocks(automatic, identified))
    without, wanted = choose_design(off, identified, design_blocks(off, identified))
    assert not found.blocks.counters_reaction and content_key(found.blocks) == content_key(without.blocks)
    assert (judged.preflight.verdict, judged.preflight.reasons) == (SAFE, ()) == (wanted.preflight.verdict, ())
    (told,) = [one for one in sentences(of_case(automatic, identified, found)) if one.startswith("controller.reaction")]
    assert "automatic leaves it off: the test would not be safe with it: with specimen at 3e+03 %" in told


@pytest.mark.campaign
def test_a_row_of_a_sweep_gets_the_design_that_its_case_gets_alone(memory: Memory) -> None:
    """Rows share one design before the check; the check takes the reaction off for one of them."""
    shared, taken = Shared((), lambda _: None), []
    for scaling in ("0.3", "0.064", "0.3"):
        settings = (*COARSE[1:], f"scaling={scaling}")
        alone, row = designed(memory, *settings), shared.ready(setup_of(*settings).case).checked.design
        assert row is not None and content_key(row.blocks) == content_key(alone.blocks)
        taken.append((row.blocks.counters_reaction, row.chosen_filter is not None))
    assert taken == [(True, False), (False, True), (True, False)]
