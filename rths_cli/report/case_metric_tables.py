"""Text tables below that of a single case: error by cause, latency, fidelity, all other metrics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.files.result_reader import Result
from rths_cli.numerics.lti import Array
from rths_cli.quantities import metric
from rths_cli.report.document import RULE, Block, Column, Document, Line, Row, Table
from rths_cli.report.numbers import listed, milliseconds, rounded, with_uncertainty
from rths_cli.report.results_by_case import Entry, mark, ratio, state, storeys
from rths_cli.report.to_text import width

CAUSES = {
    "declared": "declared building",
    "coupling": "coupling",
    "latency": "latency left",
    "model": "table model",
    "friction": "friction",
    "specimen": "specimen",
    "rounding": "rounded commands",
    "lost": "lost samples",
    "drift": "sensor drift",
    "noise": "sensor noise",
    "quantisation": "rounded samples",
    "rest": "rest",
}
WORDS = {"check": "pred.", "budget": "meas."}
STOREYS_BESIDE = 7  # at most, of one kind of error by cause
Metrics = Mapping[str, ArrayLike]

ITEMS = {
    "converter": "converter",
    "hold": "hold",
    "transport": "transport",
    "inverse": "inverse, table",
    "integration": "integration",
    "sensor": "sensor low pass",
    "coupling": "AC coupling",
    "kalman": "Kalman filter",
}
SUMS = {"total": "total", "compensated": "compensated", "left": "left"}
LEFT_SHARES = (0.05, 0.2)  # of the highest frequency: where the table shows what is left
SAME_S = 1e-9
KINDS = {"_true_full": "full-t", "_true": "true", "_full": "full", "_model": "model"}
TOTALS = ("check.rms_error_m_s2", "check.tracking_rms_m_s2")  # of the error by cause, whose table has no intervals
NAMES_SHARE = 0.7  # of a page's width; where names and units take more, values stand below them
TITLE = "Other figures of this case (definitions: rths report --json, or the result file)"
COLUMNS = {  # heading: metric, factor to the unit of the heading
    "delay ms": ("exp_rths.tracking_delay_s", 1e3),
    "FEI A": ("exp_rths.fei_amplitude", 1.0),
    "FEI d ms": ("exp_rths.fei_delay_s", 1e3),
    "J2": ("exp_rths.j2", 1.0),
    "J3": ("exp_rths.j3", 1.0),
    "J4": ("exp_rths.j4", 1.0),
    "J5": ("exp_rths.j5", 1.0),
    "energy": ("exp_rths.energy_error_ratio", 1.0),
}
PAIRS = {  # metric: heading of its two columns; the last one over that of SIM-DELAY
    "nrmse_percent": "RMS error (%)",
    "peak_error_percent": "peak error (%)",
    "rms_error_m_s2": "/ SIM-DELAY (-)",
}
PERCENT_NOTES = (
    "RMS error: in percent of the RMS of SIM (NRMSE); peak error: in percent of SIM's peak; / SIM-DELAY: RMS error of "
    "EXP-RTHS over that of SIM-DELAY, a ratio.",
    "FEI: frequency evaluation index of the table in EXP-RTHS, effective delay (positive: late) and gain (1 = exact).",
)


def named_causes(result: Result) -> str:
    """Return the named causes of the error in one sentence, "" for a result without them."""
    lines = str(result.attributes.get("error_causes", "")).splitlines()
    return f"Named causes of the error: {'; '.join(lines)}." if lines else ""


def budget(metrics: Metrics) -> list[Block]:
    """Return the table of RMS errors by cause with what the run says of the table, [] without such errors.

    `metrics` by path: predicted ones from `check.*`, measured ones from `budget.*` and `exp_rths.*`. If not all storeys
    fit side by side on a page of 100 columns, the lowest ones and the highest one are shown.
    """
    kinds = _kinds(metrics)
    if not kinds:
        return []
    most = STOREYS_BESIDE // len(kinds)
    shown = list(range(1, _storeys(metrics, kinds) + 1))
    shown = shown if len(shown) <= most else [*shown[: most - 1], shown[-1]]
    return [budget_table(metrics, shown), *([Line(_fitted(metrics))] if "budget" in kinds else [])]


def budget_table(metrics: Metrics, storeys: Sequence[int] = (), what: str = "") -> Table:
    """Return the table of RMS errors by cause, of the table and of some storeys, (): all; `what` ends its title."""
    kinds = _kinds(metrics)
    places = [0, *(storeys or range(1, _storeys(metrics, kinds) + 1))]
    columns = [(place, kind) for place in places for kind in kinds]

    def row(cause: str, label: str) -> Row:
        return Row(label, tuple(_budget_cell(metrics, kind, cause, place) for place, kind in columns))

    causes = [row(cause, label) for cause, label in CAUSES.items()]
    known = [one for one in causes if any(cell != "-" for cell in one.cells)]
    heads = (Column(WORDS[kind], (f"storey {place}" if place else "tracking",)) for place, kind in columns)
    title = f"Error by cause (RMS, mm/s^2, test band{what})"
    return Table(tuple(heads), (*known, RULE, row("", "together")), title)


def _kinds(metrics: Metrics) -> list[str]:
    return [kind for kind in WORDS if f"{kind}.rms_error_coupling_m_s2" in metrics]


def _storeys(metrics: Metrics, kinds: Sequence[str]) -> int:
    return int(np.size(metrics[f"{kinds[0]}.rms_error_coupling_m_s2"]))


def _budget_cell(metrics: Metrics, kind: str, cause: str, place: int) -> str:
    """Return an error in mm/s^2 as text; for the cause "", the total error, which is a metric of the run itself."""
    source = "exp_rths" if kind == "budget" and not cause else kind
    part = f"_{cause}" if cause else ""
    path = f"{source}.rms_error{part}_m_s2" if place else f"{source}.tracking_rms{part}_m_s2"
    if path not in metrics:
        return "-"
    value = 1e3 * float(np.atleast_1d(np.asarray(metrics[path], dtype=float))[max(place - 1, 0)])
    return f"{value:.3f}" if abs(value) < 1e4 else f"{value:.2e}"


def _fitted(metrics: Metrics) -> str:
    """Return the sentence on gain, delay and friction of the table in the run; insignificant values are not stated."""
    gain = _figure(metrics, "table_gain_error", "table_gain_error_uncertainty", 100.0, "%")
    late = _figure(metrics, "table_delay_error_s", "table_delay_error_uncertainty_s", 1e6, "microseconds", 1)
    friction = _figure(metrics, "friction_v", "friction_uncertainty_v", 1e3, "mV of command", sign="")
    told = f"The table in the run against the identified one: gain {gain}, delay {late}, friction like {friction}."
    if "not significant" not in told:
        return told
    left = "budget.rms_error_lost_m_s2" in metrics
    why = "not enough of the record is left" if left else "the record does not say more"
    return f"{told} Not significant: the uncertainty (two standard ones) is larger than the figure; {why}."


def _figure(
    metrics: Metrics, name: str, uncertainty: str, scale: float, unit: str, digits: int = 3, sign: str = "+"
) -> str:
    """Return a value with two standard uncertainties; if these exceed it, only the uncertainty."""
    value = scale * float(np.asarray(metrics[f"budget.{name}"]))
    if f"budget.{uncertainty}" not in metrics:  # a result of an earlier version
        return f"{value:{sign}.{digits}f} {unit}"
    off = 2.0 * scale * float(np.asarray(metrics[f"budget.{uncertainty}"]))
    if not off <= abs(value):
        return f"not significant (within +-{off:.2g} {unit})"
    return f"{value:{sign}.{digits}f} +- {off:.2g} {unit}"


def latency(metrics: Metrics) -> list[Block]:
    """Return the table of latencies in ms with their sums, and the delay identified on the rig; [] without latencies.

    `metrics`: metrics of a result by path (`latency.total_s`, ...).
    """
    if "latency.total_s" not in metrics or "latency.frequency_hz" not in metrics:
        return []
    frequency = np.atleast_1d(np.asarray(metrics["latency.frequency_hz"], dtype=float))
    shown = [int(np.abs(frequency - hz).argmin()) for hz in frequency[-1] * np.array(LEFT_SHARES)]
    heads = [f"{hz:g} Hz" for hz in frequency]
    columns = [*map(Column, heads), Column("taken out by", words=True)]
    columns += [Column(heads[place], ("left",)) for place in shown]
    rows = []
    for name, label in ITEMS.items():
        delay, stays = (_latency_values(metrics, f"latency.{name}{ending}") for ending in ("_s", "_left_s"))
        cells = [*map(milliseconds, delay), _taken_out_by(name, metrics), *map(milliseconds, stays[shown])]
        rows.append(Row(label, tuple(cells)))
    rows.append(RULE)
    for name, label in SUMS.items():
        total = map(milliseconds, _latency_values(metrics, f"latency.{name}_s"))
        rows.append(Row(label, (*total, *[""] * (1 + len(shown)))))
    title = "Latency of the loop (ms by frequency; negative is early)"
    return [Table(tuple(columns), tuple(rows), title), Line(_identified(metrics))]


def _latency_values(metrics: Metrics, path: str) -> Array:
    return np.atleast_1d(np.asarray(metrics[path], dtype=float))


def _number(metrics: Metrics, path: str) -> float:
    return float(_latency_values(metrics, path)[0])


def _taken_out_by(name: str, metrics: Metrics) -> str:
    """Return the block that compensates an item, "-" if the item is zero or not compensated."""
    delay, left = _latency_values(metrics, f"latency.{name}_s"), _latency_values(metrics, f"latency.{name}_left_s")
    if np.allclose(delay, left, rtol=1e-6, atol=SAME_S):
        return "-"
    if name in ("sensor", "coupling"):
        return "sensor correction" if np.any(left) else "inverse"
    return "prediction" if _number(metrics, "latency.predicted_s") > 0.0 else "inverse"


def _identified(metrics: Metrics) -> str:
    """Return the sentence on the prediction, and on the delay of converter, hold and transport."""
    lead, declared = (_number(metrics, f"latency.{name}_s") for name in ("predicted", "declared"))
    first = f"Prediction: {1e3 * lead:.3f} ms. Converter, hold and transport: {1e3 * declared:.3f} ms declared"
    if "latency.identified_s" not in metrics:
        return f"{first}; none was identified."
    found, error = (_number(metrics, f"latency.{name}_s") for name in ("identified", "identified_error"))
    return f"{first}, {with_uncertainty(found, error, 1e3)} ms (2 standard uncertainties) identified on the rig."


def other_figures(entry: Entry, shown: Iterable[str]) -> Document:
    """Return error by cause and latency of each method, then a line for each metric that is not among `shown`.

    A line states path, unit and values by method, together with the other kinds of the metric (true, full band, model,
    limit). Times in s are shown in ms.
    """
    told, sections = set(shown), list[list[Block]]()
    for method, result in entry.results.items():
        parts = [part for part in _sections(result, told) if part]
        sections += [[Line(f"Method {method}")], *parts] if parts and len(entry.results) > 1 else parts
    paths = sorted({path for result in entry.results.values() for path in result.metrics} - told)
    return [*sections, *([_list(entry, paths)] if paths else [])]


def _sections(result: Result, told: set[str]) -> list[list[Block]]:
    """Return the tables of one result, and add the paths that they show to `told`."""
    causes, loop = budget(result.metrics), latency(result.metrics)
    kinds = _kinds(result.metrics)
    whole = bool(causes) and _storeys(result.metrics, kinds) <= STOREYS_BESIDE // len(kinds)
    for path in result.metrics:
        by_cause = path.startswith(("check.rms_error", "check.tracking_rms")) or (
            path.startswith("budget.") and not path.startswith("budget.unexplained")
        )
        if whole and by_cause and not (path in TOTALS and path in result.intervals):
            told.add(path)
        if loop and path.startswith("latency.") and path.endswith(("_s", "_hz")):
            told.add(path)
    named = named_causes(result)
    return [causes, [Line(named)] if named else [], loop]


def _list(entry: Entry, paths: list[str]) -> list[Block]:
    results = entry.results
    groups = _groups(paths)
    wide = max(len(path) for path in groups)
    lines: list[Block] = [Line(TITLE)]
    for path, kinds in groups.items():
        unit = next(result.units[path] for result in results.values() if path in result.units)
        values = {method: _values(result, kinds, unit) for method, result in results.items()}
        same = len(set(values.values())) == 1
        text = next(iter(values.values())) if same else " | ".join(f"{m}: {v}" for m, v in values.items())
        shown = f"{'ms' if unit == 's' else unit:<8}{text}"
        if wide + 12 > NAMES_SHARE * width():
            lines += [Line(f"  {path}"), Line(f"    {shown}", indent=12)]
        else:
            lines.append(Line(f"  {path:<{wide}}  {shown}", indent=wide + 12))
    return lines


def _groups(paths: list[str]) -> dict[str, dict[str, str]]:
    """Return the paths of each metric by kind: "" (the metric itself), true, full, full-t, model or limit."""
    groups: dict[str, dict[str, str]] = {}
    for path in paths:
        base, kind = _kind(path, paths)
        groups.setdefault(base, {})[kind] = path
    return {base: dict(sorted(kinds.items())) for base, kinds in groups.items()}


def _kind(path: str, paths: list[str]) -> tuple[str, str]:
    """Return the basic metric of a path and the word for the path's kind; the path itself and "" if it is basic."""
    if path.startswith("check.limit_") and path.replace("limit_", "peak_") in paths:
        return path.replace("limit_", "peak_"), "limit"
    for suffix, word in KINDS.items():
        if path.endswith(suffix) and path.removesuffix(suffix) in paths:
            return path.removesuffix(suffix), word
    return path, ""


