"""Computed storeys with laws against SIM, whose code and method are others; the scheme's limit against its own run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from portfolio import parametrize_first
from repeated_laws import REPEATED
from scipy.optimize import brentq

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.control.interface import Interface, InterfaceForce
from rths_cli.control.storeys_with_laws import StoreysWithLaws, computed_storeys
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.loop.storey_forces import REMEMBERED, StoreysAndForces, hysteresis, of_the_step, storeys_and_forces
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.numerics.power_curves import on_curve, power_curve
from rths_cli.structure import Building, Numerical, Specimen, assemble, storey_matrix
from rths_cli.structure.storey_laws import (
    Bilinear,
    BoucWen,
    Clough,
    Cubic,
    ElasticGap,
    Friction,
    Law,
    Maxwell,
    ViscousPower,
    arranged,
)

STIFFNESS = 7000.0
LAWS: dict[str, tuple[Law, ...]] = {
    "bilinear": (Bilinear(STIFFNESS, 0.002, 0.05),),
    "bouc_wen": (BoucWen(STIFFNESS, 0.002, 0.05, exponent=2.0),),
    "degrading": (BoucWen(STIFFNESS, 0.002, 0.05, 1.0, 0.6, 0.4, 0.002, 0.02, 0.05, 0.7, 1.0, 0.1, 0.2, 0.01, 0.3),),
    "clough": (Clough(STIFFNESS, 0.002, 0.05, 0.3),),
    "gap": (ElasticGap(3.0 * STIFFNESS, 0.002),),
    "friction": (Friction(3.0, 1e-4),),
    "viscous": (ViscousPower(8.0, 0.4),),
    "quadratic": (ViscousPower(80.0, 2.0),),
    "maxwell": (Maxwell(4000.0, 60.0),),
    "cubic": (Cubic(STIFFNESS / 0.004**2, 0.01),),
    "degrading, two": (
        BoucWen(0.6 * STIFFNESS, 0.002, 0.05, 1.5, 0.5, 0.5, 0.0, 0.05, 0.0, 0.8, 1.0, 0.1, 0.2, 0.0, 0.5),
        Cubic(0.2 * STIFFNESS / 0.004**2, 0.01),
        BoucWen(0.4 * STIFFNESS, 0.003, 0.05, 2.0, delta_eta=0.1),
    ),
    "parallel": (Bilinear(STIFFNESS, 0.003, 0.1), ViscousPower(5.0, 0.5), Friction(1.0, 1e-4)),
}
KINKS = ("bilinear", "clough", "gap", "friction", "viscous", "parallel")


def building(laws: tuple[Law, ...]) -> Building:
    """Return two computed storeys, the first with laws, below one that stands on the table."""
    at_rest = [sum(law.at_rest[i] for law in laws) for i in range(2)]
    stiffness, dashpots = np.array([STIFFNESS, 6000.0]), np.array([3.0, 2.0])
    below = Numerical(
        np.array([6.0, 5.0]),
        storey_matrix([stiffness[0] + at_rest[0], stiffness[1]]),
        storey_matrix([dashpots[0] + at_rest[1], dashpots[1]]),
    )
    above = Specimen(np.array([4.0]), storey_matrix([5000.0]), storey_matrix([2.0]))
    return Building(below, above, 0.0, *assemble(below, above, 0.0), laws=arranged((laws, ())))


def ground(dt_s: float, peak_m_s2: float = 3.0) -> Array:
    """Return 4 s of a motion that is linear between points of 4 ms, at a rate that divides them."""
    coarse = np.arange(0.0, 4.0 + 1e-9, 0.004)
    accel = peak_m_s2 * np.sin(2.0 * np.pi * 2.3 * coarse) * np.sin(np.pi * coarse / 4.0) ** 2
    return np.interp(np.arange(round(4.0 / dt_s)) * dt_s, coarse, accel)


@entry
def driven(
    part: StoreysAndForces, ground_accel: Array, shear: Array, accel: Array, drive: Array, motion: Array
) -> None:
    """Write the interface's acceleration (n,) for a ground acceleration and a base shear (n,)."""
    part, ground_accel, shear, accel, drive, motion = borrowed((part, ground_accel, shear, accel, drive, motion))
    for k in range(ground_accel.size):
        drive[0], drive[3] = ground_accel[k], shear[k]
        part.free(drive[:3], motion[:1, 0])
        part.advance(drive[:3], drive[3:], motion)
        accel[k] = motion[0, 0]


