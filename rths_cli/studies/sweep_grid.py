"""The grid of a sweep: parse `--vary` and `--seeds` (axes), number its combinations and seeds. Pure data, read from
text."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rths_cli.case.case_schema import SEED_MAX
from rths_cli.case.yaml_reader import dump, parse
from rths_cli.case.yaml_tree import Source, plain, printable
from rths_cli.errors import InputError
from rths_cli.safe_text import shortened

MOST_VARIANTS = 1_000_000
MOST_DIGITS = 40
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
RANGE = re.compile(rf"({NUMBER}):({NUMBER}):([-+]?\d+)")
WHOLE = re.compile(r"[-+]?\d+")
SEEDS = re.compile(r"(\d{1,18})(?::(\d{1,18}))?")
NOT_VARIED = {
    "seed": "is no key to vary; give --seeds",
    "name": "changes no figure; vary what does",
    "notes": "changes no figure; vary what does",
    "accept": "changes no figure; give one limit with --set",
    "grade_limits": "changes no figure; vary what does",
    "reference": "changes no figure; vary what does",
    "report_in": "changes no figure; vary what does",
    "scale.stress": "changes no figure, for a sweep has them in model scale; vary scale.length",
    "scale.mass": "changes no figure, for a sweep has them in model scale; vary scale.length",
    "runs": "changes nothing, a sweep runs EXP-RTHS alone; vary what does",
}


@dataclass(frozen=True)
class Axis:
    """One varied key of a case and its values: numbers, texts, truths, lists or mappings."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Grid:
    """A sweep's variants: the last axis varies fastest among the points, the seeds within a point."""

    axes: tuple[Axis, ...]
    seeds: range

    @property
    def points(self) -> int:
        """Return the number of combinations of the varied values."""
        return math.prod(len(axis.values) for axis in self.axes)

    @property
    def variants(self) -> int:
        """Return the number of runs."""
        return self.points * len(self.seeds)

    def values(self, point: int) -> tuple[Any, ...]:
        """Return the varied values of a grid point, in the order of the axes."""
        found = []
        for axis in reversed(self.axes):
            point, place = divmod(point, len(axis.values))
            found.append(axis.values[place])
        return tuple(reversed(found))

    def settings(self, point: int) -> tuple[str, ...]:
        """Return a grid point as settings KEY=VALUE of a case."""
        values = zip(self.axes, self.values(point), strict=True)
        return tuple(f"{axis.key}={dump(value)}" for axis, value in values)

    def label(self, point: int) -> str:
        """Return a grid point as a reader would name it."""
        values = zip(self.axes, self.values(point), strict=True)
        return ", ".join(f"{axis.key}={as_text(value)}" for axis, value in values) or "the case as it is"


