"""The verdict of the check and its limits: stability and tolerated table error of the sampled loop, reach of the
table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, ROUND_UP, Context

import numpy as np

from rths_cli.analysis.closed_loop import CriticalDelay, LoopResponse, closed_loop_matrix, hybrid, loop_response
from rths_cli.analysis.fourier_lines import low_lines
from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.analysis.predicted_error import (
    Prediction,
    PredictionInputs,
    data_ratio,
    of_correction,
    ratio_error,
    white_noise_m_s2,
)
from rths_cli.analysis.quantisation import zero_error
from rths_cli.control.continued_table import ContinuedTable, unknown
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.margins import Margins, margins
from rths_cli.findings import Finding, sentences
from rths_cli.identification.results import LevelBand
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model
from rths_cli.rigs.description import BRAKE_SHARE, RigInfo

SAFE, UNSAFE, UNSTABLE = VERDICTS = "safe", "unsafe", "unstable"  # the worst last
ZERO_CHANGES = 0.05  # of a bit: standard uncertainty of a zero that a record in motion showed
UNSEEN_CHANGE, UNCOMPARED_CHANGE = 0.01, 0.06  # change of its response that a verification accepts; without low level
SIGMA = 3.0  # standard uncertainties of the measured response
LEAST_DELAY_S = 1e-3  # further delay that a loop must tolerate if a smaller one is not justified
RESERVE = 0.1  # fraction of every limit that is kept in reserve
ROOM_PARTS = 4  # slow motions are fitted to the last one of this many parts of the padding after the record
FINER = 8  # points of a peak's series per point at the reduced rate
MOST_GROWN = 1e99  # largest stated growth; result files hold no larger numbers
GROWN = 1e3  # growth over the record from which a loop is called unstable
# grid: start, points up to 0.4 of the sample rate, points from there on and around each loop mode, half width of those
LOWEST_HZ, POINTS, AROUND, WIDTH = 0.05, 1500, 100, 0.2  # start: lower with a lower compared band, never higher
MODES_HZ = 60.0  # of the usual compared band: highest loop mode around which the grid is refined
LEAST_LOOP = 1e-12  # a smaller loop gain counts as zero
BESIDE = 0.1  # largest logarithm of the frequency ratio of a zero and the pole of the same mode
# advice for a loop of table and controller alone
ALONE = ("lower_bandwidth", "use_ff", "identify_higher_hz")
NO_ZEROS = np.empty(0, dtype=complex)
NO_MODES = np.empty(0)


@dataclass(frozen=True)
class Beyond:
    """The error of the table's response beyond the identified band that the feedback by itself tolerates and must
    tolerate, both relative, at the frequency where they are nearest.

    `needed_hz`: end of the identified band from which on the feedback would tolerate what it must; infinite: none.
    """

    tolerates: float
    required: float
    at_hz: float
    needed_hz: float = math.nan


NO_FEEDBACK = Beyond(math.inf, 0.0, math.nan)


@dataclass(frozen=True)
class Stability:
    """Stability of the sampled loop and its margins, with the loop broken at the command.

    The tolerated error is the relative error of the table's response that makes the loop unstable, together with the
    worst change of its gain within SIGMA standard uncertainties. It is the smaller one for the measured response beyond
    its scatter and for the model.
    """

    radius: float  # spectral radius of the closed-loop matrix
    growth: float  # factor by which motions change over the record; at most 1 if the loop is stable
    measured: Margins  # with the measured response of the table
    modelled: Margins  # with the table's model
    tolerates: float  # tolerated error at `at_hz`
    required: float  # required error at `at_hz`
    at_hz: float  # frequency at which tolerated and required error are nearest
    in_band: float = math.inf  # smallest tolerated error up to the end of the compared band
    in_band_hz: float = math.nan  # its frequency
    # Largest |(1 + L) / (1 + L_model) - 1|, with L the loop on the measured response beyond its scatter. Below one,
    # both loops encircle -1 equally often (Rouche), and the spectral radius of the model is valid for both.
    apart: float = 0.0
    gain: float = 1.0  # the worst gain at `at_hz`, a factor
    gain_change: float = 0.0  # relative, within which it is the worst
    compared: ComparedBand = USUAL  # band in which the model was compared with its data
    feedback: Beyond = NO_FEEDBACK
    # whether the loop on the table continued beyond the identified band encircles -1 as often as that on its model
    same_side: bool = True
    # (c,) rms of the command's rate in V/s by white noise of 1 V (rms per sample) in each channel
    rate_by_noise: tuple[float, ...] = ()


@dataclass(frozen=True)
class Strays:
    """What the samples' zeros, noise and rounding add to the command of the undisturbed test, at any scaling."""

    aside_v: float = 0.0  # how far it goes aside
    rate_v_s: float = 0.0  # the peak of its rate
    by_feedback: bool = False  # whether there is a feedback, which makes most of both