def run(design: StoreysWithLaws, ground_accel: Array, shear: Array) -> Array:
    """Return the interface's absolute acceleration (n,)."""
    one = Interface(InterfaceForce(np.zeros((1, 0)), np.zeros((1, 0, 1)), np.zeros((1, 1)), np.zeros((1, 1))))
    accel = np.zeros(len(ground_accel))
    driven(storeys_and_forces(design, one, Room()), ground_accel, shear, accel, np.zeros(4), np.zeros((3, 1)))
    return accel


@pytest.mark.parametrize("name", LAWS)
def test_the_step_follows_each_law_as_sim_does(name: str) -> None:
    """Error of the interface's acceleration falls with the step: by its square, where no kink is within a step."""
    errors = []
    for dt_s in (1e-3, 5e-4, 2.5e-4):
        whole, accel = building(LAWS[name]), ground(dt_s)
        wanted = simulate_with_laws(whole, dt_s, accel)
        found = run(StoreysWithLaws(whole.numerical, whole.laws, dt_s), accel, wanted.base_shear_n)
        linear = simulate_with_laws(building(()), dt_s, accel).abs_accel_m_s2[1]
        peak = np.abs(wanted.abs_accel_m_s2[1]).max()
        errors.append(np.sqrt(np.mean((found - wanted.abs_accel_m_s2[1]) ** 2)) / peak)
        assert np.abs(wanted.abs_accel_m_s2[1] - linear).max() > 0.02 * peak  # the law acts
    assert errors[1] < 1e-3
    assert errors[0] / errors[2] > (3.0 if name in KINKS else 12.0)


@pytest.mark.campaign
@pytest.mark.parametrize("name", REPEATED)
def test_a_law_of_the_user_s_own_steps_as_the_built_in_one_that_it_repeats(name: str) -> None:
    make, built_in = REPEATED[name]
    accel, shear = ground(1e-3), 10.0 * np.sin(np.arange(4000) * 0.02)
    pair = [building((law,)) for law in (make(), built_in)]
    ours, theirs = (run(StoreysWithLaws(one.numerical, one.laws, 1e-3), accel, shear) for one in pair)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()


def test_laws_that_are_linear_leave_the_linear_block() -> None:
    straight = (Bilinear(STIFFNESS, 0.002, 1.0), ViscousPower(3.0, 1.0), ElasticGap(0.0, 0.001), Cubic(0.0, 0.01))
    whole, plain = building(straight), building(())
    assert whole.linear and whole.numerical.C[0, 0] == plain.numerical.C[0, 0] + 3.0
    with_dashpot = replace(plain.numerical, C=whole.numerical.C)
    same = replace(plain, numerical=with_dashpot)
    blocks = [computed_storeys(each, 5e-4, "exact") for each in (whole, same)]
    for one, other in zip(*((each.A, each.B, each.C, each.D) for each in blocks), strict=True):  # type: ignore[union-attr]
        np.testing.assert_array_equal(one, other)


