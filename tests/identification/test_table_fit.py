"""The table's fit: data made from known poles and zeros come back, for loops of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.identification.table_fit import (
    Layout,
    Timing,
    beyond_scatter,
    first_fit,
    fit_error,
    fit_paper,
    pack,
    refit,
    response_and_slopes,
    roots,
    zeros_poles_gain,
)
from rths_cli.numerics.lti import Frf, Model, staircase

DT = 5e-4
TIMING = Timing(1, DT)
MODES = (np.array([3.2, 8.4]), np.array([0.04, 0.04]))


def made_table(loop: tuple[float, float], corner_hz: float, delay_s: float = 1.5 * DT) -> Model:
    """Return a table of two coupled modes, a loop (Hz, ratio) and a lag, written root by root."""

    def pair(frequency_hz: float, ratio: float) -> np.ndarray:
        return 2.0 * np.pi * frequency_hz * np.roots([1.0, 2.0 * ratio, 1.0]).astype(complex)

    poles = np.concatenate([pair(3.14, 0.045), pair(8.35, 0.042), pair(*loop), [-2.0 * np.pi * corner_hz]])
    zeros = np.concatenate([[0.0, 0.0], pair(3.2, 0.043), pair(8.4, 0.039)])
    gain = 0.0079 * float(np.real(np.prod(-poles) / np.prod(-zeros[2:])))
    return Model(zeros, poles, gain, delay_s, (0.5, 60.0), -1.4, 1, DT)


def made_frf(model: Model, noise: float = 0.0) -> Frf:
    """Return the model's sampled response at 0.1 Hz lines, with relative noise of a known standard deviation."""
    f = np.arange(0.5, 60.05, 0.1)
    random = np.random.default_rng(0)
    error = noise * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    response = model.sampled_response(f) * (1.0 + error)
    return Frf(f, response, np.ones(len(f)), np.full(len(f), max(noise, 1e-6)), 20)


def freed(frf: Frf) -> Model:
    """Return the fit from structured starts, its zeros set free."""
    return refit(frf, replace(first_fit(frf, MODES, TIMING, (0.5, 60.0)), held_zeros=0)).model


def sorted_roots(values: np.ndarray) -> np.ndarray:
    return values[np.lexsort((values.imag, np.round(np.abs(values), 3)))]


@pytest.mark.parametrize(
    ("loop", "corner_hz"),
    [((14.0, 0.6), 100.0), ((8.0, 0.4), 60.0), ((25.0, 0.9), 150.0), ((63.0, 0.72), 16.4), ((12.0, 1.6), 120.0)],
)
def test_known_roots_come_back(loop: tuple[float, float], corner_hz: float) -> None:
    truth = made_table(loop, corner_hz)
    found = freed(made_frf(truth))
    assert sorted_roots(found.poles) == pytest.approx(sorted_roots(truth.poles), rel=1e-3)
    assert sorted_roots(found.zeros) == pytest.approx(sorted_roots(truth.zeros), rel=1e-3, abs=1e-9)
    assert found.gain == pytest.approx(truth.gain, rel=1e-3)
    assert found.ripple_m_s2_per_v == pytest.approx(-1.4, rel=1e-3)
    assert found.delay_s == 1.5 * DT


def test_inverted_table_keeps_its_sign() -> None:
    truth = replace(made_table((14.0, 0.6), 100.0), gain=-made_table((14.0, 0.6), 100.0).gain)
    found = first_fit(made_frf(truth), MODES, TIMING, (0.5, 60.0)).model
    assert found.gain == pytest.approx(truth.gain, rel=1e-3)


def test_noise_averages_out() -> None:
    truth = made_table((14.0, 0.6), 100.0)
    found = freed(made_frf(truth, 0.005))
    f = np.linspace(1.0, 40.0, 200)
    assert np.abs(found.response(f) / truth.response(f) - 1.0).max() < 0.004


def test_paper_model_is_proper_stable_and_minimum_phase_without_delay() -> None:
    frf = made_frf(made_table((14.0, 0.6), 100.0))
    found = fit_paper(frf, first_fit(frf, MODES, TIMING, (0.5, 60.0)), (0.5, 12.0)).model
    assert (len(found.poles), len(found.zeros), found.delay_s, found.ripple_m_s2_per_v) == (8, 8, 0.0, 0.0)
    assert np.count_nonzero(found.zeros == 0.0) == 2
    assert found.poles.real.max() < 0.0
    assert found.zeros[2:].real.max() < 0.0
    error = fit_error(found, frf)
    assert error.rms < 0.01
    assert error.rms_mid < 0.004


@pytest.mark.parametrize("loop", [(14.0, 0.6), (8.0, 0.4), (25.0, 0.9), (20.0, 0.5), (12.0, 1.6)])
def test_the_papers_fit_goes_on_until_it_is_done(loop: tuple[float, float]) -> None:
    frf = made_frf(made_table(loop, 100.0), 0.002)
    found = fit_paper(frf, first_fit(frf, MODES, TIMING, (0.5, 60.0)), (0.5, 12.0))
    before, after = fit_error(found.model, frf), fit_error(refit(frf, found).model, frf)
    assert before.rms == pytest.approx(after.rms, rel=0.01)  # the pull has another start
    assert before.rms < 0.0035


