"""The force of a joint that sticks like a spring and then slides: the element of which hysteresis is made."""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.lti import Array


def slid(displacement: Array, reach: float) -> Array:
    """Return the force (n,) of a joint at displacements (n,): it sticks over `reach`, in their unit, and slides at 1.

    It begins without force at a displacement of zero.
    """
    force, found = 0.0, list[float]()
    for step in (np.diff(displacement, prepend=0.0) / (reach or 1.0)).tolist():
        force += step
        if force > 1.0:  # min and max would take three times as long
            force = 1.0
        elif force < -1.0:
            force = -1.0
        found.append(force)
    return np.array(found, dtype=float)
