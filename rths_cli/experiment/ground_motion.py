"""The ground motion of a run: record scaled, interpolated, high-pass filtered, integrated; its baseline and
response spectrum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.analysis.intensity import integrate, spectrum
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.findings import Finding
from rths_cli.numerics.lti import Array
from rths_cli.structure import Similitude

CORNER_HZ = 0.25  # of the usual high pass of a record
MOST_SAMPLES = 5_000_000  # largest number of samples: 40 minutes at 2 kHz, 40 MB in each of about ten arrays

FIRST_SHARE = 0.02  # largest first sample of a filtered motion that starts at rest, over its peak
BLOCKS = 8  # of a record: a baseline shows in the mean of each, a pulse in few
POINTS = 256  # of a velocity in which a step is looked for
EXPLAINED, EXPLAINED_BY_STEP = 0.65, 0.9  # share of the squared block means that is a baseline and no motion
SIMPLER = 2.0  # times the residue of a richer baseline that a simpler one may leave and be preferred
WORTH_SAYING = 0.1  # added displacement, over that of the motion without the baseline
LEAST_QUIET, QUIET = 8, 0.25  # samples of a quiet end; what moves there, over its step
LEAST_JUMP = 1.5  # of a step, over any jump between samples of the quiet end: (1 - QUIET) / (2 QUIET)
NO_MOTION = 1e-9  # of the peak before a baseline was removed
KINDS = {"mean": "constant", "linear": "linear"}  # as scipy.signal.detrend names them
Displacement = Callable[[Array], Array]
"""Ground displacement in m of an acceleration (n,) in m/s^2 at the record's interval, scaled and filtered."""


@dataclass(frozen=True)
class GroundMotion:
    """Ground motion at the sample rate.

    The acceleration is linear between samples; velocity and displacement are its exact integrals from rest.
    """

    dt_s: float
    time_s: Array  # (n,)
    accel_m_s2: Array  # (n,)
    velocity_m_s: Array  # (n,)
    displacement_m: Array  # (n,)


@dataclass(frozen=True)
class Peaks:
    """Largest absolute values of a ground motion over its samples."""

    accel_m_s2: float
    velocity_m_s: float
    displacement_m: float


def compressed(accelerogram: Accelerogram, scale: Similitude) -> Accelerogram:
    """Return the record of a prototype as the model needs it: in the model's time, with the model's accelerations."""
    accel = accelerogram.accel_m_s2 / scale.factor("m/s^2")
    return replace(accelerogram, dt_s=accelerogram.dt_s / scale.factor("s"), accel_m_s2=accel)


def prepare(
    accelerogram: Accelerogram,
    scaling: float,
    sample_rate_hz: float,
    corner_hz: float = CORNER_HZ,
    order: int = 2,
) -> GroundMotion:
    """Scale the record, interpolate it linearly to the sample rate, then filter it from a zero initial state.

    The filter is a causal Butterworth high pass of the given order; a corner of 0 Hz switches it off. The last sample
    is the last one within the record. Raises InputError with all faults: a sample rate below the record's own, too many
    samples, a corner outside 0 to half the sample rate, an order below 1, a record shorter than one period of the
    corner.
    """
    _check(accelerogram, sample_rate_hz, corner_hz, order)
    recorded_s = accelerogram.dt_s * np.arange(len(accelerogram.accel_m_s2))
    samples = int(np.floor(recorded_s[-1] * sample_rate_hz * (1.0 + 1e-9))) + 1
    time_s = np.arange(samples) / sample_rate_hz
    accel = np.interp(time_s, recorded_s, scaling * accelerogram.accel_m_s2)
    accel = _high_pass(accel, sample_rate_hz, corner_hz, order)
    velocity, displacement = integrate(accel, 1.0 / sample_rate_hz)
    return GroundMotion(1.0 / sample_rate_hz, time_s, accel, velocity, displacement)


