"""What `rths sweep` does: check the grid, play every run as EXP-RTHS on the virtual rig side by side, write one
table."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rths_cli.experiment.allocator_settings import keep_freed_memory
from rths_cli.experiment.model_files import software
from rths_cli.experiment.provenance import attributes
from rths_cli.files.existing_files import Kind, check_existing, replaced_sentence
from rths_cli.files.result_writer import check_writable
from rths_cli.files.sweep_file import RowsFile, Sweep, check_csv, read_sweep, rows_path, write_csv, write_sweep
from rths_cli.studies.grid_points import Points, check_points
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep_output import Begun, as_line, as_sweep, begin
from rths_cli.studies.sweep_runs import Shared, failed, play_variant
from rths_cli.studies.sweep_table import Row, Table, columns, width
from rths_cli.studies.varied_keys import seeds_text

if TYPE_CHECKING:
    from rths_cli.experiment.run_command import Watcher

AHEAD = 4  # runs handed out per thread: enough to work on while the next grid point is made ready


@dataclass(frozen=True)
class SweepRequest:
    """What `rths sweep` was asked; `output` None: sweeps/NAME.h5; `jobs`: threads that play runs."""

    asked: Asked
    output: Path | None
    csv: Path | None
    jobs: int
    replace: bool
    resume: bool
    command_line: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Swept:
    """A finished sweep, its file, how many of its runs were played now, and its exit code."""

    sweep: Sweep
    path: Path
    played: int
    exit_code: int


def run_sweep(request: SweepRequest, watcher: Watcher) -> Swept:
    """Play what is not played yet and write the table; raises InputError with all faults before the first run."""
    keep_freed_memory()
    shared = Shared(request.overrides, watcher.doing)
    points = check_points(request.asked, shared, watcher.doing)
    path = request.output or Path("sweeps") / f"{points.planned.name or points.base.case.name}.h5"
    about = _attributes(points, request.command_line)
    tables: tuple[Path, ...] = ()
    if request.csv is not None:
        tables = check_existing([(request.csv, Kind.DOCUMENT)], request.replace)
        check_csv(request.csv, path)
    begun = begin(
        path, about, points.plan.variants, width(points.columns, points.storeys), request.replace, request.resume
    )
    if request.csv is not None:
        check_writable(request.csv.parent)
    played = 0 if begun is None else points.plan.variants - len(begun.rows)
    if begun is not None:
        _tell(points, begun, watcher)
    sweep = read_sweep(path) if begun is None else _play(points, shared, begun, request, watcher)
    if request.csv is not None:
        write_csv(request.csv, sweep)
    if replaced := [*([path] if begun is not None and begun.replaces else []), *tables]:
        watcher.message(replaced_sentence(replaced))
    return Swept(sweep, path, played, int(sweep.attributes["exit_code"]))


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
    return about | identity | origin | {"seeds": seeds_text(plan.seeds), "grid_points": plan.points}


def _play(points: Points, shared: Shared, begun: Begun, request: SweepRequest, watcher: Watcher) -> Sweep:
    """Play the runs that are left, keep each row at once, and write the table when all are there."""
    count = points.plan.variants
    rows = Table(points.columns, points.storeys, count)
    for row in begun.rows.values():
        rows.add(row)
    start, before = time.monotonic(), len(begun.rows)
    done = before
    with RowsFile(rows_path(begun.path), begun.attributes, begun.resumed) as file:
        try:
            for row in _rows(points, shared, request, rows.done):
                file.append(as_line(row))
                rows.add(row)
                done += 1
                watcher.doing(_progress(done, count, (time.monotonic() - start) / (done - before)))
        except BaseException:
            watcher.message(f"{file.close()} of {count} runs are kept; the same command with --resume goes on")
            raise
        sweep = as_sweep(points, begun, rows)
        write_sweep(begun.path, sweep)
        file.remove()
    return sweep


def _tell(points: Points, begun: Begun, watcher: Watcher) -> None:
    """Say what a user should know before the first run."""
    for doubt in points.doubts:
        watcher.warning(doubt)
    known = {column.path for column in columns()}
    left = [path for path in points.base.case.accept if path.partition("[")[0] not in known]
    if left:
        watcher.message(f"note: a sweep does not compute {', '.join(left)}: the accept limits on that are not judged")
    if begun.resumed:
        watcher.message(f"{len(begun.rows)} of {points.plan.variants} runs were played before")


def _progress(done: int, count: int, each_s: float) -> str:
    return f"{done} of {count} runs, about {each_s * (count - done):.0f} s left"


def _rows(points: Points, shared: Shared, request: SweepRequest, done: NDArray[np.bool_]) -> Iterator[Row]:
    """Yield the rows that are left, in the order they are made, whatever the number of threads."""
    waiting: deque[Future[Row]] = deque()
    with ThreadPoolExecutor(request.jobs) as pool:
        try:
            for future in _handed_out(points, shared, request, done, pool):
                waiting.append(future)
                if len(waiting) > AHEAD * request.jobs:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _handed_out(
    points: Points, shared: Shared, request: SweepRequest, done: NDArray[np.bool_], pool: ThreadPoolExecutor
) -> Iterator[Future[Row]]:
    """Make each grid point ready and hand its runs out; a point that cannot be made ready has rows that say so."""
    kept, seeds = points.columns, points.plan.seeds
    for point in map(int, points.order):
        left = [k for k in range(len(seeds)) if not done[point * len(seeds) + k]]
        if not left:
            continue
        try:
            ready = shared.ready(points.case(point))
        except Exception as error:
            blank = failed(Row(0, "", "", 0, "", "", np.full(width(kept, points.storeys), np.nan)), error)
            yield from (pool.submit(replace, blank, variant=point * len(seeds) + k) for k in left)
            continue
        for k in left:
            yield pool.submit(play_variant, ready, point * len(seeds) + k, seeds[k], kept, points.storeys)