NO_STRAYS = Strays()


@dataclass(frozen=True)
class Reach:
    """The predicted peak of a quantity and its limit, both in `units`; `fixed`: the part of the peak that does not grow
    with the record, and `cause` and `advice` the codes of its cause and remedy; `key`: what states the limit."""

    name: str
    peak: float
    limit: float
    units: str
    fixed: float = 0.0
    key: str = ""
    cause: str = ""
    advice: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Return the peak as a fraction of the limit."""
        return self.peak / self.limit

    def largest(self, scaling: float) -> float:
        """Return the largest safe scaling, from the `scaling` that has this peak."""
        left, grows = (1.0 - RESERVE) * self.limit - self.fixed, self.peak - self.fixed
        return scaling * max(left, 0.0) / grows if grows > 0.0 else math.inf if left >= 0.0 else 0.0


@dataclass(frozen=True)
class Preflight:
    """The result of the check of a hybrid test."""

    verdict: str  # SAFE, UNSAFE or UNSTABLE
    faults: tuple[Finding, ...]  # why it is not safe
    critical: CriticalDelay
    stability: Stability
    reach: tuple[Reach, ...]  # predicted peaks with their limits
    largest_scaling: float  # largest safe scaling of the record
    prediction: Prediction | None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why the test is not safe, one sentence each."""
        return sentences(self.faults)


def judge(
    critical: CriticalDelay, stability: Stability, reach: tuple[Reach, ...], scaling: float,
    prediction: Prediction | None, further: tuple[Finding, ...] = (), feedback: bool = False,
    least_delay_s: float = LEAST_DELAY_S, alone: bool = False,
) -> Preflight:  # fmt: skip
    """Return the result of the check: unstable, unsafe with its reasons, or safe.

    `further`: additional reasons that make a stable loop unsafe. `feedback`: whether the controller has a feedback; if
    so, no advice recommends one. `least_delay_s`: further delay in s that the loop must tolerate. `alone`: the loop is
    that of a shake-table test, and no advice speaks of a building.
    """
    faults = faults_of_loop(stability, feedback, least_delay_s, alone)
    doubt = stability.radius >= 1.0 and stability.growth >= GROWN
    largest = min((row.largest(scaling) for row in reach), default=0.0)
    if stability.radius < 1.0:
        beyond = [row for row in reach if not row.share <= 1.0 - RESERVE]
        faults += [*further, *(_beyond(row, largest, row is beyond[-1]) for row in beyond)]
    verdict = UNSTABLE if doubt else UNSAFE if faults else SAFE
    return Preflight(verdict, tuple(faults), critical, stability, reach, largest, prediction)


def over_samples(nominal: Preflight, samples: Sequence[Preflight]) -> Preflight:
    """Return the result of the check over the samples of an identified model: the worst verdict, all reasons.

    A reason that samples have is told once, with its share of the samples and the numbers of the sample in which it is
    worst, after the reasons of the nominal model. The largest safe scaling is safe with every sample.
    """
    every = (nominal, *samples)
    found: dict[tuple[object, ...], list[Finding]] = {}
    for fault in (fault for sample in samples for fault in sample.faults):
        found.setdefault(fault.kind, []).append(fault)
    return replace(
        nominal,
        verdict=max((one.verdict for one in every), key=VERDICTS.index),
        faults=(*nominal.faults, *(_of_samples(same, len(samples)) for same in found.values())),
        largest_scaling=min(one.largest_scaling for one in every),
    )


def _of_samples(same: Sequence[Finding], count: int) -> Finding:
    """Return the reason that several of `count` samples have, with the numbers of the worst."""
    worst = max(same, key=lambda fault: math.inf if math.isnan(fault.beyond) else fault.beyond)
    return worst.at("at.samples", count=len(same), of=count, quoted="worst" if len(same) > 1 else None)


def required_delay_s(
    dt_s: float, bridged: bool, error_s: float | None = None, compared: bool = True, band: ComparedBand = USUAL
) -> float:
    """Return the further delay in s that a loop must tolerate.

    It is SIGMA times the standard uncertainty `error_s` of the identified delay (None: not known) plus the delay that a
    verification accepts at the end of the compared `band`, at most LEAST_DELAY_S. (The delay is less certain only if
    the model's roots can represent a part of it, and then the lag of both together is measured.) `compared`: the
    verification has a record at low level for comparison. `bridged`: the loop substitutes a lost sample by its model.
    Otherwise a lost sample holds the command, and one lost and one late sample must not endanger the loop.
    """
    unseen = (UNSEEN_CHANGE if compared else UNCOMPARED_CHANGE) / (2.0 * math.pi * band.high_hz)
    least = LEAST_DELAY_S if error_s is None else min(unseen + SIGMA * error_s, LEAST_DELAY_S)
    return least if bridged else max(2.0 * dt_s, least)


