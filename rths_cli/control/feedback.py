"""Feedback on the tracking error: LQG with a coloured disturbance model, limited by its sensitivity peak."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rths_cli.control.continued_table import ContinuedTable
from rths_cli.control.margins import (
    Margins,
    bandwidth_hz,
    loop_curve,
    margins,
    sensitivity_peak,
    worst_sensitivity_peak,
)
from rths_cli.control.state_space import discretise, from_roots, static
from rths_cli.errors import InputError
from rths_cli.numerics.bands import TEST_BAND_HZ, with_test_band
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model, StateSpace
from rths_cli.numerics.matrix_equations import riccati_gain

INPUTS = ("tracking_error_m_s2", "feedback_shortfall_v")
OUTPUTS = ("feedback_v",)
NOISE_RANGE = (1e-3, 1e3)
BISECTIONS = 14
BAND_SHARE = 2.0 / 3.0  # of the identified band: the highest bandwidth a model is trusted with
LEAST_USE = 0.9
DOUBTFUL = 0.1  # relative error of a line that says nothing of the loop
LAST_LINES = 20  # of the measured response, from which the model goes on
ROLL_OFFS = (0.5,)  # corners over the end of the identified band, tried where the plain feedback is too loud
QUIETER = 0.95  # of the permitted gain: the check looks at other frequencies
AROUND_ROOT = np.linspace(-4.0, 4.0, 25)  # half widths of a resonance at which a loop is judged

Plant = tuple[Array, Array, Array, Array, Array, Array]


@dataclass(frozen=True)
class Weights:
    """What the regulator is designed for: the band of the error that it removes, what a command costs, and the corner
    of its command's high pass (0: none).

    The default frequencies belong to the usual test band.
    """

    disturbance_hz: tuple[float, float] = (1.0, TEST_BAND_HZ)
    command_weight: float = 0.01
    high_pass_hz: float = 0.1

    def for_test_band(self, test_band_hz: float) -> Weights:
        """Return the weights for another test band, to which the frequencies keep their ratios."""
        low, high, corner = (with_test_band(hz, test_band_hz) for hz in (*self.disturbance_hz, self.high_pass_hz))
        return Weights((low, high), self.command_weight, corner)


DEFAULT = Weights()


@dataclass(frozen=True)
class Table:
    """The identified table on which a loop is judged, (n,) each: `measured` where it was, the model's way elsewhere;
    `modelled` everywhere the model; `relative_error`: standard error of |measured| over |measured|, 0 elsewhere;
    `permitted`: largest gain of the feedback in V per m/s^2, infinite where the table is known."""

    frequency_hz: Array
    measured: ComplexArray
    modelled: ComplexArray
    relative_error: Array
    permitted: Array


@dataclass(frozen=True)
class Feedback:
    """A designed feedback and what it promises: margins with the measured table response and with its model alone.

    `worst_peak` = max |S| when every measured line is off by two standard errors in the worst direction. `same_side`:
    measured and modelled loop go round -1 alike, so that both are stable or neither is.
    """

    block: Block
    measured: Margins
    modelled: Margins
    worst_peak: float
    same_side: bool

    @property
    def sensitivity_peak(self) -> float:
        """Return max |S| with the measured response."""
        return self.measured.sensitivity_peak

    @property
    def bandwidth_hz(self) -> float:
        """Return the highest frequency at which the loop gain is one, with the measured response."""
        return self.measured.bandwidth_hz


def none(dt_s: float) -> Block:
    """Return the feedback that does nothing."""
    return static(np.zeros((1, 2)), dt_s, "feedback", INPUTS, OUTPUTS)


def sampled_table(model: Model, dt_s: float) -> StateSpace:
    """Return the identified table in discrete time as A, B, C, D: command to smooth acceleration, hold included.

    A model with an explicit delay is sampled behind a hold (half a step of its delay) and delayed by the whole
    samples that remain; a model without one has the hold's lag in its roots already.
    """
    system = from_roots(model.zeros, model.poles, model.gain)
    held = model.delay_s > 0.0
    block = discretise(system, dt_s, "zoh" if held else "foh", "table", ("command_v",), ("accel_m_s2",))
    delay = max(round(model.delay_s / dt_s - 0.5), 0) if held else 0
    return delayed(StateSpace(block.A, block.B, block.C, block.D), delay)


def delayed(system: StateSpace, samples: int) -> StateSpace:
    """Return a discrete single-input system whose input is delayed by whole samples."""
    a, b, c, d = system.A, system.B, system.C, system.D
    for _ in range(samples):
        n = a.shape[0]
        a = np.block([[a, b], [np.zeros((1, n + 1))]])
        c, d = np.hstack([c, d]), np.zeros((1, 1))
        b = np.vstack([np.zeros((n, 1)), np.ones((1, 1))])
    return StateSpace(a, b, c, d)


def lqg(model: Model, noise: float, dt_s: float, weights: Weights = DEFAULT) -> Block:
    """Return the LQG regulator from tracking error, and what the command lacked of the one wanted (V), to command (V).

    Table and disturbance are the plant: the error is minus the table's answer to the feedback command, minus a
    disturbance that is white noise through w_h s / ((s + w_l)(s + w_h)), band `disturbance_hz`, minus white measurement
    noise of relative strength `noise`. The regulator minimises E[error^2 + r command^2], r small: the command costs
    `command_weight` times what it moves at the disturbance's upper corner. The observer is the predicting
    steady-state Kalman filter; it is told what a limit took off the command, so that a limit does not wind it up.
    More noise means less bandwidth.

    The command passes a high pass: an offset of the table's sensor, of which the correction of an AC coupling makes a
    line, moves the table aside by a bounded distance instead of driving it to its stop. The default one of 0.1 Hz
    leads by 6 degrees at 1 Hz, the lower end of the disturbance.
    """
    return _with_noise(_known_plant(model, sampled_table(model, dt_s), dt_s, weights), noise, dt_s, weights)


class KnownPlant(NamedTuple):
    """The plant of the regulator with its state feedback and what a roll-off makes of the command.

    With a roll-off the plant's command v is filtered before it is sent: u = `sent` x + `sent_direct` v. A shortfall s
    of u enters the plant by `short` and the error by `short_direct`.
    """

    plant: Plant
    gain: Array  # (1, n)
    sent: Array  # (1, n)
    sent_direct: Array  # (1, 1)
    short: Array  # (n, 1)
    short_direct: Array  # (1, 1)


def _known_plant(
    model: Model, table: StateSpace, dt_s: float, weights: Weights, roll_off_hz: float = 0.0
) -> KnownPlant:
    """Return the plant with its state feedback; `roll_off_hz`: corner of a low pass of second order (Butterworth) that
    the command passes and that the regulator knows, 0: none."""
    if roll_off_hz == 0.0:
        plant = lqg_plant(table, dt_s, weights)
        gain = regulator_gain(model, plant, weights)
        return KnownPlant(plant, gain, np.zeros_like(gain), np.ones((1, 1)), plant[1], plant[3])
    corner = 2.0 * np.pi * roll_off_hz
    poles = np.asarray(corner * np.exp(1j * np.pi * np.array([0.75, -0.75])), dtype=complex)
    low = discretise(from_roots(np.zeros(0, dtype=complex), poles, corner**2), dt_s, "foh", "roll_off", ("v",), ("u",))
    n, m = len(low.A), len(table.A)
    both = StateSpace(
        np.block([[low.A, np.zeros((n, m))], [table.B @ low.C, table.A]]),
        np.vstack([low.B, table.B @ low.D]),
        np.hstack([table.D @ low.C, table.C]),
        table.D @ low.D,
    )
    plant = lqg_plant(both, dt_s, weights)
    gain = regulator_gain(model, plant, weights)
    sent, short = np.zeros_like(gain), np.zeros_like(plant[1])
    sent[:, :n], short[n : n + m] = low.C, table.B
    return KnownPlant(plant, gain, sent, low.D, short, table.D)


def regulator_gain(model: Model, plant: Plant, weights: Weights) -> Array:
    """Return the state feedback (1, n) in V per state of the plant; it does not depend on the noise."""
    a, b, c, direct, _, _ = plant
    strength = abs(model.response(np.array(weights.disturbance_hz[1:]))[0])
    cost = direct.T @ direct + (weights.command_weight * strength) ** 2
    return riccati_gain(a, b, c.T @ c, cost, c.T @ direct)


def _with_noise(known: KnownPlant, noise: float, dt_s: float, weights: Weights) -> Block:
    """Return the regulator that a state feedback K and the observer L for this noise make, with its high pass.

    v = -K x, x+ = A x + B v + B_s s + L (-e - C x - D v - D_s s): e is the tracking error and s the shortfall, applied
    less wanted command. The command is u = y - w, where y is v or what the roll-off makes of it, and
    w+ = w + (1 - p) (u + s), which is the high pass (z - 1) / (z - p). It sums the command that was applied, so that a
    limit does not wind it up either. The state is x, w; without a high pass it is x.
    """
    a, b, c, direct, drive, drive_direct = known.plant
    variance = drive_direct @ drive_direct.T + noise**2
    observer = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T).T
    shortfall, states = known.short - observer @ known.short_direct, len(a)
    closed = a - b @ known.gain - observer @ (c - direct @ known.gain)
    made = known.sent - known.sent_direct @ known.gain
    if weights.high_pass_hz == 0.0:
        through, nothing = np.hstack([-observer, shortfall]), np.zeros((1, 2))
        return Block("feedback", closed, through, made, nothing, dt_s, INPUTS, OUTPUTS)
    share = -math.expm1(-2.0 * math.pi * weights.high_pass_hz * dt_s)
    whole = np.block([[closed, np.zeros((states, 1))], [share * made, np.array([[1.0 - share]])]])
    inputs = np.block([[-observer, shortfall], [np.array([[0.0, share]])]])
    outputs = np.hstack([made, [[-1.0]]])
    return Block("feedback", whole, inputs, outputs, np.zeros((1, 2)), dt_s, INPUTS, OUTPUTS)


def unlimited(feedback: Block) -> Block:
    """Return the feedback while no limit acts: its path from tracking error to command alone."""
    b, d = feedback.B[:, :1], feedback.D[:, :1]
    return Block(feedback.name, feedback.A, b, feedback.C, d, feedback.dt_s, feedback.inputs[:1], feedback.outputs)


def lqg_plant(table: StateSpace, dt_s: float, weights: Weights) -> Plant:
    """Return A (n, n), B (n, 1), C (1, n), D (1, 1) of sampled table and disturbance together, from command in V to
    acceleration in m/s^2, then B (n, 1) and D (1, 1) of the disturbance's white noise."""
    low, high = (2.0 * np.pi * f for f in weights.disturbance_hz)
    colour = from_roots(np.zeros(1, dtype=complex), np.array([-low, -high], dtype=complex), high)
    shape = discretise(colour, dt_s, "foh", "disturbance", ("w",), ("d",))
    n, m = table.A.shape[0], shape.A.shape[0]
    b = np.vstack([table.B, np.zeros((m, 1))])
    drive = np.vstack([np.zeros((n, 1)), shape.B])
    a = np.block([[table.A, np.zeros((n, m))], [np.zeros((m, n)), shape.A]])
    return a, b, np.hstack([table.C, shape.C]), table.D, drive, shape.D


