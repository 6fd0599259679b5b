"""The data of all figures and charts: a result's series, read once and decimated so that every peak is kept."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.result_listing import Outline, read_outlines
from rths_cli.files.result_reader import Result, SeriesLeftOut
from rths_cli.numerics.lti import Array, ComplexArray, Integers
from rths_cli.report.numbers import three
from rths_cli.report.result_scale import series
from rths_cli.report.results_by_case import TABLE_RUNS
from rths_cli.rigs.description import capabilities_of

ACCEL = "abs_accel_m_s2"
DESIRED = "interface_accel_desired_m_s2"
MEASURED = "interface_accel_measured_m_s2"
MOST_STOREYS = 4


FAR_LARGER = 10.0  # times SIM's peak: a SIM-DELAY beyond it would set the axes of what is compared

POINTS_PER_FIGURE = 7500  # of all lines together: what keeps a vector file below 300 KB
POINTS_PER_LINE = (40, 2000)
CLOSE_LOOK_S = 3.0
BUCKETS = 8000  # of a series at most, two samples each: several times what a screen has columns, to zoom into
MOST_CHARACTERS = 3_400_000  # of all series of a page
QUANTA = 32767  # to which a peak is divided
FINE = 100  # quanta that half of a series must exceed to be told in them
Packed = dict[str, int | float | str]


class NotDrawn(InputError):
    """Raised if a result lacks the data of a figure; the message states the reason."""


@dataclass(frozen=True)
class Source:
    """A result whose series are read at the first request and then kept in memory.

    `headed`: whether figures state case, table and end of the run above the panels.
    """

    result: Result
    headed: bool = True
    _kept: dict[str, Array] = field(default_factory=dict)

    def read(self, name: str) -> Array:
        """Return the values of a dataset (`exp_rths/command_v`) in the scale of the result.

        Raises NotDrawn if `--series` kept it out of the file, InputError if there is none.
        """
        if name not in self._kept:
            try:
                self._kept[name] = series(self.result, name)
            except SeriesLeftOut as missing:
                raise NotDrawn(missing.reason) from missing
        return self._kept[name]

    def holds(self, name: str) -> bool:
        """Return whether the file has a dataset (`exp_rths/rel_disp_m`)."""
        group, _, leaf = name.rpartition("/")
        return group in self._outlines and leaf in self._outlines[group].datasets

    @cached_property
    def _outlines(self) -> dict[str, Outline]:
        return read_outlines(self.result.path)

    def runs(self, names: tuple[str, ...]) -> list[str]:
        """Return the runs among `names` with samples in the file; raises NotDrawn if there are none."""
        found = [run for run in names if run in self.result.groups and self.read(f"{run}/time_s").size > 1]
        if not found:
            raise NotDrawn(f"no {' and no '.join(names)} in the result")
        return found

    def metric(self, path: str) -> Array | None:
        """Return a metric as an array (n,), None if the result does not have it."""
        value = self.result.metrics.get(path)
        return None if value is None else np.atleast_1d(np.asarray(value, dtype=float))

    @property
    def virtual(self) -> bool:
        """Return whether the rig is virtual."""
        return not capabilities_of(str(self.result.attributes.get("rig_kind", ""))).moves_hardware

    @property
    def has_truth(self) -> bool:
        """Return whether the file holds the true series, which only a simulated rig knows."""
        return self.virtual and self.result.series == "all"

    @property
    def rate_hz(self) -> float:
        """Return the sample rate in Hz."""
        return self.result.sample_rate_hz

    @property
    def band(self) -> str:
        """Return in words where in frequency errors are drawn."""
        return f"errors in the test band, below {self.result.test_band_hz:g} Hz"

    @property
    def complete(self) -> bool:
        """Return whether all runs reached the end of the record."""
        return self.result.attributes.get("status") == "complete"


def reached_the_end(source: Source, time_s: Array) -> bool:
    """Return whether a run with these instants (n,) reached the end of the record."""
    return source.complete or time_s.size >= source.read("record/time_s").size


def interface_storey(source: Source) -> int:
    """Return the storey (from 1) that the table moves, 0 if no run on a table states it."""
    for run in TABLE_RUNS:
        if run in source.result.groups:
            return int(source.read(f"{run}/floor")[0]) - 1
    return 0


def without_diverged(source: Source, runs: Sequence[str]) -> tuple[list[str], str]:
    """Return the runs whose responses are drawn together, and in words why SIM-DELAY is not among them, "" if it is.

    One that diverged, or is FAR_LARGER than SIM in a storey, is drawn only where there is no other run.
    """
    others = [run for run in runs if run != "sim_delay"]
    why = _why_not_sim_delay(source, runs) if others and len(others) < len(runs) else ""
    return (others, f"SIM-DELAY {why}: not drawn") if why else (list(runs), "")


def _why_not_sim_delay(source: Source, runs: Sequence[str]) -> str:
    at_s = source.metric("sim_delay.diverged_at_s")
    if at_s is not None:
        return f"diverged at {three(float(at_s[0]))} s"
    if "sim" not in runs:
        return ""
    delayed, exact = (peaks(source.read(f"{run}/{ACCEL}")) for run in ("sim_delay", "sim"))
    times = float(np.nanmax(delayed / np.where(exact > 0.0, exact, np.nan), initial=0.0))
    return f"is {three(times)} times SIM" if times > FAR_LARGER else ""


def peaks(series: Array) -> Array:
    """Return the largest absolute finite value of each series of (n_storeys, n); NaN where there is none."""
    sizes = np.where(np.isfinite(series), np.abs(series), -np.inf).max(axis=1, initial=-np.inf)
    return np.where(np.isfinite(sizes), sizes, np.nan)


def phases(measured: ComplexArray, modelled: ComplexArray) -> tuple[Array, Array]:
    """Return the phases (n,) in degrees of responses: the measured one nearest to the model's, which is unwrapped."""
    unwrapped = np.unwrap(np.angle(modelled))
    unwrapped += 2.0 * np.pi * (unwrapped[:1] < -0.5 * np.pi)  # near 0 Hz an acceleration is 180 deg before its cause
    return np.degrees(unwrapped + np.angle(measured / modelled)), np.degrees(unwrapped)


