"""Join the parts of a sweep (`rths sweep --part K/N`) to the table that the sweep in one go writes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.experiment.run_case import worst_code
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import Attribute, check_writable
from rths_cli.files.sweep_file import PART, Sweep, read_part, values_of_axis, write_sweep
from rths_cli.studies.sweep_output import told

SAME = {
    "plan_sha256": "a sweep of another case, grid or options",
    "software_sha256": "a sweep by another version of rths, Python, numpy, scipy or numba",
}
SHOWN = 5  # ranges of rows in a sentence


def merge_parts(paths: Sequence[Path], output: Path, replaces: bool, command_line: str) -> tuple[Sweep, bool]:
    """Write the sweep of all parts, and return it and whether it took the place of a file.

    Raises InputError, and writes nothing, where a file is no part, parts are of different sweeps or software, a row is
    in two of them, or one is in none.
    """
    if any(output.resolve() == path.resolve() for path in paths):
        raise InputError(f"--output {output}: is one of the parts; give it a name of its own")
    parts = {path: _head(read_part(path)) for path in paths}
    faults = list(_faults(parts))
    if faults:
        raise InputError(*faults)
    replaced = check_existing([(output, Kind.SWEEP)], replaces)
    check_writable(output.parent, sum(path.stat().st_size for path in parts))
    sweep = _joined(list(parts), command_line)
    write_sweep(output, sweep)
    return sweep, bool(replaced)


@dataclass(frozen=True)
class _Head:
    """What tells whether a part fits the others: `numbers` (n,) of its runs, None of a whole sweep."""

    attributes: dict[str, Attribute]
    seeds_per_point: int
    numbers: NDArray[np.int64] | None
    columns: tuple[tuple[str, str], ...]


def _head(sweep: Sweep) -> _Head:
    varied = {key: "number" if _is_number(values) else "text" for key, values in sweep.varied.items()}
    figures = {path: str(figure.values.shape[1:]) for path, figure in sweep.figures.items()}
    return _Head(sweep.attributes, sweep.seeds_per_point, sweep.numbers, (*varied.items(), *figures.items()))


def _is_number(values: tuple[Any, ...] | NDArray[Any]) -> bool:
    return isinstance(values[0], float)


def _faults(parts: dict[Path, _Head]) -> Iterator[str]:
    """Yield why the parts cannot be joined."""
    (first, sweep), *_ = parts.items()
    alike = {first: sweep} if sweep.numbers is not None else {}
    for path, part in parts.items():
        other = [why for name, why in SAME.items() if part.attributes[name] != sweep.attributes[name]]
        if part.numbers is None:
            yield f"{path}: is a whole sweep and no part of one; name the files that rths sweep --part wrote"
        elif other:
            yield f"{path}: is a part of {other[0]} than {first}"
        elif part.columns != sweep.columns:
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


def _absent(parts: dict[Path, _Head]) -> str:
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


def _joined(paths: Sequence[Path], command_line: str) -> Sweep:
    """Return the sweep of parts that hold every row once. One part at a time is in memory beside it."""
    first = read_part(paths[0])
    runs = int(first.attributes["grid_points"]) * first.seeds_per_point
    varied = {key: np.empty(runs, float if _is_number(values) else object) for key, values in first.varied.items()}
    seed, texts = np.empty(runs, np.int64), {name: np.empty(runs, object) for name in first.texts}
    figures = {
        path: replace(figure, values=np.empty((runs, *figure.values.shape[1:])))
        for path, figure in first.figures.items()
    }
    first = replace(first, varied={}, texts={}, figures={})
    codes: list[int] = []
    for path in paths:
        part = read_part(path)
        place = np.asarray(part.numbers) - 1
        seed[place] = part.seed
        for key in varied:  # a column leaves the memory when it stands in the whole
            varied[key][place] = part.varied.pop(key)
        for name in texts:
            texts[name][place] = part.texts.pop(name)
        for name in figures:
            figures[name].values[place] = part.figures.pop(name).values
        codes.append(int(part.attributes["exit_code"]))
        del part
    ends: dict[str, Attribute] = {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "command_line": command_line,
        "status_reason": told(Counter(texts["status"])),
        "exit_code": worst_code(codes),
    }
    return replace(
        first,
        attributes={name: value for name, value in first.attributes.items() if name != PART} | ends,
        varied={key: values_of_axis(varied.pop(key)) for key in list(varied)},
        seed=seed,
        texts={name: tuple(texts.pop(name)) for name in list(texts)},
        figures=figures,
        numbers=None,
    )
