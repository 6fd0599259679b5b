"""Interrupt sweeps at random instants, let them go on, and compare the table with that of an uninterrupted one.

A sweep of 120 rows, some milliseconds each, is a command of its own, forked from a process that has imported it. The
interruption comes when a drawn number of rows is there, and a drawn fraction of 50 ms later: anywhere in a row or while
the table is written, however busy the machine is. Afterwards the rows that are kept must be whole and there once, the
same command with `--resume` must play the others alone, and the datasets of the table must be those of the reference to
the last bit.
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
from typing import Any, NoReturn

import h5py
import numpy as np

SEEDS = 60  # of each of two grid points
LATER_S = 0.05  # longest time between the drawn row and the interruption: some rows, or the writing of the table
KINDS = ("killed worker", "restarted scheduler", "Ctrl-C", "SIGKILL", "full disk")
LOCAL = (("--engine", "inline"), ("--engine", "threads"), ("--engine", "processes", "--jobs", "2"))
DISK_MB = 8
LIMIT_S = 300.0
CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
STUDY = "case: short\naxes: {table.after_identification.coulomb_factor: [1, 3]}\n"


@dataclass(frozen=True)
class Trial:
    """One interruption: after which row and time; how many rows were there then; what is wrong (empty: nothing)."""

    kind: str
    engine: str
    after_rows: int
    after_s: float
    met: bool  # the command had not ended before
    there: int
    faults: tuple[str, ...]


@dataclass
class Bench:
    """A folder with the study and its uninterrupted table."""

    folder: Path
    reference: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def made(cls, folder: Path, seeds: int = SEEDS) -> Bench:
        """Write the study and run it without interruption."""
        write_case(folder, "short.yaml")
        (folder / "study.yaml").write_text(f"{STUDY}seeds: {seeds}\n")
        bench = cls(folder)
        whole = folder / "whole.h5"
        first = bench.started(whole, LOCAL[0])
        if (said := first.end()) and first.returncode:
            raise RuntimeError(said)
        bench.reference = datasets(whole)
        return bench

    def started(self, output: Path, engine: Sequence[str], *more: str) -> Forked:
        """Start the sweep."""
        arguments = ("sweep", str(self.folder / "study.yaml"), "--output", str(output), *engine, *more)
        return Forked(lambda: rths(*arguments), self.folder / "told.txt")


def write_case(folder: Path, name: str) -> None:
    """Write a case of that file name on a record of 4.5 s, with the record."""
    time_s = np.arange(0.0, 4.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
    lines = "\n".join(f"{a:.6f}" for a in accel)
    (folder / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{lines}\n")
    (folder / name).write_text(CASE)


def datasets(path: Path) -> dict[str, Any]:
    """Return all datasets of a sweep, numbers as bytes."""

    def content(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        return value.tolist() if value.dtype.kind == "O" else value.tobytes()

    with h5py.File(path) as file:
        return {name: content(node[()]) for name, node in file.items()}


class Forked:
    """A command in a session of its own, forked from this process, which has imported what it needs."""

    def __init__(self, call: Callable[[], object], told: Path) -> None:
        self._told = told
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            _be(call, told)

    def poll(self) -> int | None:
        """Return the exit code, None while the command runs."""
        if self.returncode is None and (found := os.waitpid(self.pid, os.WNOHANG))[0]:
            self.returncode = os.waitstatus_to_exitcode(found[1])
        return self.returncode

    def end(self) -> str:
        """Wait for the end and return what was written to stderr."""
        end = time.monotonic() + LIMIT_S
        while self.poll() is None:
            if time.monotonic() > end:
                self.kill()
            time.sleep(0.005)
        return self._told.read_text()

    def kill(self) -> None:
        """Kill the command alone, where it still runs."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


def _be(call: Callable[[], object], told: Path) -> NoReturn:
    """Be the command; never return."""
    code = 99
    try:
        os.setsid()
        with open(told, "w") as file, open(os.devnull, "w") as silent:
            os.dup2(file.fileno(), 2)
            os.dup2(silent.fileno(), 1)
        try:
            call()
            code = 0
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else 1
        sys.stderr.flush()
    finally:
        os._exit(code)


def rths(*arguments: str) -> None:
    """Run a command of rths and leave with its exit code."""
    from rths_cli.__main__ import main

    sys.argv = ["rths", *arguments]
    main()


def dask(part: str, *arguments: str) -> None:
    """Run `dask scheduler` or `dask worker`."""
    from distributed.cli import dask_scheduler, dask_worker

    {"scheduler": dask_scheduler, "worker": dask_worker}[part].main(list(arguments), standalone_mode=False)


def await_rows(process: Forked, output: Path, number: int) -> None:
    """Wait for that many rows, or the end of the process."""
    rows = rows_of(output)
    while process.poll() is None:
        with suppress(OSError):
            if rows.read_bytes().count(b"\n") > number:
                break
        time.sleep(0.002)


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
    interrupt: Callable[[Forked], None], ends_itself: bool, before_resume: Callable[[], None],
) -> Trial:  # fmt: skip
    """Start the sweep, interrupt it, resume it, and judge."""
    after_rows, after_s = rng.randint(1, len(bench.reference["status"])), rng.uniform(0.0, LATER_S)
    process = bench.started(output, engine)
    await_rows(process, output, after_rows)
    time.sleep(after_s)
    met, there = process.poll() is None, len(kept_rows(output))
    if met:
        interrupt(process)
    said = process.end()
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
    return Trial(kind, " ".join(engine[1:2]), after_rows, after_s, met, there, tuple(faults))


def resumed(bench: Bench, output: Path, engine: Sequence[str], kept: int) -> Iterator[str]:
    """Go on with a sweep; yield what went wrong."""
    told = f"{kept} of {len(bench.reference['status'])} runs were played before"
    again = bench.started(output, engine, "--resume")
    said = again.end()
    if again.returncode:
        yield f"--resume: exit code {again.returncode}: {said[-300:]}"
    elif kept and told not in said:
        yield f"--resume did not say {told!r}: {said[-300:]}"


def kill_worker(process: Forked, rng: random.Random) -> None:
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
        self.told, self.port, self.address = folder / "cluster.txt", port, f"tcp://127.0.0.1:{port}"
        self.processes: list[Forked] = []

    def start(self) -> None:
        """Start scheduler and workers, and wait until the scheduler listens."""
        here = ("--host", "127.0.0.1", "--no-dashboard")
        scheduler = Forked(lambda: dask("scheduler", "--port", str(self.port), *here), self.told)
        await_port(self.port)
        worker = (self.address, "--nthreads", "1", "--no-nanny", *here)
        self.processes = [scheduler, *(Forked(lambda: dask("worker", *worker), self.told) for _ in range(2))]

    def kill_scheduler(self, restart: bool) -> None:
        """Kill the scheduler alone, and start another one with other workers at once."""
        self.processes[0].kill()
        if restart:
            self.stop()
            self.start()

    def stop(self) -> None:
        """End all."""
        for process in self.processes:
            process.kill()
            process.end()


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
        return interrupted(bench, kind, rng, output, local, Forked.kill, False, nothing)
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

        def again() -> None:
            cluster.stop()
            cluster.start()

        return interrupted(
            bench, kind, rng, output, engine, lambda _: cluster.kill_scheduler(rng.random() < 0.5), False, again
        )
    finally:
        cluster.stop()


def _ctrl_c(process: Forked) -> None:
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
