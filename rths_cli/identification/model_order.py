"""How many poles and zeros the table model gets, by cross-validation on halves of the data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding
from rths_cli.identification.frequency_response import Estimator, without_leakage
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import Candidate
from rths_cli.identification.table_fit import (
    LEAST_ERROR,
    Fit,
    Layout,
    best_of,
    fit,
    problem_of,
    rational_latency,
    thinned,
    timing_of,
    within,
)
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Frf

WORTH = 0.9  # a larger candidate must lower the held-out error to this fraction of the smaller one's
HALF_SEGMENTS, LONGEST_SEGMENT_S = 5, 20.0
# starts of what larger structures have more; frequencies and delay belong to the usual compared band
EXTRA_LAG_HZ, EXTRA_DELAY_S, EXTRA_MODES_HZ, EXTRA_RATIO = 300.0, 3e-4, (15.0, 25.0, 35.0, 50.0), 0.05
SPLIT = 1.02  # frequency of the zero over that of the pole in an additional mode, or the inverse
UNDETERMINED = 0.4  # standard uncertainty of a frequency's logarithm from which a pair is undetermined
BEYOND, RESONANT = 2.0, 0.25  # a pair resonates outside the data: frequency over the band's end, largest damping ratio
CERTAIN, NEAR = 3.0, 0.1  # pole and zero that do not cancel: standard errors apart, logarithm of the frequency ratio


@dataclass(frozen=True)
class Trial:
    """A structure of the model, with the start of its fits."""

    name: str
    layout: Layout
    start: Array  # parameters of the layout, then the ripple
    held_zeros: int  # number of zero pairs that stay at the specimen's modes


def choose(
    base: Fit,
    frf: Frf,
    records: Sequence[Record],
    estimator: Estimator,
    latency_in_roots: bool,
    compared: ComparedBand = USUAL,
) -> tuple[Fit, tuple[Candidate, ...], Fit | None]:
    """Choose the structure of the table model by cross-validation.

    Larger structures are tried as long as the held-out error of the chosen one is above the scatter of the data. One
    is taken only if it lowers that error to 0.9 of its value and if the data determine all its roots. Records too short
    to be halved keep the first structure. Returns the chosen fit, all candidates, the smallest first, and the fit of
    the candidate with the least held-out error if that is clearly less than the chosen one's.
    """
    halves = _halves(base, records, estimator)
    if latency_in_roots or not halves:
        trial = _with_latency(base, compared) if latency_in_roots else _as_it_is(base)
        score = held_out_error(trial, base, halves) if halves else float("nan")
        return _fitted(trial, base, frf), (_described(trial, score, chosen=True),), None
    tried = [(trial, held_out_error(trial, base, halves)) for trial in (_without_lag(base), _as_it_is(base))]
    fits = [_fitted(trial, base, frf) for trial, _ in tried]
    taken = 1 if _has_lag(fits, [score for _, score in tried]) else 0
    found = fits[taken]
    for trial in _larger(base, frf, compared):
        if tried[taken][1] <= 1.0 / WORTH:
            break
        tried.append((trial, held_out_error(trial, base, halves)))
        better = _fitted(trial, base, frf) if tried[-1][1] < WORTH * tried[taken][1] else None
        if better is not None and not doubtful(better):
            taken, found = len(tried) - 1, better
    best, least = min(tried, key=lambda each: each[1])
    other = _fitted(best, base, frf) if least < WORTH * tried[taken][1] else None
    return found, tuple(_described(trial, score, i == taken) for i, (trial, score) in enumerate(tried)), other


def _has_lag(fits: Sequence[Fit], errors: Sequence[float]) -> bool:
    """Return whether the fit with the actuator's lag is better than that without; `errors` are the held-out errors.

    Every actuator has a lag. Without it the model answers too much above the band, where the loop must be stable as
    well. It is kept where the data determine it, and where its removal makes another pair of roots take its place.
    """
    without, with_lag = fits
    if errors[1] < WORTH * errors[0]:
        return True
    lag = 1 + 2 * with_lag.layout.pole_pairs
    known = bool(with_lag.layout.single_poles) and with_lag.covariance[lag, lag] < UNDETERMINED**2
    return errors[1] < errors[0] and (bool(_beyond_band(without)) or (known and not doubtful(with_lag)))


def _described(trial: Trial, score: float, chosen: bool) -> Candidate:
    layout = trial.layout
    return Candidate(trial.name, 2 * layout.pole_pairs + layout.single_poles, 2 * layout.zero_pairs, score, chosen)


def _as_it_is(base: Fit) -> Trial:
    """Return the first fit's own structure."""
    return Trial("one lag", base.layout, base.parameters, base.held_zeros)


