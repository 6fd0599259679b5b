"""Feedback on the tracking error: LQG with a coloured disturbance model, shaped by its sensitivity function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.control.realise import discretise, from_roots, static
from rths_cli.errors import InputError
from rths_cli.lti import Array, Block, ComplexArray, Frf, Model, StateSpace, staircase

INPUTS = ("tracking_error_m_s2",)
OUTPUTS = ("feedback_v",)
DISTURBANCE_HZ = (1.0, 12.0)  # band of the error that the feedback is to remove
COMMAND_WEIGHT = 0.01
NOISE_RANGE = (1e-3, 1e3)
BISECTIONS = 14
BAND_SHARE = 2.0 / 3.0  # of the identified band: the highest bandwidth a model is trusted with
LEAST_USE = 0.9

Plant = tuple[Array, Array, Array, Array, Array, Array]


@dataclass(frozen=True)
class Feedback:
    """A designed feedback and what it promises on the identified table.

    `sensitivity_peak` = max |S|, at `peak_hz`; `bandwidth_hz`: highest frequency at which the loop gain is one.
    """

    block: Block
    sensitivity_peak: float
    peak_hz: float
    bandwidth_hz: float


def none(dt_s: float) -> Block:
    """Return the feedback that does nothing."""
    return static(np.zeros((1, 1)), dt_s, "feedback", INPUTS, OUTPUTS)


def sampled_table(model: Model, dt_s: float) -> StateSpace:
    """Return the identified table in discrete time as A, B, C, D: command to smooth acceleration, hold included.

    A model with an explicit delay is sampled behind a hold (half a step of its delay) and delayed by the whole
    samples that remain; a model without one has the hold's lag in its roots already.
    """
    system = from_roots(model.zeros, model.poles, model.gain)
    held = model.delay_s > 0.0
    block = discretise(system, dt_s, "zoh" if held else "foh", "table", ("command_v",), ("accel_m_s2",))
    delay = max(round(model.delay_s / dt_s - 0.5), 0) if held else 0
    return _delayed(StateSpace(block.A, block.B, block.C, block.D), delay)


def _delayed(system: StateSpace, samples: int) -> StateSpace:
    """Return a discrete single-input system whose input is delayed by whole samples."""
    a, b, c, d = system.A, system.B, system.C, system.D
    for _ in range(samples):
        n = a.shape[0]
        a = np.block([[a, b], [np.zeros((1, n + 1))]])
        c, d = np.hstack([c, d]), np.zeros((1, 1))
        b = np.vstack([np.zeros((n, 1)), np.ones((1, 1))])
    return StateSpace(a, b, c, d)


def lqg(model: Model, noise: float, dt_s: float) -> Block:
    """Return the LQG regulator from tracking error to command (V).

    Table and disturbance are the plant: the error is minus the table's answer to the feedback command, minus a
    disturbance that is white noise through w_h s / ((s + w_l)(s + w_h)), band DISTURBANCE_HZ, minus white measurement
    noise of relative strength `noise`. The regulator minimises E[error^2 + r command^2], r small: the command costs
    COMMAND_WEIGHT times what it moves at the disturbance's upper corner. The observer is the predicting
    steady-state Kalman filter. More noise means less bandwidth.
    """
    plant = _plant(model, dt_s)
    return _regulator(plant, _regulator_gain(model, plant), noise, dt_s)


def _regulator_gain(model: Model, plant: Plant) -> Array:
    """Return the state feedback (1, n); it does not depend on the noise."""
    a, b, c, direct, _, _ = plant
    strength = abs(model.response(np.array(DISTURBANCE_HZ[1:]))[0])
    cost = direct.T @ direct + (COMMAND_WEIGHT * strength) ** 2
    return _riccati_gain(a, b, c.T @ c, cost, c.T @ direct)


def _regulator(plant: Plant, gain: Array, noise: float, dt_s: float) -> Block:
    """Return the regulator that a state feedback and the observer for this noise make."""
    a, b, c, direct, drive, drive_direct = plant
    variance = drive_direct @ drive_direct.T + noise**2
    observer = _riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T).T
    closed = a - b @ gain - observer @ (c - direct @ gain)
    return Block("feedback", closed, -observer, -gain, np.zeros((1, 1)), dt_s, INPUTS, OUTPUTS)


def _plant(model: Model, dt_s: float) -> Plant:
    """Return A, B, C, D of table and disturbance together, then B and D of the disturbance's white noise."""
    from scipy.linalg import block_diag

    table = sampled_table(model, dt_s)
    low, high = (2.0 * np.pi * f for f in DISTURBANCE_HZ)
    colour = from_roots(np.zeros(1, dtype=complex), np.array([-low, -high], dtype=complex), high)
    shape = discretise(colour, dt_s, "foh", "disturbance", ("w",), ("d",))
    n, m = table.A.shape[0], shape.A.shape[0]
    b = np.vstack([table.B, np.zeros((m, 1))])
    drive = np.vstack([np.zeros((n, 1)), shape.B])
    return block_diag(table.A, shape.A), b, np.hstack([table.C, shape.C]), table.D, drive, shape.D


