"""Read the result and sweep files of a report, with a sentence for each file that cannot be used."""

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

MANY = 64  # number of files from which several processes read them
AT_ONCE = 4  # largest number of processes
CHUNK = 8  # files that a process takes at a time
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Unread:
    """A file that is not used or clashes with another one, or a folder without files."""

    path: Path
    sentence: str  # why


@dataclass(frozen=True)
class Inputs:
    """The input of a report, in the order in which it was named."""

    results: tuple[Result, ...]
    sweeps: tuple[tuple[Path, Sweep], ...]  # each with its file
    unread: tuple[Unread, ...]  # files and folders that could not be read


def read_inputs(paths: Sequence[Path], tell: Tell) -> Inputs:
    """Read result files, sweeps and folders of them, with units and definitions but without time histories.

    A file that is named twice is read once. `tell` receives the progress.
    """
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
    """Yield the content of each file, or a sentence if it cannot be used; several processes read many files."""
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
        return _as_sweep(file) if "holds a sweep" in str(error) else _sentence(error)


def _as_sweep(file: Path) -> Sweep | str:
    """Return the sweep in a file, or a sentence if it cannot be read."""
    try:
        return read_sweep(file)
    except InputError as error:
        return _sentence(error)


def _sentence(error: InputError) -> str:
    """Return the faults of a file, each closed: they stand in running text."""
    return " ".join(f"{fault.removesuffix('.')}." for fault in error.faults)


def _shared(result: Result) -> Result:
    """Return a result whose paths, units and definitions share memory with equal texts of other results."""
    units = {sys.intern(path): sys.intern(unit) for path, unit in result.units.items()}
    definitions = {sys.intern(path): sys.intern(about) for path, about in result.definitions.items()}
    return replace(result, units=units, definitions=definitions)
