"""A specimen attached to the interface floor, which an actuator moves: matrices, SIM, critical delay, faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.linalg import expm

from rths_cli.analysis.closed_loop import critical_delay
from rths_cli.analysis.references import reference_of
from rths_cli.benchmark.displacement import DisplacementBenchmark, critical_delay_s
from rths_cli.case.load import load_benchmark
from rths_cli.case.shipped_files import shipped
from rths_cli.case.structure_schema import StructureSpec
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.structure import Building, Numerical, Specimen, assemble, build

SPRING = {
    "numerical": {"masses_kg": (900.0, 700.0), "stiffness_n_per_m": (2e5, 1.5e5)},
    "experimental": {
        "kind": "attached", "masses_kg": (30.0,), "stiffness_n_per_m": (9e4,), "dashpots_n_s_per_m": (400.0,)
    },
}  # fmt: skip


def _building(**changes: Any) -> Building:
    spec = StructureSpec.model_validate({**SPRING, **changes})
    level = {"name": "d", "first_mode_ratio": None, "dashpots_n_s_per_m": (300.0, 200.0)}
    return build(spec, type("Level", (), level)())


def test_it_adds_to_the_matrices_what_is_attached_and_no_storey() -> None:
    found = _building()
    assert found.storeys == 2
    assert found.M.tolist() == [[900.0, 0.0], [0.0, 700.0]]  # the interface floor's mass is whole, 30 kg of it attached
    assert found.numerical.masses_kg.tolist() == [900.0, 670.0]
    assert found.K.tolist() == [[3.5e5, -1.5e5], [-1.5e5, 2.4e5]]
    assert found.C.tolist() == [[500.0, -200.0], [-200.0, 600.0]]


def test_sim_is_the_whole_structure_and_its_force_that_of_the_numerical_part() -> None:
    """Against scipy's expm with a first-order hold, and the force by equilibrium of the numerical floors alone."""
    building, dt_s = _building(), 1e-3
    ground = np.cumsum(np.random.default_rng(4).standard_normal(600)) * 0.1
    a = np.zeros((7, 7))
    inverse = np.diag([1 / 900.0, 1 / 700.0])
    a[:2, 2:4], a[2:4, :2], a[2:4, 2:4] = np.eye(2), -inverse @ building.K, -inverse @ building.C
    a[2:4, 4], a[4, 5] = -1.0, 1.0  # ground acceleration and its slope
    step, state, rows = expm(a * dt_s), np.zeros(7), []
    for k, now in enumerate(ground):
        state[4], state[5] = now, (ground[min(k + 1, 599)] - now) / dt_s
        rows.append(np.concatenate([state[:4], (a @ state)[2:4] + now]))
        state = step @ state
    exact = np.array(rows).T
    sim = reference_of(building).sim(building, dt_s, ground)
    for mine, other in ((sim.rel_disp_m, exact[:2]), (sim.rel_vel_m_s, exact[2:4]), (sim.abs_accel_m_s2, exact[4:])):
        assert np.abs(mine - other).max() < 1e-9 * np.abs(other).max()
    own = building.numerical
    force = own.masses_kg[1] * exact[5] + own.C[1] @ exact[2:4] + own.K[1] @ exact[:2]
    assert np.abs(sim.base_shear_n - force).max() < 1e-8 * np.abs(force).max()


def test_critical_delays_are_those_of_the_published_benchmark() -> None:
    """The benchmark searches on a grid, this takes the eigenvalues of a Hamiltonian."""
    spec = load_benchmark(shipped("benchmarks") / "silva2020.yaml")
    bench = DisplacementBenchmark(spec, read_accelerogram(shipped("records") / "el_centro.csv"))
    order, delays = [2, 1, 0], []  # the interface is the last coordinate here, and the first one there
    for case in spec.cases:
        M, C, K = (matrix[np.ix_(order, order)] for matrix in bench.matrices(case).numerical)
        numerical = Numerical(np.diag(M).copy(), K, C)
        mass, damping, stiffness = bench.specimen
        specimen = Specimen(np.array([mass]), np.array([[stiffness]]), np.array([[damping]]), attached=True)
        whole = Building(numerical, specimen, mass, *assemble(numerical, specimen, mass))
        delays.append(1e3 * critical_delay(whole).delay_s)
        assert delays[-1] == pytest.approx(1e3 * critical_delay_s(bench, case), abs=1e-5)
    assert delays == pytest.approx([14.640, 12.223, 9.919, 8.725], abs=1e-3)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"interface_experimental_mass_kg": 3.0}, "belongs to a table"),
        ({"experimental": {**SPRING["experimental"], "masses_kg": (700.0,)}}, "must be < the interface"),
        ({"experimental": {"kind": "attached", "stiffness_n_per_m": (1.0,), "damping_ratios": (0.1,)}}, "needs a mass"),
        ({"experimental": {**SPRING["experimental"], "stiffness_n_per_m": (1.0, 2.0)}}, "one entry per storey"),
        ({"experimental": {**SPRING["experimental"], "kind": "hanging"}}, "attached"),
        ({"numerical": {**SPRING["numerical"], "stiffness_n_per_m": "mean_of_experimental"}}, "is no storey"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        StructureSpec.model_validate({**SPRING, **changes})
