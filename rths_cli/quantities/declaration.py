"""The classes of all declarations: quantities, datasets, axes, units, a metric's value with its interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from rths_cli.unit_names import ENDINGS, unit_of_name

ACCEL = "m/s^2"
LESS, MORE, ZERO, ONE, NONE = "smaller", "larger", "near zero", "near one", "none"
BAND = (
    "in the test band (test_band_hz, 12 Hz by default; 4th-order Butterworth forward and backward), above the lowest "
    "reliable frequency"
)
COMPARED = "the compared band (identification.compared_hz, 0.7-11 Hz by default)"
FULL = "above the lowest reliable frequency"
Values = Mapping[str, ArrayLike]
"""Values of metrics by their paths: a number each, or one per storey, channel, mode or frequency."""

TABLE_RUNS = ("shake_table", "exp_rths")
"""The runs on the table, by the names of their groups."""
Source = Literal["computed", "measured", "estimated", "true"]
"""Where values come from; `true` is what only a simulated rig knows."""
Kind = Literal["real", "complex", "text"]
KIND_OF_DTYPE = {**dict.fromkeys("biuf", "real"), "c": "complex", **dict.fromkeys("OSU", "text")}
ROUNDED_BITS = 32  # error at most 2^-32 = 2.3e-10 of the largest value
RISING = ("time_s", "rest_time_s", "frequency_hz")
"""Axes along which values rise."""
SAMPLED = ("time_s", "rest_time_s")
"""Axes of samples: a run that was stopped holds fewer, and a sample that is not known is NaN."""


@dataclass(frozen=True)
class Quantity:
    """Hold what a number is.

    `path` with dots between its groups; `over`: what it has one value for each of ("" for a single number); `better`:
    which way it improves; `text`: its meaning; `kinds`: the suffixes under which it stands too; `band`: where in
    frequency it is evaluated, "" where that says nothing; `reference`: the publication that defines it; `scales_as`:
    the units by whose factor a motion or force of the building scales to the prototype; "" for a figure of the rig or
    of the loop, which has no value in prototype scale; `partial`: storeys that have no such figure are NaN.
    """

    path: str
    units: str
    over: str
    better: str
    text: str
    kinds: tuple[str, ...] = ()
    band: str = ""
    reference: str = ""
    scales_as: str = ""
    partial: bool = False

    @property
    def group(self) -> str:
        """Return the first part of the path: the run, or what was evaluated (`check`, `latency`)."""
        return self.path.partition(".")[0]

    @property
    def definition(self) -> str:
        """Return the meaning with the band it is evaluated in."""
        return f"{self.text}, {self.band}" if self.band else self.text


@dataclass(frozen=True)
class Axis:
    """Hold what the scale of an axis is: its name in every group, unit and meaning.

    `counted`: the scale counts from 1, so that a writer makes it where it was given none.
    """

    name: str
    units: str
    text: str
    counted: bool = False


@dataclass(frozen=True)
class DatasetDeclaration:
    """Hold what a dataset of a file is.

    `path`: group and name with slashes, in capitals what stands for several names (`RUN`); `axes`: the names of its
    scales, time or frequency last; `text`: its meaning; `kind`: a complex dataset is stored as NAME_real and
    NAME_imag; `present`: when it is in its group, "" for always; `remarks`: what a file may add to the meaning;
    `essential`: whether a result keeps it with `--series essential`; `follows`: whether it follows from others of its
    group, and is rounded to ROUNDED_BITS of each row's largest value, so that it takes half the space.
    """

    path: str
    units: str
    axes: tuple[str, ...]
    source: Source
    text: str
    kind: Kind = "real"
    present: str = ""
    remarks: tuple[str, ...] = ()
    essential: bool = False
    follows: bool = False

    @property
    def group(self) -> str:
        """Return the path of the group that holds it."""
        return self.path.rpartition("/")[0]

    @property
    def name(self) -> str:
        """Return the last part of the path."""
        return self.path.rpartition("/")[2]

    @property
    def stored_paths(self) -> tuple[str, ...]:
        """Return the paths under which it stands in a file: two of a complex one."""
        return tuple(f"{self.path}{part}" for part in ("_real", "_imag")) if self.kind == "complex" else (self.path,)

    def meaning(self, remarks: tuple[str, ...] = ()) -> str:
        """Return the meaning with what one file adds to it; raises ValueError for a remark that is not declared."""
        if unknown := [remark for remark in remarks if remark not in self.remarks]:
            raise ValueError(f"{self.path} is not declared with the remark {unknown[0]!r}.")
        return ", ".join((self.text, *remarks))

    def checked(self, value: ArrayLike) -> np.ndarray:
        """Return a value as an array of the declared kind; raises ValueError for another kind or number of axes."""
        array = np.asarray(value)
        kind = KIND_OF_DTYPE.get(array.dtype.kind)
        if self.kind == "complex" and kind == "real":
            array, kind = array.astype(complex), "complex"
        if kind != self.kind or array.ndim != len(self.axes):
            held, declared = f"{kind} with {array.ndim} axes", f"{self.kind} with {len(self.axes)}"
            raise ValueError(f"{self.path} is {held}, declared is {declared}.")
        return array


@dataclass(frozen=True)
class AttributeDeclaration:
    """Hold what an attribute of a file or group is.

    `kind`: of its value; `limits`: smallest and largest number, or the texts that it may be, () for any;
    `present`: when it is there, "" for always.
    """

    name: str
    kind: Literal["number", "text", "texts"]
    text: str
    limits: tuple[float, float] | tuple[str, ...] = ()
    present: str = ""


AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("time_s", "s", "time since the start of the record"),
        Axis("rest_time_s", "s", "time since the start of the record, the rest before it and after it"),
        Axis("frequency_hz", "Hz", "frequency"),
        Axis("storey", "1", "storey, counted from 1 at the ground", counted=True),
        Axis("floor", "1", "experimental storey, counted as in the building; in a model file from 1 at the table"),
        Axis(
            "channel",
            "1",
            "channel: 1 the table, then the experimental floors from the lowest, then further channels",
            counted=True,
        ),
        Axis("further_channel", "1", "channel beside the accelerometers, counted from 1", counted=True),
        Axis("tangent", "1", "verdict of the check: 1 at rest, then the tangents of laws", counted=True),
        Axis("mode", "1", "mode, counted from 1", counted=True),
        Axis("frequency", "1", "frequency of the latency budget, counted from 1", counted=True),
        Axis("zero", "1", "zero, counted from 1", counted=True),
        Axis("pole", "1", "pole, counted from 1", counted=True),
        Axis("of_floor", "1", "floor that a force or motion is of, counted from 1", counted=True),
        Axis("joint", "1", "joint of a storey, counted from 1", counted=True),
        Axis("bend", "1", "change of a storey's stiffness, counted from 1", counted=True),
        Axis("parameter", "1", "parameter of a covariance, counted from 1", counted=True),
        Axis("of_parameter", "1", "the other parameter of a covariance, counted from 1", counted=True),
        Axis("row", "1", "row of a table, counted from 1", counted=True),
        Axis("band_hz_entry", "1", "end of the band: 1 lower, 2 upper", counted=True),
        Axis("feedforward_hz_entry", "1", "end of the band: 1 lower, 2 upper", counted=True),
        Axis("reasons_entry", "1", "reason, counted from 1", counted=True),
        Axis("findings_entry", "1", "finding, counted from 1", counted=True),
        Axis("warnings_entry", "1", "warning, counted from 1", counted=True),
        Axis("table_entry", "1", "cause, counted from 1", counted=True),
        Axis("storeys_entry", "1", "entry, counted from 1", counted=True),
        Axis("variant", "1", "run of the sweep, counted from 1", counted=True),
        Axis("state", "1", "state of a block, counted from 1", counted=True),
        Axis("next_state", "1", "state of a block a step later, counted from 1", counted=True),
        Axis("value", "1", "value that a part of the step logs, counted from 1", counted=True),
        Axis("input", "1", "input of a block, counted from 1", counted=True),
        Axis("output", "1", "output of a block, counted from 1", counted=True),
    )
}
"""Every axis by its name. Scales are computed, none is measured."""


__all__ = ["ENDINGS", "typeset", "unit_of_name"]


def typeset(units: str) -> str:
    """Return units with raised exponents: m/s²."""
    return units.replace("^2", "²").replace("^4", "⁴")


@dataclass(frozen=True, eq=False)
class Interval:
    """A metric's value, and the interval from `low` to `high` that holds the true one with at least `probability`.

    The three have the shape of the metric, a number or one per storey, mode, ...; `high` is infinite where nothing is
    known to limit it, both ends are NaN where nothing is known. As an array it is its value, so that whatever takes a
    value of a metric takes an interval too.
    """

    value: ArrayLike
    low: ArrayLike
    high: ArrayLike
    probability: float

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[np.float64]:
        """Return the value."""
        return np.array(self.value, dtype=dtype or np.float64)


def coverage(samples: int) -> float:
    """Return the probability with which the range of a number of equally likely samples holds a further one.

    Of n + 1 equally likely values each is the smallest, or the largest, with the probability 1 / (n + 1): the range
    of n of them leaves out the last one with 2 / (n + 1), whatever their distribution.
    """
    return (samples - 1) / (samples + 1)


def over_samples(values: Values, samples: Sequence[Values]) -> dict[str, ArrayLike]:
    """Return values with the range of each over themselves and the same values of equally likely samples.

    A value that is the same in every sample stays as it is, and so do all without samples. A NaN among the samples
    makes the ends NaN. Raises KeyError for a sample that lacks a value.
    """
    found: dict[str, ArrayLike] = {}
    for path, value in values.items():
        every = np.array([np.asarray(each, dtype=float) for each in (value, *(sample[path] for sample in samples))])
        same = np.array_equal(every, np.broadcast_to(every[0], every.shape), equal_nan=True)
        ends = every.min(axis=0), every.max(axis=0)
        found[path] = value if same else Interval(value, *ends, coverage(len(samples)))
    return found


def intervals_of(values: Values) -> dict[str, Interval]:
    """Return those of the values that carry an interval, by path."""
    return {path: value for path, value in values.items() if isinstance(value, Interval)}
