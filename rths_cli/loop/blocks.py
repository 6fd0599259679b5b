"""The arrays of one RTHS step: what the compiled step reads, and what it changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.blocks import Blocks
from rths_cli.loop.modal import Modal, modal
from rths_cli.lti import Array, Block
from rths_cli.tiles import tiled

EXCITATION, RECORD, NUMERICAL = 0, 1, 2


class Linear(NamedTuple):
    """A discrete block as one product, n states, m inputs, p outputs: made = matrix @ given."""

    matrix: Array  # (tiles, n + m, 4), tiles.tiled
    given: Array  # (n + m,) state, then inputs
    made: Array  # (4 tiles,) next state, then outputs, then zeros
    states: int


class Step(NamedTuple):
    """One RTHS step, block by block; c channels (table first), e estimator outputs, lead n_p samples.

    At t_k the hybrid clock stands at k + n_p. The base shear there is
    f = shear_estimate . z + shear_recent . d[k .. k+n_p-1] + shear_measured . c + shear_desired * d[k+n_p],
    z the estimator's outputs, c the corrected samples, d the desired accelerations. What of it is known from the
    samples is one more output of the estimator, after its own. `samples`, `corrected`, `estimated`, `interface` and
    `error` are places within the `given` and `made` of the blocks.
    """

    source: int  # EXCITATION, RECORD or NUMERICAL
    correction: Linear  # raw samples in V (c,) -> corrected accelerations (c,)
    estimator: (
        Linear  # corrected accelerations (c,) -> specimen's state, floor accelerations (e,), base shear known (1,)
    )
    shear_recent: Array  # (n_p,)
    shear_desired: float
    numerical: Modal  # ground acceleration, base shear (2,) -> interface accel, velocity, displacement (3,)
    feedforward: Linear  # desired accel, velocity, displacement (3,) -> command in V (1,)
    feedback: Linear  # tracking error, shortfall in V (2,), or the error alone (1,) -> command in V (1,)
    recent: Array  # (n_p + 1,) desired accelerations d[k] .. d[k + n_p]
    samples: Array  # (c,) raw samples in V
    corrected: Array  # (c,)
    estimated: Array  # (e,)
    base_shear: Array  # (1,) in N at k + n_p
    interface: Array  # (3,) desired absolute acceleration, velocity, displacement of the interface
    error: Array  # (2,) tracking error, and the feedback's part as applied less as wanted in V; or (1,)
    shaping: Array  # (2,) rounding error carried over in V, and the size of a bit (0: no shaping)
    command_limit_v: float  # the feedback's part is clipped so that the sum stays within,
    feedback_limit_v: float  # and itself within this
    ripple_m_s2_per_v: float  # what the hold's staircase adds to a table sample per V of command change,
    ripple_sum_m_s2_per_v: float  # and its integral, where an AC coupling is corrected, per V of their sum
    sent: Array  # (max(latency, 1) + 1,) commands that left, the latest first


def linear(block: Block, more_c: Array | None = None, more_d: Array | None = None) -> Linear:
    """Return a discrete block at rest; `more_c` (q, n), `more_d` (q, m) are outputs in addition to its own."""
    n, m = block.B.shape
    rows = [np.hstack([block.A, block.B]), np.hstack([block.C, block.D])]
    if more_c is not None and more_d is not None:
        rows.append(np.hstack([more_c, more_d]))
    matrix = tiled(np.vstack(rows))
    return Linear(matrix, np.zeros(n + m), np.zeros(4 * len(matrix)), n)


def assemble(blocks: Blocks, source: int) -> Step:
    """Return a step at rest for one run of the given source."""
    correction, feedforward, feedback = (linear(b) for b in (blocks.correction, blocks.feedforward, blocks.feedback))
    known = blocks.shear_estimate[None, :]
    design, channels = blocks.estimator, blocks.correction.C.shape[0]
    estimator = linear(design, known @ design.C, known @ design.D + blocks.shear_measured[None, :])
    return Step(
        source=source,
        correction=correction,
        estimator=estimator,
        shear_recent=np.ascontiguousarray(blocks.shear_recent, dtype=float),
        shear_desired=float(blocks.shear_desired),
        numerical=modal(blocks.numerical),
        feedforward=feedforward,
        feedback=feedback,
        recent=np.zeros(blocks.lead_samples + 1),
        samples=correction.given[correction.states :],
        corrected=estimator.given[estimator.states : estimator.states + channels],
        estimated=estimator.made[estimator.states : estimator.states + design.C.shape[0]],
        base_shear=np.zeros(1),
        interface=feedforward.given[feedforward.states :],
        error=feedback.given[feedback.states :],
        shaping=np.array([0.0, blocks.shaping_step_v]),
        command_limit_v=float(blocks.command_limit_v),
        feedback_limit_v=float(blocks.feedback_limit_v),
        ripple_m_s2_per_v=float(blocks.ripple_m_s2_per_v),
        ripple_sum_m_s2_per_v=float(blocks.ripple_sum_m_s2_per_v),
        sent=np.zeros(max(blocks.latency_samples, 1) + 1),
    )
