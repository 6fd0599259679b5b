"""The specimen's fit: motions integrated in time by scipy give the stiffnesses and ratios back."""

from __future__ import annotations

import numpy as np
import pytest
from made_records import make_specimen
from portfolio import parametrize_first
from scipy import signal

from rths_cli.errors import InputError
from rths_cli.identification import specimen_fit as room
from rths_cli.identification.results import SpecimenFit
from rths_cli.identification.specimen_fit import Motion, Start, alive, birge, fit_specimen, fit_stretches, stretches_of
from rths_cli.structure import Specimen, modes, storey_values

DT = 1e-3
TIME = np.arange(60000) * DT


def table_motion(seed: int = 0) -> np.ndarray:
    """Return noise below 40 Hz, 2 m/s^2 rms, that starts and ends in full motion."""
    sections = signal.butter(6, [0.5, 40.0], "band", fs=1.0 / DT, output="sos")
    motion = signal.sosfilt(sections, np.random.default_rng(seed).standard_normal(len(TIME) + 20000))[20000:]
    return 2.0 * motion / motion.std()


def floors(specimen: Specimen, table: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return the floors' absolute accelerations (n, samples), the table's taken as straight lines."""
    n, inverse = len(specimen.masses_kg), 1.0 / specimen.masses_kg[:, None]
    lower = np.hstack([-inverse * specimen.K, -inverse * specimen.C])
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])
    b = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
    time = np.arange(len(table)) * DT
    return signal.lsim((a, b, lower, np.zeros((n, 1))), table, time, start)[1].reshape(len(table), n).T


def fitted(specimen: Specimen, table: np.ndarray, moved: np.ndarray) -> SpecimenFit:
    """Fit from a start that is a few per cent off in stiffness and far off in damping."""
    first = Start(storey_values(specimen.K) * 1.03, np.full(len(specimen.masses_kg), 0.02))
    return fit_specimen([Motion(table, moved)], DT, specimen.masses_kg, 0.5, first)


@pytest.mark.campaign
@parametrize_first(
    2,
    ("stiffness", "ratios"),
    [
        ((7331.56, 7376.40), (0.043, 0.039)),
        ((14710.35, 3676.36), (0.043, 0.039)),
        ((7331.56, 7376.40), (0.003, 0.1)),
        ((6000.0,), (0.02,)),
        ((7000.0, 7600.0, 7200.0), (0.03, 0.01, 0.05)),
    ],
)
def test_stiffness_and_damping_come_back(stiffness: tuple[float, ...], ratios: tuple[float, ...]) -> None:
    specimen = make_specimen(stiffness, ratios)
    table = table_motion()
    found = fitted(specimen, table, floors(specimen, table))
    hz, zeta = modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)
    assert found.stiffness_n_per_m == pytest.approx(stiffness, rel=5e-4)
    assert found.natural_frequency_hz == pytest.approx(hz, rel=2e-4)
    assert found.damping_ratio == pytest.approx(zeta, rel=0.01)
    assert pytest.approx(specimen.K, rel=5e-4) == found.specimen.K
    assert found.residual < 2e-4


def test_mode_shapes_are_the_eigenvectors() -> None:
    specimen = make_specimen()
    table = table_motion()
    found = fitted(specimen, table, floors(specimen, table))
    for mode in range(2):
        shape = found.mode_shapes[:, mode]
        omega = 2.0 * np.pi * found.natural_frequency_hz[mode]
        assert specimen.K @ shape == pytest.approx(omega**2 * specimen.masses_kg * shape, rel=2e-3)
        assert np.abs(shape).max() == 1.0


def test_free_vibration_on_a_table_that_rings() -> None:
    specimen = make_specimen()
    table = 0.05 * np.exp(-TIME[:16000] / 2.0) * np.sin(2.0 * np.pi * 3.15 * TIME[:16000])
    moved = floors(specimen, table, np.array([4e-3, 9e-3, 0.0, 0.05]))
    moved += 1e-3 * np.random.default_rng(2).standard_normal(moved.shape)
    found = fitted(specimen, table, moved)
    assert found.natural_frequency_hz == pytest.approx([3.2, 8.4], rel=5e-4)
    assert found.damping_ratio == pytest.approx([0.043, 0.039], rel=0.02)


def test_slow_drift_of_a_channel_does_no_harm_to_a_free_vibration() -> None:
    specimen, table = make_specimen(), np.zeros(16000)
    moved = floors(specimen, table, np.array([4e-3, 9e-3, 0.0, 0.05])) + 0.05 * TIME[:16000]
    found = fitted(specimen, table, moved)
    assert found.natural_frequency_hz == pytest.approx([3.2, 8.4], rel=1e-4)
    assert found.damping_ratio == pytest.approx([0.043, 0.039], rel=1e-3)


@pytest.mark.campaign
def test_standard_errors_are_the_scatter_of_repeated_records() -> None:
    specimen, random = make_specimen(), np.random.default_rng(5)
    table = table_motion()[:20000]
    still = floors(specimen, table)
    found = [fitted(specimen, table, still + 0.2 * random.standard_normal(still.shape)) for _ in range(25)]
    for value, error in (("natural_frequency_hz", "frequency_error_hz"), ("damping_ratio", "damping_error")):
        scatter = np.std([getattr(fit, value) for fit in found], axis=0, ddof=1)
        assert np.mean([getattr(fit, error) for fit in found], axis=0) == pytest.approx(scatter, rel=0.45)


def test_birge_ratio_is_what_the_scatter_has_too_much() -> None:
    random = np.random.default_rng(6)
    errors = random.uniform(0.5, 2.0, (4000, 3))
    values = 7.0 + random.standard_normal((4000, 3)) * errors * [1.0, 3.0, 0.2]
    assert birge(values, errors) == pytest.approx([1.0, 3.0, 1.0], rel=0.04)
    assert birge(np.array([[1.0], [3.0]]), np.array([[1.0], [1.0]])) == pytest.approx([np.sqrt(2.0)])


def test_stretches_share_time_or_energy() -> None:
    random = np.random.default_rng(7).standard_normal((2, 12003))
    assert stretches_of(random, free=False) == tuple(slice(2400 * i, 2400 * (i + 1)) for i in range(5))
    decay = np.exp(-np.arange(16000) * DT / 4.0) * np.sin(2.0 * np.pi * 3.0 * np.arange(16000) * DT)
    first, second = stretches_of(decay[None], free=True)
    # the energy of exp(-2 t / 4) within t: 1 - exp(-t / 2) of nearly all, 0.8 at t = 2 ln 5
    assert first == slice(0, first.stop)
    assert first.stop * DT == pytest.approx(2.0 * np.log(5.0), abs=0.1)
    assert second == slice(first.stop, 16000)
    short = decay[None] * np.exp(-np.arange(16000) * 0.01)
    assert stretches_of(short, free=True, least=2000) == (slice(0, 2000), slice(2000, 16000))
    assert stretches_of(short, free=True, least=8001) == ()
    assert stretches_of(random[:, :9999], free=False, least=2000) == ()


def test_a_free_vibration_ends_where_noise_hides_it() -> None:
    time = np.arange(16000) * DT
    decay = 0.3 + np.exp(-time / 0.5) * np.sin(2.0 * np.pi * 14.0 * time)
    rounded = 0.003 * np.round(decay / 0.003)
    end = alive(rounded[None], np.array([0.001])).stop * DT
    # exp(-t / 0.5) falls to 5 mm/s^2 at t = 0.5 ln 200 = 2.65 s; half a cycle is 0.036 s
    assert end == pytest.approx(0.5 * np.log(200.0), abs=0.2)
    assert alive(np.full((1, 16000), 0.3), np.array([0.001])) == slice(0, 0)


def test_a_motion_that_shows_nothing_is_a_sentence() -> None:
    specimen = make_specimen()
    with pytest.raises(InputError, match=r"the floors do not move in 0\.5-13\.\d Hz for 9\.\d* s of the record"):
        fitted(specimen, table_motion()[:10000], np.zeros((2, 10000)))


def test_a_fit_finds_its_way_over_a_stretch_in_which_the_floors_rest() -> None:
    """What no chain explains is approached from the middle, and there the floors show nothing for 20 s."""
    specimen, table = make_specimen(), table_motion()
    moved = floors(specimen, table) * np.array([[1.0], [-1.0]])
    moved[:, 20000:40000] = 0.0
    found = fitted(specimen, table, moved)
    assert found.residual > 0.01 and np.isfinite(found.natural_frequency_hz).all()


def test_a_stretch_in_which_no_floor_shows_anything_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its last sample alone moves by a bit, and a transform of that length leaves it out."""
    specimen, table = make_specimen(), table_motion()
    moved = floors(specimen, table)
    moved[:, 20000:40000] = 0.0
    moved[:, 39999] = 1e-3
    start = Start(storey_values(specimen.K), np.full(2, 0.04))
    monkeypatch.setattr(room, "stretches_of", lambda *_: (slice(0, 20000), slice(20000, 40000), slice(40000, 60000)))
    found = fit_stretches([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start, free=False)
    assert np.isfinite(found.frequency_scatter_hz).all()
    monkeypatch.setattr(room, "stretches_of", lambda *_: (slice(0, 20000), slice(20000, 40000)))
    alone = fit_stretches([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start, free=False)
    assert np.isnan(alone.frequency_scatter_hz).all()


def test_a_short_motion_has_no_scatter_but_an_error() -> None:
    specimen, table = make_specimen(), table_motion()[:1100]
    moved = floors(specimen, table) + 0.01 * np.random.default_rng(3).standard_normal((2, 1100))
    start = Start(storey_values(specimen.K), np.full(2, 0.04))
    found = fit_stretches([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start, free=True)
    assert np.isnan(found.frequency_scatter_hz).all()
    assert np.all(np.abs(found.natural_frequency_hz - [3.2, 8.4]) < 4.0 * found.frequency_error_hz)


def test_a_fit_that_starts_at_no_damping_comes_back() -> None:
    specimen, table = make_specimen(ratios=(0.004, 0.006)), table_motion()
    moved = floors(specimen, table)
    start = Start(storey_values(specimen.K) * 1.002, np.full(2, 2e-6))
    found = fit_specimen([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start)
    assert found.damping_ratio == pytest.approx([0.004, 0.006], rel=0.02)


@pytest.fixture(scope="module")
def drawn() -> list[tuple[Specimen, np.ndarray, np.ndarray]]:
    """Return 20 specimens of 1-3 floors with the motions of table and floors, noise of 0.3 m/s^2 on the floors."""
    random = np.random.default_rng(8)
    made = []
    for i in range(20):
        n = 1 + i % 3
        specimen = make_specimen(tuple(random.uniform(3000.0, 15000.0, n)), tuple(random.uniform(0.005, 0.06, n)))
        table = table_motion(i)[:20000]
        moved = floors(specimen, table)
        made.append((specimen, table, moved + 0.3 * random.standard_normal(moved.shape)))
    return made


def deviations(drawn: list[tuple[Specimen, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return (found - true) / stated uncertainty of all frequencies and of all damping ratios."""
    by_hz: list[float] = []
    by_ratio: list[float] = []
    for specimen, table, moved in drawn:
        n = len(specimen.masses_kg)
        start = Start(storey_values(specimen.K) * 1.03, np.full(n, 0.02))
        found = fit_stretches([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start, free=False)
        hz, zeta = modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)
        by_hz.extend((found.natural_frequency_hz - hz) / found.frequency_error_hz)
        by_ratio.extend((found.damping_ratio - zeta) / found.damping_error)
        assert np.all(np.isfinite(found.frequency_scatter_hz) & np.isfinite(found.damping_scatter))
    return np.array(by_hz), np.array(by_ratio)


@pytest.mark.campaign
def test_true_values_lie_within_the_random_uncertainties(
    drawn: list[tuple[Specimen, np.ndarray, np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "CLOCK", 0.0)
    monkeypatch.setattr(room, "SKEW", 0.0)
    for apart in deviations(drawn):
        assert np.mean(np.abs(apart) <= 2.0) >= 0.9
        assert 0.5 < apart.std() < 1.2  # neither too narrow nor absurdly wide
        assert abs(apart.mean()) < 0.4


@pytest.mark.campaign
def test_clock_and_skew_are_added_to_the_random_uncertainty(
    drawn: list[tuple[Specimen, np.ndarray, np.ndarray]],
) -> None:
    specimen, table, _ = drawn[1]
    start = Start(storey_values(specimen.K), np.full(2, 0.02))
    exact = floors(specimen, table)
    found = fit_stretches([Motion(table, exact)], DT, specimen.masses_kg, 0.5, start, free=False)
    plain = fit_specimen([Motion(table, exact)], DT, specimen.masses_kg, 0.5, start)
    hz = found.natural_frequency_hz
    assert np.all(found.frequency_error_hz >= np.hypot(plain.frequency_error_hz, 20e-6 * hz) * (1.0 - 1e-9))
    assert np.all(found.damping_error >= np.hypot(plain.damping_error, np.pi * hz * DT / 100.0) * (1.0 - 1e-9))
    assert np.all(found.frequency_error_hz < 3e-4 * hz)


def test_skew_between_channels_moves_no_more_than_is_stated() -> None:
    """A rotation of the resonance by phi shifts its frequency by zeta phi, and its damping in second order only."""
    specimen, table, skew_s = make_specimen((6000.0,), (0.02,)), table_motion(), 0.1 * DT
    f = np.fft.rfftfreq(len(table), DT)
    late = np.fft.irfft(np.fft.rfft(table) * np.exp(-2j * np.pi * f * skew_s), len(table))
    one, other = (fitted(specimen, each, floors(specimen, table)) for each in (table, late))
    omega = 2.0 * np.pi * one.natural_frequency_hz[0]
    moved = other.natural_frequency_hz[0] / one.natural_frequency_hz[0] - 1.0
    assert abs(moved) == pytest.approx(0.02 * omega * skew_s, rel=0.3)
    assert abs(other.damping_ratio[0] - one.damping_ratio[0]) < 0.1 * omega * skew_s / 2.0


def test_several_motions_are_fitted_together() -> None:
    specimen, random = make_specimen(), np.random.default_rng(9)
    motions = []
    for seed in range(4):
        table = table_motion(seed)[:16000]
        moved = floors(specimen, table)
        motions.append(Motion(table, moved + 0.3 * random.standard_normal(moved.shape)))
    start = Start(storey_values(specimen.K) * 1.03, np.full(2, 0.02))
    one, four = (fit_specimen(motions[:k], DT, specimen.masses_kg, 0.5, start) for k in (1, 4))
    assert four.frequency_error_hz == pytest.approx(0.5 * one.frequency_error_hz, rel=0.35)
    assert four.damping_error == pytest.approx(0.5 * one.damping_error, rel=0.35)
    assert four.residual == pytest.approx(one.residual, rel=0.15)
    assert np.all(np.abs(four.natural_frequency_hz - [3.2, 8.4]) < 4.0 * four.frequency_error_hz)
    assert np.all(np.abs(four.damping_ratio - [0.043, 0.039]) < 4.0 * four.damping_error)


@parametrize_first(4, "seed", range(20))
def test_the_top_floor_moves_to_the_positive_side_in_all_shapes(seed) -> None:
    """What couples two modes changes its sign with either shape, so that no fit may meet both signs of one."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 9))
    masses, stiffness = random.uniform(1.0, 9.0, n), random.uniform(1e3, 1e5, n)
    omega, shapes = room.modal(masses, stiffness)
    assert np.all(shapes[-1] > 0.0)
    drifts = np.eye(n) - np.eye(n, k=-1)
    K = drifts.T @ np.diag(stiffness) @ drifts
    assert K @ shapes == pytest.approx(masses[:, None] * shapes * omega**2, abs=1e-9 * K.max())


def test_linear_terms_that_depend_on_each_other_are_taken_out_once() -> None:
    """Nearly dependent rows, by one part in 1e9, still span two directions; equal ones span one."""
    random = np.random.default_rng(1)
    first, second, values = random.standard_normal((3, 400))
    near = np.vstack([first, first + 1e-9 * second])
    directions, made = room.orthonormal_rows(near)
    assert directions @ directions.T == pytest.approx(np.eye(2), abs=1e-12)
    assert made @ near == pytest.approx(directions, abs=1e-6)
    left = values - (directions @ values) @ directions
    assert np.abs([left @ first, left @ second]).max() < 1e-5 * np.linalg.norm(left) * np.linalg.norm(first)
    assert len(room.orthonormal_rows(np.vstack([first, first]))[0]) == 1
