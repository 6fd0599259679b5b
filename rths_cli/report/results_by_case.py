"""Group result files by case and method (`Entry`); look up their metrics, the published ones and the accept limits."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.analysis import grade
from rths_cli.case.yaml_reader import Source, parse
from rths_cli.errors import InputError
from rths_cli.files.raw_log import SUFFIX, read_header
from rths_cli.files.result_reader import BEGUN, COMPLETE, Result, read_checked, result_files
from rths_cli.report.document import across
from rths_cli.report.numbers import six_wide
from rths_cli.report.result_scale import in_model_scale
from rths_cli.rigs.description import capabilities_of

Figure = float | Sequence[float | None] | None
Figures = Mapping[str, Figure]
METHODS = ("paper", "best")
PUBLISHED = "published"
DAMPINGS = ("low", "high")
CONTROLLERS = ("FF", "FF+FB", "none")
DIVERGED = "diverged"
TABLE_RUNS, COMPUTED_RUNS = ("shake_table", "exp_rths"), ("sim", "sim_delay")
RUN_NAMES = {"sim": "SIM", "sim_delay": "SIM-DELAY", "shake_table": "shake table test", "exp_rths": "EXP-RTHS"}
SIM_DELAY_ERROR, EXP_ERROR = "sim_delay.rms_error_m_s2", "exp_rths.rms_error_m_s2"
UNFINISHED = "*"  # mark of a metric whose run did not end as planned
SHORT = {"interrupted": "halted"}  # in a narrow column

ACCEPT = re.compile(r"^accept:.*\n(?:[ -].*\n)*", re.MULTILINE)


@dataclass(frozen=True)
class Entry:
    """One case of the tables."""

    rig: str  # name
    virtual: bool  # whether the rig is virtual
    record: str  # scaling and name
    damping: str  # name
    damping_ratio: float | None  # of the building's first mode; None: not stored
    controller: str
    variant: str  # distinguishes cases with the same record, scaling, damping and controller; "": only one
    results: Mapping[str, Result]  # by method
    published: Figures  # published metrics by path
    reference_title: str  # source of the published metrics

    @property
    def table_name(self) -> str:
        """Return the rig as the titles of the tables state it."""
        return f"{'virtual ' if self.virtual else ''}shake table {self.rig}"

    @property
    def excitation(self) -> str:
        """Return record and variant."""
        return f"{self.record}, {self.variant}" if self.variant else self.record


def load(paths: Sequence[Path]) -> list[Result]:
    """Read result files and folders of them; raises InputError with a sentence for each file that cannot be read."""
    files, empty = result_files(paths)
    results, faults = [], list(empty.values())
    for file in files:
        try:
            results.append(read_checked(file))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(*faults)
    return results


def unrecovered(paths: Sequence[Path]) -> list[str]:
    """Return a sentence for each raw log in these folders whose samples are in no result."""
    logs = [log for path in paths if path.is_dir() for log in sorted(path.glob(f"*{SUFFIX}")) if _waits(log)]
    return [f"{log}: the run that it logged is in no result; rths recover {log} puts it there." for log in logs]


def _waits(log: Path) -> bool:
    """Return whether the run of a log is in no result; False for a log that a running process writes."""
    try:
        header = read_header(log)
        result = log.parent / Path(header.result).name
        if not result.exists():
            return True
        found = read_checked(result)
    except InputError:
        return False
    finished = found.attributes["status"] == "complete" or f"recovered_{header.run}" in found.attributes
    return not finished and header.run not in found.groups


def entries(results: Sequence[Result], references: Mapping[str, Figures]) -> list[Entry]:
    """Group results into cases in the order of the paper's tables; several results of a method become variants.

    `references`: published metrics by case name, which take precedence over those in the results.
    """
    places: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        places.setdefault(_place(result), []).append(result)
    found = [
        _entry(variant, members, references) for same in places.values() for variant, members in _variants(same).items()
    ]
    rigs, records = _order([e.table_name for e in found]), _order([e.record for e in found])

    def place(entry: Entry) -> tuple[object, ...]:
        where = (rigs[entry.table_name], records[entry.record], entry.variant)
        return (*where, damping_key(entry), _rank(CONTROLLERS, entry.controller))

    return sorted(found, key=place)


def damping_key(entry: Entry) -> tuple[bool, float, str]:
    """Return the sort key of entries by damping, unknown damping last."""
    rank = damping_rank(entry)
    return (math.isnan(rank), 0.0 if math.isnan(rank) else rank, entry.damping)


def damping_rank(entry: Entry) -> float:
    """Return a number that increases with damping: the first mode's ratio, else 0 for low, 1 for high; NaN: unknown."""
    if entry.damping_ratio is not None:
        return entry.damping_ratio
    return float(DAMPINGS.index(entry.damping)) if entry.damping in DAMPINGS else math.nan


