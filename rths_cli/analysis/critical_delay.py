"""The critical delay of a building: the pure delay of the base shear that makes its hybrid test unstable.

Without ground motion, the loop goes from the interface floor's absolute acceleration a through the specimen to the base
shear f(t - delay), and through the numerical substructure back to a: 1 = L(s) exp(-s delay). At a frequency with
|L(j w)| = 1 a delay of (arg L mod 2 pi) / w puts a pole on the imaginary axis; the smallest such delay is critical.

A building with laws has one critical delay per tangent: a range. That is an indication, no proof: a loop that is stable
at every frozen tangent may still diverge, and one that is not may end in a bounded vibration. SIM-DELAY shows which.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, StateSpace
from rths_cli.structure import Building
from rths_cli.structure.tangents import at_tangents

ON_AXIS = 1e-6  # largest real part over size of an eigenvalue that counts as imaginary


@dataclass(frozen=True)
class CriticalDelay:
    """The critical delay of a building."""

    delay_s: float  # infinite: every delay is stable; 0: none is
    frequency_hz: float  # at which stability is lost
    gain_at_infinity: float  # of the loop: the interface floor's mass on the table over its computed mass


def critical_delay(building: Building) -> CriticalDelay:
    """Return the critical pure delay of a building without table dynamics."""
    loop = open_loop(building)
    high = abs(float(loop.D[0, 0]))
    if high >= 1.0:
        return CriticalDelay(0.0, math.inf, high)
    crossings = unit_gain_rad_s(loop)
    if not crossings.size:
        return CriticalDelay(math.inf, math.nan, high)
    phase = np.angle(loop.response(crossings / (2.0 * np.pi))[0, 0])
    delays = np.mod(phase, 2.0 * np.pi) / crossings
    first = int(np.argmin(delays))
    return CriticalDelay(float(delays[first]), float(crossings[first] / (2.0 * np.pi)), high)


@dataclass(frozen=True)
class CriticalDelayRange:
    """The critical delays of a building with laws: at rest, the smallest and the largest of all its tangents."""

    at_rest: CriticalDelay
    smallest: CriticalDelay
    largest: CriticalDelay
    unstable: int  # tangents left out, because the undivided building is unstable there without a delay


def critical_delay_range(building: Building) -> CriticalDelayRange:
    """Return the range of `critical_delay` over the tangents of a building's laws.

    It has the building at rest and those of `structure.tangents.at_tangents`.
    """
    at_rest = critical_delay(building)
    frozen = [one.building for one in at_tangents(building)]
    stable = [one for one in frozen if _stable(one)]
    found = [at_rest, *map(critical_delay, stable)]
    largest = max(found, key=lambda one: one.delay_s)
    return CriticalDelayRange(at_rest, min(found, key=lambda one: one.delay_s), largest, len(frozen) - len(stable))


def _stable(building: Building) -> bool:
    """Return whether the undivided building is stable; a storey without stiffness may drift."""
    inverse, n = np.linalg.inv(building.M), len(building.M)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ building.K, -inverse @ building.C]])
    values = np.linalg.eigvals(a)
    return bool(values.real.max() <= ON_AXIS * np.abs(values).max())


def open_loop(building: Building) -> StateSpace:
    """Return the loop from the interface floor's acceleration through the base shear back to it, without delay.

    Specimen: f = 1^T (C v + K x) - m_I a for displacements x relative to the table (Eq. 2.5, 2.6); numerical part:
    a = (f e_p - C v - K x)_p / m_p for displacements relative to the ground (Eq. 2.3).
    """
    specimen, numerical = building.specimen, building.numerical
    n, p = len(specimen.masses_kg), len(numerical.masses_kg)
    inverse, own = 1.0 / specimen.masses_kg[:, None], 1.0 / numerical.masses_kg[:, None]
    shear = np.concatenate([specimen.K.sum(axis=0), specimen.C.sum(axis=0)])
    motion = -np.hstack([own * numerical.K, own * numerical.C])
    a = np.zeros((2 * (n + p), 2 * (n + p)))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n] = -np.hstack([inverse * specimen.K, inverse * specimen.C])
    a[2 * n : 2 * n + p, 2 * n + p :] = np.eye(p)
    a[2 * n + p :, 2 * n :] = motion
    a[-1, : 2 * n] = own[-1, 0] * shear
    high = -building.interface_experimental_mass_kg * own[-1, 0]
    b = np.zeros((len(a), 1))
    b[n : 2 * n, 0] = -1.0
    b[-1, 0] = high
    c = a[-1:].copy()
    return StateSpace(a, b, c, np.array([[high]]))


def unit_gain_rad_s(loop: StateSpace) -> Array:
    """Return the frequencies in rad/s, ascending, at which |L| = 1, for |D| below 1.

    They are the imaginary eigenvalues of the Hamiltonian matrix of the bounded real lemma (Boyd, Balakrishnan, Kabamba,
    Math. Control Signals Systems 2, 1989).
    """
    d = float(loop.D[0, 0])
    rest = 1.0 - d * d
    inner = loop.A + loop.B @ loop.C * (d / rest)
    corner = loop.C.T @ loop.C * (-1.0 - d * d / rest)
    hamiltonian = np.block([[inner, loop.B @ loop.B.T / rest], [corner, -inner.T]])
    values = np.linalg.eigvals(hamiltonian)
    on_axis = (np.abs(values.real) < ON_AXIS * np.abs(values)) & (values.imag > 0.0)
    return np.sort(values.imag[on_axis])
