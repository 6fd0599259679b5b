"""The classes of all declarations (`Quantity`, `DatasetDeclaration`, ...), and words that several share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

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


TABLE_RUNS = ("shake_table", "exp_rths")
"""The runs on the table, by the names of their groups."""
Source = Literal["computed", "measured", "estimated", "true"]
"""Where values come from; `true` is what only a simulated rig knows."""
Kind = Literal["real", "complex", "text"]
KIND_OF_DTYPE = {**dict.fromkeys("biuf", "real"), "c": "complex", **dict.fromkeys("OSU", "text")}


@dataclass(frozen=True)
class Axis:
    """Hold what the scale of an axis is: its name in every group, unit and meaning.

    `counted`: the scale counts from 1, so that a writer makes it where it was given none.
    """

    name: str
    units: str
    text: str
    counted: bool = False


ROUNDED_BITS = 32  # error at most 2^-32 = 2.3e-10 of the largest value


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
