"""SIM and SIM-DELAY of a building, chosen by the properties that it declares.

A reference is registered in REFERENCES with what it needs: names of properties of a building (`Building.linear`) that
must hold. The first one that fits is used. Another kind of building declares a property of its own and brings its
references in a module of their own; nothing else has to change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rths_cli.analysis.frame_sim import simulate_unreduced
from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.program_sim import simulate_delayed_with_program, simulate_with_program
from rths_cli.analysis.sim import Response, simulate
from rths_cli.analysis.sim_delay import DelayedResponse, simulate_delayed
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building

Sim = Callable[[Building, float, Array], Response]
"""SIM of a building for a record (n,) in m/s^2 with an interval in s, linear between samples, from rest."""
SimDelay = Callable[[Building, float, Array, float, Response], DelayedResponse]
"""SIM-DELAY of the same, with its delay in s and with SIM, which is known already."""


@dataclass(frozen=True)
class Reference:
    """How SIM and SIM-DELAY of a kind of building are computed."""

    name: str  # in words, for messages
    needs: tuple[str, ...]  # properties that must hold of a building
    sim: Sim
    sim_delay: SimDelay

    def missing(self, building: Building) -> tuple[str, ...]:
        """Return the needed properties that a building does not declare, or that do not hold."""
        return tuple(name for name in self.needs if not getattr(building, name, False))


def _modal(building: Building, dt_s: float, ground_accel_m_s2: Array) -> Response:
    """Return SIM of a linear building, with all degrees of freedom of its frame where that is reduced for the loop."""
    solve = simulate_unreduced if getattr(building, "reduced", False) else simulate
    return solve(building, dt_s, ground_accel_m_s2)


def _modal_delayed(
    building: Building, dt_s: float, ground_accel_m_s2: Array, delay_s: float, sim: Response
) -> DelayedResponse:
    return simulate_delayed(building, dt_s, ground_accel_m_s2, delay_s, sim=sim)


def _delayed_with_laws(
    building: Building, dt_s: float, ground_accel_m_s2: Array, delay_s: float, sim: Response
) -> DelayedResponse:
    return simulate_delayed_with_laws(building, dt_s, ground_accel_m_s2, delay_s, sim=sim)


REFERENCES = (
    Reference("exact modes", ("linear",), _modal, _modal_delayed),
    Reference("programs", ("has_program",), simulate_with_program, simulate_delayed_with_program),
    Reference("laws of storeys", ("has_laws",), simulate_with_laws, _delayed_with_laws),
)
"""Every reference, the one that is preferred first."""


def reference_of(building: Building, references: tuple[Reference, ...] = REFERENCES) -> Reference:
    """Return the reference of a building; raises InputError that names the missing property if there is none."""
    for reference in references:
        if not reference.missing(building):
            return reference
    told = "; ".join(f"{each.name} need it to declare {' and '.join(each.missing(building))}" for each in references)
    raise InputError(f"structure: this building has no SIM and no SIM-DELAY: {told}")
