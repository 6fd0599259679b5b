"""Laws of storeys that are not linear: what each needs, its tangents, and the linear storey that it starts from.

A storey with a law keeps its spring k, the tangent at rest. A law adds a force to it: `k u + g`, with the drift u in m.
Laws of one storey act in parallel. The equations are those of docs/background/storey_laws.md. This module holds the
numbers only: SIM (`analysis/nonlinear_sim.py`) and the step (`loop/storey_forces.py`) each compute the forces by
themselves, because the first judges the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import ClassVar, Protocol

import numpy as np

from rths_cli.numerics.lti import Array, Integers

BILINEAR, CLOUGH, GAP, CUBIC, VISCOUS, MAXWELL, BOUC_WEN, OWN, SOFTENING, PROGRAM = range(10)
"""Codes by which compiled functions know a law; friction is a bilinear law without a spring beyond its limit. No
compiled function computes a program's forces."""
NUMBERS = 16  # of a law in compiled functions
OWN_PARAMETERS = NUMBERS - 1  # at most, of a user's own law; the last number is its greatest dashpot
OWN_STATES = 8  # at most, that a user's own law remembers


class LawSpec(Protocol):
    """What a structure file states of a law: `kind`, and the numbers of that kind by their names."""

    @property
    def kind(self) -> str: ...


@dataclass(frozen=True)
class Tangents:
    """What a law adds to the spring (N/m) and the dashpot (N s/m) of its storey, at the least and at the most."""

    stiffness: tuple[float, float] = (0.0, 0.0)
    dashpot: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Law:
    """A law of a storey; each kind states its numbers, of which `code` and `numbers` reach compiled functions."""

    code: ClassVar[int]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Return the numbers of the law in the order that compiled functions know."""
        raise NotImplementedError

    @property
    def address(self) -> int:
        """Return the address of a user's own compiled force, 0 for the laws of this package."""
        return 0

    @property
    def at_rest(self) -> tuple[float, float]:
        """Return stiffness in N/m and dashpot in N s/m that it adds at rest; they are part of the linear storey."""
        return 0.0, 0.0

    @property
    def linear(self) -> bool:
        """Return whether `at_rest` is all of it."""
        return False

    @property
    def tangents(self) -> Tangents:
        """Return the range of its tangents, without `at_rest`; infinite where there is no bound."""
        return Tangents()

    @property
    def yield_drift_m(self) -> float:
        """Return the drift at which the storey's spring yields, NaN where it does not."""
        return float(getattr(self, "yield_displacement_m", np.nan))


@dataclass(frozen=True)
class Bilinear(Law):
    """Kinematic hardening: `hardening` k u + (1 - hardening) k z, dz = du while abs(z) is below the yield drift."""

    code: ClassVar[int] = BILINEAR
    stiffness_n_per_m: float  # k of the storey
    yield_displacement_m: float
    hardening: float

    @property
    def numbers(self) -> tuple[float, ...]:
        return (1.0 - self.hardening) * self.stiffness_n_per_m, self.yield_displacement_m

    @property
    def linear(self) -> bool:
        return self.hardening == 1.0

    @property
    def tangents(self) -> Tangents:
        return Tangents(((self.hardening - 1.0) * self.stiffness_n_per_m, 0.0))


@dataclass(frozen=True)
class Friction(Law):
    """Coulomb friction of `force_n` that sticks with a spring up to `sticking_displacement_m`, and beside it a spring
    `restoring_n_per_m` (weight over radius of a friction pendulum)."""

    code: ClassVar[int] = BILINEAR
    force_n: float
    sticking_displacement_m: float
    restoring_n_per_m: float = 0.0

    @property
    def _sticking_n_per_m(self) -> float:
        return self.force_n / self.sticking_displacement_m

    @property
    def numbers(self) -> tuple[float, ...]:
        return self._sticking_n_per_m, self.sticking_displacement_m

    @property
    def at_rest(self) -> tuple[float, float]:
        return self._sticking_n_per_m + self.restoring_n_per_m, 0.0

    @property
    def linear(self) -> bool:
        return self.force_n == 0.0

    @property
    def tangents(self) -> Tangents:
        return Tangents((-self._sticking_n_per_m, 0.0))


@dataclass(frozen=True)
class Clough(Law):
    """Clough's law: bilinear at first; it reloads towards the largest drift so far of the side it goes to, and unloads
    with k (yield drift / largest drift)^`unloading_exponent`, but not below the secant to that drift (Clough and
    Johnston 1966; reloading after a partial unloading goes back to where it left, Mahin and Lin 1983)."""

    code: ClassVar[int] = CLOUGH
    stiffness_n_per_m: float
    yield_displacement_m: float
    hardening: float
    unloading_exponent: float = 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        return self.stiffness_n_per_m, self.yield_displacement_m, self.hardening, self.unloading_exponent

    @property
    def linear(self) -> bool:
        return self.hardening == 1.0

    @property
    def tangents(self) -> Tangents:
        return Tangents((-self.stiffness_n_per_m, 0.0))


