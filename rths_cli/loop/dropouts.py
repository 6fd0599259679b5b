"""What the step is given where no samples came: what the channels would show if all went on as known."""

from __future__ import annotations

from rths_cli.loop.step import staircase_of
from rths_cli.loop.step_arrays import EXCITATION, Step
from rths_cli.numerics.compiled import part
from rths_cli.numerics.tiled_products import product

ROUNDS = 12  # to the fixed point of `bridge`: each leaves an eighth at 1 kHz, a quarter at 500 Hz


@part
def bridges(s: Step) -> bool:
    """Tell whether a step knows what its channels would show; an excitation and a step without lead do not."""
    return s.source != EXCITATION and s.recent.size > 1 and s.estimated.size >= 3 * (s.samples.size - 1)


@part
def bridge(s: Step) -> None:
    """Give the step what the channels would show, where no samples came: the table as desired, the floors as estimated.

    What is desired at t_k is known from before. The floors' accelerations are those from which the estimator estimates
    just these (no innovation), so that it goes on by the identified specimen alone: a fixed point, found in rounds.
    An excitation, and a step without lead, keep the last samples.
    """
    floors, block = s.samples.size - 1, s.estimator
    if not bridges(s):
        return
    s.corrected[0] = s.recent[0]
    for _ in range(ROUNDS):
        product(block.matrix, block.given.size, block.given, block.made)
        for i in range(floors):
            s.corrected[1 + i] = s.estimated[2 * floors + i]
    show(s)


@part
def show(s: Step) -> None:
    """Give the step the samples of which `sense` makes what stands in `corrected`."""
    s.corrected[0] += staircase_of(s)
    for c in range(s.samples.size):
        matrix, given, wanted = s.correction.matrix[c], s.correction.given[c], s.corrected[c]
        for j in range(3):
            wanted -= matrix[j, 3] * given[j]
        s.samples[c] = wanted / matrix[3, 3]
