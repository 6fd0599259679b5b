"""Comparison of results: `--group-by` (means and ratios of groups), repeats of one case, `--baseline` (changes,
metrics that are worse)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.quantities import LESS, metric
from rths_cli.report.document import Column, Line, Row, Section, Table
from rths_cli.report.input_files import differing
from rths_cli.report.numbers import six_wide
from rths_cli.report.results_by_case import status
from rths_cli.rigs.description import adjective, capabilities_of

COVERED = 0.95  # probability of the confidence interval

NAMES = {
    "case": "case_name",
    "controller": "controller",
    "damping": "damping_name",
    "method": "method",
    "record": "record_name",
    "rig": "rig",
    "rig_kind": "rig_kind",
    "scaling": "scaling",
    "seed": "seed",
}
NAMING = {"case_name", "controller", "damping_name", "record_name", "rig", "scaling"}  # another one, another case name
PLACE = ("rig", "rig_kind", "record", "scaling", "damping", "controller", "method", "software")
SHOWN = (
    "shake_table.tracking_max_m_s2",
    "shake_table.tracking_rms_m_s2",
    "exp_rths.tracking_max_m_s2",
    "exp_rths.tracking_rms_m_s2",
    "sim_delay.rms_error_m_s2",
    "exp_rths.rms_error_m_s2",
)
OTHERS = 2  # groups beside the first one in a table of text
COLUMN = 12
Place = tuple[str, int | None]
HEADS = ("n", "mean", "std", "min", "max", "95 % from", "95 % to")
KEYS = ("case", "method", "rig", "rig_kind")
WORSE, BETTER, SAME, SEEN = "worse", "better", "same", "not judged"
FLOOR_M_S2 = 1e-6  # smaller changes of an error are rounding, whatever their ratio
DEFAULT_PERCENT = 1.0  # tolerance
LISTED = 20  # largest number of worse metrics in the text


@dataclass(frozen=True)
class Statistics:
    """Statistics of a metric over runs."""

    n: int  # number of runs
    mean: float
    std: float  # standard deviation of one run, with n - 1; NaN for one run
    minimum: float
    maximum: float
    low: float  # lower end of the 95 % confidence interval of the mean; NaN for one run
    high: float  # upper end


def statistics(values: Sequence[float]) -> Statistics:
    """Return the statistics of one or more values; the interval is mean +- t std / sqrt(n), with Student's t."""
    n = len(values)
    mean = math.fsum(values) / n
    if n == 1:
        return Statistics(1, mean, math.nan, values[0], values[0], math.nan, math.nan)
    std = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    half = student(n - 1) * std / math.sqrt(n)
    return Statistics(n, mean, std, min(values), max(values), mean - half, mean + half)


@cache
def student(freedom: int) -> float:
    """Return t with P(|T| < t) = 95 % for Student's distribution with `freedom` degrees of freedom."""
    from scipy.special import stdtrit  # here: most reports need no statistics

    return float(stdtrit(freedom, 0.5 * (1.0 + COVERED)))


MADE: dict[str, Callable[[Result], str]] = {
    "folder": lambda result: str(result.path.parent),
    "software": lambda result: software(result),
}


@dataclass(frozen=True)
class Compared:
    """Results that agree in all keys but those of the groups."""

    where: str  # common values in words
    common: dict[str, str]  # common values by key
    groups: dict[str, tuple[Result, ...]]  # results by name of the group


def software(result: Result) -> str:
    """Return the version of rths that made a result, with the commit if it is known."""
    commit = str(result.attributes.get("git_commit") or "")[:7]
    return f"{result.attributes.get('rths_version') or '-'}{f' {commit}' if commit else ''}"


def value_of(result: Result, key: str) -> str:
    """Return the value of a result for a key of `--group-by`, "-" if it states none."""
    if key in MADE:
        return MADE[key](result)
    value = result.attributes.get(NAMES.get(key, key), "")
    return f"{value:g}" if isinstance(value, float) else str(value) or "-"


