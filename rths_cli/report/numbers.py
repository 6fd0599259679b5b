"""Every number that is printed: its digits, its interval and uncertainty, and its value in JSON.

The format of a number is changed here and nowhere else: `six_wide` in the paper's tables, `three` in the answer,
`significant` and `percent` on the pages of commands, `rounded` in sentences. A number that is not finite is a dash.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.quantities import Interval


def listed(value: ArrayLike, interval: Interval | None, as_text: Callable[[float], str], between: str = " ") -> str:
    """Return the numbers of a figure as text, each with its interval in brackets, then the probability in percent."""
    texts = [as_text(item) for item in np.atleast_1d(np.asarray(value, dtype=float))]
    if interval is None:
        return between.join(texts)
    ends = ([_end(item, as_text) for item in np.atleast_1d(end)] for end in (interval.low, interval.high))
    bracketed = (f"{text} [{low}, {high}]" for text, low, high in zip(texts, *ends, strict=True))
    return f"{between.join(bracketed)} ({whole_percent(interval.probability)})"


def _end(value: float, as_text: Callable[[float], str]) -> str:
    return ("-inf" if value < 0.0 else "inf") if math.isinf(value) else as_text(value)


def whole_percent(probability: float) -> str:
    """Return a probability in whole percent, rounded down: a statement that claims no more than is known."""
    return f"{math.floor(round(100.0 * probability, 6))} %"


def json_value(value: object) -> Any:
    """Return a number or a list of numbers, with None for each that is not finite."""
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim:
        return [json_value(item) for item in numbers]
    return float(numbers) if np.isfinite(numbers) else None


def intervals_json(intervals: Mapping[str, Interval]) -> dict[str, dict[str, Any]]:
    """Return the ends and the probability of intervals by path; an end that is not finite is None."""
    return {
        path: {"low": json_value(one.low), "high": json_value(one.high), "probability": one.probability}
        for path, one in intervals.items()
    }


DASH = "-"  # a number that is not known
MOST_DECIMALS = 6
LARGEST_WRITTEN_OUT = 1e9


def six_wide(value: float) -> str:
    """Return a number in at most six characters and its sign, with four decimals if they fit."""
    size = abs(value)
    if not math.isfinite(value):
        return DASH
    if 0 < size < 1e-9 or size >= 9.95e98:
        return "<1e-9" if size < 1 else ">1e99"
    if size != 0 and (size < 5e-5 or size >= 99999.5):
        mantissa, _, exponent = f"{value:.1e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    for decimals, limit in ((4, 9.99995), (3, 99.9995), (2, 999.995), (1, 9999.95)):
        if size < limit:
            return f"{value:.{decimals}f}"
    return f"{value:.0f}"


def significant(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, all of those before the decimal point."""
    if not math.isfinite(value):
        return DASH
    if value != 0.0 and not 10.0**-MOST_DECIMALS <= abs(value) < LARGEST_WRITTEN_OUT:
        return f"{value:.{digits - 1}e}"
    exponent = math.floor(math.log10(float(f"{abs(value):.{digits - 1}e}"))) if value else 0
    return f"{value:.{max(digits - 1 - exponent, 0)}f}"


def three(value: float) -> str:
    """Return a number with three significant digits and no more, without an exponent where it is of ordinary size."""
    rounded = float(f"{value:.3g}")  # which may carry into another power of ten
    if rounded == 0.0:
        return "0"
    return f"{rounded:.2e}" if math.isfinite(value) and not 1e-4 <= abs(rounded) < 1e5 else significant(rounded)


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with at most `digits` significant digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else DASH


def percent(share: float) -> str:
    """Return a fraction in percent."""
    return significant(100.0 * share)


def milliseconds(seconds: float) -> str:
    """Return a time in ms with three decimals, without a minus sign before zero."""
    return f"{round(1e3 * seconds, 3) + 0.0:.3f}"


def with_uncertainty(value: float, standard: float, scale: float = 1.0) -> str:
    """Return value +- two standard uncertainties, with two digits of the uncertainty and as many decimals of the value.

    Both are multiplied by `scale`; an unknown number is a dash.
    """
    value, spread = scale * value, 2.0 * abs(scale * standard)
    if not math.isfinite(value):
        return DASH
    if not math.isfinite(spread):
        return f"{significant(value, 5)} +- {DASH}"
    if abs(value) >= LARGEST_WRITTEN_OUT or spread >= LARGEST_WRITTEN_OUT:
        return f"{value:.4e} +- {spread:.1e}"
    least = 10.0**-MOST_DECIMALS
    if spread < least:
        return f"{value:.{MOST_DECIMALS}f} +- <{least:.{MOST_DECIMALS}f}"
    decimals = min(1 - math.floor(math.log10(float(f"{spread:.1e}"))), MOST_DECIMALS)
    shown = max(decimals, 0)
    return f"{round(value, decimals):.{shown}f} +- {round(spread, decimals):.{shown}f}"


def json_data(value: Any) -> Any:
    """Return a value for JSON: arrays and tuples as lists, numbers as Python numbers, None if not finite."""
    if isinstance(value, dict):
        return {key: json_data(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_data(value.tolist())
    if isinstance(value, list | tuple):
        return [json_data(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
