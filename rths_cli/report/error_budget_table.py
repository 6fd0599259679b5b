"""The error of a hybrid test by cause as a text table: as predicted before the run, and as measured in it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.files.result_reader import Result
from rths_cli.report.text_layout import WIDTH, width, wrapped

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
LABEL, COLUMN = 18, 10
Metrics = Mapping[str, ArrayLike]


def named_causes(result: Result) -> str:
    """Return the named causes of the error in one sentence, "" for a result without them."""
    lines = str(result.attributes.get("error_causes", "")).splitlines()
    return f"Named causes of the error: {'; '.join(lines)}." if lines else ""


def budget_text(metrics: Metrics) -> str:
    """Return the table of RMS errors by cause, "" if the metrics contain no such errors.

    `metrics` by path: predicted ones from `check.*`, measured ones from `budget.*` and `exp_rths.*`. If not all storeys
    fit side by side on a page of 100 columns, the lowest ones and the highest one are shown.
    """
    predicted, measured = _has(metrics, "check"), _has(metrics, "budget")
    if not (predicted or measured):
        return ""
    kinds = [kind for kind, there in (("check", predicted), ("budget", measured)) if there]
    columns = _columns(metrics, kinds)
    beside = max((width() - LABEL) // (COLUMN * len(kinds)), 1)
    lines = ["Error by cause (RMS, mm/s^2, test band)"]
    for first in range(0, len(columns), beside):
        lines += _part(metrics, kinds, columns[first : first + beside])
    return "\n".join([*lines, *([wrapped([_fitted(metrics)])] if measured else [])])


def _part(metrics: Metrics, kinds: list[str], columns: list[int]) -> list[str]:
    """Return the lines of the table with some of its columns."""
    heads = [f"storey {column}" if column else "tracking" for column in columns]
    heads = [
        head if len(head) < COLUMN * len(kinds) else f"st. {column}"
        for head, column in zip(heads, columns, strict=True)
    ]
    top = "".join(f"{head:>{COLUMN * len(kinds)}}" for head in heads)
    words = "".join(f"{WORDS[kind]:>{COLUMN}}" for kind in kinds) * len(columns)
    rule = "-" * (LABEL + len(top))
    lines = [rule, f"{'':<{LABEL}}{top}", f"{'':<{LABEL}}{words}", rule]
    for cause, label in CAUSES.items():
        cells = [_cell(metrics, kind, cause, column) for column in columns for kind in kinds]
        if any(cell.strip() != "-" for cell in cells):
            lines.append(f"{label:<{LABEL}}{''.join(cells)}")
    whole = [_cell(metrics, kind, "", column) for column in columns for kind in kinds]
    return [*lines, rule, f"{'together':<{LABEL}}{''.join(whole)}", rule]


def _has(metrics: Metrics, kind: str) -> bool:
    return f"{kind}.rms_error_coupling_m_s2" in metrics


def _columns(metrics: Metrics, kinds: list[str]) -> list[int]:
    """Return the columns: 0 for tracking, then the numbers of the lowest storeys that fit and of the highest one."""
    storeys = np.atleast_1d(metrics[f"{kinds[0]}.rms_error_coupling_m_s2"]).size
    fit = (WIDTH - LABEL) // (COLUMN * len(kinds)) - 1
    shown = list(range(1, storeys + 1))
    return [0, *(shown if storeys <= fit else [*shown[: fit - 1], storeys])]


def _cell(metrics: Metrics, kind: str, cause: str, column: int) -> str:
    """Return an error in mm/s^2 as text; for the cause "", the total error, which is a metric of the run itself."""
    source = "exp_rths" if kind == "budget" and not cause else kind
    part = f"_{cause}" if cause else ""
    path = f"{source}.rms_error{part}_m_s2" if column else f"{source}.tracking_rms{part}_m_s2"
    if path not in metrics:
        return f"{'-':>{COLUMN}}"
    value = 1e3 * float(np.atleast_1d(np.asarray(metrics[path], dtype=float))[max(column - 1, 0)])
    return f"{value:>{COLUMN}.3f}" if abs(value) < 1e4 else f"{value:>{COLUMN}.2e}"


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
