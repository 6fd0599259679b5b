"""The steps of the specimen's identification from its records, with springs that bend and joints that rub; the
linear fit itself is specimen_fit.py.

One chain with the same storeys makes both records. The force of a storey, which carries the inertia of the floors above
it, is the sum of a spring, dashpots, joints that stick like a spring over a drift before they slide, and springs of
either sign that are touched beyond a drift of either side:

    sum over j >= i of m_j a_j + k_i u_i + sum over all storeys of c_ij v_j
        + sum of joints of u_i + sum of b g(u_i) = 0,    g(u) = u - min(max(u, -h), h), u_i = x_i - x_(i-1).

Joints in parallel make any hysteresis that does not depend on the rate (W. D. Iwan, J. Appl. Mech. 33, 1966, 893), the
others any elastic spring that is the same to both sides. No law is assumed: drifts over which joints stick and beyond
which springs are touched are fixed multiples of the drift in the record at low level, and the sizes follow by least
squares from the Fourier lines of whole records: each line weighted by what white noise of all channels makes of the
equation (a drift is an acceleration over s^2), each record by what it leaves. A joint cannot push.

A linear equivalent of such a specimen holds at one level only. The chain itself holds at all levels that the records
contain, and is used to say what a test at another level will show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.findings import Finding
from rths_cli.identification.chain_residual import first_values, grouped
from rths_cli.identification.channel_signals import channel_noise
from rths_cli.identification.inputs import Evidence
from rths_cli.identification.least_squares import covariance, least_squares, linear, parts
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
from rths_cli.numerics.hysteresis import slid
from rths_cli.numerics.lti import Array, ComplexArray, Model, integral_share

STICKS = (0.03, 0.1, 0.3, 1.0)  # drifts over which joints stick, over the rms drift at low level
BENDS = (0.5, 1.0, 2.0, 4.0, 8.0)  # drifts beyond which springs are touched, over the same
RATE = 24.0  # sample rate of the forces of joints and bends, over the highest frequency
ENDS = 4  # number of powers of 1 / s that represent the ends of a record
ROUNDS = 4  # iterations of the records' weights
WORTH = 0.8  # laws are believed if they reduce what a linear storey leaves to this share, geometric mean of the records
REAL = 1e-6  # least residual, over the inertia
LOST = 1e-7  # what is smaller, relative to the whole, is what rounding makes of zero

PHASE = 3e-4  # rad; smaller phase errors between channels may be residuals of the sensor correction
BELOW_FIRST = 0.5  # the specimen's lines begin at this fraction of the first natural frequency or lower
MOST_SKEW, SEEN_SKEW = 0.25, 0.05  # skew between floors and table in samples: rejected, reported
ENOUGH = 120_000  # samples of a first look
MOST_UNEXPLAINED = 0.5  # part of the floors' motion in a record at low level that a chain may leave
WHOLE_CHANGE = 1.5  # change of a law from rest to full level over that from a fifth of it to full level
STUCK = 2.0  # factor on what friction that slides at both levels leaves at full level; it may stick at the low one
EXPLAINS = 0.5  # a skew is accepted as the cause if it reduces the unexplained motion to this fraction
MOST_LEFT = 0.1  # largest residual, as a fraction of the floors' motion
LONGEST = 1000.0  # largest skew of the fit, in samples


@dataclass(frozen=True)
class _Equations:
    """Weighted lines of one record, (n, ...) by storey: the inertia it carries and what may balance it."""

    inertia: ComplexArray  # (n, m)
    drift: ComplexArray  # (n, m)
    velocity: ComplexArray  # (n, n, m): of all storeys, in each equation
    joints: ComplexArray  # (n, j, m) of 1 N
    bends: ComplexArray  # (n, b, m) of 1 N/m
    ends: ComplexArray  # (n, e, m)


@dataclass(frozen=True)
class _Storey:
    """What was found of a storey, and what it leaves of its equation's lines in each record."""

    spring: float
    dashpots: Array  # (n,)
    joints: Array  # (j,) N
    bends: Array  # (b,) N/m
    left: Array  # (records,)


