"""SIM-DELAY of storeys with laws. Oracles: the linear one, SIM, and a Runge-Kutta integration with a delay line."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
from test_sim_delay import five_storeys, noise, outputs, paper_building, relative_difference

from rths_cli.analysis.critical_delay import critical_delay, critical_delay_range
from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.errors import InputError
from rths_cli.structure import Building, assemble, storey_matrix
from rths_cli.structure.storey_laws import (
    Bilinear,
    BoucWen,
    Clough,
    Cubic,
    ElasticGap,
    Friction,
    Law,
    ViscousPower,
    arranged,
)

DT_S = 1 / 400
FINE = 80  # Runge-Kutta steps of a sample: a yielding storey turns within 31 us
K_N_PER_M = float(paper_building().numerical.K[0, 0])
BILINEAR = Bilinear(K_N_PER_M, 0.002, 0.05)
LAWS: dict[str, Law] = {
    "bilinear": BILINEAR,
    "bouc_wen": BoucWen(K_N_PER_M, 0.003, 0.05),
    "friction": Friction(8.0, 0.0005, 500.0),
    "viscous_power": ViscousPower(15.0, 0.5, 0.001),
}


@cache
def ground(seconds: float) -> np.ndarray:
    return noise(seconds, DT_S)


def with_law(building: Building, law: Law, storey: int = 1) -> Building:
    """Return a building with a law in a storey, counted from 1, that has what the law adds at rest."""
    laws = ((),) * (storey - 1) + ((law,),)
    added = np.zeros(len(building.numerical.masses_kg))
    added[storey - 1] = law.at_rest[0]
    numerical = replace(building.numerical, K=building.numerical.K + storey_matrix(added))
    total = assemble(numerical, building.specimen, building.interface_experimental_mass_kg)
    return Building(numerical, building.specimen, building.interface_experimental_mass_kg, *total, laws=arranged(laws))


@numba.njit(error_model="numpy")
def force_and_rate(kind: int, a: np.ndarray, z: float, u: float, v: float) -> tuple[float, float]:
    """The law's force beyond the linear storey, and dz/dt: z is the elastic drift, clipped after each step."""
    if kind == 0:  # elastic and perfectly plastic of stiffness a0 up to a1
        return a[0] * (min(max(z, -a[1]), a[1]) - u), v
    if kind == 1:  # Bouc-Wen, n = 1, beta = gamma = 0.5 / a1
        return a[0] * (z - u), v - 0.5 / a[1] * (abs(v) * z + v * abs(z))
    slow = a[0] * a[2] ** (a[1] - 1.0) * v
    return (slow if abs(v) < a[2] else a[0] * np.sign(v) * abs(v) ** a[1]), 0.0


@numba.njit(error_model="numpy")
def late_force(line: np.ndarray, position: float) -> float:
    """Interpolate the delay line by a cubic through four points; zero before the start."""
    if position <= 0.0:
        return 0.0
    i = max(int(position) - 1, 0)
    s, total = position - i, 0.0
    for j in range(4):
        weight = 1.0
        for m in range(4):
            weight *= (s - m) / (j - m) if m != j else 1.0
        total += weight * line[i + j]
    return total