def _values(result: Result, kinds: Mapping[str, str], unit: str) -> str:
    return ", ".join(f"{word} {_listed(result, path, unit)}".strip() for word, path in kinds.items())


def _listed(result: Result, path: str, unit: str) -> str:
    if path not in result.metrics:
        return "-"
    return listed(result.metrics[path], result.intervals.get(path), milliseconds if unit == "s" else _plain)


def _plain(value: float) -> str:
    return rounded(value, 7 if 0.0 < abs(value - 1.0) < 1e-3 else 4)  # a radius of 0.99996 is not 1


def merit_table(cases: Sequence[Entry]) -> Table:
    """Return the table of EXP-RTHS's figures of merit, a line per case and method, with the definitions as notes."""
    rows: list[Row] = []
    for entry in cases:
        rows.append(Row(f"{entry.excitation}, damping {entry.damping}, {entry.controller}"))
        rows += [Row(method, tuple(_cells(result))) for method, result in entry.results.items()]
    title = f"Figures of merit of EXP-RTHS, measured, test band; {cases[0].table_name}"
    return Table(tuple(map(Column, COLUMNS)), tuple(rows), title, "method", tuple(_notes()))


def percent_table(cases: Sequence[Entry]) -> Table:
    """Return the table of EXP-RTHS's errors in percent of SIM, beside the ratio to SIM-DELAY and the table's FEI.

    A row for each storey of a case and method, in test band and full band; effective delay and gain are those of the
    table, stated in the first row.
    """
    rows: list[Row] = []
    for entry in cases:
        for method, result in entry.results.items():
            rows.append(Row(f"{entry.excitation}, damping {entry.damping}, {entry.controller}, {method}"))
            rows += [Row(f"storey {k + 1}", _percent_cells(result, k)) for k in range(storeys([entry]))]
    pairs = [Column(band, (what,)) for what in PAIRS.values() for band in ("test", "full")]
    of_table = [Column(name, ("table (FEI)",)) for name in ("ms late", "gain")]
    title = f"EXP-RTHS against SIM, measured, test band and full band; {cases[0].table_name}"
    return Table((*pairs, *of_table), tuple(rows), title)


