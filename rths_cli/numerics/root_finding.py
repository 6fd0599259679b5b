"""Zero or maximum of a function of one number between two ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

_MOST_STEPS = 200
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def crossing(function: Callable[[float], float], low: float, high: float, relative: float = 1e-12) -> float:
    """Return where a continuous function is zero, to `relative` of the place; its signs at the ends must differ.

    The place is bracketed all the way, and every step at least halves what is left. Raises ValueError where both ends
    have one sign. Source: Ridders, IEEE Trans. Circuits Syst. 26 (1979) 979.
    """
    at_low, at_high = function(low), function(high)
    if at_low == 0.0 or at_high == 0.0:
        return low if at_low == 0.0 else high
    if not at_low * at_high < 0.0:
        raise ValueError(f"no sign change between {low:g} and {high:g}")
    for _ in range(_MOST_STEPS):
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        if at_middle == 0.0 or abs(high - low) <= 2.0 * relative * abs(middle):
            return middle
        ahead = (middle - low) * at_middle / math.sqrt(at_middle**2 - at_low * at_high)
        place = middle + (ahead if at_low > at_high else -ahead)
        value = function(place)
        ends = [(low, at_low), (middle, at_middle), (place, value), (high, at_high)]
        ends.sort()
        if value == 0.0:
            return place
        (low, at_low), (high, at_high) = next((a, b) for a, b in pairwise(ends) if a[1] * b[1] < 0)
    return 0.5 * (low + high)


def summit(function: Callable[[float], float], low: float, high: float, relative: float = 1e-7) -> float:
    """Return where a function with one maximum between the ends has it, by golden section.

    The place is good to `relative` of the distance of the ends, the value to about its square.
    """
    inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_inner, at_outer = function(inner), function(outer)
    least = relative * (high - low)
    while high - low > least:
        if at_inner >= at_outer:
            high, outer, at_outer = outer, inner, at_inner
            inner = high - _GOLDEN * (high - low)
            at_inner = function(inner)
        else:
            low, inner, at_inner = inner, outer, at_outer
            outer = low + _GOLDEN * (high - low)
            at_outer = function(outer)
    return 0.5 * (low + high)
