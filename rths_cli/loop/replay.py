"""Run one block of the step over recorded inputs."""

from __future__ import annotations

import numpy as np

from rths_cli.compiled import entry
from rths_cli.loop.blocks import Linear, linear
from rths_cli.loop.step import advance, read_out
from rths_cli.lti import Array, Block


def run_block(block: Block, inputs: Array) -> Array:
    """Return the outputs (p, n) of a block, from rest, for inputs (m, n)."""
    outputs = np.zeros((block.C.shape[0], inputs.shape[1]))
    recorded = np.ascontiguousarray(inputs, dtype=float)
    _run(linear(block), recorded, outputs, np.zeros(inputs.shape[0]), np.zeros(outputs.shape[0]))
    return outputs


@entry
def _run(block: Linear, inputs: Array, outputs: Array, u: Array, y: Array) -> None:
    for k in range(inputs.shape[1]):
        for i in range(u.size):
            u[i] = inputs[i, k]
        read_out(block, u, y)
        advance(block, u)
        for i in range(y.size):
            outputs[i, k] = y[i]
