"""A chain of storeys on a shake table, integrated by its own Runge-Kutta scheme: data for the diagnosis of channels.

It shares no code with the project's virtual rig: a servo holds the table at the command times a gain (a spring and a
dashpot to the commanded place, which an amplifier smooths), beside it act viscous damping, dry friction, a suspension with a cubic part and the
specimen, whose storeys may soften. Commands are held over a sample and act after the latency.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
SUBSTEPS_PER_CYCLE = 25  # of the fastest natural frequency


@dataclass(frozen=True)
class Plant:
    """Masses in kg, storey stiffnesses in N/m and modal damping ratios of a chain (n,), and the table under it.

    `cubic_n_per_m3`: of the table's suspension; `softening_m`: drift at which a storey has lost half of its stiffness
    (inf: none); `servo_hz`, `servo_ratio`: of the loaded table; `lag_s`: of the amplifier.
    """

    masses_kg: Array
    stiffness_n_per_m: Array
    damping_ratio: Array
    table_kg: float = 7.0
    servo_hz: float = 25.0
    servo_ratio: float = 0.7
    lag_s: float = 1.5e-3
    gain_m_per_v: float = 0.0079
    suspension_n_per_m: float = 0.0
    cubic_n_per_m3: float = 0.0
    coulomb_n: float = 0.0
    coulomb_velocity_m_s: float = 1e-3
    softening_m: float = field(default=float("inf"))

    def matrices(self) -> tuple[Array, Array]:
        """Return stiffness and damping (n, n) of the floors relative to the table."""
        n, k = len(self.masses_kg), self.stiffness_n_per_m
        K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
        root = np.sqrt(self.masses_kg)
        values, vectors = np.linalg.eigh(K / np.outer(root, root))
        modal = vectors * (2.0 * self.damping_ratio * np.sqrt(values)) @ vectors.T
        return K, np.outer(root, root) * modal if n else np.zeros((0, 0))

    def natural_hz(self) -> Array:
        """Return the fixed-base natural frequencies in Hz (n,)."""
        root = np.sqrt(self.masses_kg)
        return np.sqrt(np.linalg.eigvalsh(self.matrices()[0] / np.outer(root, root))) / (2.0 * np.pi)

    def simulate(self, command_v: Array, dt_s: float, latency_samples: int) -> Array:
        """Return absolute accelerations (n + 1, samples) in m/s^2 of table and floors at each sample's instant."""
        total = self.table_kg + float(self.masses_kg.sum())
        servo = total * (2.0 * np.pi * self.servo_hz) ** 2
        dashpot = 2.0 * self.servo_ratio * np.sqrt(servo * total)
        fastest = max(self.servo_hz * np.sqrt(total / self.table_kg), self.natural_hz().max(initial=1.0))
        substeps = max(int(np.ceil(dt_s * fastest * SUBSTEPS_PER_CYCLE)), 1)
        late = np.concatenate([np.zeros(latency_samples), command_v])[: len(command_v)]
        return _integrate(
            self.gain_m_per_v * late, dt_s, substeps, self.lag_s, self.table_kg, servo, dashpot, self.suspension_n_per_m,
            self.cubic_n_per_m3, self.coulomb_n, self.coulomb_velocity_m_s, self.masses_kg.astype(float),
            self.stiffness_n_per_m.astype(float), self.matrices()[1], self.softening_m,
        )  # fmt: skip


@njit(cache=False)
def _integrate(
    place,
    dt,
    substeps,
    lag,
    table_kg,
    servo,
    dashpot,
    suspension,
    cubic,
    coulomb,
    slow,
    masses,
    stiffness,
    C,
    softening,
):  # type: ignore[no-untyped-def]
    n = len(masses)
    x, v = np.zeros(n + 1), np.zeros(n + 1)
    accel, out = np.zeros(n + 1), np.zeros((n + 1, len(place)))
    a1, a2, a3, a4 = accel.copy(), accel.copy(), accel.copy(), accel.copy()
    h = dt / substeps
    constants = (table_kg, servo, dashpot, suspension, cubic, coulomb, slow, masses, stiffness, C, softening)
    begin, middle, end = 0.0, 0.0, 0.0
    half = np.exp(-0.5 * h / lag)
    for k in range(len(place)):
        _accelerate(x, v, end, *constants, accel)
        out[:, k] = accel
        for _ in range(substeps):
            begin = end
            middle = place[k] + (begin - place[k]) * half
            end = place[k] + (middle - place[k]) * half
            _accelerate(x, v, begin, *constants, a1)
            v2 = v + 0.5 * h * a1
            _accelerate(x + 0.5 * h * v, v2, middle, *constants, a2)
            v3 = v + 0.5 * h * a2
            _accelerate(x + 0.5 * h * v2, v3, middle, *constants, a3)
            v4 = v + h * a3
            _accelerate(x + h * v3, v4, end, *constants, a4)
            x = x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return out


@njit(cache=False)
def _accelerate(
    x, v, place, table_kg, servo, dashpot, suspension, cubic, coulomb, slow, masses, stiffness, C, softening, accel
):  # type: ignore[no-untyped-def]
    """Write the absolute accelerations (n + 1,) of table and floors at places x and speeds v."""
    n = len(masses)
    on_table = servo * (place - x[0]) - dashpot * v[0] - suspension * x[0] - cubic * x[0] ** 3
    on_table -= coulomb * np.tanh(v[0] / slow)
    below = 0.0
    for i in range(n):
        drift = x[i + 1] - x[i]
        below = stiffness[i] * drift / (1.0 + abs(drift) / softening)
        damping = 0.0
        for j in range(n):
            damping += C[i, j] * (v[j + 1] - v[0])
        accel[i + 1] = -below - damping
        on_table += damping
        if i == 0:
            on_table += below
        else:
            accel[i] += below
    for i in range(n):
        accel[i + 1] /= masses[i]
    accel[0] = on_table / table_kg
