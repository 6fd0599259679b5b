"""The absolute scale of a calibration, from a displacement sensor, a load cell, and what a person measured.

Accelerometers alone do not know the gain that all of them share, nor the total mass. A displacement sensor knows the
first, better the better it is calibrated itself: its reading times -w^2 is the table's acceleration. A load cell knows
the product of both: its reading is the sum of masses times accelerations. Each is one linear observation of the
calibration's parameters (`Calibration.covariance`), with the declared uncertainty of its own sensitivity, and is taken
up by a step of a Kalman filter.

Parameters are the logarithms of all sensitivities, accelerometers and further channels, and of the masses of the floors
on the table, each over its declared value. Before anybody measured they are normal: independent with the declared
uncertainties, or with the posterior of a calibration by identification, in which the ratios of gains and masses are
known far better than their sizes. The gain of a displacement sensor or load cell that the identification has taken up
follows from those of accelerometers and masses, because all of them tell the same. A comparison with a standard and a
weighing are observations of one parameter each, with their own uncertainties: in a linear Gaussian problem one
comparison moves every sensor.

Two uncertainties are returned of each. The joint one is that of this posterior. The one of the parameter by itself is
what is known of it without the ratios, as the identification widened it where sensors or masses differ more than
declared: the prior for an identification that shows the ratios anew, and by then no longer the differences. Joint
uncertainties would count the ratios twice there: several sensors that all follow from one comparison would pass for as
many comparisons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.identification.least_squares import covariance, parts
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import Calibration
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.rigs.description import Channel, RigInfo

BELOW_FIRST = 0.5  # of the first natural frequency: there all floors move with the table
SPAN = 6.0  # highest over lowest frequency of the lines that are compared
LEAST_LINES = 30


@dataclass(frozen=True)
class Observation:
    """log(reading over what the accelerometers demand) = weights (p,) @ parameters, with a standard uncertainty."""

    place: int  # of the channel among the further ones
    value: float
    weights: Array
    error: float


def observations(
    records: Sequence[Record], info: RigInfo, masses_kg: Array, low_hz: float, first_hz: float
) -> tuple[Observation, ...]:
    """Return what the further channels of a rig say of gains and masses; records are those that declared sensors made.

    `masses_kg` (n,) are the weighed masses, `first_hz` is the specimen's first natural frequency on a fixed base. Lines
    from `low_hz` up are compared, for a load cell only below half of `first_hz`.
    """
    found = []
    for place, channel in enumerate(info.further):
        if channel.position != "table" or channel.kind not in ("displacement", "force"):
            continue
        high_hz = SPAN * low_hz if channel.kind == "displacement" else min(SPAN * low_hz, BELOW_FIRST * first_hz)
        seen = [
            _lines(record, place, info.dt_s, (low_hz, high_hz), channel.kind == "displacement")
            for record in records
            if record.further is not None
        ]
        if not seen or sum(s.size for s, _, _ in seen) < LEAST_LINES:
            continue
        found.append(_observed(place, channel, seen, masses_kg, len(info.channels)))
    return tuple(found)


def _lines(
    record: Record, place: int, dt_s: float, band_hz: tuple[float, float], of_displacement: bool
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return lines s (m,) in rad/s of a record's excitation, of its accelerations (c, m) and of a further channel (m,).

    The window w is von Hann's: the lines are those of signals that begin and end at zero. A windowed displacement x is
    not the integral of the windowed acceleration: w x'' = (w x)'' - 2 (w' x)' + w'' x, so that its lines are those of
    w x - 2 (w' x) / s + (w'' x) / s^2. Without that a short record would show up to 2 % less than there is.
    """
    assert record.further is not None
    signals = np.vstack([record.accel_m_s2, record.further[place : place + 1]])[:, record.parts.noise]
    count = signals.shape[1]
    signals = signals - signals.mean(axis=1, keepdims=True)
    frequency = np.fft.rfftfreq(count, dt_s)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    s: ComplexArray = np.asarray(2j * np.pi * frequency[inside])
    spectra = np.fft.rfft(signals * np.hanning(count))[:, inside]
    reading = spectra[-1]
    if of_displacement:
        rate = 2.0 * np.pi / ((count - 1) * dt_s)
        turn = rate * dt_s * np.arange(count)
        slope, bend = 0.5 * rate * np.sin(turn), 0.5 * rate**2 * np.cos(turn)
        of_slope, of_bend = np.fft.rfft(signals[-1] * np.array([slope, bend]))[:, inside]
        reading = reading - 2.0 * of_slope / s + of_bend / s**2
    return s, spectra[:-1], reading


def _observed(
    place: int, channel: Channel, seen: Sequence[tuple[ComplexArray, ComplexArray, ComplexArray]], masses_kg: Array,
    channels: int,
) -> Observation:  # fmt: skip
    """Return the observation of one channel: the real factor a of reading = (a + b s + c / s) demanded.

    b and c are a lag and a corner between the two; they say nothing of the scale.
    """
    rows, wanted = [], []
    own = channel.uncertainty
    for s, accel, reading in seen:
        if channel.kind == "displacement":
            demanded = accel[0] / s**2
        else:
            demanded = masses_kg @ accel[1:]
            reading = reading - channel.plate_mass_kg * accel[0]
        rows.append(parts(np.array([demanded, s * demanded, demanded / s])))
        wanted.append(parts(reading))
    slopes, values = np.hstack(rows), np.concatenate(wanted)
    factors = np.linalg.lstsq(slopes.T, values, rcond=None)[0]
    left = values - factors @ slopes
    variance = float(left @ left) / max(left.size - 3, 1)
    random = np.sqrt(covariance(slopes, variance)[0, 0]) / abs(factors[0])
    if channel.kind == "force":
        own *= 1.0 + channel.plate_mass_kg / masses_kg.sum()
    value = float(np.log(factors[0])) if factors[0] > 0.0 else np.nan
    return Observation(place, value, demand_of(channel, masses_kg, channels), float(np.hypot(random, own)))