def faults_of_loop(
    found: Stability, feedback: bool = False, least_delay_s: float = LEAST_DELAY_S, alone: bool = False
) -> list[Finding]:
    """Return the reasons why a loop is not safe with any record; an empty list if it is safe. `alone` as in `judge`."""
    return _fragile(found, feedback, least_delay_s, alone) if found.radius < 1.0 else _unstable(found, alone)


def faults_of_reach(rows: Sequence[Reach]) -> tuple[Finding, ...]:
    """Return a reason for each predicted peak that leaves no reserve to its limit."""
    return tuple(_beyond(row, 0.0, False) for row in rows if not row.share <= 1.0 - RESERVE)


def rounded_down(value: float, digits: int = 3) -> float:
    """Return a positive number rounded down to at most `digits` significant digits."""
    return float(Context(prec=digits, rounding=ROUND_DOWN).create_decimal(repr(float(value))))


def rounded_up(value: float, digits: int = 2) -> float:
    """Return a positive number rounded up to at most `digits` significant digits."""
    return float(Context(prec=digits, rounding=ROUND_UP).create_decimal(repr(float(value))))


def _unstable(found: Stability, alone: bool) -> list[Finding]:
    values = {"spectral_radius": found.radius, "growth": found.growth}
    advice = ALONE if alone else ("another_controller", "more_damping", "less_mass")
    return [Finding("loop.unstable", values, advice, beyond=found.radius)]


def _fragile(found: Stability, feedback: bool, least_delay_s: float, alone: bool) -> list[Finding]:
    """Return a reason for each margin (table error, feedback, delay) that is smaller than required."""
    faults = []
    if not found.apart < 1.0:  # written so that NaN counts as no margin
        faults.append(Finding("loop.measured_response", {}, ("identify_again",), beyond=found.apart))
    if not found.tolerates >= found.required:
        values = {"tolerated": found.tolerates, "required": found.required, "at_hz": found.at_hz}
        gain = None if round(found.gain, 3) == 1.0 else found.gain
        advice = ALONE if alone else _advice(found.at_hz, feedback, found.compared)
        over = _over(found.required, found.tolerates)
        faults.append(Finding("loop.table_error", {**values, "gain": gain}, advice, beyond=over))
    if not found.same_side:
        advice = ("identify_higher_hz", "use_ff") if feedback else ("identify_higher_hz",)
        faults.append(Finding("loop.beyond_the_band", {}, advice))
    beyond = found.feedback
    if not beyond.tolerates >= beyond.required:
        values = {"tolerated": beyond.tolerates, "required": beyond.required, "at_hz": beyond.at_hz}
        needed_hz = rounded_up(beyond.needed_hz) if math.isfinite(beyond.needed_hz) else None
        over = _over(beyond.required, beyond.tolerates)
        faults.append(Finding("loop.feedback_beyond_the_band", {**values, "needed_hz": needed_hz}, beyond=over))
    delay_s = found.measured.delay_margin_s
    if not delay_s >= least_delay_s:
        values = {"tolerated_s": delay_s, "required_s": least_delay_s}
        advice = ALONE if alone else ("put_less_mass", "add_damping")
        faults.append(Finding("loop.delay", values, advice, beyond=_over(least_delay_s, delay_s)))
    return faults


def _over(required: float, found: float) -> float:
    return required / found if found > 0.0 else math.inf


def _advice(at_hz: float, feedback: bool, compared: ComparedBand) -> tuple[str, ...]:
    """Return the advice for a loop that tolerates too small an error, among the building's modes or above them."""
    if at_hz <= compared.high_hz:
        return ("damp_structure_or_cut_higher",) if feedback else ("damp_structure", "cut_higher", "use_ff_fb")
    return ("put_less_mass", *(("lower_bandwidth", "use_ff") if feedback else ()), "identify_higher")


def _beyond(row: Reach, largest: float, last: bool) -> Finding:
    """Return the reason that a predicted peak is; the last one of several tells the largest safe scaling."""
    values = {"quantity": row.name, "peak": row.peak, "limit": row.limit, "units": row.units, "key": row.key or None}
    if row.cause and row.fixed > RESERVE * row.limit:
        values |= {"fixed": row.fixed, "cause": row.cause}
    if last and largest > 0.0:
        values["largest_scaling"] = rounded_down(largest)
    return Finding("table.limit", values, row.advice if "cause" in values else (), beyond=row.share)


