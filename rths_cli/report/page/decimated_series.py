"""Shorten long series for the charts: the smallest and the largest sample of every few are kept."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.lti import Array, Integers

BUCKETS = 8000  # of a series at most, two samples each: several times what a screen has columns, to zoom into
MOST_CHARACTERS = 3_400_000  # of all series of a page
QUANTA = 32767  # to which a peak is divided
FINE = 100  # quanta that half of a series must exceed to be told in them

Packed = dict[str, int | float | str]


@dataclass(frozen=True)
class Envelope:
    """Hold samples of a series: `index` (m,) rising, `value` (m,), of `count` at t = start_s + index step_s."""

    index: Integers
    value: Array
    count: int
    start_s: float
    step_s: float


def width_of(samples: int, buckets: int = BUCKETS) -> int:
    """Return how many samples share a bucket; two, of which both are kept, where there are few."""
    return max(2, math.ceil(samples / buckets))


def kept(values: Array, width: int) -> Integers:
    """Return the places of the first, the last and, in every `width` of the samples (n,), the extreme finite ones.

    A bucket without a finite sample keeps its first place, so that a cut stays a cut.
    """
    padded = np.full(math.ceil(values.size / width) * width, np.nan)
    padded[: values.size] = values
    buckets = padded.reshape(-1, width)
    lost = np.isnan(buckets)
    lowest = np.where(lost, np.inf, buckets).argmin(axis=1)
    highest = np.where(lost, -np.inf, buckets).argmax(axis=1)
    starts = np.arange(len(buckets)) * width
    ends = np.array([0, values.size - 1] if values.size else [], dtype=np.int64)
    found = np.unique(np.concatenate([starts + lowest, starts + highest, ends]))
    return np.asarray(found[found < values.size], dtype=np.int64)


def envelope(values: Array, start_s: float, step_s: float, width: int) -> Envelope:
    """Return the samples (n,) that the plot needs; those that are not finite count as lost."""
    told = np.where(np.isfinite(values), values, np.nan).astype(float)
    index = kept(told, width)
    return Envelope(index, told[index], values.size, start_s, step_s)


def thinned(fine: Envelope, width: int) -> Envelope:
    """Return an envelope of wider buckets; its peaks are those of the series."""
    values = np.full(fine.count, np.nan)
    values[fine.index] = fine.value
    return envelope(values, fine.start_s, fine.step_s, width)


@dataclass
class Pool:
    """Collect envelopes; one that is there already is not held twice."""

    envelopes: list[Envelope] = field(default_factory=list)
    _places: dict[bytes, int] = field(default_factory=dict)

    def add(self, found: Envelope) -> int:
        """Return the place of an envelope in the page."""
        about = repr((found.count, found.start_s, found.step_s)).encode()
        digest = hashlib.sha256(about + found.index.tobytes() + found.value.tobytes()).digest()
        if digest not in self._places:
            self._places[digest] = len(self.envelopes)
            self.envelopes.append(found)
        return self._places[digest]

    def packed(self, most_characters: int = MOST_CHARACTERS) -> list[Packed]:
        """Return all envelopes as text, coarser by twos until they fit into so many characters."""
        found, factor = [pack(one) for one in self.envelopes], 1
        while _characters(found) > most_characters and factor < 64:
            factor *= 2
            found = [pack(thinned(one, factor * width_of(one.count))) for one in self.envelopes]
        return found


def pack(found: Envelope) -> Packed:
    """Return an envelope for JSON: base64 of steps between places and of values, little-endian.

    Values are shares k of the peak in 16 bits (the lowest stands for a lost one), so that the peak is exact and every
    other sample within peak / 65534; floats of 32 bits (k = 0) where such shares would be coarse for half of them.
    """
    steps = np.diff(found.index, prepend=0)
    kind = "<u1" if steps.max(initial=0) < 2**8 else "<u2" if steps.max(initial=0) < 2**16 else "<u4"
    scale, values = _values(found.value)
    about: Packed = {"n": found.count, "t0": found.start_s, "dt": found.step_s, "k": scale}
    return about | {"w": int(kind[-1]), "i": _text(steps.astype(kind)), "y": _text(values)}


def pack_floats(values: Array) -> str:
    """Return values as base64 of little-endian floats of 32 bits; what is not finite stays so."""
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
