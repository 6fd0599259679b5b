"""What an interrupted run left becomes a result: the same samples as the run that was not interrupted, only fewer."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from declared_contents import declaration_faults
from portfolio import parametrize_first
from python_models import Inverse, Storeys

from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.control.interface import Logged, OwnParts
from rths_cli.control.python_parts import PythonFeedforward, PythonSubstructure
from rths_cli.errors import InputError
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import TABLE_RUNS, plan_run, play_run
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.raw_log import RawHeader, RawLogWriter, raw_log_path
from rths_cli.files.result_reader import ResultWriter, read_result
from rths_cli.laboratory.recover import recover
from rths_cli.loop.run_log import Signals
from rths_cli.numerics.lti import Block
from rths_cli.quantities import DATASETS

CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
IDENTIFIED = "\nidentification:\n  model: /gone/model.h5\n"
TRUTH = ("true_velocity_m_s_0", "true_velocity_m_s_1", "true_velocity_m_s_2", "true_displacement_m")


@dataclass(frozen=True)
class Played:
    """A case that ran to its end: its result, and header and columns of the raw log of each run on the table."""

    folder: Path
    result: Path
    logs: dict[str, tuple[RawHeader, np.ndarray]]


def named(log: Signals) -> dict[str, np.ndarray]:
    """Return the signals of a log by the names of the columns of a raw log."""
    desired = ("desired_accel_m_s2", "desired_velocity_m_s", "desired_displacement_m")
    return {
        "command_v": log.command_v,
        **dict(zip(desired, log.desired, strict=True)),
        **{f"corrected_{i}": row for i, row in enumerate(log.corrected)},
        **{f"estimated_{i}": row for i, row in enumerate(log.estimated)},
        **{f"logged_{i}": row for i, row in enumerate(log.logged)},
        "base_shear_n": log.base_shear_n,
        "compute_ns": log.compute_ns,
        "sample_v_0": log.command_v,
        **{f"true_velocity_m_s_{i}": row for i, row in enumerate(log.true_velocity_m_s)},
        "true_displacement_m": log.true_displacement_m,
    }


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory, memory: Memory) -> Played:
    return played_in(tmp_path_factory.mktemp("played"), memory)


def played_in(folder: Path, memory: Memory, parts: OwnParts | None = None) -> Played:
    """Run the case to its end, with parts of one's own, and keep what the raw logs would hold."""
    time_s = np.arange(0.0, 4.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
    (folder / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{a:.6f}" for a in accel))
    (folder / "a.yaml").write_text(CASE)
    setup = make_setup(load_cases([folder / "a.yaml"], ["runs=[shake_table, exp_rths]"])[0], ("check",), parts=parts)
    known = memory.known(setup, lambda _: None)
    checked = verdict_on(setup, known)
    assert checked.design is not None
    result = folder / "a.h5"
    assert run_case(setup, result, memory, "rths run a.yaml", lambda _: None).exit_code == 0
    told = ("format", "format_version", "status", "status_reason")
    attributes = {key: value for key, value in read_result(result).attributes.items() if key not in told}
    logs = {}
    for kind in TABLE_RUNS:
        outcome = play_run(plan_run(setup, checked.design, kind), setup.case.seed)
        columns = named(outcome.log)
        header = RawHeader(
            tuple(columns),
            ("1",) * len(columns),
            setup.rig.dt_s,
            outcome.steps,
            checked.design.blocks.lead_samples,
            kind.name,
            "a.h5",
            str(setup.case.path),
            setup.case.yaml_text,
            resolved_yaml(setup.case),
            attributes,
            logs=tuple((one.name, one.units, one.ahead) for one in checked.design.blocks.logs),
        )
        logs[kind.name] = (header, np.array(list(columns.values())))
    return Played(folder, result, logs)


def begun(played: Played, path: Path) -> Path:
    """Write what stands in a result while the table moves: all but the runs and their figures."""
    shutil.copy(played.result, path)
    with h5py.File(path, "a") as file:
        for name in ("shake_table", "exp_rths", "metrics"):
            del file[name]
        file.attrs.update({"status": "interrupted", "status_reason": "the table moves"})
    return path


def left(played: Played, folder: Path, run: str, steps: int, header: RawHeader | None = None) -> Path:
    """Write the raw log of a run that was killed after some steps."""
    told, columns = played.logs[run]
    told = header or told
    path = raw_log_path(folder / told.result, run)
    with RawLogWriter(path, told) as log:
        for first in range(0, steps, 100):
            log.append(first, columns[:, first : min(first + 100, steps)])
    return path


def series(path: Path, run: str) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file[run].visititems(
            lambda name, node: found.update({name: node[()]}) if isinstance(node, h5py.Dataset) else None
        )
    return found


def _elsewhere(resolved: str, folder: str, gone: str) -> str:
    """Return a resolved case that names a model, and another folder."""
    return resolved.replace("\nidentification:\n", IDENTIFIED).replace(folder, gone)


@pytest.mark.campaign
@parametrize_first(1, "present", [True, False], ids=["result begun", "no result"])
def test_a_recovered_run_is_the_start_of_the_whole_one(played: Played, tmp_path: Path, present: bool) -> None:
    result = tmp_path / "a.h5"
    if present:
        begun(played, result)
    gone = "/gone" if present else str(played.folder)  # the result has the record
    given = {
        run: replace(header, resolved_yaml=_elsewhere(header.resolved_yaml, str(played.folder), gone))
        for run, (header, _) in played.logs.items()
    }
    killed = (("shake_table", 3001), ("exp_rths", 5000))
    logs = [left(played, tmp_path, run, steps, given[run]) for run, steps in killed]
    two, one = (recover([log])[0] for log in reversed(logs))
    assert (one.samples, two.samples, two.steps) == (3001, 5000, played.logs["exp_rths"][0].steps)
    whole, part = read_result(played.result), read_result(result)
    note = (
        f"EXP-RTHS: 5000 of {two.steps} steps of the record (2.500 s of 4.492 s) are recovered from a.exp_rths.rthslog"
    )
    assert two.note == note and one.note.startswith("shake-table test: 3001 of")
    assert part.attributes["status"] == one.status == "interrupted" and part.metrics == {}
    reason = f"the process ended before the run did; {one.note}; {two.note}"
    assert part.attributes["status_reason"] == reason and part.attributes["recovered_exp_rths"] == note
    assert [line for line in declaration_faults(result) if "is missing" not in line] == []  # no identification was made
    same = set(whole.attributes) - {"status", "status_reason"}
    assert {key: part.attributes[key] for key in same} == {key: whole.attributes[key] for key in same}
    texts = (whole.case_yaml, whole.resolved_yaml if present else given["exp_rths"].resolved_yaml)
    assert (part.case_yaml, part.resolved_yaml) == texts
    for run, steps in killed:
        count = steps - played.logs[run][0].lead_samples
        expected, found = series(played.result, run), series(result, run)
        expected = {
            name: values for name, values in expected.items() if not name.startswith("rest/")
        }  # not in this log
        assert set(found) == set(expected) and len(found) > 12
        for name, values in expected.items():
            if name == "timing/compute_s":
                continue
            along = name.rpartition("/")[2] not in ("storey", "floor")
            start = values[..., :count] if along else values
            declared = DATASETS.get(f"{run}/{name}")  # none of a scale
            if declared and declared.follows:  # rounded to digits of the largest value, which the start may lack
                largest = np.abs(values).max(axis=-1, keepdims=True)
                assert np.all(np.abs(found[name] - start) <= 2.0**-31 * largest), name
            else:
                np.testing.assert_array_equal(found[name], start, name)
    assert ("identification" in part.groups) == present and "record" in part.groups


def test_a_second_time_nothing_is_done(played: Played, tmp_path: Path) -> None:
    result = begun(played, tmp_path / "a.h5")
    log = left(played, tmp_path, "exp_rths", 1000)
    (first,) = recover([log])
    before = result.read_bytes()
    (second,) = recover([log])
    assert not first.known and second == replace(first, known=True)
    assert result.read_bytes() == before and log.exists()


def test_a_failed_result_gets_the_run_that_it_has_not_and_says_both(played: Played, tmp_path: Path) -> None:
    result = begun(played, tmp_path / "a.h5")
    with h5py.File(result, "a") as file:
        file.attrs.update({"status": "failed", "status_reason": "the link was lost"})
        file["exp_rths/command_v"] = [0.0]
    logs = [left(played, tmp_path, "exp_rths", 1000), left(played, tmp_path, "shake_table", 500)]
    here, added = recover(logs)
    assert (here.known, added.known, added.status) == (True, False, "failed")
    found = read_result(result)
    assert found.attributes["status"] == "failed" and "shake_table" in found.groups
    assert found.attributes["status_reason"] == f"the link was lost; {added.note}"


def test_the_ramp_before_the_record_is_left_out(played: Played, tmp_path: Path) -> None:
    header, columns = played.logs["exp_rths"]
    ramped = replace(header, steps=header.steps + 300, ramp_steps=300)
    path, result, whole = (
        raw_log_path(tmp_path / "a.h5", "exp_rths"),
        tmp_path / "a.h5",
        series(played.result, "exp_rths"),
    )
    for steps in (300, 1300):
        begun(played, result)
        with RawLogWriter(path, ramped) as log:
            log.append(0, np.full((len(columns), 300), 7.0))
            if steps > 300:
                log.append(300, columns[:, :steps])
        recover([path])
        path.unlink()
        assert ("exp_rths" in read_result(result).groups) == (steps > 300)  # no step of the record before
    found = series(result, "exp_rths")["rel_disp_m"]
    np.testing.assert_array_equal(found, whole["rel_disp_m"][:, : 1300 - header.lead_samples])


def test_what_the_loop_noted_of_its_time_comes_back(played: Played, tmp_path: Path) -> None:
    header, columns = played.logs["exp_rths"]
    names = ("late_ns", "exchange_ns", "lost", "state")
    timed = replace(header, names=(*header.names, *names), units=(*header.units, "ns", "ns", "1", "1"))
    noted = 1000.0 * np.arange(4.0)[:, None] + np.arange(800.0)
    path = raw_log_path(begun(played, tmp_path / "a.h5"), "exp_rths")
    with RawLogWriter(path, timed) as log:
        log.append(0, np.vstack([columns[:, :800], noted]))
    recover([path])
    found, lead = series(tmp_path / "a.h5", "exp_rths"), header.lead_samples
    for name, values in zip(("late_s", "exchange_s", "lost", "state"), noted, strict=True):
        np.testing.assert_allclose(found[f"timing/{name}"], values[lead:] * (1e-9 if name.endswith("_s") else 1.0))


def test_what_no_rig_knows_is_left_out_and_what_is_missing_in_between_is_told(played: Played, tmp_path: Path) -> None:
    header, columns = played.logs["exp_rths"]
    kept = [i for i, name in enumerate(header.names) if name not in TRUTH]
    lean = replace(header, names=tuple(header.names[i] for i in kept), units=("1",) * len(kept))
    begun(played, tmp_path / "a.h5")
    path = raw_log_path(tmp_path / "a.h5", "exp_rths")
    with RawLogWriter(path, lean) as log:
        log.append(0, columns[kept, :400])
        log.append(500, columns[kept, 500:1000])
    (one,) = recover([path])
    assert one.samples == 900 and "1000 of" in one.note and "100 of them are missing" in one.note
    whole, found = series(played.result, "exp_rths"), series(tmp_path / "a.h5", "exp_rths")
    lead, name = header.lead_samples, "interface_accel_measured_m_s2"
    assert "truth/table_accel_m_s2" not in found and np.isnan(found[name][400 - lead : 500 - lead]).all()
    np.testing.assert_array_equal(found[name][: 400 - lead], whole[name][: 400 - lead])
    np.testing.assert_array_equal(found[name][500 - lead :], whole[name][500 - lead : 1000 - lead])
    disp = found["rel_disp_m"][0]  # computed from the base shear: known up to the gap
    np.testing.assert_array_equal(disp[:400], whole["rel_disp_m"][0, :400])
    assert np.isnan(disp[402:]).all()


def test_a_log_that_ends_before_the_record_begins_makes_a_result_without_the_run(
    played: Played, tmp_path: Path
) -> None:
    log = left(played, tmp_path, "exp_rths", 1000)
    data = log.read_bytes()
    log.write_bytes(data[: data.index(b"RTHF") + 50])
    (one,) = recover([log])
    assert one.samples == 0 and " 0 of" in one.note
    result = read_result(tmp_path / "a.h5")
    assert result.groups == ("case", "record") and result.attributes["status"] == "interrupted"
    assert recover([log])[0].known
    lead = played.logs["exp_rths"][0].lead_samples
    for steps in (lead, lead + 1):
        (tmp_path / "a.h5").unlink()
        log.unlink()
        recover([left(played, tmp_path, "exp_rths", steps)])
        assert ("exp_rths" in read_result(tmp_path / "a.h5").groups) == (steps > lead)


def refused(paths: list[Path]) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        recover(paths)
    return caught.value.faults


def test_a_finished_result_is_left_alone_and_all_faults_come_at_once(played: Played, tmp_path: Path) -> None:
    shutil.copy(played.result, tmp_path / "a.h5")
    before = (tmp_path / "a.h5").read_bytes()
    log = left(played, tmp_path, "exp_rths", 1000)
    (tmp_path / "b.rthslog").write_text("no log")
    other = left(played, tmp_path, "exp_rths", 10, replace(played.logs["exp_rths"][0], result="../b.h5"))
    faults = refused([log, tmp_path / "b.rthslog", other])
    assert len(faults) == 2
    assert "a.exp_rths.rthslog: is not needed any more" in faults[0] and "a.h5 is complete" in faults[0]
    assert "b.rthslog: is no raw log" in faults[1]
    assert (tmp_path / "a.h5").read_bytes() == before and not (tmp_path / "b.h5").exists()
    (one,) = recover([other])
    assert one.result == other.parent / "b.h5"  # wherever the header points, the result stands beside the log


def test_columns_case_and_record_must_fit(played: Played, tmp_path: Path) -> None:
    header, columns = played.logs["exp_rths"]
    result = begun(played, tmp_path / "a.h5")
    before = result.read_bytes()
    path = raw_log_path(result, "exp_rths")
    names = tuple("other" if name == "corrected_2" else name for name in header.names)
    resolved = header.resolved_yaml
    for changed, told in (
        (replace(header, names=names), "has no column corrected_2"),
        (replace(header, run="pull_test"), "holds a run named 'pull_test', this rths knows"),
        (replace(header, resolved_yaml=resolved.replace("integration: exact", "integration: magic")), "integration"),
        (replace(header, resolved_yaml="a: [1"), "its case"),
        (replace(header, resolved_yaml="a: 1"), "its case has no record"),
    ):
        with RawLogWriter(path, changed) as log:
            log.append(0, columns[:, :50])
        (fault,) = refused([path])
        assert str(path) in fault and told in fault
        path.unlink()
    assert result.read_bytes() == before
    result.unlink()
    shutil.copy(played.folder / "short.csv", tmp_path / "short.csv")
    moved = replace(header, resolved_yaml=resolved.replace(str(played.folder), str(tmp_path)))
    for about, told in (
        ({"spin": "up"}, "attribute spin is declared nowhere"),
        ({"seed": "x"}, "declared is a number"),
    ):
        left(played, tmp_path, "exp_rths", 50, replace(moved, attributes={**header.attributes, **about})).rename(path)
        (fault,) = refused([path])
        assert str(path) in fault and told in fault and "the version of rths that wrote it" in fault
        assert not result.exists()
        path.unlink()
    left(played, tmp_path, "exp_rths", 50, moved)
    (tmp_path / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "0.1\n0.2\n0.1\n" * 200)
    assert "short.csv: is not the file any more that a.h5 was made with" in refused([path])[0]
    (tmp_path / "short.csv").unlink()
    assert "short.csv" in refused([path])[0] and not result.exists()


def test_a_run_under_way_is_not_recovered(played: Played, tmp_path: Path) -> None:
    header, columns = played.logs["exp_rths"]
    begun(played, tmp_path / "a.h5")
    with RawLogWriter(raw_log_path(tmp_path / "a.h5", "exp_rths"), header) as log:
        log.append(0, columns[:, :50])
        assert "is being written by a run under way" in refused([log.path])[0]
        with ResultWriter(tmp_path / "a.h5", {}, continues=True) as writer:
            writer.finish("complete")
        log.remove()
    assert not log.path.exists()


def storeys(designed: Block) -> PythonSubstructure:
    """Return the designed storeys in numpy, with a displacement that they log."""
    return PythonSubstructure("storeys", lambda: Storeys(designed), designed, (Logged("storey_1_rel_disp", "m"),))


def feedforward(designed: Block) -> PythonFeedforward:
    """Return the designed inverse in numpy, with a number that it logs."""

    class Logging(Inverse):
        logged = np.array([3.0])

    return PythonFeedforward("inverse", lambda: Logging(designed), designed, (Logged("gain", "m/V"),))


@pytest.mark.campaign
def test_what_parts_of_ones_own_log_is_recovered(tmp_path: Path, memory: Memory) -> None:
    """With names and units, each on its own clock; a log that names nothing numbers its columns."""
    (tmp_path / "whole").mkdir()
    parts = {"numerical": storeys, "feedforward": feedforward}
    whole = played_in(tmp_path / "whole", memory, parts)
    for case, names in (("named", None), ("unnamed", "logged_0 (1)\nlogged_1 (1)")):
        folder = tmp_path / case
        folder.mkdir()
        begun(whole, folder / "a.h5")
        header = whole.logs["exp_rths"][0]
        log = left(whole, folder, "exp_rths", 5000, header if names is None else replace(header, logs=()))
        (found,) = recover([log])
        expected, got = series(whole.result, "exp_rths"), series(folder / "a.h5", "exp_rths")
        count = got["part_values"].shape[1]
        assert count == 5000 - header.lead_samples and found.samples == 5000
        text = got["part_value_names"].decode()
        assert text == (names or "storey_1_rel_disp (m)\ngain (m/V)")
        if names is None:
            assert expected["part_value_names"].decode() == text
            np.testing.assert_array_equal(got["part_values"], expected["part_values"][:, :count])
            assert np.isfinite(got["rel_disp_m"]).all()  # the interface is the only computed storey
            assert np.ptp(got["part_values"][0]) > 1e-6 and (got["part_values"][1] == 3.0).all()


@pytest.mark.campaign
def test_a_whole_run_of_storeys_of_ones_own_gets_no_figures(tmp_path: Path, memory: Memory) -> None:
    """SIM is that of a building that only the caller's program knows; other parts leave it the case's."""
    for name, parts, known in (("own", {"numerical": storeys}, False), ("other", {"feedforward": feedforward}, True)):
        (tmp_path / name / "whole").mkdir(parents=True)
        whole = played_in(tmp_path / name / "whole", memory, parts)
        begun(whole, tmp_path / name / "a.h5")
        recover([left(whole, tmp_path / name, "exp_rths", whole.logs["exp_rths"][0].steps)])
        assert ("exp_rths.rms_error_m_s2" in read_result(tmp_path / name / "a.h5").metrics) == known
