"""The real process: exit codes, what stands on stdout, a sweep that is killed and one that goes on."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from portfolio import parametrize_first
from warm_command import rths_words

CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    time_s = np.arange(0.0, 4.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
    text = "\n".join(f"{a:.6f}" for a in accel)
    (tmp_path / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{text}\n")
    (tmp_path / "a.yaml").write_text(CASE)
    return tmp_path


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=240, check=False)


def test_json_is_one_document_and_a_refused_run_is_exit_code_1(folder: Path) -> None:
    words = ("sweep", "a.yaml", "--vary", "scaling=0.2,3", "--seeds", "2", "--json")
    done = rths(*words, "--csv", "t.csv", "--output", "s.h5", cwd=folder)
    assert done.returncode == 1, done.stderr
    document = json.loads(done.stdout)
    assert (document["sweep"], document["runs"], document["exit_code"]) == ("s.h5", 4, 1)
    assert [point["runs"] for point in document["points"]] == [{"complete": 2}, {"refused": 2}]
    with h5py.File(folder / "s.h5") as file:
        third = file["exp_rths.rms_error_m_s2"][:2, 2]
        assert file.attrs["command_line"].startswith("rths sweep a.yaml --vary")
    assert document["points"][0]["errors"]["largest"]["exp_rths.rms_error_m_s2"][2] == third.max()
    assert len((folder / "t.csv").read_text().splitlines()) == 5


def test_sweep_merge_is_merge(tmp_path: Path) -> None:
    done = rths("sweep", "merge", "none.h5", "--output", "whole.h5", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "none.h5: no such file; check the path\n")
    (tmp_path / "none.h5").write_text("no sweep")
    done = rths("merge", "none.h5", "--output", "whole.h5", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "none.h5: is no file that rths sweep wrote\n")


@pytest.mark.campaign
@parametrize_first(1, ("number", "code"), [(signal.SIGKILL, -9), (signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_sweep_that_is_killed_goes_on(folder: Path, number: int, code: int) -> None:
    words = ("sweep", "a.yaml", "--seeds", "100000", "--output", "out/s.h5")
    process = subprocess.Popen(
        [sys.executable, "-m", "rths_cli", *words],
        cwd=folder,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    rows, deadline = folder / "out/s.h5.rows", time.monotonic() + 100
    while not (rows.exists() and rows.read_text().count("\n") > 3) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    output, messages = process.communicate(timeout=60)
    assert process.returncode == code and output == "" and "Traceback" not in messages
    kept = rows.read_text().count("\n") - 1
    left = {path.name for path in rows.parent.iterdir()}
    assert kept >= 3 and left - {".s.h5.lock" if number == signal.SIGKILL else ""} == {"s.h5.rows"}
    again = rths(*words, cwd=folder)
    assert again.returncode == 2 and f"holds {kept} runs of this sweep, which was interrupted; add" in again.stderr
    assert [path.name for path in rows.parent.iterdir()] == ["s.h5.rows"]
    if number != signal.SIGKILL:
        assert f"{kept} of 100000 runs are kept; the same command with --resume goes on" in messages


def test_bad_input_is_one_sentence_per_fault_and_writes_nothing(folder: Path) -> None:
    before = sorted(path.name for path in folder.iterdir())
    done = rths("sweep", "a.yaml", "--vary", "scaling=-1,0.3", "--vary", "contoller=FF", cwd=folder)
    assert done.returncode == 2 and done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 2 and "Traceback" not in done.stderr
    done = rths("sweep", "a.yaml", "--seeds", "0", cwd=folder)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert sorted(path.name for path in folder.iterdir()) == before
