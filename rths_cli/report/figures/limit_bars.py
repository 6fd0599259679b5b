"""Figure of limits: peaks against the guard's limits, and the loop's margins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.quantities import METRICS
from rths_cli.quantities.units import typeset
from rths_cli.report.figures.figure_data import MEASURED, NotDrawn, Source
from rths_cli.report.figures.panels import Mark, dot_rows, dots_legend, lettered, new_figure
from rths_cli.report.figures.style import BLACK, ORANGE, RUNS, VERMILLION

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
