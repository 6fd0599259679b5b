"""The steps of the specimen's identification from its records; the fit itself is specimen_fit.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rths_cli.identification.chain_residual import first_values, grouped
from rths_cli.identification.channel_signals import channel_noise
from rths_cli.identification.inputs import Evidence
from rths_cli.identification.least_squares import covariance, least_squares
from rths_cli.identification.nonlinear_specimen import identify_nonlinear
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import NonlinearSpecimen, SpecimenFit
from rths_cli.identification.specimen_fit import (
    ABOVE_HIGHEST,
    MISFIT,
    Motion,
    Start,
    alive,
    evaluated,
    fit_specimen,
    fit_stretches,
    least_samples,
    modal,
    reach_of,
    transform,
)
from rths_cli.identification.verdict import AGREE_SIGMA
from rths_cli.numerics.lti import Array, Model, integral_share

PHASE = 3e-4  # rad; smaller phase errors between channels may be residuals of the sensor correction
BELOW_FIRST = 0.5  # the specimen's lines begin at this fraction of the first natural frequency or lower
MOST_SKEW, SEEN_SKEW = 0.25, 0.05  # skew between floors and table in samples: rejected, reported
ENOUGH = 120_000  # samples of a first look
MOST_UNEXPLAINED = 0.5  # part of the floors' motion in a record at low level that a chain may leave


def without_staircase(table_accel: Array, command_v: Array, model: Model) -> Array:
    """Return the table's samples (n,) in m/s^2 minus the alias of the held command (n,) in V.

    The command is assumed constant before the record.
    """
    return table_accel - model.ripple_m_s2_per_v * _staircase(command_v, model)


def _staircase(command_v: Array, model: Model) -> Array:
    """Return the alias (n,) in V that a ripple of 1 m/s^2 per V makes of the held command."""
    late, count = max(model.latency_samples, 1), len(command_v)
    moved = np.concatenate([np.zeros(late + 1), command_v - command_v[0]])
    now, before = moved[1 : count + 1], moved[:count]
    return (now - before) + integral_share(model.coupling_hz, model.dt_s) * (now + before)


def motions(data: Evidence, model: Model | None, free: bool) -> list[Motion]:
    """Return table and floors during each record's excitation or, with `free`, during its free vibration if any."""
    found = [_motion(record, model, free) for record in data.records]
    return [motion for motion in found if motion is not None]


def _motion(record: Record, model: Model | None, free: bool) -> Motion | None:
    """Return table and floors of one record, minus the staircase's alias if a model is given."""
    part = record.parts.free_vibration if free else record.parts.noise
    if part is None:
        return None
    table, floors = record.accel_m_s2[0], record.accel_m_s2[1:]
    if model is None:
        return Motion(table, floors).cut(part)
    staircase = _staircase(record.command_v, model)
    return Motion(table - model.ripple_m_s2_per_v * staircase, floors, staircase).cut(part)


def first_look(data: Evidence) -> Start:
    """Return start values of the specimen: from the storeys' equations, improved by a fit to a minute of motion.

    The result of that fit is used only if it explains the motion. The table's samples contain the alias of the hold's
    staircase, which only a model of the table can remove, and a fit that takes it for motion makes the values worse.
    """
    if len(data.masses_kg) == 0:
        return Start(np.zeros(0), np.zeros(0))
    start = Start(*first_values(grouped(data.records, data.info, data.masses_kg, data.settings.band_hz)))
    minute = [motion.cut(slice(0, ENOUGH)) for motion in motions(data, None, free=False)]
    fitted, left = fit_motions(data, start, minute)
    return fitted if left <= MISFIT else start


def fit_motions(data: Evidence, start: Start, seen: Sequence[Motion]) -> tuple[Start, float]:
    """Fit the specimen to whole motions, which have no leakage however light the damping.

    Returns the stiffnesses and damping ratios, and the relative residual of the floors' motion.
    """
    if len(data.masses_kg) == 0:
        return start, 0.0
    found = fit_specimen(seen, data.info.dt_s, data.masses_kg, lowest_hz(data, start), start)
    return Start(found.stiffness_n_per_m, found.damping_ratio), found.residual


def lowest_hz(data: Evidence, start: Start) -> float:
    """Return the lowest frequency in Hz of the specimen's lines.

    It is the start of the band, or half the first natural frequency if that is lower. The specimen may be fitted below
    the excited band, because table and floors are both measured, however small their motion.
    """
    if len(data.masses_kg) == 0:
        return data.settings.band_hz[0]
    first_hz = float(modal(data.masses_kg, start.stiffness_n_per_m)[0][0]) / (2.0 * np.pi)
    return min(data.settings.band_hz[0], BELOW_FIRST * first_hz)


