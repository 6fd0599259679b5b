"""`--baseline`: comparison of results with those of a baseline: changes, and metrics that are worse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rths_cli.files.result_reader import Result
from rths_cli.quantities import LESS, metric
from rths_cli.report.group_comparison import Place, complete, in_order, over_runs, place_name, value_of
from rths_cli.report.numbers import six_wide
from rths_cli.report.report_conflicts import differing
from rths_cli.report.text_layout import Block, Cell, Paragraphs, Row, Table
from rths_cli.rigs.description import adjective

KEYS = ("case", "method", "rig", "rig_kind")
WORSE, BETTER, SAME, SEEN = "worse", "better", "same", "not judged"
FLOOR_M_S2 = 1e-6  # smaller changes of an error are rounding, whatever their ratio
DEFAULT_PERCENT = 1.0  # tolerance
LISTED = 20  # largest number of worse metrics in the text


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
    ended = {str(result.attributes.get("status", "complete")) for result in now} - {"complete"}
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


def baseline_blocks(found: Sequence[CaseChanges], source: str, percent: float) -> Iterator[Block]:
    """Yield a table of the paper's metrics against the baseline, and a list of the metrics that are worse.

    `source`: name of the baseline; `percent`: tolerance.
    """
    heads = ("baseline", "now", "change", "ratio", "")
    rows = tuple(row for one in found for row in _rows(one))
    title = f"Against the baseline {source} (m/s^2, test band, measured)"
    note = f"Means over repeats; same: within {percent:g} %."
    yield Table(title, "figure", (2, 2, 1), 10, (tuple(map(Cell, heads)),), rows, (note,))
    worse = [(one.case, change) for one in found for change in one.changes if change.verdict == WORSE]
    lines = [f"  {case}: {told(change)}" for case, change in worse[:LISTED]]
    lines += [f"  {one.case}: {one.state}" for one in found if one.failed]
    more = [f"  and {len(worse) - LISTED} more figures, which --format json lists"] if len(worse) > LISTED else []
    head = (
        f"Worse than the baseline by more than {percent:g} %"
        if lines
        else f"Nothing is worse by more than {percent:g} %."
    )
    yield Paragraphs((head, *lines, *more), 4)


def told(change: Change) -> str:
    """Return a change in words, with its percentage."""
    percent = f" ({100 * (change.ratio - 1):+.3g} %)" if change.ratio else ""
    return f"{place_name(change.place)} {change.before:.4g} -> {change.now:.4g}{percent}"


def _rows(one: CaseChanges) -> Iterator[Row]:
    yield Row(f"{one.case}{f': {one.state}' if one.state else ''}")
    found = {change.place: change for change in one.changes}
    for place in in_order(found):
        change = found[place]
        difference = f"{'-' if change.difference < 0 else '+'}{six_wide(abs(change.difference))}"
        ratio = "-" if change.ratio is None else six_wide(abs(change.ratio))
        texts = (six_wide(change.before), six_wide(change.now), difference, ratio, change.verdict)
        yield Row(place_name(place), tuple(map(Cell, texts)))
