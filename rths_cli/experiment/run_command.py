"""The work of `rths run` with all its cases: check all first, run them one by one or in parallel, exit code; memory
settings of such a batch.

A run allocates and frees tens of arrays of some megabytes. By default the C library returns each to the system at once,
and the system must then clear every page of the next array, which takes a tenth of a batch's time.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from glob import escape
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Protocol, TypeVar

from rths_cli.errors import InputError, RthsError, crash_note, out_of_memory
from rths_cli.experiment.case_warnings import baseline_note
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.real_rig_readiness import ask_to_move
from rths_cli.experiment.recorded_run import with_recordings
from rths_cli.experiment.run_case import Ended, moves_table, prepare_all, prepare_folder, run_case, worst_code
from rths_cli.experiment.setup import OwnSamples, Progress, Setup
from rths_cli.experiment.unit_plausibility import before_error
from rths_cli.files.durable_files import claimed, further_names, taken_sentence
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import check_writable
from rths_cli.findings import sentences
from rths_cli.interrupts import ended_by
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import Values

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.control.interface import OwnParts
    from rths_cli.loop.live_view import View

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # of glibc's malloc.h
MOST_KEPT_BYTES = 2**31 - 1  # largest amount of freed memory that is kept
GROWN_BYTES = 1 << 26  # taken from the system at a time
LARGEST_BYTES = 1 << 25  # largest array whose memory is kept, the maximum that glibc permits

KEPT, KEPT_BYTES = 8, 1 << 28  # largest number of shared values of each kind, and of bytes of all kinds
RESPONSES = 3  # shared responses of a case: SIM, SIM of the identified building, SIM-DELAY
Job = tuple[Setup, Path]  # a case and its result file
Item = TypeVar("Item")
Result = TypeVar("Result")
Tell = Callable[[str], None]
AT_ONCE = 2  # largest number of parallel cases; more would wait for the Python interpreter


def keep_freed_memory() -> None:
    """Let the process reuse freed memory instead of returning it to the system (glibc on Linux; else no effect)."""
    if not sys.platform.startswith("linux"):
        return
    option = getattr(ctypes.CDLL(None), "mallopt", None)
    if option is None:  # another C library
        return
    for name, value in ((MMAP_THRESHOLD, LARGEST_BYTES), (TRIM_THRESHOLD, MOST_KEPT_BYTES), (TOP_PAD, GROWN_BYTES)):
        option(name, value)


class Watcher(Protocol):
    """Receives the progress of a batch, for example to show it on a terminal."""

    def started(self, number: int, count: int, name: str) -> None:
        """Report that case `number` of `count` starts."""

    def doing(self, what: str) -> None:
        """Report the present work."""

    def ended(self, ended: Ended, seconds: float) -> None:
        """Report the end of a case and its duration."""

    def message(self, text: str) -> None:
        """Report a sentence for the user."""

    def warning(self, text: str) -> None:
        """Report a warning at once; it is among those of a case that ends later."""

    def moving(self, label: str, view: View) -> bool:
        """Report the state of a run on a real rig; return whether the operator wants to stop it."""

    def confirm(self, lines: Sequence[str]) -> bool:
        """Show a checklist and return whether a person confirms that a real table may move."""


@dataclass(frozen=True)
class Request:
    """Arguments of `rths run`."""

    cases: tuple[Case, ...]  # each once for each of `methods`
    methods: tuple[str, ...]  # (): each case's own method
    output: Path  # folder of the result files
    replace: bool  # whether existing result files may be replaced
    command_line: str  # as stored in the result files
    overrides: tuple[str, ...] = ()  # as given by --override
    parts: OwnParts | None = None  # of the step, made by the caller
    samples: OwnSamples = ()  # of the identified model, the caller's
    fresh: bool = False  # whether cached models of virtual rigs are ignored
    yes: bool = False  # whether a rig with `unattended: true` moves without a question
    session_seed: int | None = None  # of the session of the table runs; None: each case's own seed
    series: str = "all"  # that the result files keep, one of `KEPT_SERIES`
    keep_going: bool = False  # whether a case that cannot be used is a failed one instead of an InputError for all
    refused: tuple[tuple[str, str], ...] = ()  # files that hold no case to be used, and why
    at_once: int | None = None  # largest number of cases that run in parallel; None: as many as are of use


def plan(request: Request, memory: Memory, shared: SharedValues) -> tuple[list[Job], list[Ended]]:
    """Check every case completely, and return each with its result file, and those that cannot be used where the
    request keeps going; nothing is written.

    Raises InputError if a case or a model file has faults, or a result file must not be replaced.
    """
    if not request.keep_going:
        return _planned(request, request.cases, memory, shared), []
    jobs: list[Job] = []
    unusable = [Ended(Path(file).stem, None, "failed", why, 2) for file, why in request.refused]
    for case in request.cases:
        try:
            jobs += _planned(replace(request, methods=()), [case], memory, shared, len(request.methods) > 1)
        except InputError as error:
            unusable.append(Ended(case.name, None, "failed", "; ".join(error.faults), 2))
    if jobs:
        prepare_folder([setup for setup, _ in jobs], request.output, request.series)
    return jobs, unusable


def _planned(
    request: Request, all_cases: Sequence[Case], memory: Memory, shared: SharedValues, named: bool = False
) -> list[Job]:
    """Return cases with their result files; `named`: the files are named after the methods, too."""
    jobs: list[Job] = []
    for method in request.methods or ("",):
        cases = [case for case in all_cases if method in ("", case.method)]
        setups = prepare_all(
            cases, request.output, request.overrides, shared, request.parts, request.samples, request.series
        )
        setups = [replace(setup, session_seed=request.session_seed) for setup in map(with_recordings, setups)]
        named = named or len(request.methods) > 1
        jobs += [(setup, request.output / _file_of(setup, named)) for setup in setups]
    if request.series != "all" and (real := [setup for setup, _ in jobs if setup.moves_hardware]):
        raise InputError(
            f"--series {request.series}: rig {real[0].rig.name} is real, whose runs keep all; leave it out"
        )
    for setup, _ in jobs:
        if moves_table(setup.case):
            memory.prepare(setup)
    check_existing([(path, Kind.RESULT) for _, path in jobs], request.replace)
    return jobs


def _file_of(setup: Setup, named: bool) -> str:
    """Return the name of a case's result file."""
    of = "".join(f"-{spec.recording.stem}" for spec in setup.case.recorded.values())
    return f"{setup.case.name}{of}{f'-{setup.case.method}' if named else ''}{_when(setup)}.h5"


