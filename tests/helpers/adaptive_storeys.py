"""Buildings with laws of storeys by an adaptive solver: laws as equations with modes, restarted at every event.

Written from docs/background/storey_laws.md, without anything of the package's own laws. A law states its force beyond
the spring of its storey, the rates of its own states, and what ends a mode: functions that fall through zero there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

LONGEST_STEP_S = 2e-3  # events are seen at the ends of steps only
V, U, F = 1e-13, 1e-14, 1e-11  # m/s, m, N: a mode ends this far beyond its end, so that the next one holds there


class Part:
    """A law in a storey: `mode` and what it remembers; drift u, its rate v, own states s."""

    states = 0

    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        self.k, self.numbers, self.mode = k, numbers, 0

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        raise NotImplementedError

    def rates(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return ()

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        """Return functions of which one falls below zero where the mode ends."""
        return ()

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        """Take the mode that follows."""


class Sliding(Part):
    """A spring in series with a slider of limit `reach` (drift): z follows u, or stays at +-reach (mode +-1)."""

    states = 1
    spring = reach = beside = taken = 0.0

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return self.spring * s[0] + (self.beside - self.taken) * u

    def rates(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (v if self.mode == 0 else 0.0,)

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (self.reach - s[0] + 2 * U, self.reach + s[0] + 2 * U) if self.mode == 0 else (self.mode * v + V,)

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        self.mode = (1, -1)[which] if self.mode == 0 else 0
        self.reach = max(self.reach, abs(s[0]) - U)  # it has passed the limit by the band


class Bilinear(Sliding):
    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        self.spring, self.reach = (1.0 - numbers["hardening"]) * k, numbers["yield_displacement_m"]
        self.taken = self.spring


class Friction(Sliding):
    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        weight = numbers["weight_n"]
        limit = numbers["force_n"] if "force_n" in numbers else numbers["coefficient"] * weight
        self.reach = numbers["sticking_displacement_m"]
        self.spring = limit / self.reach
        self.beside = weight / numbers.get("radius_m", math.inf)


class Clough(Part):
    """Force f by its slope on the present line; `mode` names the line, `side` where it leads."""

    states = 1

    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        self.limit = numbers["yield_displacement_m"]
        self.farthest = {1: (self.limit, k * self.limit), -1: (-self.limit, -k * self.limit)}
        self.line, self.side, self.slope = "elastic", 0, k
        self.left_at, self.left_line, self.left_slope = 0.0, "", 0.0

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return s[0] - self.k * u

    def rates(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (self.slope * v,)

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        if self.line == "elastic":
            return self.limit - u + U, self.limit + u + U
        if self.line == "backbone":
            return (self.side * v + V,)
        if self.line == "unloading":
            return self.side * s[0] + F, self.side * (self.left_at - u) + U
        return self.side * v + V, self.side * (self.farthest[self.side][0] - u) + U

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        if self.line == "elastic":
            self.line, self.side, self.slope = "backbone", (1, -1)[which], self.numbers["hardening"] * self.k
        elif self.line == "unloading" and which == 0:
            self.side = -self.side
            far, most = self.farthest[self.side]
            self.line, self.slope = "reloading", most / (far - u)
        elif self.line == "unloading":
            self.line, self.slope = self.left_line, self.left_slope
        elif self.line == "reloading" and which == 1:
            self.line, self.slope = "backbone", self.numbers["hardening"] * self.k
        else:
            if self.line == "backbone":
                self.farthest[self.side] = u, s[0]
            self.left_at, self.left_line, self.left_slope = u, self.line, self.slope
            far, most = self.farthest[self.side]
            softer = self.k * (self.limit / abs(far)) ** self.numbers.get("unloading_exponent", 0.0)
            self.line, self.slope = "unloading", max(softer, most / far)


class Gap(Part):
    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return 0.0 if self.mode == 0 else self.numbers["contact_n_per_m"] * (u - self.mode * self.numbers["gap_m"])

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        gap = self.numbers["gap_m"]
        return (gap - u + U, gap + u + U) if self.mode == 0 else (self.mode * u - gap + U,)

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        self.mode = (1, -1)[which] if self.mode == 0 else 0


class Cubic(Part):
    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return self.numbers["cubic_n_per_m3"] * u**3


class Softening(Part):
    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        self.mode = 1

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        spent = u / (u + self.mode * self.numbers["half_drift_m"])
        return -self.numbers["share"] * self.k * u * spent

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (self.mode * u + U,)

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        self.mode = -self.mode


class Viscous(Part):
    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        self.slow = numbers.get("linear_below_m_per_s", 1e-5)

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        size, power = self.numbers["coefficient"], self.numbers["exponent"]
        if self.mode == 0:
            return size * self.slow**power * v / self.slow
        return math.copysign(size * abs(v) ** power, v)

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (self.slow - v + V, self.slow + v + V) if self.mode == 0 else (self.mode * v - self.slow + V,)

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        self.mode = (1, -1)[which] if self.mode == 0 else 0


class Maxwell(Part):
    states = 1

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return s[0]

    def rates(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return (self.numbers["spring_n_per_m"] * (v - s[0] / self.numbers["dashpot_n_s_per_m"]),)


class BoucWen(Part):
    """In z (m) and e = (1 - alpha) integral of z du / (yield drift)^2; modes are the signs of du and z."""

    states = 2

    def __init__(self, k: float, numbers: Mapping[str, float]) -> None:
        super().__init__(k, numbers)
        self.signs = [1.0, 1.0]

    def of(self, name: str, otherwise: float) -> float:
        return self.numbers.get(name, otherwise)

    def force(self, u: float, v: float, s: Sequence[float]) -> float:
        return (1.0 - self.numbers["hardening"]) * self.k * (s[0] - u)

    def rates(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        limit, n = self.numbers["yield_displacement_m"], self.of("exponent", 1.0)
        beta, gamma = self.of("beta", 0.5), self.of("gamma", 0.5)
        z, e = s
        a, nu, eta = (1.0 + sign * self.of(f"delta_{x}", 0.0) * e for sign, x in ((-1, "a"), (1, "nu"), (1, "eta")))
        same = self.signs[0] * self.signs[1]  # sign of z du
        flow = (a - nu * (abs(z) / limit) ** n * (gamma + beta * same)) / eta
        depth = self.of("zeta_s", 0.0) * (1.0 - math.exp(-self.of("p", 1.0) * e))
        width = (self.of("psi", 0.1) + self.of("delta_psi", 0.0) * e) * (self.of("lambda", 0.5) + depth)
        strength = limit * (1.0 / (nu * (beta + gamma))) ** (1.0 / n)
        off = (z * self.signs[0] - self.of("q", 0.0) * strength) / limit
        pinching = 1.0 - depth * math.exp(-(off**2) / width**2) if depth > 0.0 else 1.0
        return pinching * flow * v, (1.0 - self.numbers["hardening"]) * z * v / limit**2

    def ends(self, u: float, v: float, s: Sequence[float]) -> tuple[float, ...]:
        return self.signs[0] * v + V, self.signs[1] * s[0] + U

    def next(self, which: int, u: float, v: float, s: Sequence[float]) -> None:
        self.signs[which] = -self.signs[which]


KINDS: dict[str, type[Part]] = {
    "bilinear": Bilinear,
    "friction": Friction,
    "clough": Clough,
    "elastic_gap": Gap,
    "cubic": Cubic,
    "softening": Softening,
    "viscous_power": Viscous,
    "maxwell": Maxwell,
    "bouc_wen": BoucWen,
}


def adaptive(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    springs: Sequence[float],
    laws: Sequence[Sequence[Mapping[str, Any]]],
    knots_s: np.ndarray,
    ground: np.ndarray,
    times_s: np.ndarray,
    method: str = "DOP853",
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Return displacements, velocities and absolute accelerations (n, times) and the number of events.

    `matrices` M, C, K (n, n) of the building without laws, `springs` its storeys', `laws` from the ground as a
    structure file states them (with `weight_n` for friction); ground acceleration `ground` at `knots_s`, linear
    between. `times_s` lie at knots or between them.
    """
    M, C, K = matrices
    n = len(M)
    parts = [(i, KINDS[one["kind"]](springs[i], one)) for i, many in enumerate(laws) for one in many]
    first = np.cumsum([2 * n] + [part.states for _, part in parts])
    own = [slice(a, b) for a, b in pairwise(first)]
    inverse = np.linalg.inv(M)
    stiffness, damping = inverse @ K, inverse @ C

    def drift(y: np.ndarray, i: int) -> tuple[float, float]:
        return (y[i] - y[i - 1], y[n + i] - y[n + i - 1]) if i else (y[0], y[n])

    def accel(y: np.ndarray) -> np.ndarray:
        pulled = np.zeros(n)
        for (i, part), mine in zip(parts, own, strict=True):
            force = part.force(*map(float, drift(y, i)), y[mine].tolist())
            pulled[i] -= force
            if i:
                pulled[i - 1] += force
        return inverse @ pulled - stiffness @ y[:n] - damping @ y[n : 2 * n]

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        push = ground[at] + (t - knots_s[at]) * slope
        made = np.empty_like(y)
        made[:n], made[n : 2 * n] = y[n : 2 * n], accel(y) - push
        for (i, part), mine in zip(parts, own, strict=True):
            if part.states:
                made[mine] = part.rates(*map(float, drift(y, i)), y[mine].tolist())
        return made

    def ends_of(y: np.ndarray, which: int) -> tuple[float, ...]:
        i, part = parts[which]
        return part.ends(*map(float, drift(y, i)), y[own[which]].tolist())

    def end(y: np.ndarray, which: int, number: int) -> None:
        i, part = parts[which]
        part.next(number, *map(float, drift(y, i)), y[own[which]].tolist())

    def watch(which: int, number: int) -> Any:
        def ending(_: float, y: np.ndarray) -> float:
            return ends_of(y, which)[number]

        ending.terminal, ending.direction = True, -1  # type: ignore[attr-defined]
        return ending

    y, events = np.zeros(first[-1]), 0
    found, found_accel = np.zeros((2 * n, len(times_s))), np.zeros((n, len(times_s)))
    for at in range(len(knots_s) - 1):
        t, last = knots_s[at], knots_s[at + 1]
        slope = (ground[at + 1] - ground[at]) / (last - t)
        while t < last:
            endings = [(w, m) for w in range(len(parts)) for m in range(len(ends_of(y, w)))]
            wanted = times_s[(times_s > t) & (times_s <= last)]
            solved = solve_ivp(
                rate,
                (t, last),
                y,
                method,
                np.append(wanted[wanted < last], last),
                events=[watch(*one) for one in endings],
                rtol=1e-11,
                atol=1e-14,
                max_step=LONGEST_STEP_S,
            )
            for time, state in zip(solved.t, np.transpose(solved.y), strict=True):  # an event may come first
                place = int(np.searchsorted(times_s, time))
                if place < len(times_s) and times_s[place] == time:
                    found[:, place], found_accel[:, place] = state[: 2 * n], accel(state)
            if solved.status == 0:
                t, y = last, np.asarray(solved.y)[:, -1]
                continue
            assert solved.status == 1, solved.message
            which = next(m for m, when in enumerate(solved.t_events) if when.size)
            t, y = float(solved.t_events[which][0]), solved.y_events[which][0]
            end(y, *endings[which])
            events += 1
            for w in range(len(parts)):  # others that end at the same instant
                ended = [m for m, value in enumerate(ends_of(y, w)) if value < 0.0]
                if ended:
                    end(y, w, ended[0])
    return found[:n], found[n:], found_accel, events
