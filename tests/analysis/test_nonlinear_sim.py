"""Oracles: figures of three independent solvers, an adaptive solver, the linear SIM, the energy, changes of units."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.adaptive_storeys import adaptive
from portfolio import parametrize_first
from scipy.linalg import expm

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.sim import Response, simulate
from rths_cli.analysis.structural_response import inter_storey_drift_m
from rths_cli.case.load import load_cases
from rths_cli.case.storey_law_schema import KINDS
from rths_cli.errors import InputError
from rths_cli.experiment.setup import make_setup
from rths_cli.structure import Building, build, storey_values

GRAVITY_M_S2 = 9.80665
YIELDS = ("bilinear", "bouc_wen", "clough")  # each is the storey's own spring: one per storey
PINCHED = {"zeta_s": 0.8, "p": 1.0, "q": 0.1, "psi": 0.15, "delta_psi": 0.01, "lambda": 0.3}


def building_of(
    masses_kg: list[float], springs: list[float], dashpots: list[float], laws: list[list[dict[str, Any]]]
) -> Building:
    """Return a building with as many numerical storeys as dashpots."""
    p = len(dashpots)
    stated = [[KINDS[one["kind"]](**one) for one in many] for many in laws]
    numerical = SimpleNamespace(masses_kg=masses_kg[:p], stiffness_n_per_m=springs[:p], law=stated)
    experimental = SimpleNamespace(
        masses_kg=masses_kg[p:],
        stiffness_n_per_m=springs[p:],
        natural_frequencies_hz=None,
        damping_ratios=[0.03] * (len(masses_kg) - p),
        dashpots_n_s_per_m=None,
    )
    spec = SimpleNamespace(numerical=numerical, experimental=experimental, interface_experimental_mass_kg=0.0)
    return build(spec, SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=dashpots))


def law_of(kind: str, k: float, random: np.random.Generator) -> dict[str, Any]:
    """Return a random law in the words of a structure file."""

    def between(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    drift = between(0.002, 0.006)
    yielding = {"yield_displacement_m": drift, "hardening": between(0.0, 0.2)}
    bouc_wen = {**yielding, "exponent": float(random.choice([1.0, 1.5, 2.0])), "beta": 0.6, "gamma": 0.4}
    if random.random() < 0.6:
        bouc_wen |= {"delta_a": 0.001, "delta_nu": between(0, 0.02), "delta_eta": between(0, 0.02), **PINCHED}
    numbers: dict[str, dict[str, float]] = {
        "bilinear": yielding,
        "clough": {**yielding, "unloading_exponent": between(0.0, 0.5)},
        "friction": {
            "coefficient": between(0.01, 0.05),
            "sticking_displacement_m": between(1e-4, 1e-3),
            "radius_m": between(0.1, 0.5),
        },
        "elastic_gap": {"gap_m": drift, "contact_n_per_m": between(1, 10) * k},
        "cubic": {"cubic_n_per_m3": between(-0.1, 1) * k / drift**2, "largest_drift_m": 0.02},
        "softening": {"share": between(0.05, 0.5), "half_drift_m": drift},
        "viscous_power": {
            "coefficient": between(1, 5),
            "exponent": between(0.2, 2),
            "linear_below_m_per_s": 10 ** between(-4, -2),
        },
        "maxwell": {"spring_n_per_m": between(0.3, 3) * k, "dashpot_n_s_per_m": between(20, 200)},
        "bouc_wen": bouc_wen,
    }
    return {"kind": kind, **numbers[kind]}


class Made:
    """A random building of 2 to 5 storeys with laws of which one is of kind `seed` modulo their number."""

    def __init__(self, seed: int) -> None:
        random, kinds = np.random.default_rng(seed), [kind for kind in KINDS if kind != "own"]
        n = int(random.integers(2, 6))
        p = int(random.integers(1, n))
        self.masses, self.springs = random.uniform(5, 9, n).tolist(), random.uniform(5e3, 1e4, n).tolist()
        self.dashpots = random.uniform(2, 10, p).tolist()
        self.laws = []
        for i in range(p):
            drawn = [kinds[seed % len(kinds)]] if i == 0 else []
            drawn += [str(kind) for kind in random.permutation(kinds)[: int(random.integers(0, 3))]]
            own = [kind for kind in drawn if kind in YIELDS][:1]
            rest = [kind for kind in dict.fromkeys(drawn) if kind not in YIELDS]
            self.laws.append([law_of(kind, self.springs[i], random) for kind in own + rest])
        self.knots_s = np.arange(0.0, 1.6, 0.05)
        self.ground = 2.5 * random.normal(size=len(self.knots_s))
        self.ground[0] = 0.0
        self.building = building_of(self.masses, self.springs, self.dashpots, self.laws)

    def record(self, dt_s: float) -> np.ndarray:
        times = np.arange(round(self.knots_s[-1] / dt_s) + 1) * dt_s
        return np.interp(times, self.knots_s, self.ground)


def largest_difference(response: Response, other: Response) -> float:
    """Return the largest difference of displacements, velocities and accelerations, of their peak in each storey."""
    return max(
        of_peak(getattr(response, name), getattr(other, name))
        for name in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2")
    )


def of_peak(value: np.ndarray, reference: np.ndarray) -> float:
    return float((np.abs(value - reference).max(axis=1) / np.abs(reference).max(axis=1)).max())


PUBLISHED = {
    "{kind: bilinear, yield_displacement_m: 0.004, hardening: 0.05}": (
        [1.95440, 1.77854, 2.73134],
        [0.28703, 0.43919, 0.53972],
        [7.72057, 3.92988, 2.55646],
        (3.12793, 0.23441),
    ),
    "{kind: bouc_wen, yield_displacement_m: 0.004, hardening: 0.05}": (
        [1.74042, 1.61286, 2.31509],
        [0.23777, 0.31818, 0.38856],
        [8.43620, 3.12973, 2.16048],
        (0.38799, 0.86382),
    ),
}


@pytest.mark.parametrize("law", PUBLISHED)
def test_the_papers_building_yields_as_three_other_solvers_say(law: str) -> None:
    """Peaks and RMS of accelerations, peak drifts; displacement and work at the last sample."""
    setup = make_setup(load_cases(["el_centro_low_ff"], (f"structure.numerical.law={law}",))[0])
    record = setup.motion.accel_m_s2
    assert setup.rig.dt_s == 1 / 2000
    response = simulate_with_laws(setup.building, setup.rig.dt_s, record)
    assert response.laws is not None
    peaks, rms, drifts, (last, work) = PUBLISHED[law]
    accel, disp = response.abs_accel_m_s2, response.rel_disp_m
    assert np.abs(accel).max(axis=1) == pytest.approx(peaks, rel=1e-4)
    assert np.sqrt((accel**2).mean(axis=1)) == pytest.approx(rms, rel=1e-4)
    assert 1e3 * np.abs(inter_storey_drift_m(disp)).max(axis=1) == pytest.approx(drifts, rel=1e-4)
    assert 1e3 * disp[0, -1] == pytest.approx(last, rel=1e-4)
    spring = storey_values(setup.building.K)[0]
    assert response.laws.work_j[0, -1] + 0.5 * spring * disp[0, -1] ** 2 == pytest.approx(work, rel=1e-4)


@parametrize_first(4, "seed", range(10))
def test_random_buildings_agree_with_an_adaptive_solver(seed: int) -> None:
    made = Made(seed)
    linear = building_of(made.masses, made.springs, made.dashpots, [])
    weights = GRAVITY_M_S2 * np.cumsum(made.masses[::-1])[::-1]
    laws = [[{**law, "weight_n": weight} for law in many] for many, weight in zip(made.laws, weights, strict=False)]
    response = simulate_with_laws(made.building, 1e-3, made.record(1e-3))
    times = np.arange(0, len(made.record(1e-3)), 10) * 1e-3
    disp, vel, accel, _ = adaptive((linear.M, linear.C, linear.K), made.springs, laws, made.knots_s, made.ground, times)
    assert of_peak(response.rel_disp_m[:, ::10], disp) < 1e-7
    assert of_peak(response.rel_vel_m_s[:, ::10], vel) < 1e-7
    assert of_peak(response.abs_accel_m_s2[:, ::10], accel) < 1e-6


def with_maxwell_dampers(building: Building, dt_s: float, record: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return displacements, velocities and absolute accelerations of a building with Maxwell dampers alone: they are
    further states of a linear system, which the matrix exponential moves exactly."""
    n, laws = len(building.M), building.laws
    drifts = (np.eye(n) - np.eye(n, k=-1))[laws.storey]
    spring, dashpot = laws.numbers[:, 0], laws.numbers[:, 1]
    move = np.zeros((2 * n + len(spring) + 2,) * 2)
    u, v, s = slice(n), slice(n, 2 * n), slice(2 * n, -2)
    move[u, v] = np.eye(n)
    move[v, u], move[v, v], move[v, s] = (-np.linalg.solve(building.M, x) for x in (building.K, building.C, drifts.T))
    move[s, v], move[s, s] = spring[:, None] * drifts, -np.diag(spring / dashpot)
    move[v, -2], move[-2, -1] = -1.0, 1.0 / dt_s
    step, states = expm(dt_s * move), np.zeros((len(record), len(move)))
    for k in range(len(record) - 1):
        states[k, -2:] = record[k], record[k + 1] - record[k]
        states[k + 1] = step @ states[k]
    return states.T[u], states.T[v], move[v, :-2] @ states.T[:-2]


