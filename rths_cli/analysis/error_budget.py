"""The error budget after a run: EXP-RTHS's error split by cause, from its signals.

The loop is linear. Its measured motion is the sum of the responses to the ground motion, to a disturbance of the
samples (measured samples minus the identified rig's response to the commands that were sent), and to a disturbance of
the command. The disturbance of the samples is divided further: dry friction and an error of the table's gain and delay
are fitted to it; what is not significant of a fitted value stays in the remainder. The difference between the floors
and the identified specimen on the measured table is the specimen's part. The parts are time series that add up to the
error; the remainder is stated. If samples were lost, the substituted samples minus the missing ones, as reconstructed,
are a separate part, and nothing is fitted to these samples.

Storeys with laws are not linear. There the loop is not solved on lines but played with one disturbance after the other
(`Undisturbed`): each part is then the change by its disturbance beside those before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rths_cli.analysis.closed_loop import hybrid, on_perfect_table
from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import Errors, PredictionInputs, samples_of_push
from rths_cli.identification.results import Friction
from rths_cli.numerics.bands import with_test_band
from rths_cli.numerics.lti import Array, ComplexArray

Booleans = NDArray[np.bool_]

BLOCKS = 10  # parts of a record that are omitted one at a time to find uncertainties
# times in periods of the highest line, because a series of low lines resolves no less
MARGIN_PERIODS = 2.0  # end of the record at which such a series is affected by the break-off
FADE_PERIODS = 20.0  # before that margin, in which the weight of the record falls to zero
NEAR_PERIODS = 2.0  # on both sides of a gap, in which commands may differ from those of the blocks
CUT_PERIODS = 20.0  # end of the record that is excluded from the errors, because the series break off there
JOINED_S = 0.02  # time on both sides of a gap over which samples are averaged to join it: the sensors' noise sets it


def mended(samples: Array, predicted: Array, lost: Booleans, width: int = 1) -> Array:
    """Return samples (c, n) in which those that were `lost` (n,) follow a prediction (c, n).

    The prediction is shifted so that it joins the mean of up to `width` of the nearest samples on both sides.
    """
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
    """Return weights (n,) at the reduced rate: one, with a linear slope to zero before the record's end."""
    time_s = np.arange(lines.series(np.zeros(lines.count, dtype=complex)).size) * lines.reduced_dt_s
    return np.clip(
        (lines.samples * lines.dt_s - MARGIN_PERIODS / lines.highest_hz - time_s) / (FADE_PERIODS / lines.highest_hz),
        0.0,
        1.0,
    )


def bursts(lines: Lines, row: ComplexArray, lost: Booleans) -> ComplexArray:
    """Return the lines (m,) of the part of a series that occurs within NEAR_PERIODS of `lost` steps (n,).

    `row` (m,) are the lines of the series. The part is its difference to a straight line between the ends of each such
    stretch.
    """
    series = lines.series(row)[None]
    at_s = np.arange(series.shape[1]) * lines.reduced_dt_s
    gaps_s = np.flatnonzero(lost) * lines.dt_s
    after = np.searchsorted(gaps_s, at_s)
    distance = np.minimum(
        np.abs(at_s - gaps_s[np.minimum(after, gaps_s.size - 1)]), np.abs(at_s - gaps_s[np.maximum(after - 1, 0)])
    )
    calm = mended(series, np.zeros_like(series), distance < NEAR_PERIODS / lines.highest_hz)
    return _lines(lines, (series - calm)[0])


def weighted_in_time(lines: Lines, rows: ComplexArray, weight: Array) -> ComplexArray:
    """Return the lines (..., m) of series, given by their lines, after weighting each instant at the reduced rate."""
    return _lines(lines, lines.series(rows) * weight)


