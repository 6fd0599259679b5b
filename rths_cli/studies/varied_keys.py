"""The axes and seeds that `--vary` and `--seeds` state, and which keys may be varied."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rths_cli.case.case_schema import SEED_MAX
from rths_cli.case.study_schema import MOST_RUNS
from rths_cli.case.yaml_reader import parse
from rths_cli.case.yaml_tree import Source, plain, printable
from rths_cli.safe_text import LONGEST_NAME, shortened
from rths_cli.studies.plan import Axis

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
RANGE = re.compile(rf"({NUMBER}):({NUMBER}):([-+]?\d+)")
WHOLE = re.compile(r"[-+]?\d+")
SEEDS = re.compile(r"(\d{1,18})(?::(\d{1,18}))?")
NOT_VARIED = {
    "seed": "is no key to vary; give --seeds, or seeds in a study",
    "name": "changes no figure; vary another key (rths schema case lists them)",
    "notes": "changes no figure; vary another key (rths schema case lists them)",
    "accept": "changes no figure; give one limit with --set",
    "grade_limits": "changes no figure; vary another key (rths schema case lists them)",
    "reference": "changes no figure; vary another key (rths schema case lists them)",
    "report_in": "changes no figure; vary another key (rths schema case lists them)",
    "scale.stress": "changes no figure, for a sweep has them in model scale; vary scale.length",
    "scale.mass": "changes no figure, for a sweep has them in model scale; vary scale.length",
    "runs": "changes nothing, a sweep runs EXP-RTHS alone; vary another key (rths schema case lists them)",
}


def read_axes(vary: Sequence[str], faults: list[str]) -> tuple[Axis, ...]:
    """Return the axes of `--vary KEY=VALUES` texts; what is wrong with the others is added to `faults`."""
    return tuple(axis for axis in (_axis(text, faults) for text in vary) if axis is not None)


def read_seeds(text: str, faults: list[str]) -> range:
    """Return the seeds 0 to N - 1 of `N`, or A to B, both included, of `A:B`; a fault is added to `faults`."""
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
        values, fault = _range(span) if span else _listed(listed, label)
    if fault:
        faults.append(f"{label}: {fault}")
        return None
    return Axis(key, values)


def _key_fault(key: str, has_values: bool) -> str:
    """Return what is wrong with a key to vary, empty when nothing is."""
    if not has_values or not all(key.split(".")):
        return "must be KEY=VALUE,VALUE,... or KEY=LOW:HIGH:COUNT, for example --vary scaling=0.2,0.3"
    return unvaried(key)


def unvaried(key: str) -> str:
    """Return why a key of a case is not varied, empty when it may be."""
    return NOT_VARIED.get(key) or NOT_VARIED.get(key.partition(".")[0], "")


def _range(span: re.Match[str]) -> tuple[tuple[Any, ...], str]:
    """Return COUNT values from LOW to HIGH, both included, or what is wrong; whole steps between whole ends stay so."""
    if max(map(len, span.groups())) > LONGEST_NAME:
        return (), f"LOW, HIGH and COUNT may have {LONGEST_NAME} characters each, got {shortened(span[0], 60)}"
    low, high, count = float(span[1]), float(span[2]), int(span[3])
    if not (math.isfinite(low) and math.isfinite(high)):
        return (), f"LOW and HIGH must be finite numbers, got {span[0]}"
    if not 2 <= count <= MOST_RUNS or low == high:
        return (), f"LOW:HIGH:COUNT needs two different ends and a count from 2 to {MOST_RUNS}, got {span[0]}"
    return spaced(low, high, count, bool(WHOLE.fullmatch(span[1]) and WHOLE.fullmatch(span[2]))), ""


def spaced(low: float, high: float, count: int, whole: bool) -> tuple[float, ...]:
    """Return `count` values an even step apart, both ends included; whole numbers for `whole` ends a whole step
    apart."""
    values = [low + (high - low) * k / (count - 1) for k in range(count - 1)] + [high]
    if whole and (int(high) - int(low)) % (count - 1) == 0:
        return tuple(round(value) for value in values)
    return tuple(values)


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


def seeds_text(seeds: range) -> str:
    """Return the seeds as `--seeds` takes them."""
    return f"{seeds[0]}:{seeds[-1]}"
