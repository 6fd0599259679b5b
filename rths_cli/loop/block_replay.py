"""Run one compiled block of the step over recorded inputs, after a run."""

from __future__ import annotations

import numpy as np

from rths_cli.loop.linear_parts import Linear, linear
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array, Block


def run_block(block: Block, inputs: Array) -> Array:
    """Return the outputs (p, n) of a block, from rest, for inputs (m, n)."""
    outputs = np.zeros((block.C.shape[0], inputs.shape[1]))
    recorded = np.ascontiguousarray(inputs, dtype=float)
    _run(linear(block), recorded, outputs)
    return outputs


@entry
def _run(block: Linear, inputs: Array, outputs: Array) -> None:
    block, inputs, outputs = borrowed((block, inputs, outputs))
    for k in range(inputs.shape[1]):
        for i in range(inputs.shape[0]):
            block.given[block.states + i] = inputs[i, k]
        block.apply()
        for i in range(outputs.shape[0]):
            outputs[i, k] = block.made[block.states + i]
