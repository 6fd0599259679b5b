"""The response that a structural engineer designs for: inter-storey drifts, storey shears, base shear, their peaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array


def inter_storey_drift_m(rel_disp_m: Array) -> Array:
    """Return the drifts (n_storeys, n) in m: each floor's displacement less that of the floor, or ground, below.

    `rel_disp_m` (n_storeys, n): displacements relative to the ground, from the lowest floor up.
    """
    return np.diff(rel_disp_m, axis=0, prepend=np.zeros((1, rel_disp_m.shape[1])))


def storey_shear_n(masses_kg: Array, abs_accel_m_s2: Array) -> Array:
    """Return the shears (n_storeys, n) in N that the storeys transmit by their springs and dashpots.

    By equilibrium the shear of a storey is what its spring and dashpot do to the floors above, -sum m_j a_j over floors
    j from that storey up; it has the sign of the drift. The first is the base shear of the building. `masses_kg`
    (n_storeys,), of a frame the rows of its mass matrix (n_storeys, n_storeys); `abs_accel_m_s2` (n_storeys, n) from
    the lowest floor up.
    """
    masses = np.asarray(masses_kg)
    inertia = -(masses @ abs_accel_m_s2) if masses.ndim == 2 else -masses[:, None] * abs_accel_m_s2
    return np.asarray(np.cumsum(inertia[::-1], axis=0)[::-1])


def restoring_force_n(springs_n_per_m: Array, drift_m: Array, law_force_n: Array) -> Array:
    """Return the force (s, n) in N of spring and laws of the lowest s storeys, without dashpots.

    `springs_n_per_m` (n_storeys,) and `drift_m` (n_storeys, n), of which the lowest count; `law_force_n` (s, n) beside
    the springs.
    """
    known = len(law_force_n)
    return np.asarray(springs_n_per_m[:known, None] * drift_m[:known] + law_force_n)


@dataclass(frozen=True)
class Peaks:
    """Largest absolute values of a building's response over the record, all frequencies, (n_storeys,) each."""

    abs_accel_m_s2: Array
    rel_disp_m: Array
    inter_storey_drift_m: Array
    storey_shear_n: Array
    weight_n: float

    @property
    def base_shear_n(self) -> float:
        """Return the peak of the building's base shear."""
        return float(self.storey_shear_n[0])

    @property
    def base_shear_ratio(self) -> float:
        """Return the peak of the base shear over the building's weight."""
        return self.base_shear_n / self.weight_n

    def drift_ratio(self, heights_m: Array) -> Array:
        """Return the peak drifts over the storeys' heights (n_storeys,)."""
        return np.asarray(self.inter_storey_drift_m / np.asarray(heights_m))


def peaks(masses_kg: Array, rel_disp_m: Array, abs_accel_m_s2: Array, mass_kg: float | None = None) -> Peaks:
    """Return the peaks of a response: masses as of `storey_shear_n`, series (n_storeys, n) from the lowest floor up;
    `mass_kg` of the whole building, None: their sum."""
    drift, shear = inter_storey_drift_m(rel_disp_m), storey_shear_n(masses_kg, abs_accel_m_s2)
    weight_n = (float(np.sum(masses_kg)) if mass_kg is None else mass_kg) * STANDARD_GRAVITY_M_S2
    return Peaks(_largest(abs_accel_m_s2), _largest(rel_disp_m), _largest(drift), _largest(shear), weight_n)


def _largest(series: Array) -> Array:
    return np.asarray(np.abs(series).max(axis=1, initial=0.0))
