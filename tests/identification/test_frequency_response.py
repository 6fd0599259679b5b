"""H1 against scipy's spectra, a known system and the scatter of repeated records; leakage against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from rths_cli.errors import InputError
from rths_cli.identification.excitation import faded, shaped_noise
from rths_cli.identification.frequency_response import (
    Estimator,
    estimate,
    noise_floor,
    responses,
    simulate,
    without_leakage,
)
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.numerics.lti import Frf, Model

DT = 5e-4


def make_model(frequency_hz: float, ratio: float, ripple: float = 0.0) -> Model:
    """Return a table with one lightly damped pair of poles close to a pair of zeros, and a 15 Hz loop."""
    pairs = [(1.03 * frequency_hz, ratio), (15.0, 0.6)]
    poles = np.concatenate([2.0 * np.pi * f * np.array([-z + 1j * np.sqrt(1 - z * z)] * 2) for f, z in pairs])
    poles[1::2] = poles[1::2].conj()
    zeros = np.concatenate([[0.0, 0.0], poles[:2] / 1.03])
    return Model(zeros, poles, 0.0079 * (2.0 * np.pi * 15.0) ** 2, 0.0, (0.5, 60.0), ripple, 1, DT)


def response_in_time(model: Model, command: np.ndarray) -> np.ndarray:
    """Return the model's response by a state space that takes the command as straight lines between samples."""
    system = signal.ZerosPolesGain(model.zeros, model.poles, model.gain).to_ss()
    return signal.lsim(system, command, np.arange(len(command)) * DT)[1]


def whole(command: np.ndarray, accel: np.ndarray, period: int = 0) -> Record:
    """Return a record that is excitation from end to end."""
    return Record(command, np.atleast_2d(accel), Parts(slice(0, len(command)), period_samples=period))


def between(
    x: np.ndarray, y: np.ndarray, band: tuple[float, float], segment_s: float, kind: Estimator = "h1", period: int = 0
) -> Frf:
    """Return the response from x to y, taken as they are."""
    return responses([whole(x, y, period)], [x], [[y]], DT, band, segment_s, kind)[0]


def test_h1_is_that_of_scipy() -> None:
    random = np.random.default_rng(0)
    x = random.standard_normal(40000)
    y = signal.lfilter([0.2, 0.3], [1.0, -0.6], x) + 0.3 * random.standard_normal(40000) + 5.0
    frf = between(x, y, (1.0, 400.0), 2.0)
    options = {"fs": 1.0 / DT, "window": "hann", "nperseg": 4000, "noverlap": 2000, "detrend": "constant"}
    f, cross = signal.csd(x, y, **options)
    lines = np.searchsorted(f, frf.frequency_hz - 1e-6)
    assert frf.response == pytest.approx((cross / signal.welch(x, **options)[1])[lines], rel=1e-9)
    assert frf.coherence == pytest.approx(signal.coherence(x, y, **options)[1][lines], rel=1e-9)


def test_standard_error_is_the_scatter_of_repeated_records() -> None:
    random = np.random.default_rng(1)
    records = []
    for _ in range(40):
        x = random.standard_normal(12000)
        records.append(between(x, x + random.standard_normal(12000), (10.0, 800.0), 0.5))
    scatter = np.std([np.abs(r.response) for r in records], axis=0).mean()
    assert np.mean([r.relative_error for r in records]) == pytest.approx(scatter, rel=0.1)


def test_double_differentiator_is_free_of_bias_at_low_frequency() -> None:
    command = shaped_noise(100.0, DT, 0.3, 60.0, np.random.default_rng(2))
    numerator, denominator = signal.butter(2, 30.0, fs=1.0 / DT)
    output = signal.lfilter(np.convolve(numerator, [1.0, -2.0, 1.0]), denominator, command)
    frf = estimate([whole(command, output)], DT, (0.4, 1.5), 10.0)[0]
    naive = between(command, output, (0.4, 1.5), 10.0)
    truth = signal.freqz(np.convolve(numerator, [1, -2, 1]), denominator, frf.frequency_hz, fs=1.0 / DT)[1]
    assert np.abs(frf.response / truth - 1.0).max() < 0.004
    assert np.abs(naive.response / truth - 1.0).max() > 0.01


@pytest.mark.campaign
def test_leakage_of_a_light_specimen_is_taken_out() -> None:
    command = shaped_noise(120.0, DT, 0.3, 60.0, np.random.default_rng(3))
    command = faded(command, 4.0, DT)
    truth, near = make_model(3.2, 0.005), make_model(3.2003, 0.00505)
    noise = slice(100, len(command))
    measured = response_in_time(truth, command)
    record = Record(command, measured[None], Parts(noise))
    raw = estimate([record], DT, (0.5, 20.0), 15.0)[0]
    clean = without_leakage(raw, near, [record], 15.0)
    exact = truth.sampled_response(raw.frequency_hz)
    assert np.abs(raw.response / exact - 1.0).max() > 0.2
    assert np.abs(clean.response / exact - 1.0).max() < 0.04


@pytest.mark.campaign
def test_simulation_is_the_response_in_time_with_the_staircase_alias() -> None:
    command = faded(shaped_noise(60.0, DT, 0.3, 20.0, np.random.default_rng(4)), 4.0, DT)
    alias = np.concatenate([[0.0, 0.0], np.diff(command)[:-1]])
    expected = response_in_time(make_model(3.2, 0.04), command) - 1.5 * alias
    got = simulate(make_model(3.2, 0.04, -1.5), command, 80.0)
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()