def identify_nonlinear(
    loud: Sequence[Motion], quiet: Motion, dt_s: float, masses_kg: Array, stiffness_n_per_m: Array,
    band_hz: tuple[float, float],
) -> NonlinearSpecimen | None:  # fmt: skip
    """Return the specimen with the laws of its storeys, from the accelerations of records at full and at low level.

    `stiffness_n_per_m` (n,): of its linear equivalent, for the weights of lines.
    None where the storeys are linear as far as the records show, or where what explains them is no specimen: a storey
    without stiffness, dashpots that add energy.
    """
    masses, seen = np.asarray(masses_kg, dtype=float), (*loud, quiet)
    lines = [_Lines.of(motion, dt_s, band_hz) for motion in seen]
    rms_m = lines[-1].series().std(axis=1)
    sticks, bends = np.outer(rms_m, STICKS), np.outer(rms_m, BENDS)
    records = [_equations(each, masses, stiffness_n_per_m, sticks, bends) for each in lines]
    found = []
    for i in range(len(masses)):
        straight, bent = (_fitted(records, i, laws) for laws in (False, True))
        better = float(np.exp(np.mean(np.log(bent.left / straight.left))))
        found.append(bent if better <= WORTH else straight)
    if not any(each.joints.any() or each.bends.any() for each in found):
        return None
    dashpots = np.array([each.dashpots for each in found])
    laws = NonlinearSpecimen(
        stiffness_n_per_m=np.array([each.spring for each in found]),
        dashpots_n_s_per_m=0.5 * (dashpots + dashpots.T),
        joint_n=np.array([each.joints for each in found]),
        joint_m=sticks,
        bend_n_per_m=np.array([each.bends for each in found]),
        bend_m=bends,
    )
    return laws if laws.possible else None


