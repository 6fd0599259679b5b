"""Name the causes of a run's error: which single change of sensors, table or specimen explains what the budget left.

What the identified rig, driven by the commands that were sent, leaves of the samples is e = c - P u. A candidate is a
change of one sensor, of the table or of the specimen; to first order it adds columns to e, such as y_i for the gain of
channel i and -s y_i for the instant at which it is sampled. Both e and the columns are carried through the closed loop
to the errors of the storeys (closed_loop_response.hybrid), where each candidate is fitted by itself by least squares.

The one that leaves least is the cause, together with all others that leave hardly more: they cannot be told apart. A
candidate with a further column must leave less than its own part to be preferred. What was explained is subtracted, and
the next cause is sought until noise and rounding of the samples, known from the rest before the excitation and from the
converters, account for what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from rths_cli.analysis.error_budget import (
    ASSUMED_SCALE,
    CUT_PERIODS,
    Budget,
    Linear,
    Signals,
    Undisturbed,
    exceeds,
    samples_without_gaps,
)
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import PredictionInputs, friction_samples, predict, samples_of_push
from rths_cli.identification.results import Friction
from rths_cli.numerics.hysteresis import slid
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.structure import Specimen

FINER = 4  # times the reduced rate at which laws that are not linear are evaluated
LEAST_EXPLAINED = 0.5  # part of the power that a cause must explain to be named
ALIKE = 1.3  # times the rms that the best candidate leaves: what leaves less is as likely
RESOLVED = 0.02  # of the error's rms: candidates are first-order changes, what they leave below this tells nothing
MOST_ROUNDS = 4
STICKS = (0.03, 0.3)  # of the rms drift: over which joints stick before they slide
SMOOTH = 0.1  # of the rms: over which the sign of a force or velocity changes
STATED = ("declared", "coupling", "latency", "rounding", "lost", "drift")  # causes that the budget knows as series

GAIN, LATE, CORNER = "gain of {}", "sampling instant or low pass of {}", "AC corner of {}"
GAINS = "gains of several channels"
TABLE_GAIN = "gain of the table, or of all sensors"
DELAY = "delay of the table"
CORNERS = "AC corners of all channels"
INSTANTS = "instants of the converters or of the table's channel"
FRICTION = "friction"
ACTUATOR = "lag of the actuator"
STIFFNESS = "specimen's stiffness, masses or pitch"
DAMPING = "specimen's damping"
SOFTENING, JOINTS = "softening of the specimen", "friction in the specimen's joints"
DISTORTION, DEAD_BAND = "distortion by the amplifier", "dead band of the amplifier"
NOISE, RESOLUTION, UNKNOWN = "sensor noise", "rounded samples", "not known"
SIZES = {
    "gain": (100.0, "%"),
    "AC corner": (100.0, "%"),
    "sampling": (1e6, "us late"),
    "delay": (1e6, "us late"),
    "lag": (100.0, "%"),
}
"""Unit of the factor of a candidate with one column, by the beginning of its name."""
OF_BUDGET = {
    "declared": "specimen other than declared (stiffness, masses, softening, pitch; or wrong sensors identified it)",
    "coupling": "coupling",
    "latency": "latency left",
    "rounding": "rounded commands",
    "lost": "lost samples",
    "drift": "sensor drift",
}
OF_LAW = "what the law commands beyond its linear block (moved parameters, rounding)"


@dataclass(frozen=True)
class Cause:
    """One cause of the error, or several that cannot be told apart, and the RMS error (n_storeys,) in m/s^2."""

    names: tuple[str, ...]
    storeys: Array
    size: str = ""  # of the first, where it has one

    @property
    def told(self) -> str:
        """Return the names in one text, the likeliest first, with its size."""
        first = f"{self.names[0]} ({self.size})" if self.size else self.names[0]
        return " or ".join((first, *self.names[1:]))

    @property
    def largest(self) -> float:
        """Return the error of the worst storey."""
        return float(np.max(self.storeys))


def causes_of(
    known: PredictionInputs, signals: Signals, budget: Budget, test: Undisturbed | None = None
) -> tuple[Cause, ...]:
    """Return the causes of the measured error, the largest first; () where the specimen was not identified. `test`:
    None for a building without laws."""
    if known.specimen is None:
        return ()
    lines, loop = known.lines, test or Linear(known)

    def to_storeys(samples: ComplexArray) -> Array:
        return lines.evaluated(-loop.small(samples), CUT_PERIODS / lines.highest_hz)

    command = lines.of(signals.command_v) / known.loop.ahead
    samples = lines.of(samples_without_gaps(known, signals)) / known.loop.ahead
    rubbed = friction_samples(replace(known, velocity_m_s=signals.desired[1], compensation=None))  # what is there
    left = to_storeys(samples - known.loop.rig * command - rubbed)
    candidates = {
        name: np.array([to_storeys(column).ravel() for column in columns])
        for name, columns in _candidates(known, known.specimen, signals, samples, command)
    }
    random = predict(known).causes
    noise = np.hypot(random["noise"].storeys, random["quantisation"].storeys)
    felt = rubbed  # with what counters it
    if known.compensation is not None:
        felt = rubbed + known.loop.rig * (lines.of(known.compensation.added_v(signals.desired)) / known.loop.ahead)
    found, rubs = [], to_storeys(felt)
    for _ in range(MOST_ROUNDS):
        names, part, factors = _likeliest(candidates, left, float(np.sqrt(np.mean(noise**2))))
        if not names:
            break
        left = left - part
        if names[0] == FRICTION:
            rubs = rubs + part
            continue
        found.append(Cause(names, rms(part), _size(names[0], factors)))
        candidates = {name: rows for name, rows in candidates.items() if name not in names}
    found.append(Cause((FRICTION,), rms(rubs)))
    told = OF_BUDGET | ({"rounding": OF_LAW} if known.law else {})
    found += [Cause((told[name],), budget.causes[name].storeys) for name in STATED if name in budget.causes]
    found += _random_causes(random["noise"].storeys, random["quantisation"].storeys, rms(left))
    found = [cause for cause in found if not exceeds(cause.storeys, budget.measured.storeys)]
    return tuple(sorted(found, key=lambda cause: -cause.largest))


def _size(name: str, factors: Array) -> str:
    """Return the size of a candidate in words, "" where it has several."""
    unit = next((unit for begins, unit in SIZES.items() if name.startswith(begins)), None)
    return f"{unit[0] * factors[0]:+.3g} {unit[1]}" if unit and factors.size == 1 else ""


def _random_causes(noise: Array, rounded: Array, left: Array) -> list[Cause]:
    """Return noise, rounding and what neither explains, by their power, of what the candidates left (n_storeys,)."""
    both = np.hypot(noise, rounded)
    share = np.minimum(left / np.where(both > 0.0, both, 1.0), 1.0)
    rest = np.sqrt(np.maximum(left**2 - both**2, 0.0))
    return [Cause((NOISE,), share * noise), Cause((RESOLUTION,), share * rounded), Cause((UNKNOWN,), rest)]


def _likeliest(candidates: Mapping[str, Array], left: Array, noise: float) -> tuple[tuple[str, ...], Array, Array]:
    """Return the candidates that explain an error (n_storeys, n) alike, and part and factors of the first; () for none.

    `noise` is the rms of what no candidate can explain. Of the candidates that leave hardly more than the best one,
    those with more columns than the simplest are taken only if they leave clearly less than it.
    """
    wanted = left.ravel()
    size = float(np.sqrt(np.mean(wanted**2)))
    factors = {name: _factors(rows, wanted) for name, rows in candidates.items()}
    remains = {name: float(np.sqrt(np.mean((wanted - factors[name] @ rows) ** 2))) for name, rows in candidates.items()}
    least, most = min(remains.values()), math.sqrt(1.0 - LEAST_EXPLAINED) * size
    if least >= most:
        return (), left, np.zeros(0)
    enough = max(ALIKE * least, min(math.hypot(noise, RESOLVED * size), most))
    alike = sorted((name for name in remains if remains[name] <= enough), key=remains.__getitem__)
    fewest = min(len(candidates[name]) for name in alike)
    simplest = min(remains[name] for name in alike if len(candidates[name]) == fewest)
    names = tuple(name for name in alike if len(candidates[name]) == fewest or ALIKE * remains[name] < simplest)
    return names, (factors[names[0]] @ candidates[names[0]]).reshape(left.shape), factors[names[0]]


def _factors(rows: Array, wanted: Array) -> Array:
    """Return the factors (k,) of the combination of rows (k, n) that is nearest to `wanted` (n,)."""
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq((rows / size[:, None]).T, wanted, rcond=1e-9)[0] / size)


def _candidates(
    known: PredictionInputs, specimen: Specimen, signals: Signals, samples: ComplexArray, command: ComplexArray
) -> Iterator[tuple[str, list[ComplexArray]]]:
    """Yield each candidate's name and its columns (c, m) in the samples."""
    lines, channels = known.lines, known.rig.channels
    s = 2j * np.pi * lines.frequency_hz
    corners = 2.0 * np.pi * np.array([channel.high_pass_hz for channel in channels])
    coupled = np.array([corner / (s + corner) if corner else np.zeros_like(s) for corner in corners])
    for i, channel in enumerate(channels):
        yield GAIN.format(channel.name), [_only(i, samples)]
        yield LATE.format(channel.name), [_only(i, s * samples)]
        if corners[i]:
            yield CORNER.format(channel.name), [_only(i, -coupled * samples)]
    change = (1.0 - 1.0 / lines.z) / lines.z * command
    ripple = _first(change, samples)  # whose multiple is that of the held command in a table sample
    if corners.any():  # an identification with wrong corners finds another ripple
        yield CORNERS, [-coupled * samples, ripple]
    yield GAINS, [_only(i, samples) for i in range(len(channels))]
    answer, push = known.loop.rig * command, samples_of_push(known)
    yield TABLE_GAIN, [answer]
    yield DELAY, [-s * answer]
    yield INSTANTS, [-s * answer, ripple]
    yield DISTORTION, [answer, known.loop.rig * _of_series(known, lambda volts: volts**3, command)]
    yield DEAD_BAND, [push * _of_series(known, _smooth_sign, samples[0])]
    yield FRICTION, [push * _sign_of_velocity(known, signals)]
    if len(known.model.poles) == len(known.model.zeros) + 1:
        yield ACTUATOR, [_of_lag(known, specimen, samples, push) - known.model.ripple_m_s2_per_v * ripple]
    yield from _of_specimen(known, specimen, samples)


