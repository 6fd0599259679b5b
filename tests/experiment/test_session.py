"""The record before the table runs: what it finds of a drift, who plays it, and what becomes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from docs_running import shortened

from rths_cli.case.load import load_cases
from rths_cli.experiment import model_verification, run_command, session
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import save
from rths_cli.experiment.real_rig_readiness import (
    EXP_RTHS,
    IDENTIFICATION,
    PROBE,
    SHAKE_TABLE,
    VERIFICATION,
    session_of,
)
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.run_command import Request, run_batch
from rths_cli.experiment.session import session_key, with_session
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import SessionChange
from rths_cli.rigs.from_case import true_values_of_run
from rths_cli.studies import sweep_runs
from rths_cli.studies.engines import Engine
from rths_cli.studies.row_of_sweep import read_row
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep import SweepRequest, run_sweep
from rths_cli.studies.sweep_runs import Shared, play_variant
from rths_cli.studies.sweep_table import flat, kept_columns

WATCHED = ("doing", "message", "warning", "started", "ended", "confirm")  # of what is told of runs
PER_RUN = "channels.gain_change_between_runs"
LATER = "table.after_identification.command_skew_s=1e-4"
CERTAIN = "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0}"
DRAWN = "table.imperfections.laboratory=4"  # one laboratory for all seeds
QUICK = ("table=aps400_laboratory", "identification.duration_s=60", "sample_rate_hz=1000", "seed=4")


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0], ("check", "model"))


def played(setup: Setup, path: Path, memory: Memory, series: str = "none") -> list[str]:
    """Run a case; return what it told of its motions."""
    said: list[str] = []
    assert run_case(setup, path, memory, "test", said.append, series=series).status == "complete"
    return said


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Return what makes a laboratory quick, the first 14 s of the record among it."""
    path = tmp_path_factory.mktemp("record") / "short.csv"
    shortened(Path(__file__).parents[2] / "records" / "el_centro.csv", path, 700)
    return *QUICK, f"record.file={path}"


@pytest.fixture(scope="module")
def laboratory(
    tmp_path_factory: pytest.TempPathFactory, quick: tuple[str, ...]
) -> tuple[Setup, Memory, Path, list[str]]:
    setup, memory = setup_of(*quick, "runs=[sim, sim_delay, shake_table, exp_rths]"), Memory()
    path = tmp_path_factory.mktemp("session") / "laboratory.h5"
    return setup, memory, path, played(setup, path, memory, "all")


@pytest.mark.campaign
def test_the_drift_of_a_laboratory_is_found_by_the_record(laboratory: tuple[Setup, Memory, Path, list[str]]) -> None:
    setup, _, path, said = laboratory
    assert [text for text in said if text.startswith("probe")] == 2 * ["probe of 25 s at 0.4 m/s^2 rms"]
    then = true_values_of_run(setup.case, setup.rig, (setup.case.identification.seed, IDENTIFICATION))[PER_RUN]
    with h5py.File(path) as file:
        now = file["exp_rths/truth/channels_gain_change_between_runs"][()]
        assert np.array_equal(now, file["shake_table/truth/channels_gain_change_between_runs"][()])
        found, error = (file[f"session/gain_over_table_change{end}"][()] for end in ("", "_error"))
        assert file["session/unexplained"][()] < 2.0
        assert not file["session/late_change_s"][()].any()
    true = (now - then) - (now - then)[0]
    assert np.abs(true[1:]).max() > 2e-4  # there is something to be found
    assert np.all(error[1:] < 1e-4) and np.all(np.abs(found - true)[1:] < 3.0 * error[1:])


@pytest.mark.campaign
def test_the_bound_counts_what_is_left_of_the_drift(
    laboratory: tuple[Setup, Memory, Path, list[str]], quick: tuple[str, ...]
) -> None:
    setup, memory, _, _ = laboratory
    without = setup_of(*quick, "session_record=never")
    tested, blind = (verdict_on(one, memory.known(one, lambda _: None)).figures for one in (setup, without))
    for name in ("check.true_error_bound_m_s2", "check.expected_error_m_s2"):
        assert np.all(np.asarray(tested[name]) < np.asarray(blind[name])), name
    assert memory.identify(setup, lambda _: None).session is None
    assert memory.known(without, lambda _: None).found.session is None
    assert memory.known(setup, lambda _: None).found.session is not None


