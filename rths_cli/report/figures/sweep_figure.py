"""The figure of a sweep: a metric over one varied key as a line with a band over the seeds, over two as a heat map."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.files.sweep_file import Sweep
from rths_cli.numerics.lti import Array
from rths_cli.quantities.units import ENDINGS, typeset, unit_of_name
from rths_cli.report.figures.figure_data import NotDrawn
from rths_cli.report.figures.panels import GREY_TEXT, HEADING_CHARACTERS, empty_figure
from rths_cli.report.figures.style import BLUE, VERMILLION, plain
from rths_cli.report.numbers import three
from rths_cli.report.sweep_metric import Gridded, as_text, gridded, named, short_key

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NUMBERED_CELLS = {"one": 30, "two": 120}  # of a heat map, up to which each shows its number
MOST_LABELS = {"one": 6, "two": 12}  # of a value on an axis
LONGEST_VALUE = 18  # characters of a text on an axis
LOG_STEP = 0.01  # relative; steps of equal ratio get a logarithmic axis


def sweep_figure(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw a metric of a sweep over its varied keys; raises NotDrawn for none or more than two of them."""
    found = gridded(sweep, metric)
    if not 1 <= len(found.keys) <= 2:
        raise NotDrawn(f"it varies {len(found.keys)} keys; a figure shows one or two")
    if not np.any(np.isfinite(found.values)):
        raise NotDrawn(f"no run has a finite {found.label}")
    figure = empty_figure(width, 65.0 if len(found.keys) == 1 else 75.0)
    ax = figure.subplots()
    draw = _line if len(found.keys) == 1 else _scatter if _sampled(found) else _map
    draw(figure, ax, found, width)
    seeds = sweep.seeds_per_point
    shown = f"{seeds} seeds, median and range" if draw is _line else f"median of {seeds} seeds"
    return heading_of(figure, sweep, width, headed, shown if seeds > 1 else "")


def heading_of(figure: Figure, sweep: Sweep, width: str, headed: bool, note: str = "") -> Figure:
    """Return the figure of a sweep, `headed` by its case and table and a note."""
    if headed:
        text = f"{sweep.attributes['case_name']}, EXP-RTHS; virtual shake table {sweep.attributes['rig']}"
        text += f"; {note}" if note else ""
        figure.suptitle(
            plain(textwrap.fill(text, HEADING_CHARACTERS[width])), x=0.01, ha="left", fontsize=6.5, color=GREY_TEXT
        )
    return figure


def _line(figure: Figure, ax: Axes, found: Gridded, width: str) -> None:
    """Draw the median over the seeds, the band from the smallest to the largest, and points with unfinished runs."""
    ((key, varied),) = found.keys.items()
    place, numeric = places_of(varied)
    order = np.argsort(place)
    low, middle, high = (over_seeds(found.values, share)[order] for share in (0.0, 50.0, 100.0))
    if found.values.shape[1] > 1:
        ax.fill_between(place[order], low, high, color=BLUE, alpha=0.25, lw=0.0, label="range of the seeds")
    label = "median of the seeds" if found.values.shape[1] > 1 else "each run"
    ax.plot(place[order], middle, color=BLUE, marker="o", ms=3.0, ls="solid" if numeric else "none", label=label)
    if found.unfinished.any():
        at = place[found.unfinished]
        ax.plot(at, np.full(at.size, 0.03), "x", color=VERMILLION, ms=4.0, transform=ax.get_xaxis_transform(),
                label="a run was refused, aborted or failed", clip_on=False)  # fmt: skip
        figure.legend(loc="outside lower center", ncols=2 if width == "one" else 3)
    elif found.values.shape[1] > 1:
        figure.legend(loc="outside lower center", ncols=2)
    if numeric and _geometric(np.unique(place)):
        ax.set_xscale("log")
    if not numeric:
        ax.set_xticks(place, [value_name(value) for value in varied])
        ax.margins(x=0.15)
    ax.set(xlabel=key_in_words(key, list(found.keys)), ylabel=two_lines(named(found)))


