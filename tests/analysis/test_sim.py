"""Oracles: scipy's first-order hold, a Taylor series of every step, statics, free decay at a known damping."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.signal import lsim

from rths_cli.analysis import sim
from rths_cli.analysis.sim import Response, simulate
from rths_cli.errors import InputError
from rths_cli.structure import Building, Numerical, Specimen, assemble, build, storey_matrix

DT_S = 1 / 2000


def paper_building(first_mode_ratio: float = 0.026, interface_mass_kg: float = 0.0) -> Building:
    spec = SimpleNamespace(
        numerical=SimpleNamespace(masses_kg=[6.93], stiffness_n_per_m="mean_of_experimental"),
        experimental=SimpleNamespace(
            masses_kg=[6.91, 6.95],
            natural_frequencies_hz=[3.2, 8.4],
            stiffness_n_per_m=None,
            damping_ratios=[0.043, 0.039],
            dashpots_n_s_per_m=None,
        ),
        interface_experimental_mass_kg=interface_mass_kg,
    )
    return build(spec, SimpleNamespace(first_mode_ratio=first_mode_ratio, dashpots_n_s_per_m=None))


def random_building(seed: int) -> Building:
    random = np.random.default_rng(seed)
    storeys = int(random.integers(2, 13))
    p = int(random.integers(1, storeys))
    masses = random.uniform(5, 9, storeys)
    stiffness, dashpots = random.uniform(5e3, 3e4, storeys), random.uniform(2, 40, storeys)
    interface_mass = 0.3 * masses[p - 1] * (seed % 2)
    floors = masses[:p] - interface_mass * np.eye(p)[p - 1]
    numerical = Numerical(floors, storey_matrix(stiffness[:p]), storey_matrix(dashpots[:p]))
    specimen = Specimen(masses[p:], storey_matrix(stiffness[p:]), storey_matrix(dashpots[p:]))
    return Building(numerical, specimen, interface_mass, *assemble(numerical, specimen, interface_mass))


def noise(seconds: float, dt_s: float, seed: int = 1) -> np.ndarray:
    """White noise at 50 Hz, linear between its samples."""
    coarse = np.random.default_rng(seed).normal(size=int(seconds * 50) + 2)
    return np.interp(np.arange(0, seconds, dt_s), np.arange(len(coarse)) / 50, coarse)


def series_of(response: Response) -> np.ndarray:
    return np.concatenate([response.rel_disp_m, response.rel_vel_m_s, response.abs_accel_m_s2])


def relative_difference(value: np.ndarray, reference: np.ndarray) -> float:
    return float((np.abs(value - reference).max(axis=1) / np.abs(reference).max(axis=1)).max())


def by_lsim(building: Building, dt_s: float, record: np.ndarray) -> np.ndarray:
    n = len(building.M)
    inverse = np.linalg.inv(building.M)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ building.K, -inverse @ building.C]])
    b = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
    c = np.concatenate([np.eye(2 * n), a[n:]])
    times = dt_s * np.arange(len(record))
    return lsim((a, b, c, np.zeros((3 * n, 1))), record, times)[1].T


def by_taylor(building: Building, dt_s: float, record: np.ndarray) -> np.ndarray:
    """Sum x(t + dt) = x + x' dt + x'' dt^2/2 + ... from the equation of motion in every step."""
    n = len(building.M)
    x, v, found = np.zeros(n), np.zeros(n), []
    for now, after in zip(record, [*record[1:], 0.0], strict=True):
        accel = -np.linalg.solve(building.M, building.C @ v + building.K @ x)
        found.append(np.concatenate([x, v, accel]))
        u = [now, (after - now) / dt_s]
        derivatives = [x, v]
        for order in range(24):
            force = building.C @ derivatives[-1] + building.K @ derivatives[-2]
            ground = u[order] if order < 2 else 0.0
            derivatives.append(-np.linalg.solve(building.M, force) - ground)
        weights = [dt_s**k / math.factorial(k) for k in range(25)]
        x, v = (sum(w * d for w, d in zip(weights, derivatives[i:], strict=False)) for i in (0, 1))
    return np.array(found).T


@pytest.mark.campaign
@pytest.mark.parametrize("ratio", [0.026, 0.036])
def test_paper_structure_agrees_with_lsim_and_taylor(ratio: float) -> None:
    building, record = paper_building(ratio), noise(4.0, DT_S)
    response = simulate(building, DT_S, record)
    assert relative_difference(series_of(response), by_lsim(building, DT_S, record)) < 1e-11
    short = simulate(building, DT_S, record[:1000])
    assert relative_difference(series_of(short), by_taylor(building, DT_S, record[:1000])) < 1e-11


