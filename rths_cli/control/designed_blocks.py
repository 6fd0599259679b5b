"""`Blocks`, the data class of one run's designed blocks; experiment/design.py fills it, loop/step_arrays.py compiles
it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, Block
from rths_cli.structure import Specimen


@dataclass(frozen=True)
class Blocks:
    """The blocks a run is made of, as designed: all that `assemble` needs to build a Step.

    `n_p` = lead in samples; `shear_*`, `ripple_*` as in loop.blocks.Step; `shaping_step_v` is the size of a
    bit of the command converter when its rounding errors are to be shaped, else 0. The feedback's part of the command
    is kept within +-`feedback_limit_v`, and the sum within +-`command_limit_v` as far as the feedback's part can.
    `specimen`: the identified one, by which the channels are compared after a stop; None where there is none.
    `open_loop`: the same from the table's acceleration to the floors' accelerations, by which the guard knows what a
    floor must show; no block of the control, None where no specimen is known.
    """

    correction: Block
    estimator: Block
    numerical: Block
    feedforward: Block
    feedback: Block
    shear_estimate: Array
    shear_recent: Array
    shear_measured: Array
    shear_desired: float
    shaping_step_v: float = 0.0
    ripple_m_s2_per_v: float = 0.0
    latency_samples: int = 1
    command_limit_v: float = float("inf")
    feedback_limit_v: float = float("inf")
    ripple_sum_m_s2_per_v: float = 0.0
    specimen: Specimen | None = None
    open_loop: Block | None = None

    @property
    def lead_samples(self) -> int:
        """Return n_p, by how many samples the hybrid clock runs ahead of the table."""
        return len(self.shear_recent)

    def named(self) -> tuple[Block, ...]:
        """Return the discrete blocks that make the command, in the order in which the step runs them."""
        return (self.correction, self.estimator, self.numerical, self.feedforward, self.feedback)

    def base_shear(self) -> Block:
        """Return the base shear at k + n_p as a block without memory: estimates, desired and measured accelerations."""
        parts = (self.shear_estimate, self.shear_recent, self.shear_measured, [self.shear_desired])
        gain = np.concatenate(parts)[None, :]
        inputs = (
            *self.estimator.outputs,
            *_names("desired_accel_m_s2_at_k_plus", len(self.shear_recent)),
            *self.correction.outputs,
            "desired_accel_m_s2_at_k_plus_lead",
        )
        empty, wide, tall = np.zeros((0, 0)), np.zeros((0, gain.shape[1])), np.zeros((1, 0))
        return Block("base_shear", empty, wide, tall, gain, self.correction.dt_s, inputs, ("base_shear_n",))

    def staircase(self) -> Block:
        """Return the part of a table sample that the hold's staircase makes, from the command (V)."""
        order = max(self.latency_samples, 1) + 1
        a, b, c = np.eye(order, k=-1), np.zeros((order, 1)), np.zeros((1, order))
        b[0, 0], c[0, -2:] = 1.0, self.ripple_sum_m_s2_per_v + np.array([1.0, -1.0]) * self.ripple_m_s2_per_v
        direct = np.zeros((1, 1))
        return Block("staircase", a, b, c, direct, self.correction.dt_s, ("command_v",), ("table_accel_m_s2",))


def _names(kind: str, count: int) -> tuple[str, ...]:
    """Return `kind_0`, `kind_1`, ..."""
    return tuple(f"{kind}_{i}" for i in range(count))
