"""Figures of limits (peaks against the guard's, margins of the loop), of the error budget, and of step timing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.hdf5_opening import RECORDED
from rths_cli.loop.lost_samples import without_samples
from rths_cli.numerics.lti import Array
from rths_cli.quantities import METRICS
from rths_cli.quantities.declaration import typeset
from rths_cli.report.case_metric_tables import CAUSES
from rths_cli.report.figures.figure_data import (
    MEASURED,
    NotDrawn,
    Source,
    chosen_storeys,
    interface_storey,
    points_of_lines,
    thinned,
)
from rths_cli.report.figures.panels import (
    ERROR_UNITS,
    MM_PER_M,
    SECONDS,
    Mark,
    dot_rows,
    dots_legend,
    legend_below,
    lettered,
    new_figure,
    trimmed_ticks,
)
from rths_cli.report.figures.style import BLACK, BLUE, GREEN, ORANGE, RUNS, VERMILLION, Look
from rths_cli.report.results_by_case import TABLE_RUNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PREDICTED = Mark("EXP-RTHS, predicted", ORANGE, "D", 5.0, filled=False)
REACHED = {
    "exp_rths": Mark("EXP-RTHS, reached", RUNS["exp_rths"].color),
    "shake_table": Mark("shake table test, reached", RUNS["shake_table"].color, "^", 4.0, filled=False),
}
LIMITS = {
    "command_v": "command",
    "displacement_m": "displacement",
    "velocity_m_s": "velocity",
    "acceleration_m_s2": "acceleration",
    "sensor_m_s2": "sensors",
    "force_n": "force",
}
MARGINS = {
    "gain_margin": ("gain margin", "factor", 1.0),
    "gain_reduction_margin": ("gain reduction margin", "factor", 1.0),
    "phase_margin_deg": ("phase margin", "angle (deg)", 1.0),
    "delay_margin_s": ("delay margin", "delay (ms)", 1e3),
    "sensitivity_peak": ("largest sensitivity", "|S|", 1.0),
}
LOOPS = {"check": "hybrid loop", "feedback": "feedback"}
VALUE = Mark("", BLACK, "s")

ERROR_KINDS = {
    "check": Mark("predicted before the run", ORANGE, "D", 5.0, filled=False),
    "budget": Mark("measured", BLUE),
}
TOGETHER = "together"
MICRO = 1e6
LEAST_S = 1e-8  # zero has no place on a logarithmic axis
TIMING_KINDS = {
    "compute_s": Look("computing", BLUE, "solid", 0.7),
    "late_s": Look("late", ORANGE, (0, (5.0, 1.5)), 0.9),
    "exchange_s": Look("exchange", GREEN, (0, (1.5, 1.0)), 0.9),
}
INTERVAL = Look("sample interval", VERMILLION, (0, (4.0, 2.0)), 0.9)
LOST = Look("no samples", VERMILLION)


def limits(source: Source, width: str) -> Figure:
    """Draw predicted and reached peaks in percent of their limits, and the margins of the hybrid loop and feedback."""
    names = [name for name in LIMITS if source.metric(f"check.limit_{name}") is not None]
    margins = [name for name in MARGINS if any(source.metric(f"{loop}.{name}") is not None for loop in LOOPS)]
    if not names and not margins:
        raise NotDrawn("no limits and no margins in the result")
    over = 4 if names else 0  # rows of the grid above the margins
    beside = width == "two" and bool(names)
    figure = new_figure(source, width, 28.0 + 14.0 * max(len(margins), 3) + (0.0 if beside else 62.0 * bool(names)))
    grid = figure.add_gridspec(max(len(margins), 1), 2) if beside else figure.add_gridspec(len(margins) + over, 1)
    marks: list[Mark] = []
    if names:
        marks = _peaks(
            figure.add_subplot(grid[:, 0] if beside else grid[:over, 0]), source, names, "\n" if beside else " "
        )
    for i, name in enumerate(margins):
        _margin(figure.add_subplot(grid[i, 1] if beside else grid[over + i, 0]), source, name)
    titles = ["peaks against limits"] * bool(names) + [MARGINS[name][0] for name in margins]
    for ax, title in zip(figure.axes, lettered(titles), strict=True):
        ax.set_title(title)
    if marks:
        dots_legend(figure, marks)
    return figure


def _peaks(ax: Axes, source: Source, names: Sequence[str], between: str) -> list[Mark]:
    """Draw peaks in percent of their limits and return the marks used."""
    bounds = {name: _figure(source, f"check.limit_{name}") for name in names}
    peaks = [(PREDICTED, {name: _figure(source, f"check.peak_{name}") for name in names})]
    peaks += [(REACHED[run], reached_peaks(source, run)) for run in REACHED if run in source.result.groups]
    shares = [np.array([100.0 * found.get(name, np.nan) / bounds[name] for name in names]) for _, found in peaks]
    units = {name: typeset(METRICS[f"check.limit_{name}"].units) for name in names}
    labels = [f"{LIMITS[name]}{between}({bounds[name]:.4g} {units[name]})" for name in names]
    dot_rows(ax, labels, [(mark, share) for (mark, _), share in zip(peaks, shares, strict=True)])
    ax.axvline(100.0, color=VERMILLION, lw=1.0, ls=(0, (4.0, 2.0)))
    ax.set_xlim(0.0, max(110.0, 1.05 * float(np.nanmax(np.concatenate(shares)))))
    ax.set_xlabel("share of the limit (%)")
    return [mark for mark, _ in peaks]


def reached_peaks(source: Source, run: str) -> dict[str, float]:
    """Return the largest recorded values of a run on the table, by the limit with which they are compared.

    Displacement is known only on a virtual rig; velocity and force are not stored. Acceleration is the largest one of
    all channels, as in the guard.
    """
    series = {
        "command_v": ["command_v"],
        "acceleration_m_s2": [MEASURED, "floor_accel_measured_m_s2"],
        "sensor_m_s2": [MEASURED, "floor_accel_measured_m_s2"],
    }
    if source.virtual:
        series["displacement_m"] = ["truth/table_disp_m"]
    return {
        name: max(float(np.nanmax(np.abs(source.read(f"{run}/{leaf}")))) for leaf in leaves)
        for name, leaves in series.items()
    }


def _margin(ax: Axes, source: Source, name: str) -> None:
    """Draw one margin of each loop with its value; an infinite one has no mark."""
    _, label, scale = MARGINS[name]
    loops = [loop for loop in LOOPS if source.metric(f"{loop}.{name}") is not None]
    values = scale * np.array([_figure(source, f"{loop}.{name}") for loop in loops])
    dot_rows(ax, [LOOPS[loop] for loop in loops], [(VALUE, np.where(np.isfinite(values), values, np.nan))])
    for place, value in enumerate(values):
        text, at, off = (f"{value:.3g}", value, 4) if np.isfinite(value) else ("none found", 0.0, 8)
        ax.annotate(text, (at, place), xytext=(off, 0), textcoords="offset points", va="center", fontsize=6.0)
    ax.tick_params(axis="x", direction="out")  # the panel is low: inside, ticks would cross the texts
    ax.set_xlim(0.0, 1.25 * max(values[np.isfinite(values)], default=1.0))
    ax.set_xlabel(label)


def _figure(source: Source, path: str) -> float:
    found = source.metric(path)
    return float("nan") if found is None else float(found[0])


def error_budget(source: Source, width: str) -> Figure:
    """Draw RMS errors by cause, predicted and measured: of tracking and of storeys to SIM, test band."""
    kinds = [kind for kind in ERROR_KINDS if source.metric(f"{kind}.rms_error_coupling_m_s2") is not None]
    if not kinds:
        raise NotDrawn("no error by cause in the result")
    count = np.size(source.result.metrics[f"{kinds[0]}.rms_error_coupling_m_s2"])
    columns = [0, *chosen_storeys(count, interface_storey(source))]
    causes = [cause for cause in CAUSES if any(error_by(source, k, cause, c) > 0.0 for k in kinds for c in columns)]
    labels = [*(CAUSES[cause] for cause in causes), TOGETHER]
    across = len(columns) if width == "two" else 2
    down = -(-len(columns) // across)
    figure = new_figure(source, width, 22.0 + down * (14.0 + 4.2 * len(labels)), source.band)
    axes = list(figure.subplots(down, across, sharey=True, squeeze=False).ravel())
    titles = ["tracking", *(f"storey {column}" for column in columns[1:])]
    for ax, column, title in zip(axes, columns, lettered(titles), strict=False):
        dot_rows(ax, labels, [(ERROR_KINDS[kind], _errors_mm(source, kind, causes, column)) for kind in kinds])
        ax.set(title=title, xscale="log", xlabel=f"RMS error ({ERROR_UNITS})")
        ax.margins(x=0.1)  # a mark at the end is whole
        trimmed_ticks(ax, log=True)
    for ax in axes[len(columns) :]:
        ax.set_visible(False)
    dots_legend(figure, [ERROR_KINDS[kind] for kind in kinds])
    return figure


def _errors_mm(source: Source, kind: str, causes: Sequence[str], column: int) -> Array:
    """Return the errors by cause and together in mm/s^2, (n_causes + 1,); what is zero has no place on the axis."""
    values = np.array([error_by(source, kind, cause, column) for cause in (*causes, "")])
    return np.where(values > 0.0, MM_PER_M * values, np.nan)


def error_by(source: Source, kind: str, cause: str, column: int) -> float:
    """Return the RMS error in m/s^2 due to a cause ("": total), of a storey or, for column 0, of tracking."""
    owner = "exp_rths" if kind == "budget" and not cause else kind
    part = f"_{cause}" if cause else ""
    found = source.metric(f"{owner}.rms_error{part}_m_s2" if column else f"{owner}.tracking_rms{part}_m_s2")
    return float("nan") if found is None else float(found[max(column - 1, 0)])


def timing(source: Source, width: str) -> Figure:
    """Draw duration and lateness of a real run's steps and lost samples over time, and the share of longer steps."""
    runs = source.runs(TABLE_RUNS)
    if source.virtual:
        raise NotDrawn("a run on a virtual table has no real time to keep")
    if source.result.attributes.get("rig_kind") == RECORDED:
        raise NotDrawn("a recording does not hold the durations of the steps")
    times = {run: _times(source, run) for run in runs}
    stacked = width == "one"
    figure = new_figure(source, width, 20.0 + (2 if stacked else 1) * len(runs) * 42.0)
    shape = (2 * len(runs), 1) if stacked else (len(runs), 2)
    axes = list(figure.subplots(*shape, squeeze=False, width_ratios=None if stacked else (1.6, 1.0)).ravel())
    titles = [text for run in runs for text in (RUNS[run].label, "steps that took longer")]
    points = points_of_lines([1.0 for found in times.values() for _ in found for _ in range(2)])[0]
    for i, run in enumerate(runs):
        _over_time(axes[2 * i], source, run, times[run], points)
        _exceedance(axes[2 * i + 1], source, times[run], points)
    for ax, title in zip(axes, lettered(titles), strict=True):
        ax.set_title(title)
    kinds = dict.fromkeys(kind for found in times.values() for kind in found)
    legend_below(figure, [*(TIMING_KINDS[kind] for kind in kinds), INTERVAL])
    return figure