def sensitivity(feedback: Block, table: ComplexArray, frequency_hz: Array) -> ComplexArray:
    """Return S = 1 / (1 + table feedback), (n,), for a table response (n,) from command to acceleration."""
    return 1.0 / (1.0 + table * feedback.response(frequency_hz)[0, 0])


def grid_hz(model: Model, dt_s: float) -> Array:
    """Return the frequencies on which a loop is judged, (n,): up to 0.4 times the sample rate, dense at resonances."""
    lowest, highest = 0.05, 0.4 / dt_s
    roots = np.concatenate([model.zeros, model.poles])
    near = np.abs(roots)[:, None] + np.abs(roots.real)[:, None] * AROUND_ROOT
    grid = np.concatenate([np.geomspace(lowest, highest, 800), near.ravel() / (2.0 * np.pi)])
    logs = np.log(grid[(grid >= lowest) & (grid <= highest)])
    return np.exp(np.unique(np.round(logs, 6)))


def table_response(model: Model, measured: Frf | None, dt_s: float) -> Table:
    """Return the table's response on grid_hz: measured, less its alias, as far as good lines reach; below, the model.

    Above, the model goes on from the last lines. Where its roots stand for a part of the rig's declared latency they do
    so in their band only: there it is late by that part, and falls no faster than 1 / sqrt(f).
    """
    grid = grid_hz(model, dt_s)
    modelled = model.response(grid)
    good = np.zeros(0, dtype=bool) if measured is None else measured.relative_error <= DOUBTFUL
    if measured is None or not good.any():
        return Table(grid, modelled, modelled, np.zeros(grid.size), np.full(grid.size, np.inf))
    frequency, error = measured.frequency_hz[good], measured.relative_error[good]
    ratio = (measured.response[good] - model.alias(frequency)) / model.response(frequency)
    real, imag = (np.interp(grid, frequency, v, left=u) for v, u in ((ratio.real, 1.0), (ratio.imag, 0.0)))
    inside = (grid >= frequency[0]) & (grid <= frequency[-1])
    untold_s = max((model.latency_samples + 0.5) * dt_s - model.delay_s, 0.0)
    beyond = np.where(grid > frequency[-1], grid - frequency[-1], 0.0)
    joined = np.where(beyond > 0.0, ratio[-LAST_LINES:].mean(), real + 1j * imag)
    response = modelled * joined * np.exp(-2j * np.pi * beyond * untold_s)
    if untold_s > 0.0:
        loud = np.abs(model.response(frequency[-1:]) * joined[-1]) * np.sqrt(frequency[-1] / grid)
        response *= np.where(beyond > 0.0, np.maximum(loud / np.abs(response), 1.0), 1.0)
    relative = np.where(inside, np.interp(grid, frequency, error), 0.0)
    return Table(grid, response, modelled, relative, np.full(grid.size, np.inf))