@pytest.mark.parametrize("first_m_s2", [0.0, 2.5])
@pytest.mark.parametrize(
    ("spring", "dashpot"), [(2e4, 5.0), (1e5, 50.0), (1e5, 200.0), (1e6, 200.0), (1e6, 50.0), (1e9, 50.0)]
)
def test_stiff_maxwell_dampers_act_from_the_first_sample_on(spring: float, dashpot: float, first_m_s2: float) -> None:
    """They relax within a sample, and at rest they have neither force nor rate."""
    made, law = Made(1), {"kind": "maxwell", "spring_n_per_m": spring, "dashpot_n_s_per_m": dashpot}
    made.ground[0] = first_m_s2
    building, record = building_of([6.0, 7.0, 8.0], [7e3, 6e3, 5e3], [5.0, 4.0], [[law], [law]]), made.record(1e-3)
    response = simulate_with_laws(building, 1e-3, record)
    disp, vel, accel = with_maxwell_dampers(building, 1e-3, record)
    assert of_peak(response.rel_disp_m, disp) < (1e-9 if spring > 1e8 else 1e-10)
    assert of_peak(response.rel_vel_m_s, vel) < 1e-8
    assert of_peak(response.abs_accel_m_s2, accel) < 1e-7


def test_clough_unloads_no_softer_than_its_secant() -> None:
    """Much hardening and a soft unloading: without that bound the force would jump at the far side."""
    made, springs = Made(1), [7e3, 6e3]
    law = {"kind": "clough", "yield_displacement_m": 0.002, "hardening": 0.5, "unloading_exponent": 0.5}
    response = simulate_with_laws(building_of([6.0, 7.0], springs, [5.0], [[law]]), 1e-3, made.record(1e-3))
    linear = building_of([6.0, 7.0], springs, [5.0], [])
    times = np.arange(0, len(made.record(1e-3)), 10) * 1e-3
    disp, _, accel, events = adaptive(
        (linear.M, linear.C, linear.K), springs, [[law]], made.knots_s, made.ground, times
    )
    assert events > 10
    assert of_peak(response.rel_disp_m[:, ::10], disp) < 1e-7
    assert of_peak(response.abs_accel_m_s2[:, ::10], accel) < 1e-6


