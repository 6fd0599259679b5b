"""SIM-DELAY of storeys with laws. Oracles: the linear one, SIM, and a Runge-Kutta integration with a delay line."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
from portfolio import parametrize_first
from test_sim_delay import five_storeys, noise, outputs, paper_building, relative_difference

from rths_cli.analysis.closed_loop import critical_delay, critical_delay_range
from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.sim_delay import DelayedResponse, simulate_delayed
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
    if storey <= len(added):
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
def runge_kutta(A, b, shear, drift, kind, a, record, fine, h, lag, found):  # type: ignore[no-untyped-def]
    """Integrate dy = A y + b [a_g, late f, g] with steps of h, 1 / `fine` sample; states and their rates by sample.

    The law's z is the last state, whose rate is the law's own; `drift` (2, N) makes drift and rate. f = shear dy.
    """
    size, steps = len(A), (len(record) - 1) * fine
    line, y, now, slopes, inputs = np.zeros(steps + 4), np.zeros(size), np.zeros(size), np.zeros((4, size)), np.zeros(3)
    for step in range(steps + 1):
        for stage in range(4):
            part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            i = min((2 * step + (stage + 1) // 2) // (2 * fine), len(record) - 2)
            u = w = 0.0
            for r in range(size):
                now[r] = y[r] + h * part * (slopes[stage - 1, r] if stage else 0.0)
                u += drift[0, r] * now[r]
                w += drift[1, r] * now[r]
            inputs[0] = record[i] + ((step + part) / fine - i) * (record[i + 1] - record[i])
            inputs[1] = late_force(line, step + part - lag)
            inputs[2], slopes[stage, size - 1] = force_and_rate(kind, a, now[size - 1], u, w)
            for r in range(size - 1):
                total = b[r, 0] * inputs[0] + b[r, 1] * inputs[1] + b[r, 2] * inputs[2]
                for c in range(size - 1):
                    total += A[r, c] * now[c]
                slopes[stage, r] = total
            if stage == 0:
                for r in range(size):
                    line[step] += shear[r] * (slopes[0, r] - b[r, 0] * inputs[0])
        if step % fine == 0:
            for r in range(size):
                found[0, r, step // fine], found[1, r, step // fine] = slopes[0, r], y[r]
        if not abs(line[step]) < 1e6:
            return
        for r in range(size):
            y[r] += h / 6.0 * (slopes[0, r] + 2.0 * slopes[1, r] + 2.0 * slopes[2, r] + slopes[3, r])
        if kind == 0:
            y[size - 1] = min(max(y[size - 1], -a[1]), a[1])


def integrated(building: Building, law: Law, record: np.ndarray, delay_s: float) -> np.ndarray:
    """Absolute accelerations, then displacements to the ground, (2, floors, n), of the one law of a building."""
    own, top, storey = building.numerical, building.specimen, int(building.laws.storey[0])
    p, n = len(own.masses_kg), len(top.masses_kg)
    size = 2 * (p + n) + 1  # displacements and velocities to the ground of every floor, z
    A, b, shear, drift = np.zeros((size, size)), np.zeros((size, 3)), np.zeros(size), np.zeros((2, size))
    A[: p + n, p + n : -1] = np.eye(p + n)
    floors, interface = p + n, p + n + p - 1
    to_table = np.hstack([np.zeros((n, p)), np.eye(n)])
    to_table[:, p - 1] = -1.0
    for matrix_own, matrix_top, first in ((own.K, top.K, 0), (own.C, top.C, floors)):
        A[floors : floors + p, first : first + p] = -matrix_own / own.masses_kg[:, None]
        A[floors + p : -1, first : first + floors] = -matrix_top @ to_table / top.masses_kg[:, None]
    b[floors:-1, 0], b[interface, 1] = -1.0, 1.0 / own.masses_kg[-1]
    masses = np.concatenate([own.masses_kg, top.masses_kg])
    b[floors + storey, 2], drift[0, storey], drift[1, floors + storey] = -1.0 / masses[storey], 1.0, 1.0
    if storey:
        if storey != p:  # the interface floor gets the late shear alone
            b[floors + storey - 1, 2] = 1.0 / masses[storey - 1]
        drift[0, storey - 1] = drift[1, floors + storey - 1] = -1.0
    shear[interface], shear[floors + p : -1] = -building.interface_experimental_mass_kg, -top.masses_kg
    kind = {Bilinear: 0, Friction: 0, BoucWen: 1, ViscousPower: 2}[type(law)]
    found = np.zeros((2, size, len(record)))
    a, lag = np.array((*law.numbers, 0.0)[:3]), delay_s / DT_S * FINE
    runge_kutta(A, b, shear, drift, kind, a, record, FINE, DT_S / FINE, lag, found)
    return np.array([found[0, floors:-1] + record, found[1, :floors]])


def difference(found: DelayedResponse, other: np.ndarray) -> float:
    """Largest difference of accelerations and displacements over their peak, up to where SIM-DELAY was cut."""
    end = int(np.isfinite(found.base_shear_n).sum())
    pairs = zip((found.abs_accel_m_s2, found.rel_disp_m), other, strict=True)
    return max(relative_difference(mine[:, :end], theirs[:, :end]) for mine, theirs in pairs)


@parametrize_first(1, "interface_mass_kg", [0.0, 1.7325])
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
    assert difference(found, integrated(building, LAWS[name], ground(3.0), delay_s)) < 1e-5


@pytest.mark.campaign
@pytest.mark.parametrize("storey", [1, 2, 3, 5])
@pytest.mark.parametrize("interface_mass_kg", [0.0, 2.0])
def test_any_cut_agrees_too_and_laws_on_the_table(storey: int, interface_mass_kg: float) -> None:
    law = Bilinear(9e3, 0.001, 0.1)
    building = with_law(five_storeys(interface_mass_kg), law, storey)
    found = simulate_delayed_with_laws(building, DT_S, ground(3.0), 0.0047)
    assert difference(found, integrated(building, law, ground(3.0), 0.0047)) < 1e-5


def pulse(seconds: float) -> np.ndarray:
    record = np.zeros(int(seconds / DT_S))
    record[:400] = 3.0 * ground(1.0)[:400]
    return record


def test_yielding_bounds_what_grows_in_the_linear_building() -> None:
    building, record = with_law(paper_building(), BILINEAR), pulse(10.0)
    found = simulate_delayed_with_laws(building, DT_S, record, 0.009)
    linear = simulate_delayed(paper_building(), DT_S, record, 0.009)
    last, before = (np.abs(found.abs_accel_m_s2[:, part]).max() for part in (slice(-400, None), slice(-1200, -800)))
    assert last == pytest.approx(before, rel=1e-3)  # a vibration that neither grows nor dies out
    assert np.abs(linear.abs_accel_m_s2[:, -400:]).max() > 5.0 * last
    assert found.diverged_at_s is None
    assert difference(found, integrated(building, BILINEAR, record, 0.009)) < 1e-5


def test_a_long_delay_diverges_though_the_storey_yields() -> None:
    building, record = with_law(paper_building(), BILINEAR), pulse(6.0)
    found = simulate_delayed_with_laws(building, DT_S, record, 0.02)
    limit = 1000.0 * np.abs(simulate_with_laws(building, DT_S, record).abs_accel_m_s2).max()
    other = integrated(building, BILINEAR, record, 0.02)
    beyond = np.abs(other[0]).max(axis=0) > limit
    assert beyond.any()
    assert found.diverged_at_s == pytest.approx(int(np.argmax(beyond)) * DT_S, abs=DT_S)
    assert np.isnan(found.rel_disp_m[:, -1]).all()
    assert found.laws is not None
    assert np.isnan(found.laws.work_j[0, -1])
    assert difference(found, other) < 1e-5


def test_error_estimate_is_the_change_by_halving_and_larger_than_the_error() -> None:
    law = Bilinear(9e3, 0.001, 0.1)
    building, record = with_law(five_storeys(0.0), law, 2), noise(3.0, 0.01)
    exact = outputs(simulate_delayed_with_laws(building, 0.01, record, 0.0147, 1e-8))
    responses: list[DelayedResponse] = []
    tolerance = np.inf
    for _ in range(3):  # each asks for less than the one before left: one more halving
        responses.append(simulate_delayed_with_laws(building, 0.01, record, 0.0147, tolerance))
        tolerance = 0.99 * responses[-1].error_estimate
    errors = [relative_difference(outputs(response), exact) for response in responses]
    for i in (1, 2):
        assert errors[i] < responses[i].error_estimate <= 1.1 * errors[i - 1]
        assert errors[i] < errors[i - 1] / 4.0  # order two at least, with the storey's events


def test_gap_clough_and_cubic_converge() -> None:
    for law in (ElasticGap(2e4, 0.002), Clough(K_N_PER_M, 0.002, 0.05, 0.3), Cubic(2e8, 0.01)):
        building = with_law(paper_building(), law)
        found = simulate_delayed_with_laws(building, DT_S, ground(2.0), 0.005, 1e-8)
        coarse = simulate_delayed_with_laws(building, DT_S, ground(2.0), 0.005)
        assert found.error_estimate <= 1e-8
        assert relative_difference(outputs(coarse), outputs(found)) < 1e-6


def test_bad_input_and_too_much_work_are_refused_with_what_to_do() -> None:
    building = with_law(paper_building(), BILINEAR)
    with pytest.raises(InputError, match="must be finite and 0 s or more"):
        simulate_delayed_with_laws(building, DT_S, ground(1.0), -0.001)
    with pytest.raises(InputError, match="raise delay_s"):
        simulate_delayed_with_laws(building, DT_S, ground(1.0), 1e-9)


def test_critical_delays_are_those_of_the_linear_buildings_at_the_tangents() -> None:
    linear = paper_building()
    law, gap = Bilinear(K_N_PER_M, 0.002, 0.05), ElasticGap(1e4, 0.002)
    found = critical_delay_range(replace(linear, laws=arranged(((law, gap),))))

    def frozen(stiffness: float) -> float:
        numerical = replace(linear.numerical, K=np.array([[stiffness]]))
        return critical_delay(replace(linear, numerical=numerical)).delay_s

    assert found.at_rest.delay_s == critical_delay(linear).delay_s
    assert found.smallest.delay_s == pytest.approx(frozen(K_N_PER_M + 1e4))
    assert found.largest.delay_s == pytest.approx(frozen(0.05 * K_N_PER_M))
    assert found.unstable == 0


def test_a_linear_building_has_one_critical_delay() -> None:
    found, linear = critical_delay_range(five_storeys(2.0)), critical_delay(five_storeys(2.0))
    assert found.smallest == found.largest == found.at_rest == linear


def test_a_tangent_that_falls_without_delay_is_left_out() -> None:
    law = Cubic(-1e9, 0.01)  # -300,000 N/m at its largest drift
    found = critical_delay_range(replace(paper_building(), laws=arranged(((law,),))))
    assert found.unstable > 0
    assert found.smallest == found.at_rest


def test_a_damper_without_bound_locks_its_storey() -> None:
    law = ViscousPower(15.0, 2.0)
    found = critical_delay_range(replace(paper_building(), laws=arranged(((law,),))))
    assert np.isinf(found.largest.delay_s)  # the interface floor stands still
    assert found.smallest.delay_s == pytest.approx(found.at_rest.delay_s, rel=1e-4)


def test_without_events_the_error_falls_with_the_fourth_power() -> None:
    building, record = five_storeys(2.0), noise(2.0, 0.01)
    exact = outputs(simulate_delayed(building, 0.01, record, 0.0147, 1e-11))
    elastic = with_law(building, ElasticGap(1e4, 1.0))
    coarse = simulate_delayed_with_laws(elastic, 0.01, record, 0.0147, np.inf)
    fine = simulate_delayed_with_laws(elastic, 0.01, record, 0.0147, 0.99 * coarse.error_estimate)
    assert fine.substep_s == coarse.substep_s / 2.0
    errors = [relative_difference(outputs(one), exact) for one in (coarse, fine)]
    assert errors[1] < errors[0] / 10.0