def is_stable(model: Model, block: Block, dt_s: float) -> bool:
    """Tell whether identified table and feedback together are stable (spectral radius below one)."""
    return _holds(sampled_table(model, dt_s), block)


def _holds(t: StateSpace, block: Block) -> bool:
    """Tell whether sampled table and feedback together are stable."""
    k = unlimited(block)
    through = np.eye(1) + t.D @ k.D
    inner = np.linalg.inv(through)
    closed = np.block(
        [
            [t.A - t.B @ k.D @ inner @ t.C, t.B @ k.C - t.B @ k.D @ inner @ t.D @ k.C],
            [-k.B @ inner @ t.C, k.A - k.B @ inner @ t.D @ k.C],
        ]
    )
    return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)


def design(
    model: Model,
    measured: Frf | None,
    dt_s: float,
    bandwidth_hz: float | None,
    max_sensitivity: float,
    weights: Weights = DEFAULT,
    continued: ContinuedTable | None = None,
) -> Feedback:
    """Return the fastest LQG feedback, found by bisection on the noise, that is stable, keeps max |S| within its limit
    on measured response and model, and crosses a loop gain of one at the wanted bandwidth or below (default and most:
    2/3 of the identified band).

    With a `continued` table it must also be so quiet beyond the identified band that its loop is safe there whatever
    the table does (`ContinuedTable.permitted`). Where that would cost bandwidth, feedbacks with a roll-off are designed
    as well, and the one that takes most off the error is returned. Where none of them is of use, it is the one of no
    continued table, for the check to judge.

    Raises InputError when what remains takes less than a tenth off the error anywhere in `disturbance_hz`.
    """
    most = BAND_SHARE * model.band_hz[1]
    wanted = most if bandwidth_hz is None else min(bandwidth_hz, most)
    table, sampled = table_response(model, measured, dt_s), sampled_table(model, dt_s)

    def fastest(table: Table, roll_off_hz: float = 0.0) -> Block | None:
        known = _known_plant(model, sampled, dt_s, weights, roll_off_hz)
        return _fastest(known, table, sampled, wanted, max_sensitivity, dt_s, weights)

    best = fastest(table)
    if best is None:
        raise InputError(
            f"controller: no feedback with a sensitivity peak of {max_sensitivity:g} or less is of use on this table; "
            "use controller: FF, raise max_sensitivity or lower command_weight"
        )
    if continued is not None:
        limited = replace(table, permitted=continued.permitted(table.frequency_hz))
        if not _quiet(best, limited):
            corners = (0.0, *(share * continued.end_hz for share in ROLL_OFFS))
            found = [block for corner in corners if (block := fastest(limited, corner)) is not None]
            best = min(found, key=lambda block: _error_left(block, table, weights), default=best)
    return with_margins(best, table)