def test_a_gap_that_stays_open_leaves_the_linear_response() -> None:
    whole, plain = building((ElasticGap(STIFFNESS, 1.0),)), building(())
    accel = ground(5e-4)
    shear = simulate_with_laws(plain, 5e-4, accel).base_shear_n
    free = [run(StoreysWithLaws(each.numerical, whole.laws, 5e-4), accel, shear) for each in (whole, plain)]
    exact = simulate_with_laws(plain, 5e-4, accel).abs_accel_m_s2[1]
    np.testing.assert_array_equal(*free)
    assert np.abs(free[0] - exact).max() < 1e-4 * np.abs(exact).max()  # the shear is no straight line


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_the_limit_of_a_stiff_contact_is_where_its_own_run_diverges(share: float) -> None:
    """A gap of nothing is a spring at all times; the spectral radius gives its limit, and a run after a push too."""
    dt_s = 4e-3
    soft = StoreysWithLaws(building(()).numerical, building((ElasticGap(1.0, 0.0),)).laws, dt_s)
    low, high = 0.0, 1e8
    for _ in range(60):
        middle = 0.5 * (low + high)
        stable = soft.radius(np.array([middle]), np.zeros(1)) <= 1.0 + 1e-9
        low, high = (middle, high) if stable else (low, middle)
    whole = building((ElasticGap(share * low, 0.0),))
    pushed = np.zeros(1500)
    pushed[:3] = 1.0
    accel = run(StoreysWithLaws(whole.numerical, whole.laws, dt_s), pushed, np.zeros(1500))
    assert (np.abs(accel[-100:]).max() > 10.0 * np.abs(accel[:100]).max()) == (share > 1.0)
    if share > 1.0:
        with pytest.raises(InputError, match=r"law\[1\]: its stiffest tangent.*unstable at dt = 4 ms; the limit is"):
            computed_storeys(whole, dt_s, "exact")
    else:
        computed_storeys(whole, dt_s, "exact")


def test_laws_go_with_the_exact_scheme_only() -> None:
    with pytest.raises(InputError, match="integration: storeys with laws are integrated by exact only, not by cr"):
        computed_storeys(building(LAWS["bilinear"]), 5e-4, "cr")


@entry
def read_off(curve: Array, rates: Array, forces: Array) -> None:
    """Write the forces (n,) of a damper at rates (n,)."""
    curve, rates, forces = borrowed((curve, rates, forces))
    for k in range(rates.size):
        forces[k] = on_curve(curve, rates[k])


def damper_forces(power: float, c: float, knee: float, rates: Array, gives: float) -> Array:
    """Return the forces (n,) of a damper at the rates (n,)."""
    forces = np.zeros(len(rates))
    read_off(power_curve(c, power, knee, gives), rates, forces)
    return forces


@pytest.mark.parametrize(
    ("power", "c", "gives", "rate"),
    [
        (0.2, 50.0, 0.01, 0.3),
        (0.5, 5.0, 0.001, -2e-2),
        (0.5, 5.0, 1e-5, -2e-2),
        (0.5, 50.0, 0.4, 0.3),
        (2.0, 900.0, 0.02, -1.5),
        (2.0, 900.0, 0.0, 1.5),
        (2.5, 900.0, 0.02, 1.5),
        (3.0, 4000.0, 0.03, 5.0),
    ],
)
def test_a_damper_solves_its_own_equation(power: float, c: float, gives: float, rate: float) -> None:
    """The rate falls with the damper's own force: v + gives c v^a = rate, by bisection."""
    v = brentq(lambda v: v + gives * c * v**power - abs(rate), 1e-5, abs(rate), xtol=1e-15)
    found = damper_forces(power, c, 1e-5, np.array([rate]), gives)[0]
    assert found == pytest.approx(np.sign(rate) * c * v**power, rel=1e-11)


@pytest.mark.campaign
@parametrize_first(6, "gives", [0.0, 1e-3, 0.05, 1.0])
@parametrize_first(6, "power", [0.01, 0.1, 0.3, 0.7, 0.9, 1.5, 2.5, 3.0])
def test_a_damper_has_its_force_at_every_rate(power: float, gives: float) -> None:
    """From the straight line near rest to far beyond what storeys do, to both sides, by bisection."""
    c, knee = 9.0, 1e-3

    def law(v: float) -> float:
        return c * (v**power if v > knee else v * knee ** (power - 1.0))

    bend = knee + gives * law(knee)
    rates = np.concatenate([np.geomspace(1e-6, 900.0, 400), bend * np.array([0.999, 1.0, 1.001])])
    rates = np.concatenate([rates, -rates, [0.0]])
    for rate, found in zip(rates, damper_forces(power, c, knee, rates, gives), strict=True):
        size = abs(rate)
        v = brentq(lambda v, size=size: v + gives * law(v) - size, 0.0, size, xtol=1e-18, rtol=1e-15)
        within = 1e-12 if power >= 0.3 else 1e-9  # dry friction, nearly: curves have corners
        assert found == pytest.approx(np.sign(rate) * law(v), rel=within, abs=1e-300)


