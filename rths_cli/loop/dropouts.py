"""Where a sample is lost: give the step the samples that the identified model expects."""

from __future__ import annotations

from rths_cli.loop.step import staircase_of
from rths_cli.loop.step_arrays import EXCITATION, Step
from rths_cli.numerics.compiled import part
from rths_cli.numerics.tiled_products import product

ROUNDS = 12  # iterations of the fixed point in `bridge`: each reduces the error to 1/8 at 1 kHz, 1/4 at 500 Hz


@part
def bridges(s: Step) -> bool:
    """Return whether a step can substitute samples; an excitation and a step without lead cannot."""
    return s.source != EXCITATION and s.recent.size > 1 and s.estimated.size >= 3 * (s.samples.size - 1)


@part
def bridge(s: Step) -> None:
    """Write substituted samples for a step without samples: the table as desired, the floors as estimated.

    The desired acceleration at t_k is known from an earlier step. The floors' accelerations are those for which the
    estimator's innovation is zero, so that the estimate follows the identified specimen alone. They are the solution of
    a fixed-point iteration. An excitation, and a step without lead, keep the last samples.
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
    """Write the samples whose correction by `sense` gives the accelerations in `corrected`."""
    s.corrected[0] += staircase_of(s)
    for c in range(s.samples.size):
        matrix, given, wanted = s.correction.matrix[c], s.correction.given[c], s.corrected[c]
        for j in range(3):
            wanted -= matrix[j, 3] * given[j]
        s.samples[c] = wanted / matrix[3, 3]