@dataclass(frozen=True)
class ElasticGap(Law):
    """A spring of `contact_n_per_m` that is touched beyond a drift of `gap_m` to both sides."""

    code: ClassVar[int] = GAP
    contact_n_per_m: float
    gap_m: float

    @property
    def numbers(self) -> tuple[float, ...]:
        return self.contact_n_per_m, self.gap_m

    @property
    def linear(self) -> bool:
        return self.contact_n_per_m == 0.0

    @property
    def tangents(self) -> Tangents:
        return Tangents((0.0, self.contact_n_per_m))


@dataclass(frozen=True)
class Cubic(Law):
    """A force of `cubic_n_per_m3` u^3: hardening, or softening if negative."""

    code: ClassVar[int] = CUBIC
    cubic_n_per_m3: float
    largest_drift_m: float  # up to which it is to hold

    @property
    def numbers(self) -> tuple[float, ...]:
        return (self.cubic_n_per_m3,)

    @property
    def linear(self) -> bool:
        return self.cubic_n_per_m3 == 0.0

    @property
    def tangents(self) -> Tangents:
        most = 3.0 * self.cubic_n_per_m3 * self.largest_drift_m**2
        return Tangents((min(most, 0.0), max(most, 0.0)))


@dataclass(frozen=True)
class Softening(Law):
    """A force of -`share` k u abs(u) / (abs(u) + `half_drift_m`): the spring loses a share of its stiffness k."""

    code: ClassVar[int] = SOFTENING
    stiffness_n_per_m: float  # k of the storey
    share: float
    half_drift_m: float

    @property
    def numbers(self) -> tuple[float, ...]:
        return self.share * self.stiffness_n_per_m, self.half_drift_m

    @property
    def linear(self) -> bool:
        return self.share == 0.0

    @property
    def tangents(self) -> Tangents:
        return Tangents((-self.share * self.stiffness_n_per_m, 0.0))


@dataclass(frozen=True)
class ViscousPower(Law):
    """A damper of force `coefficient` abs(v)^`exponent` sign(v), coefficient in N (s/m)^exponent; a straight line below
    `linear_below_m_per_s`, because no damper has the infinite slope of an exponent below one."""

    code: ClassVar[int] = VISCOUS
    coefficient: float
    exponent: float
    linear_below_m_per_s: float = 1e-5

    @property
    def numbers(self) -> tuple[float, ...]:
        return self.coefficient, self.exponent, self.linear_below_m_per_s, self._straight

    @property
    def _straight(self) -> float:
        """Return the slope at rest in N s/m."""
        return self.coefficient * self.linear_below_m_per_s ** (self.exponent - 1.0)

    @property
    def at_rest(self) -> tuple[float, float]:
        return 0.0, self.coefficient if self.linear else 0.0

    @property
    def linear(self) -> bool:
        return self.exponent == 1.0

    @property
    def tangents(self) -> Tangents:
        return Tangents(dashpot=(0.0, self._straight) if self.exponent < 1.0 else (self._straight, np.inf))


@dataclass(frozen=True)
class Maxwell(Law):
    """A spring of `spring_n_per_m` and a dashpot of `dashpot_n_s_per_m` in series: ds = spring (v - s / dashpot) dt."""

    code: ClassVar[int] = MAXWELL
    spring_n_per_m: float
    dashpot_n_s_per_m: float

    @property
    def numbers(self) -> tuple[float, ...]:
        return self.spring_n_per_m, self.dashpot_n_s_per_m

    @property
    def tangents(self) -> Tangents:
        return Tangents((0.0, self.spring_n_per_m), (0.0, self.dashpot_n_s_per_m))


