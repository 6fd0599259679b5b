"""Interrupt sweeps at random instants, let them go on, and compare the table with that of an uninterrupted one.

A sweep of `ROWS` rows, some milliseconds each, is a command of its own. Its instant is drawn over the time in which it
plays rows and writes the table. Afterwards the rows that are kept must be whole and there once, the same command with
`--resume` must play the others alone, and the datasets of the table must be those of the reference to the last bit.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

SEEDS, POINTS = 200, 2
ROWS = SEEDS * POINTS
KINDS = ("killed worker", "restarted scheduler", "Ctrl-C", "SIGKILL", "full disk")
LOCAL = (("--engine", "inline"), ("--engine", "threads"), ("--engine", "processes", "--jobs", "2"))
DISK_MB = 8
LIMIT_S = 300.0
CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
STUDY = "case: short\naxes: {table.after_identification.coulomb_factor: [1, 3]}\n"


@dataclass(frozen=True)
class Trial:
    """One interruption: when, after the first row; how many rows were there then; what is wrong (empty: nothing)."""

    kind: str
    engine: str
    after_s: float
    met: bool  # the command had not ended before
    there: int
    faults: tuple[str, ...]


@dataclass
class Bench:
    """A folder with the study, its uninterrupted table, and how long its rows take by engine."""

    folder: Path
    reference: dict[str, Any] = field(default_factory=dict)
    lasts_s: dict[str, float] = field(default_factory=dict)

    @classmethod
    def made(cls, folder: Path, seeds: int = SEEDS) -> Bench:
        """Write the study and run it without interruption."""
        time_s = np.arange(0.0, 4.5, 0.01)
        accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
        lines = "\n".join(f"{a:.6f}" for a in accel)
        (folder / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{lines}\n")
        (folder / "short.yaml").write_text(CASE)
        (folder / "study.yaml").write_text(f"{STUDY}seeds: {seeds}\n")
        bench = cls(folder)
        whole = folder / "whole.h5"
        subprocess.run(bench.command(whole, LOCAL[0]), check=True, capture_output=True, cwd=folder)
        bench.reference = datasets(whole)
        return bench

    def command(self, output: Path, engine: Sequence[str], *more: str) -> list[str]:
        """Return the command line of the sweep."""
        place = [str(self.folder / "study.yaml"), "--output", str(output)]
        return [sys.executable, "-m", "rths_cli", "sweep", *place, *engine, *more]

    def duration(self, engine: Sequence[str]) -> float:
        """Return how long the sweep takes from its first row on."""
        key = engine[1]
        if key not in self.lasts_s:
            process = started(self.command(self.folder / "timed.h5", engine))
            begins = await_rows(process, self.folder / "timed.h5")
            process.communicate(timeout=LIMIT_S)
            self.lasts_s[key] = time.monotonic() - begins
        return self.lasts_s[key]


def datasets(path: Path) -> dict[str, Any]:
    """Return all datasets of a sweep, numbers as bytes."""

    def content(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        return value.tolist() if value.dtype.kind == "O" else value.tobytes()

    with h5py.File(path) as file:
        return {name: content(node[()]) for name, node in file.items()}


def started(command: Sequence[str]) -> subprocess.Popen[str]:
    """Start a sweep in a session of its own, as a terminal would."""
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def await_rows(process: subprocess.Popen[str], output: Path) -> float:
    """Wait for the first row, or the end of the process; return when that was."""
    rows = rows_of(output)
    while process.poll() is None:
        with suppress(OSError):
            if rows.read_bytes().count(b"\n") > 1:
                break
        time.sleep(0.002)
    return time.monotonic()


def rows_of(output: Path) -> Path:
    """Return the file of the rows of a sweep under way."""
    return output.with_name(f"{output.name}.rows")


def kept_rows(output: Path) -> list[int]:
    """Return the numbers of the whole rows that are kept."""
    try:
        lines = rows_of(output).read_bytes().split(b"\n")[1:-1]
    except FileNotFoundError:
        return []
    return [json.loads(line)[0] for line in lines]


def interrupted(
    bench: Bench, kind: str, rng: random.Random, output: Path, engine: Sequence[str],
    interrupt: Callable[[subprocess.Popen[str]], None], ends_itself: bool, before_resume: Callable[[], None],
) -> Trial:  # fmt: skip
    """Start the sweep, interrupt it, resume it, and judge."""
    after_s = rng.uniform(0.0, bench.duration(engine))
    process = started(bench.command(output, engine))
    await_rows(process, output)
    time.sleep(after_s)
    met, there = process.poll() is None, len(kept_rows(output))
    if met:
        interrupt(process)
    said = process.communicate(timeout=LIMIT_S)[1]
    faults = [f"a traceback: {said[-600:]}"] if "Traceback" in said else []
    rows = kept_rows(output)
    if len(set(rows)) < len(rows):
        faults.append("a row is kept twice")
    if ends_itself and process.returncode:
        faults.append(f"exit code {process.returncode}: {said[-300:]}")
    before_resume()
    if not output.exists() or rows_of(output).exists():
        faults += resumed(bench, output, engine, len(rows))
    if not faults and datasets(output) != bench.reference:
        faults.append("the table differs from the uninterrupted one")
    if any(left := [path.name for path in output.parent.iterdir() if path.name.startswith((".", f"{output.name}."))]):
        faults.append(f"left behind: {left}")
    output.unlink(missing_ok=True)
    rows_of(output).unlink(missing_ok=True)
    return Trial(kind, " ".join(engine[1:2]), after_s, met, there, tuple(faults))


def resumed(bench: Bench, output: Path, engine: Sequence[str], kept: int) -> Iterator[str]:
    """Go on with a sweep; yield what went wrong."""
    told = f"{kept} of {len(bench.reference['status'])} runs were played before"
    done = subprocess.run(
        bench.command(output, engine, "--resume"), capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    if done.returncode:
        yield f"--resume: exit code {done.returncode}: {done.stderr[-300:]}"
    elif kept and told not in done.stderr:
        yield f"--resume did not say {told!r}: {done.stderr[-300:]}"


def kill_worker(process: subprocess.Popen[str], rng: random.Random) -> None:
    """Kill one of the processes that play rows: the grandchildren of the command, whose parent forks them."""
    workers = [pid for child in children(process.pid) for pid in children(child)]
    if workers:
        with suppress(ProcessLookupError):
            os.kill(rng.choice(sorted(workers)), signal.SIGKILL)


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += map(int, task.read_text().split())
    return found


class Cluster:
    """A Dask scheduler and two workers of this machine, at one address."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.port, self.processes = folder, port, []  # type: ignore[var-annotated]
        self.address = f"tcp://127.0.0.1:{port}"

    def start(self) -> None:
        """Start scheduler and workers."""
        dask = [sys.executable, "-m", "dask"]
        calls = [["scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]]
        worker = ["worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        calls += [worker] * 2
        self.processes = [
            subprocess.Popen([*dask, *call], cwd=self.folder, stderr=subprocess.DEVNULL) for call in calls
        ]

    def kill_scheduler(self) -> None:
        """Kill the scheduler alone."""
        self.processes[0].kill()
        self.processes[0].wait()

    def stop(self) -> None:
        """End all."""
        for process in self.processes:
            process.kill()
            process.wait()


@contextmanager
def small_disk(place: Path) -> Iterator[Path | None]:
    """Yield a small file system of its own, None where this user may mount none."""
    place.mkdir()
    mount = shutil.which("mount")
    command = [str(mount), "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(place)]
    if mount is None or subprocess.run(command, capture_output=True).returncode:
        yield None
        return
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


def fill(disk: Path) -> None:
    """Take all space that is left."""
    with open(disk / "filler", "wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(1 << 16 if shutil.disk_usage(disk).free > 1 << 16 else 1 << 12))


def nothing() -> None:
    """Do nothing."""


def trial(bench: Bench, kind: str, rng: random.Random, disk: Path | None = None, port: int = 0) -> Trial:
    """Return one trial of a kind; `disk`: of a full disk, `port`: of a scheduler."""
    own = bench.folder / "own"
    own.mkdir(exist_ok=True)
    output, local = own / "s.h5", rng.choice(LOCAL)
    if kind == "killed worker":
        return interrupted(bench, kind, rng, output, LOCAL[2], lambda process: kill_worker(process, rng), True, nothing)
    if kind == "Ctrl-C":
        return interrupted(bench, kind, rng, output, local, _ctrl_c, False, nothing)
    if kind == "SIGKILL":
        return interrupted(bench, kind, rng, output, local, subprocess.Popen.kill, False, nothing)
    if kind == "full disk":
        assert disk is not None
        place = disk / "out"
        place.mkdir(exist_ok=True)
        filler = disk / "filler"
        try:
            return interrupted(
                bench, kind, rng, place / "s.h5", local, lambda _: fill(disk), False, lambda: filler.unlink(True)
            )
        finally:
            filler.unlink(missing_ok=True)
    cluster = Cluster(own.parent, port)
    engine = ("--engine", "dask", "--scheduler", cluster.address)
    cluster.start()
    try:
        time.sleep(0.5)
        await_port(port)

        def again() -> None:
            cluster.stop()
            cluster.start()
            await_port(port)

        return interrupted(bench, kind, rng, output, engine, lambda _: cluster.kill_scheduler(), False, again)
    finally:
        cluster.stop()


def _ctrl_c(process: subprocess.Popen[str]) -> None:
    """Send SIGINT to all processes of the command, as a terminal does."""
    os.killpg(process.pid, signal.SIGINT)


def await_port(port: int) -> None:
    """Wait until something listens at a port of this machine."""
    import socket

    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.05)


def free_port() -> int:
    """Return a port of this machine that nothing listens at."""
    import socket

    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