def _check(accelerogram: Accelerogram, sample_rate_hz: float, corner_hz: float, order: int) -> None:
    """Raise one InputError with a sentence for each value that does not fit the record."""
    own_rate_hz = 1.0 / accelerogram.dt_s
    duration_s = accelerogram.dt_s * (len(accelerogram.accel_m_s2) - 1)
    faults = []
    if not own_rate_hz <= sample_rate_hz * (1.0 + 1e-9):
        faults.append(
            f"sample_rate_hz: {sample_rate_hz:g} Hz is below the record's {own_rate_hz:g} Hz, which would alias it; "
            "raise it or resample the record"
        )
    if duration_s * sample_rate_hz > MOST_SAMPLES:
        faults.append(
            f"sample_rate_hz: {sample_rate_hz:g} Hz makes {duration_s * sample_rate_hz:.3g} samples of the record's "
            f"{duration_s:g} s, the limit is {MOST_SAMPLES:.3g}; lower it to {MOST_SAMPLES / duration_s:.3g} Hz or "
            "shorten the record"
        )
    if not 0.0 <= corner_hz < 0.5 * sample_rate_hz:
        faults.append(
            f"record_filter: the corner {corner_hz:g} Hz must be at least 0 (off) and below half the sample rate, "
            f"{0.5 * sample_rate_hz:g} Hz; correct it"
        )
    if order < 1:
        faults.append(f"record_filter: the order {order} must be at least 1; correct it, or state a corner of 0 (off)")
    if corner_hz > 0.0 and duration_s * corner_hz < 1.0 - 1e-9:
        faults.append(
            f"record: {duration_s:g} s is shorter than one period of the {corner_hz:g} Hz high pass, "
            f"{1.0 / corner_hz:g} s; give a longer record, or raise record_filter.corner_hz (0: no filter)"
        )
    if faults:
        raise InputError(*faults)


def _high_pass(accel: Array, sample_rate_hz: float, corner_hz: float, order: int) -> Array:
    """Return the causal Butterworth high pass of a series (n,) from rest; a corner of 0 Hz returns it unchanged."""
    from scipy.signal import butter, sosfilt

    if corner_hz == 0.0:
        return accel
    return np.asarray(sosfilt(butter(order, corner_hz, "high", fs=sample_rate_hz, output="sos"), accel))


def peaks(motion: GroundMotion) -> Peaks:
    """Return the peak ground acceleration, velocity and displacement."""
    return Peaks(
        float(np.abs(motion.accel_m_s2).max()),
        float(np.abs(motion.velocity_m_s).max()),
        float(np.abs(motion.displacement_m).max()),
    )


def response_spectrum(motion: GroundMotion, periods_s: Sequence[float] | Array, damping_ratio: float = 0.05) -> Array:
    """Return the pseudo-acceleration spectrum of a motion in m/s^2, (n_periods,); raises InputError as `spectrum`."""
    return spectrum(motion.accel_m_s2, motion.dt_s, periods_s, damping_ratio).sa_m_s2


@dataclass(frozen=True)
class Baseline:
    """An offset, drift or step that a record's acceleration contains and the high pass turns into displacement."""

    first_m_s2: float  # first sample of the record
    mean_m_s2: float
    drift_m_s2: float  # what the straight line through the record changes by from its start to its end
    duration_s: float
    step_m_s2: float  # of the baseline, at `step_s`; 0 without a step
    step_s: float
    added_m: float  # peak of the ground displacement that the baseline makes
    own_m: float  # peak of the ground displacement without it
    mended_by: str  # "mean", "linear", or "" where removing neither mends it


def without_baseline(accelerogram: Accelerogram, remove: str | None, order: int = 2) -> Accelerogram:
    """Return a record less its mean (`mean`), its least-squares line (`linear`) or polynomial of some order
    (`polynomial`), or the levels of quiet ends that step (`step`); any other value changes nothing.

    Raises InputError for a record of which nothing remains, and for one without such a step.
    """
    from scipy.signal import detrend

    whole = accelerogram.accel_m_s2
    if remove in KINDS:
        accel = np.asarray(detrend(whole, type=KINDS[remove]))
    elif remove == "polynomial":
        place = np.linspace(-1.0, 1.0, whole.size)
        accel = whole - np.polynomial.Polynomial.fit(place, whole, order)(place)
    elif remove == "step":
        accel = whole.copy()
        for level, first, end in end_steps(whole):
            accel[first:end] -= level
        if np.array_equal(accel, whole):
            raise InputError(
                "record.baseline: step: neither the start nor the end of this record is quiet and steps; remove the "
                "key, or name another"
            )
    else:
        return accelerogram
    if np.abs(accel).max() <= NO_MOTION * np.abs(accelerogram.accel_m_s2).max():
        raise InputError(f"record.baseline: {remove} leaves no motion of this record; remove the key, or name another")
    return replace(accelerogram, accel_m_s2=accel)


def straight_line(accelerogram: Accelerogram) -> tuple[float, float]:
    """Return mean and drift of a record in m/s^2: what its least-squares line changes by over its length."""
    accel = accelerogram.accel_m_s2
    place = np.arange(accel.size) / (accel.size - 1) - 0.5
    return float(accel.mean()), float(place @ accel / (place @ place))