def look_up(figures: Mapping[str, object], path: str, index: int | None) -> float | None:
    """Return the value of a metric: that of a storey (`index` from 0), or its first one; None if it does not exist."""
    value = figures.get(path)
    if value is None:
        return None
    values = np.atleast_1d(np.asarray(value, dtype=float))
    position = index or 0
    return float(values[position]) if position < values.size else None


def state(result: Result | None, path: str, index: int | None = None) -> float | str:
    """Return a metric as a number, or a word if there is none: "-", "diverged", or the status of its run.

    A value that is not finite belongs to a response that diverged, or to a storey whose motion is not known.
    """
    if result is None:
        return "-"
    value = look_up(result.metrics, path, index)
    if value is not None and math.isfinite(value):
        return value
    if value is not None:
        return DIVERGED if path.partition(".")[0] not in TABLE_RUNS else "-"
    end = run_state(result, path)
    return SHORT.get(end, end) if end != COMPLETE else "-"


def status(result: Result) -> str:
    """Return how the runs of a result ended."""
    return str(result.attributes.get("status", COMPLETE))


def run_state(result: Result, path: str) -> str:
    """Return the status of the run of a metric; COMPLETE for computed metrics.

    A result of an earlier version has one status for all table runs, that of the first one that did not reach its end.
    """
    whole, run = status(result), path.partition(".")[0]
    if whole == COMPLETE or run not in TABLE_RUNS:
        return COMPLETE
    told = {name: result.attributes[f"{name}_status"] for name in TABLE_RUNS if f"{name}_status" in result.attributes}
    end = str(told.get(run, COMPLETE if told else whole))
    return whole if end == BEGUN else end


def mark(result: Result | None, path: str) -> str:
    """Return UNFINISHED if the run of a metric did not end as planned, "" if it did or was refused."""
    return UNFINISHED if result and run_state(result, path) not in (COMPLETE, "refused") else ""


def words(states: Sequence[float | str], mark: str = "") -> tuple[str | None, ...]:
    """Return one cell per state (number or word); a word that all states share reaches over their columns."""
    first = states[0]
    if isinstance(first, str) and all(item == first for item in states):
        return across(first, len(states))
    return tuple(one if isinstance(one, str) else f"{six_wide(one)}{mark}" for one in states)


def our_cells(result: Result | None, paths: Sequence[str], index: int | None = None) -> tuple[str | None, ...]:
    """Return the cells of metrics of one result; `index`: storey, from 0; None: a metric with one value."""
    return words([state(result, path, index) for path in paths], mark(result, paths[0]))


def published_cells(entry: Entry | None, paths: Sequence[str], index: int | None = None) -> tuple[str | None, ...]:
    """Return the cells of published metrics; `index` as in `our_cells`."""
    return words([published(entry, path, index) if entry else "-" for path in paths])


def of(entry: Entry | None, method: str) -> Result | None:
    """Return the result of a method, None if it was not run."""
    return entry.results.get(method) if entry else None


def sim_delay_result(entry: Entry | None) -> Result | None:
    """Return the result whose SIM-DELAY is shown, the last one with its errors; all methods have the same SIM-DELAY."""
    found = list(entry.results.values()) if entry else []
    having = [r for r in reversed(found) if look_up(r.metrics, SIM_DELAY_ERROR, 0) is not None]
    return next(iter(having or found), None)


def ratio(above: float | str, below: float | str) -> float | str:
    """Return the ratio of EXP-RTHS to SIM-DELAY, or the word of the one that has no number."""
    if isinstance(above, str) or isinstance(below, str):
        return above if isinstance(above, str) else str(below)
    return above / below if below > 0 else "-"


def published(entry: Entry, path: str, index: int | None = None) -> float | str:
    """Return a published metric, or "-" if there is none."""
    value = look_up(entry.published, path, index)
    return "-" if value is None or not math.isfinite(value) else value


def sources(cases: Sequence[Entry]) -> list[str]:
    """Return a sentence on the sources of the published metrics; empty if there are none."""
    titles = dict.fromkeys(entry.reference_title for entry in cases if entry.published and entry.reference_title)
    return [f"Published (publ.): {'; '.join(titles)}."] if titles else []