@pytest.mark.campaign
def test_a_converter_that_acts_later_than_at_the_identification_is_found(tmp_path: Path, memory: Memory) -> None:
    """100 us between the converters, on a stiff table: the alias of the held command is another."""
    ratios, runs = {}, "runs=[sim, sim_delay, exp_rths]"
    for name, stated in (("usual", ()), ("certain", (CERTAIN,))):
        path = tmp_path / f"{name}.h5"
        played(setup_of(runs, LATER, *stated), path, memory)
        ratios[name] = float(np.max(read_result(path).metrics["exp_rths.true_reference_ratio"]))
    assert ratios["usual"] <= 0.02 and ratios["certain"] > 0.1  # where nothing is uncertain no record is played
    with h5py.File(tmp_path / "usual.h5") as file:
        change, error = (float(file[f"session/ripple_change{end}_m_s2_per_v"][()]) for end in ("", "_error"))
        assert change == pytest.approx(2.5, abs=3.0 * error) and error < 0.04
        assert float(file["session/delay_change_s"][()]) == pytest.approx(1e-4, rel=0.1)
    over = np.asarray(read_result(tmp_path / "usual.h5").metrics["exp_rths.error_over_expected"])
    assert np.all(np.abs(np.log(over)) < np.log(1.5))
    with h5py.File(tmp_path / "certain.h5") as file:
        assert "session" not in file
    assert "converters act at other instants" in read_result(tmp_path / "usual.h5").attributes["warnings"]


@pytest.mark.campaign
def test_what_is_no_drift_is_told_and_not_taken_up(memory: Memory) -> None:
    setup = setup_of("runs=[sim, sim_delay, exp_rths]")
    known = memory.identify(setup, lambda _: None)
    nothing, some = np.zeros(3), np.array([0.0, 0.0, 1.0])
    for gain, late_s, ripple, words in (
        (0.05 * some, nothing, 0.0, "+5 %, which is no drift: look at sensor and mount, identify again"),
        (nothing, 2.0 * setup.rig.dt_s * some, 0.0, "more than a sample interval"),
        (nothing, nothing, 100.0, "more than any instant of sampling explains"),
    ):
        found, (told,) = with_session(setup, known, SessionChange(gain, late_s, ripple, np.eye(7), 1.0))
        assert found is known and words in str(told)
    small = SessionChange(0.02 * some, nothing, 0.0, np.zeros((7, 7)), 1.0)
    assert with_session(setup, known, small)[0].session is small
    found, (told,) = with_session(setup, known, "samples are lost")
    assert found is known and "samples are lost" in str(told)


@pytest.mark.campaign
def test_a_rig_that_has_not_changed_loses_nothing_by_the_record(tmp_path: Path, memory: Memory) -> None:
    ratios = []
    for asked in ("always", "never"):
        path = tmp_path / f"{asked}.h5"
        played(setup_of("runs=[sim, sim_delay, exp_rths]", f"session_record={asked}"), path, memory)
        ratios.append(float(np.max(read_result(path).metrics["exp_rths.true_reference_ratio"])))
    assert ratios[0] == pytest.approx(ratios[1], rel=0.02) and ratios[0] <= 0.012


@pytest.mark.campaign
def test_the_record_that_verifies_a_model_file_is_that_of_the_session(tmp_path: Path, memory: Memory) -> None:
    setup, path, said = setup_of("runs=[exp_rths]"), tmp_path / "table.h5", list[str]()
    save(path, setup, memory.identify(setup, lambda _: None), "made for this test", "0" * 64)
    stored = setup_of("runs=[exp_rths]", f"identification.model={path}", "session_record=always", LATER)
    fresh = Memory()
    found = [fresh.known(stored, said.append).found for _ in range(2)]
    assert [text for text in said if text.startswith("probe")] == ["probe of 25 s at 0.4 m/s^2 rms"]
    assert found[0].session is not None and found[0].session.ripple_m_s2_per_v == pytest.approx(2.5, abs=0.1)


