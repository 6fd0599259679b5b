"""A law of a storey for rths: a spring that yields, with kinematic hardening. It equals the law `bilinear`.

A structure file names it: law: {kind: own, file: yields.py, parameters: {...}, largest_drift_m: 0.02}
"""

PARAMETERS = ("stiffness_n_per_m", "yield_displacement_m", "hardening")
STATES = 1  # where the slider stands, in m


def force(parameters, state, next_state, drift_m, velocity_m_s):
    """Return the force in N beside the storey's spring, and write the state that holds from here on."""
    stiffness, limit, hardening = parameters
    slider = min(max(state[0], drift_m - limit), drift_m + limit)
    next_state[0] = slider
    return -(1.0 - hardening) * stiffness * slider


def tangents(parameters):
    """Return what it adds to the storey's stiffness in N/m: at the softest, at the stiffest."""
    stiffness, _, hardening = parameters
    return -(1.0 - hardening) * stiffness, 0.0
