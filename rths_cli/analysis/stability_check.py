"""Whether a hybrid test may be run: stability of the sampled loop, what it tolerates, and what it asks of the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, Context

import numpy as np

from rths_cli.analysis.closed_loop_matrix import closed_loop_matrix
from rths_cli.analysis.closed_loop_response import loop_response
from rths_cli.analysis.critical_delay import CriticalDelay
from rths_cli.analysis.fourier_lines import HIGHEST_HZ
from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.analysis.predicted_error import Known, Prediction, data_ratio, ratio_error
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.margins import Margins, margins
from rths_cli.identification.results import LevelBand
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model
from rths_cli.numerics.matrix_equations import distinct
from rths_cli.rigs.description import BRAKE_SHARE, RigInfo

SAFE, UNSAFE, UNSTABLE = "safe", "unsafe", "unstable"
COMPARED_HZ = 11.0
GAIN_CHANGE = 0.1  # of the table's gain, from identification to the end of a test
UNSEEN_CHANGE, UNCOMPARED_CHANGE = 0.01, 0.06  # of its response: what a verification lets pass; without a low level
SIGMA = 3.0  # standard uncertainties of the measured response
LEAST_DELAY_S = 1e-3  # further delay that a loop must tolerate where less is not known to be enough
RESERVE = 0.1  # of every limit
ROOM_PARTS = 4  # the room after the record whose last part shows what is left of slow motions
FINER = 8  # points of a peak's series per point of the reduced one
MOST_GROWN = 1e99  # stated; result files hold no larger numbers
GROWN = 1e3  # over the record, from which growth is no doubt
LOWEST_HZ, POINTS, AROUND, WIDTH = 0.05, 1500, 100, 0.2  # of the grid: in all, about each closed-loop mode, half width
MODES_HZ = 60.0
LEAST_LOOP = 1e-12  # a smaller loop gain is none


@dataclass(frozen=True)
class Stability:
    """`radius` of the closed-loop matrix, `growth` over the record (1 and less: none); margins of the loop broken at
    the command, on the measured response and on the model; `tolerates` and `required`: error of the table's response
    (of the measured one beyond its scatter, and of the model) that makes the loop unstable with the gain of GAIN_CHANGE
    that is the worst (`gain`, a factor), and that it must stand, where the two are nearest, `at_hz`; `in_band`: the
    smallest that makes it unstable up to 11 Hz, `in_band_hz` where; `apart`: largest |(1 + L) / (1 + L_model) - 1| of
    the loop on the measured response, beyond its scatter: below one both go round -1 alike (Rouche), and the model's
    radius speaks for both."""

    radius: float
    growth: float
    measured: Margins
    modelled: Margins
    tolerates: float
    required: float
    at_hz: float
    in_band: float = math.inf
    in_band_hz: float = math.nan
    apart: float = 0.0
    gain: float = 1.0


@dataclass(frozen=True)
class Reach:
    """The predicted peak of a quantity beside its limit, both in `units`."""

    name: str
    peak: float
    limit: float
    units: str

    @property
    def share(self) -> float:
        """Return the peak as a share of the limit."""
        return self.peak / self.limit


@dataclass(frozen=True)
class Preflight:
    """What is known of a hybrid test before it moves anything; `reasons` say why it is not safe."""

    verdict: str
    reasons: tuple[str, ...]
    critical: CriticalDelay
    stability: Stability
    reach: tuple[Reach, ...]
    largest_scaling: float
    prediction: Prediction | None


def judge(
    critical: CriticalDelay, stability: Stability, reach: tuple[Reach, ...], scaling: float,
    prediction: Prediction | None, further: tuple[str, ...] = (), feedback: bool = False,
    least_delay_s: float = LEAST_DELAY_S,
) -> Preflight:  # fmt: skip
    """Return the verdict: unstable, unsafe (which limit), or safe; `further` reasons make a stable loop unsafe.

    `feedback`: the controller has one, so that no advice asks for it. `least_delay_s`: further delay it must tolerate.
    """
    reasons = faults_of_loop(stability, feedback, least_delay_s)
    doubt = stability.radius >= 1.0 and stability.growth >= GROWN
    largest = scaling * min((1.0 - RESERVE) / row.share if row.share > 0.0 else math.inf for row in reach)
    if stability.radius < 1.0:
        reasons += [*further, *(_beyond(row, largest) for row in reach if not row.share <= 1.0 - RESERVE)]
    verdict = UNSTABLE if doubt else UNSAFE if reasons else SAFE
    return Preflight(verdict, tuple(reasons), critical, stability, reach, largest, prediction)


def required_delay_s(dt_s: float, bridged: bool, error_s: float | None = None, compared: bool = True) -> float:
    """Return the further delay in s that a loop must tolerate.

    It is SIGMA times the standard uncertainty `error_s` of the identified delay (None: not known) and what a
    verification lets pass at COMPARED_HZ; `compared`: it has a record at low level to compare with. It is LEAST_DELAY_S
    at most: a delay is less certain only where the model's roots can stand for it, and then the lag of both together
    is measured. `bridged`: the loop goes on by its model where a sample is lost. Elsewhere a lost sample holds the
    command, and one lost and one late sample must not endanger the loop.
    """
    unseen = (UNSEEN_CHANGE if compared else UNCOMPARED_CHANGE) / (2.0 * math.pi * COMPARED_HZ)
    least = LEAST_DELAY_S if error_s is None else min(unseen + SIGMA * error_s, LEAST_DELAY_S)
    return least if bridged else max(2.0 * dt_s, least)


def faults_of_loop(found: Stability, feedback: bool = False, least_delay_s: float = LEAST_DELAY_S) -> list[str]:
    """Return why a loop is not safe whatever is played; nothing for one that is."""
    return _fragile(found, feedback, least_delay_s) if found.radius < 1.0 else _unstable(found)


def rounded_down(value: float, digits: int = 3) -> float:
    """Return a positive number of at most so many significant digits that is not above the given one."""
    return float(Context(prec=digits, rounding=ROUND_DOWN).create_decimal(repr(float(value))))


def _unstable(found: Stability) -> list[str]:
    if found.radius < 1.0:
        return []
    return [
        f"the sampled closed loop is unstable: its spectral radius is {found.radius:.6f}, motions grow by a factor "
        f"{found.growth:.3g} over the record; choose another controller, more damping, or less mass on the table"
    ]


def _fragile(found: Stability, feedback: bool, least_delay_s: float) -> list[str]:
    """Return a sentence when too small an error of the table, or too little delay, makes the loop unstable."""
    reasons = []
    if not found.apart < 1.0:  # so that what is no number is no margin
        reasons.append(
            "the table's measured response differs so much from its model that the model's stability says nothing of "
            "the table's; identify again"
        )
    if not found.tolerates >= found.required:
        reasons.append(
            f"{_with_gain(found.gain)}an error of {found.tolerates:.2%} in the table's response at "
            f"{found.at_hz:.3g} Hz makes the loop unstable, it must stand {found.required:.2%}; "
            f"{_advice(found.at_hz, feedback)}"
        )
    if not found.measured.delay_margin_s >= least_delay_s:
        reasons.append(
            f"{1e3 * found.measured.delay_margin_s:.3g} ms of further delay make the loop unstable, it must stand "
            f"{1e3 * least_delay_s:.3g} ms; put less of the interface floor's mass on the table, or add damping"
        )
    return reasons


def _with_gain(gain: float) -> str:
    """Return which change of the table's gain comes first, nothing for none."""
    return "" if round(gain, 3) == 1.0 else f"with {gain:.3g} times the table's gain "