SHARP = {"kind": "bouc_wen", "yield_displacement_m": 5e-4, "hardening": 0.05, "exponent": 20.0}


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("law", "seed"),
    [
        ({"kind": "elastic_gap", "gap_m": 0.002, "contact_n_per_m": 1e6}, 2),
        (
            {
                **SHARP,
                "beta": 0.5,
                "gamma": 0.5,
                "zeta_s": 0.9,
                "p": 1.0,
                "q": 0.1,
                "psi": 0.1,
                "delta_psi": 0.0,
                "lambda": 0.5,
            },
            1,
        ),
    ],
)
def test_forces_that_bend_within_a_coarse_sample_are_followed(law: dict[str, Any], seed: int) -> None:
    """Contact of two samples, and a pinched, sharp yielding, at 500 Hz."""
    made, springs, dt_s = Made(seed), [7e3, 6e3], 2e-3
    response = simulate_with_laws(building_of([6.0, 7.0], springs, [5.0], [[law]]), dt_s, made.record(dt_s))
    linear = building_of([6.0, 7.0], springs, [5.0], [])
    times = np.arange(0, len(made.record(dt_s)), 5) * dt_s
    disp, vel, accel, _ = adaptive((linear.M, linear.C, linear.K), springs, [[law]], made.knots_s, made.ground, times)
    assert of_peak(response.rel_disp_m[:, ::5], disp) < 1e-7
    assert of_peak(response.rel_vel_m_s[:, ::5], vel) < 1e-7
    assert of_peak(response.abs_accel_m_s2[:, ::5], accel) < 1e-6


