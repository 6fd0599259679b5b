"""A chain of storeys on a shake table, integrated by its own exact solution: data for the diagnosis of channels.

It shares no code with the project's virtual rig: a servo (a spring and a dashpot) holds the table at the command times
a gain, which an amplifier smooths; beside it act dry friction, a suspension with a cubic part and the specimen, whose
storeys may soften. Commands are held over a sample and act after the latency. Without friction and the like the motion
is the exact one of the linear system, mode by mode; what is not linear is held over steps of half a millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, tanh

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

Array = NDArray[np.float64]
LONGEST_STEP_S = 5e-4


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
    softening_m: float = float("inf")

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

    @property
    def linear(self) -> bool:
        """Tell whether nothing in it depends on the level."""
        return self.coulomb_n == 0.0 and self.cubic_n_per_m3 == 0.0 and not np.isfinite(self.softening_m)

    def system(self) -> tuple[Array, Array, Array]:
        """Return x' = A x + b u + N f and the rows of the accelerations, A x + N f: states are places and speeds of
        table and floors, then the smoothed command; f are forces on the storeys, the table's first."""
        n, (K, C) = len(self.masses_kg), self.matrices()
        total = self.table_kg + float(self.masses_kg.sum())
        servo = total * (2.0 * np.pi * self.servo_hz) ** 2
        dashpot = 2.0 * self.servo_ratio * np.sqrt(servo * total)
        relative = np.hstack([-np.ones((n, 1)), np.eye(n)])
        stiffness, damping = relative.T @ K @ relative, relative.T @ C @ relative
        stiffness[0, 0] += servo + self.suspension_n_per_m
        damping[0, 0] += dashpot
        inverse = 1.0 / np.concatenate([[self.table_kg], self.masses_kg])
        size = n + 1
        A = np.zeros((2 * size + 1, 2 * size + 1))
        A[:size, size : 2 * size] = np.eye(size)
        A[size : 2 * size, :size] = -inverse[:, None] * stiffness
        A[size : 2 * size, size : 2 * size] = -inverse[:, None] * damping
        A[size, -1] = servo * inverse[0]
        A[-1, -1] = -1.0 / self.lag_s
        b = np.zeros(2 * size + 1)
        b[-1] = 1.0 / self.lag_s
        between = np.eye(size) - np.diag(np.ones(n), 1)  # a storey's force pulls its floor back and the one below along
        N = np.vstack([np.zeros((size, size)), inverse[:, None] * between, np.zeros((1, size))])
        return A, b, N

    def simulate(self, command_v: Array, dt_s: float, latency_samples: int) -> Array:
        """Return absolute accelerations (n + 1, samples) in m/s^2 of table and floors at each sample's instant, before
        that instant's command acts."""
        late = np.concatenate([np.zeros(latency_samples), command_v])[: len(command_v)]
        place = self.gain_m_per_v * late
        return self._exact(place, dt_s) if self.linear else self._stepped(place, dt_s)

    def _exact(self, place_m: Array, dt_s: float) -> Array:
        """Return the accelerations of the linear system, mode by mode."""
        A, b, _ = self.system()
        values, vectors = np.linalg.eig(A)
        given = np.linalg.solve(vectors, b.astype(complex))
        size = len(self.masses_kg) + 1
        out = np.zeros((size, len(place_m)))
        rows = A[size : 2 * size] @ vectors
        for value, part, row in zip(values, given, rows.T, strict=True):
            step = np.exp(value * dt_s)
            moved = lfilter([0.0, (step - 1.0) / value * part], [1.0, -step], place_m.astype(complex))
            out += (row[:, None] * moved).real
        return out

    def _stepped(self, place_m: Array, dt_s: float) -> Array:
        """Return the accelerations with what is not linear held over short steps."""
        A, b, N = self.system()
        steps = int(np.ceil(dt_s / LONGEST_STEP_S))
        size, h = len(self.masses_kg) + 1, dt_s / steps
        block = np.zeros((len(A) + 1 + size, len(A) + 1 + size))
        block[: len(A), : len(A)], block[: len(A), len(A)], block[: len(A), len(A) + 1 :] = A, b, N
        moved = expm(block * h)[: len(A)]
        rows, forced = A[size : 2 * size], N[size : 2 * size]
        count, given = len(A), np.zeros(len(A) + 1 + size)  # state, place and forces, one behind the other
        x, f = given[:count], given[count + 1 :]
        seen = np.hstack([rows, np.zeros((size, 1)), forced])
        out = np.zeros((size, len(place_m)))
        for k, place in enumerate(place_m.tolist()):
            given[count] = place
            for step in range(steps):
                f[:] = self._forces(x.tolist())
                if step == 0:
                    out[:, k] = seen @ given
                x[:] = moved @ given
        return out

    def _forces(self, x: list[float]) -> list[float]:
        """Return what is not linear: friction and cubic spring on the table, and what the storeys lose in stiffness."""
        size = len(self.masses_kg) + 1
        f = [0.0] * size
        f[0] = -self.coulomb_n * tanh(x[size] / self.coulomb_velocity_m_s) - self.cubic_n_per_m3 * x[0] ** 3
        if isfinite(self.softening_m):
            for storey in range(1, size):
                drift = x[storey] - x[storey - 1]
                lost = 1.0 - 1.0 / (1.0 + abs(drift) / self.softening_m)
                f[storey] = float(self.stiffness_n_per_m[storey - 1]) * drift * lost
        return f
