"""Where the rows of a sweep are played (this process, processes of this machine, Dask's workers), and what another
process is told.

All stand behind `concurrent.futures.Executor`. Threads and the process itself play runs that are made ready here;
processes and Dask's workers make what they play themselves, from a few lines that say which rows. A row depends on its
grid point and seed alone, so every engine gives the same.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar

from rths_cli.case.load import PlacedSettings, WrittenCase, load_written
from rths_cli.errors import InputError, RthsError
from rths_cli.experiment.model_files import software
from rths_cli.experiment.run_command import keep_freed_memory
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import METRICS
from rths_cli.studies.sweep_runs import Shared, not_ready, play_variant
from rths_cli.studies.sweep_table import Row
from rths_cli.version import __version__

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from rths_cli.experiment.setup import Progress

SEVERAL = "a worker runs rths {theirs}, this process rths {ours}{why}; install the same on all of them"
SAME_NUMBER = ", with other sources or another Python, numpy, scipy or numba"
_SHARED = SharedValues(size=1)  # what rows share, of the sweep that this process works for

P = ParamSpec("P")
T = TypeVar("T")
ENGINES = ("inline", "threads", "processes", "dask")
ELSEWHERE = ("processes", "dask")
AHEAD = 4  # runs or chunks handed out per worker: enough to work on while more are made ready
LOOK_S = 5.0  # between two looks whether any worker is there; the first is told where there is none
LOSSES = 3  # in a row without a chunk that ends in between: then a run itself ends its process
LOGGERS = ("distributed", "distributed.client", "tornado.application")  # of Dask, which log with a traceback
INSTALL = "pip install 'rths-cli[dask]'"
START_METHOD = "forkserver" if sys.platform == "linux" else "spawn"  # forked ones import nothing, others do
PRELOADED = ("rths_cli.studies.engines", "scipy.signal", "h5py")  # what every run needs


class OtherSoftwareError(RthsError):
    """A worker has another rths, Python or numerical package than the process that asks it."""

    exit_code = 2

    def __init__(self, theirs: str, ours: str) -> None:
        super().__init__(SEVERAL.format(theirs=theirs, ours=ours, why=SAME_NUMBER if theirs == ours else ""))
        self._told = theirs, ours

    def __reduce__(self) -> tuple[type[OtherSoftwareError], tuple[str, str]]:
        """Return how the error is made again in the process that asked."""
        return type(self), self._told


@dataclass(frozen=True)
class Work:
    """What all rows of a sweep have in common: its case as written, with absolute paths, the settings of all rows, the
    metrics that are kept, how many storeys a row has room for, and the software that asks."""

    plan_sha256: str
    case: WrittenCase
    settings: PlacedSettings
    overrides: tuple[str, ...]
    metrics: tuple[str, ...]
    storeys: int
    software_sha256: str
    version: str
    sim_alone: bool = False


@dataclass(frozen=True)
class PointRows:
    """Rows of one grid point: its varied values as settings, and number and seed of each row."""

    varied: PlacedSettings
    rows: tuple[tuple[int, int], ...]


Chunk = tuple[PointRows, ...]
"""Rows that one process computes one after another."""


def check_software(sha256: str, version: str) -> None:
    """Raise OtherSoftwareError where this process runs another software."""
    if software() != sha256:
        raise OtherSoftwareError(__version__, version)


def play_chunk(work: Work, chunk: Chunk) -> list[Row]:
    """Return the rows of a chunk; raises OtherSoftwareError before the first where this is another software."""
    check_software(work.software_sha256, work.version)
    shared = _SHARED.get("shared", (work.plan_sha256, work.overrides), lambda: _begun(work))
    return [row for point in chunk for row in _rows(shared, work, point)]


def _begun(work: Work) -> Shared:
    keep_freed_memory()
    return Shared(work.overrides, lambda _: None, work.metrics, work.sim_alone)


def _rows(shared: Shared, work: Work, point: PointRows) -> Iterator[Row]:
    columns = [METRICS[path] for path in work.metrics]
    try:
        ready = shared.ready(load_written(work.case, work.settings, point.varied))
    except Exception as error:
        blank = not_ready(point.rows[0][0], columns, work.storeys, error)
        yield from (replace(blank, variant=variant) for variant, _ in point.rows)
        return
    for variant, seed in point.rows:
        yield play_variant(ready, variant, seed, columns, work.storeys)


@dataclass(frozen=True)
class Engine:
    """Which engine plays the runs; `jobs`: runs at a time on this machine; `scheduler`: address or file of Dask's."""

    name: str = "threads"
    jobs: int = 1
    scheduler: str = ""