def scatter(lines: Lines, rows: ComplexArray, wanted: ComplexArray) -> Array:
    """Return the standard uncertainties (k,) of the real factors of rows (k, m) that best approximate lines (m,).

    The method is the jackknife: the factors are fitted with each of BLOCKS parts of the record left out in turn, so
    that the residual may depend on time and frequency. Source: Efron and Tibshirani, An Introduction to the Bootstrap
    (1993), Eq. 11.5.
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
DRIFT = "drift"  # a cause only if drift or jumps were removed from the sensors' samples
LOST = "lost"  # a cause only if steps are without samples
FITTED_HZ = (0.5, 15.0)  # of the usual test band: where friction, gain and delay are fitted to the disturbance
SURE = 2.0  # standard uncertainties, up to which a fitted value is not significant
LARGER = 1.1  # times the whole error: a larger part cancels others and is no cause
ASSUMED_SCALE = 0.01  # v_s over the rms velocity if friction was not identified


@dataclass(frozen=True)
class Signals:
    """Signals of a run, n samples each; `desired`, `computed` and `sim` are on the record's clock."""

    desired: Array  # (3, n) acceleration, velocity and displacement of the interface
    corrected: Array  # (c, n) corrected samples as stored, n_p samples after they were taken
    command_v: Array  # (n,) as stored, n_p samples after it was computed
    computed: Array  # (n_storeys - c, n) accelerations of the storeys below the table
    sim: Array  # (n_storeys, n) accelerations of SIM
    # (n,) steps without samples of their own; with it the record's end is also excluded from the fits, because the
    # series break off there. None: everything is fitted.
    lost: NDArray[np.bool_] | None = None
    drift: Array | None = None  # (c, n) removed from the samples after the run; the loop used `corrected` + `drift`


@dataclass(frozen=True)
class Budget:
    """Measured RMS errors in the test band by cause, and the fitted errors of the table.

    Uncertainties are standard uncertainties.
    """

    causes: Mapping[str, Errors]
    measured: Errors  # the whole error
    unexplained: Errors  # the whole error minus the sum of all causes
    gain_error: float  # relative; positive: the table moves more than identified
    delay_error_s: float  # positive: the table is later than identified
    friction_v: float  # as a command
    gain_uncertainty: float
    delay_uncertainty_s: float
    friction_uncertainty_v: float


class Undisturbed(Protocol):
    """The test without disturbances, on lines, and what disturbances make of it."""

    @property
    def sim(self) -> ComplexArray:
        """Return the accelerations (n_storeys, m) of SIM with the identified specimen."""

    @property
    def perfect(self) -> ComplexArray:
        """Return those (n_storeys, m) of the test on a table that follows the desired motion."""

    @property
    def nominal(self) -> tuple[ComplexArray, ComplexArray]:
        """Return those (n_storeys, m) of the test on the identified rig, and its tracking error (m,)."""

    def disturb(self, samples: ComplexArray, command: ComplexArray | None) -> tuple[ComplexArray, ComplexArray]:
        """Return the change of storeys (n_storeys, m) and tracking error (m,) by disturbances of samples (c, m) and
        command (m,), in addition to those that were given before."""

    def small(self, samples: ComplexArray) -> ComplexArray:
        """Return the change of the storeys (n_storeys, m) in proportion to a disturbance of the samples (c, m)."""


class Linear:
    """The test of a building without laws: solved on lines, and any disturbance is as good as a small one."""

    def __init__(self, known: PredictionInputs) -> None:
        self._loop, self._known, self._still = known.loop, known, np.zeros_like(known.ground)
        self._transfer: ComplexArray | None = None
        self.sim = known.sim
        self.perfect = on_perfect_table(known.loop, known.floors, known.ground).storeys
        moved = hybrid(known.loop, known.ground, np.zeros_like(known.loop.rig))
        self.nominal = moved.storeys, moved.tracking

    def disturb(self, samples: ComplexArray, command: ComplexArray | None) -> tuple[ComplexArray, ComplexArray]:
        moved = hybrid(self._loop, self._still, samples, command)
        return moved.storeys, moved.tracking

    def small(self, samples: ComplexArray) -> ComplexArray:
        if self._transfer is None:
            ones = np.eye(len(samples))[:, :, None] * np.ones(samples.shape[1])
            self._transfer = np.array([self.disturb(one.astype(complex), None)[0] for one in ones])
        return np.asarray(np.einsum("csm,cm->sm", self._transfer, samples))