@dataclass(frozen=True)
class BoucWen(Law):
    """The law of Bouc and Wen with degradation (Baber and Wen 1981) and pinching (Baber and Noori 1986).

    `hardening` k u + (1 - hardening) k z; with y = z / yield drift, w = v / yield drift:
    dy/dt = h (a w - nu (beta abs(w) abs(y)^(n-1) y + gamma w abs(y)^n)) / eta, a = 1 - delta_a e, nu = 1 + delta_nu e,
    eta = 1 + delta_eta e, de/dt = (1 - hardening) y w,
    h = 1 - zeta1 exp(-((y sign(w) - q y_u) / zeta2)^2), y_u = (nu (beta + gamma))^(-1/n),
    zeta1 = zeta_s (1 - exp(-p e)), zeta2 = (psi + delta_psi e) (lambda + zeta1).
    """

    code: ClassVar[int] = BOUC_WEN
    stiffness_n_per_m: float
    yield_displacement_m: float
    hardening: float
    exponent: float = 1.0  # n
    beta: float = 0.5
    gamma: float = 0.5
    delta_a: float = 0.0
    delta_nu: float = 0.0
    delta_eta: float = 0.0
    zeta_s: float = 0.0
    p: float = 0.0
    q: float = 0.0
    psi: float = 0.0
    delta_psi: float = 0.0
    lambda_: float = 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        size = (1.0 - self.hardening) * self.stiffness_n_per_m, self.yield_displacement_m, self.hardening
        shape = self.exponent, self.beta, self.gamma
        degrading = self.delta_a, self.delta_nu, self.delta_eta
        return (*size, *shape, *degrading, self.zeta_s, self.p, self.q, self.psi, self.delta_psi, self.lambda_)

    @property
    def linear(self) -> bool:
        return self.hardening == 1.0

    @property
    def tangents(self) -> Tangents:
        yielding = (1.0 - self.hardening) * self.stiffness_n_per_m
        steepest = max(self.beta - self.gamma, 0.0) / (
            self.beta + self.gamma
        )  # unloading with gamma < 0, or beta > gamma
        return Tangents((-yielding, yielding * steepest))


@dataclass(frozen=True)
class Laws:
    """The laws of a building's storeys as compiled functions take them: l laws of storeys, in any order.

    `storey` (l,) counts from 0 at the ground; `code` (l,); `numbers` (l, NUMBERS); `address` (l,) of users' own laws in
    this process, otherwise 0. `stiffness` and `dashpot` (l, 2) are
    the least and the greatest that each adds to its storey's tangent, beside those at rest, in N/m and N s/m.
    `yield_drift_m` (l,), NaN where nothing yields.
    """

    storey: Integers
    code: Integers
    numbers: Array
    stiffness: Array
    dashpot: Array
    yield_drift_m: Array
    address: Integers

    def of_storeys(self, storeys: Sequence[int], tangents: Array) -> Array:
        """Return the sum (q,) of tangents (l,) of the laws of each of some storeys."""
        return np.array([tangents[self.storey == storey].sum() for storey in storeys])


def law_of(spec: LawSpec, stiffness_n_per_m: float, weight_n: float) -> Law:
    """Return the law of a structure file for a storey of this stiffness, below floors of this weight.

    Raises InputError for a user's own law that is none.
    """
    if spec.kind == "friction":
        radius = spec.radius_m  # type: ignore[attr-defined]
        force = spec.force_n if spec.force_n is not None else spec.coefficient * weight_n  # type: ignore[attr-defined]
        restoring = 0.0 if radius is None else weight_n / radius
        return Friction(force, spec.sticking_displacement_m, restoring)  # type: ignore[attr-defined]
    if spec.kind == "own":
        from rths_cli.structure.own_laws import own_law  # compiles

        return own_law(spec)  # type: ignore[arg-type]
    made = OF_KIND[spec.kind]
    names = [one.name for one in fields(made)]
    values = {name: getattr(spec, name) for name in names if name != "stiffness_n_per_m"}
    if "stiffness_n_per_m" in names:
        values["stiffness_n_per_m"] = stiffness_n_per_m
    return made(**values)


OF_KIND: dict[str, type[Law]] = {
    "bilinear": Bilinear,
    "bouc_wen": BoucWen,
    "clough": Clough,
    "elastic_gap": ElasticGap,
    "viscous_power": ViscousPower,
    "maxwell": Maxwell,
    "cubic": Cubic,
    "softening": Softening,
}


def arranged(by_storey: tuple[tuple[Law, ...], ...]) -> Laws:
    """Return the laws that are not linear, storey by storey from the ground."""
    found = [(i, law) for i, laws in enumerate(by_storey) for law in laws if not law.linear]
    numbers = np.zeros((len(found), NUMBERS))
    for row, (_, law) in zip(numbers, found, strict=True):
        row[: len(law.numbers)] = law.numbers
    kinds = np.array([law.code for _, law in found], dtype=np.int64)
    storeys = np.array([i for i, _ in found], dtype=np.int64)
    stiffness = np.array([law.tangents.stiffness for _, law in found]).reshape(-1, 2)
    dashpot = np.array([law.tangents.dashpot for _, law in found]).reshape(-1, 2)
    limits = np.array([law.yield_drift_m for _, law in found])
    addresses = np.array([law.address for _, law in found], dtype=np.int64)
    return Laws(storeys, kinds, numbers, stiffness, dashpot, limits, addresses)


def stacked(lower: Laws, upper: Laws, storeys: int) -> Laws:
    """Return the laws of a building from those of its lower storeys, of which there are `storeys`, and of those above,
    whose storeys count from 0 there."""
    raised = replace(upper, storey=upper.storey + storeys)
    pairs = {one.name: (getattr(lower, one.name), getattr(raised, one.name)) for one in fields(Laws)}
    return Laws(**{name: np.concatenate(pair) for name, pair in pairs.items()})
