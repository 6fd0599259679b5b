"""Phase lead: one zero and one pole on the desired displacement,

    C(s) = (1 + (lead_s + T) s) / (1 + T s),  T = 1 / (2 pi pole_hz),

discretised by Tustin's rule. It leads by `lead_s` at low frequency and has the gain (lead_s + T) / T far above its
pole, so that a pole that is too high makes it loud. Its gain is above 1 wherever it leads: a table whose response
falls with frequency is helped, one with a pure delay is driven too far by (lead_s w)^2 / 2 and more.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "J. Zhao, C. French, C. Shield, T. Posbergh: Considerations for the development of real-time dynamic testing using "
    "servo-hydraulic actuation. Earthquake Engineering and Structural Dynamics 32 (2003) 1773-1794"
)
OPTIONS = {
    "lead_s": (None, 0.0, 0.5, "lead at low frequency; default: the table's lag in the compared band, as identified"),
    "pole_hz": (60.0, 0.1, 5000.0, "frequency of the pole in Hz"),
}


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the lead in discrete time."""
    lead_s = max(plant.lag_s, 0.0) if options["lead_s"] is None else options["lead_s"]
    late = 1.0 / (2.0 * math.pi * float(options["pole_hz"] or 0.0))
    half, ahead = 0.5 * plant.dt_s, late + lead_s
    pole, direct = (late - half) / (late + half), (ahead + half) / (late + half)
    rest = (half - ahead) / (late + half) + pole * direct  # y = direct u + rest u / (z - pole)
    one = np.ones((1, 1))
    return plant.block(Block("lead", pole * one, one, rest * one, direct * one, plant.dt_s))
