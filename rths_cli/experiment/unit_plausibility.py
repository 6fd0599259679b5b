"""Doubts that numbers of a case are in another unit than their keys say: what must agree is compared, see
`unit_comparisons` in `rigs/`, `structure/` and here."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING

from rths_cli.case.unit_comparison import Comparison, doubts_of
from rths_cli.case.unit_defaults import of_defaults
from rths_cli.experiment.setup import placed
from rths_cli.experiment.unit_comparisons import of_case, of_record, of_specimen_on_table, value_at
from rths_cli.rigs.unit_comparisons import of_rig
from rths_cli.structure.unit_comparisons import of_building, of_damping

if TYPE_CHECKING:
    from rths_cli.case.structure_schema import DampingSpec, StructureSpec
    from rths_cli.experiment.setup import Setup
    from rths_cli.structure import Building


def doubts(setup: Setup) -> tuple[Comparison, ...]:
    """Return the doubts on the units of a case, those on the building first, without those that the case calls
    plausible (`plausible`)."""
    consented = setup.case.plausible or ()
    return tuple(doubts_of(one for one in _comparisons(setup) if one.key not in consented))


def unknown_consents(setup: Setup) -> tuple[str, ...]:
    """Return a sentence for each key of `plausible` that the case does not have: it permits nothing."""
    case, known = setup.case, dict.fromkeys(one.key for one in _comparisons(setup))
    told = []
    for key in case.plausible or ():
        if key not in known and value_at(case, key) is None:
            near = get_close_matches(key, known, 1)
            advice = f"did you mean {near[0]}?" if near else "name the key as the doubt names it, or leave it out"
            told.append(placed(case, f"plausible: {key} is no key of this case and permits nothing; {advice}"))
    return tuple(told)


OF_RIG = ("table.",)  # beginnings of the keys of a rig
OF_IDENTIFICATION = ("structure.", "damping.", *OF_RIG, "identification.")  # of all that an identification plays


def unit_doubts(setup: Setup) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a case: building, specimen on its table, rig, record, numbers.

    Each begins with file and line of the key in doubt.
    """
    return tuple(placed(setup.case, one.sentence) for one in doubts(setup))


def keys_in_doubt(setup: Setup) -> tuple[str, ...]:
    """Return the keys whose values speak for another unit than they must have, each once."""
    return tuple(dict.fromkeys(one.key for one in doubts(setup)))


def doubts_building(setup: Setup) -> bool:
    """Return whether the building or its record is doubted: all that follows from them is then of no use."""
    return any(key.partition(".")[0] in ("structure", "damping", "record") for key in keys_in_doubt(setup))


def specimen_doubts(setup: Setup) -> tuple[str, ...]:
    """Return a sentence for each doubt that concerns an identification: on the building, its specimen and the rig."""
    return tuple(placed(setup.case, one.sentence) for one in doubts(setup) if one.key.startswith(OF_IDENTIFICATION))


def building_doubts(spec: StructureSpec, damping: Sequence[DampingSpec], building: Building) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a building, () if its numbers are plausible.

    Each begins with the key in a structure file.
    """
    found = doubts_of((*of_building(spec, building), *of_damping(spec, damping, building)))
    return tuple(one.sentence.removeprefix("structure.") for one in found)


def _comparisons(setup: Setup) -> Iterator[Comparison]:
    case = setup.case
    yield from of_building(case.structure, setup.building)
    yield from of_damping(case.structure, (case.damping,), setup.building)
    yield from of_specimen_on_table(setup)
    yield from of_rig(case)
    yield from of_record(setup)
    yield from of_case(case)
    yield from of_defaults(case)


def before_error(setup: Setup, error: Exception) -> tuple[str, ...]:
    """Return doubts on units and the error that followed; where building or record are doubted, without its figures and
    advice, which are of other causes."""
    told, said = unit_doubts(setup), str(error)
    if doubts_building(setup):
        followed = re.split("[,;] ", said)[0].removeprefix(f"identification of rig {setup.rig.name}: ")
        said = f"it would explain: {followed}"
    return (*told, said)