def stability(
    rig: IdentifiedRig, blocks: Blocks, storeys: Block, model: Model, measured: Frf, samples: int,
    levels: Sequence[LevelBand] = (), compared: ComparedBand = USUAL, gain_uncertainty: float = 0.0,
    continued: ContinuedTable | None = None,
) -> Stability:  # fmt: skip
    """Return the stability of the sampled loop of identified rig and blocks, for a record of `samples` samples.

    `gain_uncertainty`: relative standard uncertainty of the table's gain from the last verification to the end of the
    test. `levels`: the table's response at low level over that at full level, () without a record at low level.
    `compared`: band in which the model was compared with its data. `continued`: the table beyond the identified band,
    on which the loop is judged there as well (None: the model alone).
    """
    matrix = closed_loop_matrix(rig, blocks)
    values = np.linalg.eigvals(matrix).astype(complex)
    radius = float(np.abs(values).max())
    frequency = _grid(values, rig.plant.dt_s, compared, NO_MODES if continued is None else continued.modes_beyond_hz)
    loop = loop_response(rig, blocks, storeys, np.exp(2j * np.pi * frequency * rig.plant.dt_s))
    ratio = data_ratio(model, measured, frequency, compared)
    scatter = ratio_error(model, measured, frequency, compared)
    on_data, seen = loop.with_rig(ratio), loop.with_rig(_beyond_scatter(ratio, scatter))
    identified_hz = max(model.band_hz[1], compared.high_hz)
    change = SIGMA * gain_uncertainty
    end_hz = max(min(model.band_hz[1], float(measured.frequency_hz[-1])), compared.high_hz)
    each_loop = [seen, loop.loop]
    if continued is not None and continued.shown:
        beyond = frequency > continued.end_hz
        going_on = [loop.with_rig(ratio) for ratio in _going_on(continued, frequency)]
        each_loop = [*(np.where(beyond, going_on[0], each) for each in each_loop), *going_on[1:]]
    gains = np.stack([_worst_gain(each, frequency, identified_hz, change) for each in each_loop])
    errors = np.stack([_tolerated(each, gain) for each, gain in zip(each_loop, gains, strict=True)])
    tolerated, gain = errors.min(axis=0), np.take_along_axis(gains, errors.argmin(axis=0)[None], axis=0)[0]
    measured_hz = model.band_hz[0], min(model.band_hz[1], float(measured.frequency_hz[-1]))
    unchecked = min(max(2.0 * gain_uncertainty, UNSEEN_CHANGE), UNCOMPARED_CHANGE)
    shown = continued is not None and continued.shown
    zeros = NO_ZEROS if shown else unpaired_zeros(model, compared)
    wanted = required(frequency, measured_hz, scatter, levels, zeros, compared, unchecked)
    nearest = int(np.argmin(tolerated / wanted))
    weakest = int(np.argmin(np.where(frequency <= compared.high_hz, tolerated, math.inf)))
    apart = np.abs((1.0 + seen) / (1.0 + loop.loop) - 1.0)
    return Stability(
        radius,
        growth(radius, samples),
        margins(on_data, frequency),
        margins(loop.loop, frequency),
        float(tolerated[nearest]),
        float(wanted[nearest]),
        float(frequency[nearest]),
        float(tolerated[weakest]),
        float(frequency[weakest]),
        float(apart.max()),
        float(gain[nearest]),
        change,
        compared,
        _beyond_the_band(loop, frequency, end_hz, continued),
        all(_same_side(each, loop.loop) for each in each_loop[1:]),
        _rate_by_noise(loop, np.einsum("ccm->cm", blocks.correction.response(frequency)), frequency, rig.plant.dt_s),
    )


def _rate_by_noise(loop: LoopResponse, correction: ComplexArray, frequency_hz: Array, dt_s: float) -> tuple[float, ...]:
    """Return the rms of the command's rate in V/s, from one sample to the next, by white noise of 1 V in each channel.

    `correction` (c, m): of each channel's samples, in m/s^2 per V.
    """
    steep = 2.0 * np.sin(np.pi * frequency_hz * dt_s) / dt_s
    still, found = np.zeros((3, len(frequency_hz)), dtype=complex), []
    for channel, each in enumerate(correction):
        noise = np.zeros_like(correction)
        noise[channel] = each
        power = 2.0 * dt_s * np.abs(hybrid(loop, still, noise).command_v * steep) ** 2
        found.append(float(np.sqrt(np.trapezoid(power, frequency_hz))))
    return tuple(found)


def growth(radius: float, samples: int) -> float:
    """Return the factor by which the slowest motion changes over a record, at most MOST_GROWN."""
    return float(np.exp(min(samples * math.log(radius), math.log(MOST_GROWN)))) if radius > 0.0 else 0.0