@pytest.mark.parametrize(
    ("law", "dashpot", "peaks_m"),
    [
        ({"kind": "bilinear", "yield_displacement_m": 0.001, "hardening": 1.0}, 0.0, None),
        ({"kind": "clough", "yield_displacement_m": 0.001, "hardening": 1.0}, 0.0, None),
        ({"kind": "bouc_wen", "yield_displacement_m": 0.001, "hardening": 1.0}, 0.0, None),
        ({"kind": "bilinear", "yield_displacement_m": 0.5}, 0.0, 0.5),
        ({"kind": "clough", "yield_displacement_m": 0.5}, 0.0, 0.5),
        ({"kind": "elastic_gap", "gap_m": 0.5, "contact_n_per_m": 1e6}, 0.0, 0.5),
        ({"kind": "elastic_gap", "gap_m": 0.0, "contact_n_per_m": 0.0}, 0.0, None),
        ({"kind": "cubic", "cubic_n_per_m3": 0.0, "largest_drift_m": 0.1}, 0.0, None),
        ({"kind": "viscous_power", "coefficient": 9.0, "exponent": 1.0}, 9.0, None),
        ({"kind": "friction", "force_n": 0.0}, 0.0, None),
    ],
)
def test_limits_of_laws_are_linear(law: dict[str, Any], dashpot: float, peaks_m: float | None) -> None:
    masses, springs, record = [6.0, 7.0, 8.0], [7e3, 6e3, 5e3], Made(1).record(1e-3)
    response = simulate_with_laws(building_of(masses, springs, [5.0], [[law]]), 1e-3, record)
    linear = simulate(building_of(masses, springs, [5.0 + dashpot], []), 1e-3, record)
    assert peaks_m is None or np.abs(linear.rel_disp_m[0]).max() < peaks_m
    assert largest_difference(response, linear) < 1e-12
    assert response.laws is not None and not response.laws.force_n.any()


@pytest.mark.parametrize("seed", range(6))
def test_a_branch_that_is_left_for_less_than_a_step_is_seen(seed: int) -> None:
    """The drift turns 100 nm beyond the yield drift, mostly between two samples: so much stays."""
    made, masses, springs = Made(seed), [6.0, 7.0], [7e3, 6e3]
    linear = simulate(building_of(masses, springs, [5.0], []), 2e-3 / 256, made.record(2e-3 / 256))
    beyond, peak = 1e-7, float(np.abs(linear.rel_disp_m[0]).max())
    law = {"kind": "bilinear", "yield_displacement_m": peak - beyond, "hardening": 0.0}
    response = simulate_with_laws(building_of(masses, springs, [5.0], [[law]]), 2e-3, made.record(2e-3))
    assert response.laws is not None
    assert abs(response.laws.force_n[0, -1]) == pytest.approx(springs[0] * beyond, rel=0.03)


