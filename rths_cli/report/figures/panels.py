"""Drawing helpers that several figures share: panels with zoom, rows of marks, headings, legends."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.quantities import DATASETS
from rths_cli.quantities.declaration import typeset
from rths_cli.report.figures.figure_data import Source, points_of_lines, thinned
from rths_cli.report.figures.style import MM_PER_INCH, VERMILLION, WIDTHS_MM, Look, plain
from rths_cli.report.result_scale import scale_words
from rths_cli.report.stored_findings import without_run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


@dataclass(frozen=True)
class Mark:
    """The appearance of one kind of value."""

    label: str  # in the legend
    color: str
    shape: str = "o"
    size: float = 3.0  # points
    filled: bool = True


def dot_rows(ax: Axes, labels: Sequence[str], marks: Sequence[tuple[Mark, Array]]) -> None:
    """Draw values (n,) over n labels, the first label at the top; NaN has no mark."""
    places = np.arange(len(labels))
    for mark, values in marks:
        (line,) = ax.plot(values, places, label=mark.label)
        dress(line, mark)
    ax.set_yticks(places, labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)


def dots_legend(figure: Figure, marks: Sequence[Mark]) -> None:
    """Draw one legend for the marks below the axes."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], label=mark.label) for mark in marks]
    for handle, mark in zip(handles, marks, strict=True):
        dress(handle, mark)
    figure.legend(handles=handles, loc="outside lower center", ncols=2 if figure.get_figwidth() < 4.0 else 4)


def dress(line: Line2D, mark: Mark) -> None:
    """Give a line the appearance of marks."""
    line.set(color=mark.color, linestyle="none", marker=mark.shape, markersize=mark.size)
    line.set_markerfacecolor(mark.color if mark.filled else "none")


HEADING_CHARACTERS = {"one": 60, "two": 128}
HEADING_LINES = 4
TALLEST_MM = 235.0  # the type area of a journal's page
AROUND_MM = 19.0  # heading, legend, label of the time axis
HIGH_MM = {"one": 29.0, "two": 36.0}
PAIR_MM = 45.0  # a history and its error below
GREY_TEXT = "#444444"
SECONDS = "time (s)"
ACCELERATION_UNITS = typeset(DATASETS["exp_rths/abs_accel_m_s2"].units)
ACCELERATION = f"acceleration ({ACCELERATION_UNITS})"
MM_PER_M = 1e3
ERROR_UNITS = f"m{ACCELERATION_UNITS}"  # errors are a thousandth of the motion


@dataclass(frozen=True)
class Line:
    """One line of a panel."""

    look: Look
    time_s: Array  # (n,)
    values: Array  # (n,)


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    `note`: text on the right, beside the title on the left. `close`: samples that are shown of every line; None: whole
    lines. `reach`: largest value that must be visible; None: that of all lines.
    """

    title: str
    ylabel: str
    lines: tuple[Line, ...]
    close: slice | None = None
    note: str = ""
    reach: float | None = None


def empty_figure(width: str, height_mm: float) -> Figure:
    """Return an empty figure of a journal's width."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = (WIDTHS_MM[width] / MM_PER_INCH, min(height_mm, TALLEST_MM) / MM_PER_INCH)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_figure(source: Source, width: str, height_mm: float, about: str = "") -> Figure:
    """Return an empty figure of a journal's width, with a heading that states case, table and end of the run, unless
    the source goes without."""
    figure = empty_figure(width, height_mm)
    if source.headed:
        text, color = "\n".join(heading(source, width, about)), GREY_TEXT if source.complete else VERMILLION
        figure.suptitle(plain(text), x=0.01, ha="left", fontsize=6.5, color=color)
    return figure


def heading(source: Source, width: str, about: str = "") -> list[str]:
    """Return the lines above a figure: case, method, table (virtual or not), and why a run ended early."""
    known = source.result.attributes
    table = f"{'virtual ' if source.virtual else ''}shake table {known.get('rig', '')}".rstrip()
    case = f"{known.get('case_name', source.result.path.stem)}, method {known.get('method', 'unknown')}"
    lines = ["; ".join(filter(None, (case, table, scale_words(source.result), about)))]
    if not source.complete:
        reason = without_run(source.result, str(known.get("status_reason", "")))
        lines.append(f"{known.get('status', 'unfinished')}: {reason}".rstrip(": "))
    long = HEADING_CHARACTERS[width]
    first, *rest = lines
    wrapped = textwrap.wrap(first, long)
    for line in rest:
        wrapped += textwrap.wrap(line, long, max_lines=max(HEADING_LINES - len(wrapped), 1), placeholder=" ...")
    return wrapped


def lettered(titles: Iterable[str]) -> Iterator[str]:
    """Yield titles with (a), (b), ... before them."""
    for number, title in enumerate(titles):
        yield f"({ascii_lowercase[number % 26]}) {title}"