def _times(source: Source, run: str) -> dict[str, Array]:
    """Return the durations (n,) in s that a run's file holds, by name; computing times are in every file."""
    found = {"compute_s": source.read(f"{run}/timing/compute_s")}
    for kind in ("late_s", "exchange_s"):
        values = _optional(source, f"{run}/timing/{kind}")
        if values is not None:
            found[kind] = values
    return found


def _optional(source: Source, name: str) -> Array | None:
    """Return a dataset that not every run in real time has; None if there is none."""
    try:
        return source.read(name)
    except InputError:
        return None


def _over_time(ax: Axes, source: Source, run: str, times: dict[str, Array], points: int) -> None:
    time = source.read(f"{run}/timing/time_s")
    for kind, values in times.items():
        where, thin = thinned(time, np.maximum(values, LEAST_S), points)
        ax.plot(where, MICRO * thin, **TIMING_KINDS[kind].line(dense=True))
    ax.axhline(MICRO / source.rate_hz, **INTERVAL.line())
    lost = _optional(source, f"{run}/timing/lost")
    if lost is not None and np.any(without_samples(lost)):
        at = time[without_samples(lost)]
        ax.plot(at, np.full(at.size, 0.97), "|", color=LOST.color, ms=5.0, transform=ax.get_xaxis_transform())
        ax.set_title(f"{at.size} steps without samples", loc="right", fontweight="normal", fontsize=6.5)
    ax.set(yscale="log", xlim=(float(time[0]), float(time[-1])), xlabel=SECONDS, ylabel="duration (µs)")


def _exceedance(ax: Axes, source: Source, times: dict[str, Array], points: int) -> None:
    for kind, values in times.items():
        longest, share = exceedance(values)
        thin = np.unique(np.geomspace(1, longest.size, points).astype(int)) - 1
        ax.plot(MICRO * np.maximum(longest[thin], LEAST_S), 100.0 * share[thin], **TIMING_KINDS[kind].line())
    ax.axvline(MICRO / source.rate_hz, **INTERVAL.line())
    ax.set(xscale="log", yscale="log", xlabel="duration (µs)", ylabel="share of steps (%)")


def exceedance(values: Array) -> tuple[Array, Array]:
    """Return durations (n,) in descending order, and the share (n,) of steps that took at least as long."""
    known = np.sort(values[np.isfinite(values)])[::-1]
    return known, np.arange(1, known.size + 1) / max(known.size, 1)
