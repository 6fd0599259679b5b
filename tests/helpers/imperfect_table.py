"""The imperfect table once more, for tests: energies in absolute coordinates, and an adaptive solver of order eight.

Coordinates: coil, deck, each floor (all along the pitched table, from rest), pitch. Springs, dashpots and weights are
quadratic forms of the coordinates; where coil and deck are one mass, a coordinate is eliminated by a transformation.
Filters of the sensors are further differential equations. Every instant at which something happens (a change of the
command, a sample, a branch of a law that ends) restarts the solver.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from adaptive_storeys import KINDS
from scipy.integrate import solve_ivp

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.structure import Specimen


@dataclass(frozen=True)
class Imperfect:
    """What differs from the exact table, in the words of the decision; all off."""

    coil_kg: float = 0.0
    deck_hz: float = 0.0
    deck_ratio: float = 0.02
    crossover_n: float = 0.0
    distortion: float = 0.0
    distortion_at_v: float = 3.0
    gain_drift_per_s: float = 0.0
    presliding_m: float = 0.0
    bristle_n_s_per_m: float = 0.0
    excess: float = 0.0
    stribeck_m_s: float = 0.005
    suspension: tuple[float, float] = (0.0, 0.0)
    drop: float = 0.0
    drop_at_m: float = 0.079
    pitch_hz: float = 0.0
    pitch_ratio: float = 0.03
    inertia_kg_m2: float = 3.0
    storey_m: float | Sequence[float] = 0.2
    transverse: Sequence[float] = (0.0, 0.0, 0.0)
    arm_m: float = 0.1
    lateral: float = 0.0
    gain: Sequence[float] = (1.0, 1.0, 1.0)
    offset_m_s2: Sequence[float] = (0.0, 0.0, 0.0)
    command_skew_s: float = 0.0
    skew_s: Sequence[float] = (0.0, 0.0, 0.0)
    low_pass_hz: Sequence[float] = (1549.0, 1549.0, 1549.0)
    high_pass_hz: Sequence[float] = (0.024, 0.024, 0.024)
    heavier: Sequence[float] = (0.0, 0.0)
    laws: Sequence[tuple[int, Mapping[str, Any]]] = field(default=())


class Table:
    """Equations of motion of a table with its specimen and three accelerometers."""

    def __init__(self, physics: VirtualPhysics, parts: Specimen, how: Imperfect) -> None:
        n = len(parts.masses_kg)
        parts = Specimen(parts.masses_kg * (1.0 + np.asarray(how.heavier)), parts.K, parts.C)
        self.physics, self.how, self.n = physics, how, n
        g, heights = STANDARD_GRAVITY_M_S2, np.tri(n) @ np.broadcast_to(how.storey_m, n)
        coil = how.coil_kg if how.deck_hz > 0.0 else 0.5 * physics.moving_mass_kg
        deck = physics.moving_mass_kg - coil
        masses = np.concatenate([[coil, deck], parts.masses_kg, [how.inertia_kg_m2]])
        size = n + 3
        drifts = np.zeros((n, size))  # of the floors from the deck, as the columns see it
        drifts[:, 1], drifts[:, 2 : 2 + n], drifts[:, -1] = -1.0, np.eye(n), -heights
        self.drifts = drifts
        stretch = np.zeros(size)
        stretch[0], stretch[1] = -1.0, 1.0
        rate = 2.0 * np.pi * how.deck_hz
        springs = drifts.T @ parts.K @ drifts + deck * rate**2 * np.outer(stretch, stretch)
        dashpots = drifts.T @ parts.C @ drifts + 2.0 * how.deck_ratio * deck * rate * np.outer(stretch, stretch)
        rigid = how.inertia_kg_m2 + float(parts.masses_kg @ heights**2)
        turns = 2.0 * np.pi * how.pitch_hz
        springs[-1, -1] += rigid * turns**2
        dashpots[-1, -1] += 2.0 * how.pitch_ratio * rigid * turns
        dashpots[1, 1] += physics.viscous_n_s_per_m
        springs[1, 1] += how.suspension[0]
        weights = np.zeros(size)  # each falls by th times its place along the table
        weights[0], weights[1] = coil, deck + parts.masses_kg.sum()
        weights += parts.masses_kg @ drifts
        sinking = np.zeros((size, size))
        sinking[-1] = -g * weights
        springs += sinking + sinking.T
        keep = np.eye(size)
        if how.deck_hz == 0.0:
            keep[0] = keep[1]
            keep = np.delete(keep, 0, axis=1)
        if how.pitch_hz == 0.0:
            keep = keep[:, :-1]
        self.keep = keep
        self.inverse = np.linalg.inv(keep.T @ np.diag(masses) @ keep)
        self.springs, self.dashpots = springs, dashpots
        omega = 2.0 * np.pi * physics.loop_frequency_hz
        loop = physics.moving_mass_kg + physics.loop_specimen_mass_kg
        self.loop = loop * omega**2, loop * 2.0 * physics.loop_damping_ratio * omega
        weight = g * np.cumsum(parts.masses_kg[::-1])[::-1]
        k = [float(-parts.K[i, i - 1]) if i else float(parts.K.sum()) for i in range(n)]
        self.laws = [(i, KINDS[one["kind"]](k[i], {**one, "weight_n": weight[i]})) for i, one in how.laws]
        self.dof = keep.shape[1]
        first = np.cumsum([2 * self.dof + 2 + 6] + [law.states for _, law in self.laws])
        self.own = [slice(a, b) for a, b in pairwise(first)]
        self.size = int(first[-1])

    def drift(self, y: Array, storey: int) -> tuple[float, float]:
        """Return drift and rate of a storey."""
        row = self.drifts[storey] - (self.drifts[storey - 1] if storey else 0.0)
        row = row @ self.keep
        return float(row @ y[: self.dof]), float(row @ y[self.dof : 2 * self.dof])

    def motion(self, y: Array, accel: Array) -> tuple[Array, Array, Array]:
        """Return place, velocity and acceleration of coil, deck, floors and pitch."""
        return self.keep @ y[: self.dof], self.keep @ y[self.dof : 2 * self.dof], self.keep @ accel

    def rate(self, t: float, y: Array, command_v: float) -> Array:
        """Return the rates of coordinates, velocities, force, bristles, filters and laws."""
        return self.rates_and_sensed(t, y, command_v)[0]

    def rates_and_sensed(self, t: float, y: Array, command_v: float) -> tuple[Array, Array, Array]:
        """Return the rates, what the accelerometers sense, and the true accelerations of deck and floors."""
        p, how, d = self.physics, self.how, self.dof
        made = np.zeros_like(y)
        place, velocity, _ = self.motion(y, np.zeros(d))
        force, bristle = y[2 * d], y[2 * d + 1]
        push = -self.springs @ place - self.dashpots @ velocity
        push[0] += force * (1.0 - how.drop * (place[0] / how.drop_at_m) ** 2)
        push[1] -= how.suspension[1] * place[1] ** 3
        level = p.coulomb_n * (1.0 + how.excess * np.exp(-((velocity[1] / how.stribeck_m_s) ** 2)))
        if how.presliding_m > 0.0:
            stiff = p.coulomb_n / how.presliding_m
            made[2 * d + 1] = velocity[1] * (1.0 - stiff * bristle * np.sign(velocity[1]) / level)
            push[1] -= stiff * bristle + how.bristle_n_s_per_m * made[2 * d + 1]
        else:
            push[1] -= level * np.tanh(velocity[1] / p.coulomb_velocity_m_s)
        for (storey, law), mine in zip(self.laws, self.own, strict=True):
            u, v = self.drift(y, storey)
            row = self.drifts[storey] - (self.drifts[storey - 1] if storey else 0.0)
            push -= law.force(u, v, y[mine].tolist()) * row
            if law.states:
                made[mine] = law.rates(u, v, y[mine].tolist())
        accel = self.inverse @ (self.keep.T @ push)
        heard = command_v + how.distortion * command_v**3 / how.distortion_at_v**2
        wanted = self.loop[0] * (p.gain_m_per_v * heard * (1.0 + how.gain_drift_per_s * t) - place[0])
        wanted -= self.loop[1] * velocity[0]
        if how.crossover_n > 0.0:
            wanted -= wanted * how.crossover_n / (abs(wanted) + how.crossover_n)
        wanted = min(p.force_limit_n, max(-p.force_limit_n, wanted))
        made[:d], made[d : 2 * d], made[2 * d] = y[d : 2 * d], accel, (wanted - force) / p.actuator_time_constant_s
        whole = self.keep @ accel
        true = whole[1 : 2 + self.n]
        tilt = place[-1] if how.pitch_hz > 0.0 else 0.0
        spin = whole[-1] if how.pitch_hz > 0.0 else 0.0
        across = how.arm_m * spin + how.lateral * true
        sensed = true - STANDARD_GRAVITY_M_S2 * tilt + np.asarray(how.transverse) * across
        low, high = y[2 * d + 2 : 2 * d + 5], y[2 * d + 5 : 2 * d + 8]
        passed = np.where(np.asarray(how.low_pass_hz) > 0.0, low, sensed)
        made[2 * d + 2 : 2 * d + 5] = 2.0 * np.pi * np.asarray(how.low_pass_hz) * (sensed - low)
        made[2 * d + 5 : 2 * d + 8] = 2.0 * np.pi * np.asarray(how.high_pass_hz) * (passed - high)
        return made, np.asarray(how.gain) * (passed - high) + how.offset_m_s2, true

    def ends(self, y: Array, which: int) -> tuple[float, ...]:
        """Return what falls below zero where the branch of a law ends."""
        storey, law = self.laws[which]
        return law.ends(*self.drift(y, storey), y[self.own[which]].tolist())

    def advance(self, begin_s: float, end_s: float, y: Array, command_v: float) -> Array:
        """Return the state at a later instant, the command held."""
        t = begin_s
        while t < end_s:
            endings = [(w, m) for w in range(len(self.laws)) for m in range(len(self.ends(y, w)))]
            found = solve_ivp(
                self.rate, (t, end_s), y, "DOP853", args=(command_v,), rtol=1e-10, atol=1e-13,
                events=[self._watch(*one) for one in endings] or None,
            )  # fmt: skip
            t, y = float(found.t[-1]), found.y[:, -1]
            if found.status == 1:
                which, number = endings[next(m for m, when in enumerate(found.t_events) if when.size)]
                storey, law = self.laws[which]
                law.next(number, *self.drift(y, storey), y[self.own[which]].tolist())
        return y

    def _watch(self, which: int, number: int) -> Any:
        def ending(_: float, y: Array, command: float) -> float:
            return self.ends(y, which)[number]

        ending.terminal, ending.direction = True, -1  # type: ignore[attr-defined]
        return ending


def solved(table: Table, command_v: Array, dt_s: float, latency: int) -> tuple[Array, Array, Array]:
    """Return sensed accelerations (3, n) at their own instants, and at the nominal ones the displacement (n,) of the
    deck, and the velocities (3, n) of deck and floors half an interval later."""
    n, how = len(command_v), table.how
    happens = [(k * dt_s, 1, k) for k in range(n)] + [((k + 0.5) * dt_s, 2, k) for k in range(n)]
    happens += [((k + latency) * dt_s + how.command_skew_s, 0, k) for k in range(n)]
    happens += [(k * dt_s + skew, 3 + c, k) for c, skew in enumerate(how.skew_s) for k in range(n)]
    sensed, place, velocity = np.zeros((3, n)), np.zeros(n), np.zeros((3, n))
    t, y, command = 0.0, np.zeros(table.size), 0.0
    for when, what, k in sorted(happens, key=lambda one: (one[0], -one[1])):  # the command changes after a sample
        if when > (n - 0.4) * dt_s:
            break
        if when > t:
            y, t = table.advance(t, when, y, command), when
        if what == 0:
            command = float(command_v[k])
        elif what == 1:
            place[k] = table.motion(y, np.zeros(table.dof))[0][1]
        elif what == 2:
            velocity[:, k] = table.motion(y, np.zeros(table.dof))[1][1 : 2 + table.n]
        else:
            sensed[what - 3, k] = table.rates_and_sensed(t, y, command)[1][what - 3]
    return sensed, place, velocity
