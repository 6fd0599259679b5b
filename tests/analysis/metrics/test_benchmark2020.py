"""Oracles: the benchmark itself simulated, with the figures an independent simulation of it gave; known shifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import silva

from rths_cli.analysis.metrics import best_lag_s, response_criteria, tracking_criteria
from rths_cli.errors import InputError

RECORD = Path(__file__).parents[3] / "records" / "el_centro.csv"
SEEDS = (0, 1, 2)
# J1 ms, J2 to J9 %, peak force N, reference peaks mm: PI-P on 0.4 El Centro, mean of three noise seeds.
EXPECTED = {
    1: (4.64, 10.40, 11.52, 35.76, 19.85, 32.35, 32.45, 16.73, 16.67, 4775, (3.653, 5.851, 7.144)),
    4: (4.64, 10.46, 11.06, 80.14, 43.65, 76.78, 76.92, 41.08, 41.45, 5364, (4.120, 6.580, 8.011)),
}
SCATTER = (0.005, 0.1, 0.4, 0.1, 0.4, 0.1, 0.1, 0.1, 0.1, 15)  # of the oracle itself, with the noise seed


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    """Return 0.4 El Centro in m/s^2 at the middle of every sample of its 53.74 s."""
    gal = np.array([float(line) for line in RECORD.read_text().splitlines() if not line.startswith("#")])
    end_s = 0.02 * (len(gal) - 1)
    middle_s = silva.DT_S * (np.arange(int(end_s / silva.DT_S)) + 0.5)
    return 0.4 * np.interp(middle_s, 0.02 * np.arange(len(gal)), gal / 100)


def criteria(made: silva.Benchmark) -> list[float]:
    """Return J1 in ms, J2 to J9 in percent, and the peak force."""
    tracking = tracking_criteria(made.numerical[0], made.measured, silva.DT_S, leads=False)
    response = response_criteria(made.reference, np.vstack([made.measured, made.numerical[1:]]))
    (j4, j6, j7), (j5, j8, j9) = 100 * response.deviation, 100 * response.peak
    force = np.abs(made.force_n).max()
    return [1e3 * tracking.j1_s, 100 * tracking.j2, 100 * tracking.j3, j4, j5, j6, j7, j8, j9, force]


@pytest.mark.campaign
@pytest.mark.parametrize("case", [1, 4])
def test_the_benchmark_gives_the_figures_of_an_independent_simulation(case: int, ground: np.ndarray) -> None:
    runs = [silva.run(case, ground, seed) for seed in SEEDS]
    *expected, peaks_mm = EXPECTED[case]
    found = np.mean([criteria(made) for made in runs], axis=0)
    assert np.all(np.abs(found - expected) <= SCATTER), dict(enumerate(found - expected, 1))
    assert 1e3 * np.abs(runs[0].reference).max(axis=1) == pytest.approx(peaks_mm, abs=6e-4)


def test_a_lead_is_seen_in_the_benchmark_and_hidden_by_its_own_search(ground: np.ndarray) -> None:
    """The measured motion in place of the target: the lag of 19 samples becomes a lead of 19."""
    made = silva.run(1, ground, 0)
    lag = best_lag_s(made.numerical[0], made.measured, silva.DT_S)
    assert lag == 19 * silva.DT_S
    assert best_lag_s(made.measured, made.numerical[0], silva.DT_S) == -lag
    assert best_lag_s(made.measured, made.numerical[0], silva.DT_S, leads=False) == 0.0


@pytest.mark.parametrize("shift", [-24, -7, -1, 0, 1, 5, 24])
def test_a_shift_of_whole_samples_is_found_whatever_gain_and_offset(shift: int) -> None:
    series = np.cumsum(np.random.default_rng(1).normal(size=4100))
    target, measured = series[50:4050], 0.6 * series[50 - shift : 4050 - shift] - 3e9
    assert best_lag_s(target, measured, 1 / 2000) == pytest.approx(shift / 2000, abs=1e-12)


@pytest.mark.parametrize(("dt_s", "samples"), [(1 / 4096, 49), (1 / 2000, 24), (1 / 500, 6)])
def test_the_window_is_12_ms_either_way(dt_s: float, samples: int) -> None:
    """A ramping sine far more late than the window fits best at its edge."""
    sine = np.sin(2 * np.pi * 0.5 * dt_s * np.arange(8000))
    late = np.roll(sine, 200)[500:7500]
    assert best_lag_s(sine[500:7500], late, dt_s) == pytest.approx(samples * dt_s)
    assert best_lag_s(late, sine[500:7500], dt_s) == pytest.approx(-samples * dt_s)


def test_coefficients_are_those_of_the_overlaps() -> None:
    """Short random walks, whose overlaps have other means and sizes than the whole: numpy's own, lag by lag."""
    random = np.random.default_rng(2)
    for _ in range(50):
        x, y = np.cumsum(random.normal(size=(2, 40)), axis=1)
        parts = {k: (x[max(-k, 0) : 40 - max(k, 0)], y[max(k, 0) : 40 - max(-k, 0)]) for k in range(-12, 13)}
        fits = {lag: np.corrcoef(*part)[0, 1] for lag, part in parts.items()}
        assert best_lag_s(x, y, 0.001) == pytest.approx(0.001 * max(fits, key=lambda lag: fits[lag]))


def test_overlaps_without_motion_are_passed_over() -> None:
    """Both move at the very end, the table a sample late: any larger lag leaves only what stands still."""
    for offset in np.random.default_rng(0).normal(size=(10, 2)):
        target, measured = np.repeat(offset[:, None], 200, axis=1)
        target[-3:] += (1.0, 0.4, 0.5)
        measured[-3:] += (0.0, 1.0, 0.4)
        with np.errstate(invalid="raise"):
            assert best_lag_s(target, measured, 0.001) == pytest.approx(0.001)


def test_ratios_by_hand() -> None:
    """Deviations remove the mean, peaks do not: an offset of 1 shows in the peak alone."""
    target = np.array([2.0, -2.0, 2.0, -2.0])
    found = tracking_criteria(target, target + np.array([1.5, 0.5, 1.5, 0.5]), 0.1)
    assert (found.j2, found.j3) == pytest.approx((0.25, 0.75))
    both = response_criteria([target, 10 * target], [0.5 * target, 10 * target + 4.0])
    assert both.deviation == pytest.approx([0.5, 0.0])
    assert both.peak == pytest.approx([0.5, 0.2])


def test_what_does_not_move_has_no_criteria() -> None:
    moving, still = np.sin(np.arange(100.0)), np.ones(100)
    assert np.isnan(best_lag_s(still, moving, 0.01))
    assert np.isnan(best_lag_s([1.0], [2.0], 0.01))
    assert np.isnan(best_lag_s(moving, np.append(moving[1:], np.nan), 0.01))
    assert np.isnan(tracking_criteria(0 * still, moving, 0.01).j3)
    assert np.isnan(response_criteria([0 * still, moving], [moving, moving]).peak).tolist() == [True, False]


def test_different_shapes_are_named() -> None:
    with pytest.raises(InputError, match=r"measured has shape \(3,\), but target has \(4,\)"):
        tracking_criteria(np.arange(4.0), np.arange(3.0), 0.01)
    with pytest.raises(InputError, match=r"value has shape \(2, 5\), but reference has \(3, 5\)"):
        response_criteria(np.zeros((3, 5)), np.zeros((2, 5)))
