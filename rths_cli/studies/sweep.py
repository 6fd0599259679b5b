"""What `rths sweep` does: check the grid, play every run as EXP-RTHS on the virtual rig side by side, write one
table."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor, Future
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rths_cli.case.load import PlacedSettings, written_case
from rths_cli.errors import InputError, RthsError
from rths_cli.experiment.model_files import software
from rths_cli.experiment.provenance import attributes
from rths_cli.experiment.run_command import keep_freed_memory
from rths_cli.files.durable_files import claimed, taken_sentence
from rths_cli.files.existing_files import Kind, check_existing, replaced_sentence
from rths_cli.files.result_writer import check_writable
from rths_cli.files.sweep_file import RowsFile, Sweep, check_csv, read_part, rows_path, write_csv, write_sweep
from rths_cli.studies.engines import (
    AHEAD,
    ELSEWHERE,
    Chunk,
    Engine,
    PointRows,
    Work,
    check_engine,
    executor_here,
    play_all,
    workers_of,
)
from rths_cli.studies.grid_points import Points, check_points
from rths_cli.studies.study_plan import Asked, Planned, read_plan, seeds_text
from rths_cli.studies.sweep_output import Begun, as_line, as_sweep, begin, several_processors, take_rows
from rths_cli.studies.sweep_runs import Shared, not_ready, play_variant
from rths_cli.studies.sweep_table import Row, Table, columns
from rths_cli.version import __version__

if TYPE_CHECKING:
    from rths_cli.experiment.run_command import Watcher

LONGEST_CHUNK = 16  # runs that another process plays at a time, fewer where there are few
CHUNKS_PER_WORKER = 4  # at least, where there are runs enough


Choose = Callable[[Points, Table], NDArray[np.int64]]
"""Which runs to play next, () when all that is wanted is there."""


@dataclass(frozen=True)
class SweepRequest:
    """What `rths sweep` was asked; `output` None: sweeps/NAME.h5; `engine`: what plays runs; `part`: number and count
    of the parts where only one of them is played."""

    asked: Asked
    output: Path | None
    csv: Path | None
    engine: Engine
    replace: bool
    resume: bool
    command_line: str
    overrides: tuple[str, ...] = ()
    part: tuple[int, int] | None = None
    force: bool = False  # whether a finished sweep of another plan may be replaced
    planned: Planned | None = None  # the rows, where they are not those that `asked` states
    choose: Choose | None = None  # which rows are played next, in view of those that are there; None: all at once


@dataclass(frozen=True)
class Swept:
    """A finished sweep, its file, how many of its runs were played now, and its exit code."""

    sweep: Sweep
    path: Path
    played: int
    exit_code: int


def run_sweep(request: SweepRequest, watcher: Watcher) -> Swept:
    """Play what is not played yet and write the table; raises InputError with all faults before the first run."""
    check_engine(request.engine)
    keep_freed_memory()
    planned = request.planned or read_plan(request.asked)
    shared = Shared(request.overrides, watcher.doing, planned.metrics or (), planned.sim_alone)
    points = check_points(request.asked, shared, watcher.doing, planned)
    path = request.output or Path("sweeps") / f"{points.planned.name or points.base.case.name}{_suffix(request.part)}"
    variants = _variants(points, request.part)
    about = _attributes(points, request.command_line)
    if request.part is not None:
        about["part"] = "{}/{}".format(*request.part)
    with claimed(path) as ours:
        if not ours:
            raise InputError(f"{path}: is being written by another process; choose another --output, or wait for it")
        return _swept(path, about, points, shared, variants, request, watcher)


def _swept(
    path: Path, about: dict[str, str | int | float], points: Points, shared: Shared, variants: NDArray[np.int64],
    request: SweepRequest, watcher: Watcher,
) -> Swept:  # fmt: skip
    """Play what is not played yet and write the table to a file whose name is claimed."""
    tables: tuple[Path, ...] = ()
    if request.csv is not None:
        tables = check_existing([(request.csv, Kind.DOCUMENT)], request.replace, streams=True)
        check_csv(request.csv, path)
    begun = begin(path, about, len(variants), request.replace, request.resume, request.force)
    if request.csv is not None:
        check_writable(request.csv.parent)
    played, replaces = 0, False
    if begun is None:
        sweep = read_part(path)
    else:
        rows = Table(points.columns, points.storeys, variants)
        take_rows(begun, rows)
        played = rows.left
        _tell(points, begun, rows, len(variants), watcher)
        before = len(variants) - played
        sweep, written = _play(points, shared, begun, rows, variants, request, watcher)
        played = len(sweep.seed) - before
        if written != path:
            watcher.message(taken_sentence(path, written))
        replaces, path = begun.replaces is not None and written == path, written
    if request.csv is not None:
        write_csv(request.csv, sweep)
    if replaced := [*([path] if replaces else []), *tables]:
        watcher.message(replaced_sentence(replaced))
    if several := several_processors(sweep):
        watcher.message(several)
    return Swept(sweep, path, played, int(sweep.attributes["exit_code"]))


def _suffix(part: tuple[int, int] | None) -> str:
    return ".h5" if part is None else "-part{:0{width}}of{}.h5".format(*part, width=len(str(part[1])))


def _variants(points: Points, part: tuple[int, int] | None) -> NDArray[np.int64]:
    """Return the runs (n,) that are asked for, in ascending order: all, or those of a part, neighbours in the order in
    which runs are made."""
    count, seeds = points.plan.variants, len(points.plan.seeds)
    if part is None:
        return np.arange(count)
    number, parts = part
    if parts > count:
        raise InputError(f"--part {number}/{parts}: the sweep has {count} runs; ask for at most as many parts")
    made = np.arange((number - 1) * count // parts, number * count // parts)
    return np.sort(points.order[made // seeds] * seeds + made % seeds)


def _attributes(points: Points, command_line: str) -> dict[str, str | int | float]:
    """Return the root attributes of the file: where the sweep comes from, and what tells it from another one."""
    about = attributes(points.base, None, command_line)
    identity = {"plan_sha256": points.sha256, "software_sha256": software()}
    plan, planned = points.plan, points.planned
    origin = {
        "case_file": str(planned.case.path.absolute()),
        "study_file": str(planned.study.absolute()) if planned.study else "",
        "settings": json.dumps(points.asked.settings),
        "settings_folder": str(Path.cwd()),
        "values_folder": str(plan.folder or Path.cwd()),
    }
    origin |= planned.about
    return about | identity | origin | {"seeds": seeds_text(plan.seeds), "grid_points": plan.points}


def _play(
    points: Points, shared: Shared, begun: Begun, rows: Table, variants: NDArray[np.int64], request: SweepRequest,
    watcher: Watcher,
) -> tuple[Sweep, Path]:  # fmt: skip
    """Play the runs that are left, keep each row at once, and write the table when all are there; return it and its
    file."""
    count = len(variants)
    start, before = time.monotonic(), count - rows.left
    done = before
    with RowsFile(rows_path(begun.path), begun.attributes, begun.resumed) as file:
        try:
            with closing(_wanted_rows(points, shared, request, rows, watcher)) as found:
                for row in found:
                    file.append(as_line(row))
                    rows.add(row)
                    done += 1
                    watcher.doing(_progress(done, count, (time.monotonic() - start) / (done - before)))
        except BaseException:
            if kept := file.close():
                watcher.message(f"{kept} of {count} runs are kept; the same command with --resume goes on")
            else:
                file.remove()
                watcher.message(f"none of {count} runs had ended, nothing is kept; the same command begins anew")
            raise
        if request.choose is not None:
            points, begun, rows = _of_played(points, begun, rows)
        sweep = as_sweep(points, begun, rows, None if request.part is None else variants)
        written = write_sweep(begun.path, sweep, begun.replaces)
        file.remove()
    return sweep, written


def _of_played(points: Points, begun: Begun, rows: Table) -> tuple[Points, Begun, Table]:
    """Return the points that were played alone, with their table."""
    plan = points.plan
    numbers = np.arange(plan.points) if plan.kept is None else plan.kept
    plan = replace(plan, kept=numbers[np.unique(rows.played // len(plan.seeds))])
    begun = replace(begun, attributes=begun.attributes | {"grid_points": plan.points})
    return replace(points, plan=plan), begun, rows.of_played()


def _tell(points: Points, begun: Begun, rows: Table, count: int, watcher: Watcher) -> None:
    """Say what a user should know before the first run."""
    for doubt in points.doubts:
        watcher.warning(doubt)
    known = {column.path for column in columns()}
    left = [path for path in points.base.case.accept if path.partition("[")[0] not in known]
    if left:
        watcher.message(f"note: a sweep does not compute {', '.join(left)}: the accept limits on that are not judged")
    if begun.resumed:
        watcher.message(f"{count - rows.left} of {count} runs were played before")


def _progress(done: int, count: int, each_s: float) -> str:
    return f"{done} of {count} runs, about {each_s * (count - done):.0f} s left"


def _wanted_rows(
    points: Points, shared: Shared, request: SweepRequest, rows: Table, watcher: Watcher
) -> Generator[Row, None, None]:
    """Yield the rows that are left, or those that are chosen, round after round."""
    if request.choose is None:
        yield from _rows(points, shared, request, rows, watcher)
        return
    while (wanted := request.choose(points, rows)).size:
        rows.want(wanted)
        yield from _rows(points, shared, request, rows, watcher)


def _rows(
    points: Points, shared: Shared, request: SweepRequest, rows: Table, watcher: Watcher
) -> Generator[Row, None, None]:
    """Yield the rows that are left, in the order they are made, whatever the number of threads or workers."""
    if request.engine.name in ELSEWHERE:
        yield from _rows_elsewhere(points, shared, request, rows, watcher)
        return
    waiting: deque[Future[Row]] = deque()
    with executor_here(request.engine) as pool:
        try:
            for future in _handed_out(points, shared, rows, pool):
                waiting.append(future)
                if len(waiting) > AHEAD * request.engine.jobs:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _handed_out(points: Points, shared: Shared, rows: Table, pool: Executor) -> Iterator[Future[Row]]:
    """Make each grid point ready and hand its runs out; a point that cannot be made ready has rows that say so."""
    kept = points.columns
    for point, left in _left(points, rows):
        try:
            ready = shared.ready(points.case(point))
        except Exception as error:
            blank = not_ready(left[0][0], kept, points.storeys, error)
            yield from (pool.submit(replace, blank, variant=variant) for variant, _ in left)
            continue
        for variant, seed in left:
            yield pool.submit(play_variant, ready, variant, seed, kept, points.storeys)


def _left(points: Points, rows: Table) -> Iterator[tuple[int, tuple[tuple[int, int], ...]]]:
    """Yield each grid point with rows that are left, in the order to make them, with number and seed of each row."""
    seeds = points.plan.seeds
    for point in map(int, points.order):
        first = point * len(seeds)
        left = tuple((first + k, seed) for k, seed in enumerate(seeds) if rows.lacks(first + k))
        if left:
            yield point, left


def _rows_elsewhere(
    points: Points, shared: Shared, request: SweepRequest, rows: Table, watcher: Watcher
) -> Iterator[Row]:
    """Yield the rows that are left, played by other processes; the first model is identified here, for all of them."""
    first = next(_left(points, rows), None)
    if first is None:
        return
    with suppress(RthsError):  # the rows say so
        shared.identify(points.case(first[0]))
    work = _work(points, request.overrides)
    workers = workers_of(request.engine, work, watcher.message)
    size = min(LONGEST_CHUNK, max(1, rows.left // (CHUNKS_PER_WORKER * workers.count())))
    yield from play_all(workers, work, _chunks(points, rows, size), watcher.message)


def _work(points: Points, overrides: tuple[str, ...]) -> Work:
    """Return what other processes are told of a sweep."""
    written = points.planned.case
    return Work(
        points.sha256,
        written_case(written.text, written.path.absolute()),
        PlacedSettings(tuple(points.asked.settings), Path.cwd()),
        overrides,
        tuple(column.path for column in points.columns),
        points.storeys,
        software(),
        __version__,
        points.planned.sim_alone,
    )


def _chunks(points: Points, rows: Table, size: int) -> Iterator[Chunk]:
    """Yield the rows that are left, `size` at a time, neighbours in the order to make them."""
    folder = points.plan.folder or Path.cwd()
    held: list[PointRows] = []
    room = size
    for point, left in _left(points, rows):
        varied = PlacedSettings(points.plan.settings(point), folder)
        while left:
            held.append(PointRows(varied, left[:room]))
            left, room = left[room:], room - len(left[:room])
            if room == 0:
                yield tuple(held)
                held, room = [], size
    if held:
        yield tuple(held)
