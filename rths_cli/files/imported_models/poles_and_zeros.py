"""Roots of an imported model: complex pairs, order, count at the origin."""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.lti import ComplexArray

AT_ORIGIN = 1e-6  # of the smallest other root
PAIRED = 1e-6  # relative distance of a root from the conjugate of its partner
REAL = 1e-9  # imaginary part over magnitude of a real root


def count_at_origin(zeros: ComplexArray, poles: ComplexArray) -> int:
    """Return how many zeros are at the origin: below 1e-6 of the smallest of all other roots."""
    size = np.sort(np.abs(zeros))
    other = np.abs(poles)[np.abs(poles) > 0.0]
    for count in range(len(size), 0, -1):
        smallest = min([*size[count:], *other], default=0.0)
        if size[count - 1] == 0.0 or size[count - 1] < AT_ORIGIN * smallest:
            return count
    return 0


def paired(roots: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return conjugate pairs, then real roots, each by rising magnitude; and the roots without a partner."""
    rising = roots[np.argsort(np.abs(roots), kind="stable")]
    real = np.abs(rising.imag) <= REAL * np.abs(rising)
    lower = list(rising[~real & (rising.imag < 0.0)])
    ordered, lonely = [], []
    for root in rising[~real & (rising.imag > 0.0)]:
        distance = [abs(other - np.conj(root)) for other in lower]
        if not lower or min(distance) > PAIRED * abs(root):
            lonely.append(root)
            continue
        middle = 0.5 * (root + np.conj(lower.pop(int(np.argmin(distance)))))
        ordered += [middle, np.conj(middle)]
    return np.array([*ordered, *rising[real].real], dtype=complex), np.array(lonely + lower, dtype=complex)


def shown(roots: ComplexArray) -> str:
    """Return up to three roots as text."""
    texts = [f"{root.real:.6g}{root.imag:+.6g}j" if root.imag else f"{root.real:.6g}" for root in roots[:3]]
    return ", ".join(texts) + (", ..." if len(roots) > 3 else "")