def excited(data: Evidence, model: Model, start: Start) -> SpecimenFit | None:
    """Return the specimen from the excitation, None without floors."""
    if len(data.masses_kg) == 0:
        return None
    seen = motions(data, model, free=False)
    return fit_stretches(seen, data.info.dt_s, data.masses_kg, lowest_hz(data, start), start, free=False)


def freely_vibrating(
    data: Evidence, model: Model, known: SpecimenFit | None
) -> tuple[SpecimenFit | None, tuple[str, ...]]:
    """Return the specimen identified from the free vibrations, as far as they exceed the channels' noise.

    `known` is the specimen from the excitation. Returns None without a usable free vibration; the second value is a
    sentence if all of them are too short.
    """
    if known is None:
        return None, ()
    held = [record for record in data.records if record.parts.free_vibration is not None]
    dt_s, low_hz = data.info.dt_s, lowest_hz(data, Start(known.stiffness_n_per_m, known.damping_ratio))
    least = least_samples(known.natural_frequency_hz, dt_s, low_hz)
    seen = [_living(record, data, model) for record in held]
    lasting = [motion for motion in seen if len(motion.table) >= least]
    if not lasting:
        longest_s = dt_s * max((len(motion.table) for motion in seen), default=0)
        said = (
            f"free vibration: not used; {longest_s:.2g} s of it stand out of the channels' noise, frequencies and "
            f"damping ratios take {least * dt_s:.2g} s"
        )
        return None, (said,) if held else ()
    first = Start(known.stiffness_n_per_m, known.damping_ratio)
    return fit_stretches(lasting, dt_s, data.masses_kg, low_hz, first, free=True), ()


WHOLE_CHANGE = 1.5  # change of a law from rest to full level over that from a fifth of it to full level
STUCK = 2.0  # factor on what friction that slides at both levels leaves at full level; it may stick at the low one


def at_low_level(data: Evidence, model: Model, known: SpecimenFit | None) -> SpecimenFit | None:
    """Return the specimen from the record at low level alone; None without one, or where it is too short or no chain
    explains half of its motion."""
    seen = _quiet_motion(data, model, known)
    if seen is None or known is None:
        return None
    start = Start(known.stiffness_n_per_m, known.damping_ratio)
    low_hz = lowest_hz(data, start)
    low = fit_specimen([seen], data.info.dt_s, data.masses_kg, low_hz, start)
    return None if low.residual > MOST_UNEXPLAINED else low


def _quiet_motion(data: Evidence, model: Model, known: SpecimenFit | None) -> Motion | None:
    """Return table and floors in the record at low level; None without one, or where it is too short."""
    if data.quiet is None or known is None:
        return None
    found = _motion(data.quiet, model, free=False)
    low_hz = lowest_hz(data, Start(known.stiffness_n_per_m, known.damping_ratio))
    least = least_samples(known.natural_frequency_hz, data.info.dt_s, low_hz)
    return None if found is None or len(found.table) < least else found


def of_level(level_ratio: float, known: SpecimenFit | None, low: SpecimenFit | None) -> tuple[Array, Array]:
    """Return the relative uncertainty (n,) of frequencies and of damping ratios by their dependence on the level.

    `low`: from the record at low level, below full level by `level_ratio`. The uncertainty is 1.5 times the change
    between the records at low and at full level, beyond what the fits scatter. A stiffness
    that changes as A / (A + h) with the amplitude A changes from rest to full level 1.25 (A much less than h) to 2
    (A = 3 h) times as much as from a fifth of that level. Damping that falls as the level grows is dry friction, which
    leaves 1 / (r - 1) of the change at full level for levels of ratio r. Zeros where nothing is known of the low level.
    """
    modes = 0 if known is None else len(known.damping_ratio)
    if known is None or low is None:
        return np.zeros(modes), np.zeros(modes)
    hz, damping = (_beyond_scatter(known, low, *names) for names in (
        ("natural_frequency_hz", "frequency_error_hz"), ("damping_ratio", "damping_error")))  # fmt: skip
    rubbed = min(STUCK / max(level_ratio - 1.0, 1.0), WHOLE_CHANGE)
    return WHOLE_CHANGE * np.abs(hz), np.where(damping > 0.0, rubbed * damping, -WHOLE_CHANGE * damping)


def _beyond_scatter(full: SpecimenFit, low: SpecimenFit, value: str, error: str) -> Array:
    """Return the logarithm (n,) of a value at low level over that at full level, less what the fits scatter."""
    here, there = getattr(full, value), getattr(low, value)
    change, scatter = np.log(there / here), np.hypot(getattr(full, error) / here, getattr(low, error) / there)
    return np.asarray(np.sign(change) * np.sqrt(np.maximum(change**2 - scatter**2, 0.0)))


