"""What is wrong with a record beside its baseline: spikes, clipping, samples held where others were lost, a cut end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rths_cli.files.accelerograms import Accelerogram
from rths_cli.findings import Finding
from rths_cli.numerics.lti import Array

LEAST_SAMPLES = 50
MOST_SPIKES = 20
STANDS_OUT = 3.0  # times the largest curvature elsewhere, of a spike's
FLANKS = (0.25, 0.75)  # curvature beside a lone spike, over that at the spike: it is half of it, less the motion
LEAST_CLIPPED = 3  # samples at an extreme value, twice in a record, or three times as many at once
RESOLVED = 50  # least peak over the smallest step between two values, for equal ones to mean anything
LEAST_HELD = 8  # equal samples within the motion
HELD_JUMP = 0.05  # of the peak, by which a held value is left or reached
END = 16  # part of a record at its end, whose median is its level there
ENDS_AT = 0.1  # of the peak, at the last sample of a record that was not cut


def defects(record: Accelerogram, name: str) -> tuple[Finding, ...]:
    """Return a finding on each defect of a record (its name as the case has it), () for a clean one."""
    accel = record.accel_m_s2
    if accel.size < LEAST_SAMPLES:
        return ()
    found = [*_spikes(accel), *_clipped(accel), *_held(accel), *_cut(accel)]
    return tuple(
        Finding(code, {"record": name, "at_s": round(place * record.dt_s, 6), **values})
        for code, place, values in found
    )


Found = Iterator[tuple[str, int, dict[str, float]]]


def _spikes(accel: Array) -> Found:
    """Yield the lone samples that stand out of the line through their neighbours far more than any others do."""
    bent = accel[1:-1] - 0.5 * (accel[:-2] + accel[2:])
    sizes = np.abs(bent)
    inner = np.arange(1, bent.size - 1)
    peaks = inner[(sizes[inner] >= sizes[inner - 1]) & (sizes[inner] >= sizes[inner + 1])]
    order = peaks[np.argsort(sizes[peaks])[::-1]]
    for count in range(1, min(MOST_SPIKES, order.size - 1) + 1):
        some, rest = order[:count], sizes[order[count]]
        if sizes[some[-1]] > STANDS_OUT * rest and all(_is_lone(bent, k) for k in some):
            yield "record.spikes", int(some[0]) + 1, {"count": count, "accel_m_s2": float(accel[some[0] + 1])}
            return


def _is_lone(bent: Array, k: int) -> bool:
    """Return whether both neighbours bend the other way by about half: one sample moved, and no corner of a motion."""
    low, high = FLANKS
    return all(low <= -bent[side] / bent[k] <= high for side in (k - 1, k + 1))


def _clipped(accel: Array) -> Found:
    """Yield the extremes at which a record stays for several samples."""
    steps = np.abs(np.diff(np.unique(accel)))
    if not steps.size or np.abs(accel).max() < RESOLVED * steps.min():
        return
    for extreme in (accel.max(), accel.min()):
        runs = [(first, end - first) for first, end in _runs(accel == extreme) if end - first >= LEAST_CLIPPED]
        if abs(extreme) >= 0.5 * np.abs(accel).max() and (
            len(runs) > 1 or any(count >= 3 * LEAST_CLIPPED for _, count in runs)
        ):
            count = sum(count for _, count in runs)
            yield "record.clipped", int(runs[0][0]), {"count": count, "accel_m_s2": float(extreme)}


def _held(accel: Array) -> Found:
    """Yield the longest run of equal samples within the motion that a jump begins or ends; of zeros, which may be rest,
    both. A run of three times as many far from zero needs no jump."""
    peak = float(np.abs(accel).max())
    moving = np.flatnonzero(np.abs(accel) > ENDS_AT * peak)
    for first, end in sorted(_runs(np.diff(accel) == 0.0), key=lambda run: run[0] - run[1]):
        jumps = [abs(accel[k + 1] - accel[k]) for k in (first - 1, end) if 0 <= k < accel.size - 1]
        within = moving[0] < first and end < moving[-1] and abs(accel[first]) < 0.999 * peak
        jump = max(jumps) if accel[first] else min(jumps)
        long = end - first + 1 >= 3 * LEAST_HELD and abs(accel[first]) > ENDS_AT * peak
        if end - first + 1 >= LEAST_HELD and within and (long or jump >= HELD_JUMP * peak):
            yield "record.held", int(first), {"count": int(end - first + 1), "accel_m_s2": float(accel[first])}
            return


def _cut(accel: Array) -> Found:
    """Yield the last sample of a record that does not end at rest, whatever the level of its baseline there."""
    peak = float(np.abs(accel).max())
    last = float(accel[-1] - np.median(accel[-(accel.size // END) :]))
    if abs(last) > ENDS_AT * peak:
        yield "record.cut", accel.size - 1, {"accel_m_s2": float(accel[-1]), "share": abs(last) / peak}


def _runs(marked: Array) -> list[tuple[int, int]]:
    """Return first and end of every run of true values (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(marked, dtype=int), [0]])))
    return [(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]
