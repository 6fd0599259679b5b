"""Numerical substructures by their matrices: equal to chains, right for frames, honest about what is wrong."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from beam_frames import plane_frame
from scipy.io import mmwrite, savemat
from scipy.linalg import eigh, expm
from scipy.sparse import csc_matrix, save_npz

from rths_cli.analysis.closed_loop import critical_delay
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.case.structure_schema import DampingSpec, StructureSpec
from rths_cli.control.numerical_substructure import interface
from rths_cli.errors import InputError
from rths_cli.structure import build, frame_of, storey_matrix, with_masses
from rths_cli.structure.unit_comparisons import of_building

SILVA_K = np.array(
    [[26054883.879604, -23133938.877108, 5937035.463339],
     [-23133938.877108, 32560774.186380, -14419970.777237],
     [5937035.463339, -14419970.777237, 9267275.506224]]
)  # fmt: skip
ON_TABLE = {"masses_kg": (6.91, 6.95), "stiffness_n_per_m": (7332.0, 7376.0), "damping_ratios": (0.043, 0.039)}
RECORD = np.random.default_rng(1).standard_normal(1500)
DT_S = 1.0 / 1000.0


def spec(folder: Path, M, K, at: int, mass_kg: float = 0.0, **more) -> StructureSpec:
    """Write matrices to files and return the structure with them, `at` counted from 0."""
    for name, values in (("M", M), ("K", K)):
        np.savetxt(folder / f"{name}.csv", values, delimiter=",", fmt="%.17g")
    matrices = {"mass": {"file": folder / "M.csv"}, "stiffness": {"file": folder / "K.csv"}, "interface": at + 1}
    return StructureSpec.model_validate(
        {
            "numerical": {"matrices": matrices | more},
            "experimental": ON_TABLE,
            "interface_experimental_mass_kg": mass_kg,
        }
    )


def damped(**level) -> DampingSpec:
    return DampingSpec.model_validate(level)


def with_influence(folder: Path, influence) -> dict:
    np.savetxt(folder / "r.csv", influence)
    return {"influence": {"file": folder / "r.csv"}}


def test_a_chain_by_its_matrices_is_the_chain(tmp_path):
    order = np.array([2, 0, 1])  # the interface, storey 3, first
    masses, k, c = np.array([7.0, 6.5, 6.0]), [7354.0, 7000.0, 6800.0], [20.0, 15.0, 10.0]
    chain = StructureSpec.model_validate(
        {
            "numerical": {"masses_kg": tuple(masses), "stiffness_n_per_m": tuple(k)},
            "experimental": ON_TABLE,
            "interface_experimental_mass_kg": 1.0,
        }
    )
    wanted = build(chain, damped(dashpots_n_s_per_m=tuple(c)))
    mixed = np.ix_(order, order)
    np.savetxt(tmp_path / "C.csv", storey_matrix(c)[mixed], fmt="%.17g")
    frame = spec(tmp_path, np.diag(masses)[mixed], storey_matrix(k)[mixed], 0, 1.0)
    found = build(frame, damped(matrix={"file": tmp_path / "C.csv"}))
    assert found.numerical.dofs.tolist() == [2, 3, 1]
    assert critical_delay(found).delay_s == pytest.approx(critical_delay(wanted).delay_s, rel=1e-11)
    for solve in (simulate, lambda *given: simulate_delayed(*given, 0.003)):
        own, chains = solve(found, DT_S, RECORD), solve(wanted, DT_S, RECORD)
        for name in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2"):
            series, other = getattr(own, name), getattr(chains, name)
            assert np.abs(series - other).max() <= 1e-12 * np.abs(other).max(), name
    for scheme in ("exact", "cr", "newmark"):
        blocks = [interface(one.numerical, DT_S, scheme).response(np.array([1.0, 9.0])) for one in (found, wanted)]
        assert np.allclose(*blocks, rtol=1e-11, atol=0.0)


@pytest.mark.parametrize("write", ["csv", "mtx", "mat", "sparse_mat", "npz", "sparse_npz"])
def test_the_benchmark_frame_from_every_format(tmp_path, write):
    M = 1000.0 * np.eye(3)
    both = {"M": M, "K": SILVA_K}
    whole = {"mat": lambda path: savemat(path, both), "npz": lambda path: np.savez(path, **both)}
    whole["sparse_mat"] = lambda path: savemat(path, {name: csc_matrix(one) for name, one in both.items()})
    ends = {"csv": ".csv", "mtx": ".mtx", "sparse_npz": ".npz"}
    files = {}
    for name, values in both.items():
        files[name] = {"file": tmp_path / f"{name if write in ends else 'frame'}{ends.get(write, '.' + write[-3:])}"}
        {
            "csv": lambda path, v=values: np.savetxt(path, v, delimiter=";", header="N/m"),
            "mtx": lambda path, v=values: mmwrite(path, csc_matrix(v), symmetry="symmetric", precision=17),
            "sparse_npz": lambda path, v=values: save_npz(path, csc_matrix(v)),
        }.get(write, whole.get(write))(files[name]["file"])
    matrices = {"mass": files["M"], "stiffness": files["K"], "interface": 3}
    structure = StructureSpec.model_validate({"numerical": {"matrices": matrices}, "experimental": ON_TABLE})
    frame = frame_of(structure.numerical.matrices)
    assert frame.frequency_hz == pytest.approx([3.61, 16.00, 38.09], abs=0.005)  # silva2020.md, section 1
    C = build(structure, damped(modal=0.05)).numerical.C
    stated = [14084.28, -7873.03, 440.45, 14943.62, -6348.67, 7223.10]  # the benchmark's own file, N s/m
    assert C[np.triu_indices(3)] == pytest.approx(stated, rel=1e-4)


def test_rayleigh_damping_has_its_ratio_at_both_frequencies(tmp_path):
    structure = spec(tmp_path, 1000.0 * np.eye(3), SILVA_K, 2)
    numerical = build(structure, damped(rayleigh={"ratio": 0.03, "frequencies_hz": (3.6116, 38.09)})).numerical
    squares, shapes = eigh(numerical.K, numerical.mass_matrix)
    ratios = np.diag(shapes.T @ numerical.C @ shapes) / (2.0 * np.sqrt(squares))
    assert ratios[[0, 2]] == pytest.approx([0.03, 0.03], rel=1e-3)
    assert ratios[1] < 0.025


def test_units_of_the_files(tmp_path):
    # kN and mm: kN/mm are 1e6 N/m, kN s^2/mm are 1e6 kg
    kilo = spec(tmp_path, 1e-3 * np.eye(3), 1e-6 * SILVA_K, 2,
                units={"length": "mm", "force": "kN", "mass": "consistent"})  # fmt: skip
    frame = frame_of(kilo.numerical.matrices)
    assert frame.frequency_hz[0] == pytest.approx(3.61, abs=0.005)
    assert frame.mass_kg == pytest.approx(3000.0)


def test_a_large_frame_keeps_its_modes_and_its_mass(tmp_path):
    M, K, influence, at = plane_frame(22, 2)
    assert len(M) == 201
    whole = np.sqrt(eigh(K, M, eigvals_only=True)) / (2.0 * np.pi)
    reduction = {"kind": "craig_bampton", "modes": 20}
    structure = spec(tmp_path, M, K, at, reduction=reduction, **with_influence(tmp_path, influence))
    numerical = build(structure, damped(modal=0.02)).numerical
    kept = np.sqrt(eigh(numerical.K, numerical.mass_matrix, eigvals_only=True)) / (2.0 * np.pi)
    assert len(kept) < 50
    assert kept[:20] == pytest.approx(whole[:20], rel=1e-3)
    assert numerical.ground @ numerical.inertia_kg == pytest.approx(influence @ M @ influence, rel=1e-9)
    assert numerical.dofs[-1] == at + 1
    # the coordinates are displacements of the frame: their static answer to a force on the interface is the frame's
    assert np.linalg.solve(numerical.K, np.eye(len(kept))[-1])[-1] == pytest.approx(np.linalg.inv(K)[at, at], rel=1e-9)
    again = with_masses(structure)
    assert with_masses(again).numerical.masses_kg == again.numerical.masses_kg


def test_sim_of_a_reduced_frame_takes_all_of_it(tmp_path):
    M, K, influence, at = plane_frame(6, 1)
    kept = tuple(3 * 2 * floor + 1 for floor in range(5))  # the left column's horizontal displacements
    reduction = {"kind": "craig_bampton", "modes": 2, "dofs": kept}
    structure = spec(tmp_path, M, K, at, 20.0, reduction=reduction, **with_influence(tmp_path, influence))
    building = build(structure, damped(rayleigh={"mass_1_per_s": 0.4, "stiffness_s": 2e-4}))
    found = reference_of(building).sim(building, DT_S, RECORD)
    n, total = len(M), len(M) + 2
    spread = np.zeros((2, total))
    spread[:, at], spread[:, n:] = -1.0, np.eye(2)
    whole = {"M": np.zeros((total, total)), "C": np.zeros((total, total)), "K": np.zeros((total, total))}
    for name, own in (("M", M), ("C", 0.4 * M + 2e-4 * K), ("K", K)):
        whole[name][:n, :n] = own
    whole["M"][n:, n:] = np.diag(ON_TABLE["masses_kg"])
    whole["C"] += spread.T @ building.specimen.C @ spread
    whole["K"] += spread.T @ building.specimen.K @ spread
    a = np.block([[np.zeros((total, total)), np.eye(total)],
                  [-np.linalg.solve(whole["M"], np.hstack([whole["K"], whole["C"]]))]])  # fmt: skip
    r = np.concatenate([influence, [1.0, 1.0]])
    b = np.concatenate([np.zeros(total), -r])[:, None]
    chain = np.zeros((2 * total + 2, 2 * total + 2))
    chain[:-2, :-2], chain[:-2, -2:-1], chain[-2, -1] = a * DT_S, b * DT_S, 1.0
    step, states = expm(chain), np.zeros(2 * total)
    roof = [0.0]
    for now, after in itertools.pairwise(RECORD):
        states = (step @ np.concatenate([states, [now, after - now]]))[:-2]
        roof.append(float(a[-1] @ states))
    peak = np.abs(roof).max()
    assert np.abs(found.abs_accel_m_s2[-1] - roof).max() < 1e-8 * peak
    reduced = simulate(building, DT_S, RECORD)
    assert 1e-6 * peak < np.abs(reduced.abs_accel_m_s2[-1] - roof).max() < 0.05 * peak
    assert building.numerical.dofs.tolist()[:1] == [1]


def test_degrees_of_freedom_without_mass_are_condensed_exactly(tmp_path):
    M, K, influence, at = plane_frame(3, 1, lumped=True)
    structure = spec(tmp_path, M, K, at, **with_influence(tmp_path, influence))
    frame = frame_of(structure.numerical.matrices)
    flexible = np.sort(np.linalg.eigvals(np.linalg.solve(K, M)).real)[::-1][:6]
    assert frame.frequency_hz == pytest.approx(1.0 / (2.0 * np.pi * np.sqrt(flexible)), rel=1e-9)
    assert (len(frame.dofs), len(frame.condensed.massless)) == (6, len(M) - 6)
    reduction = {"kind": "static", "dofs": (1, 7)}
    guyan = build(spec(tmp_path, M, K, at, reduction=reduction, **with_influence(tmp_path, influence)),
                  damped(modal=0.02)).numerical  # fmt: skip
    assert {1, 7, at + 1} <= set(guyan.dofs.tolist())
    # a Ritz reduction is stiffer than the frame, and near to it in the first mode
    first = np.sqrt(eigh(guyan.K, guyan.mass_matrix, eigvals_only=True)[0]) / (2.0 * np.pi)
    assert frame.frequency_hz[0] * (1.0 - 1e-9) <= first <= 1.01 * frame.frequency_hz[0]


def changed(matrix, *entries):
    found = np.array(matrix, dtype=float)
    for i, j, value in entries:
        found[i, j] = value
    return found


EYE = np.diag([5.0, 6.0, 7.0])
FAULTS = {
    "rectangular": (EYE[:2], SILVA_K, "M.csv has 2 rows and 3 columns; it must be square"),
    "other size": (np.eye(2), SILVA_K, "mass (M.csv) has 2 rows, stiffness (K.csv) 3"),
    "not symmetric": (EYE, changed(SILVA_K, (0, 2, 5e6)),
                      "K.csv is not symmetric: row 1, column 3 is 5000000, row 3, column 1 is 5937035.46"),
    "indefinite": (EYE, changed(SILVA_K, (0, 1, -4e7), (1, 0, -4e7)), "K.csv is indefinite"),
    "negative mass": (changed(EYE, (1, 1, -2.0)), SILVA_K, "M.csv, row 2, column 2: -2 is no mass"),
    "no interface mass": (changed(EYE, (2, 2, 0.0)), SILVA_K, "degree of freedom 3 has no mass (row 3 of M.csv"),
    "free body": (EYE, np.array([[1e4, -1e4, 0.0], [-1e4, 2e4, -1e4], [0.0, -1e4, 1e4]]),
                  "K.csv lets the frame move freely"),
    "nothing holds it": (EYE, changed(storey_matrix([1e4, 1e4, 1e4]), (0, 0, 0.0)), "row 1, column 1: 0 is nothing"),
    "not finite": (changed(EYE, (1, 1, np.nan)), SILVA_K, "row 2, column 2: nan is not finite"),
}  # fmt: skip


@pytest.mark.campaign
@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_is_told_by_file_and_place(tmp_path, name):
    M, K, told = FAULTS[name]
    with pytest.raises(InputError) as raised:
        build(spec(tmp_path, M, K, 2), damped(modal=0.02))
    assert told in str(raised.value), str(raised.value)


def test_all_files_are_judged_in_one_go(tmp_path):
    with pytest.raises(InputError) as raised:
        build(spec(tmp_path, EYE[:2], SILVA_K[:, :2], 2), damped(modal=0.02))
    assert len(raised.value.faults) == 2


def test_damping_that_feeds_energy_or_belongs_to_storeys_is_refused(tmp_path):
    structure = spec(tmp_path, EYE, SILVA_K, 2)
    np.savetxt(tmp_path / "C.csv", -np.eye(3))
    with pytest.raises(InputError, match="feeds energy into the frame"):
        build(structure, damped(matrix={"file": tmp_path / "C.csv"}))
    with pytest.raises(InputError, match=r"damping.first_mode_ratio: belongs to numerical storeys"):
        build(structure, damped(first_mode_ratio=0.02))
    with pytest.raises(InputError, match=r"must be less than the mass of the interface, degree of freedom 3"):
        build(spec(tmp_path, EYE, SILVA_K, 2, 7.0), damped(modal=0.02))


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_stiffness_in_another_unit_is_doubted(tmp_path, factor):
    structure = spec(tmp_path, 1000.0 * np.eye(3), factor * SILVA_K, 2)
    comparisons = of_building(structure, build(structure, damped(modal=0.02)))
    doubted = [one.key for one in comparisons if not one.low <= one.value / one.figure <= one.high]
    assert bool([key for key in doubted if "matrices" in key]) == (factor != 1.0)