def draw_rows(
    source: Source,
    rows: Sequence[Sequence[Panel]],
    width: str,
    ratios: Sequence[float] = (2.2, 1.0),
    about: str = "",
    legend: bool = True,
    left_out: str = "",
) -> Figure:
    """Draw panels in rows of two, or below each other in a single column; `about` is added to the heading, and what is
    `left_out` to the legend."""
    panels = [panel for row in rows for panel in row]
    stacked = width == "one" or len(panels) == 1
    count = len(panels) if stacked else len(rows)
    figure = new_figure(source, width, AROUND_MM + count * HIGH_MM[width], about)
    grid = figure.add_gridspec(count, 1 if stacked else 2, width_ratios=None if stacked else ratios)
    places = (
        [(i, 0) for i in range(count)] if stacked else [(i, k) for i, row in enumerate(rows) for k in range(len(row))]
    )
    wide = [1.0 if stacked else ratios[column] for _, column in places]
    points = iter(points_of_lines([wide[i] for i, panel in enumerate(panels) for _ in panel.lines]))
    for panel, title, (row, column) in zip(panels, lettered(p.title for p in panels), places, strict=True):
        ax = figure.add_subplot(grid[row, column])
        _draw_panel(ax, panel, title if len(panels) > 1 else panel.title, points)
        if row == count - 1:
            ax.set_xlabel(SECONDS)
    figure.align_ylabels()
    if legend:
        legend_below(figure, [*(line.look for panel in panels for line in panel.lines), Look(left_out, "none")])
    return figure


def draw_pairs(
    source: Source, storeys: Sequence[Sequence[tuple[Panel, Panel]]], width: str, about: str = "",
    ratios: Sequence[float] = (2.2, 1.0),
) -> Figure:  # fmt: skip
    """Draw pairs of panels with one time axis, the second one lower and below the first: a row of pairs per storey."""
    from matplotlib.ticker import MaxNLocator

    rows, columns = len(storeys), len(storeys[0])
    figure = new_figure(source, width, AROUND_MM + rows * PAIR_MM, about)
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[1.5, 1.0] * rows, width_ratios=ratios[:columns])
    pairs = [(row, column, pair) for row, found in enumerate(storeys) for column, pair in enumerate(found)]
    wide = [ratios[column] for _, column, pair in pairs for panel in pair for _ in panel.lines]
    points = iter(points_of_lines(wide))
    titles = lettered(upper.title for _, _, (upper, _) in pairs)
    for (row, column, (upper, lower)), title in zip(pairs, titles, strict=True):
        above = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw_panel(above, upper, title, points)
        _draw_panel(below, lower, "", points)
        for ax in (above, below):
            ax.set_ylabel(ax.get_ylabel().replace(" (", "\n("))
        above.tick_params(labelbottom=False)
        below.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
        if row == rows - 1:
            below.set_xlabel(SECONDS)
    figure.align_ylabels()
    legend_below(figure, [line.look for _, _, (upper, _) in pairs for line in upper.lines])
    return figure


def trimmed_ticks(ax: Axes, log: bool = False) -> None:
    """Give the horizontal axis of a narrow panel few labels, so that they do not touch."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    if not log:
        ax.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
        return
    ax.xaxis.set_major_locator(LogLocator(numticks=3))
    ax.xaxis.set_minor_formatter(NullFormatter())


def legend_below(figure: Figure, looks: Sequence[Look]) -> None:
    """Draw one legend for all lines below the axes, with each look once."""
    from matplotlib.lines import Line2D

    each = list({look.label: look for look in looks if look.label}.values())
    handles = [Line2D([], [], label=plain(look.label), **look.line()) for look in each]
    narrow = figure.get_figwidth() * MM_PER_INCH < 100.0
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(each), 2 if narrow else 4))


def _draw_panel(ax: Axes, panel: Panel, title: str, points: Iterator[int]) -> None:
    dense = panel.close is None
    for line in panel.lines:
        part = slice(None) if panel.close is None else panel.close
        ax.plot(*thinned(line.time_s[part], line.values[part], next(points)), **line.look.line(dense))
    ax.set_title(title)
    if panel.note:
        ax.set_title(panel.note, loc="right", fontweight="normal", fontsize=6.5)
    ax.set_ylabel(panel.ylabel)
    ax.set_xlim(_first_and_last(panel))
    if panel.reach:
        ax.set_ylim(-1.08 * panel.reach, 1.08 * panel.reach)


def _first_and_last(panel: Panel) -> tuple[float, float]:
    times = [line.time_s[panel.close or slice(None)] for line in panel.lines]
    return min(float(time[0]) for time in times), max(float(time[-1]) for time in times)


def largest(*series: Array) -> float:
    """Return the largest absolute finite value of several series."""
    return max((float(np.abs(values[np.isfinite(values)]).max(initial=0.0)) for values in series), default=0.0)
