"""The 2020 RTHS benchmark (Silva et al.) simulated: partition, plant and PI-P controller at 4096 Hz.

Numbers: the benchmark's public release. Exact zero-order hold for plant and storeys, ground acceleration at
mid-sample, one sample of delay of the force; displacement and force noise are one draw, as released.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import expm

DT_S = 1 / 4096
K = np.array(
    [
        [26054883.879604, -23133938.877108, 5937035.463339],
        [-23133938.877108, 32560774.186380, -14419970.777237],
        [5937035.463339, -14419970.777237, 9267275.506224],
    ]
)
CASES = {1: (1000.0, 0.05), 2: (1100.0, 0.04), 3: (1300.0, 0.03), 4: (1000.0, 0.03)}
M_E, K_E, ZETA_E = 29.13, 1.19e6, 0.0097
C_E = 2 * ZETA_E * np.sqrt(M_E * K_E)
SCALE = 0.4
QUANTUM = 2.0**-18


@dataclass(frozen=True)
class Benchmark:
    """Reference (3, n), numerical storeys (3, n), measured interface displacement (n,) in m; force (n,) in N."""

    reference: np.ndarray
    numerical: np.ndarray
    measured: np.ndarray
    force_n: np.ndarray


def run(case: int, ground: np.ndarray, seed: int) -> Benchmark:
    """Run PI-P on a case under ground acceleration at mid-sample (n,) in m/s^2."""
    mass, ratio = CASES[case]
    M, C = mass * np.eye(3), modal_damping(mass, ratio)
    first = np.diag([1.0, 0.0, 0.0])
    numerical = held(*storeys(M - M_E * first, C - C_E * first, K - K_E * first, M))
    noise = np.random.default_rng(seed).normal(size=len(ground)) / np.sqrt(DT_S)
    whole = held(*storeys(M, C, K, M))
    lead, pi = tustin_lead(), tustin_pi()
    disp, measured, force, reference = loop(*numerical, *held(*plant()), *whole, lead, pi, ground, noise)
    return Benchmark(reference.T.copy(), disp.T.copy(), measured, force)


def modal_damping(mass: float, ratio: float) -> np.ndarray:
    squares, shapes = np.linalg.eigh(K / mass)
    return mass * shapes @ np.diag(2 * ratio * np.sqrt(squares)) @ shapes.T


def storeys(M: np.ndarray, C: np.ndarray, stiffness: np.ndarray, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A, B of M d2x + C dx + K x = -load 1 a_g - [f, 0, 0], inputs a_g and f."""
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(M, stiffness), -np.linalg.solve(M, C)]])
    inputs = np.column_stack([-load @ np.ones(3), -np.array([1.0, 0.0, 0.0])])
    return A, np.vstack([np.zeros((3, 2)), np.linalg.solve(M, inputs)])


def plant() -> tuple[np.ndarray, np.ndarray]:
    """Return A, B of valve (2 states), force, displacement, velocity; input the command."""
    a1b0, a2, a3, b1, b2, gain = 2.1283e13, 4.2297e6, 3.3, 425.0, 9.9976e4, 1.0261
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [-b2, -b1, 0.0, -a1b0, 0.0],
            [1.0, 0.0, -a3, 0.0, -a2],
            [0.0, 0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 1 / M_E, -K_E / M_E, -C_E / M_E],
        ]
    )
    return A, np.array([[0.0], [gain * a1b0], [0.0], [0.0], [0.0]])


def held(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact zero-order hold."""
    n, m = B.shape
    exponential = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * DT_S)
    return exponential[:n, :n].copy(), exponential[:n, n:].copy()


def tustin_lead() -> np.ndarray:
    b1, b0, a0 = 50.8316336, 8570.39733944, 8570.39733944
    w = 2 / DT_S
    return np.array([b1 * w + b0, -b1 * w + b0, a0 - w]) / (w + a0)


def tustin_pi() -> np.ndarray:
    kp, ki = 2.0, 95.0
    return np.array([kp + ki * DT_S / 2, -kp + ki * DT_S / 2])


@njit(cache=True)
def loop(An, Bn, Ap, Bp, Aw, Bw, lead, pi, ground, noise):
    n = len(ground)
    disp, reference = np.zeros((n, 3)), np.zeros((n, 3))
    measured, force = np.zeros(n), np.zeros(n)
    xn, xp, xw = np.zeros(6), np.zeros(5), np.zeros(6)
    target_before = lead_before = error_before = command = felt = 0.0
    for k in range(n):
        disp[k], reference[k] = xn[:3], xw[:3]
        measured[k] = xp[3] + np.sqrt(6.25e-14) * noise[k]
        force[k] = xp[2] + np.sqrt(1.16e-3) * noise[k]
        target = QUANTUM * np.round(xn[0] / QUANTUM)
        leading = lead[0] * target + lead[1] * target_before - lead[2] * lead_before
        error = leading - QUANTUM * np.round(measured[k] / QUANTUM)
        command += pi[0] * error + pi[1] * error_before
        target_before, lead_before, error_before = target, leading, error
        xn = An @ xn + Bn[:, 0] * ground[k] + Bn[:, 1] * felt
        xw = Aw @ xw + Bw[:, 0] * ground[k]
        xp = Ap @ xp + Bp[:, 0] * QUANTUM * np.round(command / QUANTUM)
        felt = force[k]
    return disp, measured, force, reference
