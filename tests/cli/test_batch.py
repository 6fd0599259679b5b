"""Batches: one case that fails is named and the others run; signals end a batch cleanly."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from portfolio import parametrize_first
from warm_command import rths_words

from rths_cli.files.result_reader import read_result

FAST = ("--set", "runs=[sim, sim_delay]")
CASE = "structure: three_storey\ndamping: low\nrecord: el_centro\nscaling: {scaling}\ncontroller: FF\nruns: {runs}\n"


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=240, check=False)


@pytest.mark.campaign
def test_one_case_that_is_stopped_by_a_limit_is_named_and_the_others_run(tmp_path: Path) -> None:
    (tmp_path / "loud.yaml").write_text(CASE.format(scaling=3, runs="[sim, shake_table]"))
    (tmp_path / "calm.yaml").write_text(CASE.format(scaling=0.3, runs="[sim, shake_table]"))
    done = rths("run", "loud.yaml", "calm.yaml", "--override", "check", cwd=tmp_path)
    assert done.returncode == 3
    assert "loud: aborted" in done.stderr and "calm: complete" in done.stderr
    assert read_result(tmp_path / "results/loud.h5").attributes["status"] == "aborted"
    assert read_result(tmp_path / "results/calm.h5").attributes["status"] == "complete"
    assert "aborted" in done.stdout


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Return a folder in which a case ran, and how that process ended."""
    folder = tmp_path_factory.mktemp("ran")
    done = rths("run", "el_centro_low_ff", *FAST, "--json", cwd=folder)
    assert done.returncode == 0
    return folder, done


def test_json_is_one_document_and_progress_goes_elsewhere(
    ran: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    _, done = ran
    document = json.loads(done.stdout)
    assert document["cases"][0]["status"] == "complete"
    figures = document["results"][0]["metrics"]
    assert len(figures["sim_delay.rms_error_m_s2"]) == 3
    assert "complete" in done.stderr


def test_a_finished_result_is_replaced_unless_told_not_to(
    ran: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    shutil.copytree(ran[0], tmp_path, dirs_exist_ok=True)
    before = (tmp_path / "results/el_centro_low_ff.h5").stat().st_mtime_ns
    refused = rths("run", "el_centro_low_ff", *FAST, "--no-replace", cwd=tmp_path)
    assert refused.returncode == 2 and "el_centro_low_ff.h5" in refused.stderr
    assert (tmp_path / "results/el_centro_low_ff.h5").stat().st_mtime_ns == before
    again = rths("run", "el_centro_low_ff", *FAST, cwd=tmp_path)
    assert again.returncode == 0 and "(replaced)" in again.stderr
    assert (tmp_path / "results/el_centro_low_ff.h5").stat().st_mtime_ns > before


@pytest.mark.campaign
@parametrize_first(1, ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_batch_with_its_code_and_whole_files(tmp_path: Path, number: int, code: int) -> None:
    for k in range(60):
        (tmp_path / f"c{k:02}.yaml").write_text(CASE.format(scaling=0.3, runs="[sim, sim_delay]"))
    process = subprocess.Popen(
        [sys.executable, "-m", "rths_cli", "run", *(f"c{k:02}.yaml" for k in range(60))],
        cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 100
    while not list(tmp_path.glob("results/*.h5")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, messages = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in messages
    assert list(tmp_path.glob("results/.*")) == []
    for path in tmp_path.glob("results/*.h5"):
        assert read_result(path).attributes["status"] == "complete"


CONTROLS = ("ff", "ff_fb")


@pytest.mark.campaign
def test_a_run_prints_as_much_as_is_asked_for(tmp_path: Path) -> None:
    """The answer alone; --full has every figure below it, --quiet a line."""
    (tmp_path / "own.yaml").write_text(CASE.format(scaling=0.3, runs="[sim, sim_delay, exp_rths]"))
    answer = rths("run", "own.yaml", cwd=tmp_path)
    assert answer.returncode == 0 and len(answer.stdout.splitlines()) + len(answer.stderr.splitlines()) <= 18
    assert answer.stdout.startswith("GOOD: ") and "claims" not in answer.stdout
    full = rths("run", "own.yaml", "--full", cwd=tmp_path)
    assert full.stdout.startswith(answer.stdout) and "Error by cause" in full.stdout
    quiet = rths("run", "own.yaml", "--quiet", cwd=tmp_path)
    assert (
        quiet.stdout.count("\n") == 1 and quiet.stdout.startswith("own: good on a virtual rig, ") and quiet.stderr == ""
    )
    silent = rths("run", "own.yaml", "--quiet", "--quiet", cwd=tmp_path)
    assert silent.stdout == silent.stderr == ""


@pytest.mark.campaign
def test_several_cases_print_a_row_each_and_leave_the_tables_to_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    names = [
        f"{quake}_{level}_{c}" for quake in ("el_centro", "hachinohe") for level in ("low", "high") for c in CONTROLS
    ]
    eight = rths("run", *names, "--set", "runs=[sim]", cwd=tmp_path)
    lines = eight.stdout.splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 80 and "Published" not in eight.stdout
    assert [line.split()[0] for line in lines[3:11]] == names
    assert "more: rths report results with --full, or --paper" in " ".join(eight.stdout.split())
    for option, told in (((), False), (("--paper",), True)):
        alone = rths("run", names[0], "--set", "runs=[sim]", *option, cwd=tmp_path)
        assert alone.stdout.startswith("NO HYBRID TEST: ") and ("Published" in alone.stdout) == told