class InlineExecutor(Executor):
    """Call at once, in the thread that submits."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Return a future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def executor_here(engine: Engine) -> Executor:
    """Return what plays runs that are made ready in this process."""
    return InlineExecutor() if engine.name == "inline" else ThreadPoolExecutor(engine.jobs)


class Workers(Protocol):
    """Processes that play chunks of rows. `lost`: the errors of a chunk whose worker was lost."""

    lost: tuple[type[BaseException], ...]

    def count(self) -> int:
        """Return how many chunks are played at a time, at least 1."""

    def submit(self, work: Work, chunk: Chunk) -> Future[list[Row]]:
        """Hand out a chunk."""

    def why_idle(self) -> str:
        """Return why nothing is played at the moment, as a sentence, empty where something is; raises WorkersLostError
        where nothing ever will."""

    def replace_lost(self, error: BaseException) -> None:
        """Start anew after a worker was lost; raises RthsError where that is of no use."""

    def close(self, at_once: bool) -> None:
        """Let the workers go, `at_once` without waiting for what they play."""


class LocalProcesses:
    """Processes of this machine. They end with this one, however it ends."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._context = get_context(START_METHOD)
        if START_METHOD == "forkserver":
            self._context.set_forkserver_preload(list(PRELOADED))
        self._start()

    def _start(self) -> None:
        theirs, self._life = self._context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(self._jobs, self._context, _begin_worker, (theirs,))
        self._theirs = theirs

    def count(self) -> int:
        """Return the number of processes."""
        return self._jobs

    def submit(self, work: Work, chunk: Chunk) -> Future[list[Row]]:
        """Hand out a chunk."""
        return self._pool.submit(play_chunk, work, chunk)

    def why_idle(self) -> str:
        """Return nothing: lost processes are replaced at once."""
        return ""

    def replace_lost(self, error: BaseException) -> None:
        """Start other processes: the pool of one that was lost is of no more use."""
        self.close(at_once=True)
        self._start()

    def close(self, at_once: bool) -> None:
        """Let the processes go."""
        if at_once:
            self._life.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._life.close()
        self._theirs.close()


def _begin_worker(life: Connection) -> None:
    """Have this worker ignore Ctrl-C, which its parent obeys, and end when the other end of `life` closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(life,), daemon=True).start()


def _end_with(life: Connection) -> None:
    try:
        life.recv()
    except (EOFError, OSError):
        os._exit(1)


class DaskWorkers:
    """The workers of a Dask scheduler, which itself gives the chunks of lost workers to others."""

    def __init__(self, scheduler: str, work: Work, say: Progress) -> None:
        self._name = scheduler
        distributed = _distributed()
        self.lost: tuple[type[BaseException], ...] = (CancelledError, distributed.KilledWorker)
        for logger in LOGGERS:  # a lost scheduler is told in a sentence
            logging.getLogger(logger).setLevel(logging.CRITICAL)
        where = {"scheduler_file": scheduler} if Path(scheduler).is_file() else {"address": scheduler}
        try:
            self._client = distributed.Client(**where, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one by dask scheduler"
            ) from error
        self._connection = self._client.scheduler_comm
        try:
            self._await_worker(say)
            self._check(work)
        except BaseException as error:
            self._client.close()
            if isinstance(error, OSError):
                raise self._gone() from error
            raise
        self._pool = self._client.get_executor(pure=False)

    def _await_worker(self, say: Progress) -> None:
        """Wait until a worker is there; say what is missing where that takes long. A cluster may have a queue."""
        told = False
        while not self._threads():
            try:
                self._client.wait_for_workers(1, timeout=LOOK_S)
            except TimeoutError:
                if not told:
                    say(self.why_idle())
                told = True

    def _check(self, work: Work) -> None:
        """Raise InputError with a sentence for each worker that runs another software."""
        sha256, version = work.software_sha256, work.version

        def differs() -> str:  # sent as source: a worker may have no rths
            try:
                pass
            except ImportError as error:
                return f"a worker cannot import rths ({error}); install rths {version} there"
            try:
                check_software(sha256, version)
            except Exception as error:
                return str(error)
            return ""

        faults = {address: told for address, told in self._client.run(differs).items() if told}
        if faults:
            raise InputError(*(f"Dask worker {address}: {told}" for address, told in sorted(faults.items())))

    def count(self) -> int:
        """Return the number of threads of all workers that are there now."""
        return max(1, self._threads())

    def _threads(self) -> int:
        """Return the number of threads of all workers. A client that is connected anew, as to a scheduler that was
        restarted, has lost what it waits for."""
        if self._client.scheduler_comm is not self._connection:
            raise self._gone()
        try:
            return sum(self._client.nthreads().values())
        except OSError as error:
            raise self._gone() from error

    def why_idle(self) -> str:
        """Return that no worker is there, and how to start one."""
        if self._threads():
            return ""
        address = self._client.scheduler.address
        return (
            f"--scheduler {self._name}: no worker is there; the sweep waits for one: dask worker {address} "
            "--nthreads 1 (Ctrl-C ends the waiting)"
        )

    def submit(self, work: Work, chunk: Chunk) -> Future[list[Row]]:
        """Hand out a chunk."""
        found: Future[list[Row]] = self._pool.submit(play_chunk, work, chunk)
        return found

    def replace_lost(self, error: BaseException) -> None:
        """Raise WorkersLostError: the scheduler has replaced lost workers several times, or is lost itself."""
        if isinstance(error, CancelledError):
            raise self._gone()
        raise WorkersLostError(f"--scheduler {self._name}: worker after worker was lost ({error})")

    def close(self, at_once: bool) -> None:
        """Let the workers go, and cancel what they have not played."""
        with suppress(OSError, CancelledError):
            self._pool.shutdown(wait=not at_once)
        self._client.close()

    def _gone(self) -> WorkersLostError:
        return WorkersLostError(f"--scheduler {self._name}: the connection to the Dask scheduler is lost")


class WorkersLostError(RthsError):
    """Worker after worker was lost, or all at once with their scheduler."""

    exit_code = 4


def _distributed() -> Any:
    """Return the package distributed; raises InputError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise InputError(f"--engine dask: the package distributed is missing; install it: {INSTALL}") from error
    return distributed