def check_keys(keys: Sequence[str], results: Sequence[Result]) -> None:
    """Raise InputError with a sentence for each key that no result states."""
    stated = {name for result in results for name in result.attributes} | NAMES.keys() | MADE.keys()
    unknown = [key for key in keys if key not in stated]
    if unknown:
        known = ", ".join(sorted((*NAMES, *MADE)))
        advice = f"use one of {known}, or an attribute of the result files"
        raise InputError(*(f"--group-by {key}: no result states it; {advice}." for key in unknown))


def group_name(result: Result, keys: Sequence[str]) -> str:
    """Return the name of a result's group, made of its values for the keys."""
    return ", ".join(value_of(result, key) for key in keys)


def compare(results: Sequence[Result], keys: Sequence[str]) -> list[Compared]:
    """Return the results with equal values of the other keys together, by group; also those of a single group."""
    stated = {NAMES.get(key, key) for key in keys}
    rest = [key for key in PLACE if NAMES.get(key, key) not in stated]
    rest += [] if stated & NAMING else ["case"]
    names = dict.fromkeys(group_name(result, keys) for result in results)
    places: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        places.setdefault(tuple(value_of(result, key) for key in rest), []).append(result)
    found = []
    for place, members in places.items():
        common = dict(zip(rest, place, strict=True))
        groups = {name: tuple(r for r in members if group_name(r, keys) == name) for name in names}
        found.append(Compared(_where(common), common, groups))
    return found


def _where(common: dict[str, str]) -> str:
    """Return the common values of results in words."""
    parts = dict(common)
    scaling, kind = parts.pop("scaling", ""), parts.pop("rig_kind", "")
    percent = f"{100 * float(scaling):g} % " if scaling.replace(".", "", 1).isdigit() else ""
    told = []
    for key, value in parts.items():
        if key == "record":
            told.append(percent + value)
        elif key == "rig":
            told.append(f"{adjective(kind)}rig {value}")
        else:
            told.append(f"{key} {value}")
    return ", ".join(told)


def flat(result: Result) -> dict[Place, float]:
    """Return the finite metrics of a result by path and, for metrics with several values, number from 1."""
    found: dict[Place, float] = {}
    for path, value in result.metrics.items():
        values = np.asarray(value, dtype=float)
        if values.ndim == 0:
            found[path, None] = float(values)
        else:
            found |= {(path, number): float(item) for number, item in enumerate(values.ravel(), 1)}
    return {place: item for place, item in found.items() if math.isfinite(item)}


def place_name(place: Place) -> str:
    """Return the name of a metric as in `accept`."""
    return place[0] if place[1] is None else f"{place[0]}[{place[1]}]"


def in_order(found: Iterable[Place]) -> list[Place]:
    """Return the metrics that the tables show, in the order of the paper's tables."""
    return sorted((place for place in found if place[0] in SHOWN), key=lambda p: (SHOWN.index(p[0]), p[1] or 0))


def complete(results: Sequence[Result]) -> list[Result]:
    """Return the results whose runs ended as planned."""
    return [result for result in results if status(result) == COMPLETE]


def over_runs(results: Sequence[Result]) -> dict[Place, Statistics]:
    """Return the statistics of each metric over the complete results."""
    values: dict[Place, list[float]] = {}
    for result in complete(results):
        for place, value in flat(result).items():
            values.setdefault(place, []).append(value)
    return {place: statistics(items) for place, items in values.items()}


