"""The arrays of one RTHS step: what the compiled step reads, and what it changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.blocks import Blocks
from rths_cli.lti import Array, Block

EXCITATION, RECORD, NUMERICAL = 0, 1, 2


class Linear(NamedTuple):
    """A discrete block and its state: x (n,) is changed in place, `scratch` (n,) holds the next one."""

    A: Array
    B: Array
    C: Array
    D: Array
    x: Array
    scratch: Array


class Step(NamedTuple):
    """One RTHS step, block by block; c channels (table first), e estimator outputs, lead n_p samples.

    At t_k the hybrid clock stands at k + n_p. The base shear there is
    f = shear_estimate . z + shear_recent . d[k .. k+n_p-1] + shear_measured . c + shear_desired * d[k+n_p],
    z the estimator's outputs, c the corrected samples, d the desired accelerations.
    """

    source: int  # EXCITATION, RECORD or NUMERICAL
    correction: Linear  # raw samples in V (c,) -> corrected accelerations (c,)
    estimator: Linear  # corrected accelerations (c,) -> specimen's state and floor accelerations (e,)
    shear_estimate: Array  # (e,)
    shear_recent: Array  # (n_p,)
    shear_measured: Array  # (c,)
    shear_desired: float
    numerical: Linear  # ground acceleration, base shear (2,) -> interface accel, velocity, displacement (3,)
    feedforward: Linear  # desired accel, velocity, displacement (3,) -> command in V (1,)
    feedback: Linear  # tracking error, shortfall in V (2,), or the error alone (1,) -> command in V (1,)
    recent: Array  # (n_p + 1,) desired accelerations d[k] .. d[k + n_p]
    samples: Array  # (c,) raw samples in V
    corrected: Array  # (c,)
    estimated: Array  # (e,)
    ground: Array  # (2,) ground acceleration and base shear
    interface: Array  # (3,) desired absolute acceleration, velocity, displacement of the interface
    error: Array  # (2,) tracking error, and the feedback's part as applied less as wanted in V; or (1,)
    command: Array  # (2,) feedforward and feedback part in V
    shaping: Array  # (2,) rounding error carried over in V, and the size of a bit (0: no shaping)
    command_limit_v: float  # the feedback's part is clipped so that the sum stays within,
    feedback_limit_v: float  # and itself within this
    ripple_m_s2_per_v: float  # what the hold's staircase adds to a table sample per V of command change,
    ripple_sum_m_s2_per_v: float  # and its integral, where an AC coupling is corrected, per V of their sum
    sent: Array  # (max(latency, 1) + 1,) commands that left, the latest first


def linear(block: Block) -> Linear:
    """Return a block with a fresh state, as contiguous arrays."""
    n = block.A.shape[0]
    a, b, c, d = (np.ascontiguousarray(m, dtype=float) for m in (block.A, block.B, block.C, block.D))
    return Linear(a, b, c, d, np.zeros(n), np.zeros(n))


def assemble(blocks: Blocks, source: int) -> Step:
    """Return a step at rest for one run of the given source."""
    channels, estimates = blocks.correction.C.shape[0], blocks.estimator.C.shape[0]
    return Step(
        source=source,
        correction=linear(blocks.correction),
        estimator=linear(blocks.estimator),
        shear_estimate=np.ascontiguousarray(blocks.shear_estimate),
        shear_recent=np.ascontiguousarray(blocks.shear_recent),
        shear_measured=np.ascontiguousarray(blocks.shear_measured),
        shear_desired=float(blocks.shear_desired),
        numerical=linear(blocks.numerical),
        feedforward=linear(blocks.feedforward),
        feedback=linear(blocks.feedback),
        recent=np.zeros(blocks.lead_samples + 1),
        samples=np.zeros(channels),
        corrected=np.zeros(channels),
        estimated=np.zeros(estimates),
        ground=np.zeros(2),
        interface=np.zeros(3),
        error=np.zeros(blocks.feedback.D.shape[1]),
        command=np.zeros(2),
        shaping=np.array([0.0, blocks.shaping_step_v]),
        command_limit_v=float(blocks.command_limit_v),
        feedback_limit_v=float(blocks.feedback_limit_v),
        ripple_m_s2_per_v=float(blocks.ripple_m_s2_per_v),
        ripple_sum_m_s2_per_v=float(blocks.ripple_sum_m_s2_per_v),
        sent=np.zeros(max(blocks.latency_samples, 1) + 1),
    )