def test_a_damper_goes_straight_on_beyond_its_curve_and_passes_on_what_is_no_number() -> None:
    rates = np.array([1e3, 1.02e3, 1.04e3, 2e3, 3e3, 4e3, np.inf, -np.inf, np.nan])
    forces = damper_forces(0.5, 4.0, 1e-5, rates, 1e-4)
    assert forces[:3] == pytest.approx(4.0 * np.sqrt(rates[:3]), rel=1e-3)
    assert forces[5] - forces[4] == pytest.approx(forces[4] - forces[3], rel=1e-12)
    assert forces[6] == np.inf and forces[7] == -np.inf and np.isnan(forces[8])


@entry
def followed(numbers: Array, curve: Array, table: Array, memory: Array, drifts: Array, forces: Array) -> None:
    """Write the forces (n,) of Bouc and Wen's law at one drift (n,) after the other."""
    numbers, curve, table, memory = borrowed((numbers, curve, table, memory))
    drifts, forces = borrowed((drifts, forces))
    for k in range(drifts.size):
        forces[k] = hysteresis(numbers, curve, table, memory, drifts[k])


@pytest.mark.campaign
@parametrize_first(
    2,
    ("n", "beta", "gamma", "within"),
    [
        (1.0, 0.5, 0.5, 2e-5),
        (1.0, 0.9, -0.3, 2e-5),
        (1.1, 0.5, 0.5, 2e-5),
        (1.5, 0.3, 0.7, 5e-6),
        (2.0, 0.5, 0.5, 2e-7),
        (2.0, 0.8, -0.5, 2e-7),
        (3.0, 0.5, 0.5, 2e-7),
        (5.0, 0.6, 0.4, 5e-7),
        (20.0, 0.5, 0.5, 5e-6),
    ],
)
def test_bouc_and_wen_s_variable_follows_its_equation(n: float, beta: float, gamma: float, within: float) -> None:
    """Cycles to four yield drifts, at most 0.03 of one per sample, against a solver with small steps of its own; the
    error is largest where the slope has a kink, at zero force, and least where n = 2 or 3 has none or a small one."""
    limit = 1e-3
    time_s = np.linspace(0.0, 1.0, 4001)[1:]
    drifts = limit * (3.0 * np.sin(18.8 * time_s) + 1.5 * np.sin(45.9 * time_s))
    laws = arranged(((BoucWen(1.0, limit, 0.0, n, beta, gamma),),))
    numbers, curves, tables = of_the_step(laws, np.zeros(1), 1e-3)
    forces = np.zeros(len(drifts))
    followed(numbers[0], curves[0], tables[0], np.zeros(REMEMBERED), drifts, forces)
    wanted, y, parts = np.zeros(len(drifts)), 0.0, 32
    for k, way in enumerate(np.diff(drifts, prepend=0.0) / limit):
        h = way / parts
        for _ in range(parts):
            slopes = [0.0]
            for share in (0.0, 0.5, 0.5, 1.0):
                z = y + share * h * slopes[-1]
                slopes.append(1.0 - abs(z) ** n * (gamma + beta * np.sign(z * way)))
            y += h * (slopes[1] + 2.0 * slopes[2] + 2.0 * slopes[3] + slopes[4]) / 6.0
        wanted[k] = y
    assert np.abs(forces / limit + drifts / limit - wanted).max() < within


