"""From a case with `--vary` and `--seeds`, or a study file, to the varied case and the plan of its rows: axes,
samples.

Latin hypercubes and Sobol sequences are scipy's (`scipy.stats.qmc`), the rows for Sobol indices are SALib's; all depend
on the seed alone. A Gaussian copula (Nelsen, An Introduction to Copulas, 2006, section 2.3) puts correlations in: the
samples become normal variables, are mixed by the Cholesky factor of their correlations, and become samples of the unit
cube again. Their distributions stay what they are.
"""

from __future__ import annotations

import csv
import json
import math
import operator
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.case_schema import SEED_MAX
from rths_cli.case.load import WrittenCase, load_study, read_case, study_file, written_case
from rths_cli.case.study_schema import (
    MOST_RUNS,
    ConstraintSpec,
    EmpiricalAxis,
    FolderAxis,
    ListAxis,
    LognormalAxis,
    Method,
    NormalAxis,
    RangeAxis,
    SamplesSpec,
    Strict,
    StudyKeys,
    TruncatedNormalAxis,
    UniformAxis,
    is_sampled,
)
from rths_cli.case.yaml_reader import Source, dump, parse, plain, printable
from rths_cli.errors import InputError
from rths_cli.safe_text import LONGEST_NAME, shortened
from rths_cli.studies.plan import Axis, Block, Plan, checked_plan
from rths_cli.studies.record_sets import KEYS, is_set, records_of
from rths_cli.studies.sensitivity import index_samples

if TYPE_CHECKING:
    from rths_cli.numerics.lti import Array

INSIDE = 1 - 1e-10  # of the unit interval, about its middle: a quantile at its ends would be infinite

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
COMPARED = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
MOST_CSV_BYTES = 1 << 28