def _without_lag(base: Fit) -> Trial:
    """Return the structure without the actuator's lag."""
    start = np.delete(base.parameters, 1 + 2 * base.layout.pole_pairs)
    return Trial("no lag", replace(base.layout, single_poles=0), start, base.held_zeros)


def _larger(base: Fit, frf: Frf, compared: ComparedBand) -> Iterator[Trial]:
    """Yield larger structures than the first fit's: free zeros, a second lag, a longer delay, a mode of the frame."""
    layout, theta, held = base.layout, base.parameters, base.held_zeros
    if held:
        yield Trial("one lag, zeros free", layout, theta, 0)
    single = 1 + 2 * layout.pole_pairs
    wide = np.insert(theta, single, np.log(2.0 * np.pi * compared.with_high(EXTRA_LAG_HZ)))
    yield Trial("two lags", replace(layout, single_poles=2), wide, held)
    late = np.insert(theta, layout.size, np.log(EXTRA_DELAY_S / compared.with_high(1.0)))
    yield Trial("one lag, delay fitted", replace(layout, fits_delay=True), late, held)
    more = replace(layout, pole_pairs=layout.pole_pairs + 1, zero_pairs=layout.zero_pairs + 1)
    few = thinned(problem_of(frf, more, timing_of(base.model), base.model.band_hz, ripple=True))
    modes_hz = [compared.with_high(hz) for hz in EXTRA_MODES_HZ]
    starts = [_with_mode(base, hz, split) for hz in modes_hz for split in (SPLIT, 1.0 / SPLIT)]
    yield Trial("one lag, one more mode", more, best_of(few, starts, more.zeros(held)), held)


def _with_latency(base: Fit, compared: ComparedBand) -> Trial:
    """Return the structure whose roots represent the latency."""
    layout, start = rational_latency(base, compared)
    return Trial("latency in the roots", layout, np.append(start, base.parameters[-1]), 0)


def _with_mode(base: Fit, frequency_hz: float, split: float) -> Array:
    """Return the first fit's parameters with an additional pole pair and zero pair near a frequency."""
    pole = np.log([2.0 * np.pi * frequency_hz, EXTRA_RATIO])
    zero = np.log([2.0 * np.pi * frequency_hz * split, EXTRA_RATIO])
    theta = np.insert(base.parameters, 1 + 2 * base.layout.pole_pairs, pole)
    return np.insert(theta, base.layout.size + 2, zero)


def _fitted(trial: Trial, base: Fit, frf: Frf) -> Fit:
    """Return the fit of a structure to a response."""
    band = base.model.band_hz
    return fit(frf, trial.layout, trial.start, timing_of(base.model), band, ripple=True, held_zeros=trial.held_zeros)


def _halves(base: Fit, records: Sequence[Record], estimator: Estimator) -> tuple[Frf, ...]:
    """Return the table's response from two halves of the data, () if they are too short.

    The halves of noise are the first and the second half of every record. A periodic excitation repeats the effect of
    friction in every period; its halves are the even and the odd lines.
    """
    period_s = records[0].parts.period_samples * base.model.dt_s
    if period_s:
        whole = without_leakage(_blank(base, period_s), base.model, records, period_s, estimator)
        return _every_other(whole, 0), _every_other(whole, 1)
    try:
        return tuple(_half(base, records, estimator, which) for which in (_first, _second))
    except InputError:
        return ()


def _half(base: Fit, records: Sequence[Record], estimator: Estimator, which: Callable[[Record], Record]) -> Frf:
    parts = [which(record) for record in records]
    dt = base.model.dt_s
    shortest = min(part.parts.noise.stop - part.parts.noise.start for part in parts)
    suited = [part.parts.segment_samples * dt for part in parts if part.parts.segment_samples]
    segment_s = min(shortest * dt / HALF_SEGMENTS, LONGEST_SEGMENT_S, *suited)
    return without_leakage(_blank(base, segment_s), base.model, parts, segment_s, estimator)


