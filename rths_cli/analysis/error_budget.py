"""The error of a hybrid test that was run, split by cause from its signals.

The loop is linear: what was measured is what the identified rig makes of ground motion, of what disturbed the samples
(measured less what the identified rig answers to the commands that left) and of what was added to the command. The
disturbance is split once more: dry friction and an error of the table's gain and delay are fitted to it, what the
floors do otherwise than the identified specimen on the measured table is the specimen's. The parts add up instant by
instant; what is left over is stated. Where samples did not come, what the loop was given in their place less what they
would have been is a part of its own, and nothing is fitted to them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rths_cli.analysis.closed_loop_response import Motion, hybrid, on_perfect_table
from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import Errors, Known, samples_of_push
from rths_cli.identification.results import Friction
from rths_cli.numerics.lti import Array, ComplexArray

Booleans = NDArray[np.bool_]

BLOCKS = 10  # of a record, left out one at a time
MARGIN_S = 0.05  # before the end, where a series of low lines knows of the end already
FADE_S = 0.5  # before that margin, in which the record fades out of a fit
NEAR_S = 0.05  # on both sides of a gap, in which commands may not be what the blocks make
JOINED_S = 0.02  # of samples on both sides of a gap, to whose mean it is joined


def mended(samples: Array, predicted: Array, lost: Booleans, width: int = 1) -> Array:
    """Return samples (c, n) that follow a prediction (c, n) where they were `lost` (n,), shifted so that they join the
    mean of the nearest ones on both sides, up to `width` of them; what is not lost stays."""
    came = np.flatnonzero(~lost)
    if not came.size:
        return predicted.copy()
    every, box = np.arange(lost.size), np.ones(min(width, lost.size))
    off = np.where(lost, 0.0, samples - predicted)
    count = np.convolve(~lost, box, "same")[came]
    means = [np.convolve(row, box, "same")[came] / count for row in off]
    return np.where(lost, predicted + np.array([np.interp(every, came, mean) for mean in means]), samples)


def at_full_rate(lines: Lines, rows: ComplexArray) -> Array:
    """Return the series (..., n) of lines (..., m) at the record's own sample rate."""
    return np.fft.irfft(rows, lines.padded)[..., : lines.samples]


def inside(lines: Lines) -> Array:
    """Return one inside the record and a slope to zero before its end, at the reduced rate."""
    time_s = np.arange(lines.series(np.zeros(lines.count, dtype=complex)).size) * lines.reduced_dt_s
    return np.clip((lines.samples * lines.dt_s - MARGIN_S - time_s) / FADE_S, 0.0, 1.0)


def bursts(lines: Lines, row: ComplexArray, lost: Booleans) -> ComplexArray:
    """Return the lines (m,) of what a series given by lines does within NEAR_S of `lost` steps (n,), beyond a straight
    line from one end of such a stretch to the other."""
    series = lines.series(row)[None]
    at_s = np.arange(series.shape[1]) * lines.reduced_dt_s
    gaps_s = np.flatnonzero(lost) * lines.dt_s
    after = np.searchsorted(gaps_s, at_s)
    distance = np.minimum(
        np.abs(at_s - gaps_s[np.minimum(after, gaps_s.size - 1)]), np.abs(at_s - gaps_s[np.maximum(after - 1, 0)])
    )
    calm = mended(series, np.zeros_like(series), distance < NEAR_S)
    return _lines(lines, (series - calm)[0])


def weighted_in_time(lines: Lines, rows: ComplexArray, weight: Array) -> ComplexArray:
    """Return the lines (..., m) of series given by lines, after a weight of every instant (at the reduced rate)."""
    return _lines(lines, lines.series(rows) * weight)


def scatter(lines: Lines, rows: ComplexArray, wanted: ComplexArray) -> Array:
    """Return the standard uncertainties (k,) of the real factors of rows (k, m) that make most of lines (m,).

    The factors are found again and again without one of BLOCKS parts of the record, so that whatever is left over may
    depend on time and on frequency. Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), Eq. 11.5.
    """
    series = lines.series(np.vstack([rows, wanted[None]]))
    size = np.linalg.norm(series[:-1], axis=1)
    size[size == 0.0] = 1.0
    series[:-1] /= size[:, None]
    parts = np.array_split(series, BLOCKS, axis=1)
    powers = np.array([part @ part.T for part in parts])
    left = powers.sum(axis=0) - powers
    found = [np.linalg.lstsq(power[:-1, :-1], power[:-1, -1], rcond=1e-12)[0] for power in left]
    return np.sqrt((BLOCKS - 1) * np.var(found, axis=0)) / size


def _lines(lines: Lines, series: Array) -> ComplexArray:
    """Return the lines (..., m) of series at the reduced rate."""
    return np.asarray(np.fft.rfft(series, lines.reduced)[..., : lines.count] * (lines.padded / lines.reduced))


CAUSES = ("declared", "coupling", "latency", "model", "friction", "specimen", "rounding", "rest")
DRIFT = "drift"  # a cause only where something was taken out of the sensors' samples
LOST = "lost"  # a cause only where steps are without samples
FITTED_HZ = (0.5, 15.0)  # of the disturbance, for friction, gain and delay
CUT_S = 0.5  # of the end, where the series break off
ASSUMED_SCALE = 0.01  # of the rms velocity: v_s of a friction that was not identified


