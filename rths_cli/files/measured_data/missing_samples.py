"""Missing samples of measured channels: found, and short gaps bridged where that is harmless."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.lti import Array

LONGEST_BRIDGED = 3
LARGEST_SHARE = 0.001
"""Share of a record's samples that may be bridged."""
BAND = 0.1
"""A bridged channel's content lies below this part of half the sample rate ..."""
POWER_ABOVE = 0.01
"""... all but this share of its power."""
_BESIDE = 2
"""Samples on either side of a gap through which the cubic passes."""


def missing(samples: Array, names: Sequence[str], dt_s: float) -> tuple[str, ...]:
    """Return one sentence per channel with missing samples: number, share, longest run, time of the first.

    `samples` (c, n), NaN where missing; `names` (c,); `dt_s` in s.
    """
    sentences = []
    for name, values in zip(names, samples, strict=True):
        starts, lengths = _gaps(values)
        if len(starts):
            count, longest = int(lengths.sum()), int(lengths.max())
            which = "1 sample is missing" if count == 1 else f"{count} samples are missing"
            sentences.append(
                f"{name}: {which} ({100 * count / len(values):.3g} % of the record), the longest run {longest} "
                f"({longest * dt_s:.4g} s), the first at {starts[0] * dt_s:.6g} s"
            )
    return tuple(sentences)


def mend(samples: Array, names: Sequence[str]) -> tuple[Array, tuple[str, ...]]:
    """Bridge isolated gaps of at most 3 samples by the cubic through two samples on either side; leave all others NaN.

    `samples` (c, n), NaN where missing; `names` (c,). A channel is bridged where that concerns at most 0.1 % of its
    samples and 99 % of its power lies below 1/10 of half the sample rate, where the cubic errs by 1.6 % at most.
    Return the mended samples (c, n) and one sentence per channel that was bridged or could not be.
    """
    mended, notes = np.array(samples, dtype=float), []
    for name, values in zip(names, mended, strict=True):
        starts, lengths = _short_gaps(values)
        count = int(lengths.sum())
        if count == 0:
            continue
        reason = _objection(values, count)
        if reason:
            notes.append(f"{name}: {count} missing samples in short gaps are not bridged, because {reason}")
            continue
        for length in range(1, LONGEST_BRIDGED + 1):
            _bridge(values, starts[lengths == length], length)
        notes.append(f"{name}: {count} missing {'sample' if count == 1 else 'samples'} bridged by cubic interpolation")
    return mended, tuple(notes)


def _gaps(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return start and length of every run of missing samples."""
    edges = np.diff(np.concatenate([[False], np.isnan(values), [False]]).astype(np.int8))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def _short_gaps(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return start and length of the gaps that are short and have the samples beside them that a cubic needs."""
    starts, lengths = _gaps(values)
    ends = starts + lengths
    before = starts - np.concatenate([[0], ends[:-1]]) if len(starts) else starts
    after = np.concatenate([starts[1:], [len(values)]]) - ends if len(starts) else starts
    wanted = (lengths <= LONGEST_BRIDGED) & (before >= _BESIDE) & (after >= _BESIDE)
    return starts[wanted], lengths[wanted]


def _objection(values: Array, count: int) -> str:
    """Return why a channel's short gaps cannot be bridged, "" if they can."""
    if count > LARGEST_SHARE * len(values):
        return f"they are more than {100.0 * LARGEST_SHARE:.1f} % of the record"
    above = _power_above(values)
    if above > POWER_ABOVE:
        return f"{100.0 * above:.0f} % of the channel's power lies above {BAND:g} of half the sample rate"
    return ""


def _power_above(values: Array) -> float:
    """Return the share of a channel's power above BAND of half the sample rate, gaps filled by straight lines."""
    import scipy.fft

    known = np.flatnonzero(~np.isnan(values))
    filled = np.interp(np.arange(len(values)), known, values[known])
    window = np.hanning(len(filled))
    power = np.abs(scipy.fft.rfft((filled - filled.mean()) * window)) ** 2
    total = float(power.sum())
    return float(power[int(BAND * len(power)) :].sum()) / total if total > 0.0 else 0.0


def _bridge(values: Array, starts: NDArray[np.intp], length: int) -> None:
    """Fill gaps of one length in place with the cubic (Lagrange) through the two samples on either side."""
    nodes = np.array([-2, -1, length, length + 1])
    inside = np.arange(length)
    others = [np.delete(nodes, k) for k in range(4)]
    weights = np.array([[np.prod((x - o) / (n - o)) for n, o in zip(nodes, others, strict=True)] for x in inside])
    values[starts[:, None] + inside] = values[starts[:, None] + nodes] @ weights.T