def _advice(at_hz: float, feedback: bool) -> str:
    """Return what to do about a loop that stands too small an error at a frequency: among the modes, or above them."""
    if at_hz <= COMPARED_HZ:
        higher = "cut the building higher up"
        return f"add damping to the structure{f' or {higher}' if feedback else f', {higher}, or use FF+FB'}"
    less = "lower feedback_bandwidth_hz, use controller FF, " if feedback else ""
    return f"put less of the interface floor's mass on the table, {less}or identify to a higher frequency"


def _beyond(row: Reach, largest: float) -> str:
    return (
        f"{row.name}: {row.peak:.4g} {row.units} is predicted, the limit is {row.limit:.4g} {row.units} and a tenth of "
        f"it is kept in reserve; the largest safe scaling is {rounded_down(largest):g}"
    )


def stability(
    rig: IdentifiedRig, blocks: Blocks, storeys: Block, model: Model, measured: Frf, samples: int,
    levels: Sequence[LevelBand] = (),
) -> Stability:  # fmt: skip
    """Return the stability of the sampled loop of identified rig and blocks for a record of so many samples.

    `levels`: the table's response at low level over that at full level, () where there is no record at low level.
    """
    matrix = closed_loop_matrix(rig, blocks)
    values = np.linalg.eigvals(matrix).astype(complex)
    radius = float(np.abs(values).max())
    frequency = _grid(values, rig.plant.dt_s)
    loop = loop_response(rig, blocks, storeys, np.exp(2j * np.pi * frequency * rig.plant.dt_s))
    ratio, scatter = data_ratio(model, measured, frequency), ratio_error(model, measured, frequency)
    on_data, seen = loop.with_rig(ratio), loop.with_rig(_beyond_scatter(ratio, scatter))
    gains = np.stack([_worst_gain(each, frequency, max(model.band_hz[1], COMPARED_HZ)) for each in (seen, loop.loop)])
    errors = np.stack([_tolerated(each, gain) for each, gain in zip((seen, loop.loop), gains, strict=True)])
    tolerated, gain = errors.min(axis=0), np.where(errors[0] <= errors[1], *gains)
    wanted = required(frequency, model.band_hz, scatter, levels)
    nearest = int(np.argmin(tolerated / wanted))
    weakest = int(np.argmin(np.where(frequency <= COMPARED_HZ, tolerated, math.inf)))
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
    )