@dataclass(frozen=True)
class Signals:
    """What a run measured, n samples: `desired` (3, n), `sim` (n_storeys, n) and `computed` (n_storeys - c, n), the
    storeys below the table, on the record's clock, `corrected` (c, n) and `command_v` (n,) as stored, n_p samples after
    they were made.

    `drift` (c, n): what was taken out of the samples after the run; the loop had `corrected` + `drift`. `lost` (n,):
    steps without samples of their own. With it the fits also leave out the record's end, where the series
    break off; None: everything is fitted.
    """

    desired: Array
    corrected: Array
    command_v: Array
    computed: Array
    sim: Array
    lost: NDArray[np.bool_] | None = None
    drift: Array | None = None


@dataclass(frozen=True)
class Budget:
    """RMS errors in the test band by cause, all together as measured, and what the parts leave over; and what was
    fitted, with standard uncertainties: `gain_error` and `delay_error_s` of the table (positive: more, late),
    `friction_v` as a command."""

    causes: Mapping[str, Errors]
    measured: Errors
    unexplained: Errors
    gain_error: float
    delay_error_s: float
    friction_v: float
    gain_uncertainty: float
    delay_uncertainty_s: float
    friction_uncertainty_v: float


def split(known: Known, signals: Signals) -> Budget:
    """Return the measured error by cause."""
    lines, loop, still = known.lines, known.loop, np.zeros_like(known.ground)
    command = lines.of(signals.command_v) / loop.ahead
    stored, came = lines.of(signals.corrected), lines.of(_samples(known, signals))
    corrected = stored / loop.ahead
    sim, reported = lines.of(signals.sim), np.vstack([lines.of(signals.computed), stored])
    desired = lines.of_motion(*signals.desired)
    drifted = np.zeros_like(stored) if signals.drift is None else lines.of(signals.drift)
    rounded, held = _added(known, signals, command - _wanted(known, desired, corrected[0] + drifted[0] / loop.ahead))
    disturbed = came / loop.ahead - loop.rig * command
    instants = None if signals.lost is None else inside(lines)
    parts, fitted = _disturbances(known, disturbed, command, signals.desired[1], instants)
    if held is not None:
        bridged = _disturbances(known, corrected - loop.rig * command, command, signals.desired[1], instants)[1]
        fitted = _less_sure(fitted, bridged)
    nominal = hybrid(loop, known.ground, np.zeros_like(disturbed))
    perfect = on_perfect_table(loop, known.floors, known.ground)
    quiet = np.zeros_like(nominal.tracking)
    series = {
        "declared": (sim - known.sim, quiet),
        "coupling": (known.sim - perfect.storeys, quiet),
        "latency": (perfect.storeys - nominal.storeys, nominal.tracking),
        "rounding": _error(hybrid(loop, still, np.zeros_like(disturbed), rounded)),
    } | {name: _error(hybrid(loop, still, part)) for name, part in parts.items()}
    if held is not None:
        series[LOST] = _error(hybrid(loop, still, (stored - came) / loop.ahead, held))
    if signals.drift is not None:
        moved, shown = hybrid(loop, still, drifted / loop.ahead), np.zeros_like(sim)
        shown[len(sim) - len(drifted) :] = drifted
        series[DRIFT] = (shown - moved.storeys, moved.tracking + drifted[0])
    measured = (sim - reported, lines.of(signals.desired[0]) - stored[0])
    left = tuple(whole - sum(pair[i] for pair in series.values()) for i, whole in enumerate(measured))
    causes = {name: _errors(known, *series[name]) for name in (*CAUSES, LOST, DRIFT) if name in series}
    return Budget(causes, _errors(known, *measured), _errors(known, *left), *fitted)


def _samples(known: Known, signals: Signals) -> Array:
    """Return the corrected samples (c, n), those that did not come replaced by what the identified rig answers to the
    commands, shifted to what came before and after."""
    if signals.lost is None or not signals.lost.any():
        return signals.corrected
    answer = at_full_rate(known.lines, known.loop.rig * known.lines.of(signals.command_v))
    width = 2 * round(JOINED_S / known.lines.dt_s) + 1
    return mended(signals.corrected, answer, signals.lost, width)


def _less_sure(fitted: tuple[float, ...], bridged: tuple[float, ...]) -> tuple[float, ...]:
    """Return fitted figures, their uncertainties grown by how far they depend on what stands for lost samples."""
    half = len(fitted) // 2
    moved = [a - b for a, b in zip(fitted[:half], bridged[:half], strict=True)]
    return (*fitted[:half], *(math.hypot(off, by) for off, by in zip(fitted[half:], moved, strict=True)))


def _added(known: Known, signals: Signals, added: ComplexArray) -> tuple[ComplexArray, ComplexArray | None]:
    """Return what rounding added to the command (m,), and what near steps without samples did (None: all came)."""
    if signals.lost is None or not signals.lost.any():
        return added, None
    held = bursts(known.lines, added, signals.lost)
    return added - held, held