def power_integral(dt_s: float, power: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Integrate a power (n,) with its derivatives at the start and at the end of each interval (n - 1,)."""
    return float((dt_s * (power[1:] + power[:-1]) / 2 + dt_s**2 * (before - after) / 12).sum())


@pytest.mark.parametrize("seed", range(8))
def test_the_energy_of_the_ground_is_found_again(seed: int) -> None:
    made, dt_s = Made(seed), 5e-4
    building, record = made.building, made.record(dt_s)
    response = simulate_with_laws(building, dt_s, record)
    assert response.laws is not None
    u, v, a = response.rel_disp_m, response.rel_vel_m_s, response.abs_accel_m_s2 - record
    masses, slope = building.M.sum(axis=1), np.diff(record) / dt_s
    power, change = -masses @ v * record, -masses @ a * record
    momentum = -masses @ v
    ground = power_integral(dt_s, power, change[:-1] + slope * momentum[:-1], change[1:] + slope * momentum[1:])
    loss, loss_change = np.einsum("it,ij,jt->t", v, building.C, v), 2 * np.einsum("it,ij,jt->t", v, building.C, a)
    dashpots = power_integral(dt_s, loss, loss_change[:-1], loss_change[1:])
    kinetic, strain = v[:, -1] @ building.M @ v[:, -1] / 2, u[:, -1] @ building.K @ u[:, -1] / 2
    supplied = float((dt_s * np.abs(power)).sum())
    assert abs(ground - kinetic - strain - dashpots - response.laws.work_j[:, -1].sum()) < 1e-6 * supplied


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(8))
def test_the_rate_of_the_record_changes_nothing(seed: int) -> None:
    """The same motion of the ground, at 500 Hz and twice as often."""
    made = Made(seed)
    coarse, fine = (simulate_with_laws(made.building, dt_s, made.record(dt_s)) for dt_s in (2e-3, 1e-3))
    assert of_peak(coarse.rel_disp_m, fine.rel_disp_m[:, ::2]) < 1e-7
    assert of_peak(coarse.abs_accel_m_s2, fine.abs_accel_m_s2[:, ::2]) < 1e-6


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(8))
def test_a_mirrored_record_gives_the_mirrored_response(seed: int) -> None:
    made = Made(seed)
    record = made.record(1e-3)
    there, back = (simulate_with_laws(made.building, 1e-3, sign * record) for sign in (1.0, -1.0))
    assert of_peak(-back.rel_disp_m, there.rel_disp_m) < 1e-11
    assert there.laws is not None and back.laws is not None
    assert back.laws.work_j == pytest.approx(there.laws.work_j, abs=1e-11)


POWER_OF_MASS = ("force_n", "contact_n_per_m", "coefficient", "spring_n_per_m", "dashpot_n_s_per_m", "cubic_n_per_m3")


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(8))
def test_a_thousandfold_building_moves_alike(seed: int) -> None:
    """Masses and forces in another unit."""
    made = Made(seed)
    laws = [
        [
            {k: v * 1e3 if k in POWER_OF_MASS and law["kind"] != "friction" else v for k, v in law.items()}
            for law in many
        ]
        for many in made.laws
    ]
    masses, springs, dashpots = ((1e3 * np.array(x)).tolist() for x in (made.masses, made.springs, made.dashpots))
    large = building_of(masses, springs, dashpots, laws)
    record = made.record(1e-3)
    there, here = (simulate_with_laws(one, 1e-3, record) for one in (large, made.building))
    assert of_peak(there.rel_disp_m, here.rel_disp_m) < 1e-10


def test_ten_storeys_of_which_most_are_stiff() -> None:
    """The first mode at 1 Hz, the others beyond 100 Hz: a base that yields below a stiff building."""
    masses, stiff = [6.0] * 10, 4e7
    springs = [60.0 * (2 * np.pi) ** 2] + [stiff] * 9
    gaps = [[{"kind": "elastic_gap", "gap_m": 1e-7, "contact_n_per_m": 1e7}] for _ in range(8)]
    laws = [[{"kind": "bilinear", "yield_displacement_m": 0.01, "hardening": 0.1}], *gaps]
    building, made = building_of(masses, springs, [20.0] + [2e3] * 8, laws), Made(2)
    coarse, fine = (simulate_with_laws(building, dt_s, made.record(dt_s)) for dt_s in (1e-3, 2.5e-4))
    assert np.abs(coarse.rel_disp_m[0]).max() > 0.01
    assert fine.laws is not None and (np.abs(fine.laws.force_n).max(axis=1)[:9] > 0.0).all()
    assert of_peak(coarse.rel_disp_m, fine.rel_disp_m[:, ::4]) < 1e-6


def test_laws_of_a_file_reach_the_storey_they_stand_at(tmp_path: Path) -> None:
    """Laws of the second storey only, a list of two in parallel."""
    (tmp_path / "own.yaml").write_text(
        "numerical:\n  masses_kg: [6, 7]\n  stiffness_n_per_m: [7000, 6000]\n"
        "  law: [null, [{kind: maxwell, spring_n_per_m: 1000, dashpot_n_s_per_m: 50}, "
        "{kind: elastic_gap, gap_m: 0, contact_n_per_m: 500}]]\n"
        "experimental: {masses_kg: [8], stiffness_n_per_m: [5000], damping_ratios: [0.03]}\n"
        "damping_levels: {low: {dashpots_n_s_per_m: [5, 5]}}\n"
    )
    (tmp_path / "a.yaml").write_text("structure: own\ndamping: low\nrecord: el_centro\nscaling: 0.3\ncontroller: FF\n")
    laws = make_setup(load_cases([tmp_path / "a.yaml"])[0]).building.laws
    assert laws.storey.tolist() == [1, 1] and laws.numbers[:, :2].tolist() == [[1000.0, 50.0], [500.0, 0.0]]


def test_a_storey_that_collapses_is_told_so() -> None:
    """Two laws of one storey leave together what they leave."""
    made, law = Made(1), {"kind": "cubic", "cubic_n_per_m3": -5e8, "largest_drift_m": 0.05}
    building = building_of([6.0, 7.0], [7e3, 6e3], [5.0], [[law, law]])
    with pytest.raises(InputError, match=r"storey 1 collapses .* no stiffness beyond a drift of 0\.001528 m;"):
        simulate_with_laws(building, 1e-3, made.record(1e-3))
