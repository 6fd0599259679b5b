"""The RTHS step in plain numpy, to be read beside its equations: an oracle for the compiled step, and far slower.

It does what loop/step.py does, in the same order, from the designed blocks as they are: no tiles, no modal coordinates,
no arrays that are shared. Left out are the excitation, whose command is given, and what each channel is expected to
show, which makes no command. The guard stands behind it and is no part of it.
"""

from __future__ import annotations

import numpy as np

from rths_cli.control.designed_blocks import Blocks, with_cell
from rths_cli.control.interface import COMMANDED
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
    """One RTHS step of c channels (the first table's first), i degrees of freedom of the interface and a commands, n_p
    samples ahead of the tables; a call is an instant.

    Behind the c accelerometers stand the f further channels. After a call `corrected` (c + f,) and `estimated` (e,) are
    what the step found at t_k, `force_n` (i,) and `interface` (3, i) in m/s^2, m/s and m what it found for k + n_p.
    """

    def __init__(self, blocks: Blocks) -> None:
        self.blocks = blocks
        interface, axes = blocks.interface, len(blocks.interface.channels)
        numerical, feedforward, feedback = blocks.linear_parts()
        estimator, self.with_cell = blocks.estimator, interface
        if blocks.cell is not None:
            estimator, self.with_cell = with_cell(blocks, blocks.cell)
        self.correction, self.estimator = Running(blocks.correction), Running(estimator)
        self.further = None if blocks.further is None else Running(blocks.further)
        self.numerical, self.feedforward, self.feedback = Running(numerical), Running(feedforward), Running(feedback)
        self.measured_by = list(interface.channels)
        self.commanded = COMMANDED[interface.commanded]  # row of the motion
        self.recent = np.zeros((blocks.lead_samples, axes))  # desired accelerations d[k] .. d[k + n_p - 1]
        self.awaited = np.zeros((blocks.lead_samples, axes))  # the same of the motion that is commanded
        # commands in V that left the guard, the latest first
        self.sent = np.zeros((max(blocks.latency_samples, 1) + 1, interface.actuators))
        self.carried_v = np.zeros(interface.actuators)  # rounding errors of the last commands
        beside = 0 if blocks.further is None else len(blocks.further.C)
        self.corrected = np.zeros(len(blocks.correction.C) + beside)
        self.estimated = np.zeros(len(blocks.estimator.C))
        self.force_n, self.interface = np.zeros(axes), np.zeros((3, axes))

    def __call__(self, samples_v: Array, source: Array, numerical: bool = True) -> Array:
        """Return the commands (a,) in V for the samples (c + f,) of t_k.

        `source` (3,): ground acceleration, velocity and displacement at k + n_p; without `numerical` the motion that
        the tables are to make.
        """
        self.sense(samples_v)
        self.interface = self.advance_numerical(source) if numerical else np.outer(source, np.ones(self.force_n.size))
        awaited = np.vstack([self.awaited, self.interface[self.commanded]])  # of k .. k + n_p
        own = self.corrected[: len(self.blocks.correction.C)]
        inputs = np.append(self.interface.ravel(), own)[: self.feedforward.B.shape[1]]
        forward = self.feedforward(inputs)
        command = forward + self.feed_back(awaited[0] - self.corrected[self.measured_by], forward)
        self.recent, self.awaited = np.vstack([self.recent, self.interface[0]])[1:], awaited[1:]
        return self.shape(command)

    def sense(self, samples_v: Array) -> None:
        """Correct the samples for their sensors, take the held commands' alias out of the tables', and estimate the
        specimen's state."""
        b, (now, before) = self.blocks, self.sent[-2:]
        own = len(b.correction.C)
        beside = np.zeros(0) if self.further is None else self.further(samples_v[own:])
        self.corrected = np.append(self.correction(samples_v[:own]), beside)
        alias = b.ripple_m_s2_per_v * (now - before) + b.ripple_sum_m_s2_per_v * (now + before)
        self.corrected[self.measured_by] -= alias
        if b.cell is not None:  # the plate on the load cell feels the alias too
            self.corrected[own + b.cell.channel] -= b.cell.reads[0] * alias[0]
        self.estimated = self.estimator(self.corrected[: self.estimator.B.shape[1]])

    def advance_numerical(self, ground: Array) -> Array:
        """Return accelerations, velocities and displacements (3, i) of the interface at k + n_p, absolute (Eq. 2.3).

        The accelerations d in m/s^2 depend on the forces f in N (Eq. 2.6), and f on d of the same instant:

            d = free + D f,    f = known + F d.

        D is the numerical substructure's direct response to f, in m/s^2 per N. F is the weight of d in the forces, in N
        per m/s^2.
        """
        weights, axes = self.with_cell.force, self.force_n.size
        direct = self.numerical.D[:axes, 1:]
        known = weights.estimates @ self.estimated + weights.samples @ self.corrected[: weights.samples.shape[1]]
        known = known + np.einsum("ikj,kj->i", weights.recent, self.recent)
        free = self.numerical.outputs(np.append(ground[0], np.zeros(axes)))[:axes]
        self.force_n = np.linalg.solve(np.eye(axes) - weights.desired @ direct, known + weights.desired @ free)
        relative = self.numerical(np.append(ground[0], self.force_n)).reshape(3, axes)
        return relative + np.array([[0.0], [ground[1]], [ground[2]]])

    def feed_back(self, error: Array, forward: Array) -> Array:
        """Return the feedback's part (a,) of the commands in V, kept within its own limit and the commands' range.

        The feedback is told what was taken off it (anti-windup). A feedforward beyond the range is left to the guard.
        """
        b, given = self.blocks, np.zeros(self.feedback.B.shape[1])
        given[: error.size] = error
        wanted = self.feedback.outputs(given)
        highest = np.minimum(b.feedback_limit_v, np.maximum(b.command_limit_v - forward, 0.0))
        lowest = np.maximum(-b.feedback_limit_v, np.minimum(-b.command_limit_v - forward, 0.0))
        applied = np.clip(wanted, lowest, highest)
        if given.size > error.size:
            given[error.size :] = applied - wanted
        self.feedback.advance(given)
        return applied

    def shape(self, command: Array) -> Array:
        """Round to the converter's bits and carry the rounding errors over to the next sample."""
        size = self.blocks.shaping_step_v
        if size == 0.0 or not np.isfinite(command).all():
            return command
        wanted = command + self.carried_v
        rounded = np.floor(wanted / size + 0.5) * size
        self.carried_v = wanted - rounded
        return rounded

    def note_sent(self, command: Array) -> None:
        """Store the commands (a,) that left the guard: later samples contain the alias of their hold."""
        self.sent = np.vstack([command, self.sent[:-1]])