def _worst_gain(loop: ComplexArray, frequency_hz: Array, identified_hz: float, change: float) -> Array:
    """Return the factor (n,) on the gain of a loop (n,), within the relative `change`, that brings it nearest to -1.

    It is one beyond the identified band, where the required error covers any change. The remaining relative error
    |1 + 1 / (g L)| is, squared, a parabola in 1 / g.
    """
    over = 1.0 / np.where(np.abs(loop) > LEAST_LOOP, loop, LEAST_LOOP)
    share = np.clip(-over.real / np.abs(over) ** 2, 1.0 / (1.0 + change), 1.0 / (1.0 - change))
    return np.where(frequency_hz <= identified_hz, 1.0 / share, 1.0)


def _tolerated(loop: ComplexArray, gain: Array) -> Array:
    """Return the smallest relative error (n,) of the table that brings the loop, with the given gain, to -1."""
    return np.abs(1.0 + gain * loop) / np.maximum(np.abs(gain * loop), LEAST_LOOP)


def required(
    frequency_hz: Array, band_hz: tuple[float, float], scatter: Array, levels: Sequence[LevelBand],
    zeros: ComplexArray = NO_ZEROS, compared: ComparedBand = USUAL, unchecked: float = UNCOMPARED_CHANGE,
) -> Array:  # fmt: skip
    """Return the error (n,) of the table's response that a loop must tolerate in addition to a change of its gain.

    It is the error that identification and verification cannot exclude. Its terms are the change that a verification
    accepts, SIGMA times the uncertainty `scatter` (n,) of the measured response, the change with the level and with
    friction, and unknown modes beyond the measured band `band_hz`. A mode at f_0, twice the end of the band, adds
    (f / f_0)^2 below it; up to the end of the band the measured response contains that. Below the band, and above the
    `compared` one, the verification is coarse, and its term is `unchecked`, how much the response may have changed
    there; without a record at low level it is UNCOMPARED_CHANGE everywhere. The sum is at most 1, but beyond the band
    at least the motion of an oscillator at each of the `zeros` (z,) in rad/s, those of the model whose pole was not
    measured (`unpaired_zeros`).
    """
    end_hz = max(band_hz[1], compared.high_hz)
    verified = (frequency_hz >= band_hz[0]) & (frequency_hz <= compared.high_hz)
    unseen = np.where(verified, UNSEEN_CHANGE, unchecked) if levels else UNCOMPARED_CHANGE
    beyond = np.where(frequency_hz > band_hz[1], (frequency_hz / (2.0 * end_hz)) ** 2, 0.0)
    total = np.minimum(unseen + SIGMA * scatter + _by_level(frequency_hz, levels) + beyond, 1.0)
    return np.maximum(total, _beside(frequency_hz, end_hz, zeros))


def _going_on(continued: ContinuedTable, frequency_hz: Array) -> list[ComplexArray]:
    """Return the continued response over the model's (n,), one within the identified band: with the specimen as
    identified, then with its frequencies shifted down and up."""
    model = continued.model
    over = np.exp(-2j * np.pi * frequency_hz * continued.late_s) / model.response(frequency_hz)
    shifts = (0.0, -continued.shift, continued.shift) if continued.modes_beyond_hz.size else (0.0,)
    beyond = frequency_hz > continued.end_hz
    return [np.where(beyond, continued.response(frequency_hz, shift) * over, 1.0) for shift in shifts]


def _same_side(loop: ComplexArray, modelled: ComplexArray) -> bool:
    """Tell whether two loops (n,) encircle -1 equally often."""
    turned = np.unwrap(np.angle((1.0 + loop) / (1.0 + modelled)))
    return bool(abs(turned[-1] - turned[0]) < np.pi)


def _beyond_the_band(
    loop: LoopResponse, frequency_hz: Array, end_hz: float, continued: ContinuedTable | None
) -> Beyond:
    """Return what the feedback's own loop (n,) tolerates beyond the end of the identified band, and what it must.

    It is judged on the table as it goes on with every specimen that may stand there, and on its model where nothing
    shows how it goes on: then with any phase of the largest response. Each is off by what nobody has seen there: a deck
    on its coil answered at 200 Hz four times as much as its model, in the samples of 500 Hz.
    """
    if not loop.feedback.any():
        return NO_FEEDBACK
    modelled, known = loop.feedback * loop.rig[0], np.ones(len(frequency_hz))
    if continued is None:
        tolerated = _tolerated(modelled, known)
    elif continued.shown:
        tolerated = np.full(len(frequency_hz), math.inf)
        for each in continued.variants(frequency_hz):
            there = np.where(frequency_hz > end_hz, loop.feedback * each, modelled)
            stands = _tolerated(there, known) if _same_side(there, modelled) else np.zeros(len(frequency_hz))
            tolerated = np.minimum(tolerated, stands)
    else:
        largest = np.maximum(np.abs(loop.rig[0]), continued.largest(frequency_hz))
        tolerated = np.maximum(1.0 / np.maximum(np.abs(loop.feedback) * largest, LEAST_LOOP) - 1.0, 0.0)
    wanted = unknown(frequency_hz, end_hz)
    at = int(np.argmax((wanted + LEAST_LOOP) / (tolerated + LEAST_LOOP) * (frequency_hz > end_hz)))
    safe = tolerated[at] >= wanted[at]
    needed_hz = end_hz if safe else _band_needed(frequency_hz, tolerated, end_hz)
    return Beyond(float(tolerated[at]), float(wanted[at]), float(frequency_hz[at]), needed_hz)


