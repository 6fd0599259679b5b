"""The check of a law that adapts: the loop of the hybrid test over the bounds of its parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rths_cli.analysis.adaptive_loop import AdaptiveVerdict, judged
from rths_cli.analysis.closed_loop import closed_loop_matrix
from rths_cli.control.compensator import CompiledLaw
from rths_cli.experiment.design import loop_parts
from rths_cli.findings import Finding
from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Array

_VERDICTS = SharedValues()  # warnings and verdict of a check ask for the same


def adaptive_verdict(setup: Setup, identified: Identification, design: Design) -> AdaptiveVerdict | None:
    """Return what is known of the loop while parameters of the feedforward move, None where none do.

    The table is the identified model, the storeys are those at rest.
    """
    law = design.blocks.feedforward
    if not isinstance(law, CompiledLaw) or law.adapted is None or law.at is None or identified.specimen is None:
        return None
    at, bounds = law.at, law.adapted
    rig, _ = loop_parts(setup, identified)
    linear = design.blocks.linearised()

    def matrix_at(values: Array) -> Array:
        return closed_loop_matrix(rig, replace(linear, feedforward=at(values)))

    dt_s = setup.rig.dt_s
    asked = content_key(*map(matrix_at, (bounds.start, bounds.least, bounds.most)), bounds.limits, dt_s)
    return _VERDICTS.get("adaptive", asked, lambda: judged(matrix_at, bounds, dt_s))


def adaptive_faults(found: AdaptiveVerdict | None) -> tuple[Finding, ...]:
    """Return why a loop is not safe while its parameters move."""
    if found is None:
        return ()
    if found.found_unstable:
        values = {"spectral_radius": found.worst_radius, "point": found.point}
        return (Finding("loop.adaptive_point", values, beyond=found.worst_radius),)
    if not found.switching_stable:
        return (Finding("loop.adaptive_switching", {"growth": found.growth}),)
    return ()
