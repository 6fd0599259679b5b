"""Every key of a study file: a case, the axes that are varied, how they are sampled, and what is kept."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, PlainValidator, ValidatorFunctionWrapHandler, WithJsonSchema, WrapValidator

from rths_cli.case.case_schema import FileName, Seed
from rths_cli.case.field_types import Problem, Range, Strict, exactly_one, listed, near, number, refusal, shown

MOST_RUNS = 1_000_000
FINITE = Range(ge=-1e12, le=1e12)
Number = Annotated[float, FINITE]
Count = Annotated[int, Range(ge=2, le=MOST_RUNS)]
Method = Literal["latin_hypercube", "sobol", "sobol_indices"]
WANTED_AXIS = (
    "a list of values, a range {start: 0.1, stop: 0.5, count: 5}, {folder: ./records} or {distribution: normal, ...}"
)


class ListAxis(Strict):
    """Hold the values of an axis one by one: numbers, texts, truths, lists or mappings, as a case takes them."""

    values: tuple[Any, ...] = Field(min_length=1, description="the values; a bare list says the same")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        before: set[str] = set()
        for k, value in enumerate(listed(data, "values") or ()):
            text = json.dumps(value, default=str)
            if value is None:
                yield ("values", k), "is missing; give a value, or remove the entry"
            elif text in before:
                yield ("values", k), f"{shown(value)} is given twice; give each value once"
            before.add(text)


class RangeAxis(Strict):
    """Hold evenly spaced values, both ends included; whole ends with a whole step stay whole numbers."""

    start: Number = Field(description="first value")
    stop: Number = Field(description="last value")
    count: Count = Field(description="how many values")
    spacing: Literal["linear", "log"] = Field(default="linear", description="even steps, or even ratios")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        start, stop = number(data, "start"), number(data, "stop")
        if start is None or stop is None:
            return
        if start == stop:
            yield ("stop",), f"must differ from start = {start:g}"
        elif data.get("spacing") == "log" and min(start, stop) <= 0:
            yield ("start" if start <= 0 else "stop",), f"must be > 0 with spacing log, got {min(start, stop):g}"


class FolderAxis(Strict):
    """Hold a set of records: those of a folder, in the order of their names, or of a list."""

    folder: str = Field(
        min_length=1,
        description="every record in it is a value, or that each line of this text file names; of `record` alone",
    )


class NormalAxis(Strict):
    """Hold a normal distribution."""

    distribution: Literal["normal"] = Field(description="bell curve")
    mean: Number = Field(description="mean")
    std: Annotated[float, Range(gt=0, le=1e12)] = Field(description="standard deviation")


class TruncatedNormalAxis(Strict):
    """Hold a normal distribution cut at two ends; mean and standard deviation are those before the cut."""

    distribution: Literal["truncated_normal"] = Field(description="bell curve between two ends")
    mean: Number = Field(description="mean before the cut")
    std: Annotated[float, Range(gt=0, le=1e12)] = Field(description="standard deviation before the cut")
    low: Number = Field(description="smallest value")
    high: Number = Field(description="largest value")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from _ends(data)


class LognormalAxis(Strict):
    """Hold a lognormal distribution by its median and its coefficient of variation."""

    distribution: Literal["lognormal"] = Field(description="its logarithm is normal")
    median: Annotated[float, Range(gt=0, le=1e12)] = Field(description="median")
    cov: Annotated[float, Range(gt=0, le=100)] = Field(
        description="coefficient of variation, standard deviation over mean; that of the logarithm is "
        "sqrt(ln(1 + cov^2))"
    )


class UniformAxis(Strict):
    """Hold a uniform distribution."""

    distribution: Literal["uniform"] = Field(description="every value between two ends is as likely")
    low: Number = Field(description="smallest value")
    high: Number = Field(description="largest value")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from _ends(data)


class EmpiricalAxis(Strict):
    """Hold values that were observed: each of them is as likely."""

    distribution: Literal["empirical"] = Field(description="observed values, each as likely")
    values: tuple[Any, ...] | None = Field(
        default=None, min_length=1, description="the values: numbers, or texts such as names of records"
    )
    file: str | None = Field(default=None, description="a CSV file with a header, instead of `values`")
    column: str | None = Field(default=None, description="which column of `file`, by its header")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from exactly_one(data, "values", "file")
        if (data.get("file") is None) != (data.get("column") is None):
            told = "a file needs a column, and a column a file; give both"
            yield ("column" if data.get("column") is not None else "file",), told
        for k, value in enumerate(listed(data, "values") or ()):
            if value is None:
                yield ("values", k), "is missing; give a value, or remove the entry"


def _ends(data: Mapping[str, Any]) -> Iterator[Problem]:
    low, high = number(data, "low"), number(data, "high")
    if low is not None and high is not None and low >= high:
        yield ("high",), f"must be > low = {low:g}, got {high:g}"


DISTRIBUTIONS: dict[str, type[Strict]] = {
    "normal": NormalAxis,
    "lognormal": LognormalAxis,
    "uniform": UniformAxis,
    "truncated_normal": TruncatedNormalAxis,
    "empirical": EmpiricalAxis,
}
LISTED: dict[str, type[Strict]] = {"values": ListAxis, "start": RangeAxis, "folder": FolderAxis}
"""Axes that are no distribution, each by a key that tells it."""
Distribution = NormalAxis | LognormalAxis | UniformAxis | TruncatedNormalAxis | EmpiricalAxis
Axis = ListAxis | RangeAxis | FolderAxis | Distribution


def read_axis(data: Any, handler: ValidatorFunctionWrapHandler) -> Strict:
    """Return the axis of unchecked data; raises the faults of the one kind that it is."""
    if isinstance(data, Strict):
        return data
    if isinstance(data, list | tuple):
        return ListAxis.model_validate({"values": data})
    if not isinstance(data, Mapping):
        raise refusal(f"must be {WANTED_AXIS}, got {shown(data)}")
    if "distribution" in data:
        name = data["distribution"]
        if not isinstance(name, str) or name not in DISTRIBUTIONS:
            called = name[:40] if isinstance(name, str) else shown(name)
            raise refusal(f"no distribution is called {called!r}{near(str(name), DISTRIBUTIONS)}")
        return DISTRIBUTIONS[name].model_validate(data)
    kind = next((model for key, model in LISTED.items() if key in data), None)
    if kind is None and not {"stop", "count"} & set(data):
        raise refusal(f"must be {WANTED_AXIS}")
    return (kind or RangeAxis).model_validate(data)


AnyAxis = Annotated[Axis, WrapValidator(read_axis)]


class SamplesSpec(Strict):
    """Hold how many values are drawn of all distributions together, and how."""

    method: Method = Field(
        default="latin_hypercube",
        description="Latin hypercube; scrambled Sobol sequence; or the rows from which Sobol indices are estimated "
        "(Saltelli), count times the number of distributions + 2",
    )
    count: Annotated[int, Range(ge=1, le=MOST_RUNS)] = Field(
        description="number of samples; of a Sobol sequence a power of 2"
    )
    seed: Seed = Field(default=0, description="seed of the samples; the same seed gives the same rows")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        count, method = number(data, "count"), data.get("method")
        if not isinstance(count, int) or not 1 <= count <= MOST_RUNS:
            return
        if method in ("sobol", "sobol_indices") and count & (count - 1):
            below = 1 << (count.bit_length() - 1)
            yield ("count",), f"must be a power of 2 with method {method}, such as {below} or {2 * below}, got {count}"


class CorrelationSpec(Strict):
    """Hold the correlation of two sampled axes, of a Gaussian copula."""

    between: tuple[str, ...] = Field(
        description="the keys of two axes", json_schema_extra={"minItems": 2, "maxItems": 2}
    )
    rank: Annotated[float, Range(gt=-1, lt=1)] | None = Field(default=None, description="Spearman's rank correlation")
    normal: Annotated[float, Range(gt=-1, lt=1)] | None = Field(
        default=None, description="correlation of the copula's normal variables, instead of `rank`"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from exactly_one(data, "rank", "normal")
        pair = listed(data, "between")
        if pair is not None and (len(pair) != 2 or pair[0] == pair[1]):
            yield ("between",), "must name two different axes"


def _side(value: Any) -> Any:
    if isinstance(value, str) or (isinstance(value, int | float) and not isinstance(value, bool)):
        return value
    raise refusal(f"must be the key of an axis, or a number, got {shown(value)}")


Side = Annotated[
    str | float,
    PlainValidator(_side),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "number"}]}),
]


class ConstraintSpec(Strict):
    """Hold one comparison that a row must meet; rows that do not are left out."""

    left: Side = Field(description="the key of an axis with numbers, or a number")
    op: Literal["<", "<=", ">", ">=", "==", "!="] = Field(description="comparison")
    right: Side = Field(description="the key of an axis with numbers, or a number")
    times: Number = Field(default=1.0, description="factor on `right`")


class SeedsSpec(Strict):
    """Hold the seeds of every row, both ends included."""

    first: Seed = Field(description="first seed")
    last: Seed = Field(description="last seed")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        first, last = number(data, "first"), number(data, "last")
        if first is not None and last is not None and last < first:
            yield ("last",), f"must be >= first = {first:g}, got {last:g}"


def read_seeds(data: Any, handler: ValidatorFunctionWrapHandler) -> SeedsSpec:
    """Return the seeds of a count, which means 0 to count - 1, or of a mapping."""
    if isinstance(data, SeedsSpec | Mapping):
        return SeedsSpec.model_validate(data)
    if isinstance(data, int) and not isinstance(data, bool) and 1 <= data <= MOST_RUNS:
        return SeedsSpec(first=0, last=data - 1)
    raise refusal(f"must be a number of seeds from 1 to {MOST_RUNS}, or {{first: 3, last: 5}}, got {shown(data)}")


def _case(value: Any) -> Any:
    if isinstance(value, Mapping) or (isinstance(value, str) and value.strip()):
        return value
    raise refusal(f"must be the name or path of a case, or its keys as a mapping, got {shown(value)}")


CASE_KEYS = {"anyOf": [{"type": "string", "minLength": 1}, {"type": "object"}]}


class StudyKeys(Strict):
    """Hold the keys of a study file."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        "seed": "unknown key; seeds is that of the runs, samples.seed that of the samples",
        "vary": "unknown key; did you mean axes?",
    }

    name: FileName | None = Field(default=None, description="default: the file's name; the table is sweeps/NAME.h5")
    case: Annotated[Any, PlainValidator(_case), WithJsonSchema(CASE_KEYS)] = Field(
        description="the case that is varied: a name, a path, or its keys"
    )
    axes: dict[str, AnyAxis] = Field(
        default={}, description="what is varied: keys of the case, dotted, each with its values or its distribution"
    )
    samples: SamplesSpec | None = Field(
        default=None, description="how the distributions are sampled; needed where an axis has one"
    )
    correlations: tuple[CorrelationSpec, ...] = Field(default=(), description="of axes that are sampled")
    constraints: tuple[ConstraintSpec, ...] = Field(default=(), description="which rows are kept: all must be met")
    seeds: Annotated[SeedsSpec, WrapValidator(read_seeds)] | None = Field(
        default=None, description="seeds of the noise, of every row: a number N for 0 to N - 1, or both ends; default: "
        "the case's own",
    )  # fmt: skip
    metrics: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="paths of the metrics that are kept; default: all that a sweep computes"
    )
    notes: str = Field(default="", description="any text")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        axes = data.get("axes")
        if not isinstance(axes, Mapping):
            axes = {}
        sampled = [key for key, axis in axes.items() if isinstance(axis, Mapping) and "distribution" in axis]
        yield from _folder_problems(axes)
        yield from _sample_problems(data, sampled)
        yield from _correlation_problems(listed(data, "correlations") or (), axes, sampled)
        for k, constraint in enumerate(listed(data, "constraints") or ()):
            for side in ("left", "right"):
                key = constraint.get(side) if isinstance(constraint, Mapping) else None
                if isinstance(key, str) and key not in axes:
                    yield ("constraints", k, side), f"no axis is called {key[:80]!r}{near(key, axes)}"


