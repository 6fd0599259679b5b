"""State-space forms that keep their digits, and their discretisation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from rths_cli.numerics.lti import Array, Block, ComplexArray, StateSpace
from rths_cli.numerics.matrix_equations import exponential

Hold = Literal["foh", "zoh", "bilinear"]


def residues(zeros: ComplexArray, poles: ComplexArray, gain: float) -> ComplexArray:
    """Return the residue of gain prod(s - z) / prod(s - p) at each of its distinct poles, (n_poles,)."""
    values = np.empty(len(poles), dtype=complex)
    for i, pole in enumerate(poles):
        others = np.delete(poles, i)
        values[i] = gain * _ratio(pole, zeros, others)
    return values


def _ratio(s: complex, zeros: ComplexArray, poles: ComplexArray) -> complex:
    """Return prod(s - z) / prod(s - p), factor by factor so that it does not overflow."""
    value = 1.0 + 0.0j
    for k in range(max(len(zeros), len(poles))):
        if k < len(zeros):
            value *= s - zeros[k]
        if k < len(poles):
            value /= s - poles[k]
    return value


def modal(poles: ComplexArray, weights: ComplexArray, direct: float) -> StateSpace:
    """Return direct + sum of weight / (s - pole) in real modal form: 1 x 1 and 2 x 2 blocks, one input and output.

    Poles come in conjugate pairs with conjugate weights; of each pair the upper one is used.
    """
    upper = [(p, w) for p, w in zip(poles, weights, strict=True) if p.imag >= 0.0]
    n = sum(1 if p.imag == 0.0 else 2 for p, _ in upper)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    row = 0
    for p, w in upper:
        scale = np.sqrt(abs(w)) or 1.0
        if p.imag == 0.0:
            a[row, row], b[row, 0], c[0, row] = p.real, scale, w.real / scale
            row += 1
            continue
        a[row : row + 2, row : row + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        b[row, 0] = scale
        c[0, row : row + 2] = [2.0 * w.real / scale, 2.0 * w.imag / scale]
        row += 2
    return StateSpace(a, b, c, np.array([[direct]]))


def from_roots(zeros: ComplexArray, poles: ComplexArray, gain: float) -> StateSpace:
    """Return the real modal form of gain prod(s - z) / prod(s - p) with distinct poles, proper."""
    direct = gain if len(zeros) == len(poles) else 0.0
    return modal(poles, residues(zeros, poles, gain), direct)


def discretise(
    system: StateSpace, dt_s: float, method: Hold, name: str, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> Block:
    """Return the block of a continuous system: `foh` for inputs that are straight lines between samples, `zoh` for
    held ones, `bilinear` (Tustin)."""
    if system.A.shape[0] == 0:
        return static(system.D, dt_s, name, inputs, outputs)
    sampled = {"foh": _straight, "zoh": _held, "bilinear": _bilinear}[method](system, dt_s)
    return Block(name, sampled.A, sampled.B, sampled.C, sampled.D, dt_s, inputs, outputs)


def _held(system: StateSpace, dt_s: float) -> StateSpace:
    """Return a system sampled exactly for inputs that are held from sample to sample."""
    n, m = system.B.shape
    both = exponential(dt_s * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))
    return StateSpace(both[:n, :n], both[:n, n:], system.C, system.D)


def _straight(system: StateSpace, dt_s: float) -> StateSpace:
    """Return a system sampled exactly for inputs that are straight lines between samples, its state x less the end's
    share of the input (Franklin, Powell, Workman, Digital Control of Dynamic Systems, section 6.3.2)."""
    n, m = system.B.shape
    chain = np.zeros((n + 2 * m, n + 2 * m))
    chain[:n, :n], chain[:n, n : n + m] = system.A * dt_s, system.B * dt_s
    chain[n : n + m, n + m :] = np.eye(m)
    rows = exponential(chain)[:n]
    a, start, end = rows[:, :n], rows[:, n : n + m], rows[:, n + m :]
    return StateSpace(a, start - end + a @ end, system.C, system.D + system.C @ end)


def _bilinear(system: StateSpace, dt_s: float) -> StateSpace:
    """Return a system with s = 2 / dt (z - 1) / (z + 1) (Tustin)."""
    half: Array = np.asarray(0.5 * dt_s * system.A)
    eye = np.eye(len(half))
    a = np.asarray(np.linalg.solve(eye - half, eye + half), dtype=float)
    b = np.asarray(np.linalg.solve(eye - half, dt_s * system.B), dtype=float)
    c = np.asarray(np.linalg.solve((eye - half).T, system.C.T).T, dtype=float)
    return StateSpace(a, b, c, system.D + 0.5 * system.C @ b)


def static(gain: Array, dt_s: float, name: str, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Block:
    """Return a block without memory, y = gain u, gain (p, m)."""
    p, m = gain.shape
    return Block(name, np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), gain, dt_s, inputs, outputs)
