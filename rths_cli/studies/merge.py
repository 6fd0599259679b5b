"""Join the parts of a sweep (`rths sweep --part K/N`) to the table that the sweep in one go writes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.experiment.run_case import worst_code
from rths_cli.files.durable_files import Stamp, stamp
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import Attribute, check_writable
from rths_cli.files.sweep_file import PART, Head, Sweep, read_columns, read_head, write_sweep
from rths_cli.quantities.sweep_datasets import TEXTS
from rths_cli.studies.sweep_output import check_same_plan, told

SAME = {
    "plan_sha256": "a sweep of another case, grid or options",
    "software_sha256": "a sweep by another version of rths, Python, numpy, scipy or numba",
}
SHOWN = 5  # ranges of rows in a sentence


def merge_parts(
    paths: Sequence[Path], output: Path, replaces: bool, command_line: str, force: bool = False
) -> tuple[Sweep, Path, bool]:
    """Write the sweep of all parts, and return it, its file, and whether it took the place of one.

    With `force`, that may be the sweep of another plan. The file gets another name than `output` where another process
    has taken that meanwhile.

    Raises InputError, and writes nothing, where a file is no part, parts are of different sweeps or software, a row is
    in two of them, or one is in none, or a part is written anew meanwhile.
    """
    if any(output.resolve() == path.resolve() for path in paths):
        raise InputError(f"--output {output}: is one of the parts; give it a name of its own")
    seen = {path: stamp(path.resolve()) for path in paths}
    parts = {path: read_head(path) for path in paths}
    faults = list(_faults(parts))
    if faults:
        raise InputError(*faults)
    replaced, there = check_existing([(output, Kind.SWEEP)], replaces), stamp(output)
    first, *_ = parts.values()
    if replaced and output.stat().st_size and not force:
        check_same_plan(output, {"plan_sha256": first.attributes["plan_sha256"]})
    check_writable(output.parent, sum(one[2] for one in seen.values() if one is not None))
    sweep = _joined(parts, seen, command_line)
    written = write_sweep(output, sweep, there)
    return sweep, written, bool(replaced) and written == output


def _faults(parts: dict[Path, Head]) -> Iterator[str]:
    """Yield why the parts cannot be joined."""
    (first, sweep), *_ = parts.items()
    alike = {first: sweep} if sweep.numbers is not None else {}
    for path, part in parts.items():
        other = [why for name, why in SAME.items() if part.attributes[name] != sweep.attributes[name]]
        if part.numbers is None:
            yield f"{path}: is a whole sweep and no part of one; name the files that rths sweep --part wrote"
        elif other:
            yield f"{path}: is a part of {other[0]} than {first}"
        elif (part.varied, _shapes(part)) != (sweep.varied, _shapes(sweep)):
            yield f"{path}: has other columns than {first}; run this part again"
        else:
            alike[path] = part
    if len(alike) < len(parts):
        return
    runs = int(sweep.attributes["grid_points"]) * sweep.seeds_per_point
    numbers = {path: np.asarray(part.numbers) for path, part in parts.items()}
    owner: NDArray[Any] = np.full(runs + 1, -1)
    names = list(parts)
    for place, (path, own) in enumerate(numbers.items()):
        if own[-1] > runs:
            yield f"{path}: has row {own[-1]} of a sweep of {runs} rows; run this part again"
            return
        twice = own[owner[own] >= 0]
        if len(twice):
            others = ", ".join(str(names[k]) for k in np.unique(owner[twice]))
            yield f"{path}: has rows {_ranges(twice)}, which {others} has too; name each part once"
        owner[own] = place
    missing = np.flatnonzero(owner[1:] < 0) + 1
    if len(missing):
        yield f"{len(missing)} of {runs} rows are in no part: {_ranges(missing)}{_absent(parts)}"


def _absent(parts: dict[Path, Head]) -> str:
    """Return which parts are not there, as the end of a sentence, where all are parts of one division."""
    told_parts = [str(part.attributes[PART]).split("/") for part in parts.values()]
    counts = {each[-1] for each in told_parts}
    if len(counts) != 1 or not all(len(each) == 2 and all(map(str.isdecimal, each)) for each in told_parts):
        return "; play the parts that hold them"
    count = counts.pop()
    absent = sorted(set(range(1, int(count) + 1)) - {int(number) for number, _ in told_parts})
    return f"; play part{'s' * (len(absent) > 1)} {_ranges(np.array(absent))} of {count}" if absent else ""


def _ranges(numbers: NDArray[np.int64]) -> str:
    """Return ascending numbers as text, neighbours as a range."""
    ends = np.flatnonzero(np.diff(numbers) > 1)
    starts = [0, *(int(end) + 1 for end in ends)]
    lasts = [*map(int, ends), len(numbers) - 1]
    spans = [(int(numbers[start]), int(numbers[last])) for start, last in zip(starts, lasts, strict=True)]
    shown = ", ".join(str(low) if low == high else f"{low} to {high}" for low, high in spans[:SHOWN])
    return f"{shown} and more" if len(spans) > SHOWN else shown


def _shapes(part: Head) -> dict[str, tuple[int, ...]]:
    return {path: figure.shape for path, figure in part.figures.items()}


@contextmanager
def _as_seen(path: Path, seen: Stamp) -> Iterator[None]:
    """Raise InputError, whatever else the body raises, where the file is not the one that was seen."""
    told = f"{path}: was written anew or removed while it was read; join the parts again"
    try:
        yield
    except (InputError, OSError, ValueError, KeyError) as error:
        if stamp(path.resolve()) != seen:
            raise InputError(told) from error
        raise
    if stamp(path.resolve()) != seen:
        raise InputError(told)


def _joined(parts: dict[Path, Head], seen: dict[Path, Stamp], command_line: str) -> Sweep:
    """Return the sweep of parts that hold every row once. One column of one part is in memory beside it."""
    first, *_ = parts.values()
    runs = int(first.attributes["grid_points"]) * first.seeds_per_point
    whole = {path: np.empty((runs, *figure.shape)) for path, figure in first.figures.items()}
    whole |= {key: np.empty(runs, float if numbers else object) for key, numbers in first.varied.items()}
    whole |= {name: np.empty(runs, object) for name in TEXTS} | {"seed": np.empty(runs, np.int64)}
    for path, part in parts.items():
        place = np.asarray(part.numbers) - 1

        def keep(name: str, values: NDArray[Any], place: NDArray[np.int64] = place) -> None:
            whole[name][place] = values

        with _as_seen(path, seen[path]):
            read_columns(path, keep)
    ends: dict[str, Attribute] = {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "command_line": command_line,
        "status_reason": told(Counter(whole["status"])),
        "exit_code": worst_code(int(part.attributes["exit_code"]) for part in parts.values()),
    }
    attributes = {name: value for name, value in first.attributes.items() if name != PART} | ends
    return replace(first, attributes=attributes, numbers=None).sweep(whole)
