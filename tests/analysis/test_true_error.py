"""The error that wrong sensors and masses leave, against the whole test as one state equation that is solved anew."""

import numpy as np
import pytest
from scipy.signal import StateSpace, butter, lsim, sosfiltfilt

from rths_cli.analysis.fourier_lines import lines_for, sim_lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.metrics import test_band as in_band
from rths_cli.analysis.true_error import (
    MeasuredError,
    OwnError,
    best_remedy,
    gram,
    products,
    sensitivities,
    true_error,
    true_error_of_run,
)
from rths_cli.identification.results import Calibration
from rths_cli.numerics.lti import Frf, Model
from rths_cli.structure import Building, Numerical, Specimen, assemble

DT = 0.005
NOTHING = OwnError(np.zeros(3), np.zeros(3))
MASSES, K_E = np.array([6.91, 6.95]), np.array([[14707.96, -7376.4], [-7376.4, 7376.4]])
C_E = np.array([[8.0, -2.0], [-2.0, 6.0]])
M_N, K_N, C_N = 6.93, 7354.0, 22.0
TIME = np.arange(8000) * DT
BAND = butter(2, [0.5, 6.0], "band", fs=1.0 / DT, output="sos")
GROUND = sosfiltfilt(BAND, np.random.default_rng(4).standard_normal(8000))
GROUND *= np.hanning(8000)


def whole_test(gain, masses_taken):
    """Return the true accelerations (3, n) of a test on a perfect table whose sensors read `gain` (3,) times the truth.

    x: floor 1; the table is moved so that its sensor shows floor 1; the shear is that of the masses that are taken for
    true and of the measured floors. Unknown: floor 1 relative to the ground, floors relative to the true table.
    """
    table, top = gain[0], gain[1:]
    # absolute accelerations: floor 1 a, true table a / table, floors a / table + r'' with
    # m (r'' + a / table) + C r' + K r = 0, shear f = -sum of taken mass * reading * (a / table + r'')
    #                                             = sum of (taken mass * reading / true mass) * (C r' + K r)
    share = masses_taken * top / MASSES
    a, b = np.zeros((6, 6)), np.zeros((6, 1))
    a[0, 3] = a[1, 4] = a[2, 5] = 1.0
    interface = np.concatenate([[-K_N], share @ K_E, [-C_N], share @ C_E]) / M_N  # absolute acceleration of floor 1
    a[3], b[3] = interface, -1.0
    a[4:] = np.hstack([np.zeros((2, 1)), -K_E / MASSES[:, None], np.zeros((2, 1)), -C_E / MASSES[:, None]])
    floors = a[4:].copy()  # absolute accelerations
    a[4:] -= interface / table
    out = np.vstack([interface, floors])
    seen = lsim(StateSpace(a, b, out, np.zeros((3, 1))), GROUND, TIME)[1].T
    return np.vstack([seen[:1] / table, seen[1:]])


def building():
    numerical = Numerical(np.array([M_N]), np.array([K_N]), np.array([C_N]))
    specimen = Specimen(MASSES, K_E, C_E)
    return Building(numerical, specimen, 0.0, *assemble(numerical, specimen, 0.0), ())


POLES = np.array([-20.0 + 15.0j, -20.0 - 15.0j])
TABLE = Model(zeros=np.zeros(2), poles=POLES, gain=80.0, delay_s=0.0, band_hz=(0.5, 40.0))  # samples without alias
BAND = np.linspace(0.5, 40.0, 800)
MEASURED = Frf(BAND, TABLE.response(BAND), np.ones(800), np.full(800, 1e-4), 10)


def known():
    lines = lines_for(len(TIME), DT, 40.0)
    return sensitivities(
        building(), lines, sim_lines(building(), lines, lines.of(GROUND)), np.zeros(3), TABLE, MEASURED
    )


@pytest.mark.parametrize("place", range(5))
def test_each_gain_and_mass_has_the_error_of_a_whole_test_with_it(place):
    size, gain, taken = 1e-3, np.ones(3), MASSES.copy()
    if place < 3:
        gain[place] += size
    else:
        taken[place - 3] /= 1.0 + size  # the true mass is larger than what is taken for it
    off = whole_test(gain, taken) - whole_test(np.ones(3), MASSES)
    rms = np.sqrt(np.mean(in_band(off, DT) ** 2, axis=1)) / size
    parameter = place if place < 3 else 9 + place - 3
    assert np.sqrt(known().gram[:, parameter, parameter]) == pytest.approx(rms, rel=0.01)


@pytest.mark.campaign
@pytest.mark.parametrize("place", range(5))
def test_what_the_sensors_show_of_each_gain_and_mass_is_what_they_read_of_a_whole_test_with_it(place):
    size, gain, taken = 1e-3, np.ones(3), MASSES.copy()
    if place < 3:
        gain[place] += size
    else:
        taken[place - 3] /= 1.0 + size
    off = gain[:, None] * whole_test(gain, taken) - whole_test(np.ones(3), MASSES)
    rms = np.sqrt(np.mean(in_band(off, DT) ** 2, axis=1)) / size
    parameter = place if place < 3 else 9 + place - 3
    covariance = np.zeros((11, 11))
    covariance[parameter, parameter] = 1.0
    assert known().measured_rms(covariance) == pytest.approx(rms, rel=0.01)