@pytest.mark.parametrize("seed", range(20))
def test_random_buildings_agree_with_lsim_and_taylor(seed: int) -> None:
    building, record = random_building(seed), noise(3.0, 0.005, seed)
    response = simulate(building, 0.005, record)
    oracle = by_lsim(building, 0.005, record)
    assert relative_difference(series_of(response), oracle) < 1e-9
    assert relative_difference(series_of(response)[:, :150], by_taylor(building, 0.005, record[:150])) < 1e-9
    assert np.abs(series_of(response) - oracle).max() < 1e-9
    assert response.error_estimate < 1e-9


def test_base_shear_is_what_the_numerical_part_lacks() -> None:
    """Eq. 2.3 solved for f: the numerical masses alone do not explain the interface floor's motion."""
    for seed in range(1, 8, 2):
        building = random_building(seed)
        response = simulate(building, 0.005, noise(3.0, 0.005, seed))
        part, p = building.numerical, len(building.numerical.masses_kg)
        inertia = part.masses_kg[:, None] * response.abs_accel_m_s2[:p]
        rest = inertia + part.C @ response.rel_vel_m_s[:p] + part.K @ response.rel_disp_m[:p]
        assert np.abs(rest[:-1]).max(initial=0.0) < 1e-9 * np.abs(inertia).max()
        assert response.base_shear_n == pytest.approx(rest[-1], abs=1e-9 * np.abs(rest[-1]).max())


def test_steady_ground_acceleration_ends_in_the_static_push() -> None:
    building = paper_building(interface_mass_kg=1.5)
    response = simulate(building, 0.01, np.ones(10_000))
    static = -np.linalg.solve(building.K, np.diag(building.M))
    assert response.rel_disp_m[:, -1] == pytest.approx(static, rel=1e-9)
    assert response.abs_accel_m_s2[:, 0] == pytest.approx(np.zeros(3))
    assert response.base_shear_n[-1] == pytest.approx(-(1.5 + 6.91 + 6.95), rel=1e-9)


def test_defective_modes_take_the_matrix_recursion() -> None:
    """Every mode critically damped: the eigenvectors are (nearly) dependent and the modal sum is refused."""
    building = random_building(3)
    square_root = np.diag(np.sqrt(np.diag(building.M)))
    inner = np.linalg.solve(square_root, np.linalg.solve(square_root, building.K).T)
    critical = 2 * square_root @ sqrtm(inner).real @ square_root
    overdamped = Building(building.numerical, building.specimen, 0.0, building.M, critical, building.K)
    record = noise(2.0, 0.005)
    A, B = sim.state_equation(overdamped.M, overdamped.C, overdamped.K)
    assert sim.modal_states(A, B, 0.005, record) is None
    found = series_of(simulate(overdamped, 0.005, record))
    assert relative_difference(found, by_lsim(overdamped, 0.005, record)) < 1e-9


def test_overdamped_building_has_real_modes_and_still_agrees() -> None:
    base = random_building(4)
    building = Building(base.numerical, base.specimen, 0.0, base.M, 60 * base.C, base.K)
    A, B = sim.state_equation(building.M, building.C, building.K)
    record = noise(2.0, 0.005)
    assert (np.linalg.eigvals(A).imag == 0).any()
    assert sim.modal_states(A, B, 0.005, record) is not None
    found = series_of(simulate(building, 0.005, record))
    assert relative_difference(found, by_lsim(building, 0.005, record)) < 1e-9


def test_error_estimate_sees_a_wrong_solution() -> None:
    """A frequency wrong by 1e-6 is reported as at least the error it makes."""
    building, record = paper_building(), noise(10.0, DT_S)
    A, B = sim.state_equation(building.M, building.C, building.K)
    wrong_A, _ = sim.state_equation(building.M, building.C, building.K * (1 + 2e-6))
    solved = [sim.modal_states(matrix, B, DT_S, record) for matrix in (A, wrong_A)]
    assert solved[0] is not None and solved[1] is not None
    right, wrong = solved[0][0], solved[1][0]
    peaks = np.abs(right).max(axis=1)
    actual = (np.abs(wrong - right).max(axis=1) / peaks).max()
    accel_peaks = np.abs(A[3:] @ right).max(axis=1)
    told = sim.accumulated_residual(A, B, DT_S, record, wrong, np.concatenate([peaks, accel_peaks]))
    assert actual > 1e-7
    assert actual <= told < 1e-2