def chosen_storeys(storeys: int, interface: int) -> list[int]:
    """Return the storeys (from 1) that figures show: all up to four, else first, interface, the middle above, top.

    `interface`: highest storey of the numerical substructure, 0 if it is not known.
    """
    if storeys <= MOST_STOREYS:
        return list(range(1, storeys + 1))
    cut = interface or storeys // 2
    middle = (cut + storeys) // 2 if storeys - cut > 2 else cut // 2
    return sorted({1, cut, max(middle, 1), storeys})


def points_of_lines(weights: Sequence[float]) -> list[int]:
    """Return the largest number of points of each line of a figure, in proportion to its weight."""
    least, most = POINTS_PER_LINE
    return [int(np.clip(POINTS_PER_FIGURE * weight / sum(weights), least, most)) for weight in weights]


def thinned(time_s: Array, values: Array, points: int) -> tuple[Array, Array]:
    """Return at most `points` samples of a series (n,): the smallest and largest of equal stretches, in their order.

    Each sample keeps its instant, so peaks keep their value and place. Stretches share their end samples: where a
    series is monotone, one sample of each is enough, and there may be twice as many stretches. A stretch without
    numbers is a NaN, which breaks the line. A series that is short enough is returned unchanged.
    """
    if values.size <= points:
        return time_s, values
    for stretches in (points - 1, 3 * points // 4, points // 2):
        length = -(-(values.size - 1) // stretches)
        kept = extremes(values, np.arange(0, values.size - 1, length), length + 1)
        if kept.size <= points:
            break
    return time_s[kept], values[kept]


def extremes(values: Array, starts: Integers, length: int) -> Integers:
    """Return the indices of the smallest and largest finite value of each stretch, in ascending order, each once.

    A stretch has `length` samples from one of `starts` on; of one without numbers its first sample is taken.
    """
    places = np.minimum(starts[:, None] + np.arange(length), values.size - 1)
    inside = values[places]
    known = np.isfinite(inside)
    rows = np.arange(len(places))
    lowest = places[rows, np.where(known, inside, np.inf).argmin(axis=1)]
    highest = places[rows, np.where(known, inside, -np.inf).argmax(axis=1)]
    return np.unique(np.concatenate([lowest, highest]))


def known_part(values: Array) -> int:
    """Return the number of samples of a series (n,) before the first one that is not finite."""
    unknown = np.flatnonzero(~np.isfinite(values))
    return int(unknown[0]) if unknown.size else values.size


def window_at(time_s: Array, instant_s: float, length_s: float = CLOSE_LOOK_S) -> slice:
    """Return the samples of a stretch of `length_s` around an instant, shifted if it exceeds the record."""
    first = min(max(instant_s - 0.5 * length_s, float(time_s[0])), max(float(time_s[-1]) - length_s, float(time_s[0])))
    start = int(np.searchsorted(time_s, first - 1e-9))
    return slice(start, int(np.searchsorted(time_s, first + length_s + 1e-9)))


def busiest(time_s: Array, values: Array, length_s: float = CLOSE_LOOK_S) -> slice:
    """Return the stretch around the largest absolute value of a series (n,)."""
    return window_at(time_s, float(time_s[int(np.nanargmax(np.abs(values)))]), length_s)


def quietest(time_s: Array, values: Array, length_s: float) -> slice:
    """Return the stretch after the largest absolute value in which a series (n,) has the least power."""
    peak = int(np.nanargmax(np.abs(values)))
    count = round(length_s * (len(time_s) - 1) / float(time_s[-1] - time_s[0]))
    count = min(max(count, 1), values.size - 1)
    power = np.concatenate([[0.0], np.cumsum(np.nan_to_num(values) ** 2)])
    start = min(peak, max(values.size - count - 1, 0))
    moving = power[start + count :] - power[start : power.size - count]
    first = start + int(moving.argmin())
    return slice(first, min(first + count + 1, values.size))


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


def thinned_envelope(fine: Envelope, width: int) -> Envelope:
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
            found = [pack(thinned_envelope(one, factor * width_of(one.count))) for one in self.envelopes]
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
