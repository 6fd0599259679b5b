"""The filter of the floors that a case gets: the usual one, or one that trusts the identified specimen where the
rounding of the samples would be most of the error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rths_cli.analysis.changed_specimen import error_if_changed
from rths_cli.analysis.predicted_error import predict
from rths_cli.case.load import load_cases
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check import as_identified, judge
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.structure.tangents import at_rest

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


def test_a_changed_specimen_costs_what_is_expected(tmp_path: Path, memory: Memory) -> None:
    """Against runs on a rig without noise, bits and friction, by the true error; the trusting filter has 15 times that
    of the usual one."""
    exact = ("table.sensors.noise_rms_m_s2=0", "table.converters.bits=0", "table.physics.coulomb_n=0")
    trusting = ("kalman={q: 0.001, residual_hz: 0.4}", "runs=[sim, sim_delay, exp_rths]")
    factor = "table.after_identification.specimen_stiffness_factor=1.005"
    setup = setup_of(*exact, *trusting)
    path = tmp_path / "changed.h5"
    assert run_case(setup_of(*exact, *trusting, factor), path, memory, "test", lambda _: None).status == "complete"
    measured = np.asarray(read_result(path).metrics["exp_rths.true_reference_rms_error_m_s2"])
    found = memory.identify(setup, lambda _: None)
    known, fit = judge(setup, found, design_blocks(setup, found)).known, found.specimen
    assert known is not None and fit is not None
    table = predict(known).nominal.corrected[0]
    expected = error_if_changed(known, at_rest(as_identified(setup, fit.specimen)), table, 0.005)
    np.testing.assert_allclose(measured, expected, rtol=0.1)


def test_the_choice_is_told_and_repeats_as_stated(memory: Memory) -> None:
    setup = setup_of(*COARSE)
    known = memory.at_rest(setup, lambda _: None)
    design = verdict_on(setup, known).design
    assert design is not None and design.chosen_filter is not None
    (told,) = [one for one in of_case(setup, known.found, design) if one.startswith("kalman:")]
    q, hz = design.chosen_filter.q, design.chosen_filter.residual_hz
    assert f"q: {q:g}, residual_hz: {hz:.3g}" in told
    again = setup_of(*COARSE, f"kalman={{q: {q}, residual_hz: {hz}}}")
    assert again.case.kalman.choice == "stated"
    same = verdict_on(again, known).design
    assert same is not None and same.chosen_filter is None
    np.testing.assert_array_equal(same.blocks.estimator.A, design.blocks.estimator.A)


@pytest.mark.parametrize(
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


def test_a_resolved_case_leaves_the_same_choice() -> None:
    """The case as resolved states every key; loaded again it must not be taken for one that states the weights."""
    case = setup_of(*COARSE).case
    assert case.kalman.choice == "automatic"
    assert case.kalman.model_dump() == {"q": 1000.0, "r": 1.0, "residual_hz": 40.0, "choice": "automatic"}
