"""Computed storeys with laws against SIM, whose code and method are others; the scheme's limit against its own run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from repeated_laws import REPEATED
from scipy.optimize import brentq

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.control.interface import Interface, InterfaceForce
from rths_cli.control.storeys_with_laws import StoreysWithLaws, computed_storeys
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.loop.storey_forces import StoreysAndForces, damper, storeys_and_forces
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
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


@pytest.mark.parametrize("name", REPEATED)
def test_a_law_of_the_user_s_own_steps_as_the_built_in_one_that_it_repeats(name: str) -> None:
    make, built_in = REPEATED[name]
    accel, shear = ground(1e-3), 10.0 * np.sin(np.arange(4000) * 0.02)
    pair = [building((law,)) for law in (make(), built_in)]
    ours, theirs = (run(StoreysWithLaws(one.numerical, one.laws, 1e-3), accel, shear) for one in pair)
    within = 1e-7 if name == "viscous_power" else 1e-12  # a built-in damper goes by series, see loop/storey_forces.py
    assert np.abs(ours - theirs).max() < within * np.abs(theirs).max()


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
def damped(numbers: Array, memory: Array, rates: Array, gives: float, forces: Array) -> None:
    """Write the forces (n,) of a damper at one rate (n,) after the other."""
    numbers, memory, rates, forces = borrowed((numbers, memory, rates, forces))
    for k in range(rates.size):
        forces[k] = damper(numbers, memory, rates[k], gives)


def damper_forces(power: float, c: float, knee: float, rates: Array, gives: float) -> Array:
    """Return the forces (n,) of a damper at the rates (n,), from rest on."""
    forces = np.zeros(len(rates))
    damped(np.array([c, power, knee, c * knee ** (power - 1.0)]), np.zeros(2), rates, gives, forces)
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


@pytest.mark.parametrize("gives", [0.0, 1e-3, 0.05, 1.0])
@pytest.mark.parametrize("power", [0.1, 0.3, 0.7, 0.9, 1.5, 2.5, 3.0])
def test_a_damper_goes_from_sample_to_sample(power: float, gives: float) -> None:
    """From each rate to the next one, smooth or jumping, back and forth through the straight line near rest.

    Series err most where the damper takes far more of the rate than it leaves (`gives` 1).
    """
    c, knee = 9.0, 1e-3
    smooth = 0.4 * np.sin(np.arange(300) * 0.03) * np.linspace(0.0, 1.0, 300)
    ratios = np.array([0.9, 0.91, 1.0, 1.09, 1.1, 1.101, 3.0, 0.2, -1.0, -1.05])

    def law(v: float) -> float:
        return c * (v**power if v > knee else v * knee ** (power - 1.0))

    rates = np.append(smooth, 0.05 * np.cumprod(ratios))
    for rate, found in zip(rates, damper_forces(power, c, knee, rates, gives), strict=True):
        size = abs(rate)
        v = brentq(lambda v, size=size: v + gives * law(v) - size, 0.0, size + knee, xtol=1e-18, rtol=1e-15)
        assert found == pytest.approx(np.sign(rate) * law(v), rel=3e-6 if gives == 1.0 else 1e-7, abs=1e-14)