def test_zero_record_and_single_sample_stay_at_rest() -> None:
    for record in (np.zeros(10), [0.3]):
        response = simulate(paper_building(), DT_S, record)
        assert not series_of(response).any()
        assert response.error_estimate == 0.0


@pytest.mark.parametrize(
    ("dt_s", "record", "words"),
    [
        (0.0, [1.0, 2.0], "dt_s is 0 s"),
        (math.nan, [1.0, 2.0], "dt_s is nan s"),
        (0.01, [1.0, math.nan], r"ground_accel_m_s2\[1\] is nan"),
        (0.01, [[1.0, 2.0]], r"shape \(1, 2\)"),
        (0.01, [], r"shape \(0,\)"),
    ],
)
def test_bad_input_is_named(dt_s: float, record: list, words: str) -> None:
    with pytest.raises(InputError, match=words):
        simulate(paper_building(), dt_s, record)


def test_all_faults_come_at_once() -> None:
    with pytest.raises(InputError) as raised:
        simulate(paper_building(), -1.0, [math.inf])
    assert len(raised.value.faults) == 2


def test_a_response_that_would_be_too_large_is_refused_with_the_rate_that_is_not() -> None:
    with pytest.raises(
        InputError, match=r"^sample_rate_hz: 2000 Hz makes 4000000 samples of 3 storeys, .* to 1.83e\+03 Hz"
    ):
        simulate(paper_building(), DT_S, np.zeros(4_000_000))


def fixed_to_the_ground(building: Building, record: np.ndarray) -> np.ndarray:
    """Return the absolute accelerations (2, n) of the specimen's floors on the ground, by scipy."""
    masses = building.specimen.masses_kg
    C, K = (matrix / masses[:, None] for matrix in (building.specimen.C, building.specimen.K))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -C]])
    B = np.array([[0.0], [0.0], [-1.0], [-1.0]])
    _, alone, _ = lsim((A, B, A[2:], np.zeros((2, 1))), record, DT_S * np.arange(len(record)))
    return np.asarray(alone.T)


def test_stiff_and_locked_storeys_keep_the_digits_of_the_others() -> None:
    """A dashpot of 1e9 N s/m on 40 g holds floor 1 to the ground: the others answer as on the ground, by scipy."""
    building, record = paper_building(), noise(5.0, DT_S) * np.minimum(np.arange(round(5.0 / DT_S)) / 100.0, 1.0)
    numerical = Numerical(np.array([0.04]), np.array([[7e3]]), np.array([[1e9]]))
    stiff = Building(numerical, building.specimen, 0.0, *assemble(numerical, building.specimen, 0.0))
    found = simulate(stiff, DT_S, record)
    alone = fixed_to_the_ground(building, record)
    assert relative_difference(found.abs_accel_m_s2, np.vstack([record, alone])) < 3e-6  # 10 N move the floor


def test_a_stiff_storey_leaves_the_modes_of_the_others() -> None:
    """1e15 N/m under floor 1: displacements and velocities are so unlike that only balanced units show three modes."""
    building, record = paper_building(), noise(5.0, DT_S) * np.minimum(np.arange(round(5.0 / DT_S)) / 100.0, 1.0)
    numerical = Numerical(np.array([6.93]), np.array([[1e15]]), np.array([[50.0]]))
    A, B = sim.state_equation(*assemble(numerical, building.specimen, 0.0))
    assert np.linalg.cond(np.linalg.eig(A)[1]) > 1e6
    found = sim.modal_states(A, B, DT_S, record)
    assert found is not None
    assert relative_difference(found[1][1:], fixed_to_the_ground(building, record)) < 1e-9


def test_storeys_too_unlike_for_double_precision_are_refused() -> None:
    numerical = Numerical(np.array([1e7, 1e-9]), storey_matrix([1e-6, 1e12]), storey_matrix([0.0, 0.0]))
    specimen = Specimen(np.array([1e-9]), np.array([[1e12]]), np.array([[0.0]]))
    with pytest.raises(InputError, match=r"^SIM: "):
        simulate(Building(numerical, specimen, 0.0, *assemble(numerical, specimen, 0.0)), DT_S, noise(2.0, DT_S))
