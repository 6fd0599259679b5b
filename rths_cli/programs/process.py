"""The process of a program, seen from rths: start it, exchange displacements and forces through shared memory, end it.

Control goes over a socket, numbers over memory that both processes map. Whatever a program does (ends, hangs, raises,
gives no numbers) becomes a `ProgramFault` with its name; no process outlives its `Program` or this process.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import pickle
import select
import socket
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import visible

MOST_FLOORS = 200
START_S = 120.0  # to import, build and apply gravity
LONG_S = 3600.0  # for a whole response
FORCE = b"f"  # the message that asks for the forces at the displacements in shared memory
TOLD = 300  # characters of what a program printed, in a sentence
CALLS = 400  # of a measurement


class ProgramFault(InputError):
    """A program that cannot be built, or that failed while it ran."""


@dataclass(frozen=True)
class Description:
    """What a case states of a program. `length_m`, `force_n`: units of an OpenSees model; `sha256` of the file."""

    kind: str
    file: str  # its path, "" where a package brings it
    sha256: str
    function: str
    node: int = 0
    dof: int = 0
    length_m: float = 1.0
    force_n: float = 1.0
    masses_kg: tuple[float, ...] = ()
    parameters: tuple[tuple[str, float], ...] = ()
    silent_after_s: float = 10.0

    @property
    def name(self) -> str:
        """Return the program's name in messages."""
        return f"{self.kind} program {Path(self.file).name}" if self.file else f"program {self.kind}"

    def content(self) -> str:
        """Return the checksum of the file as it is now, "" without one; raises ProgramFault."""
        try:
            return hashlib.sha256(Path(self.file).read_bytes()).hexdigest() if self.file else ""
        except OSError as error:
            raise ProgramFault(f"{self.name}: {self.file} cannot be read: {error}") from error

    def check(self) -> None:
        """Raise ProgramFault where the file is no longer the one of the checksum."""
        if self.file and self.sha256 and self.content() != self.sha256:
            raise ProgramFault(f"{self.name}: {self.file} has changed since the case was read; start again")


@dataclass(frozen=True)
class Described:
    """What a program says of itself, built and at rest: p floors, the interface last.

    `masses_kg` (p,); `stiffness` (p, p) in N/m, the condensed tangent at rest; `first_hz`: the first natural frequency
    of the program's own eigenvalue analysis, NaN where it has none; `version` of what computes it.
    """

    masses_kg: Array
    stiffness: Array
    floors: tuple[str, ...]
    first_hz: float
    version: str


