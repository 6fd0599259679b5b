"""A compensator that takes the table for a first-order lag and inverts it.

command = (d[k] + lag / dt (d[k] - d[k-1])) / gain, d being the desired displacement. docs/howto/own_controller.md tells
what holds for every compensator.
"""

SOURCE = "inverse of a first-order lag, as Chen and Ricles 2009"
OPTIONS = {"lag_s": (None, 0.0, 0.1, "lag of the table in s; default: as identified")}
STATES = 1  # the desired displacement of the last sample


def design(plant, options):
    """Return the gain in V per m, and the lag in samples."""
    lag_s = plant.lag_s if options["lag_s"] is None else options["lag_s"]
    return [1.0 / plant.gain_m_per_v, lag_s / plant.dt_s]


def command(parameters, state, next_state, desired, measured, sent):
    """Return the command in V."""
    per_metre, samples = parameters
    next_state[0] = desired[2]
    return per_metre * (desired[2] + samples * (desired[2] - state[0]))
