"""Results in model scale, as they are stored, or in prototype scale: figures, series, and the lines that say which.

Everything that prints or draws the figures of a result takes the results that `reported` returns.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.files.result_reader import Result, read_series
from rths_cli.numerics.lti import Array
from rths_cli.quantities import Interval, metric, stored_dataset
from rths_cli.structure import Similitude
from rths_cli.structure.similitude import factors_text

MODEL, PROTOTYPE = "model", "prototype"
SCALES = (MODEL, PROTOTYPE)
MOTIONS = ("record", "sim", "sim_delay", "exp_rths", "shake_table")
"""Groups whose motions and forces are those of the building, with their time; so are those of `truth` in them."""
SCALED = ("s", "m", "m/s", "m/s^2", "N")
"""Units of their series that scale; volts, counts and states do not."""


@dataclass(frozen=True)
class PrototypeResult(Result):
    """A result whose figures of the building are in prototype scale; `stored` is the same in model scale."""

    stored: Result = field(kw_only=True)


def scale_of(result: Result) -> Similitude | None:
    """Return the scale of the model of a result, prototype over model; None where its case states none."""
    return stored_scale(result.attributes)


def stored_scale(attributes: Mapping[str, Any]) -> Similitude | None:
    """Return the scale that the root attributes of a result or sweep state, None where they state none."""
    found = [attributes.get(f"scale_{name}") for name in ("length", "acceleration", "mass")]
    return None if None in found else Similitude(*(float(str(one)) for one in found))


def in_model_scale(result: Result) -> Result:
    """Return a result as it is stored."""
    return result.stored if isinstance(result, PrototypeResult) else result


def in_prototype_scale(result: Result) -> Result:
    """Return a result with the building's figures, intervals and published figures in prototype scale.

    Figures of the rig and of the loop, and a result without a scale, stay as they are.
    """
    scale = scale_of(result)
    if scale is None or isinstance(result, PrototypeResult):
        return result
    kept: dict[str, Any] = {one.name: getattr(result, one.name) for one in fields(Result)}
    kept["metrics"] = {path: _times(value, factor(scale, path)) for path, value in result.metrics.items()}
    kept["intervals"] = {path: _interval(one, factor(scale, path)) for path, one in result.intervals.items()}
    published = result.attributes.get("reference_json")
    if published:
        kept["attributes"] = {**result.attributes, "reference_json": _published(scale, str(published))}
    return PrototypeResult(**kept, stored=result)


def reported(results: Sequence[Result], report_in: str | None = None) -> list[Result]:
    """Return results in the scale that is asked for; None: in that of their cases, or where these differ as stored."""
    wanted = {str(result.attributes.get("report_in", MODEL)) for result in results if scale_of(result) is not None}
    chosen = report_in or (wanted.pop() if len(wanted) == 1 else MODEL)
    return [in_prototype_scale(result) if chosen == PROTOTYPE else in_model_scale(result) for result in results]


def factor(scale: Similitude, path: str) -> float:
    """Return the factor of a figure to prototype scale: 1 for one of the rig, of the loop, or not declared."""
    known = metric(path)
    return scale.factor(known.scales_as) if known is not None and known.scales_as else 1.0


def series(result: Result, name: str) -> Array:
    """Return the values of a dataset (`sim/rel_disp_m`) in the scale of the result: motions, forces and their time."""
    values, by = read_series(result.path, name), series_factor(result, name)
    return values if by == 1.0 else by * values


def series_factor(result: Result, name: str) -> float:
    """Return the factor of a dataset to the scale of the result: 1 for one of the rig or of the loop."""
    scale = scale_of(result) if isinstance(result, PrototypeResult) else None
    group, _, leaf = name.rpartition("/")
    declared = stored_dataset(name)
    units = "s" if leaf == "time_s" else declared.units if declared is not None else ""
    scales = group.removesuffix("/truth") in MOTIONS and units in SCALED
    return scale.factor(units) if scale is not None and scales else 1.0


def units_factor(result: Result, units: str) -> float:
    """Return the factor of a quantity of the building, by its units, to the scale of the result."""
    scale = scale_of(result) if isinstance(result, PrototypeResult) else None
    return 1.0 if scale is None else scale.factor(units)


def scale_words(result: Result) -> str:
    """Return the scale of a result's figures in two words, "" where its case states none."""
    if scale_of(result) is None:
        return ""
    return f"{PROTOTYPE if isinstance(result, PrototypeResult) else MODEL} scale"


def scale_lines(results: Sequence[Result]) -> list[str]:
    """Return sentences on the scale of results: model or prototype, and the factors; [] where no case states one."""
    told: dict[tuple[str, str], list[str]] = {}
    for result in results:
        scale = scale_of(result)
        if scale is not None:
            names = told.setdefault((scale_words(result), factors_text(scale.factors)), [])
            names.append(str(result.attributes.get("case_name") or result.path.stem))
    lines = []
    for (words, factors), names in told.items():
        of = "" if len(told) == 1 and len(names) == len(results) else f" ({', '.join(dict.fromkeys(names))})"
        lines.append(f"{words[0].upper()}{words[1:]}{of}; prototype over model: {factors}.")
    if any(isinstance(result, PrototypeResult) for result in results):
        without = [str(one.attributes.get("case_name") or one.path.stem) for one in results if scale_of(one) is None]
        if without:
            lines.append(f"No scale is stated for {', '.join(dict.fromkeys(without))}: shown as stored.")
        lines.append(
            "Rig and loop are in model scale: bands, delays, limits, volts, accept limits. So is the result file."
        )
    return lines


def scale_json(result: Result) -> dict[str, object] | None:
    """Return scale and factors of a result for JSON, None where its case states none."""
    scale = scale_of(result)
    if scale is None:
        return None
    return {"reported_in": scale_words(result).partition(" ")[0], "factors": scale.factors}


def _times(value: ArrayLike, by: float) -> float | Array:
    """Return a value times a factor; exactly the same value where the factor is 1."""
    array = np.asarray(value, dtype=float) * by
    return array if array.ndim else float(array)


def _interval(one: Interval, by: float) -> Interval:
    return replace(one, value=_times(one.value, by), low=_times(one.low, by), high=_times(one.high, by))


def _published(scale: Similitude, text: str) -> str:
    """Return published figures of a model, JSON by path, in prototype scale; what is no mapping stays as it is."""
    try:
        found = json.loads(text)
    except ValueError:
        return text
    if not isinstance(found, dict):
        return text
    return json.dumps({path: _scaled(value, factor(scale, path)) for path, value in found.items()})


def _scaled(value: Any, by: float) -> Any:
    if isinstance(value, list):
        return [_scaled(one, by) for one in value]
    return value * by if isinstance(value, int | float) else value
