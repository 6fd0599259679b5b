"""Inverses of the table: what they leave in the band, and that they are stable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S
from hybrid import true_model
from scipy.signal import bessel, freqs

from rths_cli.control import feedforward
from rths_cli.control.feedforward import direct, lagged_inverse, leaky_inverse, low_pass_poles
from rths_cli.numerics.lti import Block, Model

BAND_HZ = np.linspace(0.3, 12.0, 200)


def proper_model() -> Model:
    """Return a table of 8 poles and 8 zeros, as the paper fits one: its delay is in an extra pole and far zeros."""
    model = true_model(0.0)
    zeros = np.concatenate([model.zeros, [-2500.0, -4000.0]])
    poles = np.concatenate([model.poles, [-1300.0]])
    return replace(model, zeros=zeros, poles=poles, gain=model.gain * 1300.0 / (2500.0 * 4000.0))


def answer(block: Block, frequency_hz: np.ndarray) -> np.ndarray:
    """Return the response in V per m/s^2 of desired acceleration, velocity and displacement being its integrals."""
    s = 2j * np.pi * frequency_hz
    parts = block.response(frequency_hz)[0]
    return parts[0] + parts[1] / s + parts[2] / s**2


@pytest.mark.parametrize("leak_hz", [0.002, 0.05])
def test_the_printed_inverse_times_the_table_is_a_leaking_one(leak_hz: float) -> None:
    model = proper_model()
    block = leaky_inverse(model, DT_S, leak_hz)
    product = answer(block, BAND_HZ) * model.response(BAND_HZ) / np.sinc(BAND_HZ * DT_S)
    s = 2j * np.pi * BAND_HZ
    leak = (s / (s + 2.0 * np.pi * leak_hz)) ** 2
    assert np.abs(product / leak - 1.0).max() < 2e-3
    assert np.abs(product[BAND_HZ < 3.0] / leak[BAND_HZ < 3.0] - 1.0).max() < 1.5e-4
    assert np.abs(np.linalg.eigvals(block.A)).max() < 1.0
    assert (block.D[0, 1:] == 0.0).all()
    warped = np.tan(np.pi * BAND_HZ * DT_S) / (np.pi * DT_S)
    w = 2j * np.pi * warped
    exact = (w / (w + 2.0 * np.pi * leak_hz)) ** 2 / (model.response(warped) / np.sinc(warped * DT_S))
    assert np.abs(answer(block, BAND_HZ) / exact - 1.0).max() < 1e-8


@pytest.mark.parametrize(("delay_samples", "lead"), [(0.5, 1), (1.5, 2), (2.5, 3), (1.25, 3)])
def test_the_lagged_inverse_times_the_table_is_a_pure_lag(delay_samples: float, lead: int) -> None:
    """The product with the delayed table is z^-n_p; what is left is the low pass of the remaining delay."""
    model = true_model(delay_samples * DT_S)
    block = lagged_inverse(model, DT_S, lead)
    product = answer(block, BAND_HZ) * model.response(BAND_HZ)
    lag = np.exp(-2j * np.pi * BAND_HZ * lead * DT_S)
    left = 2.0 * np.pi * 12.0 * (lead - delay_samples) * DT_S
    assert np.abs(product / lag - 1.0).max() < 0.5 * left**2 + 2e-4  # a first-order lag for a pure one
    assert np.abs(np.angle(product / lag)).max() < left**3 / 3.0 + 1e-4
    assert np.abs(np.linalg.eigvals(block.A)).max() < 1.0


def test_without_its_three_inputs_together_the_inverse_is_none() -> None:
    """Desired displacement and velocity carry the double integrator: below the modes they carry nearly everything."""
    model = true_model(1.5 * DT_S)
    block, low = lagged_inverse(model, DT_S, 2), np.array([0.05])
    by_displacement = block.response(low)[0, 2] / (2j * np.pi * low) ** 2
    assert np.abs(by_displacement / answer(block, low) - 1.0) < 0.01
    assert block.D[0, 2] == pytest.approx(1.0 / 0.0079, rel=1e-9)


def test_the_split_of_the_double_integrator_is_the_function_itself() -> None:
    zeros = np.array([-3.0 + 5.0j, -3.0 - 5.0j, -7.0, -30.0])
    poles = np.array([-2.0 + 9.0j, -2.0 - 9.0j])
    for at, gain in ((0.0, 4.0), (-0.01, 4.0)):
        c2, c1, weights, constant = feedforward.split_double_pole(zeros, poles, gain, at)
        for s in (0.3j, 4.0j, 1.0 + 11.0j):
            whole = gain * np.prod(s - zeros) / np.prod(s - poles) / (s - at) ** 2
            parts = c2 / (s - at) ** 2 + c1 / (s - at) + np.sum(weights / (s - poles)) + constant
            assert parts == pytest.approx(whole, rel=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_low_pass_delays_by_what_is_left(order: int) -> None:
    poles = low_pass_poles(2e-4, order)
    b, a = bessel(order, 1.0 / 2e-4, analog=True, norm="delay")
    s = 2.0 * np.pi * np.array([1.0, 10.0, 40.0])
    found = np.prod(-poles) / np.prod(1j * s[:, None] - poles, axis=1)
    assert found == pytest.approx(freqs(b, a, s)[1], rel=1e-9)
    assert -np.angle(found[:2]) / s[:2] == pytest.approx([2e-4, 2e-4], rel=1e-3)
    assert low_pass_poles(2e-4, 0).size == 0


def test_the_table_as_delivered_takes_displacement_over_gain() -> None:
    assert np.array_equal(direct(0.0079, DT_S).D, [[0.0, 0.0, 1.0 / 0.0079]])