@numba.njit(error_model="numpy")
def runge_kutta(Mn, Cn, Kn, Ms, Cs, Ks, mass, kind, a, storey, record, dt_s, fine, lag):  # type: ignore[no-untyped-def]
    """Integrate both parts with steps of 1 / `fine` sample; absolute accelerations and displacements by sample."""
    p, n, h = len(Mn), len(Ms), dt_s / fine
    steps = (len(record) - 1) * fine
    line, y = np.zeros(steps + 4), np.zeros(2 * p + 2 * n + 1)
    slopes, accel = np.zeros((4, len(y))), np.zeros(p + n)
    found = np.zeros((2, p + n, len(record)))
    for step in range(steps + 1):
        for stage in range(4):
            part = (0.0, 0.5, 0.5, 1.0)[stage]
            now = y + h * part * slopes[stage - 1] if stage else y
            k = min((step + part) / fine, len(record) - 1.0)
            i = min(int(k), len(record) - 2)
            ag = record[i] + (k - i) * (record[i + 1] - record[i])
            x, v, xs, vs = now[:p], now[p : 2 * p], now[2 * p : 2 * p + n], now[2 * p + n : -1]
            below = storey - 1
            u = x[storey] - (x[below] if storey else 0.0)
            w = v[storey] - (v[below] if storey else 0.0)
            g, dz = force_and_rate(kind, a, now[-1], u, w)
            forces = -(Cn @ v) - Kn @ x
            forces[storey] -= g
            if storey:
                forces[below] += g
            forces[-1] += late_force(line, step + part - lag)
            own = forces / Mn
            top = -(Cs @ vs + Ks @ xs) / Ms
            if stage == 0:
                line[step] = -mass * own[-1] - (Ms * top).sum()
                accel[:p], accel[p:] = own, top
            slopes[stage, :p], slopes[stage, p : 2 * p] = v, own - ag
            slopes[stage, 2 * p : 2 * p + n], slopes[stage, 2 * p + n : -1] = vs, top - own[-1]
            slopes[stage, -1] = dz
        if step % fine == 0:
            found[0, :, step // fine] = accel
            found[1, :p, step // fine] = y[:p]
            found[1, p:, step // fine] = y[2 * p : 2 * p + n] + y[p - 1]
        if not abs(line[step]) < 1e6:
            break
        y = y + h / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
        if kind == 0:
            y[-1] = min(max(y[-1], -a[1]), a[1])
    return found


def integrated(building: Building, law: Law, record: np.ndarray, delay_s: float, fine: int = FINE) -> np.ndarray:
    """Absolute accelerations, then displacements to the ground, (2, floors, n), of the one law of a building."""
    own, top = building.numerical, building.specimen
    kind = {Bilinear: 0, Friction: 0, BoucWen: 1, ViscousPower: 2}[type(law)]
    a = np.array((*law.numbers, 0.0)[:3])
    storey = int(building.laws.storey[0])
    lag = delay_s / DT_S * fine
    return runge_kutta(
        own.masses_kg, own.C, own.K, top.masses_kg, top.C, top.K, building.interface_experimental_mass_kg,
        kind, a, storey, record, DT_S, fine, lag,
    )  # fmt: skip


@pytest.mark.parametrize("interface_mass_kg", [0.0, 1.7325])
def test_laws_that_never_act_leave_the_linear_response(interface_mass_kg: float) -> None:
    building = paper_building(interface_mass_kg=interface_mass_kg)
    linear = outputs(simulate_delayed(building, DT_S, ground(2.0), 0.0031, 1e-10))
    for law in (ElasticGap(1e4, 1.0), Bilinear(K_N_PER_M, 1.0, 0.0)):
        found = simulate_delayed_with_laws(with_law(building, law), DT_S, ground(2.0), 0.0031, 1e-10)
        assert relative_difference(outputs(found), linear) < 1e-9
        assert found.laws is not None
        assert not found.laws.force_n.any()


def test_hardening_one_is_the_linear_response() -> None:
    building = paper_building()
    found = simulate_delayed_with_laws(with_law(building, Bilinear(K_N_PER_M, 0.002, 1.0)), DT_S, ground(1.0), 0.003)
    assert np.array_equal(outputs(found), outputs(simulate_delayed(building, DT_S, ground(1.0), 0.003)))


def test_small_delays_approach_sim_in_proportion() -> None:
    building = with_law(paper_building(), BILINEAR)
    sim = simulate_with_laws(building, DT_S, ground(2.0))
    assert sim.laws is not None
    assert np.abs(sim.laws.force_n).max() > 1.0
    changes = [
        (outputs(simulate_delayed_with_laws(building, DT_S, ground(2.0), delay_s, sim=sim)) - outputs(sim))[:3]
        for delay_s in (1e-4, 2e-4)
    ]
    assert np.abs(changes[1] - 2.0 * changes[0]).max() < 0.05 * np.abs(changes[1]).max()
    same = simulate_delayed_with_laws(building, DT_S, ground(2.0), 0.0)
    assert np.array_equal(outputs(same), outputs(sim))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("delay_s", [0.005, 0.00337])
def test_laws_agree_with_runge_kutta(name: str, delay_s: float) -> None:
    building = with_law(paper_building(), LAWS[name])
    found = simulate_delayed_with_laws(building, DT_S, ground(3.0), delay_s)
    assert found.error_estimate <= 1e-6
    assert found.laws is not None
    assert np.abs(found.laws.work_j[0]).max() > 1e-3
    other = integrated(building, LAWS[name], ground(3.0), delay_s)
    for mine, theirs in zip((found.abs_accel_m_s2, found.rel_disp_m), other, strict=True):
        assert relative_difference(mine, theirs) < 1e-5


@pytest.mark.parametrize("storey", [1, 2])
@pytest.mark.parametrize("interface_mass_kg", [0.0, 2.0])
def test_any_cut_agrees_too(storey: int, interface_mass_kg: float) -> None:
    law = Bilinear(9e3, 0.001, 0.1)
    building = with_law(five_storeys(interface_mass_kg), law, storey)
    found = simulate_delayed_with_laws(building, DT_S, ground(3.0), 0.0047)
    other = integrated(building, law, ground(3.0), 0.0047)
    for mine, theirs in zip((found.abs_accel_m_s2, found.rel_disp_m), other, strict=True):
        assert relative_difference(mine, theirs) < 1e-5
