"""The linear parts of the step: sensor correction, Kalman filter, feedforward (which may counter dry friction),
feedback."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rths_cli.control.displacement_interface import StoreysOfActuator
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.interface import Interface
from rths_cli.control.state_space import static
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part_class
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.tiled_products import copied, product, product_of_four, tiled

NOTHING = np.zeros(0)
ROUNDS = 12  # of the fixed point in `substitute`: each reduces the error to 1/8 at 1 kHz, 1/4 at 500 Hz


@part_class
class Linear(NamedTuple):
    """A discrete block as one product, n states, m inputs, p outputs: made = matrix @ given."""

    matrix: Array  # (tiles, n + m, 4), tiled_products.tiled
    given: Array  # (n + m,) state, then inputs; may be longer, the rest counts for nothing
    made: Array  # (4 tiles,) next state, then outputs, then zeros
    states: int

    def apply(self) -> None:
        """Write outputs and next state for the inputs in `given`, and make the next state the state."""
        product(self.matrix, self.matrix.shape[1], self.given, self.made)
        copied(self.states, self.made, self.given)


@part_class
class Channels(NamedTuple):
    """Small blocks of one input and one output each, up to three states, one per channel: made = matrix @ given."""

    matrix: Array  # (c, 4, 4) channel, column (three states, then the input), row (three next states, then the output)
    given: Array  # (c, 4)

    def correct(self, samples: Array, accel: Array) -> None:
        """Correct the samples (c,) in V of every channel for its sensor; write its values (c,) in their unit."""
        for c in range(samples.size):
            self.given[c, 3] = samples[c]
            last, before, total, corrected = product_of_four(self.matrix[c], self.given[c])
            self.given[c, 0], self.given[c, 1], self.given[c, 2] = last, before, total
            accel[c] = corrected


@part_class
class OpenLoop(NamedTuple):
    """A block of one input, n states and p outputs, run twice with two inputs; without outputs it is unknown."""

    matrix: Array  # (tiles, n + 1, 4), tiled_products.tiled
    given: Array  # (2, n + 1) state, then input
    made: Array  # (2, 4 tiles) next state, then outputs, then zeros
    states: int
    floors: int  # p

    def expect(self, desired: float, measured: float, unknown: float, expected: Array) -> None:
        """Write the accelerations (2, c) that the channels must show by the desired and by the measured motion of the
        table, both in m/s^2; where no specimen is known, `unknown`; nothing for channels that are no floor's."""
        known = self.made.size > 0
        self.given[0, self.states], self.given[1, self.states] = desired, measured
        for i in range(2):
            product(self.matrix, self.given.shape[1], self.given[i], self.made[i])
            copied(self.states, self.made[i], self.given[i])
            for c in range(1, self.floors + 1 if known else expected.shape[1]):
                expected[i, c] = self.made[i, self.states + c - 1] if known else unknown


@part_class
class KalmanFilter(NamedTuple):
    """The identified specimen's state and floor accelerations from the samples; the known force is a further output."""

    block: Linear  # corrected channels -> estimates (e,), then the known part of the interface force (i,)
    corrected: Array  # (c + f,) the block's inputs, then channels that are none
    estimated: Array  # (e,) the block's outputs
    axes: tuple[int, ...]  # (i,)
    floors: int  # c - 1

    def observe(self, corrected: Array, force: Array) -> None:
        """Estimate from the channels (c + f,); write the known part (i,) of the interface force, as parts.Observer."""
        self.block.apply()
        first = self.block.states + self.estimated.size
        for i in range(len(self.axes)):
            force[i] = self.block.made[first + i]

    def can_substitute(self, channels: int) -> bool:
        """Return whether the estimates hold displacement, velocity and acceleration of every floor."""
        return self.estimated.size >= 3 * (channels - 1)

    def substitute(self, corrected: Array) -> None:
        """Write the floors' accelerations for which the innovation is zero, so that the estimate follows the identified
        specimen alone: the solution of a fixed-point iteration, as parts.Observer."""
        floors, block = self.floors, self.block
        for _ in range(ROUNDS):
            product(block.matrix, block.matrix.shape[1], block.given, block.made)
            for i in range(floors):
                corrected[1 + i] = self.estimated[2 * floors + i]