def _when(setup: Setup) -> str:
    """Return the time (UTC) for the name of a real rig's result, which is never replaced; "" for a virtual rig."""
    return datetime.now(UTC).strftime("-%Y%m%dT%H%M%SZ") if setup.moves_hardware else ""


def run_batch(request: Request, watcher: Watcher) -> list[Ended]:
    """Run every case of a request, several at a time on virtual rigs, and return how each one ended, first those that
    cannot be used.

    If a case fails, the others are still run. On a real rig, the batch stops after an exit code above 1. Raises
    InputError if a case cannot be used or a real rig may not move.
    """
    keep_freed_memory()
    memory, shared = Memory(Cache(request.fresh)), SharedValues()
    planned, unusable = plan(request, memory, shared)
    for number, ended in enumerate(unusable, 1):
        watcher.started(number, len(unusable) + len(planned), ended.name)
        watcher.ended(ended, 0.0)
    if not planned:
        return unusable
    with ExitStack() as names:
        jobs = [(setup, _own_name(path, request.replace, watcher, names)) for setup, path in planned]
        check_existing([(path, Kind.RESULT) for _, path in jobs], request.replace)  # again, now that they are ours
        return [*unusable, *_run_jobs(jobs, request, memory, shared, watcher, len(unusable))]


def _own_name(path: Path, replaces: bool, watcher: Watcher, names: ExitStack) -> Path:
    """Return the name of a result that is claimed for this process until `names` is closed: `path`, or where another
    process is writing that, the next free one beside it. Raises InputError if that is not wanted (`--no-replace`)."""
    check_writable(path.parent)
    if names.enter_context(claimed(path)):
        return path
    if not replaces:
        raise InputError(f"{path}: is being written by another process; choose another --output, or wait for its end")
    name = next(one for one in further_names(path) if not one.exists() and names.enter_context(claimed(one)))
    watcher.message(f"{path}: is being written by another process; this result goes to {name}")
    return name


def _run_jobs(
    jobs: Sequence[Job], request: Request, memory: Memory, shared: SharedValues, watcher: Watcher, before: int
) -> list[Ended]:
    """Run the cases, whose result files are claimed; `before`: number of cases that cannot be used."""
    shared.size = most_kept(jobs)
    real = [setup for setup, _ in jobs if setup.moves_hardware]
    for note in dict.fromkeys(str(note) for setup in real for note in baseline_note(setup)):
        watcher.warning(note)  # before anybody permits a motion; of a virtual rig the answer tells

    def predicted(setup: Setup) -> Values:
        from rths_cli.files.foreign_models import is_foreign

        model = setup.case.identification.model
        if setup.recorded or "exp_rths" not in setup.case.runs or model is None or is_foreign(model):
            return {}
        return verdict_on(setup, memory.at_rest(setup, watcher.doing), shared=shared).figures

    ask_to_move([setup for setup, _ in jobs if not setup.recorded], request.yes, watcher.confirm, predicted)

    def work(job: Job, tell: Progress) -> Ended:
        start = time.monotonic()
        ended = run_one(*job, memory, shared, request.command_line, tell, watcher, request.series)
        return replace(ended, seconds=time.monotonic() - start)

    results: list[Ended] = []
    with closing(in_order(work, jobs, watcher.doing, cases_at_once(jobs, request.at_once))) as endings:
        for number, (setup, path) in enumerate(jobs, before + 1):
            watcher.started(number, before + len(jobs), path.stem)
            ended = next(endings)
            results.append(ended)
            if ended.path not in (None, path):
                watcher.message(taken_sentence(path, ended.path))
            watcher.ended(ended, ended.seconds)
            if setup.moves_hardware and ended.exit_code > 1:
                results += [_not_run(left, path) for left, _ in jobs[number - before :]]
                break
    return results


