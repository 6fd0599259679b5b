"""The path of docs/howto/cluster.md with Dask, by its own commands: start, run, stop, resume, report."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from campaigns.study_interruptions import datasets, free_port, write_case

from rths_cli.files.sweep_file import rows_path

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "howto" / "cluster.md").read_text(encoding="utf-8")
SEEDS, KEPT = 60, 5
MANY = 5000  # seeds, whose rows take longer than a worker to start
STUDY = f"case: short\naxes: {{table.after_identification.coulomb_factor: [1, 3]}}\nseeds: {SEEDS}\n"
LIMIT_S = 300.0

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="SIGINT of a process")


def guided(port: int) -> tuple[list[str], list[str], list[str]]:
    """Return the guide's commands of scheduler, worker and sweep as words, for this machine and that port."""
    (block,) = (text for text in re.findall(r"```\n(.*?)```", GUIDE, re.DOTALL) if "dask scheduler" in text)
    here = block.replace("HOST", "127.0.0.1").replace("8786", str(port)).replace("--nworkers 4", "--nworkers 2")
    scheduler, worker, sweep = (shlex.split(line, comments=True) for line in here.splitlines())
    return [*scheduler, "--host", "127.0.0.1", "--no-dashboard"], [*worker, "--no-dashboard"], sweep


def started(words: list[str], folder: Path, more_path: str = "") -> subprocess.Popen[str]:
    module = {"dask": "dask", "rths": "rths_cli"}[words[0]]
    path = os.pathsep.join(filter(None, [more_path, str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen(
        [sys.executable, "-m", module, *words[1:]], cwd=folder, env={**os.environ, "PYTHONPATH": path}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE if words[0] == "rths" else subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    told = "".join(process.communicate(timeout=LIMIT_S))
    return process.returncode, told


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pytest.importorskip("distributed")
    write_case(tmp_path, "short.yaml")
    (tmp_path / "robustness.yaml").write_text(STUDY)
    return tmp_path


@pytest.fixture
def cluster(folder: Path) -> Iterator[tuple[list[str], list[str]]]:
    """Yield the guide's commands of worker and sweep, with the scheduler and two workers running."""
    scheduler, worker, sweep = guided(free_port())
    processes = [started(scheduler, folder), started(worker, folder)]
    try:
        yield worker, sweep
    finally:
        end(processes)


def test_a_study_is_run_stopped_resumed_and_reported_as_the_guide_says(
    folder: Path, cluster: tuple[list[str], list[str]]
) -> None:
    _, sweep = cluster
    output = folder / "sweeps" / "robustness.h5"
    first = started(sweep, folder)
    wait_for_rows(first, output)
    os.kill(first.pid, signal.SIGINT)
    code, told = ended(first)
    assert code == 130 and "the same command with --resume goes on" in told, told
    kept = rows_path(output).read_text().count("\n") - 1
    assert KEPT <= kept < 2 * SEEDS and not output.exists()
    assert tasks_left(sweep) == 0

    code, told = ended(started([*sweep, "--resume"], folder))
    assert code == 0 and f"{kept} of {2 * SEEDS} runs were played before" in told, told

    code, told = ended(started(["rths", "report", "sweeps/robustness.h5"], folder))
    assert code == 0 and f"Of {2 * SEEDS} runs: {2 * SEEDS} complete (100 %)." in told, told

    alone = ["rths", "sweep", "robustness.yaml", "--engine", "inline", "--output", "alone.h5"]
    code, told = ended(started(alone, folder))
    assert code == 0 and datasets(folder / "alone.h5") == datasets(output), told


def test_a_worker_of_another_version_that_joins_late_is_told(
    folder: Path, cluster: tuple[list[str], list[str]], tmp_path: Path
) -> None:
    worker, sweep = cluster
    other = tmp_path / "other"
    shutil.copytree(ROOT / "rths_cli", other / "rths_cli", ignore=shutil.ignore_patterns("__pycache__"))
    (other / "rths_cli" / "version.py").write_text('__version__ = "9.9"\n')
    output = folder / "sweeps" / "robustness.h5"
    running = started([*sweep, "--seeds", str(MANY)], folder)
    wait_for_rows(running, output)
    late = started(worker, folder, str(other))
    try:
        code, told = ended(running)
    finally:
        os.killpg(late.pid, signal.SIGKILL)
        late.communicate()
    assert code == 2 and "a worker runs rths 9.9, this process rths" in told, told
    assert "Traceback" not in told and rows_path(output).exists()


def test_a_sweep_waits_for_workers_says_so_and_goes_on_with_one_that_joins_late(folder: Path) -> None:
    scheduler, worker, sweep = guided(free_port())
    output, missing = folder / "sweeps" / "robustness.h5", "no worker is there; the sweep waits for one: dask worker"
    clustered = [started(scheduler, folder)]
    try:
        running = started([*sweep, "--seeds", "600"], folder)
        wait_for_words(running, missing)
        clustered.append(started(worker, folder))
        wait_for_rows(running, output)
        os.killpg(clustered[-1].pid, signal.SIGKILL)
        wait_for_words(running, missing)
        clustered.append(started(worker, folder))
        code, told = ended(running)
    finally:
        end(clustered)
    assert code == 0 and "Of 1200 runs: 1200 complete (100 %)." in told, told


def test_a_scheduler_that_is_restarted_at_once_ends_the_sweep_and_its_rows_are_kept(folder: Path) -> None:
    scheduler, worker, sweep = guided(free_port())
    output = folder / "sweeps" / "robustness.h5"
    clustered = [started(scheduler, folder), started(worker, folder)]
    try:
        running = started([*sweep, "--seeds", str(MANY)], folder)
        wait_for_rows(running, output)
        os.killpg(clustered[0].pid, signal.SIGKILL)
        clustered += [started(scheduler, folder), started(worker, folder)]
        code, told = ended(running)
    finally:
        end(clustered)
    assert code == 4 and "the connection to the Dask scheduler is lost" in told and "Traceback" not in told, told
    assert rows_path(output).exists()


def end(processes: list[subprocess.Popen[str]]) -> None:
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def tasks_left(sweep: list[str]) -> int:
    """Return how many tasks the scheduler of a sweep still has, a minute after at most."""
    import distributed

    with distributed.Client(sweep[-1], set_as_default=False) as client:
        for _ in range(60):
            left = int(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))
            if not left:
                break
            time.sleep(1.0)
    return left


def wait_for_words(process: subprocess.Popen[str], words: str) -> None:
    """Read what a command says until these words are there."""
    assert process.stderr is not None
    killer = threading.Timer(LIMIT_S, process.kill)
    killer.start()
    told = [""]
    while words not in told[-1] and (line := process.stderr.readline()):
        told.append(line)
    killer.cancel()
    assert words in told[-1], told


def wait_for_rows(process: subprocess.Popen[str], output: Path) -> None:
    end = time.monotonic() + LIMIT_S
    while process.poll() is None and time.monotonic() < end:
        if rows_path(output).exists() and rows_path(output).read_bytes().count(b"\n") > KEPT:
            return
        time.sleep(0.01)
    raise AssertionError(f"no rows: {ended(process) if process.poll() is not None else 'the sweep waits'}")
