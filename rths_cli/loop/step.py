"""The one RTHS step, compiled: from the samples of t_k to a command, in the order of its blocks.

The same function runs for every source, rig and clock. Nothing in it allocates, blocks or logs.
"""

from __future__ import annotations

import math

import numpy as np

from rths_cli.loop.adapted_states import hold
from rths_cli.loop.step_arrays import ACCELERATION, EXCITATION, NUMERICAL, Step
from rths_cli.numerics.compiled import kept_part, part
from rths_cli.numerics.lti import Array


@part
def staircase_of(s: Step, a: int) -> float:
    """Return the alias of a held command in the sample of its table at this instant, in the unit of that sample."""
    now, before = s.sent[s.sent.shape[0] - 2, a], s.sent[s.sent.shape[0] - 1, a]
    return s.ripple_m_s2_per_v * (now - before) + s.ripple_sum_m_s2_per_v * (now + before)


@part
def sense(s: Step) -> None:
    """Correct the samples for sensors and for the held commands' alias, and estimate the specimen's motion."""
    s.correction.correct(s.samples, s.corrected)
    for i in range(len(s.measured_by)):
        s.corrected[s.measured_by[i]] -= staircase_of(s, i)
    if s.cell >= 0:  # the plate on the cell feels the same
        s.corrected[s.cell] -= s.cell_reads[0] * staircase_of(s, 0)
    s.observer.observe(s.corrected, s.force)


@part
def advance_numerical(s: Step, ground: Array) -> None:
    """Advance the numerical substructure to k + n_p: interface force and absolute interface motion.

    Desired acceleration and force of the same instant depend on each other by linear equations, which are solved here.
    """
    direct = s.numerical.direct
    for i in range(len(s.measured_by)):
        for k in range(s.force_recent.shape[1]):
            for j in range(len(s.measured_by)):
                s.force[i] += s.force_recent[i, k, j] * s.recent[k, j]
    s.numerical.free(ground, s.free_accel)
    for i in range(len(s.measured_by)):
        for j in range(len(s.measured_by)):
            s.free_accel[i] += direct[i, j] * s.force[j]
    for i in range(len(s.measured_by)):
        for j in range(len(s.measured_by)):
            s.force[i] += s.force_returned[i, j] * s.free_accel[j]
    s.numerical.advance(ground, s.force, s.motion)


@part
def track(s: Step) -> None:
    """Store the desired motion of k + n_p, and write the tracking errors of t_k and what the channels must show."""
    lead = s.recent.shape[0] - 1
    for i in range(len(s.measured_by)):
        s.recent[lead, i] = s.motion[0, i]
        if s.commanded != ACCELERATION:
            s.recent_commanded[lead, i] = s.motion[s.commanded, i]
        s.error[i] = s.recent_commanded[0, i] - s.corrected[s.measured_by[i]]
    s.open_loop.expect(s.recent[0, 0], s.corrected[0], s.motion[0, 0], s.expected)
    for by in range(2):
        s.expected[by, 0] = s.motion[0, 0]
        for i in range(len(s.measured_by)):
            s.expected[by, s.measured_by[i]] = s.motion[s.commanded, i]


@part
def go_on(s: Step, recent: Array) -> None:
    """Move the desired motion (n_p + 1, i) one instant on."""
    for k in range(recent.shape[0] - 1):
        for i in range(len(s.measured_by)):
            recent[k, i] = recent[k + 1, i] + 0.0


@part
def compensate(s: Step) -> None:
    """Write the commands: the feedforward's part, and the feedback's part within its limits.

    The feedback's part is clipped so that the command stays in its range. A feedforward beyond the range is left to the
    guard; the feedback is not used to reduce it.
    """
    frozen = s.held.lost[0] != 0.0
    for a in range(len(s.actuators)):
        off, wanted = s.sent[0, a] - s.held.wanted[a], s.held.wanted[a]
        frozen = frozen or abs(off) > s.bit_v + 1e-9 * abs(wanted)
    s.feedforward.feed_forward(s.motion, s.accel, s.sent, s.forward)
    hold(s.held, frozen)
    s.held.lost[0] = 0.0
    for a in range(len(s.actuators)):
        limit, room = s.feedback_limit_v[a], s.command_limit_v[a]
        s.back_limits[0, a] = max(-limit, min(-room - s.forward[a], 0.0))
        s.back_limits[1, a] = min(limit, max(room - s.forward[a], 0.0))
    s.feedback.feed_back(s.error, s.back_limits[0], s.back_limits[1], s.back)
    for a in range(len(s.actuators)):
        s.command[a] = shape(s, a, s.forward[a] + s.back[a])
        s.held.wanted[a] = s.command[a] + 0.0


@part
def shape(s: Step, a: int, command: float) -> float:
    """Round to the converter's bits, carrying each rounding error over to the next sample (first order)."""
    if s.bit_v == 0.0 or not math.isfinite(command):
        return command
    wanted = command + s.carried[a]
    rounded = np.floor(wanted * s.bits_per_v + 0.5) * s.bit_v
    s.carried[a] = wanted - rounded
    return rounded


@part
def note_sent(s: Step) -> None:
    """Store the commands that left the guard; later samples contain the alias of their hold."""
    for a in range(len(s.actuators)):
        for i in range(s.sent.shape[0] - 1, 0, -1):
            s.sent[i, a] = s.sent[i - 1, a] + 0.0
        s.sent[0, a] = s.command[a]


@kept_part
def step(s: Step, drive: Array) -> None:
    """Write the commands in V for the samples in `s.samples`.

    `drive` (3,): absolute-motion source at k + n_p, that is ground acceleration, velocity and displacement, or
    for an excitation the commands in V in its first places.
    """
    sense(s)
    if s.source == EXCITATION:
        for a in range(len(s.actuators)):
            s.command[a] = drive[a]
        for i in range(len(s.measured_by)):
            s.force[i] = 0.0
        return
    if s.source == NUMERICAL:
        advance_numerical(s, drive)
    else:
        for i in range(len(s.measured_by)):
            s.force[i] = 0.0
            for q in range(3):
                s.motion[q, i] = drive[q]
    track(s)
    compensate(s)
    go_on(s, s.recent)
    if s.commanded != ACCELERATION:
        go_on(s, s.recent_commanded)