def nonlinear(data: Evidence, model: Model, known: SpecimenFit | None) -> NonlinearSpecimen | None:
    """Return the specimen as it is at every level of the records; None if it is linear as far as they show.

    None without a record at low level, or where that is too short.
    """
    quiet = _quiet_motion(data, model, known)
    if quiet is None or known is None:
        return None
    low_hz = lowest_hz(data, Start(known.stiffness_n_per_m, known.damping_ratio))
    band_hz = low_hz, ABOVE_HIGHEST * float(known.natural_frequency_hz[-1])
    loud = motions(data, model, free=False)
    return identify_nonlinear(loud, quiet, data.info.dt_s, data.masses_kg, known.stiffness_n_per_m, band_hz)


def with_level(known: SpecimenFit | None, frequency: Array, damping: Array) -> SpecimenFit | None:
    """Return a fit whose frequencies and damping ratios have these relative uncertainties (n,) beside their own."""
    if known is None:
        return None
    return replace(
        known,
        frequency_error_hz=np.hypot(known.frequency_error_hz, frequency * known.natural_frequency_hz),
        damping_error=np.hypot(known.damping_error, damping * known.damping_ratio),
    )


def _living(record: Record, data: Evidence, model: Model) -> Motion:
    """Return table and floors in a record's free vibration, up to the instant at which noise hides it."""
    motion = _motion(record, model, free=True)
    assert motion is not None
    return motion.cut(alive(motion.floors, channel_noise(record, data.info)[1:]))


def out_of_step(data: Evidence, model: Model, found: SpecimenFit | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return reasons to reject the channels, and warnings, if the floors are out of step with the table."""
    if found is None:
        return (), ()
    dt_s, start = data.info.dt_s, Start(found.stiffness_n_per_m, found.damping_ratio)
    seen = [motion.cut(slice(0, ENOUGH)) for motion in motions(data, model, free=False)]
    late, error = skew(seen, dt_s, data.masses_kg, lowest_hz(data, start), start)
    error = float(np.hypot(error, PHASE / (2.0 * np.pi * found.natural_frequency_hz[-1] * dt_s)))
    sentence = (
        f"channels: the floors are {abs(late):.2f} samples ({1e3 * abs(late) * dt_s:.3g} ms) "
        f"{'late' if late > 0.0 else 'early'} against the table; all must be sampled at one instant, and their sensors "
        "have the stated corners"
    )
    if abs(late) > MOST_SKEW + AGREE_SIGMA * error:
        return (sentence,), ()
    return (), ((sentence,) if abs(late) > SEEN_SKEW + AGREE_SIGMA * error else ())


EXPLAINS = 0.5  # a skew is accepted as the cause if it reduces the unexplained motion to this fraction
MOST_LEFT = 0.1  # largest residual, as a fraction of the floors' motion
LONGEST = 1000.0  # largest skew of the fit, in samples


def skew(motions: Sequence[Motion], dt_s: float, masses_kg: Array, low_hz: float, start: Start) -> tuple[float, float]:
    """Return by how many samples the floors are late against the table, and the standard error of this skew.

    Both are zero if a skew does not halve the motion that the specimen leaves unexplained, or leaves more than a tenth
    of the floors' motion: then the residual has another cause.
    """
    masses = np.asarray(masses_kg, dtype=float)
    highest = modal(masses, start.stiffness_n_per_m)[0][-1] / (2.0 * np.pi)
    lines = [transform(motion, dt_s, (low_hz, ABOVE_HIGHEST * highest)) for motion in motions]

    def left(theta: Array) -> tuple[Array, Array]:
        late = [replace(part, table=part.table * np.exp(-part.s * dt_s * theta[-1])) for part in lines]
        residual, slopes = evaluated(late, masses, theta[:-1])
        slopes[-1] *= dt_s
        return residual, slopes

    first = np.append(np.log(np.concatenate([start.stiffness_n_per_m, start.damping_ratio])), 0.0)
    found = least_squares(left, first, reach=np.append(reach_of(len(masses)), LONGEST))
    unexplained = float(np.linalg.norm(left(first)[0]))
    if found.size > min(EXPLAINS * unexplained, MOST_LEFT * np.sqrt(len(motions))):
        return 0.0, 0.0
    variance = found.size**2 / max(len(found.residual) - len(first), 1)
    return float(found.parameters[-1]), float(np.sqrt(covariance(found.slopes, variance)[-1, -1]))
