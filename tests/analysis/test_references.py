"""References are chosen by what a building declares of itself."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest
from open_loop import specimen, storeys

from rths_cli.analysis.references import REFERENCES, Reference, reference_of
from rths_cli.analysis.sim import Response, simulate
from rths_cli.analysis.sim_delay import DelayedResponse, simulate_delayed
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building, assemble

DT_S = 1e-3
GROUND = np.sin(2.0 * np.pi * 2.0 * DT_S * np.arange(2000))


def building() -> Building:
    computed, tested = storeys(), specimen()
    return Building(computed, tested, 1.2, *assemble(computed, tested, 1.2))


@dataclass(frozen=True)
class Rocking(Building):
    """A building that rocks on its foundation, so that its matrices describe it only at rest."""

    rocks: tuple[str, ...] = ("uplift",)

    @property
    def linear(self) -> bool:
        return False

    @property
    def has_laws(self) -> bool:
        return False


def rocking(rocks: tuple[str, ...] = ("uplift",)) -> Rocking:
    made = building()
    return Rocking(**{each.name: getattr(made, each.name) for each in fields(made)}, rocks=rocks)


def test_a_linear_building_has_the_exact_modes() -> None:
    found, made = reference_of(building()), building()
    assert found.needs == ("linear",)
    sim = found.sim(made, DT_S, GROUND)
    assert np.array_equal(sim.abs_accel_m_s2, simulate(made, DT_S, GROUND).abs_accel_m_s2)
    late = found.sim_delay(made, DT_S, GROUND, 0.003, sim)
    assert np.array_equal(late.abs_accel_m_s2, simulate_delayed(made, DT_S, GROUND, 0.003).abs_accel_m_s2)


def test_a_building_that_no_reference_solves_is_refused_with_what_it_lacks() -> None:
    with pytest.raises(InputError) as refused:
        reference_of(rocking())
    (fault,) = refused.value.faults
    assert fault == (
        "structure: this building has no SIM and no SIM-DELAY: exact modes need it to declare linear; "
        "programs need it to declare has_program; laws of storeys need it to declare has_laws"
    )


def by_rocking(made: Building, dt_s: float, ground: Array) -> Response:
    return Response(*(np.full((3, ground.size), 7.0),) * 3, np.zeros(ground.size), 0.0)


def by_rocking_delayed(made: Building, dt_s: float, ground: Array, delay_s: float, sim: Response) -> DelayedResponse:
    series = {each.name: getattr(sim, each.name) for each in fields(sim)}
    return DelayedResponse(**series, substep_s=dt_s, diverged_at_s=None)


def test_another_kind_of_building_brings_its_reference_by_one_registration() -> None:
    """It is taken for buildings that declare its property; the linear ones keep theirs, whatever stands first."""
    registered = (Reference("steps of rocking", ("rocks",), by_rocking, by_rocking_delayed), *REFERENCES)
    assert reference_of(rocking(), registered).sim(rocking(), DT_S, GROUND).abs_accel_m_s2[0, 0] == 7.0
    assert reference_of(building(), registered) is REFERENCES[0]
    with pytest.raises(InputError, match="steps of rocking need it to declare rocks; exact modes need it to declare"):
        reference_of(rocking(rocks=()), registered)


def test_a_building_counts_its_storeys() -> None:
    assert building().storeys == len(building().M) and building().linear
