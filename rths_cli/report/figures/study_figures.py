"""Figures of a study: tornado, parallel coordinates, Sobol indices, and the boundary of stability over two keys.

The figure of a sweep: a metric over one varied key as a line with a band over the seeds, over two as a heat map.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Sweep
from rths_cli.numerics.lti import Array
from rths_cli.quantities.declaration import ENDINGS, typeset, unit_of_name
from rths_cli.report.figures.figure_data import NotDrawn
from rths_cli.report.figures.panels import GREY_TEXT, HEADING_CHARACTERS, empty_figure
from rths_cli.report.figures.style import BLACK, BLUE, GREY, ORANGE, VERMILLION, WIDTHS_MM, plain
from rths_cli.report.numbers import three
from rths_cli.report.sweep_page import Gridded, as_text, gridded, indexed_keys, indices_of, named, short_key

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NUMBERED_CELLS = {"one": 30, "two": 120}  # of a heat map, up to which each shows its number
MOST_LABELS = {"one": 6, "two": 12}  # of a value on an axis
LONGEST_VALUE = 18  # characters of a text on an axis
LOG_STEP = 0.01  # relative; steps of equal ratio get a logarithmic axis

RADIUS = "check.spectral_radius"
FEW_VALUES = 8  # of a key, up to which each value is a group of its own
SHARE = 0.2  # of the grid points at either end of a key with more values
MOST_LINES = 1000  # of parallel coordinates
ROW_MM, AROUND_MM = 9.0, 24.0
BAR = 0.6
LABEL_CHARACTERS = {"one": 16, "two": 40}
PLOT_CHARACTERS = {"one": 54, "two": 120}  # of a value's label, across the axes of a tornado
VALUE_CHARACTER_POINTS = 3.3  # of a value at a parallel axis
NAME_CHARACTER_MM, LEAST_CHARACTERS = 1.5, 8  # of the name of a parallel axis; with less room it is written upwards


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


def heading_of(
    figure: Figure, sweep: Sweep, width: str, headed: bool, note: str = "", runs: str = "EXP-RTHS"
) -> Figure:
    """Return the figure of a sweep, `headed` by its case, runs, table and a note."""
    if headed:
        text = f"{sweep.attributes['case_name']}, {runs}; virtual shake table {sweep.attributes['rig']}"
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
    """Return a varied value as a figure names it: a number with four digits, a file by its name alone, a mapping by its
    kind and its other keys, a long text cut off."""
    if isinstance(value, float):
        return f"{value:.4g}"
    text = as_text(value)
    if text.startswith("{"):
        text = re.sub(r"\b(kind|file|name|extends): ", "", re.sub("[{}]", "", text)).replace(": ", " ")
    name = Path(text).stem if "/" in text and not text.startswith(("{", "[")) else text
    return name if len(name) <= LONGEST_VALUE else f"{name[: LONGEST_VALUE - 1]}…"


def two_lines(text: str) -> str:
    """Return a long name of an axis in two lines."""
    head, comma, rest = text.partition(", ")
    return f"{head},\n{rest}" if comma else text


def tornado(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw how far the median of a metric moves when one key goes from its smallest to its largest values.

    A key with up to 8 values has a group of grid points for each, one with more has the lowest and the highest fifth.
    A bar spans the medians of the groups; keys are in the order of their bars. Raises NotDrawn for fewer than two keys.
    """
    found = _checked(sweep, metric, fewest=2, what="a tornado")
    middle = over_seeds(found.values, 50.0)
    known = np.isfinite(middle)
    groups = {key: _groups(values, known) for key, values in found.keys.items()}
    spans = {
        key: [(label, float(np.median(middle[where]))) for label, where in each] for key, each in groups.items() if each
    }
    order = sorted(spans, key=lambda key: _span(spans[key]))
    figure = empty_figure(width, AROUND_MM + ROW_MM * len(order))
    ax = figure.subplots()
    for row, key in enumerate(order):
        values = [value for _, value in spans[key]]
        numeric = places_of(found.keys[key])[1]
        low, high = (0, -1) if numeric else (int(np.argmin(values)), int(np.argmax(values)))
        ends = spans[key][low], spans[key][high]
        ax.barh(row, max(values) - min(values), left=min(values), height=BAR, color="#DDDDDD")
        for (label, value), color in zip(ends, (BLUE, VERMILLION) if numeric else (GREY, GREY), strict=True):
            ax.plot(value, row, "o", color=color, ms=4.0)
            other = ends[1][1] if value == ends[0][1] else ends[0][1]
            right = value >= other if label == ends[1][0] else value > other
            ax.annotate(
                plain(label), (value, row), (5 if right else -5, 0), textcoords="offset points", va="center",
                ha="left" if right else "right", fontsize=5.5,
            )  # fmt: skip
    ax.axvline(float(np.median(middle[known])), color=BLACK, lw=0.8)
    keys = list(found.keys)
    ax.set_yticks(range(len(order)), [_wrapped(key_in_words(key, keys), width) for key in order])
    ax.set_ylim(-0.6, len(order) - 0.4)
    ax.use_sticky_edges = False
    longest = max(len(label) for each in spans.values() for label, _ in each)
    beside = min((longest + 3) / PLOT_CHARACTERS[width], 0.35)  # of the axes' width, for the label at either end
    ax.margins(x=beside / (1.0 - 2.0 * beside))
    ax.grid(False, axis="y")
    ax.set_xlabel(f"median {named(found)}")
    _dots(figure, [("at the small values", BLUE), ("at the large values", VERMILLION), ("texts", GREY)], found.keys)
    return heading_of(figure, sweep, width, headed, "black line: median of all")


