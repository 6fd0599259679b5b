"""Models in Python for the parts of the step, which do what the compiled parts do."""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.lti import Array, Block


class Inverse:
    """A linear feedforward block in numpy."""

    def __init__(self, block: Block) -> None:
        self.block, self.x = block, np.zeros(len(block.A))

    def command(self, motion: Array, corrected: Array, sent: Array) -> Array:
        command = self.block.C @ self.x + self.block.D @ motion[:, 0]
        self.x = self.block.A @ self.x + self.block.B @ motion[:, 0]
        return command


class Storeys:
    """The linear storeys of a block, in numpy."""

    def __init__(self, block: Block, fails_at: int = -1) -> None:
        self.block, self.x, self.k, self.fails_at = block, np.zeros(len(block.A)), 0, fails_at
        self.direct, self.logged = block.D[:1, 1:], np.zeros(1)

    def free(self, ground: Array) -> Array:
        return self.block.C[:1] @ self.x + self.block.D[:1, 0] * ground[0]

    def advance(self, ground: Array, force: Array) -> Array:
        self.k += 1
        if self.k == self.fails_at:
            raise RuntimeError("the model does not converge")
        inputs = np.array([ground[0], force[0]])
        motion = self.block.C @ self.x + self.block.D @ inputs + np.array([0.0, ground[1], ground[2]])
        self.x = self.block.A @ self.x + self.block.B @ inputs
        self.logged[0] = self.x[0]
        return motion[:, None]