def _folder_problems(axes: Mapping[str, Any]) -> Iterator[Problem]:
    for key, axis in axes.items():
        if isinstance(axis, Mapping) and "folder" in axis and key not in ("record", "record.file"):
            yield ("axes", key), "a folder gives the values of record alone; list the values"


def _sample_problems(data: Mapping[str, Any], sampled: list[str]) -> Iterator[Problem]:
    samples = data.get("samples")
    if sampled and samples is None:
        told = "an axis has a distribution; add samples: {method: latin_hypercube, count: 100}"
        yield ("axes", sampled[0]), told
    if samples is not None and not sampled:
        yield ("samples",), "no axis has a distribution; give one, or remove samples"
    method = samples.get("method") if isinstance(samples, Mapping) else None
    if method == "sobol_indices":
        for key in ("correlations", "constraints"):
            if data.get(key):
                yield (key,), "Sobol indices need independent axes and every row; remove it, or use method sobol"


def _correlation_problems(correlations: Any, axes: Mapping[str, Any], sampled: list[str]) -> Iterator[Problem]:
    pairs: set[frozenset[str]] = set()
    for k, correlation in enumerate(correlations):
        names = listed(correlation, "between") if isinstance(correlation, Mapping) else None
        texts = [name for name in names or () if isinstance(name, str)]
        for name in texts:
            if name not in axes:
                yield ("correlations", k, "between"), f"no axis is called {name[:80]!r}{near(name, axes)}"
            elif name not in sampled:
                yield ("correlations", k, "between"), f"{name[:80]} has no distribution; only sampled axes correlate"
        if frozenset(texts) in pairs:
            yield ("correlations", k, "between"), "these two axes are correlated above already; keep one"
        pairs.add(frozenset(texts))


def is_sampled(axis: Strict) -> bool:
    """Return whether an axis is a distribution."""
    return isinstance(axis, tuple(DISTRIBUTIONS.values()))
