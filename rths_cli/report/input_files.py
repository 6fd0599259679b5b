"""Read the result and sweep files of a report; a sentence for each that cannot be used, or not together with the
others."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result, read_checked, result_files
from rths_cli.files.sweep_file import Sweep, read_sweep
from rths_cli.quantities import metric

MANY = 64  # number of files from which several processes read them
AT_ONCE = 4  # largest number of processes
CHUNK = 8  # files that a process takes at a time
Tell = Callable[[str], None]

APART = ("name", "seed", "method", "runs", "accept", "notes", "reference")  # keys that do not distinguish cases
SEED = re.compile(r"^  seed: .*\n", re.MULTILINE)
KEY = re.compile(r"^(?=[^\s-])", re.MULTILINE)
Key = Callable[[Result], tuple[str, ...]]


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


def other_units(results: Sequence[Result]) -> list[Unread]:
    """Return a sentence for each result with metrics in another unit than declared or than in other results."""
    first: dict[str, tuple[str, Result]] = {}
    found: list[Unread] = []
    for result in results:
        odd = []
        for path, unit in result.units.items():
            known = metric(path)
            if path not in first and (known is None or known.units == unit):
                first[path] = unit, result
            expected = known.units if known else first[path][0]
            if unit != expected:
                odd.append(f"{path} is in {unit}, not {expected}")
        if odd:
            more = f", and {len(odd) - 1} more figures in other units" if len(odd) > 1 else ""
            found.append(Unread(result.path, f"{result.path}: {odd[0]}{more}; convert them, or report it apart."))
    return found


def doubled(results: Sequence[Result], group: Key) -> list[Unread]:
    """Return a sentence for each result that is a copy of another one, or a different case of the same name.

    Cases of the same name may differ if `group` returns different values, or if method, rig or software differ.
    """
    seen: dict[tuple[str, ...], list[Result]] = {}
    found: list[Unread] = []
    for result in results:
        same = seen.setdefault((*_place(result), *group(result)), [])
        found += list(_clash(result, same))[:1]
        same.append(result)
    return found


def _clash(result: Result, others: Sequence[Result]) -> Iterator[Unread]:
    path, name = result.path, result.attributes.get("case_name")
    moment = _moment(result)
    for other in others:
        if moment == _moment(other) and _same_figures(result, other):
            yield Unread(path, f"{path}: is the same run as {other.path}; leave one of them out.")
            return
    keys = differing(result, others[0]) if others else []
    if keys:
        yield Unread(
            path,
            f"{path}: case {name} is another one than in {others[0].path} (they differ in {', '.join(keys)}); "
            "give one another name, or tell them apart with --group-by.",
        )


def _place(result: Result) -> tuple[str, ...]:
    keys = ("case_name", "method", "rig", "rig_kind", "rths_version", "git_commit")
    return tuple(str(result.attributes.get(key, "")) for key in keys)


def _moment(result: Result) -> tuple[object, ...]:
    return tuple(result.attributes.get(key) for key in ("created_utc", "seed", "status"))


def _same_figures(one: Result, other: Result) -> bool:
    return one.metrics.keys() == other.metrics.keys() and all(
        np.array_equal(value, other.metrics[path], equal_nan=True) for path, value in one.metrics.items()
    )


def differing(one: Result, other: Result) -> list[str]:
    """Return the keys in which the cases of two results differ; empty if a case is not stored."""
    if not one.resolved_yaml or not other.resolved_yaml or one.resolved_yaml == other.resolved_yaml:
        return []
    mine, theirs = _keys(one.resolved_yaml), _keys(other.resolved_yaml)
    return sorted(key for key in mine.keys() | theirs.keys() if mine.get(key) != theirs.get(key))


def _keys(text: str) -> dict[str, str]:
    """Return the text of each key of a resolved case, without the keys that do not distinguish cases."""
    parts = [part for part in KEY.split(text) if part.strip()]
    keys = {part.partition(":")[0]: SEED.sub("", part) for part in parts}
    return {key: part for key, part in keys.items() if key not in APART}