def _of_lag(known: PredictionInputs, specimen: Specimen, samples: ComplexArray, push: ComplexArray) -> ComplexArray:
    """Return what a lag of the actuator that is longer by its own length adds to the samples (c, m), alias left out.

    A force f that comes later by t is less by t f', as if the command were. At high frequency a volt makes f rise at a
    rate that moves the table alone, by the gain of its model: t over the force per volt is 1 / (gain mass). The alias
    of the held command is in proportion to that gain, and is lost by as much.
    """
    mass_kg, s = known.rig.moving_mass_kg, 2j * np.pi * known.lines.frequency_hz
    force = mass_kg * samples[0] + specimen.masses_kg @ samples[1:]
    return -push * known.loop.ahead * s * force / (known.model.gain * mass_kg)


def _of_specimen(
    known: PredictionInputs, specimen: Specimen, samples: ComplexArray
) -> Iterator[tuple[str, list[ComplexArray]]]:
    """Yield the candidates of the specimen: forces on its floors, which move as identified otherwise."""
    s = 2j * np.pi * known.lines.frequency_hz
    M, floors = np.diag(specimen.masses_kg), len(specimen.masses_kg)
    flexible = np.linalg.inv(M * s[:, None, None] ** 2 + specimen.C * s[:, None, None] + specimen.K)  # (m, n, n)

    def moved(forces: ComplexArray) -> ComplexArray:
        column = np.zeros_like(samples)
        column[1:] = np.einsum("mij,jm->im", flexible, forces) * s**2
        return column

    place = -np.einsum("mij,j->im", flexible, np.asarray(specimen.masses_kg)) * samples[0]
    accel = samples[0] + place * s**2
    drifts = np.diff(place, axis=0, prepend=np.zeros((1, len(s))))
    pairs = np.eye(floors) - np.eye(floors, k=1)  # a storey's force on its upper and lower floor
    springs = [moved(-pairs[:, [k]] * drifts[k]) for k in range(floors)]
    masses = [moved(-np.eye(floors)[:, [k]] * accel[k]) for k in range(floors)]
    yield STIFFNESS, [*springs, *masses]
    yield DAMPING, [moved(-pairs[:, [k]] * s * drifts[k]) for k in range(floors)]
    soft = [_of_series(known, lambda drift: drift * np.abs(drift), drift) for drift in drifts]
    yield SOFTENING, [*springs, *(moved(-pairs[:, [k]] * soft[k]) for k in range(floors))]
    rubbed = [[_of_series(known, partial(_slid, share=share), drift) for share in STICKS] for drift in drifts]
    yield JOINTS, [*springs, *(moved(-pairs[:, [k]] * force) for k in range(floors) for force in rubbed[k])]


