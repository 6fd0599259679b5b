"""Decimate long series for the charts: the smallest and the largest sample of each bucket are kept."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.lti import Array, Integers
from rths_cli.report.figures.figure_data import extremes

BUCKETS = 8000  # of a series at most, two samples each: several times what a screen has columns, to zoom into
MOST_CHARACTERS = 3_400_000  # of all series of a page
QUANTA = 32767  # to which a peak is divided
FINE = 100  # quanta that half of a series must exceed to be told in them

Packed = dict[str, int | float | str]


@dataclass(frozen=True)
class Envelope:
    """Selected samples of a series, at the times start_s + index step_s."""

    index: Integers  # (m,) ascending
    value: Array  # (m,) in the unit of the series; NaN if not finite
    count: int  # samples of the whole series
    start_s: float
    step_s: float


def width_of(samples: int, buckets: int = BUCKETS) -> int:
    """Return the number of samples per bucket: 2 for a short series, of which every sample is kept, or more."""
    return max(2, math.ceil(samples / buckets))


def kept(values: Array, width: int) -> Integers:
    """Return the indices of the first and last sample, and of the extreme finite samples in each bucket of `width`.

    `values`: samples (n,). Of a bucket without a finite sample its first one is kept, so that a gap remains visible.
    """
    if not values.size:
        return np.zeros(0, dtype=np.int64)
    found = extremes(values, np.arange(0, values.size, width), width)
    return np.union1d(found, np.array([0, values.size - 1]))


def envelope(values: Array, start_s: float, step_s: float, width: int) -> Envelope:
    """Return the samples of a series (n,) that the plot needs; samples that are not finite become NaN."""
    told = np.where(np.isfinite(values), values, np.nan).astype(float)
    index = kept(told, width)
    return Envelope(index, told[index], values.size, start_s, step_s)


def thinned(fine: Envelope, width: int) -> Envelope:
    """Return an envelope with wider buckets; the peaks of the series are kept."""
    values = np.full(fine.count, np.nan)
    values[fine.index] = fine.value
    return envelope(values, fine.start_s, fine.step_s, width)


@dataclass
class Pool:
    """The envelopes of a page; equal ones are stored once."""

    envelopes: list[Envelope] = field(default_factory=list)
    _places: dict[bytes, int] = field(default_factory=dict)

    def add(self, found: Envelope) -> int:
        """Store an envelope and return its index in the page."""
        about = repr((found.count, found.start_s, found.step_s)).encode()
        digest = hashlib.sha256(about + found.index.tobytes() + found.value.tobytes()).digest()
        if digest not in self._places:
            self._places[digest] = len(self.envelopes)
            self.envelopes.append(found)
        return self._places[digest]

    def packed(self, most_characters: int = MOST_CHARACTERS) -> list[Packed]:
        """Return all envelopes as text; the buckets are doubled until the text fits into `most_characters`."""
        found, factor = [pack(one) for one in self.envelopes], 1
        while _characters(found) > most_characters and factor < 64:
            factor *= 2
            found = [pack(thinned(one, factor * width_of(one.count))) for one in self.envelopes]
        return found


def pack(found: Envelope) -> Packed:
    """Return an envelope for JSON: base64 of the differences of indices and of the values, little-endian.

    Values are 16-bit integers times a factor k (the lowest integer: NaN), so the peak is exact and the error of every
    other sample at most peak / 65534. If that is too coarse for half of the samples, they are 32-bit floats (k = 0).
    """
    steps = np.diff(found.index, prepend=0)
    kind = "<u1" if steps.max(initial=0) < 2**8 else "<u2" if steps.max(initial=0) < 2**16 else "<u4"
    scale, values = _values(found.value)
    about: Packed = {"n": found.count, "t0": found.start_s, "dt": found.step_s, "k": scale}
    return about | {"w": int(kind[-1]), "i": _text(steps.astype(kind)), "y": _text(values)}


def pack_floats(values: Array) -> str:
    """Return values as base64 of little-endian 32-bit floats; values that are not finite are kept."""
    return _text(np.asarray(values).astype("<f4"))


def _values(values: Array) -> tuple[float, NDArray[np.generic]]:
    sizes = np.abs(values[np.isfinite(values)])
    scale = float(sizes.max(initial=0.0)) / QUANTA
    if scale == 0.0 or np.median(sizes[sizes > 0.0]) < FINE * scale:
        return 0.0, values.astype("<f4")
    shares = np.where(np.isfinite(values), np.rint(values / scale), -QUANTA - 1)
    return scale, shares.astype("<i2")


def _text(values: NDArray[np.generic]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")


def _characters(found: Sequence[Packed]) -> int:
    return sum(len(str(one["i"])) + len(str(one["y"])) for one in found)
