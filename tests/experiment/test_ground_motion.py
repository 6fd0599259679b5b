"""Oracles: closed forms of filter, integrals and oscillator, limits of the spectrum, and scipy.signal.lsim."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from rths_cli.analysis.intensity import integrate
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import GroundMotion, peaks, prepare, response_spectrum
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram

Array = NDArray[np.float64]
EL_CENTRO = Path(__file__).parents[2] / "records" / "el_centro.csv"


def accelerogram(accel_m_s2: Array | list[float], dt_s: float = 0.01) -> Accelerogram:
    return Accelerogram(dt_s, np.asarray(accel_m_s2, dtype=float), "made", "made", "m/s^2", "one column", "")


def motion_of(accel_m_s2: Array, dt_s: float) -> GroundMotion:
    return prepare(accelerogram(accel_m_s2, dt_s), 1.0, 1.0 / dt_s, corner_hz=0.0)


def test_record_is_scaled_and_interpolated_linearly_up_to_its_end() -> None:
    motion = prepare(accelerogram([0.0, 2.0, -4.0]), 0.5, 400.0, corner_hz=0.0)
    assert motion.time_s == pytest.approx(np.arange(9) * 0.0025)
    assert motion.accel_m_s2 == pytest.approx([0, 0.25, 0.5, 0.75, 1, 0.25, -0.5, -1.25, -2])


def test_last_sample_lies_within_a_record_that_the_rate_does_not_divide() -> None:
    motion = prepare(accelerogram([0.0, 1.0, 2.0, 3.0]), 1.0, 130.0, corner_hz=0.0)
    assert motion.time_s == pytest.approx([0, 1 / 130, 2 / 130, 3 / 130])
    assert motion.accel_m_s2 == pytest.approx(100 * motion.time_s)


def test_el_centro_at_the_default_rate_has_no_tail() -> None:
    motion = prepare(read_accelerogram(EL_CENTRO), 0.30, 2000.0)
    assert len(motion.time_s) == 2687 * 40 + 1
    assert motion.time_s[-1] == pytest.approx(2687 * 0.02)


@pytest.mark.parametrize(("corner_hz", "order"), [(0.25, 2), (2.0, 4)])
def test_filter_has_the_butterworth_magnitude_and_is_causal(corner_hz: float, order: int) -> None:
    impulse = np.zeros(2**13)
    impulse[1000] = 1.0
    response = prepare(accelerogram(impulse), 1.0, 100.0, corner_hz, order).accel_m_s2
    frequency = np.fft.rfftfreq(len(impulse), 0.01)[1:-1]
    warped = np.tan(np.pi * corner_hz / 100) / np.tan(np.pi * frequency / 100)
    assert not response[:1000].any()
    assert np.abs(np.fft.rfft(response))[1:-1] == pytest.approx((1 + warped ** (2 * order)) ** -0.5, abs=1e-6)


def test_filter_starts_from_rest() -> None:
    motion = prepare(accelerogram(np.ones(1001)), 1.0, 2000.0)
    x = np.sqrt(2) * np.pi * 0.25 * motion.time_s
    assert motion.accel_m_s2 == pytest.approx(np.exp(-x) * (np.cos(x) - np.sin(x)), abs=1e-3)


def test_integrals_are_exact_for_a_piecewise_linear_acceleration() -> None:
    t = np.linspace(0.0, 3.0, 7)
    velocity, displacement = integrate(4.0 - 3.0 * np.abs(t - 1.5), 0.5)
    late = np.maximum(t - 1.5, 0.0)
    assert velocity == pytest.approx(-0.5 * t + 1.5 * t**2 - 3.0 * late**2)
    assert displacement == pytest.approx(-0.25 * t**2 + 0.5 * t**3 - late**3)


def test_integrals_of_a_sine_converge_at_second_order() -> None:
    errors = []
    for n in (200, 400):
        t = np.linspace(0.0, 2.0, n + 1)
        _, displacement = integrate(np.sin(5.0 * t), t[1])
        errors.append(np.abs(displacement - (t / 5.0 - np.sin(5.0 * t) / 25.0)).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)


def test_peaks_are_the_greatest_magnitudes() -> None:
    motion = GroundMotion(0.1, np.arange(3.0), np.array([1.0, -2, 0]), np.array([0.0, 3, -5]), np.array([-7.0, 4, 6]))
    found = peaks(motion)
    assert (found.accel_m_s2, found.velocity_m_s, found.displacement_m) == (2.0, 5.0, 7.0)


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.6])
def test_spectrum_of_a_step_is_its_overshoot(zeta: float) -> None:
    motion = motion_of(np.full(4001, 1.5), 0.001)
    overshoot = 1.0 + np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2))
    assert response_spectrum(motion, [0.5, 1.0], zeta) == pytest.approx([1.5 * overshoot] * 2, rel=1e-5)


def test_spectrum_of_a_sine_matches_the_undamped_closed_form() -> None:
    t = np.arange(0.0, 10.0, 0.0005)
    w, drive = 2 * np.pi / 0.7, 9.0
    exact = (np.sin(drive * t) - drive / w * np.sin(w * t)) / (w**2 - drive**2)
    found = response_spectrum(motion_of(np.sin(drive * t), 0.0005), [0.7], 0.0)
    assert found == pytest.approx([w**2 * np.abs(exact).max()], rel=3e-6)


def test_spectrum_matches_lsim_on_a_real_record() -> None:
    motion = prepare(read_accelerogram(EL_CENTRO), 0.30, 200.0)
    periods = np.array([0.06, 0.43])
    expected = []
    for w in 2 * np.pi / periods:
        system = ([[0.0, 1.0], [-(w**2), -0.06 * w]], [[0.0], [-1.0]], [[w**2, 0.0]], [[0.0]])
        fine_s = np.arange((motion.time_s.size - 1) * 8 + 1) / 8 * motion.dt_s
        accel = np.interp(fine_s, motion.time_s, motion.accel_m_s2)
        _, response, _ = lsim(system, accel, fine_s, interp=True)
        expected.append(np.abs(response).max())
    assert response_spectrum(motion, periods, 0.03) == pytest.approx(expected, rel=5e-4)


def test_spectrum_tends_to_peak_acceleration_and_peak_displacement() -> None:
    motion = prepare(read_accelerogram(EL_CENTRO), 0.30, 2000.0)
    stiff, soft = response_spectrum(motion, [0.0002, 1000.0], 0.05)
    assert stiff == pytest.approx(peaks(motion).accel_m_s2, rel=0.002)
    assert soft == pytest.approx((2 * np.pi / 1000.0) ** 2 * peaks(motion).displacement_m, rel=0.01)


def test_a_hundred_periods_of_a_long_record_are_those_of_each_alone() -> None:
    motion, periods = motion_of(np.sin(np.arange(108_000) * 0.01), 0.0005), np.geomspace(0.02, 10.0, 100)
    together = response_spectrum(motion, periods)
    alone = [response_spectrum(motion, [period])[0] for period in periods[::33]]
    assert together[::33] == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize(
    ("rate_hz", "corner_hz", "order", "words"),
    [
        (2000.0, 0.25, 2, "shorter than one period of the 0.25 Hz high pass, 4 s"),
        (50.0, 0.0, 2, "sample_rate_hz: 50 Hz is below the record's 100 Hz"),
        (100.0, 50.0, 2, "corner 50 Hz must be at least 0 (off) and below half the sample rate, 50 Hz"),
        (100.0, -1.0, 2, "corner -1 Hz must be at least 0"),
        (100.0, 20.0, 0, "order 0 must be at least 1"),
        (100.0, float("nan"), 2, "corner nan Hz"),
    ],
)
def test_what_does_not_fit_the_record_is_refused(rate_hz: float, corner_hz: float, order: int, words: str) -> None:
    with pytest.raises(InputError) as caught:
        prepare(accelerogram(np.ones(400)), 1.0, rate_hz, corner_hz, order)
    assert len(caught.value.faults) == 1
    assert words in str(caught.value)


def test_a_record_of_one_filter_period_is_accepted() -> None:
    assert len(prepare(accelerogram(np.ones(401)), 1.0, 100.0).time_s) == 401


@pytest.mark.parametrize(("periods", "zeta"), [([1.0, 0.0], 0.05), ([float("nan")], 0.05), ([1.0], 1.0), ([1.0], -0.1)])
def test_impossible_oscillators_are_refused(periods: list[float], zeta: float) -> None:
    with pytest.raises(InputError):
        response_spectrum(motion_of(np.ones(10), 0.01), periods, zeta)


def test_a_record_that_would_make_too_many_samples_is_refused_before_they_are_made() -> None:
    long = Accelerogram(1.0, np.zeros(2001), "", "", "m/s^2", "", "")
    with pytest.raises(
        InputError, match=r"^sample_rate_hz: 50000 Hz makes 1e\+08 samples of the record's 2000 s, the limit"
    ):
        prepare(long, 1.0, 50_000.0, corner_hz=0.0)
