"""H1 against scipy's spectra, a known system and the scatter of repeated records; leakage against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from rths_cli.errors import InputError
from rths_cli.identification.excitation import faded, shaped_noise
from rths_cli.identification.frf import estimate, h1, simulate, without_leakage
from rths_cli.lti import Model

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


def test_h1_is_that_of_scipy() -> None:
    random = np.random.default_rng(0)
    x = random.standard_normal(40000)
    y = signal.lfilter([0.2, 0.3], [1.0, -0.6], x) + 0.3 * random.standard_normal(40000) + 5.0
    frf = h1(x, y[None], DT, (1.0, 400.0), 2.0)[0]
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
        records.append(h1(x, (x + random.standard_normal(12000))[None], DT, (10.0, 800.0), 0.5)[0])
    scatter = np.std([np.abs(r.response) for r in records], axis=0).mean()
    assert np.mean([r.relative_error for r in records]) == pytest.approx(scatter, rel=0.1)


def test_double_differentiator_is_free_of_bias_at_low_frequency() -> None:
    command = shaped_noise(100.0, DT, 0.3, 60.0, np.random.default_rng(2))
    numerator, denominator = signal.butter(2, 30.0, fs=1.0 / DT)
    output = signal.lfilter(np.convolve(numerator, [1.0, -2.0, 1.0]), denominator, command)
    frf = estimate(command, output[None], DT, (0.4, 1.5), 10.0)[0]
    naive = h1(command, output[None], DT, (0.4, 1.5), 10.0)[0]
    truth = signal.freqz(np.convolve(numerator, [1, -2, 1]), denominator, frf.frequency_hz, fs=1.0 / DT)[1]
    assert np.abs(frf.response / truth - 1.0).max() < 0.004
    assert np.abs(naive.response / truth - 1.0).max() > 0.01


def test_leakage_of_a_light_specimen_is_taken_out() -> None:
    command = shaped_noise(120.0, DT, 0.3, 60.0, np.random.default_rng(3))
    command = faded(command, 4.0, DT)
    truth, near = make_model(3.2, 0.005), make_model(3.2003, 0.00505)
    noise = slice(100, len(command))
    measured = response_in_time(truth, command)
    raw = estimate(command[noise], measured[None, noise], DT, (0.5, 20.0), 15.0)[0]
    clean = without_leakage(raw, near, command, measured, noise)
    exact = truth.sampled_response(raw.frequency_hz)
    assert np.abs(raw.response / exact - 1.0).max() > 0.2
    assert np.abs(clean.response / exact - 1.0).max() < 0.04


def test_simulation_is_the_response_in_time_with_the_staircase_alias() -> None:
    command = faded(shaped_noise(60.0, DT, 0.3, 20.0, np.random.default_rng(4)), 4.0, DT)
    alias = np.concatenate([[0.0, 0.0], np.diff(command)[:-1]])
    expected = response_in_time(make_model(3.2, 0.04), command) - 1.5 * alias
    got = simulate(make_model(3.2, 0.04, -1.5), command, 80.0)
    assert np.abs(got - expected).max() < 2e-3 * np.abs(expected).max()


def test_short_record_is_refused() -> None:
    with pytest.raises(InputError, match="shorter than 4 segments"):
        h1(np.zeros(15000), np.zeros((1, 15000)), DT, (1.0, 50.0), 2.0)
