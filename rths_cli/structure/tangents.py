"""The linear buildings at the tangents of a building's laws, and of a specimen whose stiffness is known as a range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.structure.shear_chain import Building, Specimen, assemble, storey_matrix, storey_values
from rths_cli.structure.storey_laws import arranged

LOCKING = 100.0  # critical dashpots 2 sqrt(k m), at which a storey is locked


@dataclass(frozen=True)
class Tangent:
    """A linear building at a tangent of its laws."""

    name: str  # in words: "storey 1 at its softest"
    building: Building  # without laws


def at_rest(building: Building) -> Building:
    """Return a building without its laws or program; its storeys hold the tangents at rest."""
    return building if building.linear else replace(building, laws=arranged(()), program=None)


def at_tangents(building: Building, least: float = -np.inf) -> list[Tangent]:
    """Return the linear buildings at the tangents of laws, without that at rest.

    Each storey with laws is at its softest and stiffest, and at its least and most damped, while the others are at
    rest; then all these storeys at once. Dashpots end at 100 times 2 sqrt(k m), k of the storey and m of the whole
    building, which locks the storey. No storey is softer than `least` times its stiffness at rest.
    """
    numerical, laws = building.numerical, building.laws
    k, c = storey_values(numerical.K), storey_values(numerical.C)
    stiffness, dashpots = _ranges(building, k)
    found: list[Tangent] = []
    storeys = np.unique(laws.storey)
    for some in [storeys] if len(storeys) < 2 else [storeys, *storeys[:, None]]:
        where = f"storey {some[0] + 1}" if len(some) == 1 else "all storeys with laws"
        for soft in _ends(stiffness[some], ("softest", "stiffest")):
            for damped in _ends(dashpots[some], ("least damped", "most damped")):
                own_k, own_c = k.copy(), c.copy()
                own_k[some] += stiffness[some, soft.end]
                own_c[some] += dashpots[some, damped.end]
                words = [*soft.words, *damped.words]
                if (own_k < least * k).any():
                    words.append(f"at {100.0 * least:g} % of its stiffness at rest" if soft.words else "")
                    own_k = np.maximum(own_k, least * k)
                if not (np.array_equal(own_k, k) and np.array_equal(own_c, c)):
                    found.append(Tangent(f"{where} {', '.join(words)}", _building(building, own_k, own_c)))
    return found


@dataclass(frozen=True)
class _End:
    end: int  # 0 least, 1 most
    words: tuple[str, ...]


def _ends(ranges: Array, words: tuple[str, str]) -> Iterator[_End]:
    """Yield both ends of ranges (s, 2), or one without words if no range has a width."""
    if np.array_equal(ranges[:, 0], ranges[:, 1]):
        yield _End(0, ())
        return
    for end in (0, 1):
        yield _End(end, (words[end],))


def _ranges(building: Building, stiffness: Array) -> tuple[Array, Array]:
    """Return what the laws add to stiffness and dashpot of each storey (p, 2), at the least and at the most."""
    both = np.zeros((2, len(stiffness), 2))
    laws = building.laws
    for i, storey in enumerate(laws.storey):
        both[0, storey] += laws.stiffness[i]
        both[1, storey] += laws.dashpot[i]
    locked = LOCKING * 2.0 * np.sqrt(np.abs(stiffness) * np.trace(building.M))
    return both[0], np.minimum(both[1], locked[:, None])


def with_specimen(building: Building, factor: float) -> Building:
    """Return a linear building whose experimental storeys have `factor` times their stiffness."""
    return on_specimen(building, replace(building.specimen, K=factor * building.specimen.K))


def on_specimen(building: Building, specimen: Specimen) -> Building:
    """Return a linear building with another specimen of the same masses."""
    mass = building.interface_experimental_mass_kg
    return Building(building.numerical, specimen, mass, *assemble(building.numerical, specimen, mass))


def _building(building: Building, stiffness: Array, dashpots: Array) -> Building:
    numerical = replace(building.numerical, K=storey_matrix(stiffness), C=storey_matrix(dashpots))
    if building.has_program:  # its floors are no chain: what a tangent changes is one
        added = storey_matrix(stiffness - storey_values(building.numerical.K))
        numerical = replace(building.numerical, K=building.numerical.K + added)
    mass = building.interface_experimental_mass_kg
    return Building(numerical, building.specimen, mass, *assemble(numerical, building.specimen, mass))
