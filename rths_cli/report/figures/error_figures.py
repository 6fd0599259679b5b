"""Figures of errors: error budget by cause, peaks and errors by storey."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.report.error_budget_table import CAUSES
from rths_cli.report.figures.figure_data import ACCEL, NotDrawn, Source, chosen_storeys, interface_storey
from rths_cli.report.figures.panels import (
    ACCELERATION,
    ACCELERATION_UNITS,
    Mark,
    dot_rows,
    dots_legend,
    legend_below,
    lettered,
    new_figure,
)
from rths_cli.report.figures.style import BLUE, GREY, ORANGE, RUNS, Look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KINDS = {
    "check": Mark("predicted before the run", ORANGE, "D", 5.0, filled=False),
    "budget": Mark("measured", BLUE),
}
MM_PER_M = 1e3
TOGETHER = "together"
SHAPES = {"sim": "s", "sim_delay": "^", "exp_rths": "o"}
PROFILES = {RUNS[run].label for run in SHAPES}
INTERFACE = Look("interface", GREY, (0, (4.0, 2.0)), 0.7)


def error_budget(source: Source, width: str) -> Figure:
    """Draw RMS errors by cause, predicted and measured: of tracking and of storeys to SIM, test band."""
    kinds = [kind for kind in KINDS if source.metric(f"{kind}.rms_error_coupling_m_s2") is not None]
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
        dot_rows(ax, labels, [(KINDS[kind], _errors_mm(source, kind, causes, column)) for kind in kinds])
        ax.set(title=title, xscale="log", xlabel="RMS error (mm/s²)")
    for ax in axes[len(columns) :]:
        ax.set_visible(False)
    dots_legend(figure, [KINDS[kind] for kind in kinds])
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


def storeys(source: Source, width: str) -> Figure:
    """Draw by storey the largest absolute acceleration of each run, and the RMS error to SIM in the test band."""
    runs = source.runs(tuple(SHAPES))
    count = len(source.read(f"{runs[0]}/{ACCEL}"))
    figure = new_figure(source, width, min(55.0 + 2.0 * count, 110.0))
    peaks, errors = figure.subplots(1, 2, sharey=True)
    for run in runs:
        _profile(peaks, run, np.nanmax(np.abs(source.read(f"{run}/{ACCEL}")), axis=1))
        found = source.metric(f"{run}.rms_error_m_s2")
        if found is not None:
            _profile(errors, run, np.where(np.isfinite(found), found, np.nan))
    for ax, title in zip((peaks, errors), lettered(("peaks", "errors, test band")), strict=True):
        _storey_axis(ax, count, interface_storey(source))
        ax.set_title(title)
    peaks.set(xlabel=ACCELERATION, ylabel="storey")
    errors.set(xlabel=f"RMS error ({ACCELERATION_UNITS})")
    _wide_axis(peaks)
    _wide_axis(errors)
    legend_below(figure, [*(RUNS[run] for run in runs), *([INTERFACE] if interface_storey(source) else [])])
    return figure


def _profile(ax: Axes, run: str, values: Array) -> None:
    places = np.arange(1, values.size + 1)
    ax.plot(values, places, marker=SHAPES[run], ms=2.5, mfc="white", label=RUNS[run].label, **RUNS[run].line())


def _storey_axis(ax: Axes, count: int, interface: int) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.set_ylim(0.5, count + 0.5)
    ax.yaxis.set_major_locator(MaxNLocator(10, integer=True))
    if interface:
        ax.axhline(interface, color=INTERFACE.color, ls=INTERFACE.dashes, lw=INTERFACE.width)


def _wide_axis(ax: Axes) -> None:
    """Make the axis logarithmic if values differ by more than a factor of ten, else start it at zero."""
    from matplotlib.ticker import NullFormatter

    drawn = [np.asarray(line.get_xdata(), dtype=float) for line in ax.lines if line.get_label() in PROFILES]
    values = np.concatenate([np.zeros(0), *drawn])
    values = values[np.isfinite(values) & (values > 0.0)]
    if values.size and values.max() > 10.0 * values.min():
        ax.set_xscale("log")
        ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        ax.set_xlim(left=0.0)
