"""The RTHS step in plain numpy, to be read beside its equations: an oracle for the compiled step, and far slower.

It does what loop/step.py does, in the same order, from the designed blocks as they are: no tiles, no modal coordinates,
no arrays that are shared. Left out are the excitation, whose command is given, and what each channel is expected to
show, which makes no command. The guard stands behind it and is no part of it.
"""

from __future__ import annotations

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.numerics.lti import Array, Block


class Running:
    """A discrete block with its state, from rest: y[k] = C x[k] + D u[k], x[k+1] = A x[k] + B u[k]."""

    def __init__(self, block: Block) -> None:
        self.A, self.B, self.C, self.D = block.A, block.B, block.C, block.D
        self.x = np.zeros(len(block.A))

    def outputs(self, u: Array) -> Array:
        """Return the outputs (p,) for the inputs (m,) of this instant; the state stays."""
        return self.C @ self.x + self.D @ u

    def advance(self, u: Array) -> None:
        """Take the state to the next instant."""
        self.x = self.A @ self.x + self.B @ u

    def __call__(self, u: Array) -> Array:
        """Return the outputs (p,) of this instant and go on to the next."""
        y = self.outputs(u)
        self.advance(u)
        return y


class ReferenceStep:
    """One RTHS step of one table with c channels (the table first), n_p samples ahead of it; a call is an instant.

    After a call `corrected` (c,) in m/s^2 and `estimated` (e,) are what the step found at t_k, `base_shear_n` and
    `interface` (3,) in m/s^2, m/s and m what it found for k + n_p.
    """

    def __init__(self, blocks: Blocks) -> None:
        self.blocks = blocks
        numerical, feedforward, feedback = blocks.linear_parts()
        self.correction, self.estimator = Running(blocks.correction), Running(blocks.estimator)
        self.numerical, self.feedforward, self.feedback = Running(numerical), Running(feedforward), Running(feedback)
        self.recent = np.zeros(blocks.lead_samples)  # desired accelerations d[k] .. d[k + n_p - 1]
        self.sent = np.zeros(max(blocks.latency_samples, 1) + 1)  # commands in V that left the guard, the latest first
        self.carried_v = 0.0  # rounding error of the last command
        self.corrected, self.estimated = np.zeros(len(blocks.correction.C)), np.zeros(len(blocks.estimator.C))
        self.base_shear_n, self.interface = 0.0, np.zeros(3)

    def __call__(self, samples_v: Array, source: Array, numerical: bool = True) -> float:
        """Return the command in V for the samples (c,) of t_k.

        `source` (3,): ground acceleration, velocity and displacement at k + n_p; without `numerical` the motion that
        the table is to make.
        """
        self.sense(samples_v)
        self.interface = self.advance_numerical(source) if numerical else source.copy()
        desired = np.append(self.recent, self.interface[0])  # d[k] .. d[k + n_p]
        forward = float(self.feedforward(self.interface)[0])
        command = forward + self.feed_back(desired[0] - self.corrected[0], forward)
        self.recent = desired[1:]
        return self.shape(command)

    def sense(self, samples_v: Array) -> None:
        """Correct the samples for their sensors, take the held command's alias out of the table's, and estimate the
        specimen's state."""
        b, (now, before) = self.blocks, self.sent[-2:]
        self.corrected = self.correction(samples_v)
        self.corrected[0] -= b.ripple_m_s2_per_v * (now - before) + b.ripple_sum_m_s2_per_v * (now + before)
        self.estimated = self.estimator(self.corrected)

    def advance_numerical(self, ground: Array) -> Array:
        """Return acceleration, velocity and displacement (3,) of the interface floor at k + n_p, absolute (Eq. 2.3).

        The acceleration d in m/s^2 depends on the base shear f in N (Eq. 2.6), and f on d of the same instant:

            d = free + D f,    f = known + F d.

        D is the numerical substructure's direct response to f, in m/s^2 per N. F is the weight of d in the force, in N
        per m/s^2.
        """
        direct = self.numerical.D[0, 1]
        estimates, recent, samples, desired = self.blocks.interface.force.of_one()
        known = estimates @ self.estimated + recent @ self.recent + samples @ self.corrected
        free = self.numerical.outputs(np.array([ground[0], 0.0]))[0]
        shear = (known + desired * free) / (1.0 - desired * direct)
        motion = self.numerical(np.array([ground[0], shear])) + np.array([0.0, ground[1], ground[2]])
        self.base_shear_n = float(shear)
        return motion

    def feed_back(self, error: float, forward: float) -> float:
        """Return the feedback's part of the command in V, kept within its own limit and the command's range.

        The feedback is told what was taken off it (anti-windup). A feedforward beyond the range is left to the guard.
        """
        b, given = self.blocks, np.zeros(self.feedback.B.shape[1])
        given[0] = error
        wanted = float(self.feedback.outputs(given)[0])
        highest = min(b.feedback_limit_v, max(b.command_limit_v - forward, 0.0))
        lowest = max(-b.feedback_limit_v, min(-b.command_limit_v - forward, 0.0))
        applied = min(max(wanted, lowest), highest)
        if len(given) > 1:
            given[1] = applied - wanted
        self.feedback.advance(given)
        return applied

    def shape(self, command: float) -> float:
        """Round to the converter's bits and carry the rounding error over to the next sample."""
        size = self.blocks.shaping_step_v
        if size == 0.0 or not np.isfinite(command):
            return command
        wanted = command + self.carried_v
        rounded = float(np.floor(wanted / size + 0.5)) * size
        self.carried_v = wanted - rounded
        return rounded

    def note_sent(self, command: float) -> None:
        """Store the command that left the guard: later samples contain the alias of its hold."""
        self.sent = np.append(command, self.sent[:-1])