def controllers(cases: Sequence[Entry]) -> list[str]:
    """Return the controllers of the cases, FF and FF+FB first."""
    return sorted({entry.controller for entry in cases}, key=lambda name: _rank(CONTROLLERS, name))


def methods(cases: Sequence[Entry]) -> tuple[str, ...]:
    """Return the methods: paper, best, and further ones of the cases."""
    others = {method for entry in cases for method in entry.results} - set(METHODS)
    return (*METHODS, *sorted(others))


def storeys(cases: Sequence[Entry]) -> int:
    """Return the largest number of storeys in results and published metrics."""
    sizes = [1]
    for entry in cases:
        for figures in (entry.published, *(result.metrics for result in entry.results.values())):
            sizes += [_size(value) for path, value in figures.items() if ".rms_error_m_s2" in path]
    return max(sizes)


def _size(value: object) -> int:
    return int(np.size(np.asarray(value))) if value is not None else 0


def _place(result: Result) -> tuple[str, ...]:
    """Return the values that rows and columns of the tables distinguish: record, rig, its kind, damping, controller."""
    a = result.attributes
    scaling = a.get("scaling", "")
    percent = f"{float(scaling) * 100:g} % " if scaling != "" else ""
    names = (str(a.get(key) or "-") for key in ("rig", "rig_kind", "damping_name", "controller"))
    return (percent + str(a.get("record_name") or "-"), *names)


def _variants(same: Sequence[Result]) -> dict[str, list[Result]]:
    """Return the results of one place by variant, with at most one result of each method per variant."""
    if not _doubled(same):
        return {"": list(same)}
    named: dict[str, list[Result]] = {}
    for result in same:
        name = str(result.attributes.get("case_name") or "-")
        count = 1
        while _doubled([*named.get(_numbered(name, count), []), result]):
            count += 1
        named.setdefault(_numbered(name, count), []).append(result)
    return named


def _numbered(name: str, count: int) -> str:
    return f"case {name}" if count == 1 else f"case {name} ({count})"


def _doubled(results: Sequence[Result]) -> bool:
    found = [_method(result) for result in results]
    return len(found) != len(set(found))


def _method(result: Result) -> str:
    return str(result.attributes.get("method") or "-")


def _entry(variant: str, members: Sequence[Result], references: Mapping[str, Figures]) -> Entry:
    record, rig, kind, damping, controller = _place(members[0])
    figures: dict[str, Figure] = {}
    for result in members:
        figures |= _stored_figures(result)
    for result in members:
        figures |= references.get(str(result.attributes.get("case_name")), {})
    ratios = [a for r in members if isinstance(a := r.attributes.get("damping_first_mode_ratio"), float)]
    titles = [str(r.attributes["reference_title"]) for r in members if r.attributes.get("reference_title")]
    return Entry(
        rig=rig,
        virtual=not capabilities_of(str(kind)).moves_hardware,
        record=record,
        damping=damping,
        damping_ratio=ratios[0] if ratios else None,
        controller=controller,
        variant=variant,
        results={_method(result): result for result in members},
        published=figures,
        reference_title=titles[0] if titles else "",
    )


def _stored_figures(result: Result) -> dict[str, Figure]:
    """Return the published metrics stored with a result; raises InputError if they are not a JSON mapping."""
    text = str(result.attributes.get("reference_json") or "{}")
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError) as error:
        raise InputError(f"{result.path}: reference_json is not a JSON mapping; {result.made_anew}") from error


def _order(names: Sequence[str]) -> dict[str, int]:
    return {name: position for position, name in enumerate(dict.fromkeys(names))}


def _rank(known: Sequence[str], name: str) -> tuple[int, str]:
    return (known.index(name), "") if name in known else (len(known), name)


def limits_of(result: Result) -> dict[str, float]:
    """Return the accept limits of a result's case by metric path; raises InputError if they cannot be read."""
    block = ACCEPT.search(result.resolved_yaml)
    if block is None:
        return {}
    node, faults = parse(block[0], Source(str(result.path), result.path.parent))
    limits = node.value["accept"].value if node is not None and isinstance(node.value, dict) else None
    if faults or not isinstance(limits, dict):
        raise InputError(f"{result.path}: the accept limits stored in it cannot be read; {result.made_anew}")
    return {path: float(str(limit.value)) for path, limit in limits.items()}


def judge(result: Result) -> list[grade.Judged]:
    """Return the judged accept limits of a result, in model scale; raises InputError if they cannot be read."""
    stored = in_model_scale(result).metrics
    return [grade.judge(path, limit, stored.get(grade.figure(path), [])) for path, limit in limits_of(result).items()]