def group_tables(found: Sequence[Compared], keys: Sequence[str]) -> Iterator[Table]:
    """Yield the comparison as tables: the mean of each group, and its ratio to the first; OTHERS groups per table."""
    names = list(found[0].groups)
    for start in range(1, max(len(names), 2), OTHERS):
        chosen = [names[0], *names[start : start + OTHERS]]
        letters = {
            name: chr(ord("A") + names.index(name)) if len(names) <= 26 else str(1 + names.index(name))
            for name in chosen
        }
        heads = [name if len(name) < COLUMN else letters[name] for name in chosen]
        ratios = [f"{head} / {heads[0]}" if len(head) + len(heads[0]) < COLUMN - 3 else "ratio" for head in heads[1:]]
        told = [f"{letters[name]}: {name}." for name in chosen if len(name) >= COLUMN]
        notes = (
            *told,
            "Mean over the complete runs of a group, ratio of means; * not all runs of the group are complete.",
        )
        rows = tuple(row for place in found for row in _rows(place, chosen))
        title = f"Comparison by {', '.join(keys)} (m/s^2, test band, measured)"
        yield Table(tuple(map(Column, (*heads, *ratios))), rows, title, "figure", notes)


def _rows(place: Compared, names: Sequence[str]) -> Iterator[Row]:
    runs = [place.groups[name] for name in names]
    means = [over_runs(members) for members in runs]
    counts = ", ".join(str(len(members)) for members in runs)
    yield Row(f"{place.where} (runs: {counts}{_mixed(runs)})")
    wanted = in_order({item for found in means for item in found})
    if not wanted:
        yield Row("no figure", (*(_cell(members, None) for members in runs), *["-"] * (len(runs) - 1)))
    for item in wanted:
        cells = [_cell(members, found.get(item)) for members, found in zip(runs, means, strict=True)]
        first = means[0].get(item)
        ratios = [_ratio(found.get(item), first) for found in means[1:]]
        yield Row(place_name(item), (*cells, *ratios))


def _mixed(runs: Sequence[Sequence[Result]]) -> str:
    """Return a warning if a group contains several cases, whose mean may be meaningless."""
    named = [sorted({value_of(result, "case") for result in members}) for members in runs]
    several = [f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''}" for names in named if len(names) > 1]
    return f"; several cases in one group: {'; '.join(several)}" if several else ""


def _cell(members: Sequence[Result], found: Statistics | None) -> str:
    ended = [status(result) for result in members]
    other = [end for end in ended if end != COMPLETE]
    if found is None:
        return other[0] if other else "-"
    return f"{six_wide(found.mean)}{'*' if other else ''}"


def _ratio(above: Statistics | None, below: Statistics | None) -> str:
    if above is None or below is None or below.mean == 0:
        return "-"
    return six_wide(above.mean / below.mean)


@dataclass(frozen=True)
class Repeats:
    """The repeated runs of one case."""

    case: str  # name
    where: str  # method and rig in words
    runs: int  # number of results
    ends: dict[str, int]  # number of results by status
    same_seed: int  # results that repeat seed and metrics of another one on a virtual rig, not counted
    seeds: tuple[str, ...]
    figures: dict[Place, Statistics]  # of each metric, over the complete runs that are counted


def repeats(results: Sequence[Result], keys: Sequence[str] = ()) -> list[Repeats]:
    """Return the cases that were run more than once.

    A run with the seed and metrics of another one on a virtual rig is no repeat. Results that differ in one of the
    `--group-by` keys, except the seed, are not repeats of each other: they may be different cases of the same name.
    """
    apart = [key for key in keys if key != "seed"]
    places: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        where = [value_of(result, key) for key in ("case", *PLACE)]
        places.setdefault((*where, group_name(result, apart)), []).append(result)
    return [_repeats(members) for members in places.values() if len(members) > 1 and len(_once(members)) > 1]


def _repeats(members: Sequence[Result]) -> Repeats:
    once = _once(members)
    a = members[0].attributes
    virtual = adjective(str(a.get("rig_kind", "")))
    where = f"method {a.get('method', '-')}, {virtual}rig {a.get('rig', '-')}"
    ends = Counter(map(status, members))
    seeds = tuple(dict.fromkeys(value_of(result, "seed") for result in members))
    case = str(a.get("case_name") or "-")
    return Repeats(
        case, where, len(members), dict(sorted(ends.items())), len(members) - len(once), seeds, over_runs(once)
    )


