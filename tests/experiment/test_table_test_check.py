"""The shake-table test is judged by its own loop before it moves, and refused like EXP-RTHS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaigns.judged_run_trials import tried
from portfolio import parametrize_first

from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE
from rths_cli.case.load import load_cases
from rths_cli.errors import LimitError
from rths_cli.experiment.check_command import Verdict, excitations, verdict_on
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.excitation_plan import excitation_faults, excitation_reach, plan
from rths_cli.experiment.identify_on_rig import excite
from rths_cli.experiment.model_choice import IdentifiedModel
from rths_cli.experiment.one_table_run import HYBRID_TEST, SHAKE_TABLE_TEST, plan_run, play_run, run_of
from rths_cli.experiment.run_case import refusal_of
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.findings import sentences, stated
from rths_cli.identification.results import Identification

SHORT_SEED = 32  # stiff: modes in and above the identified band


def table_only(setup: Setup, *settings: str, overrides: tuple[str, ...] = ()) -> Setup:
    """Return a case whose only table run is the shake-table test."""
    return make_setup(load_cases([setup.case.path], ["runs=[shake_table]", *settings])[0], overrides)


def louder(setup: Setup, identified: Identification, factor: float) -> Verdict:
    """Return the verdict with a feedback of so many times its gain."""
    design = design_blocks(setup, identified)
    block = design.blocks.linear_parts()[2]
    loud = replace(block, C=factor * block.C, D=factor * block.D)
    design = replace(design.without_reaction(), blocks=replace(design.without_reaction().blocks, feedback=loud))
    return verdict_on(setup, IdentifiedModel(identified, "test"), False, design)


@parametrize_first(1, "method", ["best", "paper"])  # paper: its leaky inverse has a double root slower than a record
def test_peaks_are_those_of_the_table(
    default_setup: Setup, default_identification: Identification, method: str
) -> None:
    setup = table_only(default_setup, f"method={method}")
    found = verdict_on(setup, IdentifiedModel(default_identification, "test"), False)
    assert found.table_test is not None and found.table_test.verdict == SAFE == found.worst
    assert found.design is not None and refusal_of(setup, found, SHAKE_TABLE_TEST) is None
    outcome = play_run(plan_run(setup, found.design, SHAKE_TABLE_TEST), 1)
    run = run_of(outcome, setup, SHAKE_TABLE_TEST, found.design.blocks.lead_samples, None)
    true = np.abs(run.series.true_accel).max(), setup.rig.gain_m_per_v * np.abs(outcome.log.command_v).max()
    peaks = [float(np.asarray(found.figures[f"check.shake_table_peak_{name}"])) for name in
             ("acceleration_m_s2", "command_v")]  # fmt: skip
    assert peaks[0] == pytest.approx(true[0], rel=0.1)
    assert setup.rig.gain_m_per_v * peaks[1] == pytest.approx(true[1], rel=0.05)


def test_a_loop_that_is_not_safe_is_refused(default_setup: Setup, default_identification: Identification) -> None:
    """Its own loop decides, not that of EXP-RTHS: without feedback nothing is around the table."""
    setup = table_only(default_setup)
    assert louder(setup, default_identification, 1.0).worst == SAFE
    assert louder(setup, default_identification, 0.0).worst == SAFE
    found = louder(setup, default_identification, 3.0)
    assert found.table_test is not None and found.worst in (UNSAFE, UNSTABLE)
    stop = refusal_of(setup, found, SHAKE_TABLE_TEST)
    assert stop is not None and stop.status == "refused" and stop.exit_code == 1
    assert stop.reason.startswith("shake-table test refused, un") and "--override check" in stop.reason
    assert refusal_of(setup, found, HYBRID_TEST) is None  # it was not asked for
    assert refusal_of(table_only(default_setup, overrides=("check",)), found, SHAKE_TABLE_TEST) is None


def test_too_much_of_a_record_is_refused_with_its_limit(
    default_setup: Setup, default_identification: Identification
) -> None:
    setup = table_only(default_setup, "scaling=20")
    found = verdict_on(setup, IdentifiedModel(default_identification, "test"), False)
    assert found.table_test is not None and found.worst == UNSAFE
    assert any("limits.stroke_m" in reason or "converters.range_v" in reason for reason in found.table_test.reasons)


def test_model_that_is_rejected_refuses_the_table_test_too(
    default_setup: Setup, default_identification: Identification
) -> None:
    setup = table_only(default_setup)
    found = verdict_on(
        setup, replace(IdentifiedModel(default_identification, "test"), reasons=(stated("made up"),)), False
    )
    assert found.worst == UNSAFE and "made up" in "; ".join(sentences(found.of_run("shake_table")[1]))


def test_excitations_are_judged_by_their_command(default_setup: Setup, default_identification: Identification) -> None:
    command = plan(default_setup).command_v
    rows = {row.name: row for row in excitation_reach(default_setup, command)}
    assert rows["command_v"].peak == pytest.approx(np.abs(command).max(), rel=1e-6)
    assert not excitation_faults(default_setup, command)
    told = dict(excitations(default_setup, IdentifiedModel(default_identification, "test")))
    assert told["identification"] == ()
    with pytest.raises(LimitError, match=r"refused: .*limits.*reserve"):
        excite(default_setup, 0.95 * default_setup.rig.converters.range_v * command / np.abs(command).max())


@pytest.mark.campaign
def test_random_runs_move_as_planned(tmp_path: object) -> None:
    """The short form of benchmarks/judged_runs.py: what is not refused keeps to its plan, with the true motion."""
    trial = tried(SHORT_SEED, tmp_path)  # type: ignore[arg-type]
    assert [each.run for each in trial.runs][-2:] == ["shake_table", "exp_rths"]
    assert all(each.kept for each in trial.runs if not each.refused)
