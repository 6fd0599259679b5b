"""Smith predictor, LQG/LTR and H-infinity loop shaping against closed forms and a published example."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from rths_cli.control.compensator import Plant, definition_of, designed_law, made_up_plant
from rths_cli.control.compensators.hinf import robustified
from rths_cli.control.compensators.lqg_ltr import gains
from rths_cli.control.compensators.smith import predictor
from rths_cli.control.feedback import delayed
from rths_cli.control.tracking import loop
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, Model, StateSpace

DT_S, ANGLE = 1.0 / 4096.0, 2.0 * math.pi * 20.0
POLES = ANGLE * np.exp(1j * np.array([1.0, -1.0]) * math.acos(-0.7))


def plant(late: int = 0) -> Plant:
    """An actuator of second order, 20 Hz and 70 %, late by whole samples beside its hold."""
    model = Model(np.zeros(2, complex), POLES.astype(complex), ANGLE**2, (late + 0.5) * DT_S, (0.3, 20.0), dt_s=DT_S)
    return Plant(model, made_up_plant().specimen, DT_S, (0.3, 10.0), channels=2, interface="displacement")


def sampled(late: int = 0) -> StateSpace:
    a, b, c, d, _ = cont2discrete(tf2ss([ANGLE**2], [1.0, 1.4 * ANGLE, ANGLE**2]), DT_S)
    return delayed(StateSpace(a, b, c, d), late)


def response(system: StateSpace | Block, frequency_hz: Array) -> Array:
    eye = np.eye(len(system.A))
    z = np.exp(2j * np.pi * frequency_hz * DT_S)
    return np.array([(system.C @ np.linalg.solve(one * eye - system.A, system.B) + system.D)[0] for one in z])


def test_the_smith_predictor_has_the_characteristic_polynomial_without_delay() -> None:
    """40 samples of delay and a perfect model: the roots are those of PI and actuator without delay, those of the
    actuator itself, and zeros of the delays. The same PI without the predictor is unstable."""
    c, a = predictor(plant(40), 2.0, 60.0), sampled()
    pi = Block("pi", np.eye(1), 60.0 * DT_S * np.array([[1.0, -1.0]]), np.eye(1), 2.0 * np.array([[1.0, -1.0]]), DT_S)
    roots = np.linalg.eigvals(loop(c, sampled(40)).A)
    without = np.concatenate([np.linalg.eigvals(loop(pi, a).A), np.linalg.eigvals(a.A)])
    for one in without:
        assert np.abs(roots - one).min() < 1e-6
    assert np.sum(np.abs(roots) > 0.85) == len(without)
    assert np.abs(np.linalg.eigvals(loop(pi, sampled(40)).A)).max() > 1.0


def test_lqg_recovers_the_loop_of_the_state_feedback() -> None:
    """The loop at the command tends to k (s - A)^-1 B as the recovery grows, and the state feedback has the return
    difference of Kalman's equation, |1 + loop| >= 1."""
    a, b, c, d = tf2ss([1.0], [1.0, 1.4, 1.0])
    system = StateSpace(a, b, c, d)
    s, off = 1j * np.array([0.3, 1.0, 3.0, 8.0]), []
    for recovery in (1.0, 1e4, 1e8, 1e12):
        feedback, gain = gains(system, 0.5, 0.01, recovery)
        k, ki = feedback[:, :2], feedback[:, 2:]
        wanted = np.array([(k @ np.linalg.solve(one * np.eye(2) - a, b)).item() for one in s])
        integral = ki.item() / s * np.array([(c @ np.linalg.solve(one * np.eye(2) - a, b)).item() for one in s])
        assert np.all(np.abs(1.0 + wanted + integral) >= 1.0 - 1e-9)
        # of the Kalman filter, its input the plant's output, with the command that it makes
        filter_a = a - b @ k - gain @ c
        made = [(k @ np.linalg.solve(one * np.eye(2) - filter_a, gain)
                 @ (c @ np.linalg.solve(one * np.eye(2) - a, b))).item() for one in s]  # fmt: skip
        off.append(np.abs(np.array(made) - wanted).max() / np.abs(wanted).max())
    assert off[0] > 0.1 and off[3] < 0.01 and np.all(np.diff(off) < 0.0)


def test_the_robustness_of_the_shaped_loop_is_the_published_one() -> None:
    """1 / s: X = Z = 1, so gamma_min = sqrt(2). Skogestad and Postlethwaite, example 9.3: gamma_min = 2.34 for
    200 / ((10 s + 1) (0.05 s + 1)^2) shaped by (s + 2) / s. The controller attains gamma."""
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    assert robustified(StateSpace(none, one, one, none), 0.1)[1] == pytest.approx(math.sqrt(2.0), rel=1e-9)
    below = np.polymul([10.0, 1.0], np.polymul([0.05, 1.0], [0.05, 1.0]))
    shaped = StateSpace(*tf2ss(np.polymul([1.0, 2.0], [200.0]), np.polymul([1.0, 0.0], below)))
    controller, least = robustified(shaped, 0.1)
    assert least == pytest.approx(2.34, abs=0.005)
    s = 1j * np.logspace(-3, 3, 2000)
    g, k = (np.array([(one.C @ np.linalg.solve(x * np.eye(len(one.A)) - one.A, one.B)).item() for x in s])
            for one in (shaped, controller))  # fmt: skip
    sides = np.abs(1.0 / (1.0 - g * k)) * np.sqrt((1.0 + np.abs(g) ** 2) * (1.0 + np.abs(k) ** 2))
    assert 0.9 * least < sides.max() <= 1.1 * least * (1.0 + 1e-6)


@pytest.mark.parametrize("kind", ["smith", "lqg_ltr", "hinf"])
def test_the_loop_follows_slow_motions_and_refuses_accelerations(kind: str) -> None:
    """d, v and a of a slow sine: the displacement is that desired, to 8 %."""
    definition = definition_of(kind)
    block = designed_law(definition, definition.values({}), plant())
    assert isinstance(block, Block) and definition.source
    a = sampled()
    frequency_hz = np.array([0.5, 2.0])
    c, moved = response(block, frequency_hz), response(a, frequency_hz)[:, 0]
    s = 2j * np.pi * frequency_hz
    by = dict(zip(block.inputs, c.T, strict=True))
    of_desired = by["desired_disp_m"] + s * by["desired_vel_m_s"] + s**2 * by["desired_accel_m_s2"]
    closed = moved * of_desired / (1.0 - moved * by["measured_disp_m"])
    assert np.abs(closed - 1.0).max() < 0.08
    with pytest.raises(InputError, match=rf"controller: {kind} uses the measured displacement of an actuator"):
        designed_law(definition, definition.values({}), replace(plant(), interface="acceleration"))
