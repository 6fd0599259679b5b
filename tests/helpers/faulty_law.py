"""A user's own law that lacks one property of a law, by its first parameter."""

from __future__ import annotations

import math
from typing import Any

PARAMETERS = ("fault", "rounds", "declared")
STATES = 1
NONE, CHANGES, READS, LEAVES, INFINITE, STEEP, AT_REST, TANGENT, BEYOND, JUMPS, DASHPOT = range(11)


def force(parameters: Any, state: Any, next_state: Any, drift_m: float, velocity_m_s: float) -> float:
    fault, value = parameters[0], 1e5 * drift_m**3
    if fault == READS:
        value *= 1.0 + next_state[0]
    if fault != LEAVES:
        next_state[0] = drift_m
    if fault == CHANGES:
        state[0] = drift_m
    if fault == INFINITE and drift_m > 0.01:
        return math.inf
    if fault == STEEP:
        return 10.0 * value
    if fault == AT_REST:
        return value + 1.0
    if fault == TANGENT:
        return value + 5.0 * drift_m
    if fault == BEYOND:
        return value + state[7]
    if fault == JUMPS and drift_m > 0.01:
        return value + 100.0
    if fault == DASHPOT:
        return value + 5.0 * velocity_m_s
    for i in range(int(parameters[1])):
        value += 1e-300 * drift_m * math.sin(drift_m + i)
    return value


def tangents(parameters: Any) -> Any:
    right = (0.0, 3e5 * 0.02**2)
    return (right, (1.0, 2.0), (0.0, math.inf), (0.0, 0.0, 2.0, 1.0), 0.0, None)[int(parameters[2])]