def _percent_cells(result: Result, storey: int) -> tuple[str, ...]:
    values: list[float | str] = []
    for leaf in PAIRS:
        for suffix in ("", "_full"):
            value = state(result, f"exp_rths.{leaf}{suffix}", storey)
            if leaf == "rms_error_m_s2":
                value = ratio(value, state(result, f"sim_delay.{leaf}{suffix}", storey))
            values.append(value)
    cells = [_cell(value, mark(result, "exp_rths.nrmse_percent")) for value in values]
    if storey > 0:
        return (*cells, "", "")
    delay_s, gain = state(result, "exp_rths.fei_delay_s"), state(result, "exp_rths.fei_amplitude")
    delay_ms = delay_s if isinstance(delay_s, str) else round(1e3 * delay_s, 4) + 0.0  # a column has room for -0.1234
    shown = gain if isinstance(gain, str) else f"{gain:.4f}{mark(result, 'exp_rths.fei_amplitude')}"
    return (*cells, _cell(delay_ms, mark(result, "exp_rths.fei_delay_s")), shown)


def _cell(value: float | str, mark: str) -> str:
    return value if isinstance(value, str) else f"{value:.3g}{mark}"


def _cells(result: Result) -> Iterator[str]:
    for path, factor in COLUMNS.values():
        value = state(result, path)
        yield value if isinstance(value, str) else f"{rounded(factor * value, 4)}{mark(result, path)}"


def _notes() -> Iterator[str]:
    for head, (path, _) in COLUMNS.items():
        found = metric(path)
        yield f"{head} ({path}): {found.text if found else ''}."


def every_figure(entry: Entry) -> Iterator[Table]:
    """Yield a table of all metrics of one case: path, unit, values by method, definition; nothing without metrics."""
    methods = list(entry.results)
    paths = sorted({path for result in entry.results.values() for path in result.metrics})
    rows = []
    for path in paths:
        having = next(result for result in entry.results.values() if path in result.metrics)
        values = [_fidelity_values(entry.results[method], path) for method in methods]
        rows.append(Row(path, (having.units[path], *values, having.definitions[path])))
    columns = tuple(Column(name, words=True) for name in ("unit", *methods, "definition"))
    if rows:
        yield Table(columns, tuple(rows), f"Every figure of this case; {entry.table_name}", "figure")


def _fidelity_values(result: Result, path: str) -> str:
    return listed(
        result.metrics.get(path, np.nan), result.intervals.get(path), partial(rounded, digits=4), between="  "
    )