def growth(radius: float, samples: int) -> float:
    """Return the factor by which the slowest motion of a loop of this spectral radius changes over a record, at most
    MOST_GROWN."""
    return float(np.exp(min(samples * math.log(radius), math.log(MOST_GROWN)))) if radius > 0.0 else 0.0


def _worst_gain(loop: ComplexArray, frequency_hz: Array, identified_hz: float) -> Array:
    """Return the factor (n,) on the table's gain, up to GAIN_CHANGE off, that puts the loop gain nearest to -1.

    It is one beyond the identified band, where a table is doubted altogether. The relative error that is left is
    |1 + 1 / (g L)|, a parabola of 1 / g.
    """
    over = 1.0 / np.where(np.abs(loop) > LEAST_LOOP, loop, LEAST_LOOP)
    share = np.clip(-over.real / np.abs(over) ** 2, 1.0 / (1.0 + GAIN_CHANGE), 1.0 / (1.0 - GAIN_CHANGE))
    return np.where(frequency_hz <= identified_hz, 1.0 / share, 1.0)


def _tolerated(loop: ComplexArray, gain: Array) -> Array:
    """Return the smallest relative error of a table of so many times the gain (n,) that puts the loop gain on -1."""
    return np.abs(1.0 + gain * loop) / np.maximum(np.abs(gain * loop), LEAST_LOOP)


def required(frequency_hz: Array, band_hz: tuple[float, float], scatter: Array, levels: Sequence[LevelBand]) -> Array:
    """Return the error of the table's response that a loop must stand beside a change of its gain, (n,).

    It is what identification and verification leave open: a change that is let pass, SIGMA times the uncertainty of
    the measured response (n,), what level and friction change, and modes beyond the identified band `band_hz`. One at
    twice its end adds (f / f_0)^2 to the table below it; from there on nothing is known of the table, and all of it is
    doubted. Below the band, and above COMPARED_HZ, where a verification is coarse, it is that of a table without a
    record at low level.
    """
    compared = (frequency_hz >= band_hz[0]) & (frequency_hz <= COMPARED_HZ) & bool(levels)
    unseen = np.where(compared, UNSEEN_CHANGE, UNCOMPARED_CHANGE)
    beyond = (frequency_hz / (2.0 * max(band_hz[1], COMPARED_HZ))) ** 2
    return np.minimum(unseen + SIGMA * scatter + _by_level(frequency_hz, levels) + beyond, 1.0)