def _band_needed(frequency_hz: Array, tolerated: Array, end_hz: float) -> float:
    """Return the end of the identified band from which on the tolerated error is what it must be, infinite without."""
    for needed in frequency_hz[frequency_hz > end_hz]:
        above = frequency_hz > needed
        if above.any() and np.all(tolerated[above] >= unknown(frequency_hz[above], needed)):
            return float(needed)
    return math.inf


def _beside(frequency_hz: Array, end_hz: float, zeros: ComplexArray) -> Array:
    """Return the error (n,) of the table's response beyond the end of the identified band by poles not measured.

    The mode of the floors on a table at rest is a zero of the table's response, and a pole of about its damping stands
    near it. Where the pole was not measured, the response may be wrong by the motion of an oscillator at the mode's
    frequency, r^2 / |1 - r^2 + 2 i z r| with r = f / f_0, which at the mode itself is 1 / 2 z.
    """
    motion, s = np.zeros(len(frequency_hz)), 2j * np.pi * frequency_hz
    for zero in zeros:
        motion = np.maximum(motion, np.abs(s**2 / ((s - zero) * (s - zero.conjugate()))))
    return np.where(frequency_hz > end_hz, motion, 0.0)


def unpaired_zeros(model: Model, compared: ComparedBand = USUAL) -> ComplexArray:
    """Return the zeros (z,) in rad/s, one per pair, beyond the model's band whose pole lies beyond the band as well.

    A pole within the band belongs to the nearest zero, if that is at most BESIDE away.
    """
    end = 2.0 * np.pi * max(model.band_hz[1], compared.high_hz)
    zeros = model.zeros[model.zeros.imag > 0.0]
    poles = model.poles[(model.poles.imag > 0.0) & (np.abs(model.poles) <= end)]
    if not len(poles) or not len(zeros):
        return zeros[np.abs(zeros) > end]
    apart = np.abs(np.log(np.abs(zeros)[:, None] / np.abs(poles)))  # (zeros, poles)
    paired = np.zeros(len(zeros), dtype=bool)
    paired[apart.argmin(axis=0)[apart.min(axis=0) <= BESIDE]] = True
    return zeros[(np.abs(zeros) > end) & ~paired]


def _by_level(frequency_hz: Array, levels: Sequence[LevelBand]) -> Array:
    """Return the change (n,) of the table's response from full to low level, interpolated between the bands' centres.

    A test may move the table at any level between the two. The change that the scatter of the comparison may hide is
    added, up to the term that applies without a comparison.
    """
    if not levels:
        return np.zeros(len(frequency_hz))
    centres = np.log([math.sqrt(band.low_hz * band.high_hz) for band in levels])
    hidden = UNCOMPARED_CHANGE - UNSEEN_CHANGE
    changes = [
        max(abs(band.ratio - 1.0) - SIGMA * band.error, 0.0) + min(SIGMA * band.error, hidden) for band in levels
    ]
    return np.interp(np.log(frequency_hz), centres, changes)


def _beyond_scatter(ratio: ComplexArray, scatter: Array) -> ComplexArray:
    """Return the ratio (n,) of measured response to model, moved towards one by SIGMA standard uncertainties."""
    off = np.abs(ratio - 1.0)
    return 1.0 + (ratio - 1.0) * np.maximum(1.0 - SIGMA * scatter / np.maximum(off, LEAST_LOOP), 0.0)