def _riccati_gain(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array:
    """Return the gain of the discrete linear-quadratic regulator with cross weight s."""
    from scipy.linalg import solve_discrete_are

    cost = solve_discrete_are(a, b, q, r, s=s)
    return np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + s.T)


def sensitivity(feedback: Block, table: ComplexArray, frequency_hz: Array) -> ComplexArray:
    """Return S = 1 / (1 + table feedback), (n,), for a table response (n,) from command to acceleration."""
    return 1.0 / (1.0 + table * feedback.response(frequency_hz)[0, 0])


def grid_hz(dt_s: float) -> Array:
    """Return the frequencies on which a loop is judged, up to 0.4 times the sample rate, (800,)."""
    return np.geomspace(0.05, 0.4 / dt_s, 800)


def table_response(model: Model, measured: Frf | None, dt_s: float) -> ComplexArray:
    """Return the table's response on grid_hz: measured inside the model's band, the model outside."""
    grid = grid_hz(dt_s)
    response = model.response(grid)
    if measured is None:
        return response
    lowest, highest = model.band_hz
    inside = (lowest <= grid) & (highest >= grid)
    frequency = measured.frequency_hz
    alias = model.ripple_m_s2_per_v * staircase(frequency, model.latency_samples, model.dt_s)
    ratio = (measured.response - alias) / model.response(frequency)
    real = np.interp(grid[inside], frequency, ratio.real)
    imag = np.interp(grid[inside], frequency, ratio.imag)
    response[inside] *= real + 1j * imag
    return response


def is_stable(model: Model, block: Block, dt_s: float) -> bool:
    """Tell whether identified table and feedback together are stable (spectral radius below one)."""
    t = sampled_table(model, dt_s)
    through = np.eye(1) + t.D @ block.D
    inner = np.linalg.inv(through)
    closed = np.block(
        [
            [t.A - t.B @ block.D @ inner @ t.C, t.B @ block.C - t.B @ block.D @ inner @ t.D @ block.C],
            [-block.B @ inner @ t.C, block.A - block.B @ inner @ t.D @ block.C],
        ]
    )
    return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)


def design(
    model: Model, measured: Frf | None, dt_s: float, bandwidth_hz: float | None, max_sensitivity: float
) -> Feedback:
    """Return the fastest LQG feedback, found by bisection on the noise, that is stable with the model, keeps max |S|
    within its limit and crosses a loop gain of one at the wanted bandwidth or below (default and most: 2/3 of the
    identified band).

    Raises InputError when what remains takes less than a tenth off the error anywhere in DISTURBANCE_HZ.
    """
    most = BAND_SHARE * model.band_hz[1]
    wanted = most if bandwidth_hz is None else min(bandwidth_hz, most)
    table, plant = table_response(model, measured, dt_s), _plant(model, dt_s)
    gain = _regulator_gain(model, plant)
    low, high = NOISE_RANGE
    best = _judge(_regulator(plant, gain, high, dt_s), table)
    for _ in range(BISECTIONS):
        noise = float(np.sqrt(low * high))
        found = _judge(_regulator(plant, gain, noise, dt_s), table)
        fits = found.bandwidth_hz <= wanted and found.sensitivity_peak <= max_sensitivity
        if fits and is_stable(model, found.block, dt_s):
            high, best = noise, found
        else:
            low = noise
    if _least_sensitivity(best.block, table) > LEAST_USE:
        raise InputError(
            f"controller: no feedback with a sensitivity peak of {max_sensitivity:g} or less is of use on this table; "
            "use controller: FF, or raise max_sensitivity"
        )
    return best


def _least_sensitivity(block: Block, table: ComplexArray) -> float:
    """Return the smallest |S| in the band of the disturbance."""
    frequency = grid_hz(block.dt_s)
    inside = (frequency >= DISTURBANCE_HZ[0]) & (frequency <= DISTURBANCE_HZ[1])
    return float(np.abs(sensitivity(block, table, frequency))[inside].min())


def _judge(block: Block, table: ComplexArray) -> Feedback:
    """Return a feedback with its figures on the given table response (on grid_hz)."""
    frequency = grid_hz(block.dt_s)
    loop = table * block.response(frequency)[0, 0]
    size = np.abs(1.0 / (1.0 + loop))
    above = np.flatnonzero(np.abs(loop) > 1.0)
    crossing = float(frequency[above[-1]]) if above.size else 0.0
    peak = int(size.argmax())
    return Feedback(block, float(size[peak]), float(frequency[peak]), crossing)