def _once(members: Sequence[Result]) -> list[Result]:
    """Return the results without those on a virtual rig that repeat seed and metrics of another one."""
    found: list[Result] = []
    for result in members:
        alike = [other for other in found if other.attributes.get("seed") == result.attributes.get("seed")]
        can = capabilities_of(str(result.attributes.get("rig_kind", "")))
        if not can.counts_steps or not any(_equal(result, other) for other in alike):
            found.append(result)
    return found


def _equal(one: Result, other: Result) -> bool:
    return one.metrics.keys() == other.metrics.keys() and all(
        np.array_equal(value, other.metrics[path], equal_nan=True) for path, value in one.metrics.items()
    )


def repeats_tables(found: Sequence[Repeats]) -> Iterator[Table]:
    """Yield one table with the statistics of the paper's metrics over repeats; nothing without repeats."""
    if found:
        rows = tuple(row for one in found for row in _repeat_rows(one))
        notes = (
            "n: complete runs; std: of one run, over n - 1; 95 %: interval of the mean by Student's distribution, for "
            "runs that scatter independently.",
        )
        title = "Statistics over repeats (m/s^2, test band, measured)"
        yield Table(tuple(map(Column, HEADS)), rows, title, "figure", notes)


def _repeat_rows(one: Repeats) -> Iterator[Row]:
    ends = ", ".join(f"{count} {status}" for status, count in one.ends.items())
    twice = f"; {one.same_seed} with the seed and figures of another, counted once" if one.same_seed else ""
    yield Row(f"{one.case}, {one.where}: {ends}{twice}")
    for place in in_order(one.figures):
        found = one.figures[place]
        yield Row(place_name(place), (str(found.n), *map(six_wide, _values(found))))


def _values(found: Statistics) -> tuple[float, ...]:
    return found.mean, found.std, found.minimum, found.maximum, found.low, found.high


@dataclass(frozen=True)
class Change:
    """One metric of a case in the baseline and now."""

    place: Place
    before: float  # mean over the repeats of the baseline
    now: float  # mean over the present repeats
    verdict: str  # WORSE, BETTER, SAME (within the tolerance), or SEEN (no error, not judged)

    @property
    def difference(self) -> float:
        """Return now - before."""
        return self.now - self.before

    @property
    def ratio(self) -> float | None:
        """Return now / before; None if before is 0."""
        return self.now / self.before if self.before else None


@dataclass(frozen=True)
class CaseChanges:
    """Changes of one case and method against the baseline."""

    case: str  # case, method and rig in words
    state: str  # remarks: why it cannot be compared, how runs ended, differing keys; "" if there are none
    changes: tuple[Change, ...]
    failed: bool  # whether a run or an error is missing, a run did not end as planned, or the case differs


def against(results: Sequence[Result], baseline: Sequence[Result], percent: float) -> list[CaseChanges]:
    """Return the changes against a baseline for each case, method and rig, as means over repeats on both sides.

    An error is worse if it is larger by more than `percent`. A case of the baseline also counts as worse if its run is
    missing, did not end as planned, or belongs to a changed case. A new case does not count as worse.
    """
    before, now = _by_case(baseline), _by_case(results)
    return [_case(key, before.get(key, []), now.get(key, []), percent) for key in dict.fromkeys((*before, *now))]


def got_worse(found: Sequence[CaseChanges]) -> bool:
    """Return whether a metric, or the end of a run, is worse than in the baseline."""
    return any(one.failed or any(change.verdict == WORSE for change in one.changes) for one in found)


def _by_case(results: Sequence[Result]) -> dict[tuple[str, ...], list[Result]]:
    """Return the results by their values of KEYS."""
    found: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        found.setdefault(tuple(value_of(result, key) for key in KEYS), []).append(result)
    return found


