"""The findings of a result: why a run was refused, and its warnings, as its file holds them."""

from __future__ import annotations

from dataclasses import replace

from rths_cli.files.result_reader import Result
from rths_cli.findings import Finding, from_json


def stored_findings(result: Result) -> tuple[Finding, ...]:
    """Return the findings of a result, () of a file without codes."""
    return from_json(str(result.attributes.get("findings") or ""))


def without_run(result: Result, reason: str) -> str:
    """Return the reason of a refusal without the name of the run, if that is EXP-RTHS."""
    for one in stored_findings(result):
        if one.code == "run.refused" and one.values.get("run") == "EXP-RTHS" and reason.startswith(str(one)):
            return str(replace(one, values={**one.values, "run": None})) + reason[len(str(one)) :]
    return reason
