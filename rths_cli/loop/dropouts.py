"""Where a sample is lost: give the step the samples that the identified model expects."""

from __future__ import annotations

from rths_cli.loop.step import staircase_of
from rths_cli.loop.step_arrays import EXCITATION, Step
from rths_cli.numerics.compiled import kept_part, part


@part
def bridges(s: Step) -> bool:
    """Return whether a step can substitute samples; an excitation and a step without lead cannot."""
    return s.source != EXCITATION and s.recent.shape[0] > 1 and s.observer.can_substitute(s.accelerometers)


@kept_part
def bridge(s: Step) -> None:
    """Write substituted samples for a step without samples: the table as desired, the floors as estimated.

    The desired motion at t_k is known from an earlier step. The floors' accelerations are those that the observer
    expects, the load cell of the base shear shows what they demand, and other channels keep their values. An
    excitation, and a step without lead, keep the last samples.
    """
    s.held.lost[0] = 1.0
    if not bridges(s):
        return
    s.corrected[0] = s.recent[0, 0]
    for i in range(len(s.measured_by)):
        s.corrected[s.measured_by[i]] = s.recent_commanded[0, i]
    s.observer.substitute(s.corrected)
    if s.cell >= 0:
        s.corrected[s.cell] = 0.0
        for c in range(s.accelerometers):
            s.corrected[s.cell] += s.cell_reads[c] * s.corrected[c]
    show(s)


@part
def show(s: Step) -> None:
    """Write the samples whose correction by `sense` gives the accelerations in `corrected`."""
    for i in range(len(s.measured_by)):
        s.corrected[s.measured_by[i]] += staircase_of(s, i)
    if s.cell >= 0:
        s.corrected[s.cell] += s.cell_reads[0] * staircase_of(s, 0)
    for c in range(s.samples.size):
        matrix, given, wanted = s.correction.matrix[c], s.correction.given[c], s.corrected[c]
        for j in range(3):
            wanted -= matrix[j, 3] * given[j]
        s.samples[c] = wanted / matrix[3, 3]
