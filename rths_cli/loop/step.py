"""The one RTHS step, compiled: from the samples of t_k to a command, in the order of its blocks.

The same function runs for every source, rig and clock. Nothing in it allocates, blocks or logs.
"""

from __future__ import annotations

import math

import numpy as np

from rths_cli.loop.modal_substructure import advance_modal, read_modal
from rths_cli.loop.step_arrays import EXCITATION, NUMERICAL, Channels, Linear, Step
from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import copied, product, shifted


@part
def apply(block: Linear) -> None:
    """Write outputs and next state of a block for the inputs in its `given`, and make the next state its state."""
    product(block.matrix, block.given.size, block.given, block.made)
    copied(block.states, block.made, block.given)


@part
def correct(channels: Channels, samples: Array, accel: Array) -> None:
    """Correct the samples (c,) in V of every channel for its sensor; write accelerations (c,) in m/s^2."""
    matrix, given = channels.matrix, channels.given
    for c in range(samples.size):
        given[c, 3] = samples[c]
        last, before, total, corrected = 0.0, 0.0, 0.0, 0.0
        for j in range(4):
            value = given[c, j]
            last += matrix[c, j, 0] * value
            before += matrix[c, j, 1] * value
            total += matrix[c, j, 2] * value
            corrected += matrix[c, j, 3] * value
        given[c, 0], given[c, 1], given[c, 2] = last, before, total
        accel[c] = corrected


@part
def staircase_of(s: Step) -> float:
    """Return the alias of the held command in the table sample of this instant, in m/s^2."""
    now, before = s.sent[s.sent.size - 2], s.sent[s.sent.size - 1]
    return s.ripple_m_s2_per_v * (now - before) + s.ripple_sum_m_s2_per_v * (now + before)


@part
def sense(s: Step) -> None:
    """Correct the samples for sensors and for the held command's alias, and estimate the specimen's motion."""
    correct(s.correction, s.samples, s.corrected)
    s.corrected[0] -= staircase_of(s)
    apply(s.estimator)


@part
def expect(s: Step) -> None:
    """Write the acceleration that each channel is expected to show.

    For the table it is the desired acceleration. For a floor it is the response of the identified specimen, in open
    loop, to the table's motion. The estimate is not used, because it follows the channel that is judged.
    """
    block, known = s.open_loop, s.open_loop.made.size > 0
    block.given[0, block.states], block.given[1, block.states] = s.recent[0], s.corrected[0]
    for i in range(2):
        product(block.matrix, block.given.shape[1], block.given[i], block.made[i])
        copied(block.states, block.made[i], block.given[i])
        s.expected[i, 0] = s.interface[0]
        for c in range(1, s.expected.shape[1]):
            s.expected[i, c] = block.made[i, block.states + c - 1] if known else s.interface[0]


@part
def advance_numerical(s: Step, drive: Array) -> None:
    """Advance the numerical substructure to k + n_p: absolute interface motion and base shear.

    Desired acceleration and base shear of the same instant depend on each other by two scalar equations, which are
    solved here.
    """
    block, ground_accel = s.numerical, drive[0]
    known = s.estimator.made[s.estimator.states + s.estimated.size]
    for i in range(s.shear_recent.size):
        known += s.shear_recent[i] * s.recent[i]
    read_modal(block)
    direct = block.direct
    free = block.made[0] + direct[0, 0] * ground_accel + direct[0, 1] * known
    shear = known + s.shear_returned * free
    s.base_shear[0] = shear
    for i in range(3):
        s.interface[i] = block.made[i] + direct[i, 0] * ground_accel + direct[i, 1] * shear
    s.interface[1] += drive[1]
    s.interface[2] += drive[2]
    advance_modal(block, ground_accel, shear)


@part
def shape(s: Step, command: float) -> float:
    """Round to the converter's bits, carrying each rounding error over to the next sample (first order)."""
    size = s.shaping[1]
    if size == 0.0 or not math.isfinite(command):
        return command
    wanted = command + s.shaping[0]
    rounded = np.floor(wanted * s.shaping[2] + 0.5) * size
    s.shaping[0] = wanted - rounded
    return rounded


@part
def feed_back(s: Step, forward: float) -> float:
    """Return the feedback's part of the command in V, clipped so that the command stays in its range.

    The feedback receives the difference between applied and requested part (anti-windup). A feedforward beyond the
    range is left to the guard; the feedback is not used to reduce it.
    """
    block = s.feedback
    if s.error.size > 1:
        s.error[1] = 0.0
    apply(block)
    wanted = block.made[block.states]
    highest = min(s.feedback_limit_v, max(s.command_limit_v - forward, 0.0))
    lowest = max(-s.feedback_limit_v, min(-s.command_limit_v - forward, 0.0))
    applied = highest if wanted > highest else lowest if wanted < lowest else wanted
    if s.error.size > 1 and applied != wanted:
        s.error[1] = applied - wanted
        for i in range(block.states):
            block.given[i] += s.shortfall[i] * s.error[1]
    return applied


@part
def note_sent(s: Step, command: float) -> None:
    """Store the command that left the guard; later samples contain the alias of its hold."""
    for i in range(s.sent.size - 1, 0, -1):
        s.sent[i] = s.sent[i - 1] + 0.0
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
        advance_numerical(s, drive)
    else:
        for i in range(s.interface.size):
            s.interface[i] = drive[i]
    s.recent[lead] = s.interface[0]
    s.error[0] = s.recent[0] - s.corrected[0]
    expect(s)
    apply(s.feedforward)
    forward = s.feedforward.made[s.feedforward.states]
    shifted(s.recent)
    return shape(s, forward + feed_back(s, forward))
