"""Model-based feedforward: the inverse of the identified table from command to displacement, made proper.

    C(s) = L(s) / G(s),  G(s) = gain prod(s - z) / prod(s - p) without its delay and the two zeros at the origin,

with a Bessel low pass L(s) of as many poles as G has more than zeros, which is late by `low_pass_s`. The model's delay
is not inverted: state `lead_samples` near (delay + low_pass_s) / dt. A table with a zero in the right half plane has no
stable inverse and is refused. `FF` is the same inverse, driven by acceleration, velocity and displacement, with the
remaining part of a sample in the low pass and the lead that belongs to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.feedforward import low_pass_poles
from rths_cli.control.state_space import discretise, from_roots
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "J. E. Carrion, B. F. Spencer: Model-based strategies for real-time hybrid testing. Newmark Structural Engineering "
    "Laboratory Report 6, University of Illinois (2007)"
)
OPTIONS = {"low_pass_s": (0.001, 0.0001, 0.1, "delay of the low pass that makes the inverse proper")}
LEAST_HZ = 0.05  # below it a zero counts as one of the double derivative


def design(plant: Plant, options: dict[str, float | None]) -> Block:
    """Return the inverse in discrete time, for straight lines between the samples of the desired displacement."""
    model = plant.model
    finite = model.zeros[np.abs(model.zeros) > 2.0 * np.pi * LEAST_HZ]
    if len(model.zeros) - len(finite) != 2:
        raise InputError("controller: model_based needs a table model with two zeros at the origin; use another kind")
    if np.any(finite.real >= 0.0):
        fastest = float(np.abs(finite[finite.real >= 0.0]).min()) / (2.0 * np.pi)
        raise InputError(
            f"controller: model_based has no stable inverse: the identified table has a zero at {fastest:.3g} Hz in "
            "the right half plane; use another kind"
        )
    low_pass = low_pass_poles(float(options["low_pass_s"] or 0.0), len(model.poles) - len(finite))
    gain = float(np.real(np.prod(-low_pass))) / model.gain
    inverse = from_roots(model.poles, np.concatenate([finite, low_pass]), gain)
    return discretise(inverse, plant.dt_s, "foh", "model_based", ("desired_disp_m",), ("command_v",))