def _slid(drift: Array, share: float) -> Array:
    """Return the force (n,) of a joint that sticks over a share of the rms drift (n,) and then slides at one."""
    return slid(drift, share * float(rms(drift)))


def _smooth_sign(series: Array) -> Array:
    return np.tanh(series / (SMOOTH * float(rms(series)) or 1.0))


def _sign_of_velocity(known: PredictionInputs, signals: Signals) -> ComplexArray:
    """Return the lines (m,) of the command that is equivalent to friction of 1 V."""
    velocity = signals.desired[1]
    scale = known.friction.scale_m_s if known.friction else ASSUMED_SCALE * (float(rms(velocity)) or 1.0)
    return known.lines.of(Friction(1.0, 0.0, math.inf, 0.0, scale).disturbance_v(velocity))


def _of_series(known: PredictionInputs, law: Callable[[Array], Array], row: ComplexArray) -> ComplexArray:
    """Return the lines (m,) of a law of a series, given by its lines (m,)."""
    lines = known.lines
    count = FINER * lines.reduced
    found = law(lines.series(row, FINER))
    return np.asarray(np.fft.rfft(found, count)[: lines.count] * (lines.padded / count))


def _only(channel: int, samples: ComplexArray) -> ComplexArray:
    column = np.zeros_like(samples)
    column[channel] = samples[channel]
    return column


def _first(row: ComplexArray, samples: ComplexArray) -> ComplexArray:
    """Return a column (c, m) that disturbs the table's channel alone."""
    column = np.zeros_like(samples)
    column[0] = row
    return column
