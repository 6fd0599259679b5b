"""What `rths plugin test` holds a compensator to: each clause of its contract, tried on a table that is made up."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from rths_cli.control.block_files import placed_block
from rths_cli.control.compensator import (
    FIELD,
    Definition,
    Plant,
    compiled_function,
    designed_law,
    made_up_plant,
    part_of_law,
)
from rths_cli.control.interface import PartDesign
from rths_cli.control.law_block import STEP_SHARE, Law, derived_block, seconds_per_call
from rths_cli.control.law_trial import RANGE_V, SECONDS, BlockLaw, Played, code_and_block, motion, played
from rths_cli.errors import InputError
from rths_cli.files.user_code import told
from rths_cli.numerics.lti import Block
from rths_cli.rigs.contract import Kept

WOUND_UP = 0.01  # of the range: command that is left long after a motion beyond the range
GROWS = 10.0  # times that a state may be larger in the last fifth of a motion than before


def clauses(definition: Definition) -> Iterator[Kept]:
    """Yield each clause of the contract, and what was broken of it."""
    plant = made_up_plant()
    try:
        made = designed_law(definition, definition.values({}), plant)
        part = made if isinstance(made, Block) else part_of_law(definition, made, plant.dt_s)
    except InputError as error:
        clause = "at rest it commands nothing, it is finite, and the same state and inputs give the same"
        for one in error.faults:
            yield Kept(clause, one.removeprefix(f"{FIELD}: {definition.who}: "))
        return
    law = BlockLaw(made) if isinstance(made, Block) else made
    yield Kept("at rest it commands nothing, it is finite, and the same state and inputs give the same", "")
    tried: tuple[tuple[str, Callable[[], str]], ...] = (
        ("its state stays bounded", lambda: _bounded(law, plant)),
        ("behind a motion beyond the range it does not stay wound up", lambda: _unwinds(law, plant)),
        (_judged_by(part), lambda: _agrees(law, part, plant)),
        (_runs_as(definition, made, part), lambda: ""),
        (f"a step takes at most {STEP_SHARE:g} of the interval", lambda: _in_time(made, part, plant)),
    )
    for clause, fault in tried:
        yield Kept(clause, _found(fault))


def _found(fault: Callable[[], str]) -> str:
    """Return what a trial finds, which may be that the user's code fails."""
    try:
        with np.errstate(all="ignore"):
            return fault()
    except Exception as error:  # whatever the user's code raises
        return f"the code fails there: {told(error)}"


def _moved(law: Law | BlockLaw, plant: Plant, peak_m: float, still_s: float = 0.0) -> Played:
    return played(law, motion(plant.dt_s, peak_m, still_s), plant.channels, plant.lag_s / plant.dt_s)


def _bounded(law: Law | BlockLaw, plant: Plant) -> str:
    block = law.block if isinstance(law, BlockLaw) else derived_block(law, plant.dt_s)
    radius = 0.0 if block is None or not block.A.size else float(np.abs(np.linalg.eigvals(block.A)).max())
    if radius > 1.0 + 1e-9:
        return f"its own spectral radius is {radius:.6g}, its state grows without end; it must be at most 1"
    found = _moved(law, plant, 0.01)
    if not np.isfinite(found.command_v[-1]):
        return f"the command is not finite after {found.command_v.size * plant.dt_s:.3g} s of a motion of 10 mm"
    last = found.state.size // 5
    before, after = found.state[:-last].max(initial=0.0), found.state[-last:].max(initial=0.0)
    grown = after > GROWS * before > 0.0
    return f"the largest state grows from {before:.3g} to {after:.3g} though the motion ends" if grown else ""


def _unwinds(law: Law | BlockLaw, plant: Plant) -> str:
    peak_m = 3.0 * RANGE_V * plant.gain_m_per_v
    found = _moved(law, plant, peak_m, still_s=SECONDS)
    left = float(np.abs(found.command_v[-1]))
    if left <= WOUND_UP * RANGE_V:
        return ""
    return (
        f"{SECONDS:g} s after a motion of three times the range it still commands {left:.3g} V; correct the state by "
        "what was sent less what was commanded (sent, the command of the last sample behind all limits)"
    )


def _judged_by(part: PartDesign) -> str:
    if isinstance(part, Block):
        return "it is linear: the check judges its block, found by exciting it, and the block agrees with the code"
    try:
        part.linearised()
    except InputError:
        return "it is not linear and declares no block: the check cannot judge it, and refuses it unless overridden"
    return "it is not linear, or uses sent: the check judges its block, which agrees with the code for small motions"


def _agrees(law: Law | BlockLaw, part: PartDesign, plant: Plant) -> str:
    """Return by how much block and code differ, for a motion of 1 um for what is not linear; "" where they agree."""
    try:
        block = placed_block(FIELD, part.linearised(), plant.dt_s, plant.channels)
    except InputError:
        return ""
    return code_and_block(law, block, plant.channels, plant.lag_s / plant.dt_s, exact=part.linear)


def _runs_as(definition: Definition, made: Law | Block, part: PartDesign) -> str:
    if isinstance(part, Block):
        return "it runs compiled, as a linear block"
    assert isinstance(made, Law)
    function = compiled_function(definition, made)
    if isinstance(function, str):
        return f"it runs in Python, on a rig only at a rate that it holds, because {function}"
    return "it runs compiled"


def _in_time(made: Law | Block, part: PartDesign, plant: Plant) -> str:
    if isinstance(made, Block) or isinstance(part, Block):
        return ""
    seconds = seconds_per_call(made.in_step().command, plant.channels)
    most = STEP_SHARE * plant.dt_s
    return "" if seconds <= most else f"it takes {1e6 * seconds:.3g} us in Python, at most {1e6 * most:.3g} us"