def _map(figure: Figure, ax: Axes, found: Gridded, width: str) -> None:
    """Draw the median over the seeds as a heat map: the first key along the vertical axis, the second along the other;
    grey where no run has a value."""
    (rows, columns) = [_distinct(values) for values in found.keys.values()]
    middle = over_seeds(found.values, 50.0)
    table = np.full((len(rows), len(columns)), np.nan)
    for first, second, value in zip(*found.keys.values(), middle, strict=True):
        table[rows.index(first), columns.index(second)] = value
    ax.grid(False)
    ax.set_facecolor("#DDDDDD")
    mesh = ax.imshow(np.ma.masked_invalid(table), origin="lower", aspect="auto", cmap="viridis")
    bar = figure.colorbar(mesh, ax=ax)
    bar.set_label(two_lines(named(found)))
    keys = list(found.keys)
    for values, place, text, name in (
        (columns, ax.set_xticks, ax.set_xlabel, keys[1]), (rows, ax.set_yticks, ax.set_ylabel, keys[0]),
    ):  # fmt: skip
        step = -(-len(values) // MOST_LABELS[width])
        place(range(0, len(values), step), [value_name(value) for value in values[::step]])
        text(key_in_words(name, keys), labelpad=6.0)
    if table.size <= NUMBERED_CELLS[width]:
        light = float(np.nanmin(table)) + 0.6 * float(np.nanmax(table) - np.nanmin(table))
        for (row, column), value in np.ndenumerate(table):
            color = "black" if not value < light else "white"
            shown = three(float(value)) if np.isfinite(value) else "none"
            ax.text(column, row, shown, ha="center", va="center", color=color, fontsize=6.0)


def _sampled(found: Gridded) -> bool:
    """Return whether two keys have numbers that fill no grid: a map of them would be empty nearly everywhere."""
    if not all(places_of(values)[1] for values in found.keys.values()):
        return False
    rows, columns = (len(set(values)) for values in found.keys.values())
    return 2 * len(found.values) < rows * columns


def _scatter(figure: Figure, ax: Axes, found: Gridded, width: str) -> None:
    """Draw a dot for each grid point, its colour the median over the seeds: the first key along the vertical axis, the
    second along the other; a cross where no run has a value."""
    (up, across), keys = (places_of(values)[0] for values in found.keys.values()), list(found.keys)
    middle = over_seeds(found.values, 50.0)
    known = np.isfinite(middle)
    dots = ax.scatter(across[known], up[known], c=middle[known], s=9.0, cmap="viridis")
    figure.colorbar(dots, ax=ax).set_label(two_lines(named(found)))
    ax.set(xlabel=key_in_words(keys[1], keys), ylabel=key_in_words(keys[0], keys))
    if not known.all():
        ax.plot(across[~known], up[~known], "x", color=VERMILLION, ms=4.0, label="no run has a value")
        figure.legend(loc="outside lower center", ncols=2 if width == "one" else 3)


def _distinct(values: Sequence[Any]) -> list[Any]:
    """Return the values of an axis once each: numbers ascending, others in their order."""
    found = list(dict.fromkeys(values))
    return sorted(found) if all(isinstance(value, int | float) for value in found) else found


def places_of(values: Sequence[Any]) -> tuple[Array, bool]:
    """Return where the values of a key lie on an axis, and whether they are numbers."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.asarray(values, dtype=float), True
    return np.arange(len(values), dtype=float), False


def _geometric(places: Array) -> bool:
    """Return whether positive places have equal ratios rather than equal steps."""
    if places.size < 3 or places[0] <= 0.0:
        return False
    steps, ratios = np.diff(places), np.diff(np.log(places))
    return bool(np.ptp(ratios) < LOG_STEP * ratios.max() and np.ptp(steps) > LOG_STEP * steps.max())


def over_seeds(values: Array, share: float) -> Array:
    """Return a quantile in percent over the seeds of each grid point (n_points,); NaN where no run has a value."""
    found = np.full(len(values), np.nan)
    known = np.isfinite(values).any(axis=1)
    found[known] = np.nanpercentile(values[known], share, axis=1)
    return found


def key_in_words(key: str, keys: Sequence[str]) -> str:
    """Return a varied key in words, its unit in brackets alone."""
    unit, name = unit_of_name(key, ""), short_key(key, keys)
    ending = next((ending for ending, _ in ENDINGS if name.endswith(ending)), "")
    return (f"{name.removesuffix(ending)} ({typeset(unit)})" if unit else name).replace("_", " ")


def value_name(value: Any) -> str:
    """Return a varied value as a figure names it: a number with four digits, a file by its name alone, a long text cut
    off."""
    if isinstance(value, float):
        return f"{value:.4g}"
    text = as_text(value)
    name = Path(text).stem if "/" in text and not text.startswith(("{", "[")) else text
    return name if len(name) <= LONGEST_VALUE else f"{name[: LONGEST_VALUE - 1]}…"


def two_lines(text: str) -> str:
    """Return a long name of an axis in two lines."""
    head, comma, rest = text.partition(", ")
    return f"{head},\n{rest}" if comma else text
