"""The accept limits of a stored result, judged one by one."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from rths_cli.case.nodes import Source
from rths_cli.case.yaml_nodes import parse
from rths_cli.errors import InputError
from rths_cli.files.results import Result

ACCEPT = re.compile(r"^accept:.*\n(?:[ -].*\n)*", re.MULTILINE)


@dataclass(frozen=True)
class Judged:
    """Hold one limit of a case, the figure it judges (None: not computed) and whether it is met."""

    path: str
    limit: float
    value: float | None
    met: bool


def limits_of(result: Result) -> dict[str, float]:
    """Return the accept limits that a result's case states, by the figure's path; raises InputError when the case
    stored cannot be read."""
    block = ACCEPT.search(result.resolved_yaml)
    if block is None:
        return {}
    node, faults = parse(block[0], Source(str(result.path), result.path.parent))
    limits = node.value["accept"].value if node is not None and isinstance(node.value, dict) else None
    if faults or not isinstance(limits, dict):
        raise InputError(f"{result.path}: the accept limits stored in it cannot be read; run the case again.")
    return {path: float(str(limit.value)) for path, limit in limits.items()}


def judge(result: Result) -> list[Judged]:
    """Return each accept limit of a result with its figure; a signed figure is limited either way, one of several
    storeys by its largest."""
    return [_judged(path, limit, result) for path, limit in limits_of(result).items()]


def _judged(path: str, limit: float, result: Result) -> Judged:
    name, _, index = path.partition("[")
    values = np.atleast_1d(np.asarray(result.metrics.get(name, []), dtype=float))
    if index:
        values = values[int(index[:-1]) - 1 : int(index[:-1])]
    if values.size == 0:
        return Judged(path, limit, None, False)
    value = float(values[np.argmax(np.abs(values))])
    return Judged(path, limit, value, abs(value) <= limit)
