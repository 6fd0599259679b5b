"""A user's own law that is one of several, by its first parameter."""

from __future__ import annotations

import math
from typing import Any

PARAMETERS = ("which", "a", "b", "c")
STATES = 2


def force(parameters: Any, state: Any, next_state: Any, drift_m: float, velocity_m_s: float) -> float:
    which, a, b, c = parameters
    next_state[0] = next_state[1] = 0.0
    if which == 0.0:  # a spring a that yields at b, with hardening c
        slider = min(max(state[1], drift_m - b), drift_m + b)
        next_state[1] = slider
        return -(1.0 - c) * a * slider
    if which == 1.0:  # a u^3 up to b
        return a * drift_m**3
    if which == 2.0:  # a u^3 up to b beside a damper of at most 5 N
        return a * drift_m**3 + 5.0 * math.tanh(velocity_m_s / c)
    size = abs(velocity_m_s)  # a abs(v)^b, straight below c
    return a * c ** (b - 1.0) * velocity_m_s if size <= c else math.copysign(a * size**b, velocity_m_s)


def tangents(parameters: Any) -> tuple[float, ...]:
    which, a, b, c = parameters
    if which == 0.0:
        return -(1.0 - c) * a, 0.0
    if which < 3.0:
        return 0.0, 3.0 * a * b**2, 0.0, (5.0 / c if which == 2.0 else 0.0)
    return 0.0, 0.0, 0.0, a * c ** (b - 1.0)