def _error(motion: Motion) -> tuple[ComplexArray, ComplexArray]:
    return -motion.storeys, motion.tracking


def _errors(known: Known, storeys: ComplexArray, tracking: ComplexArray) -> Errors:
    return Errors(_rms(known, storeys), float(_rms(known, tracking)))


def _rms(known: Known, lines: ComplexArray) -> Array:
    return rms(known.lines.evaluated(lines, CUT_S))


def _wanted(known: Known, desired: ComplexArray, table: ComplexArray) -> ComplexArray:
    """Return the command that feedforward and feedback made of desired motion (3, m) and corrected table (m,)."""
    error = desired[0] / known.loop.ahead - table
    return np.sum(known.loop.feedforward * desired, axis=0) + known.loop.feedback * error


def _disturbances(
    known: Known, disturbed: ComplexArray, command: ComplexArray, velocity_m_s: Array, instants: Array | None
) -> tuple[dict[str, ComplexArray], tuple[float, ...]]:
    """Return the disturbance of the samples (c, m) by cause; gain error, delay error and friction that were fitted, and
    their standard uncertainties."""
    s = 2j * np.pi * known.lines.frequency_hz
    friction, more, friction_off = _friction(known, disturbed, command, velocity_m_s, instants)
    answer = known.loop.rig * command
    rows = (answer[0], -s * answer[0])
    (gain, late), off = _told(known, disturbed[0] - friction[0], rows, _felt(known), instants)
    parts = {"model": (gain - late * s) * answer, "friction": friction}
    left = disturbed[0] - parts["model"][0] - parts["friction"][0]
    parts["rest"] = known.floors * left
    parts["specimen"] = disturbed - sum(parts.values())
    identified = known.friction.command_v if known.friction else 0.0
    return parts, (gain, late, identified + more, *off, friction_off)


def _friction(
    known: Known,
    disturbed: ComplexArray,
    command: ComplexArray,
    velocity_m_s: Array,
    instants: Array | None = None,
) -> tuple[ComplexArray, float, float]:
    """Return what friction adds to the samples (c, m), by how many V it is more than identified, and how surely.

    Its size is told by sign(v) - c v, which neither gain nor delay can look like; what is more than identified acts
    with all of sign(v), because no model holds its linear part.
    """
    speed = float(rms(velocity_m_s)) or 1.0
    scale = known.friction.scale_m_s if known.friction else ASSUMED_SCALE * speed

    sign = known.lines.of(Friction(1.0, 0.0, math.inf, 0.0, scale).disturbance_v(velocity_m_s))
    velocity, through = known.lines.of(velocity_m_s), samples_of_push(known)
    shape = through * (sign + Friction(1.0, 0.0, speed, 0.0, scale).linear_s_per_m * velocity)
    as_identified = np.zeros_like(shape)
    if known.friction:
        as_identified = through * known.friction.command_v * (sign + known.friction.linear_s_per_m * velocity)
    answer, s = known.loop.rig[0] * command, 2j * np.pi * known.lines.frequency_hz
    rows = (shape[0], answer, s * answer)
    (more, *_), (off, *_) = _told(known, disturbed[0] - as_identified[0], rows, np.ones(len(command)), instants)
    return as_identified + more * through * sign, more, off


def _felt(known: Known) -> Array:
    """Return how much a disturbance of the table's motion moves the storeys, (m,): a mode feels it most."""
    moved = hybrid(known.loop, np.zeros_like(known.ground), known.floors)
    return np.sqrt(np.sum(np.abs(moved.storeys) ** 2, axis=0)) * known.lines.test_band()


def _told(
    known: Known, disturbed: ComplexArray, rows: tuple[ComplexArray, ...], weight: Array, instants: Array | None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the factors of rows as `_fitted` and their standard uncertainties, of the record's instants alone that
    have a weight (at the reduced rate; None: of all)."""
    both = np.vstack([*rows, disturbed[None]])
    if instants is not None:
        both = weighted_in_time(known.lines, both, instants)
    found = _fitted(known, both[-1], tuple(both[:-1]), weight)
    both = np.asarray(both * (weight * _inside(known)), dtype=complex)
    return found, tuple(float(off) for off in scatter(known.lines, both[:-1], both[-1]))


def _inside(known: Known) -> NDArray[np.bool_]:
    f = known.lines.frequency_hz
    return (f >= FITTED_HZ[0]) & (f <= FITTED_HZ[1])


def _fitted(known: Known, disturbed: ComplexArray, rows: tuple[ComplexArray, ...], weight: Array) -> tuple[float, ...]:
    """Return the real factors of rows (m,) that explain most of a disturbance (m,) between FITTED_HZ, weighted."""
    inside = _inside(known)
    scaled = [(weight * row)[inside] for row in (*rows, disturbed)]
    *parts, wanted = (np.concatenate([row.real, row.imag]) for row in scaled)
    matrix = np.array(parts).T
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq(matrix / size, wanted, rcond=1e-9)[0] / size
    return tuple(float(value) for value in found)