def test_table_without_a_specimen() -> None:
    poles = 2.0 * np.pi * np.concatenate([14.0 * np.roots([1.0, 1.2, 1.0]), [-100.0]]).astype(complex)
    gain = 0.0079 * float(np.real(np.prod(-poles)))
    truth = Model(np.zeros(2, dtype=complex), poles, gain, 1.5 * DT, (0.5, 60.0), -1.4, 1, DT)
    found = first_fit(made_frf(truth), (np.zeros(0), np.zeros(0)), TIMING, (0.5, 60.0)).model
    assert sorted_roots(found.poles) == pytest.approx(sorted_roots(poles), rel=1e-4)


def test_fit_error_is_the_relative_deviation_in_its_bands() -> None:
    truth = made_table((14.0, 0.6), 100.0)
    frf = made_frf(truth)
    f = frf.frequency_hz
    factor = np.where((f > 1.95) & (f < 10.05), 1.01, np.where((f > 0.65) & (f < 11.05), 1.02, 1.5))
    error = fit_error(truth, replace(frf, response=frf.response / factor))
    share = np.mean(factor[(f > 0.65) & (f < 11.05)] == 1.02)
    assert error.largest == pytest.approx(0.02, rel=1e-6)
    assert error.rms == pytest.approx(np.sqrt(share * 0.02**2 + (1 - share) * 0.01**2), rel=1e-6)
    assert error.rms_mid == pytest.approx(0.01, rel=1e-6)
    assert fit_error(truth, frf).largest < 1e-12


def test_scatter_of_the_data_is_not_held_against_a_model_but_what_it_hides_is() -> None:
    """Lines of 2 % scatter (each part): the true model errs by 2.8 % rms of them; what they leave uncertain of its six
    parameters is 0.02 sqrt(6 / lines), of which two standard errors count. An error of 6 % shows through."""
    truth = made_table((14.0, 0.6), 100.0)
    clean = made_frf(truth)
    f, random = clean.frequency_hz, np.random.default_rng(4)
    scatter = 0.02 * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    noisy = replace(clean, response=clean.response * (1.0 + scatter), relative_error=np.full(len(f), 0.02))
    lines = int(np.sum((f > 0.65) & (f < 11.05)))
    parameters = len(truth.poles) + len(truth.zeros) - 1
    hidden = 2.0 * 0.02 * np.sqrt(parameters * noisy.bandwidth_lines / lines)
    fine = beyond_scatter(truth, noisy)
    assert fit_error(truth, noisy).rms == pytest.approx(0.0283, rel=0.2)
    assert hidden < fine.rms < hidden + 0.007
    wrong = beyond_scatter(replace(truth, gain=1.06 * truth.gain), noisy)
    assert wrong.rms > 0.025
    exact = beyond_scatter(replace(truth, gain=1.06 * truth.gain), replace(clean, relative_error=np.full(len(f), 1e-6)))
    assert exact.rms == pytest.approx(0.06, rel=3e-3)  # the alias has its own gain


def test_slopes_are_those_of_the_logarithm() -> None:
    layout = Layout(2, 1, 1, 1e-3)
    parameters = np.log(np.array([0.3, 20.0, 0.04, 90.0, 1.7, 300.0, 21.0, 0.05]))
    s = 2j * np.pi * np.linspace(0.5, 50.0, 30)
    _, slopes = response_and_slopes(layout, parameters, s)
    for i, step in enumerate(1e-6 * np.eye(layout.size)):
        ahead, behind = (response_and_slopes(layout, parameters + sign * step, s)[0] for sign in (1.0, -1.0))
        assert slopes[i] == pytest.approx(np.log(ahead / behind) / 2e-6, abs=1e-6)


def test_factors_and_roots_are_one_function() -> None:
    pole_pairs, zero_pairs = np.array([[20.0, 0.04], [90.0, 1.7]]), np.array([[21.0, 0.05]])
    parameters, layout = pack(0.3, pole_pairs, np.array([300.0]), zero_pairs), Layout(2, 1, 1, 1e-3)
    zeros, poles, gain = zeros_poles_gain(layout, parameters, -1.0)
    f = np.linspace(0.5, 50.0, 30)
    value, _ = response_and_slopes(layout, parameters, 2j * np.pi * f)
    assert Model(zeros, poles, gain, 1e-3, (0.5, 50.0)).response(f) == pytest.approx(-value, rel=1e-10)
    assert np.all(roots(pole_pairs)[2:].imag == 0.0)


@pytest.mark.parametrize(("latency", "late"), [(0, 1), (1, 1), (3, 3)])
def test_staircase_is_the_response_of_a_late_difference(latency: int, late: int) -> None:
    f, k = np.array([3.0, 40.0]), np.arange(4000)
    for frequency, value in zip(f, staircase(f, latency, DT), strict=True):
        u = np.exp(2j * np.pi * frequency * k * DT)
        assert u[late + 9] * value == pytest.approx(u[9] - u[8], rel=1e-9)


def test_too_few_lines_are_refused() -> None:
    frf = made_frf(made_table((14.0, 0.6), 100.0))
    few = Frf(frf.frequency_hz[:20], frf.response[:20], frf.coherence[:20], frf.relative_error[:20], 20)
    with pytest.raises(InputError, match="20 lines"):
        first_fit(few, MODES, TIMING, (0.5, 60.0))


@pytest.mark.filterwarnings("error")
def test_a_ripple_is_no_logarithm_however_large() -> None:
    layout = Layout(1, 0, 1, 0.0)
    theta = np.append(pack(1.0, np.array([[10.0, 0.1]]), np.zeros(0), np.array([[20.0, 0.1]])), 1e4)
    assert all(np.array_equal(*pair) for pair in zip(layout.pairs(theta), layout.pairs(theta[:-1]), strict=True))
