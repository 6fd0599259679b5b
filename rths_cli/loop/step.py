"""The one RTHS step, compiled: from the samples of t_k to a command (DESIGN.md section 5).

The same function runs for every source, rig and clock. Nothing in it allocates, blocks or logs.
"""

from __future__ import annotations

import math

from rths_cli.compiled import part
from rths_cli.loop.blocks import EXCITATION, NUMERICAL, Linear, Step
from rths_cli.lti import Array


@part
def read_out(block: Linear, u: Array, y: Array) -> None:
    """Write y = C x + D u."""
    for i in range(y.size):
        value = 0.0
        for j in range(block.x.size):
            value += block.C[i, j] * block.x[j]
        for j in range(u.size):
            value += block.D[i, j] * u[j]
        y[i] = value


@part
def advance(block: Linear, u: Array) -> None:
    """Replace x by A x + B u."""
    for i in range(block.x.size):
        value = 0.0
        for j in range(block.x.size):
            value += block.A[i, j] * block.x[j]
        for j in range(u.size):
            value += block.B[i, j] * u[j]
        block.scratch[i] = value
    for i in range(block.x.size):
        block.x[i] = block.scratch[i]


@part
def sense(s: Step) -> None:
    """Correct the samples for sensors and staircase and estimate the specimen's motion."""
    read_out(s.correction, s.samples, s.corrected)
    advance(s.correction, s.samples)
    now, before = s.sent[s.sent.size - 2], s.sent[s.sent.size - 1]
    s.corrected[0] -= s.ripple_m_s2_per_v * (now - before) + s.ripple_sum_m_s2_per_v * (now + before)
    read_out(s.estimator, s.corrected, s.estimated)
    advance(s.estimator, s.corrected)


@part
def known_base_shear(s: Step) -> float:
    """Return the part of the base shear at k + n_p that does not wait for the desired acceleration there."""
    shear = 0.0
    for i in range(s.estimated.size):
        shear += s.shear_estimate[i] * s.estimated[i]
    for i in range(s.shear_recent.size):
        shear += s.shear_recent[i] * s.recent[i]
    for i in range(s.corrected.size):
        shear += s.shear_measured[i] * s.corrected[i]
    return shear


@part
def advance_numerical(s: Step, ground_accel: float) -> None:
    """Advance the numerical part to k + n_p: interface motion relative to the ground and base shear.

    Desired acceleration and base shear depend on each other at the same instant by two scalars, solved here.
    """
    known = known_base_shear(s)
    s.ground[0], s.ground[1] = ground_accel, known
    read_out(s.numerical, s.ground, s.interface)
    desired = s.interface[0] / (1.0 - s.numerical.D[0, 1] * s.shear_desired)
    s.ground[1] = known + s.shear_desired * desired
    read_out(s.numerical, s.ground, s.interface)
    advance(s.numerical, s.ground)


@part
def shape(s: Step, command: float) -> float:
    """Round to the converter's bits, carrying each rounding error over to the next sample (first order)."""
    size = s.shaping[1]
    if size == 0.0 or not math.isfinite(command):
        return command
    wanted = command + s.shaping[0]
    rounded = math.floor(wanted / size + 0.5) * size
    s.shaping[0] = wanted - rounded
    return rounded


@part
def apply_feedback(s: Step) -> None:
    """Clip the feedback's part so that the command stays in its range, and let the feedback know what was applied.

    A feedforward beyond the range is left to the guard: the feedback's part is then never made to oppose it.
    """
    forward, wanted = s.command[0], s.command[1]
    highest = min(s.feedback_limit_v, max(s.command_limit_v - forward, 0.0))
    lowest = max(-s.feedback_limit_v, min(-s.command_limit_v - forward, 0.0))
    if wanted > highest:
        s.command[1] = highest
    elif wanted < lowest:
        s.command[1] = lowest
    if s.error.size > 1:
        s.error[1] = s.command[1] - wanted
    advance(s.feedback, s.error)


@part
def note_sent(s: Step, command: float) -> None:
    """Keep the command that left the guard: later samples carry the staircase of its hold."""
    for i in range(s.sent.size - 1, 0, -1):
        s.sent[i] = s.sent[i - 1]
    s.sent[0] = command


@part
def step(s: Step, drive: Array) -> float:
    """Return the command in V for the samples in `s.samples`.

    `drive` (3,): absolute-motion source at k + n_p, that is ground acceleration, velocity and displacement, or
    for an excitation the command in V in its first place.
    """
    sense(s)
    if s.source == EXCITATION:
        return drive[0]
    lead = s.shear_recent.size
    if s.source == NUMERICAL:
        advance_numerical(s, drive[0])
        s.interface[1] += drive[1]
        s.interface[2] += drive[2]
    else:
        for i in range(s.interface.size):
            s.interface[i] = drive[i]
    s.recent[lead] = s.interface[0]
    s.error[0] = s.recent[0] - s.corrected[0]
    read_out(s.feedforward, s.interface, s.command[:1])
    advance(s.feedforward, s.interface)
    if s.error.size > 1:
        s.error[1] = 0.0
    read_out(s.feedback, s.error, s.command[1:])
    apply_feedback(s)
    for i in range(lead):
        s.recent[i] = s.recent[i + 1]
    return shape(s, s.command[0] + s.command[1])