@pytest.mark.campaign
def test_a_verification_is_judged_with_the_gains_of_its_session(
    laboratory: tuple[Setup, Memory, Path, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, memory, _, _ = laboratory
    save(tmp_path / "lab.h5", lab, memory.identify(lab, lambda _: None), "made for this test", "0" * 64)
    seen: list[Record] = []

    def judged(setup, known, record):
        seen.append(record)
        return compared(setup, known, record)

    compared = model_verification.compared
    monkeypatch.setattr(session, "change_shown", lambda setup, known, record: seen.append(record) or CHANGED)
    monkeypatch.setattr(model_verification, "compared", judged)
    stored = setup_of(*QUICK, "runs=[exp_rths]", f"identification.model={tmp_path / 'lab.h5'}")
    known = Memory().known(stored, lambda _: None)
    played_then, judged_then = (record.accel_m_s2 for record in seen)
    assert not any("specimen mode" in str(one) for one in known.reasons), "another level is no change"
    assert played_then / np.exp(CHANGED.gain)[:, None] == pytest.approx(judged_then, rel=1e-9)


CHANGED = SessionChange(np.array([0.0, 0.004, -0.003]), np.zeros(3), 0.0, 1e-10 * np.eye(7), 1.0)


@pytest.mark.campaign
def test_runs_of_a_case_are_in_one_session() -> None:
    setup = setup_of("table=aps400_laboratory", "seed=4", "identification.seed=2")
    assert session_of(setup, (IDENTIFICATION,), 2) == session_of(setup, (PROBE, 1), 2) == (2, IDENTIFICATION)
    before = session_of(setup, (VERIFICATION,), 2)
    assert before == session_of(setup, (EXP_RTHS,), 4) == session_of(setup, (SHAKE_TABLE,), 4) == (4, EXP_RTHS)
    assert session_of(setup, (EXP_RTHS,), 9) == before  # a repetition in a sweep, whose blocks are those of this case
    alone = setup_of("table=aps400_laboratory", "seed=4", "session_record=never")
    assert session_of(alone, (EXP_RTHS,), 9) == (9, EXP_RTHS)


@pytest.mark.campaign
def test_a_row_of_a_sweep_has_the_metrics_of_the_run(
    laboratory: tuple[Setup, Memory, Path, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drift of the channels is taken off in both, and the row of another seed is in the session of the sweep's case."""
    setup, memory, path, _ = laboratory
    monkeypatch.setattr(sweep_runs, "Memory", lambda *_: memory)
    kept, ready = kept_columns(None, None), Shared(("check", "model"), lambda _: None).ready(setup.case)
    row = play_variant(ready, 0, setup.case.seed, kept, 3)
    assert row.figures == pytest.approx(flat(kept, 3, read_result(path).metrics), rel=1e-9, abs=0.0, nan_ok=True)
    other = replace(setup_of(*QUICK[:-1], "seed=5"), session_seed=setup.case.seed)
    assert session_of(other, (EXP_RTHS,), 5) == session_of(setup, (EXP_RTHS,), 5)


@pytest.mark.campaign
def test_a_row_of_a_drifting_laboratory_is_run_in_the_session_of_its_sweep(
    laboratory: tuple[Setup, Memory, Path, list[str]],
    quick: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As `rths run --from` does; without the sweep's session the channels have drifted elsewhere."""
    _, memory, _, _ = laboratory
    for module in (sweep_runs, run_command):
        monkeypatch.setattr(module, "Memory", lambda *_: memory)
    alone, silent = ("check", "model"), SimpleNamespace(**dict.fromkeys(WATCHED, lambda *_: None))
    asked = Asked("el_centro_low_ff_fb", (*quick, DRAWN), (), "5:5")
    request = SweepRequest(asked, tmp_path / "s.h5", None, Engine("inline"), True, False, "test", alone)
    run_sweep(request, silent)  # type: ignore[arg-type]
    row = read_row(tmp_path / "s.h5", 1, ("runs=[sim, sim_delay, exp_rths]",))
    assert (row.case.seed, row.session_seed, row.overrides) == (5, 4, alone)

    def differences(session_seed: int | None) -> list[str]:
        request = Request(
            (row.case,), (), tmp_path / str(session_seed), True, "test", row.overrides, session_seed=session_seed
        )
        (ended,) = run_batch(request, silent)  # type: ignore[arg-type]
        assert ended.path is not None
        return row.differences(read_result(ended.path))

    assert differences(row.session_seed) == []
    assert differences(None) != []


def test_the_session_is_that_of_the_sweep_not_of_the_row() -> None:
    row, case = (setup_of(*QUICK[:-1], DRAWN, f"seed={seed}") for seed in (5, 4))
    assert session_key(row) != session_key(case) == session_key(replace(row, session_seed=4))


def test_points_of_a_sweep_in_other_sessions_share_no_blocks() -> None:
    shared, drawn = Shared((), lambda _: None), ("table=aps400_laboratory", "table.imperfections.laboratory=7")

    def design(seed: int, *settings: str) -> str:
        return shared.keys(setup_of(*drawn, f"seed={seed}", *settings)).design

    assert design(1) != design(2)
    assert design(1, "session_record=never") == design(2, "session_record=never")