def test_sensors_show_nothing_of_a_gain_that_all_share():
    covariance = np.zeros((11, 11))
    covariance[:3, :3] = 1.0
    assert np.all(known().measured_rms(covariance) < 1e-6 * np.sqrt(np.einsum("spp->s", known().gram)))


def test_errors_of_several_parameters_add_with_their_signs():
    gain, taken = np.array([1.001, 1.001, 1.001]), MASSES
    off = whole_test(gain, taken) - whole_test(np.ones(3), MASSES)
    rms = np.sqrt(np.mean(in_band(off, DT) ** 2, axis=1))
    together = np.zeros(11)
    together[:3] = 1e-3
    assert np.sqrt(np.einsum("p,spq,q->s", together, known().gram, together)) == pytest.approx(rms, rel=0.01)


def test_the_distribution_is_that_of_many_laboratories():
    covariance = np.zeros((11, 11))
    covariance[:3, :3] = 0.01**2 / 3.0  # a common gain
    found = Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), covariance)
    uncertain = true_error(known(), found, NOTHING)
    gains = 0.01 / np.sqrt(3.0) * np.random.default_rng(1).standard_normal(300)
    exact = whole_test(np.ones(3), MASSES)

    def error(gain):
        return np.sqrt(np.mean(in_band(whole_test(np.full(3, 1.0 + gain), MASSES) - exact, DT) ** 2, axis=1))

    grid = np.linspace(-1.0, 1.0, 21) * np.abs(gains).max()  # the error of a storey bends at no gain, which is in it
    solved = np.array([error(gain) for gain in grid]).T
    errors = np.array([np.interp(gains, grid, storey) for storey in solved]).T
    assert errors[7] == pytest.approx(error(gains[7]), rel=0.01)
    assert uncertain.median == pytest.approx(np.median(errors, axis=0), rel=0.15)
    assert uncertain.bound == pytest.approx(np.quantile(errors, 0.95, axis=0), rel=0.15)


def test_a_specimen_may_be_stiffer_or_softer():
    """A normal deviation: its error is half normal, with 0.674 standard deviations as the median and 1.96 at 95 %."""
    found = Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), np.zeros((11, 11)))
    size = np.array([1.0, 2.0, 5.0])
    uncertain = true_error(known(), found, OwnError(np.zeros(3), size))
    assert uncertain.median == pytest.approx(0.674 * size, rel=0.05)
    assert uncertain.bound == pytest.approx(1.96 * size, rel=0.05)


def test_pitch_has_an_error_of_known_size():
    found = Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), np.zeros((11, 11)))
    size = np.array([1.0, 2.0, 5.0])
    uncertain = true_error(known(), found, OwnError(np.zeros(3), np.zeros(3), size, 0.1))
    assert uncertain.median == pytest.approx(size, rel=0.01)
    assert uncertain.bound == pytest.approx((1.0 + 0.1 * 1.645) * size, rel=0.01)


def test_the_remedy_is_the_measurement_that_helps_most():
    covariance = np.diag(np.concatenate([np.full(3, 1e-8), np.zeros(6), [1e-9, 1e-4]]))
    found = Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), covariance)
    remedy, before = best_remedy(known(), found, NOTHING), true_error(known(), found, NOTHING)
    assert remedy is not None and remedy.parameter == 10
    assert np.all(remedy.bound < 0.2 * before.bound)
    nothing = Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), np.zeros((11, 11)))
    assert best_remedy(known(), nothing, OwnError(np.ones(3), np.ones(3))) is None
    assert best_remedy(known(), found, OwnError(np.full(3, 100.0 * before.bound.max()), np.zeros(3))) is None


@pytest.mark.parametrize("aligned", [0.0, 0.9])
def test_the_distribution_after_a_run_covers_what_errors_of_the_calibration_make_of_its_loop_s_error(
    aligned: float,
) -> None:
    """The true errors are formed as series, in time; the loop's error may look like one of the calibration."""
    random, lines = np.random.default_rng(7), lines_for(4000, 2e-3, 4.0)
    spectra = random.standard_normal((4, 2, lines.count, 2)) @ np.array([1.0, 1j])
    of_each, other = spectra[:3], spectra[3]
    loop = 0.02 * (aligned * of_each[0] + np.sqrt(1.0 - aligned**2) * other)
    spread = np.array([0.03, 0.01, 0.005])
    series, own = lines.evaluated(of_each), lines.evaluated(loop)
    none = np.zeros(2)
    run = MeasuredError(rms(own), products(lines, list(of_each), loop), none, none, none)
    stated = true_error_of_run(gram(lines, list(of_each)), np.diag(spread**2), run)
    drawn = random.standard_normal((1000, 3)) * spread
    true = np.array([rms(own + np.einsum("p,psn->sn", each, series)) for each in drawn])
    assert np.all(np.abs(np.mean(true <= stated.bound, axis=0) - 0.95) < 0.02)
    assert np.all(np.abs(np.mean(true <= stated.median, axis=0) - 0.5) < 0.05)