def workers_of(engine: Engine, work: Work, say: Progress) -> Workers:
    """Return the workers of an engine that is not in this process; raises InputError where it has none of use."""
    check_software(work.software_sha256, work.version)
    return DaskWorkers(engine.scheduler, work, say) if engine.name == "dask" else LocalProcesses(engine.jobs)


def check_engine(engine: Engine) -> None:
    """Raise InputError where what is asked of an engine does not fit it, or a package is missing."""
    if engine.name == "dask":
        if not engine.scheduler:
            raise InputError("--engine dask: needs --scheduler, the address of a Dask scheduler, as tcp://HOST:8786")
        _distributed()
    elif engine.scheduler:
        raise InputError(f"--scheduler {engine.scheduler}: is for --engine dask, got --engine {engine.name}")


def play_all(workers: Workers, work: Work, chunks: Iterable[Chunk], say: Progress) -> Iterator[Row]:
    """Yield the rows of all chunks in their order; what a lost worker had is played again by others.

    Raises WorkersLostError when workers are lost `LOSSES` times in a row and no chunk ends in between.
    """
    waiting: deque[tuple[Chunk, Future[list[Row]]]] = deque()
    left, losses, ended = iter(chunks), 0, False
    try:
        while True:
            try:
                room = AHEAD * workers.count() - len(waiting)
                for chunk in (each for _, each in zip(range(room), left, strict=False)):
                    waiting.append((chunk, _submitted(workers, work, chunk)))
                if not waiting:
                    break
                rows = _result(waiting[0][1], workers, say)
            except workers.lost as error:
                losses += 1
                if losses >= LOSSES:
                    raise WorkersLostError(_lost_sentence(waiting[0][0])) from error
                workers.replace_lost(error)
                say("a worker was lost; what it had is played again")
                waiting = deque([(chunk, _kept(workers, work, chunk, future)) for chunk, future in waiting])
                continue
            losses = 0
            waiting.popleft()
            yield from rows
        ended = True
    finally:
        workers.close(at_once=not ended)


def _result(future: Future[list[Row]], workers: Workers, say: Progress) -> list[Row]:
    """Return the rows of a chunk when they are there; say once why none come where no worker is left."""
    told = False
    while True:
        try:
            return future.result(LOOK_S)
        except TimeoutError:
            if future.done():
                raise  # the chunk's own
            why = workers.why_idle()  # raises where all are lost
            if why and not told:
                say(why)
                told = True


def _submitted(workers: Workers, work: Work, chunk: Chunk) -> Future[list[Row]]:
    """Return the future of a chunk, a broken one where a worker was lost before: the chunk is in the queue then."""
    try:
        return workers.submit(work, chunk)
    except BrokenExecutor as error:
        broken: Future[list[Row]] = Future()
        broken.set_exception(error)
        return broken


def _kept(workers: Workers, work: Work, chunk: Chunk, future: Future[list[Row]]) -> Future[list[Row]]:
    """Return the future of a chunk whose rows are there, else that of the same chunk handed out again."""
    there = future.done() and not future.cancelled() and not isinstance(future.exception(), BrokenExecutor)
    return future if there else _submitted(workers, work, chunk)


def _lost_sentence(chunk: Chunk) -> str:
    rows = [variant + 1 for point in chunk for variant, _ in point.rows]
    return (
        f"worker processes were lost {LOSSES} times in a row (killed, or out of memory), the last at rows {rows[0]} to "
        f"{rows[-1]}; use fewer --jobs, or find out what ends them"
    )
