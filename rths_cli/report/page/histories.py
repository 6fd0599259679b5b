"""Charts over time: the record, storeys and table with their errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.files.result_reader import Result, read_series
from rths_cli.numerics.lti import Array
from rths_cli.quantities import DATASETS
from rths_cli.quantities.declaration import typeset
from rths_cli.report.figures.figure_data import Pool, envelope, width_of
from rths_cli.report.filtered_errors import evaluated_error
from rths_cli.report.result_scale import series_factor
from rths_cli.report.results_by_case import RUN_NAMES

BUILDINGS = ("sim", "sim_delay", "exp_rths")
TABLES = ("exp_rths", "shake_table")
UNIT = typeset(DATASETS["exp_rths/abs_accel_m_s2"].units)
MM_PER_M = 1e3
ERROR_UNIT = f"m{UNIT}"  # errors are a thousandth of the motion


@dataclass(frozen=True)
class Trace:
    """A series of a chart."""

    name: str
    role: str  # selects the colour: sim, sim_delay, exp_rths, desired, measured or error
    values: Array  # (n,) in the chart's unit
    shown: bool = True  # False: a click shows it, because it would hide the others


@dataclass(frozen=True)
class Chart:
    """A chart of series with the same unit."""

    title: str
    unit: str
    time_s: Array  # (n,)
    traces: tuple[Trace, ...]  # a series of a run that stopped early is shorter than n


@dataclass(frozen=True)
class View:
    """The charts of one entry of a menu: the table in a run, or a storey."""

    name: str
    charts: tuple[Chart, ...]


def left_out(results: Sequence[Result]) -> list[str]:
    """Return a sentence for each result that holds no series to be drawn."""
    said = "has no time histories, the case was run with --series none; run it with --series all or essential."
    return [f"{result.path.name} {said}" for result in results if result.series == "none"]


def tables(result: Result) -> Iterator[View]:
    """Yield desired and measured acceleration of the table and their difference, for each run on the table."""
    for run in TABLES:
        if run in result.groups:
            time = read_series(result.path, f"{run}/time_s")
            desired, measured = (
                read_series(result.path, f"{run}/interface_accel_{name}_m_s2") for name in ("desired", "measured")
            )
            both = (Trace("desired", "desired", desired), Trace("measured", "measured", measured))
            missed = MM_PER_M * evaluated_error(result, run, desired - measured, _step(time))
            error = Trace("desired - measured", "error", missed)
            charts = (
                Chart("Table acceleration", UNIT, time, both),
                Chart(f"Tracking error, {_band(result)}", ERROR_UNIT, time, (error,)),
            )
            yield View(RUN_NAMES[run], charts)


def storeys(result: Result) -> Iterator[View]:
    """Yield the absolute acceleration of each storey, the roof first, by SIM, SIM-DELAY and EXP-RTHS, and their errors
    to SIM."""
    runs = [run for run in BUILDINGS if run in result.groups]
    if not runs:
        return
    times = [read_series(result.path, f"{run}/time_s") for run in runs]
    time = max(times, key=lambda values: values.size)
    accel = {run: read_series(result.path, f"{run}/abs_accel_m_s2") for run in runs}
    interface = _interface(result)
    roof = len(accel[runs[0]])
    names = {roof: " (roof)", interface: " (interface)"}
    for place in reversed(range(roof)):
        of = {run: values[place] for run, values in accel.items()}
        name = f"{place + 1}{names.get(place + 1, '')}"
        yield View(name, tuple(_storey_charts(result, place + 1, of, time)))


def _storey_charts(result: Result, storey: int, of: dict[str, Array], time: Array) -> Iterator[Chart]:
    traces = tuple(Trace(RUN_NAMES[run], run, values) for run, values in of.items())
    yield Chart(f"Absolute acceleration, storey {storey}", UNIT, time, traces)
    errors = tuple(error_trace(result, run, of, time) for run in BUILDINGS[1:] if run in of and "sim" in of)
    if errors:
        yield Chart(f"Error to SIM, storey {storey}, {_band(result)}", ERROR_UNIT, time, errors)


def _band(result: Result) -> str:
    return f"{result.test_band_hz:g} Hz test band"


def error_trace(result: Result, run: str, of: dict[str, Array], time: Array) -> Trace:
    """Return the error SIM - run of one storey's absolute acceleration in mm/s^2, with the filters of its RMS.

    `of`: series (n,) in m/s^2 by run, with SIM; `time` (n,) in s.
    """
    both = min(of["sim"].size, of[run].size)
    error = of["sim"][:both] - of[run][:both]
    values = MM_PER_M * evaluated_error(result, run, error, _step(time))
    return Trace(f"SIM - {RUN_NAMES[run]}", run, values, run == "exp_rths" or "exp_rths" not in of)


def record(result: Result) -> Chart | None:
    """Return the acceleration of the ground, None where the result holds no record."""
    if "record" not in result.groups:
        return None
    time, ground = (read_series(result.path, f"record/{name}") for name in ("time_s", "ground_accel_m_s2"))
    name = str(result.attributes.get("record_name") or "record")
    return Chart("Ground acceleration", UNIT, time, (Trace(name, "model", ground),))


def document(result: Result, pool: Pool) -> dict[str, object]:
    """Return the charts of a result for JSON; their series are added to `pool` and named by their indices there."""
    if left_out([result]):
        return {"record": None, "runs": [], "storeys": []}
    views = {"runs": tables(result), "storeys": storeys(result)}
    ground = record(result)
    return {"record": None if ground is None else _chart(_in_scale(ground, result), pool)} | {
        kind: [
            {"name": view.name, "charts": [_chart(_in_scale(chart, result), pool) for chart in view.charts]}
            for view in found
        ]
        for kind, found in views.items()
    }


def _in_scale(chart: Chart, result: Result) -> Chart:
    """Return a chart of accelerations, made and filtered in model scale, in the scale of the result."""
    time, accel = (series_factor(result, f"sim/{name}") for name in ("time_s", "abs_accel_m_s2"))
    if time == accel == 1.0:
        return chart
    traces = tuple(replace(trace, values=accel * trace.values) for trace in chart.traces)
    return replace(chart, time_s=time * chart.time_s, traces=traces)


def _chart(chart: Chart, pool: Pool) -> dict[str, object]:
    step, start = _step(chart.time_s), float(chart.time_s[0]) if chart.time_s.size else 0.0
    traces = []
    for trace in chart.traces:
        if np.any(np.isfinite(trace.values)):
            short = envelope(trace.values, start, step, width_of(chart.time_s.size))
            whole = bool(np.all(np.isfinite(trace.values)))
            about = {"name": trace.name, "role": trace.role, "whole": whole, "shown": trace.shown and whole}
            traces.append(about | {"series": pool.add(short)})
    return {"title": chart.title, "unit": chart.unit, "traces": traces}


def _step(time: Array) -> float:
    """Return the mean interval of a time (n,) in s, rounded to a femtosecond: 0.0005, not 0.00050000000000001."""
    return round(float(time[-1] - time[0]) / (time.size - 1), 15) if time.size > 1 else 1.0


def _interface(result: Result) -> int:
    """Return the storey (from 1) that the table moves, 0 if no run states it."""
    for run in TABLES:
        if run in result.groups:
            return int(read_series(result.path, f"{run}/floor")[0]) - 1
    return 0