def _grid(values: ComplexArray, dt_s: float, compared: ComparedBand, further_hz: Array) -> Array:
    """Return the frequencies (n,) in Hz at which the loop is evaluated, to half the sample rate, dense at its modes.

    `values` (n,) are the eigenvalues of the closed-loop matrix; `further_hz` (m,): modes beyond the band.
    """
    values = values[np.abs(values) > 0.1]
    modes = np.abs(np.log(values)) / (2.0 * np.pi * dt_s)
    lowest_hz = min(LOWEST_HZ, compared.with_low(LOWEST_HZ))
    modes = np.unique(np.round(modes[(modes > lowest_hz) & (modes < compared.with_high(MODES_HZ))], 6))
    modes = np.concatenate([modes, further_hz])
    around = np.outer(modes, 1.0 + WIDTH * np.linspace(-1.0, 1.0, AROUND) ** 3).ravel()
    below, above = np.geomspace(lowest_hz, 0.4 / dt_s, POINTS), np.linspace(0.4 / dt_s, 0.5 / dt_s, AROUND + 1)
    return np.unique(np.concatenate([below, above[1:], around[(around > lowest_hz) & (around < 0.5 / dt_s)]]))


def strays(known: PredictionInputs, found: Stability) -> Strays:
    """Return what zeros, noise and rounding of the samples add to the command.

    Its rate is the largest of as many normal values as the record has samples.
    """
    sizes = np.array([channel.sensitivity_v_per_unit for channel in known.rig.channels])
    noise_v = np.hypot(white_noise_m_s2(known) * sizes, known.rig.converters.step_v / math.sqrt(12.0))
    largest = math.sqrt(2.0 * math.log(max(known.lines.samples, 2)))
    rate = largest * float(np.linalg.norm(np.multiply(found.rate_by_noise, noise_v)))
    return Strays(_aside_v(known), rate, bool(np.any(known.loop.feedback)))


