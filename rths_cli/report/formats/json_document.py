"""`--format json`: one document, by the published schema (configs/report.schema.json)."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rths_cli.findings import as_data
from rths_cli.quantities import metric
from rths_cli.report.group_comparison import Compared, Place, Repeats, Statistics, got_worse, over_runs, place_name
from rths_cli.report.numbers import json_value
from rths_cli.report.report_contents import Baseline, Contents
from rths_cli.report.result_tables import to_json
from rths_cli.report.results_by_case import judge
from rths_cli.report.stored_findings import stored_findings
from rths_cli.report.study_pages import document as sweep_document

FORMAT, FORMAT_VERSION = "rths-report", 1


def document(found: Contents) -> dict[str, Any]:
    """Return a report for JSON: all results with all metrics, accept limits, comparisons, and unread files."""
    results = found.inputs.results
    listed = to_json(results)["results"]
    assert isinstance(listed, list)
    for one, result in zip(listed, results, strict=True):
        one["findings"] = [as_data(found) for found in stored_findings(result)]
        one["accept"] = [asdict(limit) | {"value": json_value(limit.value)} for limit in judge(result)]
    paths = sorted({path for result in results for path in result.metrics})
    defined = {path: definition for path in paths if (definition := metric(path))}
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "results": listed,
        "figures": {
            path: {"unit": d.units, "over": d.over, "better": d.better, "definition": d.text}
            for path, d in defined.items()
        },
        "group_by": list(found.keys),
        "groups": [_compared(one) for one in found.groups],
        "repeats": [_repeats(one) for one in found.repeats],
        "baseline": _baseline(found.baseline),
        "sweeps": [sweep_document(sweep, path) for path, sweep in found.inputs.sweeps],
        "unread": [{"file": str(one.path), "reason": one.sentence} for one in found.unread],
        "clashes": [{"file": str(one.path), "reason": one.sentence} for one in found.clashes],
    }


def _compared(one: Compared) -> dict[str, Any]:
    groups = [
        {"group": name, "files": [str(r.path) for r in members], "figures": _figures(over_runs(members))}
        for name, members in one.groups.items()
    ]
    return {"common": one.common, "groups": groups}


def _figures(found: dict[Place, Statistics]) -> dict[str, Any]:
    return {place_name(place): _statistics(item) for place, item in found.items()}


def _statistics(found: Statistics) -> dict[str, Any]:
    return {
        "n": found.n,
        "mean": json_value(found.mean),
        "std": json_value(found.std),
        "min": json_value(found.minimum),
        "max": json_value(found.maximum),
        "mean_95_low": json_value(found.low),
        "mean_95_high": json_value(found.high),
    }


def _repeats(one: Repeats) -> dict[str, Any]:
    about = {"case": one.case, "where": one.where, "runs": one.runs, "ends": one.ends, "same_seed": one.same_seed}
    return {**about, "seeds": list(one.seeds), "figures": _figures(one.figures)}


def _baseline(found: Baseline | None) -> dict[str, Any] | None:
    if found is None:
        return None
    cases = [
        {
            "case": one.case,
            "state": one.state,
            "changes": [
                {
                    "figure": place_name(change.place),
                    "before": change.before,
                    "now": change.now,
                    "difference": change.difference,
                    "ratio": None if change.ratio is None else json_value(change.ratio),
                    "verdict": change.verdict,
                }
                for change in one.changes
            ],
        }
        for one in found.changes
    ]
    about = {"source": found.source, "tolerance_percent": found.percent, "worse": got_worse(found.changes)}
    return {**about, "cases": cases}