def _not_run(setup: Setup, stopped: Path) -> Ended:
    """Return the end of a case that a real rig does not begin after `stopped`, which did not end as planned."""
    reason = f"not begun after {stopped.stem}: a person looks at the table before it moves again"
    return Ended(setup.case.name, None, "not run", reason, 1)


def cases_at_once(jobs: Sequence[Job], most: int | None = None) -> int:
    """Return the number of cases that run in parallel, at most `most`: one with a real rig or a very long record."""
    real = any(setup.moves_hardware for setup, _ in jobs)
    return 1 if real else min(most or AT_ONCE, len(jobs), cores(), most_kept(jobs))


def exit_code(results: Sequence[Ended]) -> int:
    """Return the exit code of a batch, that of its worst end (docs/decisions/commands.md)."""
    return worst_code(ended.exit_code for ended in results)


def most_kept(jobs: Sequence[Job]) -> int:
    """Return the number of shared values of each kind that fit into KEPT_BYTES for the longest case: 1 to KEPT."""
    series = max(len(setup.motion.time_s) * (4 + RESPONSES * (3 * setup.building.storeys + 1)) for setup, _ in jobs)
    return max(1, min(KEPT, KEPT_BYTES // (8 * series)))


def run_one(
    setup: Setup, path: Path, memory: Memory, shared: SharedValues, command_line: str, tell: Progress, watcher: Watcher,
    series: str = "all",
) -> Ended:  # fmt: skip
    """Run one case, write its result file and return how it ended; an exception gives the reason and the exit code."""
    taken = path.exists()
    try:
        if setup.rig.can.counts_steps or setup.recorded:
            return run_case(setup, path, memory, command_line, tell, shared, series=series)
        return _run_real(setup, path, memory, shared, command_line, tell, watcher)
    except RthsError as error:
        return _failed(setup, path, taken, "; ".join(sentences(before_error(setup, error))), error.exit_code)
    except Exception as error:
        tell("")  # a signal that arrived during a compilation ends the batch here
        if told := out_of_memory(error):
            return _failed(setup, path, taken, told, 2)
        return _failed(setup, path, taken, f"internal error ({type(error).__name__}), {crash_note()}", 5)


def _run_real(
    setup: Setup, path: Path, memory: Memory, shared: SharedValues, command_line: str, tell: Progress, watcher: Watcher
) -> Ended:
    """Run a case on a real rig; rate and channels are checked before the table moves and its result file is begun."""
    from rths_cli.experiment.real_stage import RealStage, ask_the_rig

    if moves_table(setup.case):
        ask_the_rig(setup, memory, tell)
    with closing(RealStage(watcher.moving)) as stage:
        return run_case(setup, path, memory, command_line, tell, shared, stage)


def _failed(setup: Setup, path: Path, taken: bool, reason: str, code: int) -> Ended:
    """Return the end of a case that raised an exception; `taken`: the result file existed before.

    A result file of a real rig that was begun is kept. Exit code 2, which means that nothing was written, is then
    replaced by 4.
    """
    begun = (
        setup.moves_hardware
        and not taken
        and bool(path.exists() or [*path.parent.glob(f".{escape(path.name)}.*.part")])
    )
    return Ended(
        setup.case.name, path if begun and path.exists() else None, "failed", reason, 4 if begun and code == 2 else code
    )


class Stopped(BaseException):
    """Raised in a job to end it, because the batch has ended."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_order(
    work: Callable[[Item, Tell], Result], jobs: Sequence[Item], tell: Tell, at_once: int
) -> Generator[Result, None, None]:
    """Yield the results of `work(job, tell)` in the order of the jobs, of which `at_once` run in parallel.

    `tell` is called only for the job whose result is awaited. An exception of a job is raised here. After that, or when
    the iterator is closed, Stopped ends the running jobs at their next report or interruptible computation, and no
    further job starts.
    """
    if at_once == 1:
        yield from (work(job, tell) for job in jobs)
        return
    stop, awaited = Event(), [0]

    def look() -> None:
        if stop.is_set():
            raise Stopped

    def begin(number: int, job: Item) -> Result:
        def told(what: str) -> None:
            look()
            if awaited[0] == number:
                tell(what)

        look()
        with ended_by(look):
            return work(job, told)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            futures = [pool.submit(begin, number, job) for number, job in enumerate(jobs)]
            for awaited[0], future in enumerate(futures):
                yield future.result()
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