def baseline_of(accelerogram: Accelerogram, displacement: Displacement) -> Baseline | None:
    """Return a record's baseline if it adds more than a tenth to the ground displacement, None for a clean record.

    A baseline is a constant, a straight line or one step that explains two thirds of the squared means of eighths
    of the record (a step nine tenths), which a motion that ends at rest, or a pulse, does not leave.
    """
    from scipy.signal import detrend

    accel = accelerogram.accel_m_s2
    steps = end_steps(accel)
    found = None if steps else _shape(accel)
    if found is None and not steps:
        return None
    split, richest = found or (steps[0][1] or steps[0][2], without_baseline(accelerogram, "step").accel_m_s2)
    clean = displacement(richest)
    whole = displacement(accel)
    own_m = _peak(clean)
    if _peak(whole - clean) <= WORTH_SAYING * own_m:
        return None
    mended_by, after = "", clean
    for remove, kind in () if steps else KINDS.items():
        tried = displacement(np.asarray(detrend(accel, type=kind)))
        if _peak(tried - clean) <= max(WORTH_SAYING * own_m, WORTH_SAYING * _peak(whole - clean)):
            mended_by, after = remove, tried
            break
    mean, drift = straight_line(accelerogram)
    step = float(accel[split:].mean() - accel[:split].mean()) if split and not mended_by else 0.0
    if steps:
        level, first, _ = steps[0]
        step, mended_by = (level if first else -level), "step"
    return Baseline(
        first_m_s2=float(accel[0]),
        mean_m_s2=mean,
        drift_m_s2=drift,
        duration_s=accelerogram.dt_s * (accel.size - 1),
        step_m_s2=step,
        step_s=split * accelerogram.dt_s if step else 0.0,
        added_m=_peak(whole - after),
        own_m=_peak(after),
        mended_by=mended_by,
    )


def _shape(accel: Array) -> tuple[int, Array] | None:
    """Return the sample at which the baseline of a record (n,) steps (0: nowhere) and the record without its baseline;
    None for a record without one."""
    from scipy.signal import detrend

    if accel.size < 4 * BLOCKS:
        return None
    power = _in_blocks(accel)
    split, steps = _best_step(accel)
    if steps and _is_step(accel, split):
        levelled = np.concatenate([part - part.mean() for part in (accel[:split], accel[split:])])
        if _in_blocks(levelled) <= (1.0 - EXPLAINED_BY_STEP) * power:
            return split, levelled
    level, line = (np.asarray(detrend(accel, type=kind)) for kind in KINDS.values())
    drifts = SIMPLER * _in_blocks(line) < _in_blocks(level)
    found = line if drifts else level
    return None if _in_blocks(found) > (1.0 - EXPLAINED) * power else (0, found)


def end_steps(accel: Array) -> list[tuple[float, int, int]]:
    """Return the level in m/s^2, the first sample and the end of a start or an end of a record (n,) that is quiet, at a
    level of its own, and joined to the rest by a jump between two samples."""
    found = [(level, 0, end) for level, end in _quiet_start(accel)]
    return found + [(level, accel.size - count, accel.size) for level, count in _quiet_start(accel[::-1])]


