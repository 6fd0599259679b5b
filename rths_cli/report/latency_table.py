"""The latency budget of a result as a text table: each delay, its compensation and its remainder."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.numerics.lti import Array
from rths_cli.report.numbers import with_uncertainty
from rths_cli.report.text_layout import width, wrapped

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
LABEL, COLUMN, BY = 15, 8, 17
NARROW = 7  # characters of a column on a narrow page


def latency_text(metrics: Mapping[str, ArrayLike]) -> str:
    """Return the table of latencies in ms with their sums, and the delay identified on the rig; "" without latencies.

    `metrics`: metrics of a result by path (`latency.total_s`, ...).
    """
    if "latency.total_s" not in metrics or "latency.frequency_hz" not in metrics:
        return ""
    frequency = np.atleast_1d(np.asarray(metrics["latency.frequency_hz"], dtype=float))
    shown = [int(np.abs(frequency - hz).argmin()) for hz in frequency[-1] * np.array(LEFT_SHARES)]
    heads = [f"{hz:g} Hz" for hz in frequency]
    left_heads = [f"left {heads[shown[0]]}", heads[shown[1]]]
    rows = [_line("", heads, "taken out by", left_heads)]
    if len(rows[0]) > width():
        return _in_two(metrics, heads, left_heads, shown)
    for name, label in ITEMS.items():
        delay, stays = _values(metrics, f"latency.{name}_s"), _values(metrics, f"latency.{name}_left_s")
        rows.append(_line(label, _ms(delay), _taken_out_by(name, metrics), _ms(stays[shown])))
    rule = "-" * len(rows[0])
    sums = [_line(label, _ms(_values(metrics, f"latency.{name}_s")), "", []) for name, label in SUMS.items()]
    title = "Latency of the loop (ms by frequency; negative is early)"
    return "\n".join([title, rule, rows[0], rule, *rows[1:], rule, *sums, rule, wrapped(_identified(metrics))])


def _in_two(metrics: Mapping[str, ArrayLike], heads: list[str], left_heads: list[str], shown: list[int]) -> str:
    """Return the table on a narrow page: first the latencies, then what takes them out and what is left."""

    def narrow(label: str, cells: list[str]) -> str:
        return label.ljust(LABEL) + "".join(cell.rjust(NARROW) for cell in cells)

    named = {**ITEMS, **SUMS}
    first = [narrow(label, _ms(_values(metrics, f"latency.{name}_s"))) for name, label in named.items()]
    second = [
        _line(label, [], _taken_out_by(name, metrics), _ms(_values(metrics, f"latency.{name}_left_s")[shown]))
        for name, label in ITEMS.items()
    ]
    top, rule = narrow("", heads), "-" * len(narrow("", heads))
    title = "Latency of the loop (ms by frequency; negative is early)"
    lines = [title, rule, top, rule, *first, rule, _line("", [], "taken out by", left_heads), rule, *second, rule]
    return "\n".join([*lines, wrapped(_identified(metrics))])


def _values(metrics: Mapping[str, ArrayLike], path: str) -> Array:
    return np.atleast_1d(np.asarray(metrics[path], dtype=float))


def _number(metrics: Mapping[str, ArrayLike], path: str) -> float:
    return float(_values(metrics, path)[0])


def _ms(seconds: Array) -> list[str]:
    """Return times (n,) in s as texts in ms with three decimals, without a minus sign before zero."""
    return [f"{round(1e3 * value, 3) + 0.0:.3f}" for value in seconds]


def _line(label: str, cells: list[str], by: str, left: list[str]) -> str:
    text = label.ljust(LABEL) + "".join(cell.rjust(COLUMN) for cell in cells) + "  " + by.ljust(BY)
    return (text + "".join(cell.rjust(COLUMN + 1) for cell in left)).rstrip()


def _taken_out_by(name: str, metrics: Mapping[str, ArrayLike]) -> str:
    """Return the block that compensates an item, "-" if the item is zero or not compensated."""
    delay, left = _values(metrics, f"latency.{name}_s"), _values(metrics, f"latency.{name}_left_s")
    if np.allclose(delay, left, rtol=1e-6, atol=SAME_S):
        return "-"
    if name in ("sensor", "coupling"):
        return "sensor correction" if np.any(left) else "inverse"
    return "prediction" if _number(metrics, "latency.predicted_s") > 0.0 else "inverse"


def _identified(metrics: Mapping[str, ArrayLike]) -> list[str]:
    """Return the lines on the prediction and on the declared and identified delay of converter, hold and transport."""
    lead, declared = (_number(metrics, f"latency.{name}_s") for name in ("predicted", "declared"))
    first = f"Prediction: {1e3 * lead:.3f} ms. Converter, hold and transport: {1e3 * declared:.3f} ms declared"
    if "latency.identified_s" not in metrics:
        return [f"{first}; none was identified."]
    found, error = (_number(metrics, f"latency.{name}_s") for name in ("identified", "identified_error"))
    return [f"{first}, {with_uncertainty(found, error, 1e3)} ms (2 standard uncertainties) identified on the rig."]