def _aside_v(known: PredictionInputs) -> float:
    """Return how far the command goes aside because the channels' zeros are their means at rest, which stay within a
    bit: by what a record in motion showed them to be off, and twice the root mean square of what that leaves unknown.

    Without such a record a zero is off by anything up to half a bit. A zero's error does not change during the test.
    The correction of an AC coupling integrates it; after the record an opposite offset takes the integral back, so that
    it is that of a test which starts at rest.
    """
    lines = known.lines
    back = max((lines.padded - lines.samples) // 2, 1)
    offset = np.zeros(lines.padded)
    offset[: lines.samples], offset[lines.samples : lines.samples + back] = 1.0, -lines.samples / back
    bits = known.rig.converters.step_v / np.array([c.sensitivity_v_per_unit for c in known.rig.channels])
    made, still = np.zeros_like(known.floors), np.zeros_like(known.ground)
    held, corrected, paths = low_lines(offset, lines.count, lines.padded), of_correction(known), []
    for channel in range(len(bits)):
        made[:], made[channel] = 0.0, corrected[channel] * held
        series = _from_rest(known, hybrid(known.loop, still, made).command_v)
        paths.append(series - series[0])  # lines have no mean; the test starts at zero
    off = np.array([zero_error(bit, noise) for bit, noise in zip(bits, known.noise_m_s2, strict=True)])
    if known.zero_m_s2 is None:
        seen, unknown = np.zeros(len(bits)), off
    else:
        seen, unknown = np.clip(known.zero_m_s2, -2.0 * off, 2.0 * off), np.minimum(off, ZERO_CHANGES * bits)
    peaks = np.array([_peak(path) for path in paths])
    return _peak(seen @ np.array(paths)) + min(2.0 * float(np.linalg.norm(unknown * peaks)), float(0.5 * bits @ peaks))


def reach(
    known: PredictionInputs, prediction: Prediction, rig: RigInfo, masses_kg: Array, strays: Strays = NO_STRAYS
) -> tuple[Reach, ...]:
    """Return the peaks of the undisturbed test, with the limits that the guard enforces.

    `masses_kg` (c,): moving mass and floors. As in the guard, displacement and velocity are the command times the
    nominal gain, and the displacement includes the room to brake.
    """
    lines, motion = known.lines, prediction.nominal
    s = 2j * np.pi * lines.frequency_hz
    command, rate = (_from_rest(known, values) for values in (motion.command_v, s * motion.command_v))
    accel = np.array([_from_rest(known, values) for values in motion.corrected])
    loudest = 0.0 if known.peaks_m_s2 is None else float(known.peaks_m_s2.max())
    return reach_of_series(command, rate, accel, loudest, rig, masses_kg, known.shaped, strays)


def reach_of_series(
    command_v: Array,
    rate_v_s: Array,
    accel_m_s2: Array,
    loudest_m_s2: float,
    rig: RigInfo,
    masses_kg: Array,
    shaped: bool,
    strays: Strays = NO_STRAYS,
) -> tuple[Reach, ...]:
    """Return the peaks of a test with its limits, as `reach`, from command and its rate (n,) and accelerations (c, n).

    `loudest_m_s2`: an acceleration that is known to be reached, whatever the series show. `shaped`: whether commands
    are rounded with noise shaping, which carries an error over and can make two bits of it.
    """
    loudest = max(_peak(accel_m_s2), loudest_m_s2)
    limits, converters, gain = rig.limits, rig.converters, rig.gain_m_per_v
    rounding = (2.0 if shaped else 1.0) * converters.step_v / rig.dt_s
    aside_m, faster_m_s = gain * strays.aside_v, gain * (rounding + strays.rate_v_s)
    place, speed = gain * command_v, gain * rate_v_s
    to_brake = 2.0 * BRAKE_SHARE * limits.acceleration_m_s2
    reached = [place, *(place + v * np.abs(v) / to_brake for v in (speed - faster_m_s, speed + faster_m_s))]
    far_m, still_m = aside_m + max(_peak(each) for each in reached), aside_m + faster_m_s**2 / to_brake
    force = masses_kg @ accel_m_s2
    range_m_s2 = min(min(c.range, converters.range_v / c.sensitivity_v_per_unit) for c in rig.channels)
    stroke = min(limits.stroke_m, gain * converters.range_v)
    of_stroke = "limits.stroke_m" if limits.stroke_m <= stroke else "converters.range_v"
    fastest, of_fastest = limits.fastest_m_s(gain), limits.of_fastest(gain)
    by_zeros, by_rates = _causes(strays, rounding, still_m > 2.0 * aside_m)
    return (
        Reach("displacement_m", far_m, stroke, "m", still_m, of_stroke, *by_zeros),
        Reach("velocity_m_s", _peak(speed) + faster_m_s, fastest, "m/s", faster_m_s, of_fastest, *by_rates),
        Reach("acceleration_m_s2", loudest, limits.acceleration_m_s2, "m/s^2", key="limits.acceleration_m_s2"),
        Reach("sensor_m_s2", loudest, range_m_s2, "m/s^2", key="of sensor or converter"),
        Reach("force_n", _peak(force), limits.force_n, "N", key="limits.force_n"),
        Reach(
            "command_v", _peak(command_v) + strays.aside_v, converters.range_v, "V", strays.aside_v,
            "converters.range_v", *_causes(strays, rounding)[0],
        ),
    )  # fmt: skip


Cause = tuple[str, tuple[str, ...]]


def _causes(strays: Strays, rounding_v_s: float, braked: bool = False) -> tuple[Cause, Cause]:
    """Return the causes, with advice, of what is added to displacement or command, and to the velocity. `braked`: most
    of a displacement is the room to brake what noise and rounding do."""
    gentler = strays.by_feedback and strays.rate_v_s > rounding_v_s
    fast = "rounding", ("finer_converters", *(("slower_feedback", "controller_ff") if gentler else ()))
    zeros = "zeros", ("finer_converters", *(("controller_ff",) if strays.by_feedback else ()))
    return fast if braked else zeros, fast


def _from_rest(known: PredictionInputs, values: ComplexArray) -> Array:
    """Return the series (n,) of lines (m,) of a test that starts at rest.

    Lines describe a record that is repeated. A motion that is slower than the padding after the record is therefore
    still present at the next start. It is fitted to the end of the padding with the loop's slow roots, extrapolated,
    and subtracted.
    """
    lines, roots = known.lines, known.slow_roots
    series = lines.series(values, FINER)
    if not len(roots):
        return series
    whole = replace(lines, samples=lines.padded).series(values)
    tail = whole[-max(int(len(whole) * (1.0 - lines.samples / lines.padded)) // ROOM_PARTS, 2) :]
    dt_s = lines.reduced_dt_s
    factors = np.asarray(np.linalg.lstsq(_ringing(roots, dt_s, -len(tail), 0), tail, rcond=None)[0], dtype=float)
    return np.asarray(series - _ringing(roots, dt_s / FINER, 0, len(series)) @ factors)


def _ringing(roots: ComplexArray, dt_s: float, first: int, end: int) -> Array:
    """Return the free motions (n, 2 k) of roots (k,) in rad/s, cosine and sine of each, for samples first to end."""
    motion = np.exp(np.outer(dt_s * np.arange(first, end), roots))
    return np.hstack([motion.real, motion.imag])


def unseen(known: PredictionInputs) -> tuple[Finding, ...]:
    """Return a reason if more than RESERVE of the interface's peak acceleration in SIM is above the highest line."""
    if known.peaks_m_s2 is None:
        return ()
    seen = _peak(known.lines.series(known.sim[len(known.sim) - len(known.floors)], FINER))
    missing = 1.0 - seen / float(known.peaks_m_s2[0]) if known.peaks_m_s2[0] > 0.0 else 0.0
    if missing <= RESERVE:
        return ()
    values = {"share": missing, "highest_hz": known.lines.highest_hz}
    return (Finding("record.above_the_check", values, beyond=missing),)


def _peak(series: Array) -> float:
    return float(np.abs(series).max())
