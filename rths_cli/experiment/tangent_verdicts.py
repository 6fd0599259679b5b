"""Verdicts on the linear loops at the tangents of a building's laws, and at both ends of its specimen's stiffness.

They are indications: a loop that is stable at every frozen tangent may still diverge, and one that is not may end in a
bounded vibration. The simulated test (experiment/simulated_test.py) is the evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.critical_delay import critical_delay
from rths_cli.control.numerical_substructure import interface
from rths_cli.experiment.loop_stability_of_case import loop_faults, loop_stability
from rths_cli.structure.tangents import Tangent, at_rest, at_tangents, with_specimen

if TYPE_CHECKING:
    from rths_cli.analysis.critical_delay import CriticalDelay
    from rths_cli.case.case_schema import Case
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.shared_values import SharedValues
    from rths_cli.structure import Building

SOFTEST = 0.01  # of a storey's stiffness at rest: a softer building does not return within a record
AT_REST = "at rest"
ASSUMPTIONS = (
    "structure.numerical.law: the verdicts at rest and at tangents of the laws are indications (a loop that is stable "
    "at every frozen tangent may still diverge); the evidence is the test with the laws, simulated on the rig as "
    "identified"
)
RANGE_ASSUMPTIONS = (
    "check.specimen_range: the loop is judged at both ends of the specimen's stiffness, with the table's response as "
    "identified; a specimen that changes in the test is not simulated"
)
REACTION_ASSUMPTIONS = (
    "controller.reaction_feedforward: the loop is judged at both ends of the specimen's stiffness ({:g} and {:g} of "
    "the identified one), with a table that moves as the changed reaction makes it; a specimen that changes in the "
    "test is not simulated"
)
REACTION_RANGE = 0.5, 1.0  # judged with a feedforward of the reaction if the case states no specimen_range
TANGENT = "tangent "  # begins the cause of each reason


@dataclass(frozen=True)
class TangentVerdict:
    """The verdict on the loop at one tangent."""

    name: str  # in words
    stability: preflight.Stability
    critical: CriticalDelay
    faults: tuple[preflight.Fault, ...]  # why it is not safe


def range_assumption(case: Case, counters_reaction: bool) -> str:
    """Return how a specimen with a range of stiffness is judged, "" without a range."""
    ends = stated_ends(case, counters_reaction)
    if ends is None:
        return ""
    return REACTION_ASSUMPTIONS.format(*ends) if counters_reaction else RANGE_ASSUMPTIONS


def tangent_verdicts(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    building: Building,
    shared: SharedValues,
    ends: tuple[float, ...] | None = None,
) -> tuple[TangentVerdict, ...]:
    """Return the verdicts at rest and at all tangents, () for a linear building whose specimen has no range.

    `blocks` are as designed; `building` is as identified, with its laws; `ends` those of the specimen's stiffness, over
    the identified one. The table's response and the blocks of the control stay as identified
    and designed.
    """
    frozen = _frozen(building, ends)
    if len(frozen) < 2:
        return ()
    return tuple(_verdict(setup, identified, blocks, one, shared) for one in frozen)


def faults_at_tangents(verdicts: tuple[TangentVerdict, ...]) -> tuple[preflight.Fault, ...]:
    """Return why loops at tangents are not safe: each cause once, with the tangent at which it is worst."""
    found: dict[str, list[tuple[str, preflight.Fault]]] = {}
    for one in verdicts:
        if one.name != AT_REST:
            for fault in one.faults:
                found.setdefault(fault.cause, []).append((one.name, fault))
    told = []
    for cause, same in found.items():
        name, worst = max(same, key=lambda each: each[1].beyond)
        more = f" (and {len(same) - 1} more)" if len(same) > 1 else ""
        told.append(preflight.Fault(TANGENT + cause, f"with {name}{more}: {worst.text}", worst.beyond))
    return tuple(told)


def _frozen(building: Building, ends: tuple[float, ...] | None) -> list[Tangent]:
    """Return the linear buildings to judge, the one at rest first."""
    rest = Tangent(AT_REST, at_rest(building))
    frozen = [rest, *at_tangents(building, SOFTEST)]
    if ends is None:
        return frozen
    together = [one for one in frozen if one.name.startswith("all")] or frozen[1:]
    found = list(frozen)
    for factor in ends:
        if factor != 1.0:
            for one in (rest, *together):
                name = f"specimen at {100.0 * factor:.3g} % of its stiffness, {one.name}"
                found.append(Tangent(name, with_specimen(one.building, factor)))
    return found


def stated_ends(case: Case, counters_reaction: bool) -> tuple[float, ...] | None:
    """Return the stated ends of the specimen's stiffness, or those of a case that asks for its reaction to be
    countered. Where that is automatic, `design_choice` judges them."""
    stated = case.check.specimen_range if case.check is not None else None
    asked = counters_reaction and case.controller.reaction_feedforward is True
    return REACTION_RANGE if stated is None and asked else stated


def _verdict(
    setup: Setup, identified: Identification, blocks: Blocks, at: Tangent, shared: SharedValues
) -> TangentVerdict:
    """Return the verdict at one tangent: that of the linear building, by the way of every linear building."""
    assert identified.specimen is not None  # every case has experimental storeys
    if at.building.numerical is not setup.building.numerical:
        setup = replace(setup, building=replace(setup.building, numerical=at.building.numerical))
        numerical = interface(at.building.numerical, setup.rig.dt_s, setup.case.integration)
        blocks = replace(blocks, numerical=numerical)
    specimen = at.building.specimen
    there = None if specimen is identified.specimen.specimen else specimen
    found = loop_stability(setup, identified, blocks, shared, there)
    faults = tuple(loop_faults(setup, identified, blocks, shared, there))
    return TangentVerdict(at.name, found, critical_delay(at.building), faults)