def demand_of(channel: Channel, masses_kg: Array, channels: int) -> Array:
    """Return what of log gains, corners, lags and log masses (3 c + n,) adds up to the log of a channel's reading over
    what the accelerometers demand of it, for a displacement sensor or load cell of the table of gain 1."""
    weights = np.zeros(3 * channels + len(masses_kg))
    if channel.kind == "displacement":
        weights[0] = -1.0
    else:
        share, plate = masses_kg / masses_kg.sum(), channel.plate_mass_kg / masses_kg.sum()
        weights[0], weights[1:channels], weights[3 * channels :] = -plate, -share, share
    return weights


def taken_up(mean: Array, spread: Array, weights: Array, value: float, error: float) -> tuple[Array, Array]:
    """Return mean (p,) and covariance (p, p) after an observation weights (p,) @ parameters = value +- error.

    A step of a Kalman filter; nothing changes where neither parameters nor observation are uncertain.
    """
    column = spread @ weights
    total = float(weights @ column) + error**2
    if total <= 0.0:
        return mean, spread
    return mean + column * (value - float(weights @ mean)) / total, spread - np.outer(column, column) / total


def with_scale(found: Calibration, seen: Sequence[Observation], further: int = 0) -> Calibration:
    """Return a calibration that takes up observations; one of a reversed channel (NaN) is left out.

    What an observation is off afterwards is the gain of its own channel, one of `further`: all then tell the same.
    """
    channels = len(found.gain)
    mean = np.concatenate([np.log(found.gain), np.log(found.coupling), found.late_s, np.log(found.mass)])
    spread = found.covariance
    for one in seen:
        if not np.isfinite(one.value):
            continue
        mean, spread = taken_up(mean, spread, one.weights, one.value, one.error)
    gain, coupling, late_s, mass = np.split(mean, [channels, 2 * channels, 3 * channels])
    own = np.ones(max([further, *(one.place + 1 for one in seen)]))
    for one in seen:
        own[one.place] = np.exp(one.value - float(one.weights @ mean)) if np.isfinite(one.value) else 1.0
    return replace(
        found, gain=np.exp(gain), coupling=np.exp(coupling), late_s=late_s, mass=np.exp(mass), covariance=spread,
        further_gain=own,
    )  # fmt: skip


@dataclass(frozen=True)
class Belief:
    """What is known of log sensitivities and log masses (p,) over their declared values: accelerometers, further
    channels, floors upwards. `alone` (p,) is the standard uncertainty of each without regard to the others."""

    mean: Array
    covariance: Array  # (p, p)
    alone: Array

    @property
    def joint(self) -> Array:
        """Return the standard uncertainties (p,) of the posterior."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True)
class Measured:
    """log(measured over declared) of one parameter, with its standard uncertainty."""

    place: int
    value: float
    error: float


def before(info: RigInfo, masses_kg: Array, found: Calibration | None) -> Belief:
    """Return what is known before anybody measured; `found`: the calibration of a model identified on this rig.

    `masses_kg` (n,) are those of the structure.
    """
    channels, further, floors = len(info.channels), len(info.further), len(masses_kg)
    declared = [*(one.uncertainty for one in info.all_channels), *info.uncertainty.of_masses(floors)]
    alone = np.array(declared, dtype=float)
    if found is None:
        return Belief(np.zeros(alone.size), np.diag(alone**2), alone)
    masses = slice(channels + further, None)
    for places, widening in ((slice(0, channels), found.gain_widening), (masses, found.mass_widening)):
        alone[places] *= widening if widening.size else 1.0
    demand = np.zeros((alone.size, 3 * channels + floors))
    demand[:channels, :channels], demand[masses, 3 * channels :] = np.eye(channels), np.eye(floors)
    mean, rest = np.zeros(alone.size), np.zeros(alone.size)
    mean[:channels], mean[masses] = np.log(found.gain), np.log(found.mass)
    for i, channel in enumerate(info.further):
        gain = float(found.further_gain[i]) if i < len(found.further_gain) else 1.0
        mean[channels + i] = np.log(gain)
        if gain == 1.0:
            rest[channels + i] = channel.uncertainty
        else:
            demand[channels + i] = -demand_of(channel, masses_kg, channels)
    return Belief(mean, demand @ found.covariance @ demand.T + np.diag(rest**2), alone)


def after(belief: Belief, one: Measured) -> Belief:
    """Return what is known after a measurement; that of a parameter which is declared as exact changes nothing."""
    if belief.alone[one.place] == 0.0:
        return belief
    weights, alone = np.zeros(belief.mean.size), belief.alone.copy()
    weights[one.place] = 1.0
    mean, spread = taken_up(belief.mean, belief.covariance, weights, one.value, one.error)
    alone[one.place] = (alone[one.place] ** -2 + one.error**-2) ** -0.5
    return Belief(mean, spread, alone)


def contradiction(belief: Belief, one: Measured) -> float:
    """Return by how many standard uncertainties a measurement differs from what is known before it."""
    total = float(belief.covariance[one.place, one.place]) + one.error**2
    return abs(one.value - float(belief.mean[one.place])) / float(np.sqrt(total))
