"""Feedforward compensator: the inverse of the identified table (paper, section 3)."""

from __future__ import annotations

import math

import numpy as np

from rths_cli.control.state_space import discretise, modal, residues, static
from rths_cli.numerics.lti import Block, ComplexArray, Model, StateSpace

INPUTS = ("desired_accel_m_s2", "desired_vel_m_s", "desired_disp_m")
OUTPUTS = ("feedforward_v",)
LEAK_HZ = 0.002
LEAST_LOW_PASS = 0.1  # of a sample: the delay of the low pass that makes an inverse proper


def direct(gain_m_per_v: float, dt_s: float) -> Block:
    """Return the table as delivered: absolute interface displacement over the low-frequency gain."""
    return static(np.array([[0.0, 0.0, 1.0 / gain_m_per_v]]), dt_s, "feedforward", INPUTS, OUTPUTS)


def leaky_inverse(model: Model, dt_s: float, leak_hz: float = LEAK_HZ) -> Block:
    """Return the printed inverse, driven by the desired acceleration alone; its two integrators leak at `leak_hz`
    so that it is stable. Bilinear: neither lag nor lead at low frequency."""
    finite = model.zeros[np.abs(model.zeros) > 1e-9]
    leak = -2.0 * np.pi * leak_hz
    c2, c1, weights, constant = split_double_pole(model.poles, finite, 1.0 / model.gain, leak)
    rest = modal(finite, weights, constant)
    n = rest.A.shape[0]
    a = np.block([[rest.A, np.zeros((n, 2))], [np.zeros((2, n)), np.array([[leak, 1.0], [0.0, leak]])]])
    b, c = np.vstack([rest.B, [[0.0], [1.0]]]), np.hstack([rest.C, [[c2, c1]]])
    block = discretise(StateSpace(a, b, c, rest.D), dt_s, "bilinear", "feedforward", INPUTS[:1], OUTPUTS)
    return _with_motion(block, 0.0, 0.0)


def lagged_inverse(model: Model, dt_s: float, lead_samples: int) -> Block:
    """Return the inverse that lags exactly `lead_samples`, without an integrator of its own.

    exp(s (delay - n_p dt)) / G(s) is taken as D(s) / (gain s^2 N(s)) times a low pass of the delay
    n_p dt - model.delay_s that is left. Its double pole at the origin is c2 / s^2 + c1 / s: these act on the desired
    displacement and velocity, which numerical part and record know, the stable rest on the desired acceleration.
    """
    left = lead_samples * dt_s - model.delay_s
    low_pass = low_pass_poles(left, len(model.poles) - len(model.zeros))
    finite = model.zeros[np.abs(model.zeros) > 1e-9]
    poles = np.concatenate([finite, low_pass])
    gain = float(np.real(np.prod(-low_pass))) / model.gain
    c2, c1, weights, constant = split_double_pole(model.poles, poles, gain, 0.0)
    block = discretise(modal(poles, weights, constant), dt_s, "foh", "feedforward", INPUTS[:1], OUTPUTS)
    return _with_motion(block, c1, c2)


def lead_samples(model: Model, dt_s: float) -> int:
    """Return the fewest whole samples that a lagged inverse can lag: the model's delay, and some of a sample more where
    the inverse is proper only behind a low pass, which takes that time."""
    needed = model.delay_s + (LEAST_LOW_PASS * dt_s if len(model.poles) > len(model.zeros) else 0.0)
    return math.ceil(needed / dt_s - 1e-9)


def low_pass_poles(delay_s: float, order: int) -> ComplexArray:
    """Return the poles of a Bessel low pass (unit gain) of this order whose low-frequency delay is `delay_s`."""
    poles: ComplexArray = np.roots(_bessel_polynomial(order)).astype(complex)
    return np.asarray(poles[np.argsort(-poles.imag)] / delay_s)


def _bessel_polynomial(order: int) -> list[float]:
    """Return the reverse Bessel polynomial, highest power first: (2 n - k)! / (2^(n - k) k! (n - k)!) at s^k."""
    return [
        math.factorial(2 * order - k) / (2 ** (order - k) * math.factorial(k) * math.factorial(order - k))
        for k in range(order, -1, -1)
    ]


def split_double_pole(
    zeros: ComplexArray, poles: ComplexArray, gain: float, at: float
) -> tuple[float, float, ComplexArray, float]:
    """Split a double pole off: H(s) / (s - at)^2, H = gain prod(s - z) / prod(s - p), into
    c2 / (s - at)^2 + c1 / (s - at) + sum w / (s - p) + constant."""
    value = gain * np.prod((at - zeros[: len(poles)]) / (at - poles)) * np.prod(at - zeros[len(poles) :])
    slope = value * (np.sum(1.0 / (at - zeros)) - np.sum(1.0 / (at - poles)))
    weights = residues(zeros, poles, gain) / (poles - at) ** 2
    constant = gain if len(zeros) == len(poles) + 2 else 0.0
    return float(value.real), float(slope.real), weights, constant


def _with_motion(block: Block, velocity_v: float, displacement_v: float) -> Block:
    """Return a single-input block widened by static gains on desired velocity and displacement."""
    n = block.A.shape[0]
    b = np.hstack([block.B, np.zeros((n, 2))])
    d = np.array([[block.D[0, 0], velocity_v, displacement_v]])
    return Block(block.name, block.A, b, block.C, d, block.dt_s, INPUTS, OUTPUTS)