def _blank(base: Fit, segment_s: float) -> Frf:
    """Return a response of ones that only defines the lines of a segment length in the model's band."""
    length, dt = round(segment_s / base.model.dt_s), base.model.dt_s
    lines = np.arange(length // 2 + 1) / (length * dt)
    lines = lines[within(lines, base.model.band_hz)]
    return Frf(lines, np.ones(len(lines), dtype=complex), np.ones(len(lines)), np.ones(len(lines)), 0)


def _every_other(frf: Frf, first: int) -> Frf:
    """Return every second line of a response."""
    some = slice(first, None, 2)
    return Frf(frf.frequency_hz[some], frf.response[some], frf.coherence[some], frf.relative_error[some], frf.averages)


def _first(record: Record) -> Record:
    noise = record.parts.noise
    return record.excited_in(slice(noise.start, (noise.start + noise.stop) // 2))


def _second(record: Record) -> Record:
    noise = record.parts.noise
    return record.excited_in(slice((noise.start + noise.stop) // 2, noise.stop))


def held_out_error(trial: Trial, base: Fit, halves: tuple[Frf, ...]) -> float:
    """Return the rms error over both halves, each fitted to the other one, in standard errors of the responses."""
    squares = [mean_square(_fitted(trial, base, fitted), judged) for fitted, judged in (halves, halves[::-1])]
    return float(np.sqrt(np.mean(squares)))


def mean_square(found: Fit, frf: Frf) -> float:
    """Return the mean square of |model / FRF - 1| over the FRF's standard error (of real or imaginary part)."""
    inside = within(frf.frequency_hz, found.model.band_hz)
    f = frf.frequency_hz[inside]
    error = np.abs(found.model.sampled_response(f) / frf.response[inside] - 1.0)
    scatter = np.hypot(frf.relative_error[inside], LEAST_ERROR)
    return float(np.mean(error**2 / (2.0 * scatter**2)))


def doubtful(found: Fit) -> tuple[Finding, ...]:
    """Return a finding for each pair of roots that is not supported by the data.

    Such a pair is undetermined, cancels with another one within their uncertainty, or resonates outside the measured
    band.
    """
    return (*_undetermined(found), *unsupported(found))


def unsupported(found: Fit) -> tuple[Finding, ...]:
    """Return a finding for each pair of roots that cancels with another one, or resonates outside the measured
    band."""
    return (*_cancelling(found), *_beyond_band(found))


def _resonates(pairs: Array, found: Fit) -> np.ndarray:
    """Return which pairs (n, 2) are weakly damped and above BEYOND times the end of the band, (n,)."""
    return (pairs[:, 0] > 2.0 * np.pi * BEYOND * found.model.band_hz[1]) & (pairs[:, 1] < RESONANT)


def _beyond_band(found: Fit) -> tuple[Finding, ...]:
    """Return a finding for each pair that resonates far above the measured band.

    Within the band such a pair changes the response by less than the check allows for unknown modes, and other roots
    could change it in the same way.
    """
    poles, _, zeros = found.layout.pairs(found.parameters)
    return tuple(
        Finding("model.far_pair", {"root": kind, "at_hz": omega / (2.0 * np.pi), "end_hz": found.model.band_hz[1]})
        for kind, pairs in (("pole", poles), ("zero", zeros))
        for omega in pairs[_resonates(pairs, found), 0]
    )


def _undetermined(found: Fit) -> tuple[Finding, ...]:
    """Return a finding for each pair whose frequency has a standard uncertainty of half an octave or so."""
    error = np.sqrt(np.diag(found.covariance))
    poles, single, zeros = found.layout.pairs(found.parameters)
    first_zero = 1 + 2 * found.layout.pole_pairs + len(single)
    named = [("pole", 1 + 2 * i, pair[0]) for i, pair in enumerate(poles)]
    named += [("zero", first_zero + 2 * i, pair[0]) for i, pair in enumerate(zeros)]
    return tuple(
        Finding("model.undetermined_pair", {"root": kind, "at_hz": omega / (2.0 * np.pi)})
        for kind, column, omega in named
        if error[column] > UNDETERMINED
    )


def _cancelling(found: Fit) -> tuple[Finding, ...]:
    """Return a finding for each pole pair that cancels with a zero pair within their uncertainty."""
    poles, _, zeros = found.layout.pairs(found.parameters)
    first_zero = 1 + 2 * found.layout.pole_pairs + found.layout.single_poles
    cancelling = []
    for i, pole in enumerate(poles):
        for j, zero in enumerate(zeros):
            p, z = slice(1 + 2 * i, 3 + 2 * i), slice(first_zero + 2 * j, first_zero + 2 * j + 2)
            apart = np.log(pole / zero)
            if abs(apart[0]) > NEAR:
                continue
            spread = _block(found.covariance, p, p) + _block(found.covariance, z, z)
            spread = spread - _block(found.covariance, p, z) - _block(found.covariance, z, p)
            if float(apart @ np.linalg.pinv(spread) @ apart) < CERTAIN**2:
                cancelling.append(Finding("model.cancelling_pairs", {"at_hz": pole[0] / (2.0 * np.pi)}))
    return tuple(cancelling)


def _block(matrix: Array, rows: slice, columns: slice) -> Array:
    return matrix[rows, columns]