@part_class
class LinearFeedforward(NamedTuple):
    """Commands as a linear block of the desired motion; for one command, the command that counters friction at the
    velocity to come is added."""

    # desired accelerations, velocities, displacements (3 i,), then corrected accelerations (c,) or nothing -> commands
    # in V (a,)
    block: Linear
    logged: Array  # nothing
    axes: tuple[int, ...]  # (i,)
    actuators: tuple[int, ...]  # (a,)
    friction_v: float = 0.0  # kappa; 0: friction is not countered
    per_scale: float = 0.0  # 1 / v_s
    linear_s_per_m: float = 0.0  # c
    lead_s: float = 0.0

    def feed_forward(self, motion: Array, corrected: Array, sent: Array, command: Array) -> None:
        """Write the commands (a,) in V for the desired motion (3, i), as parts.Feedforward."""
        for q in range(3):
            for i in range(len(self.axes)):
                self.block.given[self.block.states + q * len(self.axes) + i] = motion[q, i]
        first = self.block.states + 3 * len(self.axes)
        for c in range(self.block.given.size - first):
            self.block.given[first + c] = corrected[c]
        self.block.apply()
        for a in range(len(self.actuators)):
            command[a] = self.block.made[self.block.states + a]
        if self.friction_v != 0.0:
            velocity = motion[1, 0] + self.lead_s * motion[0, 0]
            sign = math.tanh(velocity * self.per_scale)
            command[0] += self.friction_v * (sign - self.linear_s_per_m * velocity)


@part_class
class LinearFeedback(NamedTuple):
    """A linear block of the tracking error, whose limits it is told of (anti-windup)."""

    block: Linear  # tracking errors (i,), shortfalls in V (a,), or the errors alone -> commands in V (a,)
    shortfall: Array  # (a, states) change of the states per 1 V between applied and requested part; (0, .): untold
    logged: Array  # nothing
    axes: tuple[int, ...]  # (i,)
    actuators: tuple[int, ...]  # (a,)

    def feed_back(self, error: Array, lowest: Array, highest: Array, command: Array) -> None:
        """Write the applied part (a,) of the commands in V, as parts.Feedback."""
        states, block = self.block.states, self.block
        for i in range(len(self.axes)):
            block.given[states + i] = error[i]
        block.apply()
        for a in range(len(self.actuators)):
            wanted = block.made[states + a]
            applied = highest[a] if wanted > highest[a] else lowest[a] if wanted < lowest[a] else wanted
            command[a] = applied
            if applied != wanted and self.shortfall.shape[0] > 0:
                for i in range(states):
                    block.given[i] += self.shortfall[a, i] * (applied - wanted)


def linear(
    block: Block, room: Room | None = None, more_c: Array | None = None, more_d: Array | None = None, wide: int = 0
) -> Linear:
    """Return a discrete block at rest; `more_c` (q, n), `more_d` (q, m) are outputs in addition to its own, `wide` the
    number of places for inputs where there are more than it has."""
    n, m = block.B.shape
    rows = [np.hstack([block.A, block.B]), np.hstack([block.C, block.D])]
    if more_c is not None and more_d is not None:
        rows.append(np.hstack([more_c, more_d]))
    matrix = tiled(np.vstack(rows))
    return Linear(matrix, (room or Room()).take(n + max(m, wide)), np.zeros(4 * len(matrix)), n)


def twice(block: Block | None, room: Room) -> OpenLoop:
    """Return a discrete block of one input, at rest, prepared for two inputs; None: an unknown block."""
    made = linear(block or static(np.zeros((0, 1)), 1.0, "unknown", (), ()))
    floors = len(block.C) if block else 0
    return OpenLoop(made.matrix, room.take(2, made.given.size), np.zeros((2, made.made.size)), made.states, floors)


def channelwise(blocks: tuple[Block, ...], room: Room) -> Channels:
    """Return blocks without coupling between channels as one small block per channel, at rest.

    Their states must be ordered channel by channel. Raises ValueError if a block couples channels, or if it has more
    than three states per channel.
    """
    matrix = np.concatenate([_small_blocks(block) for block in blocks])
    return Channels(matrix, room.take(len(matrix), 4))


def _small_blocks(block: Block) -> Array:
    """Return the matrices (c, 4, 4) of `Channels` for a block of c channels."""
    count = block.D.shape[0]
    states = len(block.A) // count
    if states > 3 or states * count != len(block.A):
        raise ValueError(f"{block.name}: {len(block.A)} states for {count} channels; up to 3 for each, or none")
    matrix = np.zeros((count, 4, 4))
    mixed = np.abs(np.block([[block.A, block.B], [block.C, block.D]]))
    for c in range(count):
        own = np.arange(c * states, (c + 1) * states)
        matrix[c, :states, :states], matrix[c, 3, :states] = block.A[np.ix_(own, own)].T, block.B[own, c]
        matrix[c, :states, 3], matrix[c, 3, 3] = block.C[c, own], block.D[c, c]
        mixed[np.ix_([*own, len(block.A) + c], [*own, len(block.A) + c])] = 0.0
    if mixed.any():
        raise ValueError(f"{block.name} mixes channels: each must be corrected by itself")
    return matrix