def _fastest(
    known: KnownPlant, table: Table, sampled: StateSpace, most_hz: float, max_sensitivity: float, dt_s: float,
    weights: Weights,
) -> Block | None:  # fmt: skip
    """Return the feedback with the least noise that keeps the limits, None where none is of use."""
    low, high = NOISE_RANGE
    best = _with_noise(known, high, dt_s, weights)
    useful = _keeps(best, table, most_hz, max_sensitivity)
    for _ in range(BISECTIONS):
        noise = float(np.sqrt(low * high))
        found = _attempt(known, noise, dt_s, weights)
        if found and _keeps(found, table, most_hz, max_sensitivity) and _holds(sampled, found):
            high, best, useful = noise, found, True
        else:
            low = noise
    if not useful or _least_sensitivity(best, table, weights.disturbance_hz) > LEAST_USE:
        return None
    return best


def _attempt(known: KnownPlant, noise: float, dt_s: float, weights: Weights) -> Block | None:
    """Return the feedback for this noise, None when it has no observer."""
    try:
        return _with_noise(known, noise, dt_s, weights)
    except InputError:
        return None


def _quiet(block: Block, table: Table) -> bool:
    """Tell whether a feedback keeps its gain within the permitted one."""
    return bool(np.all(np.abs(block.response(table.frequency_hz)[0, 0]) <= QUIETER * table.permitted))


