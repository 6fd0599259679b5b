"""Oracles: the table of the paper's notes, closed forms of chains, Eq. 2.2 to 2.6 written out, a search."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.structure import (
    Numerical,
    Specimen,
    assemble,
    build,
    modal_damping_matrix,
    modes,
    stiffness_from_frequencies,
    storey_matrix,
    storey_values,
)


def paper_structure(storeys: int = 1, interface_mass_kg: float = 0.0, **experimental: object) -> SimpleNamespace:
    stated = {
        "masses_kg": [6.91, 6.95],
        "natural_frequencies_hz": [3.2, 8.4],
        "stiffness_n_per_m": None,
        "damping_ratios": [0.043, 0.039],
        "dashpots_n_s_per_m": None,
    }
    return SimpleNamespace(
        numerical=SimpleNamespace(masses_kg=[6.93] * storeys, stiffness_n_per_m="mean_of_experimental"),
        experimental=SimpleNamespace(**(stated | experimental)),
        interface_experimental_mass_kg=interface_mass_kg,
    )


def target(ratio: float) -> SimpleNamespace:
    return SimpleNamespace(first_mode_ratio=ratio, dashpots_n_s_per_m=None)


def dashpots(*values: float) -> SimpleNamespace:
    return SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=list(values))


def test_paper_specimen_has_both_stiffness_sets_of_the_notes() -> None:
    found = stiffness_from_frequencies([6.91, 6.95], [3.2, 8.4])
    assert found == pytest.approx(np.array([[7331.56, 7376.40], [14710.35, 3676.36]]), abs=0.005)


def test_taken_set_is_named_with_the_other() -> None:
    (note,) = build(paper_structure(), target(0.026)).notes
    assert "(7331.6, 7376.4) N/m is used, not (14710, 3676.4)" in note


@pytest.mark.parametrize(
    ("stiffness", "frequencies"),
    [((7331.56, 7376.40), (2.306, 6.467, 9.345)), ((14710.35, 3676.36), (2.51, 5.40, 11.52))],
)
def test_total_structure_has_the_frequencies_of_the_notes(
    stiffness: tuple[float, float], frequencies: tuple[float, ...]
) -> None:
    spec = paper_structure(natural_frequencies_hz=None, stiffness_n_per_m=stiffness)
    total = build(spec, dashpots(0.0))
    undamped, _ = modes(total.M, 0.0 * total.C, total.K)
    assert undamped == pytest.approx(frequencies, abs=0.006 if stiffness[0] > 1e4 else 0.0006)


@pytest.mark.parametrize(
    ("first", "c1", "ratios"),
    [(0.026, 22.163, (0.026, 0.066, 0.056)), (0.036, 40.884, (0.036, 0.085, 0.064))],
)
def test_first_mode_target_gives_the_dashpot_of_the_notes(first: float, c1: float, ratios: tuple[float, ...]) -> None:
    building = build(paper_structure(), target(first))
    assert building.numerical.C[0, 0] == pytest.approx(c1, abs=0.0005)
    _, found = modes(building.M, building.C, building.K)
    assert found[0] == pytest.approx(first, abs=1e-9)
    assert found == pytest.approx(ratios, abs=0.0005)


def test_total_is_equation_2_2_with_part_of_the_interface_mass_on_the_table() -> None:
    c1, c2, c3, k1, k2, k3 = 3.0, 5.0, 7.0, 1100.0, 1300.0, 1700.0
    spec = paper_structure(
        interface_mass_kg=1.5,
        natural_frequencies_hz=None,
        stiffness_n_per_m=[k2, k3],
        damping_ratios=None,
        dashpots_n_s_per_m=[c2, c3],
    )
    spec.numerical.stiffness_n_per_m = [k1]
    building = build(spec, dashpots(c1))
    assert building.numerical.masses_kg == pytest.approx([6.93 - 1.5])
    np.testing.assert_allclose(building.M, np.diag([6.93, 6.91, 6.95]), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        building.C, np.array([[c1 + c2, -c2, 0], [-c2, c2 + c3, -c3], [0, -c3, c3]]), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(
        building.K, np.array([[k1 + k2, -k2, 0], [-k2, k2 + k3, -k3], [0, -k3, k3]]), rtol=1e-12, atol=1e-12
    )


def test_substructures_coupled_by_equation_2_6_move_as_the_total() -> None:
    rng = np.random.default_rng(3)
    p, n, m_interface, a_ground = 3, 2, 0.7, 1.3
    numerical = Numerical(rng.uniform(1, 5, p), storey_matrix([9.0, 8.0, 7.0]), storey_matrix([0.3, 0.2, 0.4]))
    masses, K = rng.uniform(1, 5, n), storey_matrix([6.0, 5.0])
    specimen = Specimen(masses, K, modal_damping_matrix(masses, K, [0.04, 0.03]))
    M, C, K_total = assemble(numerical, specimen, m_interface)
    x, v = rng.normal(size=(2, p + n))
    a = np.linalg.solve(M, -C @ v - K_total @ x) - a_ground
    absolute = a + a_ground
    force = -m_interface * absolute[p - 1] - masses @ absolute[p:]
    left = numerical.masses_kg * a[:p] + numerical.C @ v[:p] + numerical.K @ x[:p]
    assert left == pytest.approx(-numerical.masses_kg * a_ground + force * np.array([0, 0, 1.0]))
    hat_x, hat_v = x[p:] - x[p - 1], v[p:] - v[p - 1]
    assert masses * absolute[p:] == pytest.approx(-specimen.C @ hat_v - specimen.K @ hat_x)


def test_static_push_at_the_roof_arrives_at_the_interface_with_its_sign() -> None:
    building = build(paper_structure(storeys=2), dashpots(1.0, 1.0))
    push = 10.0
    x = np.linalg.solve(building.K, [0, 0, 0, push])
    base_shear = (building.specimen.K @ (x[2:] - x[1])).sum()
    springs = np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)])
    assert base_shear == pytest.approx(push)
    assert x == pytest.approx(push * np.cumsum(1.0 / springs))


def test_numerical_storeys_take_the_mean_of_the_experimental() -> None:
    building = build(paper_structure(storeys=3), dashpots(1.0, 2.0, 3.0))
    assert storey_values(building.numerical.K) == pytest.approx([(7331.56 + 7376.40) / 2] * 3, abs=0.01)
    assert storey_values(building.numerical.C) == pytest.approx([1.0, 2.0, 3.0])


def test_two_storey_solutions_are_the_roots_of_the_quadratic() -> None:
    m1, m2, f = 3.0, 2.0, np.array([1.0, 3.5])
    trace, product = ((2 * np.pi * f) ** 2).sum(), ((2 * np.pi * f) ** 2).prod() * m1 * m2
    k2 = np.roots([1 / m1 + 1 / m2, -trace, product / m1])
    expected = np.column_stack([product / k2, k2])
    found = stiffness_from_frequencies([m1, m2], f)
    assert found[np.argsort(found[:, 1])] == pytest.approx(expected[np.argsort(k2)], rel=1e-10)


@pytest.mark.campaign
@pytest.mark.parametrize("n", [1, 3, 4, 5])
def test_known_stiffness_is_recovered_and_every_set_has_the_frequencies(n: int) -> None:
    rng = np.random.default_rng(n)
    masses, stiffness = rng.uniform(2, 9, n), rng.uniform(1e3, 2e4, n)
    frequencies = np.sqrt(np.sort(np.linalg.eigvals(storey_matrix(stiffness) / masses[:, None]).real)) / (2 * np.pi)
    found = stiffness_from_frequencies(masses, frequencies)
    assert min(np.abs(found / stiffness - 1).max(axis=1)) < 1e-9
    for solution in found:
        eigenvalues = np.sort(np.linalg.eigvals(storey_matrix(solution) / masses[:, None]).real)
        assert np.sqrt(eigenvalues) / (2 * np.pi) == pytest.approx(frequencies, rel=1e-9)
    spread = found.std(axis=1) / found.mean(axis=1)
    assert np.all(np.diff(spread) >= 0)


def test_a_search_from_many_starts_reaches_the_same_six_three_storey_sets() -> None:
    from scipy.optimize import root

    masses, frequencies = np.array([7.0, 5.0, 6.0]), np.array([1.7, 5.4, 11.4])
    found = stiffness_from_frequencies(masses, frequencies)

    def residual(log_k: np.ndarray) -> np.ndarray:
        matrix = storey_matrix(np.exp(log_k)) / np.sqrt(np.outer(masses, masses))
        return np.log(np.linalg.eigvalsh(matrix)) - 2 * np.log(2 * np.pi * frequencies)

    rng = np.random.default_rng(0)
    reached: set[int] = set()
    for start in rng.uniform(np.log(500), np.log(5e4), (80, 3)):
        result = root(residual, start)
        if np.abs(result.fun).max() < 1e-9:
            distance = np.abs(found / np.exp(result.x) - 1).max(axis=1)
            assert distance.min() < 1e-6
            reached.add(int(distance.argmin()))
    assert reached == set(range(len(found)))
    assert len(found) == 6


@pytest.mark.parametrize(
    ("masses", "frequencies", "words"),
    [
        ([7.0, 7.0], [3.2, 3.3], "no positive storey stiffnesses give 3.2, 3.3 Hz"),
        ([7.0, 7.0], [8.4, 3.2], "positive frequencies that ascend"),
        ([7.0] * 6, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "experimental.stiffness_n_per_m"),
    ],
)
def test_frequencies_without_an_answer_are_refused(masses: list[float], frequencies: list[float], words: str) -> None:
    with pytest.raises(InputError) as caught:
        stiffness_from_frequencies(masses, frequencies)
    assert len(caught.value.faults) == 1
    assert words in str(caught.value)


def test_modal_damping_gives_the_stated_ratios_and_keeps_the_frequencies() -> None:
    masses, K, ratios = np.array([3.0, 4.0, 2.0]), storey_matrix([900.0, 1500.0, 700.0]), [0.05, 0.01, 0.08]
    frequency, ratio = modes(np.diag(masses), modal_damping_matrix(masses, K, ratios), K)
    assert ratio == pytest.approx(ratios, rel=1e-9)
    assert frequency == pytest.approx(np.sqrt(np.sort(np.linalg.eigvals(K / masses[:, None]).real)) / (2 * np.pi))


def test_modes_of_a_hundred_equal_storeys_match_the_closed_form() -> None:
    n, m, k = 100, 2e5, 3e8
    frequency, ratio = modes(m * np.eye(n), np.zeros((n, n)), storey_matrix([k] * n))
    j = np.arange(1, n + 1)
    expected = 2 * np.sqrt(k / m) * np.sin((2 * j - 1) * np.pi / (2 * (2 * n + 1))) / (2 * np.pi)
    assert frequency == pytest.approx(expected, rel=1e-9)
    assert np.abs(ratio).max() < 1e-9


@pytest.mark.parametrize("zeta", [0.0, 0.3, 1.7])
def test_one_storey_modes_match_the_closed_form_also_overdamped(zeta: float) -> None:
    m, k = 2.0, 800.0
    frequency, ratio = modes(np.array([[m]]), np.array([[2 * zeta * np.sqrt(k * m)]]), np.array([[k]]))
    assert frequency == pytest.approx([20.0 / (2 * np.pi)])
    assert ratio == pytest.approx([zeta], abs=1e-12)


def test_first_mode_out_of_reach_names_the_range_and_the_range_holds() -> None:
    with pytest.raises(InputError, match=r"cannot give 0.5, only 0.0142 to 0.2383") as caught:
        build(paper_structure(), target(0.5))
    assert "dashpots_n_s_per_m" in str(caught.value)
    with pytest.raises(InputError, match=r"only 0.0142 to 0.2383"):
        build(paper_structure(), target(0.01))
    building = build(paper_structure(), target(0.2383))
    assert modes(building.M, building.C, building.K)[1][0] == pytest.approx(0.2383, abs=1e-9)


def test_every_wrong_list_is_named_at_once() -> None:
    spec = paper_structure(storeys=2, interface_mass_kg=6.93, damping_ratios=[0.04])
    spec.numerical.stiffness_n_per_m = [7000.0]
    with pytest.raises(InputError) as caught:
        build(spec, dashpots(1.0, 2.0, 3.0))
    fields = [fault.split(":")[0] for fault in caught.value.faults]
    assert fields == [
        "structure.numerical.stiffness_n_per_m",
        "structure.experimental.damping_ratios",
        "damping.dashpots_n_s_per_m",
        "structure.interface_experimental_mass_kg",
    ]


@pytest.mark.parametrize(
    ("experimental", "damping", "sentence"),
    [
        (
            {"masses_kg": [7.0, 1e-20]},
            {},
            "structure.experimental.masses_kg: 1e-20 kg must be at least 1e-09 kg; raise it",
        ),
        (
            {"masses_kg": [7.0, 1e-9], "stiffness_n_per_m": [7e3, 1e14]},
            {},
            "structure.experimental: floor 2 of 1e-09 kg",
        ),
        ({"stiffness_n_per_m": [7e3, 1e-12]}, {}, "storey 2 of 1e-12 N/m lets a mass of 7 kg move at 3.8e-07 1/s, the"),
        (
            {"dashpots_n_s_per_m": [1.0, 1e13]},
            {},
            "structure.experimental: floor 1 of 7 kg moves at 1.4e+12 1/s on its ",
        ),
        ({}, {"dashpots_n_s_per_m": [1e13]}, "damping: floor 1 of 7 kg moves at 1.4e+12 1/s on its dashpots_n_s_per_m"),
    ],
)
def test_floors_too_light_for_their_springs_are_named(
    experimental: dict[str, object], damping: dict[str, object], sentence: str
) -> None:
    own = {"masses_kg": [7.0, 7.0], "natural_frequencies_hz": None, "stiffness_n_per_m": [7e3, 7e3],
           "damping_ratios": None, "dashpots_n_s_per_m": [8.0, 8.0]}  # fmt: skip
    spec = SimpleNamespace(
        numerical=SimpleNamespace(masses_kg=[7.0], stiffness_n_per_m=[7e3]),
        experimental=SimpleNamespace(**(own | experimental)),
        interface_experimental_mass_kg=0.0,
    )
    level = SimpleNamespace(**({"first_mode_ratio": None, "dashpots_n_s_per_m": [20.0]} | damping))
    with pytest.raises(InputError, match=re.escape(sentence)):
        build(spec, level)


@pytest.mark.parametrize(
    ("masses", "frequencies", "sentence"),
    [
        ([7.0, 7.0], [1e-300, 1e3], "1e-300 Hz must be at least 1e-06 Hz"),
        ([7.0, 7.0], [1e-3, 1e3], "frequencies of 0.001 and 1000 are more than 10000 times apart"),
        ([1e-9, 7.0], [3.0, 8.0], "masses of 1e-09 and 7 are more than 1e+08 times apart"),
    ],
)
def test_values_too_far_apart_have_no_stiffnesses_that_can_be_found(
    masses: list[float], frequencies: list[float], sentence: str
) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        stiffness_from_frequencies(masses, frequencies)


def test_modes_lost_in_the_rounding_of_the_largest_one_leave_finite_damping() -> None:
    """A fit that went astray may give such a chain; the eigenvalues of its soft storeys are rounding, of any sign."""
    stiffness = [30.0, 1.8e3, 390.0, 2.1e3, 2.1e3, 230.0, 6.7e20]
    masses = np.linspace(1.2, 2.9, 7)
    chains = [storey_matrix(np.roll(stiffness, k)) for k in range(7)]
    assert all(np.isfinite(modal_damping_matrix(masses, K, [0.02] * 7)).all() for K in chains)