def unit_samples(method: Method, count: int, axes: int, seed: int) -> Array:
    """Return samples (n, axes) in (0, 1); n is `count`, for `sobol_indices` count (axes + 2).

    `count` is a power of 2 for both Sobol methods. Raises InputError where a package for the method is missing.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "latin_hypercube":
        found = qmc.LatinHypercube(axes, seed=rng).random(count)
    elif method == "sobol":
        found = qmc.Sobol(axes, seed=rng).random_base2(count.bit_length() - 1)
    else:
        found = index_samples(count, axes, rng)
    return np.asarray(0.5 + INSIDE * (found - 0.5))


def normal_correlation(rank: float) -> float:
    """Return the correlation of two normal variables with a rank correlation (Spearman's) of `rank`."""
    return 2.0 * math.sin(math.pi * rank / 6.0)


def correlated(samples: Array, pairs: Mapping[tuple[int, int], float]) -> Array:
    """Return samples (n, axes) of the unit cube with the normal correlations of pairs of axes, the others zero.

    Raises InputError where no variables have these correlations: their matrix is not positive definite.
    """
    from scipy.special import ndtr, ndtri

    matrix = np.eye(samples.shape[1])
    for (first, second), value in pairs.items():
        matrix[first, second] = matrix[second, first] = value
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        least = float(np.linalg.eigvalsh(matrix)[0])
        raise InputError(
            "correlations: no variables are correlated like this: the smallest eigenvalue of the matrix is "
            f"{least:.3g} and must be > 0; weaken a correlation"
        ) from None
    mixed = ndtr(ndtri(samples) @ factor.T)
    return np.asarray(np.clip(mixed, (1 - INSIDE) / 2, (1 + INSIDE) / 2))


def quantiles(of: Strict, shares: Array) -> Array:
    """Return the values (n,) of a distribution below which `shares` (n,) of it lie."""
    from scipy import stats

    if isinstance(of, NormalAxis):
        found = stats.norm(of.mean, of.std).ppf(shares)
    elif isinstance(of, LognormalAxis):
        found = stats.lognorm(math.sqrt(math.log1p(of.cov**2)), scale=of.median).ppf(shares)
    elif isinstance(of, UniformAxis):
        found = of.low + (of.high - of.low) * shares
    else:
        assert isinstance(of, TruncatedNormalAxis)
        ends = (of.low - of.mean) / of.std, (of.high - of.mean) / of.std
        found = stats.truncnorm(*ends, loc=of.mean, scale=of.std).ppf(shares)
    return np.asarray(found, dtype=float)


def chosen(count: int, shares: Array) -> Array:
    """Return which of `count` values, each as likely, the `shares` (n,) of the unit interval stand for."""
    return np.asarray(np.minimum((shares * count).astype(np.int64), count - 1))


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
    if not fault and key in KEYS and len(values) == 1 and isinstance(values[0], str) and is_set(Path(values[0])):
        try:
            values = records_of(values[0], Path.cwd())
        except InputError as error:
            faults += [f"{label}: {each}" for each in error.faults]
            return None
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


@dataclass(frozen=True)
class Asked:
    """The case or study of a sweep, settings KEY=VALUE, the texts of --vary, and that of --seeds (None: not given)."""

    path: str
    settings: tuple[str, ...]
    vary: tuple[str, ...]
    seeds: str | None


@dataclass(frozen=True)
class Planned:
    """The case that is varied, as it is written; the rows; whether their seed is the case's own; the metrics that are
    kept (None: all); and the study file (None: a case was given)."""

    case: WrittenCase
    plan: Plan
    own_seed: bool
    metrics: tuple[str, ...] | None = None
    samples: SamplesSpec | None = None
    study: Path | None = None
    name: str = ""
    about: Mapping[str, str] = field(default_factory=dict)  # attributes of its file, of an incremental dynamic analysis
    sim_alone: bool = False  # whether SIM alone is computed, beside the check of the test


def read_plan(asked: Asked) -> Planned:
    """Return the case and the rows that were asked for; raises InputError with every fault."""
    faults: list[str] = []
    typed = tuple((axis,) for axis in read_axes(asked.vary, faults))
    seeds = range(1) if asked.seeds is None else read_seeds(asked.seeds, faults)
    path = study_file(asked.path)
    if path is None:
        plan = checked_plan(Plan(typed, seeds), faults)
        return Planned(read_case(asked.path), plan, asked.seeds is None)
    study, places = load_study(path)
    folder = path.absolute().parent
    blocks = (*_listed_axes(study, places, folder, faults), *_sampled_axes(study, places, folder, faults))
    if asked.seeds is None and study.seeds is not None:
        seeds = range(study.seeds.first, study.seeds.last + 1)
    plan = checked_plan(Plan((*typed, *blocks), seeds, folder=folder), faults)
    own_seed = asked.seeds is None and study.seeds is None
    name = study.name or path.stem
    case = _case_of(study, path)
    return Planned(
        case, _constrained(plan, study.constraints, path), own_seed, study.metrics, study.samples, path, name
    )


def _case_of(study: StudyKeys, path: Path) -> WrittenCase:
    """Return the case of a study: a name or path beside it, or the keys in it."""
    if isinstance(study.case, str):
        beside = Path(os.path.expanduser(study.case))
        name = study.case if beside.is_absolute() else os.path.join(path.parent, study.case)
        tried = (name, *(f"{name}{suffix}" for suffix in (".yaml", ".yml")))
        if found := next((each for each in tried if os.path.isfile(each)), None):
            return read_case(found)
        try:
            return read_case(study.case)
        except InputError as error:
            raise InputError(*(f"{path.name}: case: {fault}" for fault in error.faults)) from error
    return written_case(dump(_plain({"name": study.name or path.stem} | dict(study.case))), path.absolute())


def _plain(data: Any) -> Any:
    """Return nested data with lists for tuples."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    return [_plain(value) for value in data] if isinstance(data, tuple) else data


def _listed_axes(study: StudyKeys, places: dict[str, str], folder: Path, faults: list[str]) -> list[Block]:
    """Return a block for each axis that is no distribution."""
    blocks: list[Block] = []
    for key, axis in study.axes.items():
        if why := unvaried(key):
            faults.append(f"{places[key]}: {why}")
        elif not is_sampled(axis):
            try:
                blocks.append((Axis(key, _values(axis, folder), places[key]),))
            except InputError as error:
                faults += [f"{places[key]}: {fault}" for fault in error.faults]
    return blocks


def _values(axis: Strict, folder: Path) -> tuple[Any, ...]:
    """Return the values of a list, a range or a folder of records."""
    if isinstance(axis, ListAxis):
        return axis.values
    if isinstance(axis, RangeAxis):
        if axis.spacing == "log":
            ends = spaced(math.log(axis.start), math.log(axis.stop), axis.count, whole=False)
            return (axis.start, *map(math.exp, ends[1:-1]), axis.stop)
        return spaced(axis.start, axis.stop, axis.count, axis.start.is_integer() and axis.stop.is_integer())
    assert isinstance(axis, FolderAxis)
    return records_of(axis.folder, folder)


def _sampled_axes(study: StudyKeys, places: dict[str, str], folder: Path, faults: list[str]) -> list[Block]:
    """Return one block of all axes that are distributions: they are sampled together."""
    keys = [key for key, axis in study.axes.items() if is_sampled(axis)]
    if not keys or study.samples is None:
        return []
    observed: dict[str, tuple[Any, ...]] = {}
    for key in keys:
        axis = study.axes[key]
        if isinstance(axis, EmpiricalAxis):
            try:
                observed[key] = axis.values or _csv_column(folder / str(axis.file), str(axis.column))
            except InputError as error:
                faults += [f"{places[key]}: {fault}" for fault in error.faults]
    samples = study.samples
    try:
        cube = unit_samples(samples.method, samples.count, len(keys), samples.seed)
        if study.correlations:
            cube = correlated(cube, _pairs(study, keys))
    except InputError as error:
        faults += error.faults
    if faults:
        return []
    return [
        tuple(
            Axis(key, _taken(observed[key], column) if key in observed else quantiles(study.axes[key], column), place)
            for key, place, column in zip(keys, (places[key] for key in keys), cube.T, strict=True)
        )
    ]


def _taken(values: tuple[Any, ...], shares: Any) -> Any:
    """Return the observed values (n,) that shares of the unit interval stand for: numbers, else objects."""
    numbers = all(isinstance(value, float) for value in values)
    held = np.empty(len(values), dtype=float if numbers else object)
    for place, value in enumerate(values):
        held[place] = value
    return held[chosen(len(values), shares)]


def _pairs(study: StudyKeys, keys: list[str]) -> dict[tuple[int, int], float]:
    """Return the normal correlation of each pair of sampled axes, by their places."""
    found = {}
    for one in study.correlations:
        first, second = (keys.index(key) for key in one.between)
        found[first, second] = normal_correlation(one.rank) if one.rank is not None else float(one.normal or 0.0)
    return found


def _csv_column(path: Path, column: str) -> tuple[float, ...]:
    """Return the numbers in a column of a CSV file with a header; raises InputError."""
    path = Path(os.path.expanduser(path))
    try:
        if path.stat().st_size > MOST_CSV_BYTES:
            raise InputError(f"{path}: must be <= {MOST_CSV_BYTES} bytes, got {path.stat().st_size}")
        with open(path, encoding="utf-8-sig", newline="") as file:
            lines = csv.DictReader(file, skipinitialspace=True)
            if column not in (lines.fieldnames or ()):
                names = ", ".join(lines.fieldnames or ()) or "none"
                raise InputError(f"{path} has no column {column!r}; known: {names}"[:400])
            found = []
            for line in lines:
                value = _number(line[column])
                if value is None:
                    raise InputError(f"{path}:{lines.line_num}: {column} must be a number, got {line[column]!r:.40}")
                found.append(value)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {getattr(error, 'strerror', None) or error}") from error
    if not found:
        raise InputError(f"{path}: holds no row below its header; add values")
    return tuple(found)


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _constrained(plan: Plan, constraints: tuple[ConstraintSpec, ...], path: Path) -> Plan:
    """Return the plan with the points that meet every constraint; raises InputError where that is none."""
    if not constraints:
        return plan
    keep = np.ones(plan.points, dtype=bool)
    for k, one in enumerate(constraints, 1):
        left, right = (_side(plan, side, f"{path.name}: constraints[{k}]") for side in (one.left, one.right))
        keep &= COMPARED[one.op](left, one.times * right)
    if not keep.any():
        raise InputError(f"{path.name}: constraints: no row of {plan.points} meets them; loosen one")
    return replace(plan, kept=np.flatnonzero(keep))


def _side(plan: Plan, side: str | float, label: str) -> Any:
    """Return one side of a comparison: a number, or the numbers (n_points,) of an axis."""
    if not isinstance(side, str):
        return float(side)
    numbers = plan.numbers(side)
    if numbers is None:
        raise InputError(f"{label}: {side} has values that are no numbers, which cannot be compared")
    return numbers
