"""What a page needs of the case that a result file holds: the runs asked for, its limits, the table's latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.case.nodes import Source, plain
from rths_cli.case.yaml_nodes import parse
from rths_cli.files.results import Result
from rths_cli.rig_info import capabilities_of

MET, NOT_MET, NOT_JUDGED = "met", "not met", "not judged"
RUNS = {"sim": "SIM", "sim_delay": "SIM-DELAY", "shake_table": "shake table test", "exp_rths": "EXP-RTHS"}


@dataclass(frozen=True)
class Limit:
    """Hold an `accept` limit of a case: the figure's path, the limit, the figure (None: not there) and the verdict."""

    path: str
    limit: float
    value: float | None
    verdict: str


@dataclass(frozen=True)
class Facts:
    """Hold what a case asked for: `missing` are the runs that are not in its result."""

    missing: tuple[str, ...]
    limits: tuple[Limit, ...]
    latency_samples: int
    notes: str


def facts(result: Result) -> Facts:
    """Return what the resolved case of a result says; a result without one asked for nothing."""
    node, _ = parse(result.resolved_yaml, Source("case/resolved", Path()))
    found = plain(node) if node is not None else {}
    case: Mapping[str, Any] = found if isinstance(found, dict) else {}
    accept = _mapping(case.get("accept"))
    limits = tuple(_limit(result, str(path), limit) for path, limit in accept.items() if isinstance(limit, int | float))
    latency = _mapping(_mapping(case.get("table")).get("converters")).get("latency_samples", 1)
    missing = tuple(RUNS.get(str(run), str(run)) for run in case.get("runs") or () if run not in result.groups)
    return Facts(missing, limits, latency if isinstance(latency, int) else 1, str(case.get("notes") or ""))


def is_virtual(result: Result) -> bool:
    """Tell whether a result is of a virtual rig."""
    return not capabilities_of(str(result.attributes.get("rig_kind", ""))).moves_hardware


def status(result: Result) -> str:
    """Return how a run ended."""
    return str(result.attributes.get("status", "complete"))


def name_of(result: Result) -> str:
    """Return case and method of a result, and the instant of a run on a real rig, which may be one of several."""
    a = result.attributes
    when = "" if is_virtual(result) else f", {a.get('created_utc') or '-'}"
    return f"{a.get('case_name') or '-'} ({a.get('method') or '-'}{when})"


def _limit(result: Result, path: str, limit: float) -> Limit:
    value = _figure(result, path)
    if status(result) != "complete":
        return Limit(path, limit, value, NOT_JUDGED)
    return Limit(path, limit, value, MET if value is not None and abs(value) <= limit else NOT_MET)


def _figure(result: Result, path: str) -> float | None:
    """Return the figure of a path: of its storey, counted from 1, or the largest, as `rths run` judges it."""
    name, _, index = path.partition("[")
    if name not in result.metrics:
        return None
    values = np.atleast_1d(np.asarray(result.metrics[name], dtype=float))
    place = int(index.rstrip("]")) - 1 if index else int(np.abs(values).argmax())
    return float(values[place]) if place < values.size else None


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
