"""Conditional adaptive time series: `ats` whose parameters follow only while the actuator moves enough to tell them.

A sample counts, and the memory fades, while the filtered displacement is at least `counts_m`; otherwise the parameters
stay where they are. Between two phases of motion nothing is forgotten, and noise at rest teaches nothing. The fit is
that of `ats`, with a fading memory in place of the recursive least squares of the source. It needs a
measured displacement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.control.compensators import ats
from rths_cli.control.compensators.ats import ADAPTS, bounds, followed, linear
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

__all__ = ["ADAPTS", "OPTIONS", "SOURCE", "STATES", "bounds", "command", "design", "linear"]

SOURCE = (
    "A. Palacio-Betancur, M. Gutierrez Soto: Adaptive tracking control for real-time hybrid simulation of structures "
    "subjected to seismic loading. Mechanical Systems and Signal Processing 134 (2019) 106345"
)
OPTIONS = {**ats.OPTIONS, "counts_m": (2e-4, 0.0, 1.0, "displacement from which a sample counts")}
STATES = ats.STATES
COUNTS = 28  # place of the threshold behind the numbers of `ats`


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return the numbers of `ats`, and the threshold."""
    plant.needs_displacement("ats_conditional")
    return [*ats.design(plant, options), float(options["counts_m"] or 0.0)]


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command in m."""
    return followed(p, state, next_state, desired, measured, sent, p[COUNTS])