def as_text(value: Any) -> str:
    """Return a varied value as it would be typed."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.10g}"
    return json.dumps(value).replace('"', "")


def read_grid(vary: Sequence[str], seeds: str | None, own_seed: int) -> Grid:
    """Return the grid of `--vary KEY=VALUES` texts and a `--seeds` text (None: the case's own seed).

    Raises InputError with every fault.
    """
    faults: list[str] = []
    axes = [axis for axis in (_axis(text, faults) for text in vary) if axis is not None]
    keys = [axis.key for axis in axes]
    faults += [f"--vary {key}: is given twice; give all its values once" for key in _repeated(keys)]
    faults += [f"--vary {key}: holds {above}, which is varied too; vary one of them" for above, key in _nested(keys)]
    drawn = range(own_seed, own_seed + 1) if seeds is None else _seeds(seeds, faults)
    grid = Grid(tuple(axes), drawn)
    if grid.variants > MOST_VARIANTS:
        faults.append(f"the grid has {grid.variants} runs, at most {MOST_VARIANTS} are allowed; vary less")
    if faults:
        raise InputError(*faults)
    return grid


def _seeds(text: str, faults: list[str]) -> range:
    """Return the seeds 0 to N - 1 of `N`, or A to B, both included, of `A:B`."""
    found = SEEDS.fullmatch(text.strip())
    if found is None:
        faults.append(f"--seeds {printable(text)[:40]}: must be a number of seeds N, or a range A:B of seeds >= 0")
        return range(1)
    first, last = (0, int(found[1]) - 1) if found[2] is None else (int(found[1]), int(found[2]))
    if found[2] is None and last < 0:
        faults.append("--seeds 0: gives no run; give at least 1")
    elif last < first:
        faults.append(f"--seeds {text.strip()}: runs backwards; give the smaller seed first")
    elif last > SEED_MAX:
        faults.append(f"--seeds {text.strip()}: must be <= {SEED_MAX}, the largest seed")
    return range(first, last + 1) if first <= last <= SEED_MAX else range(1)


def _axis(text: str, faults: list[str]) -> Axis | None:
    """Return the key and values of one `KEY=V1,V2,...` or `KEY=LOW:HIGH:COUNT`; None with a fault."""
    key, sign, listed = (part.strip() for part in text.partition("="))
    label = f"--vary {printable(key)[:80]}"
    fault = _key_fault(key, bool(sign))
    values: tuple[Any, ...] = ()
    if not fault and re.fullmatch(rf"{NUMBER}:{NUMBER}", listed):
        fault = f"a range is LOW:HIGH:COUNT, for example {listed}:5"
    if not fault:
        span = RANGE.fullmatch(listed)
        values, fault = _spaced(span) if span else _listed(listed, label)
    if fault:
        faults.append(f"{label}: {fault}")
        return None
    return Axis(key, values)


def _key_fault(key: str, has_values: bool) -> str:
    """Return what is wrong with a key to vary, empty when nothing is."""
    if not has_values or not all(key.split(".")):
        return "must be KEY=VALUE,VALUE,... or KEY=LOW:HIGH:COUNT, for example --vary scaling=0.2,0.3"
    return NOT_VARIED.get(key) or NOT_VARIED.get(key.partition(".")[0], "")


def _spaced(span: re.Match[str]) -> tuple[tuple[Any, ...], str]:
    """Return COUNT values from LOW to HIGH, both included, or what is wrong; whole steps between whole ends stay so."""
    if max(map(len, span.groups())) > MOST_DIGITS:
        return (), f"LOW, HIGH and COUNT may have {MOST_DIGITS} characters each, got {shortened(span[0], 60)}"
    low, high, count = float(span[1]), float(span[2]), int(span[3])
    if not (math.isfinite(low) and math.isfinite(high)):
        return (), f"LOW and HIGH must be finite numbers, got {span[0]}"
    if not 2 <= count <= MOST_VARIANTS or low == high:
        return (), f"LOW:HIGH:COUNT needs two different ends and a count from 2 to {MOST_VARIANTS}, got {span[0]}"
    values = [low + (high - low) * k / (count - 1) for k in range(count - 1)] + [high]
    if WHOLE.fullmatch(span[1]) and WHOLE.fullmatch(span[2]) and (int(span[2]) - int(span[1])) % (count - 1) == 0:
        return tuple(round(value) for value in values), ""
    return tuple(values), ""


def _listed(text: str, label: str) -> tuple[tuple[Any, ...], str]:
    """Return the values of a list V1,V2,... in YAML, or what is wrong with it."""
    node, found = parse(f"[{text}]", Source(label, Path.cwd()))
    if found or node is None or not isinstance(node.value, tuple):
        return (), found[0].message if found else "must be values with commas between them"
    values = tuple(plain(item) for item in node.value)
    if not values or any(item.value is None for item in node.value):
        return (), "a value is missing; give VALUE,VALUE,..., a mapping in braces, a list in brackets"
    twice = _repeated([json.dumps(value) for value in values])
    return values, f"gives {twice[0]} twice; give each value once" if twice else ""


def _repeated(names: Sequence[str]) -> list[str]:
    return [name for name, times in Counter(names).items() if times > 1]


def _nested(keys: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pairs of a varied key and another one below it."""
    return [(below, key) for key in keys for below in keys if below.startswith(f"{key}.")]


def seeds_text(seeds: range) -> str:
    """Return the seeds as `--seeds` takes them."""
    return f"{seeds[0]}:{seeds[-1]}"
