"""Read the result and sweep files that a report is made of; a sentence for each file that cannot be used."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result, read_checked, result_files
from rths_cli.files.sweep_file import Sweep, read_sweep

MANY = 64  # files from which several processes read
AT_ONCE = 4  # processes at most
CHUNK = 8  # files a process is handed at a time
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Unread:
    """A file, or a folder without one, that is in no table, and the sentence why."""

    path: Path
    sentence: str


@dataclass(frozen=True)
class Inputs:
    """All that was named: results and sweeps in the order given, and what could not be read."""

    results: tuple[Result, ...]
    sweeps: tuple[tuple[Path, Sweep], ...]
    unread: tuple[Unread, ...]


def read_inputs(paths: Sequence[Path], tell: Tell) -> Inputs:
    """Read result files, sweeps and folders of them with units and definitions, but no time history; a file named twice
    is read once. `tell` hears how it goes."""
    files, empty = result_files(paths)
    unread = [Unread(path, sentence) for path, sentence in empty.items()]
    read: list[Result | Sweep | str] = []
    for number, found in enumerate(_reading(files), 1):
        tell(f"reading results: {number} of {len(files)}")
        read.append(found)
    pairs = list(zip(files, read, strict=True))
    unread += [Unread(file, found) for file, found in pairs if isinstance(found, str)]
    sweeps = tuple((file, found) for file, found in pairs if isinstance(found, Sweep))
    return Inputs(tuple(found for found in read if isinstance(found, Result)), sweeps, tuple(unread))


def _reading(files: Sequence[Path]) -> Iterator[Result | Sweep | str]:
    """Yield what stands in each file, or the sentence why nothing does; many files by several processes."""
    workers = min(AT_ONCE, os.cpu_count() or 1)
    if len(files) < MANY or workers < 2:
        yield from map(_read, files)
        return
    with ProcessPoolExecutor(workers) as pool:
        try:
            for found in pool.map(_read, files, chunksize=CHUNK):
                yield _shared(found) if isinstance(found, Result) else found
        finally:
            pool.shutdown(cancel_futures=True)


def _read(file: Path) -> Result | Sweep | str:
    try:
        return read_checked(file, whole=True)
    except InputError as error:
        return _as_sweep(file) if "holds a sweep" in str(error) else " ".join(error.faults)


def _as_sweep(file: Path) -> Sweep | str:
    """Return the sweep in a file, or why there is none."""
    try:
        return read_sweep(file)
    except InputError as error:
        return " ".join(error.faults)


def _shared(result: Result) -> Result:
    """Return a result whose texts stand in memory once for all results that have them."""
    units = {sys.intern(path): sys.intern(unit) for path, unit in result.units.items()}
    definitions = {sys.intern(path): sys.intern(about) for path, about in result.definitions.items()}
    return replace(result, units=units, definitions=definitions)
