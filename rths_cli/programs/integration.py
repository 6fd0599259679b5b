"""The response of a structure of which a program computes the lower floors: the program is asked at every step.

Explicit integration with Newmark's beta = 0 and gamma = 1/2, which needs the forces at displacements only (Newmark, J.
Eng. Mech. Div. 85(EM3), 1959): of second order, stable below 2 over the highest angular frequency. It is the reference
for the loop, which asks the program less often, and shares no code with it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rths_cli.numerics.lti import Array

Force = Callable[[Array], Array]
"""Displacements (p,) in m to restoring forces (p,) in N, in the order of time."""


def whole(force: Force, p: int, masses_kg: Array, C: Array, K: Array, dt_s: float, steps: int, ground: Array) -> Array:
    """Return displacement, velocity and acceleration (3, q, n) relative to the ground of the undivided structure.

    `masses_kg` (q,), C and K (q, q) without the program's forces, which act on the first `p` floors. `ground` (n,) in
    m/s^2, `dt_s` apart, is linear between samples, `steps` of the integration to a sample.
    """
    h, q = dt_s / steps, len(masses_kg)
    inverse = np.linalg.inv(np.diag(masses_kg) + 0.5 * h * C)
    found = np.zeros((3, q, len(ground)))
    x, v, a = np.zeros((3, q))
    a = inverse @ (-masses_kg * ground[0])
    found[2, :, 0] = a
    for k in range(1, len(ground)):
        for i in range(1, steps + 1):
            accel = ground[k - 1] + (ground[k] - ground[k - 1]) * i / steps
            x = x + h * v + 0.5 * h * h * a
            half = v + 0.5 * h * a
            load = -masses_kg * accel - C @ half - K @ x
            load[:p] -= force(x[:p])
            a = inverse @ load
            v = half + 0.5 * h * a
        found[0, :, k], found[1, :, k], found[2, :, k] = x, v, a
    return found


def divided(
    force: Force, masses_kg: Array, C: Array, specimen: tuple[Array, Array, Array], interface_kg: float, delay_s: float,
    dt_s: float, steps: int, ground: Array, largest_m_s2: float,
) -> tuple[Array, Array, int]:  # fmt: skip
    """Return the same of the structure divided at the interface, whose computed part gets the base shear late.

    `masses_kg` (p,) and C (p, p) are of the computed floors, `specimen` has masses (n,), C and K (n, n) of those on the
    table, relative to it; `interface_kg` of the interface floor stands on the table. Returned are displacements
    relative to the ground, velocities and absolute accelerations (3, p + n, samples), the base shear (samples,) in N,
    and the number of samples until an acceleration went beyond `largest_m_s2`.
    """
    h, p = dt_s / steps, len(masses_kg)
    on_table, C_table, K_table = specimen
    inverse = np.linalg.inv(np.diag(masses_kg) + 0.5 * h * C)
    inverse_table = np.linalg.inv(np.diag(on_table) + 0.5 * h * C_table)
    found, shear = np.zeros((3, p + len(on_table), len(ground))), np.zeros(len(ground))
    late = _Delayed(delay_s / h, steps * len(ground))
    x, v, a = np.zeros((3, p))
    y, w, b = np.zeros((3, len(on_table)))  # relative to the table
    a = inverse @ (-masses_kg * ground[0])
    for k in range(1, len(ground)):
        for i in range(1, steps + 1):
            accel = ground[k - 1] + (ground[k] - ground[k - 1]) * i / steps
            x = x + h * v + 0.5 * h * h * a
            half = v + 0.5 * h * a
            load = -masses_kg * accel - C @ half - force(x)
            load[-1] += late.value()
            a = inverse @ load
            v = half + 0.5 * h * a
            table = a[-1] + accel
            y = y + h * w + 0.5 * h * h * b
            half = w + 0.5 * h * b
            b = inverse_table @ (-on_table * table - C_table @ half - K_table @ y)
            w = half + 0.5 * h * b
            f = -interface_kg * table - float(on_table @ (b + table))
            late.note(f)
        found[:, :p, k] = x, v, a + accel
        found[:, p:, k] = x[-1] + y, v[-1] + w, b + table
        shear[k] = f
        if not np.abs(found[2, :, k]).max() < largest_m_s2:
            return found, shear, k
    return found, shear, len(ground)


class _Delayed:
    """A series that is read a number of steps, at least one, after it was noted; straight lines between steps."""

    def __init__(self, steps: float, count: int) -> None:
        self._late = max(steps, 1.0)
        self._values = np.zeros(count + 1)
        self._last = 0

    def value(self) -> float:
        """Return the value for the step that comes next."""
        place = self._last + 1 - self._late
        if place <= 0.0:
            return 0.0
        low = int(place)
        share = place - low
        return float((1.0 - share) * self._values[low] + share * self._values[min(low + 1, self._last)])

    def note(self, value: float) -> None:
        """Note the value of the step that has come."""
        self._last += 1
        self._values[self._last] = value
