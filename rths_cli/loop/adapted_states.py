"""What holds the parameters of a law that adapts, whatever the law does: bounds, rate, and a halt where the last
command was clipped or the sample is lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.interface import Adapted
from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array


class Held(NamedTuple):
    """The k parameters of a law that move, its last k states; k = 0 for any other law."""

    state: Array  # (n,) of the law
    limits: Array  # (3, k) least, most, largest change in a sample, as differences from the start
    start: Array  # (k,)
    before: Array  # (k,) differences from the start, in the sample before
    values: Array  # (k,) the parameters, for the log
    wanted: Array  # (a,) commands as the step made them; what was sent differs where one was clipped
    lost: Array  # (1,) 1: this sample is none that was measured


def held(adapted: Adapted | None, state: Array, values: Array, commands: int) -> Held:
    """Return the parameters at rest, of a law with these states (n,); `values` (k,): where the log reads them."""
    if adapted is None:
        none = np.zeros(0)
        return Held(none, np.zeros((3, 0)), none, none, none, np.zeros(commands), np.zeros(1))
    values[:] = adapted.start
    return Held(state, adapted.limits, adapted.start.copy(), np.zeros(len(values)), values, np.zeros(commands),
                np.zeros(1))  # fmt: skip


@part
def hold(h: Held, frozen: bool) -> None:
    """Hold the parameters to their limits, and where they are while `frozen`."""
    first = h.state.size - h.before.size
    for i in range(h.before.size):
        if not frozen:
            change = min(max(h.state[first + i] - h.before[i], -h.limits[2, i]), h.limits[2, i])
            h.before[i] = min(max(h.before[i] + change, h.limits[0, i]), h.limits[1, i])
        h.state[first + i] = h.before[i] + 0.0
        h.values[i] = h.start[i] + h.before[i]