def test_short_record_is_refused() -> None:
    with pytest.raises(InputError, match="shorter than 4 segments"):
        between(np.zeros(15000), np.zeros(15000), (1.0, 50.0), 2.0)
    with pytest.raises(InputError, match="shorter than 3 periods"):
        between(np.zeros(15000), np.zeros(15000), (1.0, 50.0), 2.0, period=6000)


def noisy_pair(at_input: float, at_output: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a measured input and an output twice the true input, with white noise of these shares on either."""
    random = np.random.default_rng(7)
    true = random.standard_normal(400000)
    return (
        true + at_input * random.standard_normal(true.size),
        2.0 * true + 2.0 * at_output * random.standard_normal(true.size),
    )


@pytest.mark.parametrize(
    ("at_input", "at_output", "expected"),
    [
        (0.0, 0.5, {"h1": 2.0, "h2": 2.0 * 1.25, "hv": 2.0 * 1.25**0.5}),
        (0.5, 0.0, {"h1": 2.0 / 1.25, "h2": 2.0, "hv": 2.0 / 1.25**0.5}),
        (0.5, 0.5, {"h1": 2.0 / 1.25, "h2": 2.0 * 1.25, "hv": 2.0}),
    ],
)
def test_estimators_are_right_where_their_noise_is(
    at_input: float, at_output: float, expected: dict[Estimator, float]
) -> None:
    x, y = noisy_pair(at_input, at_output)
    for kind, value in expected.items():
        mean = float(np.mean(np.abs(between(x, y, (10.0, 900.0), 1.0, kind).response)))
        assert mean == pytest.approx(value, rel=0.01)


def test_several_records_count_as_one_long_one() -> None:
    random = np.random.default_rng(8)
    x = random.standard_normal(40000)
    y = signal.lfilter([0.2, 0.3], [1.0, -0.6], x) + 0.3 * random.standard_normal(40000)
    records = [whole(x[:20000], y[:20000]), whole(x[20000:], y[20000:])]
    both = responses(records, [x[:20000], x[20000:]], [[y[:20000], y[20000:]]], DT, (1.0, 400.0), 1.0, "h1")[0]
    options = {"fs": 1.0 / DT, "nperseg": 2000}
    spectra = [
        (signal.csd(r.command_v, r.accel_m_s2[0], **options)[1], signal.welch(r.command_v, **options)[1])
        for r in records
    ]
    f = signal.welch(x[:20000], **options)[0]
    lines = np.searchsorted(f, both.frequency_hz - 1e-6)
    expected = sum(cross for cross, _ in spectra) / sum(power for _, power in spectra)
    assert both.response == pytest.approx(expected[lines], rel=1e-9)
    assert both.averages > 30


@pytest.mark.campaign
def test_whole_periods_leak_nothing() -> None:
    model, period = make_model(3.2, 0.005), 20000
    lines = np.arange(3, 200)
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * np.random.default_rng(9).random(len(lines))) / lines**1.5
    command = np.tile(np.fft.irfft(spectrum, period), 14)
    settled = slice(10 * period, 14 * period)  # the transient of 0.5 % damping has died
    answer = response_in_time(model, command)
    record = Record(command, answer[None], Parts(settled, period_samples=period))
    f = np.arange(3, 200) / (period * DT)
    found = responses([record], [command], [[answer]], DT, (0.3, 19.95), 99.0, "h1")[0]
    assert found.frequency_hz == pytest.approx(f)
    truth = signal.freqs_zpk(model.zeros, model.poles, model.gain, 2.0 * np.pi * f)[1]
    assert np.abs(found.response / truth - 1.0).max() < 2e-3  # lsim itself errs by 1e-3
    assert found.coherence.min() > 1.0 - 1e-6


def test_noise_floor_is_what_pure_noise_shows() -> None:
    random = np.random.default_rng(10)
    command = np.concatenate([np.zeros(40000), random.standard_normal(200000)])
    accel = 0.05 * random.standard_normal(command.size)  # nothing but noise
    record = Record(command, accel[None], Parts(slice(40000, command.size), slice(0, 40000)))
    shown = responses([record], [command], [[accel]], DT, (10.0, 800.0), 2.0, "h1")[0]
    floor = noise_floor([record], shown, 0, DT)
    assert floor is not None
    assert np.sqrt(np.mean(floor**2)) == pytest.approx(np.sqrt(np.mean(np.abs(shown.response) ** 2)), rel=0.1)
    assert noise_floor([whole(command, accel)], shown, 0, DT) is None


@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
def test_a_dead_channel_has_no_coherence_and_no_response(estimator: Estimator) -> None:
    """No evidence, and no division by zero: a NaN would pass for coherent where it is compared with a limit."""
    command = np.random.default_rng(1).normal(size=40_000)
    answer = np.diff(command, 2, prepend=[0.0, 0.0])
    with np.errstate(all="raise"):
        alive, dead = estimate((whole(command, np.vstack([answer, 0.0 * answer])),), DT, (1.0, 100.0), 2.0, estimator)
    assert not dead.coherence.any() and not dead.response.any() and np.isinf(dead.relative_error).all()
    assert alive.coherence == pytest.approx(1.0) and np.isfinite(alive.relative_error).all()
