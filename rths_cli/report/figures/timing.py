"""Figure of step timing: computing, lateness, exchange, lost samples; over time and as shares of the steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.loop.lost_samples import without_samples
from rths_cli.numerics.lti import Array
from rths_cli.report.figures.figure_data import TABLE_RUNS, NotDrawn, Source, points_of_lines, thinned
from rths_cli.report.figures.panels import SECONDS, legend_below, lettered, new_figure
from rths_cli.report.figures.style import BLUE, GREEN, ORANGE, RUNS, VERMILLION, Look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MICRO = 1e6
LEAST_S = 1e-8  # zero has no place on a logarithmic axis
KINDS = {
    "compute_s": Look("computing", BLUE, "solid", 0.7),
    "late_s": Look("late", ORANGE, (0, (5.0, 1.5)), 0.9),
    "exchange_s": Look("exchange", GREEN, (0, (1.5, 1.0)), 0.9),
}
INTERVAL = Look("sample interval", VERMILLION, (0, (4.0, 2.0)), 0.9)
LOST = Look("no samples", VERMILLION)


def timing(source: Source, width: str) -> Figure:
    """Draw duration and lateness of a real run's steps and lost samples over time, and the share of longer steps."""
    runs = source.runs(TABLE_RUNS)
    if source.virtual:
        raise NotDrawn("a run on a virtual table has no real time to keep")
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
    legend_below(figure, [*(KINDS[kind] for kind in kinds), INTERVAL])
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
        ax.plot(where, MICRO * thin, **KINDS[kind].line(dense=True))
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
        ax.plot(MICRO * np.maximum(longest[thin], LEAST_S), 100.0 * share[thin], **KINDS[kind].line())
    ax.axvline(MICRO / source.rate_hz, **INTERVAL.line())
    ax.set(xscale="log", yscale="log", xlabel="duration (µs)", ylabel="share of steps (%)")


def exceedance(values: Array) -> tuple[Array, Array]:
    """Return durations (n,) in descending order, and the share (n,) of steps that took at least as long."""
    known = np.sort(values[np.isfinite(values)])[::-1]
    return known, np.arange(1, known.size + 1) / max(known.size, 1)
