"""Text below the table of a single case: error by cause, latency, and a list of all other metrics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from rths_cli.files.result_reader import Result
from rths_cli.report.error_budget_table import budget_text, named_causes
from rths_cli.report.latency_table import latency_text
from rths_cli.report.numbers import listed
from rths_cli.report.results_by_case import Entry
from rths_cli.report.text_layout import width, wrapped

KINDS = {"_true_full": "full-t", "_true": "true", "_full": "full", "_model": "model"}
TOTALS = ("check.rms_error_m_s2", "check.tracking_rms_m_s2")  # of the error by cause, whose table has no intervals
NAMES_SHARE = 0.7  # of a page's width; where names and units take more, values stand below them
TITLE = "Other figures of this case (definitions: rths report --json, or the result file)"


def other_figures(entry: Entry, shown: Iterable[str]) -> str:
    """Return error by cause and latency of each method, then a line for each metric that is not among `shown`.

    A line states path, unit and values by method, together with the other kinds of the metric (true, full band, model,
    limit). Times in s are shown in ms.
    """
    told, blocks = set(shown), []
    for method, result in entry.results.items():
        parts = _blocks(result, told)
        blocks += [f"Method {method}", *parts] if parts and len(entry.results) > 1 else parts
    paths = sorted({path for result in entry.results.values() for path in result.metrics} - told)
    return "\n\n".join([*blocks, *([_list(entry, paths)] if paths else [])])


def _blocks(result: Result, told: set[str]) -> list[str]:
    """Return the text blocks of one result, and add the paths that they show to `told`."""
    causes, latency = budget_text(result.metrics), latency_text(result.metrics)
    storeys = max((np.size(v) for path, v in result.metrics.items() if ".rms_error_coupling" in path), default=1)
    whole = bool(causes) and all(f"storey {storey}" in causes for storey in range(1, storeys + 1))
    for path in result.metrics:
        by_cause = path.startswith(("check.rms_error", "check.tracking_rms")) or (
            path.startswith("budget.") and not path.startswith("budget.unexplained")
        )
        if whole and by_cause and not (path in TOTALS and path in result.intervals):
            told.add(path)
        if latency and path.startswith("latency.") and path.endswith(("_s", "_hz")):
            told.add(path)
    named = named_causes(result)
    return [text for text in (causes, wrapped([named]) if named else "", latency) if text]


def _list(entry: Entry, paths: list[str]) -> str:
    results = entry.results
    groups = _groups(paths)
    wide = max(len(path) for path in groups)
    lines = []
    for path, kinds in groups.items():
        unit = next(result.units[path] for result in results.values() if path in result.units)
        values = {method: _values(result, kinds, unit) for method, result in results.items()}
        same = len(set(values.values())) == 1
        text = next(iter(values.values())) if same else " | ".join(f"{m}: {v}" for m, v in values.items())
        shown = f"{'ms' if unit == 's' else unit:<8}{text}"
        if wide + 12 > NAMES_SHARE * width():
            lines += [f"  {path}", wrapped([f"    {shown}"], indent=12)]
        else:
            lines.append(wrapped([f"  {path:<{wide}}  {shown}"], indent=wide + 12))
    return "\n".join([wrapped([TITLE], 2), *lines])


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
    return listed(result.metrics[path], result.intervals.get(path), _milliseconds if unit == "s" else _plain)


def _milliseconds(value: float) -> str:
    return f"{round(1e3 * value, 3) + 0.0:.3f}"


def _plain(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    near_one = 0.0 < abs(value - 1.0) < 1e-3  # a radius of 0.99996 is not 1
    return f"{float(value):.{7 if near_one else 4}g}"