@pytest.mark.campaign
@parametrize_first(
    2,
    ("law", "within"),
    [
        (BoucWen(1.0, 1e-3, 0.1, 1.0, delta_a=0.01), 2e-5),
        (BoucWen(1.0, 1e-3, 0.0, 2.0, delta_nu=0.05), 5e-7),
        (BoucWen(1.0, 1e-3, 0.0, 2.0, 0.8, -0.5, delta_eta=0.1), 5e-7),
        (BoucWen(1.0, 1e-3, 0.0, 20.0, delta_nu=0.02), 5e-6),
        (BoucWen(1.0, 1e-3, 0.05, 1.0, 0.6, 0.4, 0.002, 0.02, 0.05, 0.7, 1.0, 0.1, 0.2, 0.01, 0.3), 2e-5),
        (BoucWen(1.0, 1e-3, 0.05, 2.0, 0.6, 0.4, 0.002, 0.02, 0.05, 0.7, 1.0, 0.1, 0.2, 0.01, 0.3), 2e-6),
        (BoucWen(1.0, 1e-3, 0.05, 1.5, 0.3, 0.7, 0.002, 0.02, 0.05, 0.9, 0.3, 0.2, 0.5, 0.0, 0.5), 5e-6),
        (BoucWen(1.0, 1e-3, 0.05, 2.0, zeta_s=0.9, p=100.0, psi=1.0, lambda_=1.0), 2e-6),
        (
            BoucWen(1.0, 1e-3, 0.0, 2.0, delta_nu=1.0, delta_eta=0.2, zeta_s=0.8, p=0.5, q=0.3, psi=0.3, lambda_=0.4),
            5e-6,
        ),
        (BoucWen(1.0, 1e-3, 0.0, 2.0, zeta_s=0.5, p=1.0, psi=1.0, lambda_=0.0), 5e-5),
        (BoucWen(1.0, 1e-3, 0.0, 2.0, zeta_s=0.9, p=1.0, q=0.2, psi=0.02, lambda_=0.5), 1.5e-4),  # narrower than a step
    ],
)
def test_a_law_that_degrades_follows_its_equation(law: BoucWen, within: float) -> None:
    """Cycles to four yield drifts, at most 0.03 of one per sample, against a solver with small steps of its own."""
    time_s = np.linspace(0.0, 1.0, 4001)[1:]
    drifts = 1e-3 * (3.0 * np.sin(18.8 * time_s) + 1.5 * np.sin(45.9 * time_s))
    found = y_of(law, drifts)
    wanted, y, e, parts = np.zeros(len(drifts)), 0.0, 0.0, 16
    for k, way in enumerate(np.diff(drifts, prepend=0.0) / 1e-3):
        h = way / parts
        for _ in range(parts):
            slopes = [(0.0, 0.0)]
            for share in (0.0, 0.5, 0.5, 1.0):
                slopes.append(slope_of_bouc_wen(law, y + share * h * slopes[-1][0], e + share * h * slopes[-1][1], way))
            change = [sum(w * slopes[i][j] for i, w in ((1, 1.0), (2, 2.0), (3, 2.0), (4, 1.0))) / 6.0 for j in (0, 1)]
            y, e = y + h * change[0], e + h * change[1]
        wanted[k] = y
    assert np.abs(found - wanted).max() < within


def y_of(law: BoucWen, drifts: Array) -> Array:
    """Return the law's variable over the yield drift (n,) at one drift (n,) after the other."""
    numbers, curves, tables = of_the_step(arranged(((law,),)), np.zeros(1), 1e-3)
    forces = np.zeros(len(drifts))
    followed(numbers[0], curves[0], tables[0], np.zeros(REMEMBERED), drifts, forces)
    return (forces / numbers[0, 0] + drifts) / law.yield_displacement_m


def slope_of_bouc_wen(law: BoucWen, y: float, e: float, way: float) -> tuple[float, float]:
    """Return dy/ds and de/ds where the drift moves by s yield drifts."""
    side, n, bound = np.sign(way), law.exponent, law.beta + law.gamma
    a, nu, eta = 1.0 - law.delta_a * e, 1.0 + law.delta_nu * e, 1.0 + law.delta_eta * e
    slope = (a - nu * abs(y) ** n * (law.gamma + law.beta * np.sign(y * side))) / eta
    zeta = -law.zeta_s * np.expm1(-law.p * e)
    if zeta != 0.0:
        off = y * side - law.q * (nu * bound) ** (-1.0 / n)
        slope *= 1.0 - zeta * np.exp(-((off / (law.psi + law.delta_psi * e) / (law.lambda_ + zeta)) ** 2))
    return slope, (1.0 - law.hardening) * y