def split(known: PredictionInputs, signals: Signals, test: Undisturbed | None = None) -> Budget:
    """Return the measured error by cause; `test`: None for a building without laws."""
    test = test or Linear(known)
    lines, loop = known.lines, known.loop
    command = lines.of(signals.command_v) / loop.ahead
    stored, came = lines.of(signals.corrected), lines.of(samples_without_gaps(known, signals))
    corrected = stored / loop.ahead
    sim, reported = lines.of(signals.sim), np.vstack([lines.of(signals.computed), stored])
    desired = lines.of_motion(*signals.desired)
    drifted = np.zeros_like(stored) if signals.drift is None else lines.of(signals.drift)
    wanted, countered = _wanted(known, desired, corrected + drifted / loop.ahead), np.zeros_like(command)
    if known.compensation is not None:
        countered = lines.of(known.compensation.added_v(signals.desired)) / loop.ahead
    rounded, held = _added(known, signals, command - wanted - countered)
    disturbed = came / loop.ahead - loop.rig * command
    instants = None if signals.lost is None else inside(lines)
    parts, fitted = _disturbances(known, disturbed, command, signals.desired[1], instants)
    if held is not None:
        bridged = _disturbances(known, corrected - loop.rig * command, command, signals.desired[1], instants)[1]
        fitted = _less_sure(fitted, bridged)
    (nominal, tracking), quiet = test.nominal, np.zeros_like(command)
    series = {
        "declared": (sim - test.sim, quiet),
        "coupling": (test.sim - test.perfect, quiet),
        "latency": (test.perfect - nominal, tracking),
        "rounding": _error(test.disturb(np.zeros_like(disturbed), rounded)),
    } | {name: _error(test.disturb(part, countered if name == "friction" else None)) for name, part in parts.items()}
    if held is not None:
        series[LOST] = _error(test.disturb((stored - came) / loop.ahead, held))
    if signals.drift is not None:
        (moved, followed), shown = test.disturb(drifted / loop.ahead, None), np.zeros_like(sim)
        shown[len(sim) - len(drifted) :] = drifted
        series[DRIFT] = (shown - moved, followed + drifted[0])
    measured = (sim - reported, lines.of(signals.desired[0]) - stored[0])
    whole = _errors(known, *measured)
    left = tuple(error - sum(pair[i] for pair in series.values()) for i, error in enumerate(measured))
    causes = {name: _errors(known, *series[name]) for name in (*CAUSES, LOST, DRIFT) if name in series}
    return Budget(causes, whole, _errors(known, *left), *fitted)


def exceeds(part: Array, whole: Array) -> bool:
    """Return whether a part of the errors is too large for a cause of the whole ones, (n_storeys,) each, over all
    storeys."""
    return float(rms(part)) > LARGER * float(rms(whole))


def significant(value: float, off: float) -> float:
    """Return what is significant of a fitted value with standard uncertainty `off`: the value less the share that the
    uncertainty explains, nothing up to SURE of them."""
    return value * max(1.0 - (SURE * off / value) ** 2, 0.0) if value != 0.0 else 0.0


def samples_without_gaps(known: PredictionInputs, signals: Signals) -> Array:
    """Return the corrected samples (c, n), with lost ones replaced by the identified rig's response to the commands.

    The response is shifted to join the samples before and after the gap.
    """
    if signals.lost is None or not signals.lost.any():
        return signals.corrected
    answer = at_full_rate(known.lines, known.loop.rig * known.lines.of(signals.command_v))
    width = 2 * round(JOINED_S / known.lines.dt_s) + 1
    return mended(signals.corrected, answer, signals.lost, width)


def _less_sure(fitted: tuple[float, ...], bridged: tuple[float, ...]) -> tuple[float, ...]:
    """Return fitted values and uncertainties, the latter increased by the effect of substituted samples on the fit."""
    half = len(fitted) // 2
    moved = [a - b for a, b in zip(fitted[:half], bridged[:half], strict=True)]
    return (*fitted[:half], *(math.hypot(off, by) for off, by in zip(fitted[half:], moved, strict=True)))


def _added(known: PredictionInputs, signals: Signals, added: ComplexArray) -> tuple[ComplexArray, ComplexArray | None]:
    """Return the disturbance of the command (m,) by rounding, and its part near lost samples (None: none were lost)."""
    if signals.lost is None or not signals.lost.any():
        return added, None
    held = bursts(known.lines, added, signals.lost)
    return added - held, held


def _error(changed: tuple[ComplexArray, ComplexArray]) -> tuple[ComplexArray, ComplexArray]:
    return -changed[0], changed[1]


def _errors(known: PredictionInputs, storeys: ComplexArray, tracking: ComplexArray) -> Errors:
    return Errors(_rms(known, storeys), float(_rms(known, tracking)))


