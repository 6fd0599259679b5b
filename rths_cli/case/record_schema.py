"""The keys of a case's `record`: its file, what is done to it, and what it is scaled to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from rths_cli.case.field_types import Problem, Range, Strict, listed


class BaselineSpec(Strict):
    """Hold what is removed from a record; a word is short for `{remove: word}`."""

    wanted: ClassVar[str] = "a word or a mapping"

    remove: Literal["mean", "linear", "polynomial", "step", "none"] = Field(
        description="its mean, its least-squares line or polynomial, the level of a quiet start or end that steps; "
        "none: nothing, and a motion that begins with a step is run as it is"
    )
    order: Annotated[int, Range(ge=1, le=8)] = Field(default=2, description="order of the polynomial")
    taper_s: Annotated[float, Range(ge=0, le=60)] = Field(
        default=0.0, description="length of a half cosine by which it then begins and ends at zero"
    )
    zero_velocity: bool = Field(
        default=False,
        description="whether a smooth acceleration over its whole length brings it to rest at its end",
    )


def _spelled_out(baseline: object) -> object:
    return {"remove": baseline} if isinstance(baseline, str) else baseline


Baseline = Annotated[
    BaselineSpec,
    BeforeValidator(
        _spelled_out, json_schema_input_type=Literal["mean", "linear", "polynomial", "step", "none"] | BaselineSpec
    ),
]


class ScaleToSpec(Strict):
    """Hold what a record is scaled to before `scaling`: one measure's value, or a code's spectrum."""

    measure: Literal["pga", "sa_t1", "arias"] | None = Field(
        default=None,
        description="peak acceleration, spectral acceleration at the building's first period and 5 % damping, or Arias "
        "intensity: of the record as it is written, the prototype's where `scale` is stated",
    )
    value: Annotated[float, Range(gt=0, le=1000)] | None = Field(
        default=None, description="of the measure: in m/s^2, of the Arias intensity in m/s"
    )
    spectrum: Literal["ec8", "asce7"] | Path | None = Field(
        default=None,
        description="instead of a measure, the elastic spectrum of Eurocode 8 (ec8: EN 1998-1, 3.2.2.2), the design "
        "spectrum of ASCE 7 (asce7: 11.4), or a file with the columns period_s and sa_g (or sa_m_s2)",
    )
    method: Literal["least_squares", "match"] = Field(
        default="least_squares",
        description="how a spectrum is reached. least_squares: by a factor, that of the least squares between the "
        "logarithms of both; match: by the least motion added within the band of the periods",
    )
    period_s: (
        Annotated[
            tuple[Annotated[float, Range(ge=0.01, le=20)], ...],
            Field(json_schema_extra={"minItems": 2, "maxItems": 2}),
        ]
        | None
    ) = Field(default=None, description="ends of the periods that count, of the record as it is written")
    damping: Annotated[float, Range(ge=0.005, le=0.3)] = Field(
        default=0.05, description="damping ratio of both spectra; asce7: 0.05 alone"
    )
    type: Literal[1, 2] = Field(default=1, description="type of the spectrum of ec8")
    ground: Literal["A", "B", "C", "D", "E"] | None = Field(default=None, description="ground type of ec8")
    ag_m_s2: Annotated[float, Range(gt=0, le=50)] | None = Field(
        default=None, description="design ground acceleration of ec8 on ground A, importance factor included"
    )
    sds_g: Annotated[float, Range(gt=0, le=5)] | None = Field(
        default=None, description="spectral acceleration of asce7 at short periods, in g"
    )
    sd1_g: Annotated[float, Range(gt=0, le=5)] | None = Field(default=None, description="that at 1 s, in g")
    tl_s: Annotated[float, Range(ge=1, le=30)] = Field(default=8.0, description="long-period transition of asce7")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield a fault for both or neither of measure and spectrum, and for each key that the one stated needs."""
        if (data.get("measure") is None) == (data.get("spectrum") is None):
            yield (), "needs one of measure (with value) and spectrum (with period_s)"
            return
        needed = ("value",) if data.get("measure") else ("period_s", *OF_CODE.get(str(data.get("spectrum")), ()))
        named = data.get("measure") or Path(str(data.get("spectrum"))).name
        for key in needed:
            if data.get(key) is None:
                yield (), f"needs {key} with {named}"
        if data.get("measure") and data.get("method") == "match":
            yield ("method",), "belongs to a spectrum; a measure is reached by a factor"
        yield from _two_ends(data, "period_s", "periods in s", "[0.2, 2]")
        if data.get("spectrum") == "asce7" and data.get("damping", 0.05) != 0.05:
            yield ("damping",), "is 0.05 in the spectrum of asce7; leave it out"


OF_CODE = {"ec8": ("ground", "ag_m_s2"), "asce7": ("sds_g", "sd1_g")}


def _two_ends(data: Mapping[str, Any], key: str, what: str, example: str) -> Iterator[Problem]:
    """Yield a fault of a list that is not two ends, the lower one first."""
    band = listed(data, key)
    if band is not None and (len(band) != 2 or not all(isinstance(f, int | float) for f in band) or band[0] >= band[1]):
        yield (key,), f"must be the two ends of {what}, the lower one first, such as {example}"


class RecordSpec(Strict):
    """Hold a ground motion's file, and what is done to it before it is scaled; unit and interval only where the file
    itself does not state them."""

    wanted: ClassVar[str] = "a name or a mapping"

    file: Path = Field(description="a name looked up in records/, or a path")
    unit: str | None = Field(
        default=None,
        min_length=1,
        max_length=20,
        description="unit of the accelerations, where the file does not state it: m/s^2, cm/s^2, gal, g, mm/s^2, "
        "in/s^2, ft/s^2, mg, %g",
    )
    dt_s: Annotated[float, Range(gt=0, le=10)] | None = Field(
        default=None, description="interval of the samples, where the file does not state it"
    )
    component: Annotated[str, Field(min_length=1, max_length=60)] | None = Field(
        default=None,
        description="which one, where the file holds several: its direction, code, channel or column (NS, 90, HNE, "
        "channel 1)",
    )
    baseline: Baseline | None = Field(
        default=None,
        description="what is removed from the record before it is scaled, in a word or in full; default: nothing, and "
        "a motion that begins with a step is refused",
    )
    band_hz: (
        Annotated[
            tuple[Annotated[float, Range(ge=0.005, le=1000)], ...],
            Field(json_schema_extra={"minItems": 2, "maxItems": 2}),
        ]
        | None
    ) = Field(
        default=None,
        description="band outside of which it is filtered away, by two poles at each end, forth and back; default: not "
        "filtered before it is scaled",
    )
    resample_hz: Annotated[float, Range(ge=1, le=100_000)] | None = Field(
        default=None,
        description="rate to which it is resampled within its band, before the straight lines between its samples are "
        "followed; default: its own",
    )
    scale_to: ScaleToSpec | None = Field(
        default=None, description="what it is scaled to then, before `scaling`; default: nothing, it keeps its size"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield a fault of the band."""
        yield from _two_ends(data, "band_hz", "a band in Hz", "[0.1, 25]")

    @property
    def keeps_baseline(self) -> bool:
        """Return whether the case plays a motion as it is, in so many words."""
        return self.baseline is not None and self.baseline.remove == "none"

    @property
    def name(self) -> str:
        """Return the record's name: its file's, without the suffix."""
        return self.file.stem

    @property
    def path(self) -> Path:
        """Return the record's file."""
        return self.file