def _quiet_start(accel: Array) -> list[tuple[float, int]]:
    """Return the level and the length of a record's (n,) quiet start, [] without one."""
    jumps = np.abs(np.diff(accel[: accel.size // 4]))
    before = np.concatenate([[0.0], np.maximum.accumulate(jumps)[:-1]])
    least = np.maximum(LEAST_JUMP * before, FIRST_SHARE * (1.0 - QUIET) * _peak(accel))
    for count in np.flatnonzero(jumps > least) + 1:  # a quiet start has none so large
        start, after = accel[:count], accel[count : count + LEAST_QUIET]
        if count < LEAST_QUIET:
            continue
        level, rest = float(np.median(start)), float(np.median(after))
        quiet = QUIET * abs(level - rest)
        still = max(float(np.abs(start - level).max()), float(np.abs(after - rest).max())) <= quiet
        if still and level != rest and abs(jumps[count - 1] - abs(level - rest)) <= quiet:
            return [(level - rest, int(count))]
    return []


def _in_blocks(accel: Array) -> float:
    """Return the sum of the squared means of the blocks of a record (n,)."""
    means = np.array([part.mean() for part in np.array_split(accel, BLOCKS)])
    return float(means @ means)


def _best_step(accel: Array) -> tuple[int, bool]:
    """Return the sample, within the middle three quarters of a record (n,), at which one step explains the velocity
    best, and whether it does so better than a drift."""
    places = np.unique(np.linspace(0, accel.size - 1, POINTS).astype(int))
    velocity, t = np.cumsum(accel)[places], places / accel.size
    ends = np.linspace(1.0 / BLOCKS, 1.0 - 1.0 / BLOCKS, POINTS)
    left = [_residue(velocity, t, np.maximum(t - end, 0.0)) for end in ends]
    best = int(np.argmin(left))
    return round(float(ends[best]) * accel.size), SIMPLER * left[best] < _residue(velocity, t, t * t)


def _residue(velocity: Array, t: Array, shape: Array) -> float:
    """Return what the best sum of constant, ramp and a further shape leaves of a velocity (p,), squared and summed."""
    basis = np.stack([np.ones_like(t), t, shape], axis=1)
    rest = velocity - basis @ np.linalg.lstsq(basis, velocity, rcond=None)[0]
    return float(rest @ rest)


def _is_step(accel: Array, split: int) -> bool:
    """Return whether the medians on both sides differ as the means do, which a pulse at one end does not do."""
    step = accel[split:].mean() - accel[:split].mean()
    between = np.median(accel[split:]) - np.median(accel[:split])
    return bool(abs(between - step) <= 0.5 * abs(step))


def _peak(series: Array) -> float:
    return float(np.abs(series).max())


def told_of(baseline: Baseline, name: str, corner_hz: float, file: str) -> Finding:
    """Return what a baseline is, what it does, and the key that mends it; `file` as the case names the record."""
    b = baseline
    shape = {"mean": "offset", "linear": "drifting"}.get(b.mended_by, "no_line")
    step = {"step_m_s2": b.step_m_s2, "step_s": b.step_s} if b.step_m_s2 else {"shape": shape}
    first, mean, drift = (rounded(value) for value in (b.first_m_s2, b.mean_m_s2, b.drift_m_s2))
    size = {"first_m_s2": first, "mean_m_s2": mean, "drift_m_s2": drift, "duration_s": b.duration_s}
    effect = {"corner_hz": corner_hz or None, "added_m": b.added_m, "own_m": b.own_m}
    return Finding(
        "record.baseline", {"record": name, "file": file, "mended_by": b.mended_by, **step, **size, **effect}
    )


def rounded(accel_m_s2: float) -> float:
    """Return an acceleration in m/s^2 to four decimals, zero without a sign."""
    return round(accel_m_s2, 4) + 0.0


def start_fault(
    motion: GroundMotion, accelerogram: Accelerogram, baseline: Baseline | None, said: Finding | None
) -> str:
    """Return a sentence on a motion that does not begin at rest, "" for one that does.

    `accelerogram` is the record without what was removed; `said` is the finding on its `baseline`.
    """
    accel, peak = accelerogram.accel_m_s2, _peak(motion.accel_m_s2)
    filtered = abs(float(motion.accel_m_s2[0])) / peak
    first = int(np.flatnonzero(accel)[0])  # zeros before an offset are no rest: the motion steps at their end
    jump = abs(float(accel[first])) / _peak(accel) if baseline is not None and baseline.mended_by and first else 0.0
    share = max(filtered, jump)
    if share <= FIRST_SHARE:
        return ""
    at_s = first * accelerogram.dt_s
    told = (
        f"the motion begins with a step of {100.0 * share:.3g} % of its peak at t = {at_s:g} s, at most "
        f"{100.0 * FIRST_SHARE:g} % is allowed: the table would be kicked"
    )
    keep = "or state record.baseline: none to run it so"
    if baseline is not None and said:
        count = f"{first} zeros" if first > 1 else "zero"
        zeros = f"; first remove the {count} before it from the file" if first else ""
        return f"{said}; {told}{zeros}"
    bends = np.abs(np.diff(accel[first : first + 30], 2))  # of a motion alike, of wrong first samples larger
    if bends[:3].max(initial=0.0) > 3.0 * bends[4:].max(initial=0.0):
        return (
            f"record: {told}; sample {first + 1} of the record reads {accel[first]:.3g} m/s^2 and the next one "
            f"{accel[min(first + 1, accel.size - 1)] + 0.0:.3g}: correct the first samples in the file, {keep}"
        )
    return (
        f"record: {told}; the record begins at {accel[first]:.3g} m/s^2, within a motion: give it from its beginning, "
        f"or with a taper, {keep}"
    )