def _error_left(block: Block, table: Table, weights: Weights) -> float:
    """Return the mean of |S|^2 over the logarithmic frequencies of the disturbance."""
    inside = (table.frequency_hz >= weights.disturbance_hz[0]) & (table.frequency_hz <= weights.disturbance_hz[1])
    at = np.log(table.frequency_hz[inside])
    left = np.abs(sensitivity(block, table.measured, table.frequency_hz)[inside]) ** 2
    return float(np.trapezoid(left, at) / (at[-1] - at[0]))


def _keeps(block: Block, table: Table, most_hz: float, max_sensitivity: float) -> bool:
    """Tell whether a feedback keeps all limits, and is stable on the measured response if it is with the model."""
    if not _quiet(block, table):
        return False
    loop, modelled = _loops(block, table)
    least = min(np.abs(1.0 + loop).min(), np.abs(1.0 + modelled).min())
    if not (_apart(loop, modelled) < 1.0 and least * max_sensitivity >= 1.0):  # on the points already; NaN keeps none
        return False
    curve = loop_curve(loop, table.frequency_hz)
    return (
        bandwidth_hz(curve) <= most_hz
        and sensitivity_peak(curve)[0] <= max_sensitivity
        and sensitivity_peak(loop_curve(modelled, table.frequency_hz))[0] <= max_sensitivity
    )


def _loops(block: Block, table: Table) -> tuple[ComplexArray, ComplexArray]:
    """Return the loop gain (n,) on the measured table and on the modelled one."""
    response = block.response(table.frequency_hz)[0, 0]
    return table.measured * response, table.modelled * response


def _apart(loop: ComplexArray, modelled: ComplexArray) -> float:
    """Return how far two loops are apart: below one they go round -1 alike (Rouche)."""
    return float(np.abs((1.0 + loop) / (1.0 + modelled) - 1.0).max())


def _least_sensitivity(block: Block, table: Table, band_hz: tuple[float, float]) -> float:
    """Return the smallest |S| in a band."""
    inside = (table.frequency_hz >= band_hz[0]) & (table.frequency_hz <= band_hz[1])
    return float(np.abs(sensitivity(block, table.measured, table.frequency_hz))[inside].min(initial=1.0))


def with_margins(block: Block, table: Table) -> Feedback:
    """Return a feedback with its margins on a table, measured and modelled."""
    loop, modelled = _loops(block, table)
    with_data = margins(loop, table.frequency_hz)
    worst = max(worst_sensitivity_peak(loop, table.relative_error), with_data.sensitivity_peak)
    on_model = margins(modelled, table.frequency_hz)
    return Feedback(block, with_data, on_model, worst, _apart(loop, modelled) < 1.0)