def _rms(known: PredictionInputs, lines: ComplexArray) -> Array:
    return rms(known.lines.evaluated(lines, CUT_PERIODS / known.lines.highest_hz))


def _wanted(known: PredictionInputs, desired: ComplexArray, samples: ComplexArray) -> ComplexArray:
    """Return the command (m,) that feedforward and feedback compute from desired motion (3, m) and samples (c, m)."""
    loop, error = known.loop, desired[0] / known.loop.ahead - samples[0]
    forward = np.sum(loop.feedforward * desired, axis=0) + np.sum(loop.reaction * samples, axis=0)
    return np.asarray(forward + loop.feedback * error)


def _disturbances(
    known: PredictionInputs, disturbed: ComplexArray, command: ComplexArray, velocity_m_s: Array, instants: Array | None
) -> tuple[dict[str, ComplexArray], tuple[float, ...]]:
    """Return the disturbance of the samples (c, m) by cause; gain error, delay error and friction that were fitted, and
    their standard uncertainties."""
    s = 2j * np.pi * known.lines.frequency_hz
    friction, more, friction_off = friction_in_samples(known, disturbed, command, velocity_m_s, instants)
    answer = known.loop.rig * command
    rows = (answer[0], -s * answer[0])
    (gain, late), off = _told(known, disturbed[0] - friction[0], rows, _felt(known), instants)
    sure = [significant(*pair) for pair in zip((gain, late), off, strict=True)]
    parts = {"model": (sure[0] - sure[1] * s) * answer, "friction": friction}
    left = disturbed[0] - parts["model"][0] - parts["friction"][0]
    parts["rest"] = known.floors * left
    parts["specimen"] = disturbed - sum(parts.values())
    identified = known.friction.command_v if known.friction else 0.0
    return parts, (gain, late, identified + more, *off, friction_off)


def friction_in_samples(
    known: PredictionInputs,
    disturbed: ComplexArray,
    command: ComplexArray,
    velocity_m_s: Array,
    instants: Array | None = None,
) -> tuple[ComplexArray, float, float]:
    """Return the disturbance of the samples (c, m) by friction, the excess over its identified size, its uncertainty.

    The size is fitted with the shape sign(v) - c v, which a gain or delay error cannot have. The excess and its
    standard uncertainty are in V. What is significant of it acts with the whole of sign(v), because no model contains
    its linear part.
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
    return as_identified + significant(more, off) * through * sign, more, off


def _felt(known: PredictionInputs) -> Array:
    """Return the weight (m,) of a disturbance of the table: its effect on the storeys, largest at their modes."""
    moved = hybrid(known.loop, np.zeros_like(known.ground), known.floors)
    return np.sqrt(np.sum(np.abs(moved.storeys) ** 2, axis=0)) * known.lines.test_band()


def _told(
    known: PredictionInputs,
    disturbed: ComplexArray,
    rows: tuple[ComplexArray, ...],
    weight: Array,
    instants: Array | None,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the factors of rows as `fitted_factors` does and their standard uncertainties, of the record's instants
    alone that have a weight (at the reduced rate; None: of all)."""
    both = np.vstack([*rows, disturbed[None]])
    if instants is not None:
        both = weighted_in_time(known.lines, both, instants)
    found = fitted_factors(known, both[-1], tuple(both[:-1]), weight)
    both = np.asarray(both * (weight * _inside(known)), dtype=complex)
    return found, tuple(float(off) for off in scatter(known.lines, both[:-1], both[-1]))


def _inside(known: PredictionInputs) -> NDArray[np.bool_]:
    f = known.lines.frequency_hz
    low, high = (with_test_band(hz, known.lines.test_band_hz) for hz in FITTED_HZ)
    return (f >= low) & (f <= high)


def fitted_factors(
    known: PredictionInputs, disturbed: ComplexArray, rows: tuple[ComplexArray, ...], weight: Array
) -> tuple[float, ...]:
    """Return the real factors of rows (m,) that explain most of a disturbance (m,) in the band of the fit, weighted."""
    inside = _inside(known)
    scaled = [(weight * row)[inside] for row in (*rows, disturbed)]
    *parts, wanted = (np.concatenate([row.real, row.imag]) for row in scaled)
    matrix = np.array(parts).T
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq(matrix / size, wanted, rcond=1e-9)[0] / size
    return tuple(float(value) for value in found)