@dataclass(frozen=True)
class _Lines:
    """Fourier lines of one record in a band."""

    s: ComplexArray  # (m,) rad/s
    accel: ComplexArray  # (c, m)
    first: int  # number of the first line
    count: int  # samples of the series

    @classmethod
    def of(cls, motion: Motion, dt_s: float, band_hz: tuple[float, float]) -> _Lines:
        """Return the lines of a record; its series are sampled RATE times as fast as the band ends."""
        samples = np.vstack([motion.table, motion.floors])
        n = samples.shape[1]
        frequency = np.arange(n // 2 + 1) / (n * dt_s)
        inside = np.flatnonzero((frequency >= band_hz[0]) & (frequency <= band_hz[1]))
        lines = np.fft.rfft(samples - samples.mean(axis=1, keepdims=True))[:, inside] / n
        return cls(2j * np.pi * frequency[inside], lines, int(inside[0]), min(n, int(RATE * band_hz[1] * n * dt_s)))

    @property
    def drift(self) -> ComplexArray:
        """Return the lines (n, m) of the storeys' drifts."""
        return np.asarray(np.diff(self.accel, axis=0) / self.s**2)

    def series(self) -> Array:
        """Return the storeys' drifts (n, count) in m."""
        whole = np.zeros((len(self.accel) - 1, self.count // 2 + 1), dtype=complex)
        whole[:, self.first : self.first + len(self.s)] = self.drift
        return np.asarray(np.fft.irfft(whole, self.count) * self.count)

    def of_series(self, forces: Array) -> ComplexArray:
        """Return the lines (..., m) of series (..., count)."""
        return np.asarray(np.fft.rfft(forces)[..., self.first : self.first + len(self.s)] / self.count)


def _equations(lines: _Lines, masses: Array, stiffness: Array, sticks: Array, bends: Array) -> _Equations:
    """Return the weighted lines of one record's equations; `sticks` (n, j) and `bends` (n, b) are drifts in m."""
    drifts, n = lines.series(), len(masses)
    above = np.array([masses[i + 1 :] @ masses[i + 1 :] for i in range(n)])
    weights = 1.0 / np.array([_noise(lines, *each) for each in zip(masses, above, stiffness, strict=True)])
    rubbed = [[slid(drift, reach) for reach in own] for drift, own in zip(drifts, sticks.tolist(), strict=True)]
    touched = drifts[:, None] - np.clip(drifts[:, None], -bends[..., None], bends[..., None])
    return _Equations(
        inertia=weights * np.array([masses[i:] @ lines.accel[1 + i :] for i in range(n)]),
        drift=weights * lines.drift,
        velocity=weights[:, None] * lines.drift * lines.s,
        joints=weights[:, None] * lines.of_series(np.array(rubbed)),
        bends=weights[:, None] * lines.of_series(touched),
        ends=weights[:, None] * np.array([lines.s**-power for power in range(ENDS)]),
    )


def _noise(lines: _Lines, mass: float, above: float, stiffness: float) -> Array:
    """Return what noise of 1 m/s^2 in all channels makes of a storey's equation (m,) in N; `above`: sum of the squared
    masses of the floors above that of the storey."""
    per_accel = stiffness / np.abs(lines.s) ** 2
    return np.asarray(np.sqrt((mass - per_accel) ** 2 + per_accel**2 + above))


def _span(rows: Array) -> Array:
    """Return an orthonormal basis (r, m) of what rows (n, m) span; r < n where some are zero or depend on others."""
    size = np.linalg.norm(rows, axis=1)
    kept = rows[size > 0.0] / size[size > 0.0, None]  # a bend that no drift reaches has a row of zeros
    _, values, basis = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(basis[values > LOST * values[0]])


def _fitted(records: Sequence[_Equations], i: int, laws: bool) -> _Storey:
    """Return storey i, with or without joints and bends, from all records at once."""
    from scipy.optimize import nnls

    n, (j, b) = len(records[0].drift), (each.shape[1] for each in (records[0].joints, records[0].bends))
    wanted = [parts(-record.inertia[i]) for record in records]
    storey = [parts(np.vstack([r.drift[i : i + 1], r.velocity[i], *([r.bends[i]] if laws else [])])) for r in records]
    joints = [parts(record.joints[i]) for record in records]
    ends = [parts(record.ends[i]) for record in records]
    sizes = np.array([np.linalg.norm(each) for each in wanted])
    left = sizes
    for _ in range(ROUNDS):
        weight = [np.sqrt(each.size) / max(by, REAL * of) for each, by, of in zip(wanted, left, sizes, strict=True)]
        apart = [np.hstack([w * rows * (rows is end) for w, rows in zip(weight, ends, strict=True)]) for end in ends]
        free = np.vstack([np.hstack([w * rows for w, rows in zip(weight, storey, strict=True)]), *apart])
        target = np.hstack([w * rows for w, rows in zip(weight, wanted, strict=True)])
        rubbing = np.hstack([w * rows for w, rows in zip(weight, joints, strict=True)])
        pushed = np.zeros(j)
        if laws:
            basis = _span(free)
            alone = rubbing - (rubbing @ basis.T) @ basis
            size = np.linalg.norm(alone, axis=1)
            seen = size > LOST * np.linalg.norm(rubbing, axis=1)  # others never slid, or are what a spring is
            if seen.any():
                shares = nnls((alone[seen] / size[seen, None]).T, target - (target @ basis.T) @ basis)[0]
                pushed[seen] = shares / size[seen]
        factors = linear(free, target - pushed @ rubbing)
        residual = target - pushed @ rubbing - factors @ free
        pieces = np.split(residual, np.cumsum([rows.size for rows in wanted])[:-1])
        left = np.array([np.linalg.norm(piece) / w for piece, w in zip(pieces, weight, strict=True)])
    bends = factors[1 + n : 1 + n + b] if laws else np.zeros(b)
    return _Storey(float(factors[0]), factors[1 : 1 + n], pushed, bends, left)


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
) -> tuple[SpecimenFit | None, tuple[Finding, ...]]:
    """Return the specimen identified from the free vibrations, as far as they exceed the channels' noise.

    `known` is the specimen from the excitation. Returns None without a usable free vibration; the second value is a
    warning if all of them are too short.
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
        said = Finding("free_vibration.short", {"lasting_s": longest_s, "needed_s": least * dt_s})
        return None, (said,) if held else ()
    first = Start(known.stiffness_n_per_m, known.damping_ratio)
    return fit_stretches(lasting, dt_s, data.masses_kg, low_hz, first, free=True), ()


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


def out_of_step(
    data: Evidence, model: Model, found: SpecimenFit | None
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Return reasons to reject the channels, and warnings, if the floors are out of step with the table."""
    if found is None:
        return (), ()
    dt_s, start = data.info.dt_s, Start(found.stiffness_n_per_m, found.damping_ratio)
    seen = [motion.cut(slice(0, ENOUGH)) for motion in motions(data, model, free=False)]
    late, error = skew(seen, dt_s, data.masses_kg, lowest_hz(data, start), start)
    error = float(np.hypot(error, PHASE / (2.0 * np.pi * found.natural_frequency_hz[-1] * dt_s)))
    values = {"late_samples": abs(late), "late_s": abs(late) * dt_s, "way": "late" if late > 0.0 else "early"}
    said = Finding("channels.skew", values)
    if abs(late) > MOST_SKEW + AGREE_SIGMA * error:
        return (said,), ()
    return (), ((replace(said, severity="warns"),) if abs(late) > SEEN_SKEW + AGREE_SIGMA * error else ())


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
