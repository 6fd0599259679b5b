"""The arrays that the compiled step reads and changes, assembled from the designed blocks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.state_space import static
from rths_cli.loop.modal_substructure import Modal, modal
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.tiled_products import tiled

EXCITATION, RECORD, NUMERICAL = 0, 1, 2


class Linear(NamedTuple):
    """A discrete block as one product, n states, m inputs, p outputs: made = matrix @ given."""

    matrix: Array  # (tiles, n + m, 4), tiled_products.tiled
    given: Array  # (n + m,) state, then inputs
    made: Array  # (4 tiles,) next state, then outputs, then zeros
    states: int


class OpenLoop(NamedTuple):
    """A block of one input, n states and p outputs, run twice with two inputs; without outputs it is unknown."""

    matrix: Array  # (tiles, n + 1, 4), tiled_products.tiled
    given: Array  # (2, n + 1) state, then input
    made: Array  # (2, 4 tiles) next state, then outputs, then zeros
    states: int


class Channels(NamedTuple):
    """Small blocks of one input and one output each, up to three states, one per channel: made = matrix @ given."""

    matrix: Array  # (c, 4, 4) channel, column (three states, then the input), row (three next states, then the output)
    given: Array  # (c, 4)


class Step(NamedTuple):
    """One RTHS step, block by block; c channels (table first), e estimator outputs, lead n_p samples.

    At t_k the hybrid clock is at k + n_p. The base shear there is
    f = shear_estimate . z + shear_recent . d[k .. k+n_p-1] + shear_measured . c + shear_desired * d[k+n_p],
    with the estimator's outputs z, the corrected samples c and the desired accelerations d. The terms in z and c are
    computed as an additional output of the estimator, after its own. `corrected`, `estimated`, `interface` and `error`
    are views of the `given` and `made` of the blocks.
    """

    source: int  # EXCITATION, RECORD or NUMERICAL
    correction: Channels  # raw samples in V (c,) -> corrected accelerations (c,)
    estimator: Linear  # corrected accelerations (c,) -> specimen's state and floor accelerations (e,), base shear known
    shear_recent: Array  # (n_p,)
    shear_returned: float  # base shear in N per m/s^2 that known forces cause, mutual dependence solved
    numerical: Modal  # ground acceleration, base shear (2,) -> interface accel, velocity, displacement (3,)
    feedforward: Linear  # desired accel, velocity, displacement (3,) -> command in V (1,)
    feedback: Linear  # tracking error, shortfall in V (2,), or the error alone (1,) -> command in V (1,)
    recent: Array  # (n_p + 1,) desired accelerations d[k] .. d[k + n_p]
    samples: Array  # (c,) raw samples in V
    corrected: Array  # (c,)
    estimated: Array  # (e,)
    base_shear: Array  # (1,) in N at k + n_p
    interface: Array  # (3,) desired absolute acceleration, velocity, displacement of the interface
    error: Array  # (2,) tracking error, and applied minus requested part of the feedback in V; or (1,)
    shortfall: Array  # (feedback's states,) change of the states per 1 V between applied and requested part
    shaping: Array  # (3,) rounding error carried over in V, the size of a bit (0: no shaping) and its inverse
    command_limit_v: float  # limit of the command, to which the feedback's part is clipped
    feedback_limit_v: float  # limit of the feedback's part itself
    ripple_m_s2_per_v: float  # alias of the held command in a table sample, per V of command change
    ripple_sum_m_s2_per_v: float  # integral of the alias by the AC correction, per V of the sum of two commands
    sent: Array  # (max(latency, 1) + 1,) commands that were sent, the latest first
    open_loop: OpenLoop  # table acceleration, desired and measured -> expected accelerations of the floors
    expected: Array  # (2, c) expected accelerations of the channels, by the desired and by the measured motion


def linear(block: Block, more_c: Array | None = None, more_d: Array | None = None) -> Linear:
    """Return a discrete block at rest; `more_c` (q, n), `more_d` (q, m) are outputs in addition to its own."""
    n, m = block.B.shape
    rows = [np.hstack([block.A, block.B]), np.hstack([block.C, block.D])]
    if more_c is not None and more_d is not None:
        rows.append(np.hstack([more_c, more_d]))
    matrix = tiled(np.vstack(rows))
    return Linear(matrix, np.zeros(n + m), np.zeros(4 * len(matrix)), n)


def twice(block: Block | None) -> OpenLoop:
    """Return a discrete block of one input, at rest, prepared for two inputs; None: an unknown block."""
    made = linear(block or static(np.zeros((0, 1)), 1.0, "unknown", (), ()))
    return OpenLoop(made.matrix, np.zeros((2, made.given.size)), np.zeros((2, made.made.size)), made.states)


def channelwise(block: Block) -> Channels:
    """Return a block without coupling between channels as one small block per channel, at rest.

    Its states must be ordered channel by channel. Raises ValueError if it couples channels, or if it has more than
    three states per channel.
    """
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
    return Channels(matrix, np.zeros((count, 4)))


def assemble(blocks: Blocks, source: int) -> Step:
    """Return a step at rest for one run of the given source."""
    feedforward, feedback = linear(blocks.feedforward), linear(blocks.feedback)
    known, size = blocks.shear_estimate[None, :], blocks.shaping_step_v
    design, channels = blocks.estimator, blocks.correction.C.shape[0]
    estimator = linear(design, known @ design.C, known @ design.D + blocks.shear_measured[None, :])
    return Step(
        source=source,
        correction=channelwise(blocks.correction),
        estimator=estimator,
        shear_recent=np.ascontiguousarray(blocks.shear_recent, dtype=float),
        shear_returned=float(blocks.shear_desired / (1.0 - blocks.numerical.D[0, 1] * blocks.shear_desired)),
        numerical=modal(blocks.numerical),
        feedforward=feedforward,
        feedback=feedback,
        recent=np.zeros(blocks.lead_samples + 1),
        samples=np.zeros(channels),
        corrected=estimator.given[estimator.states : estimator.states + channels],
        estimated=estimator.made[estimator.states : estimator.states + design.C.shape[0]],
        base_shear=np.zeros(1),
        interface=feedforward.given[feedforward.states :],
        error=feedback.given[feedback.states :],
        shortfall=np.ascontiguousarray(blocks.feedback.B[:, -1]),
        shaping=np.array([0.0, size, 1.0 / size if size > 0.0 else 0.0]),
        command_limit_v=float(blocks.command_limit_v),
        feedback_limit_v=float(blocks.feedback_limit_v),
        ripple_m_s2_per_v=float(blocks.ripple_m_s2_per_v),
        ripple_sum_m_s2_per_v=float(blocks.ripple_sum_m_s2_per_v),
        sent=np.zeros(max(blocks.latency_samples, 1) + 1),
        open_loop=twice(blocks.open_loop),
        expected=np.zeros((2, channels)),
    )