def _case(key: tuple[str, ...], before: Sequence[Result], now: Sequence[Result], percent: float) -> CaseChanges:
    case, method, rig, kind = key
    name = f"{case} ({method}), {adjective(kind)}rig {rig}"
    if not now:
        return CaseChanges(name, "in the baseline, but missing now", (), True)
    if not before:
        return CaseChanges(name, "new: not in the baseline", (), False)
    old, new = over_runs(before), over_runs(now)
    found = [_change(place, old[place].mean, new[place].mean, percent) for place in old if place in new]
    lost = [place for place in old if place not in new and _is_error(place)]
    ended = set(map(status, now)) - {COMPLETE}
    state = f"{', '.join(sorted(ended))} now" if ended else ""
    if lost:
        state = "; ".join(filter(None, [state, f"{len(lost)} errors of the baseline are missing"]))
    keys = differing(now[0], before[0])
    if keys:
        state = "; ".join(filter(None, [state, f"another case than in the baseline: they differ in {', '.join(keys)}"]))
    if not complete(before):
        return CaseChanges(name, "did not end as planned in the baseline", (), False)
    return CaseChanges(name, state, tuple(found), bool(ended or lost or keys))


def _is_error(place: Place) -> bool:
    """Return whether a metric is declared as one that is better the smaller it is."""
    found = metric(place[0])
    return found is not None and found.better == LESS


def _change(place: Place, before: float, now: float, percent: float) -> Change:
    if not _is_error(place):
        return Change(place, before, now, SEEN)
    allowed = percent / 100.0 * abs(before)
    floor = FLOOR_M_S2 if place[0].split(".")[1].count("m_s2") else 0.0
    if abs(now - before) <= max(allowed, floor):
        return Change(place, before, now, SAME)
    return Change(place, before, now, WORSE if now > before else BETTER)


def baseline_sections(found: Sequence[CaseChanges], source: str, percent: float) -> Iterator[Section]:
    """Yield a table of the paper's metrics against the baseline, and a list of the metrics that are worse.

    `source`: name of the baseline; `percent`: tolerance.
    """
    heads = ("baseline", "now", "change", "ratio", "")
    rows = tuple(row for one in found for row in _change_rows(one))
    title = f"Against the baseline {source} (m/s^2, test band, measured)"
    note = f"Means over repeats; same: within {percent:g} %."
    yield [Table(tuple(map(Column, heads)), rows, title, "figure", (note,))]
    worse = [(one.case, change) for one in found for change in one.changes if change.verdict == WORSE]
    lines = [f"  {case}: {told(change)}" for case, change in worse[:LISTED]]
    lines += [f"  {one.case}: {one.state}" for one in found if one.failed]
    more = [f"  and {len(worse) - LISTED} more figures, which --format json lists"] if len(worse) > LISTED else []
    head = (
        f"Worse than the baseline by more than {percent:g} %"
        if lines
        else f"Nothing is worse by more than {percent:g} %."
    )
    yield [Line(line, indent=4) for line in (head, *lines, *more)]


def told(change: Change) -> str:
    """Return a change in words, with its percentage."""
    percent = f" ({100 * (change.ratio - 1):+.3g} %)" if change.ratio else ""
    return f"{place_name(change.place)} {change.before:.4g} -> {change.now:.4g}{percent}"


def _change_rows(one: CaseChanges) -> Iterator[Row]:
    yield Row(f"{one.case}{f': {one.state}' if one.state else ''}")
    found = {change.place: change for change in one.changes}
    for place in in_order(found):
        change = found[place]
        difference = f"{'-' if change.difference < 0 else '+'}{six_wide(abs(change.difference))}"
        ratio = "-" if change.ratio is None else six_wide(abs(change.ratio))
        texts = (six_wide(change.before), six_wide(change.now), difference, ratio, change.verdict)
        yield Row(place_name(place), texts)
