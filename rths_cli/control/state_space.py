"""Build, connect and discretise state-space systems without loss of digits; their data classes: numerics/lti.py."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.linalg import expm

from rths_cli.numerics.lti import Array, Block, ComplexArray, StateSpace

Hold = Literal["foh", "zoh", "bilinear"]
NEARLY_EQUAL = 1e-3  # of two poles' size: nearer ones have residues of a thousand times the response, and more


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
    """Return gain prod(s - z) / prod(s - p), proper: in modal form, or as a chain where two poles nearly coincide.

    Partial fractions of nearly equal poles are huge and cancel; a chain of sections has no such numbers.
    """
    if _nearly_equal(poles):
        return in_series(zeros, poles, gain)
    direct = gain if len(zeros) == len(poles) else 0.0
    return modal(poles, residues(zeros, poles, gain), direct)


def _nearly_equal(roots: ComplexArray) -> bool:
    """Tell whether two of the roots are nearer to each other than NEARLY_EQUAL of their size."""
    apart = np.abs(roots[:, None] - roots)[np.triu_indices(len(roots), 1)]
    size = np.maximum(np.abs(roots)[:, None], np.abs(roots))[np.triu_indices(len(roots), 1)]
    return bool(np.any(apart <= NEARLY_EQUAL * size))  # equal at zero, too


def in_series(zeros: ComplexArray, poles: ComplexArray, gain: float) -> StateSpace:
    """Return gain prod(s - z) / prod(s - p), proper, as a chain of sections of at most two poles, slow ones first.

    Each section has the slowest of the zeros that are left, and a gain of one at its own frequency. Poles may be equal.
    """
    chain = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
    sections, left = _in_pairs(poles), _in_pairs(zeros)
    for section in sections:
        last_alone = len(left) > 0 and len(left[-1]) == 1 and len(section) == 1
        fits = len(left) > 0 and len(left[0]) <= len(section) and (len(left[0]) == 2 or len(poles) % 2 == 0)
        given = left.pop() if last_alone else left.pop(0) if fits else np.zeros(0, dtype=complex)
        following, factor = _section(given, section)
        chain, gain = _behind(chain, following), gain * factor
    return StateSpace(chain.A, chain.B, gain * chain.C, gain * chain.D)


def _in_pairs(roots: ComplexArray) -> list[ComplexArray]:
    """Return roots, slow ones first, as conjugate pairs, real ones two by two; a real one alone comes last."""
    upper, real = roots[roots.imag > 0.0], roots[roots.imag == 0.0]
    real = real[np.argsort(np.abs(real), kind="stable")]
    pairs = [np.array([p, p.conj()]) for p in upper] + [real[i : i + 2] for i in range(0, len(real), 2)]
    return sorted(pairs, key=lambda pair: (len(pair) == 1, float(np.abs(pair).max())))


def _section(zeros: ComplexArray, poles: ComplexArray) -> tuple[StateSpace, float]:
    """Return prod(s - z) / prod(s - p) divided by a factor, and the factor: its size at the frequency of the poles.

    Time is counted in their periods within, so that all numbers are near one.
    """
    size = float(np.abs(poles).max()) or 1.0
    below, above = (np.atleast_1d(np.poly(roots / size)).real for roots in (poles, zeros))
    n = len(poles)
    above = np.concatenate([np.zeros(n + 1 - len(above)), above])
    factor = float(abs(np.polyval(above, 1j) / np.polyval(below, 1j))) or 1.0
    above = above / factor
    a, b = np.eye(n, k=1), np.zeros((n, 1))
    a[-1], b[-1, 0] = -below[:0:-1], 1.0
    c = (above[1:] - above[0] * below[1:])[::-1]
    return StateSpace(size * a, size * b, c[None, :], np.array([[above[0]]])), factor * size ** (len(zeros) - n)


def _behind(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return two systems of one input and output, the second driven by the first."""
    n, m = len(first.A), len(second.A)
    a = np.block([[first.A, np.zeros((n, m))], [second.B @ first.C, second.A]])
    b = np.vstack([first.B, second.B @ first.D])
    return StateSpace(a, b, np.hstack([second.D @ first.C, second.C]), second.D @ first.D)


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
    both = expm(dt_s * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))
    return StateSpace(both[:n, :n], both[:n, n:], system.C, system.D)


def _straight(system: StateSpace, dt_s: float) -> StateSpace:
    """Return a system sampled exactly for inputs that are straight lines between samples, its state x less the end's
    share of the input (Franklin, Powell, Workman, Digital Control of Dynamic Systems, section 6.3.2)."""
    n, m = system.B.shape
    chain = np.zeros((n + 2 * m, n + 2 * m))
    chain[:n, :n], chain[:n, n : n + m] = system.A * dt_s, system.B * dt_s
    chain[n : n + m, n + m :] = np.eye(m)
    rows = expm(chain)[:n]
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