@dataclass(eq=False)
class Program:
    """A program in a process of its own, built and at rest. Close it, or use it as a context."""

    description: Description
    described: Described = field(init=False)
    _process: subprocess.Popen[bytes] = field(init=False)
    _connection: Connection = field(init=False)
    _poll: select.poll = field(init=False)
    _printed: IO[bytes] = field(init=False)
    _numbers: Array = field(init=False)

    def __post_init__(self) -> None:
        self.description.check()
        memory = _shared(8 * 2 * MOST_FLOORS)
        ours, theirs = socket.socketpair()
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115
        command = [sys.executable, "-m", "rths_cli.programs.child", str(theirs.fileno()), str(memory.fileno())]
        folder = str(Path(self.description.file).parent) if self.description.file else None
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=self._printed, stderr=self._printed, cwd=folder,
                pass_fds=(theirs.fileno(), memory.fileno()), env=_environment(),
            )  # fmt: skip
        except OSError as error:
            raise ProgramFault(f"{self.description.name}: its process cannot be started: {error}") from error
        self._connection = Connection(ours.detach())
        self._poll = select.poll()  # Connection.poll makes one at each call
        self._poll.register(self._connection.fileno(), select.POLLIN)
        theirs.close()
        self._numbers = np.frombuffer(mmap.mmap(memory.fileno(), 0), dtype=float).reshape(2, MOST_FLOORS)
        memory.close()
        self.close = weakref.finalize(self, _end, self._process, self._connection, self._printed)
        try:
            self.described = self.asked("build", START_S, self.description)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def asked(self, operation: str, longest_s: float, *arguments: Any) -> Any:
        """Return what an operation of the child gives; raises ProgramFault where there is none."""
        self._send(pickle.dumps((operation, longest_s, arguments)))
        return self._answer(longest_s)

    @property
    def process_id(self) -> int:
        """Return the number of its process."""
        return self._process.pid

    def restart(self) -> None:
        """Build the program anew, at rest."""
        self.asked("restart", START_S)

    def request(self, displacement_m: Array) -> None:
        """Ask for the restoring forces at displacements (p,) in m, relative to rest; does not wait."""
        self._numbers[0, : displacement_m.size] = displacement_m
        self._send(FORCE)

    def forces(self) -> Array:
        """Return the restoring forces (p,) in N that were asked for; waits. Raises ProgramFault."""
        self._answer(self.description.silent_after_s)
        found = self._numbers[1, : self.described.masses_kg.size].copy()
        if not np.isfinite(found).all():
            raise self._fault(f"gave a force that is not finite: {np.array2string(found, precision=4)} N")
        return found

    def force_at(self, displacement_m: Array) -> Array:
        """Return the restoring forces (p,) in N at displacements (p,) in m."""
        self.request(displacement_m)
        return self.forces()

    def _send(self, message: bytes) -> None:
        if not self.close.alive:
            raise self._fault("has been ended")
        try:
            self._connection.send_bytes(message)
        except OSError:
            raise self._ended() from None

    def _answer(self, longest_s: float) -> Any:
        try:
            if not self._poll.poll(1e3 * longest_s):
                fault = self._fault(f"did not answer within {longest_s:g} s and was ended")
                self.close()
                raise fault
            said, value = pickle.loads(self._connection.recv_bytes())
        except (EOFError, OSError):
            raise self._ended() from None
        if said == "fault":
            raise self._fault(value)
        return value

    def _ended(self) -> ProgramFault:
        """Return how the process ended by itself."""
        try:
            code = self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            code = None
        how = "closed its connection" if code is None else "ended by itself, "
        how += "" if code is None else f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        fault = self._fault(how)
        self.close()
        return fault

    def _fault(self, what: str) -> ProgramFault:
        said = last_printed(self._printed)
        return ProgramFault(f"{self.description.name} {what}" + (f"; it printed last: {said}" if said else ""))


def last_printed(file: IO[bytes]) -> str:
    """Return the last line that a program printed, "" for none."""
    if file.closed:
        return ""
    size = os.fstat(file.fileno()).st_size
    tail = os.pread(file.fileno(), 4096, max(size - 4096, 0)).decode(errors="replace")
    lines = [line.strip() for line in tail.splitlines() if line.strip()]
    return visible(lines[-1])[:TOLD] if lines else ""


def _end(process: subprocess.Popen[bytes], connection: Connection, printed: IO[bytes]) -> None:
    """End a process: it leaves when its connection closes, and is killed where it does not."""
    connection.close()
    try:
        process.wait(0.5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    printed.close()


def _shared(size: int) -> IO[bytes]:
    """Return an unnamed file of zeros for both processes to map: it leaves nothing behind."""
    if hasattr(os, "memfd_create"):
        file: IO[bytes] = os.fdopen(os.memfd_create("rths-program"), "w+b")
    else:
        file = tempfile.TemporaryFile()  # noqa: SIM115
    file.truncate(size)
    return file


def _environment() -> Mapping[str, str]:
    """Return the environment of a program: one thread, and this package where this process has it."""
    package = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH", ""))))
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **threads, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}


@lru_cache(maxsize=32)
def described(description: Description) -> Described:
    """Return what a program says of itself; equal ones are asked once in a process. Raises ProgramFault."""
    with Program(description) as program:
        return program.described


def step_times(description: Description, amplitude_m: Array, calls: int = CALLS) -> Array:
    """Return the time in s of each of some calls, from request to forces here, over four growing cycles up to
    displacements `amplitude_m` (p,)."""
    taken = np.zeros(calls)
    with Program(description) as program:
        for k in range(calls):
            displacement = amplitude_m * (k + 1) / calls * np.sin(8.0 * np.pi * k / calls)
            start = time.perf_counter()
            program.force_at(displacement)
            taken[k] = time.perf_counter() - start
    return taken
