"""The accept limits of a stored result, read from the case in its file and judged, for JSON and JUnit."""

from __future__ import annotations

import re

from rths_cli.analysis import accept_limits
from rths_cli.case.yaml_reader import parse
from rths_cli.case.yaml_tree import Source
from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.report.result_scale import in_model_scale

ACCEPT = re.compile(r"^accept:.*\n(?:[ -].*\n)*", re.MULTILINE)


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


def judge(result: Result) -> list[accept_limits.Judged]:
    """Return the judged accept limits of a result, in model scale; raises InputError if they cannot be read."""
    stored = in_model_scale(result).metrics
    return [
        accept_limits.judge(path, limit, stored.get(accept_limits.figure(path), []))
        for path, limit in limits_of(result).items()
    ]