def _by_level(frequency_hz: Array, levels: Sequence[LevelBand]) -> Array:
    """Return the change of the table's response from full to low level, (n,), interpolated between the bands' centres:
    a test moves the table by anything between.

    What the scatter of the comparison may hide counts too, up to what a table without a comparison is doubted by.
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
    """Return a ratio of measured response to model, (n,), less what SIGMA standard uncertainties explain of it."""
    off = np.abs(ratio - 1.0)
    return 1.0 + (ratio - 1.0) * np.maximum(1.0 - SIGMA * scatter / np.maximum(off, LEAST_LOOP), 0.0)


def _grid(values: ComplexArray, dt_s: float) -> Array:
    """Return frequencies in Hz on which a loop of these eigenvalues (n,) is looked at, dense about its modes."""
    values = values[np.abs(values) > 0.1]
    modes = np.abs(np.log(values)) / (2.0 * np.pi * dt_s)
    modes = distinct(np.round(modes[(modes > LOWEST_HZ) & (modes < MODES_HZ)], 6))
    around = np.outer(modes, 1.0 + WIDTH * np.linspace(-1.0, 1.0, AROUND) ** 3).ravel()
    return distinct(np.concatenate([np.geomspace(LOWEST_HZ, 0.4 / dt_s, POINTS), around]))


def reach(known: Known, prediction: Prediction, rig: RigInfo, masses_kg: Array) -> tuple[Reach, ...]:
    """Return what the undisturbed test asks of table and sensors, beside the limits that the guard holds.

    `masses_kg` (c,): moving mass and floors. Displacement and velocity are the command's through the nominal gain, as
    the guard sees them, the displacement with the room to brake.
    """
    lines, motion = known.lines, prediction.nominal
    s = 2j * np.pi * lines.frequency_hz
    command, rate = (_from_rest(known, values) for values in (motion.command_v, s * motion.command_v))
    accel = np.array([_from_rest(known, values) for values in motion.corrected])
    loudest = _peak(accel) if known.peaks_m_s2 is None else max(_peak(accel), float(known.peaks_m_s2.max()))
    place, speed = rig.gain_m_per_v * command, rig.gain_m_per_v * rate
    braked = place + 0.5 * speed * np.abs(speed) / (BRAKE_SHARE * rig.limits.acceleration_m_s2)
    force = masses_kg @ accel
    range_m_s2 = min(min(c.range_m_s2, rig.converters.range_v / c.sensitivity_v_per_m_s2) for c in rig.channels)
    rounding = rig.gain_m_per_v * rig.converters.step_v / rig.dt_s
    stroke = min(rig.limits.stroke_m, rig.gain_m_per_v * rig.converters.range_v)
    return (
        Reach("displacement (with room to brake)", _peak(np.maximum(np.abs(place), np.abs(braked))), stroke, "m"),
        Reach("velocity", _peak(speed) + rounding, rig.limits.velocity_m_s, "m/s"),
        Reach("acceleration", loudest, rig.limits.acceleration_m_s2, "m/s^2"),
        Reach("accelerometers' range", loudest, range_m_s2, "m/s^2"),
        Reach("actuator force", _peak(force), rig.limits.force_n, "N"),
        Reach("command", _peak(command), rig.converters.range_v, "V"),
    )


def _from_rest(known: Known, values: ComplexArray) -> Array:
    """Return the series (n,) of lines (m,) of a test that starts at rest.

    Lines are those of a record that is repeated, so that a motion slower than the room after it is still there at the
    next start. What the loop's slow roots make of the end of that room is taken off, as it goes on from there.
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
    """Return the free motions (n, 2 k) of roots (k,) in rad/s, cosine and sine of each, from sample first to end."""
    motion = np.exp(np.outer(dt_s * np.arange(first, end), roots))
    return np.hstack([motion.real, motion.imag])


def unseen(known: Known) -> tuple[str, ...]:
    """Return a sentence when more than a reserve's share of the interface's peak acceleration in SIM is above the
    lines."""
    if known.peaks_m_s2 is None:
        return ()
    seen = _peak(known.lines.series(known.sim[len(known.sim) - len(known.floors)], FINER))
    missing = 1.0 - seen / float(known.peaks_m_s2[0]) if known.peaks_m_s2[0] > 0.0 else 0.0
    if missing <= RESERVE:
        return ()
    return (
        f"{missing:.0%} of the interface floor's peak acceleration lies above {HIGHEST_HZ:g} Hz, where the check does "
        "not look; filter the record, or soften the computed storeys that shake there",
    )


def _peak(series: Array) -> float:
    return float(np.abs(series).max())