def _groups(values: Sequence[Any], known: NDArray[np.bool_]) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return labels and grid points (n_points,) of the groups of a key, numbers ascending; those without value left
    out."""
    place, numeric = places_of(values)
    texts = np.array([as_text(value) for value in values], dtype=object)
    distinct = np.unique(place) if numeric else np.array(list(dict.fromkeys(texts)), dtype=object)
    if len(distinct) <= FEW_VALUES:
        each = place if numeric else texts
        groups = [(value_name(float(one) if numeric else str(one)), each == one) for one in distinct]
    else:
        low, high = np.quantile(place[known], [SHARE, 1.0 - SHARE])
        groups = [(f"≤ {low:.3g}", place <= low), (f"≥ {high:.3g}", place >= high)]
    return [(label, where & known) for label, where in groups if np.any(where & known)]


def _span(groups: Sequence[tuple[str, float]]) -> float:
    values = [value for _, value in groups]
    return max(values) - min(values)


def parallel(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw every grid point as a line across its varied keys to its metric, coloured by its height there.

    Grid points with an unfinished run are grey and end before the metric. Of more than 1,000 grid points as
    many, evenly spread, are drawn. Raises NotDrawn for fewer than two keys.
    """
    found = _checked(sweep, metric, fewest=2, what="parallel coordinates")
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    keys = list(found.keys)
    middle = over_seeds(found.values, 50.0)
    shown = np.unique(np.linspace(0, len(middle) - 1, min(len(middle), MOST_LINES)).astype(int))
    columns = [_scaled(found.keys[key]) for key in keys]
    known = np.isfinite(middle)
    low, high = float(middle[known].min()), float(middle[known].max())
    last = (middle - low) / (high - low) if high > low else np.full(len(middle), 0.5)
    heights = np.stack([*(column for column, _ in columns), last], axis=1)[shown]
    names = [*(key_in_words(key, keys) for key in keys), named(found)]
    room = int(WIDTHS_MM[width] / len(names) / NAME_CHARACTER_MM)
    upright = room < LEAST_CHARACTERS
    turned = 90.0 if upright else 0.0
    figure = empty_figure(width, 95.0 if upright else 80.0)
    ax = figure.subplots()
    across = np.arange(len(keys) + 1)
    whole = known[shown]
    unknown = [np.stack([across[:-1], row[:-1]], axis=1) for row in heights[~whole]]
    ax.add_collection(LineCollection(unknown, colors="#BBBBBB", linewidths=0.6))
    order = np.argsort(middle[shown][whole])  # the largest on top
    lines = [np.stack([across, row], axis=1) for row in heights[whole][order]]
    colors = colormaps["viridis"](Normalize(low, high)(middle[shown][whole][order]))
    ax.add_collection(LineCollection(lines, colors=colors, linewidths=0.7, alpha=0.8))
    axes = [*columns, (last, ((0.0, three(low)), (1.0, three(high))))]
    below = max((len(text) for _, ticks in axes for height, text in ticks if height == 0.0), default=0)
    for place, (_, ticks) in enumerate(axes):
        ax.axvline(place, color=BLACK, lw=0.6)
        for height, text in ticks:
            side = {0.0: (0, -3, "top"), 1.0: (0, 3, "bottom")}.get(height, (0, 0, "center"))
            ax.annotate(
                plain(text), (place, height), side[:2], textcoords="offset points", va=side[2], ha="center",
                rotation=turned, fontsize=5.5, bbox={"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 0.6},
            )  # fmt: skip
    written = [plain(_broken(name, 26 if upright else room)) for name in names]
    ax.set_xticks(across, written, rotation=turned, fontsize=6.0)
    ax.set_yticks([])
    ax.grid(False)
    for edge in ("left", "right", "top", "bottom"):
        ax.spines[edge].set_visible(False)
    ax.tick_params(axis="x", length=0, pad=VALUE_CHARACTER_POINTS * below if upright else 3.0)
    ax.set(xlim=(-0.4, len(keys) + 0.4), ylim=(-0.08, 1.08))
    told = ["colour: height on the last axis"]
    told += [f"{len(shown)} of {len(middle)} grid points"] if len(shown) < len(middle) else []
    told += ["grey: a run was refused, aborted or failed"] if not whole.all() else []
    return heading_of(figure, sweep, width, headed, "; ".join(told))


def _scaled(values: Sequence[Any]) -> tuple[Array, tuple[tuple[float, str], ...]]:
    """Return the heights (n_points,) of a key from 0 to 1, and its ticks: both ends of numbers, every text."""
    place, numeric = places_of(values)
    if numeric:
        low, high = float(place.min()), float(place.max())
        height = (place - low) / (high - low) if high > low else np.full(len(place), 0.5)
        return height, ((0.0, f"{low:.3g}"), (1.0, f"{high:.3g}")) if high > low else ((0.5, f"{low:.3g}"),)
    texts = list(dict.fromkeys(as_text(value) for value in values))
    each = {text: (k / (len(texts) - 1) if len(texts) > 1 else 0.5) for k, text in enumerate(texts)}
    return np.array([each[as_text(value)] for value in values]), tuple(
        (height, value_name(text)) for text, height in each.items()
    )


def sobol(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw first-order and total Sobol indices of a metric with their standard errors.

    Raises NotDrawn for a study that was not sampled for them, or with a run that has no metric.
    """
    keys = indexed_keys(sweep)
    if not keys:
        raise NotDrawn("no study with samples.method: sobol_indices")
    try:
        found, indices = indices_of(sweep, metric)
    except InputError as error:
        raise NotDrawn(str(error)) from error
    order = np.argsort(indices.total)
    figure = empty_figure(width, AROUND_MM + ROW_MM * len(keys))
    ax = figure.subplots()
    for values, errors, color, place, label in (
        (indices.first, indices.first_error, BLUE, 0.15, "first order: this key alone"),
        (indices.total, indices.total_error, ORANGE, -0.15, "total: with all its interactions"),
    ):
        ax.errorbar(values[order], np.arange(len(keys)) + place, xerr=errors[order], fmt="o", color=color, ms=3.5,
                    elinewidth=1.0, capsize=2.0, label=label)  # fmt: skip
    ax.axvline(0.0, color=BLACK, lw=0.6)
    ax.set_yticks(range(len(keys)), [_wrapped(key_in_words(keys[k], keys), width) for k in order])
    ax.set_ylim(-0.6, len(keys) - 0.4)
    ax.set_xlabel(_indexed(found, sweep))
    figure.legend(loc="outside lower center", ncols=1 if width == "one" else 2)
    return heading_of(figure, sweep, width, headed, "bars: one standard error")


def _indexed(found: Gridded, sweep: Sweep) -> str:
    seeds = f",\nmean of {sweep.seeds_per_point} seeds" if sweep.seeds_per_point > 1 else ""
    return f"Sobol index of {found.label}{seeds}"


def stability(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw where the check forecasts a stable loop over two keys with numbers, and how the runs there ended.

    The boundary is the line of spectral radius 1 between the grid points. `metric` is not used. Raises NotDrawn for
    other keys, and where no boundary runs between the grid points.
    """
    if not has_boundary(sweep):
        raise NotDrawn("no boundary of stability runs between grid points over two keys with numbers")
    keys, across, up, radius = _plane(sweep)
    known = np.isfinite(radius)
    figure = empty_figure(width, 82.0)
    ax = figure.subplots()
    ax.set(xlim=_beyond(across), ylim=_beyond(up))
    ax.tricontourf(across[known], up[known], radius[known], levels=[1.0, np.inf], colors=["#F3D9C8"], extend="neither")
    ax.tricontour(across[known], up[known], radius[known], levels=[1.0], colors=[BLACK], linewidths=1.2)
    for label, marker, color, filled, where in _ended(sweep):
        ax.plot(across[where], up[where], marker, color=color, ms=3.5, ls="none", label=label,
                markerfacecolor=color if filled else "none")  # fmt: skip
    ax.set(xlabel=key_in_words(keys[1], keys), ylabel=key_in_words(keys[0], keys))
    ax.plot([], [], color=BLACK, lw=1.2, label="boundary by the check")
    figure.legend(loc="outside lower center", ncols=1 if width == "one" else 2)
    return heading_of(figure, sweep, width, headed, "shaded: the check forecasts an unstable loop")


def has_boundary(sweep: Sweep) -> bool:
    """Return whether two keys with numbers are varied, and the check forecasts both stable and unstable loops."""
    numeric = [places_of(list(values))[1] for values in sweep.varied.values()]
    if RADIUS not in sweep.figures or numeric != [True, True]:
        return False
    _, across, up, radius = _plane(sweep)
    known = np.isfinite(radius)
    spread = [len(np.unique(values[known])) > 1 for values in (across, up)]
    return bool(known.sum() > 3 and all(spread) and radius[known].min() < 1.0 <= radius[known].max())


def _plane(sweep: Sweep) -> tuple[list[str], Array, Array, Array]:
    """Return two keys, the values (n_points,) of the second and of the first, and the forecast spectral radius."""
    size, keys = sweep.seeds_per_point, list(sweep.varied)
    across, up = (places_of(list(sweep.varied[key]))[0][::size] for key in (keys[1], keys[0]))
    return keys, across, up, sweep.figures[RADIUS].values[::size]


def _ended(sweep: Sweep) -> list[tuple[str, str, str, bool, NDArray[np.bool_]]]:
    """Return label, marker, colour, whether it is filled, and grid points (n_points,), by a run's worst end."""
    size = sweep.seeds_per_point
    statuses = np.array(sweep.texts["status"]).reshape(-1, size)
    refused = (statuses == "refused").all(axis=1)
    stopped = ((statuses != "complete") & (statuses != "refused")).any(axis=1)
    kinds = (
        ("simulated: reached the end", "o", BLUE, True, ~refused & ~stopped),
        ("simulated: stopped by a limit", "x", VERMILLION, True, stopped),
        ("refused by the check, not simulated", "s", GREY, False, refused & ~stopped),
    )
    return [kind for kind in kinds if kind[-1].any()]


def _beyond(values: Array) -> tuple[float, float]:
    """Return the ends of an axis a little beyond its values."""
    low, high = float(values.min()), float(values.max())
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _checked(sweep: Sweep, metric: str, fewest: int, what: str) -> Gridded:
    """Return a metric by grid point; raises NotDrawn for too few keys or no value."""
    found = gridded(sweep, metric)
    if len(found.keys) < fewest:
        raise NotDrawn(f"{what} needs {fewest} varied keys or more")
    if not np.any(np.isfinite(found.values)):
        raise NotDrawn(f"no run has a finite {found.label}")
    return found


def _dots(figure: Figure, kinds: Sequence[tuple[str, str]], keys: dict[str, list[Any]]) -> None:
    """Draw the legend of the dots that occur: of numbers, of texts."""
    from matplotlib.lines import Line2D

    numbers = [places_of(values)[1] for values in keys.values()]
    shown = [*(kinds[:2] if any(numbers) else ()), *(kinds[2:] if not all(numbers) else ())]
    handles = [Line2D([], [], marker="o", ls="none", ms=4.0, color=color, label=label) for label, color in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.2)


def _broken(text: str, room: int) -> str:
    """Return a long name in lines of about `room` characters, words apart."""
    return "\n".join(textwrap.wrap(text.replace("_", " "), room, break_long_words=True))


def _wrapped(text: str, width: str) -> str:
    """Return a long name in several lines."""
    return plain(_broken(text, LABEL_CHARACTERS[width]))
