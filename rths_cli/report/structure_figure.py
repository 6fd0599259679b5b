"""The figure of `rths structure`: the building with its cut, and its first mode shapes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.report.figure_file import write_figure_file
from rths_cli.report.figures.style import (
    BLUE,
    DPI,
    GREY,
    METADATA,
    MM_PER_INCH,
    VERMILLION,
    WIDTHS_MM,
    in_house_style,
    plain,
)
from rths_cli.report.numbers import significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rths_cli.experiment.structure_command import Inspected

MOST_MODES = 5  # drawn
HIGH_MM = 62.0
MARKED_FLOORS = 25  # up to which each floor has its marker and its tick
HALF_WIDTH = 0.5  # of the sketch
LONGEST_NAME = 18  # characters above the sketch


def write_figure(found: Inspected, path: Path) -> None:
    """Write the figure as .pdf, .svg or .png, by the suffix of `path`; the same building gives the same bytes.

    Raises InputError for another suffix, or if the file cannot be written.
    """
    write_figure_file(path, lambda form: _image(found, form))


def _image(found: Inspected, form: str) -> bytes:
    buffer = io.BytesIO()
    with in_house_style():
        metadata = {**METADATA[form], "Title": f"structure {found.name}"}
        figure = draw_structure(found)
        _settle(figure)
        figure.savefig(buffer, format=form, dpi=DPI, metadata=metadata)
    return buffer.getvalue()


def _settle(figure: Figure) -> None:
    """Fix the axes where the layout put them, to a millionth of the figure: its last bits differ from time to time."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for ax in figure.axes:
        ax.set_position(np.round(ax.get_position().bounds, 6).tolist())


def draw_structure(found: Inspected) -> Figure:
    """Draw a building of n storeys: a sketch with the cut, and beside it the first mode shapes over the height."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = min(len(found.floor_mass_kg), MOST_MODES)
    size = (WIDTHS_MM["two"] / MM_PER_INCH, HIGH_MM / MM_PER_INCH)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 1 + count, sharey=True, width_ratios=[1.3, *[1.0] * count])
    level = _levels(found)
    _sketch(axes[0], found, level)
    for mode, ax in enumerate(axes[1:]):
        _shape(ax, found, mode, level)
    return figure


def _levels(found: Inspected) -> Array:
    """Return the height (n + 1,) of ground and floors: in m where heights are known, else the floor's number."""
    heights = np.ones(len(found.floor_mass_kg)) if found.heights_m is None else found.heights_m
    return np.concatenate([[0.0], np.cumsum(heights)])


def _sketch(ax: Axes, found: Inspected, level: Array) -> None:
    """Draw floors and columns: the computed ones grey and dashed, those on the table blue, the cut between them."""
    p, n = found.numerical_storeys, len(level) - 1
    ax.plot([-0.9, 0.9], [0.0, 0.0], color="black", lw=1.2)
    for storey in range(1, n + 1):
        low, high = level[storey - 1], level[storey]
        color, dashes = (GREY, (0, (3.0, 1.5))) if storey <= p else (BLUE, "solid")
        for x in (-HALF_WIDTH, HALF_WIDTH):
            ax.plot([x, x], [low, high], color=color, ls=dashes, lw=0.8)
        ax.plot([-HALF_WIDTH, HALF_WIDTH], [high, high], color=color, lw=2.2 if n <= MARKED_FLOORS else 0.8)
    ax.plot([-0.9, 0.9], [level[p], level[p]], color=VERMILLION, ls=(0, (4.0, 2.0)), lw=0.9)
    for first, last, text, color in ((p + 1, n, "on the table", BLUE), (1, p, "computed", GREY)):
        storey = (first + last) // 2
        middle = 0.5 * (level[storey - 1] + level[storey])
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        ax.text(0.0, middle, text, ha="center", va="center", color=color, fontsize=6.5, bbox=box)
    ax.text(0.9, level[p], "cut", ha="right", va="bottom", color=VERMILLION, fontsize=6.5)
    ax.set_xlim(-1.0, 1.0)
    ax.set_ylim(-0.02 * level[n], 1.04 * level[n])
    ax.set_xticks([])
    ax.grid(False)
    if found.heights_m is None and n <= MARKED_FLOORS:
        ax.set_yticks(level)
    ax.set_ylabel("floor" if found.heights_m is None else "height (m)")
    long = len(found.name) > LONGEST_NAME
    ax.set_title(plain(found.name[: LONGEST_NAME - 3] + "..." if long else found.name))


def _shape(ax: Axes, found: Inspected, mode: int, level: Array) -> None:
    """Draw a mode shape over the height, with frequency and period."""
    shape = np.concatenate([[0.0], found.mode_shapes[:, mode]])
    hz = float(found.natural_frequency_hz[mode])
    ax.axvline(0.0, color=GREY, lw=0.6)
    ax.axhline(level[found.numerical_storeys], color=VERMILLION, ls=(0, (4.0, 2.0)), lw=0.6)
    ax.plot(shape, level, color=BLUE, marker="o" if len(level) <= MARKED_FLOORS else "", markersize=2.5)
    ax.set_xlim(-1.15, 1.15)
    ax.set_xticks([-1.0, 0.0, 1.0])
    ax.set_title(f"mode {mode + 1}, {significant(hz)} Hz")
    ax.set_xlabel(f"T = {significant(1.0 / hz)} s\nmodal mass {100.0 * found.effective_mass_ratio[mode]:.1f} %")
