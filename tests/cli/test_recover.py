"""`rths recover` as a process: exit codes, what stands on stdout, and a report that says when it is needed."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from warm_command import rths_words

from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.cli import cli
from rths_cli.files.raw_log import RawHeader, RawLogWriter, raw_log_path
from rths_cli.files.result_reader import ResultWriter, Status

NAMES = ("command_v", "desired_accel_m_s2", "desired_velocity_m_s", "desired_displacement_m", "base_shear_n")
NAMES += (*(f"corrected_{i}" for i in range(3)), *(f"estimated_{i}" for i in range(6)))
FINISHED: tuple[tuple[str, Status], ...] = (("four", "complete"), ("six", "aborted"))
STEPS, DONE, LEAD = 4000, 1500, 2


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=120, check=False)


def inside(*words: str) -> str:
    """Run a command in this process and return what it prints."""
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    return done.output


def killed(folder: Path, name: str, done: int = DONE) -> np.ndarray:
    """Leave the raw log of a run of the default case; return its columns (w, done)."""
    case = load_cases(["el_centro_low_ff_fb"])[0]
    result = folder / f"{name}.h5"
    attributes = {"case_name": name, "rig_kind": "udp", "rig": "lab", "controller": "FF+FB", "record_name": "el_centro"}
    attributes |= {"damping_name": "low", "method": "best", "reference_title": "", "reference_json": ""}
    texts = (str(case.path), case.yaml_text, resolved_yaml(case))
    header = RawHeader(
        NAMES, ("1",) * len(NAMES), 0.0005, STEPS, LEAD, "exp_rths", result.name, *texts,
        {**attributes, "scaling": 0.3},
    )  # fmt: skip
    columns = np.random.default_rng(0).normal(size=(len(NAMES), done))
    with RawLogWriter(raw_log_path(result, "exp_rths"), header) as log:
        log.append(0, columns)
    return columns


def test_help_has_an_example_and_a_log_must_be_named() -> None:
    assert "Example: rths recover" in " ".join(inside("recover", "--help").split())
    assert "Missing argument 'LOG...'" in inside("recover")


def test_logs_become_results_and_json_is_one_document(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    columns = killed(tmp_path, "one")
    killed(tmp_path, "two")
    done = rths("recover", "one.exp_rths.rthslog", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (
        "one.h5: interrupted, EXP-RTHS: 1500 of 4000 steps of the record (0.750 s of 2.000 s) are recovered from "
        "one.exp_rths.rthslog\n"
    )
    with h5py.File(tmp_path / "one.h5") as file:
        assert file.attrs["status"] == "interrupted" and file.attrs["recovered_exp_rths"] in done.stdout
        np.testing.assert_array_equal(file["exp_rths/command_v"][()], columns[0, LEAD:])
    words = ("recover", "one.exp_rths.rthslog", "two.exp_rths.rthslog", "two.exp_rths.rthslog", "--json")
    document = json.loads(inside(*words))
    assert (document["exit_code"], len(document["recovered"])) == (0, 2)
    one, two = document["recovered"]
    assert (one["already_there"], two["already_there"]) == (True, False)
    assert (two["result"], two["samples"], two["steps"], two["status"]) == ("two.h5", DONE, STEPS, "interrupted")
    assert "one.h5: held it already and is left as it is" in inside("recover", "one.exp_rths.rthslog")


def test_what_cannot_be_recovered_is_one_sentence_each_and_writes_nothing(tmp_path: Path) -> None:
    killed(tmp_path, "one")
    with ResultWriter(tmp_path / "one.h5", {"rig_kind": "udp"}, lasting=True) as writer:
        writer.finish("complete")
    (tmp_path / "b.rthslog").write_text("other")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    done = rths("recover", "one.exp_rths.rthslog", "b.rthslog", "c.rthslog", "--json", cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 3
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert json.loads(done.stdout) == {"exit_code": 2, "faults": done.stderr.strip().splitlines()}


@pytest.mark.campaign
@pytest.mark.parametrize("others", [True, False], ids=["beside results", "alone"])
def test_report_says_what_waits_to_be_recovered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: bool) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "results"
    folder.mkdir()
    killed(folder, "one")
    advice = "results/one.exp_rths.rthslog: the run that it logged is in no result; rths recover"
    if others:
        killed(folder, "two")
        killed(folder, "three", LEAD)  # of which the record's clock knows nothing
        inside("recover", "results/two.exp_rths.rthslog", "results/three.exp_rths.rthslog")
        for name, status in FINISHED:
            killed(folder, name)
            with ResultWriter(folder / f"{name}.h5", {"case_name": name}) as writer:
                writer.group("exp_rths" if status == "aborted" else "record", {})
                writer.finish(status)
        (folder / "five.rthslog").write_text("no log")
    done = rths("report", cwd=tmp_path)
    assert done.returncode == (0 if others else 2)
    assert advice in done.stderr and len(done.stderr.splitlines()) == (1 if others else 2)
    assert ("interrupted" in done.stdout) == others
    inside("recover", "results/one.exp_rths.rthslog")
    assert "rths recover" not in inside("report")