def kalman_filter(block: Block, interface: Interface, room: Room, accelerometers: int, channels: int) -> KalmanFilter:
    """Return an estimator at rest; the known part of the interface force is a further output of its block.

    Of the `channels` that stand in its place of inputs it takes the first ones, as many as its block has inputs.
    """
    estimates, force = len(block.D), interface.force
    more_c, more_d = force.estimates @ block.C, force.estimates @ block.D + force.samples
    made = linear(block, room, more_c, more_d, channels)
    corrected, estimated = made.given[made.states :], made.made[made.states : made.states + estimates]
    return KalmanFilter(made, corrected, estimated, interface.channels, accelerometers - 1)


def linear_feedforward(block: Block, interface: Interface, room: Room) -> LinearFeedforward:
    """Return a feedforward at rest."""
    return LinearFeedforward(linear(block, room), NOTHING, interface.channels, interface.commands)


def linear_feedback(block: Block, interface: Interface, room: Room) -> LinearFeedback:
    """Return a feedback at rest; inputs beyond its commands' tracking errors are the shortfalls."""
    told = np.ascontiguousarray(block.B[:, len(interface.channels) :].T)
    return LinearFeedback(linear(block, room), told, NOTHING, interface.channels, interface.commands)


def compensated_feedforward(design: FrictionFeedforward, interface: Interface, room: Room) -> LinearFeedforward:
    """Return a feedforward that counters friction, at rest."""
    return linear_feedforward(design.block, interface, room)._replace(
        friction_v=design.command_v,
        per_scale=1.0 / design.scale_m_s,
        linear_s_per_m=design.linear_s_per_m,
        lead_s=design.lead_s,
    )


@part_class
class DenseStoreys(NamedTuple):
    """A numerical substructure as a block of n states, whose outputs (3 i,) are all relative to the ground."""

    A: Array  # (n, n)
    B: Array  # (n, 1 + i) by ground acceleration and forces
    C: Array  # (3 i, n)
    D: Array  # (3 i, 1 + i)
    state: Array  # (n,)
    following: Array  # (n,) the next state
    direct: Array  # (i, i)
    felt: Array  # (n + 2,) of which state, ground acceleration and force make the force that is felt
    logged: Array  # (1,) that force

    def free(self, ground: Array, accel: Array) -> None:
        """Write the accelerations (i,) of the interface without interface force, as parts.NumericalSubstructure."""
        for i in range(accel.size):
            accel[i] = self.D[i, 0] * ground[0]
            for j in range(self.state.size):
                accel[i] += self.C[i, j] * self.state[j]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's motion (3, i) and go to the next instant, as parts.NumericalSubstructure."""
        axes, n = force.size, self.state.size
        self.logged[0] = self.felt[n] * ground[0] + self.felt[n + 1] * force[0]
        for j in range(n):
            self.logged[0] += self.felt[j] * self.state[j]
        for q in range(3):
            for i in range(axes):
                row = q * axes + i
                value = self.D[row, 0] * ground[0]
                for j in range(self.state.size):
                    value += self.C[row, j] * self.state[j]
                for j in range(axes):
                    value += self.D[row, 1 + j] * force[j]
                motion[q, i] = value
        for i in range(self.state.size):
            value = self.B[i, 0] * ground[0]
            for j in range(self.state.size):
                value += self.A[i, j] * self.state[j]
            for j in range(axes):
                value += self.B[i, 1 + j] * force[j]
            self.following[i] = value
        for i in range(self.state.size):
            self.state[i] = self.following[i] + 0.0


def dense_storeys(design: StoreysOfActuator, interface: Interface, room: Room) -> DenseStoreys:
    """Return the storeys of a test with an actuator at rest."""
    block, axes = design.block, len(interface.channels)
    a, b, c, d = (np.ascontiguousarray(getattr(block, name)) for name in "ABCD")
    direct = np.ascontiguousarray(d[:axes, 1:])
    felt = np.concatenate([design.force.C[0], design.force.D[0]])
    return DenseStoreys(a, b, c, d, room.take(len(a)), np.zeros(len(a)), direct, felt, np.zeros(1))
