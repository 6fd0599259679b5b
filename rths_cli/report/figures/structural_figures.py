"""Figures of the building's response: profiles over the height, hysteresis of the storeys, histories against SIM.

The figure of `rths structure`: the building with its cut, and its first mode shapes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.structural_response import inter_storey_drift_m, storey_shear_n
from rths_cli.errors import InputError
from rths_cli.files.stored_case import floor_masses_kg, storey_heights_m
from rths_cli.numerics.lti import Array
from rths_cli.report.figures.figure_data import (
    ACCEL,
    NotDrawn,
    Source,
    chosen_storeys,
    interface_storey,
    peaks,
    reached_the_end,
    window_at,
    without_diverged,
)
from rths_cli.report.figures.histories import CLOSE, close_look, error_panel, rms_note, role_of
from rths_cli.report.figures.panels import (
    ACCELERATION,
    ACCELERATION_UNITS,
    ERROR_UNITS,
    MM_PER_M,
    Line,
    Panel,
    draw_pairs,
    largest,
    legend_below,
    lettered,
    new_figure,
    trimmed_ticks,
)
from rths_cli.report.figures.style import (
    BLUE,
    DPI,
    GREY,
    METADATA,
    MM_PER_INCH,
    RUNS,
    VERMILLION,
    WIDTHS_MM,
    Look,
    in_house_style,
    plain,
    write_figure_file,
)
from rths_cli.report.numbers import significant
from rths_cli.report.result_scale import units_factor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rths_cli.laboratory.describe import Inspected

BUILDINGS = ("sim", "sim_delay", "exp_rths")
SHAPES = {"sim": "s", "sim_delay": "^", "exp_rths": "o"}
INTERFACE = Look("interface", GREY, (0, (4.0, 2.0)), 0.7)
MARKED_FLOORS = 25  # up to which each floor has its marker
RESTORING = "restoring_force_n"
DRIFT, SHEAR, DISPLACEMENT = "inter_storey_drift_m", "storey_shear_n", "rel_disp_m"
LOOPS_S = 6.0  # of the hysteresis: around the largest drift
POINTS_PER_LOOP = 12000  # corners stay sharp; a figure leaves out what lies on a line

MOST_MODES = 5  # drawn
HIGH_MM = 62.0
HALF_WIDTH = 0.5  # of the sketch
LONGEST_NAME = 18  # characters above the sketch


def drifts_m(source: Source, run: str) -> Array | None:
    """Return the inter-storey drifts (n_storeys, n) of a run in m, computed where the file holds displacements alone;
    None without both."""
    if source.holds(f"{run}/{DRIFT}"):
        return source.read(f"{run}/{DRIFT}")
    return inter_storey_drift_m(source.read(f"{run}/{DISPLACEMENT}")) if source.holds(f"{run}/{DISPLACEMENT}") else None


def shears_n(source: Source, run: str) -> Array | None:
    """Return the storey shears (n_storeys, n) of a run in N, computed where the file holds accelerations alone; None
    where it states no masses of the floors."""
    if source.holds(f"{run}/{SHEAR}"):
        return source.read(f"{run}/{SHEAR}")
    accel = source.read(f"{run}/{ACCEL}")
    try:
        masses = units_factor(source.result, "kg") * floor_masses_kg(source.result)
    except InputError:
        return None
    return storey_shear_n(masses, accel) if len(masses) == len(accel) else None


@dataclass(frozen=True)
class Profile:
    """A quantity over the height: per run its value at each floor, or in each storey."""

    title: str
    xlabel: str
    values: dict[str, Array]  # (n_storeys,) by run
    ground: float | None = None  # at the ground; None: a quantity of a storey, drawn as steps, or not known there
    steps: bool = False
    from_zero: bool = True


def profiles(source: Source, width: str) -> Figure:
    """Draw peak acceleration, displacement, drift, storey shear and the error to SIM over the height, by run."""
    runs, left_out = without_diverged(source, source.runs(BUILDINGS))
    shown = [one for one in _profiles(source, runs) if one.values]
    level, unit = levels(source, len(source.read(f"{runs[0]}/{ACCEL}")))
    across = len(shown) if width == "two" else 2
    down = -(-len(shown) // across)
    figure = new_figure(source, width, 20.0 + down * min(50.0 + 1.5 * len(level), 90.0))
    axes = list(figure.subplots(down, across, sharey=True, squeeze=False).ravel())
    interface = interface_storey(source)
    for place, (ax, one, title) in enumerate(zip(axes, shown, lettered(one.title for one in shown), strict=False)):
        _profile(ax, one, level)
        ax.set(title=title, xlabel=one.xlabel)
        if place % across == 0:
            ax.set_ylabel(unit)
        if interface:
            ax.axhline(level[interface], **INTERFACE.line())
        trimmed_ticks(ax, log=not one.from_zero)
    for ax in axes[len(shown) :]:
        ax.set_visible(False)
    axes[0].set_ylim(0.0, 1.04 * level[-1])
    if unit == "floor":
        _whole_floors(axes[0])
    legend_below(figure, [*(RUNS[run] for run in runs), *([INTERFACE] if interface else []), Look(left_out, "none")])
    return figure


def _heights_m(source: Source) -> Array | None:
    """Return the storeys' heights in the scale of the result, None where its case states none."""
    heights = storey_heights_m(source.result)
    return None if heights is None else units_factor(source.result, "m") * heights


def levels(source: Source, storeys: int) -> tuple[Array, str]:
    """Return the heights (n_storeys + 1,) of ground and floors in m and the name of that axis; the floors' numbers
    where the case states no heights."""
    heights = _heights_m(source)
    if heights is None or len(heights) != storeys:
        return np.arange(storeys + 1, dtype=float), "floor"
    return np.concatenate([[0.0], np.cumsum(heights)]), "height (m)"


def _profiles(source: Source, runs: Sequence[str]) -> list[Profile]:
    """Return the quantities over the height; of one that no run states `values` is empty."""

    def of(series: Callable[[Source, str], Array | None], factor: float) -> dict[str, Array]:
        known = ((run, series(source, run)) for run in runs)
        return {run: factor * peaks(found) for run, found in known if found is not None}

    drifts = of(drifts_m, MM_PER_M)
    heights = _heights_m(source)
    if heights is not None and all(len(heights) == len(values) for values in drifts.values()):
        percent = {run: values / (MM_PER_M * heights) * 100.0 for run, values in drifts.items()}
        drift = Profile("drift", "peak / height (%)", percent, steps=True)
    else:
        drift = Profile("drift", "peak (mm)", drifts, steps=True)
    found = {run: source.metric(f"{run}.rms_error_m_s2") for run in runs}
    errors = {run: MM_PER_M * values for run, values in found.items() if values is not None}
    known = {run: np.where(np.isfinite(v) & (v > 0.0), v, np.nan) for run, v in errors.items() if np.any(v > 0.0)}
    apart = np.concatenate([*known.values(), np.zeros(0)])
    apart = apart[np.isfinite(apart)]
    wide = bool(apart.size) and float(apart.max()) > 10.0 * float(apart.min())
    return [
        Profile("acceleration", f"peak ({ACCELERATION_UNITS})", of(_accelerations, 1.0), _peak_of_ground(source)),
        Profile("displacement", "peak (mm)", of(_displacements, MM_PER_M), 0.0),
        drift,
        Profile("storey shear", "peak (N)", of(shears_n, 1.0), steps=True),
        Profile("error to SIM", f"RMS ({ERROR_UNITS})", known, from_zero=not wide),
    ]


def _accelerations(source: Source, run: str) -> Array | None:
    return source.read(f"{run}/{ACCEL}")


def _displacements(source: Source, run: str) -> Array | None:
    return source.read(f"{run}/{DISPLACEMENT}") if source.holds(f"{run}/{DISPLACEMENT}") else None


def _peak_of_ground(source: Source) -> float | None:
    name = "record/ground_accel_m_s2"
    return float(np.abs(source.read(name)).max(initial=0.0)) if source.holds(name) else None


def _profile(ax: Axes, one: Profile, level: Array) -> None:
    if not one.from_zero:
        ax.set_xscale("log")
    for run, values in one.values.items():
        look = RUNS[run]
        if one.steps:
            ax.plot(np.repeat(values, 2), np.repeat(level, 2)[1:-1], label=look.label, **look.line())
            continue
        x, y = values, level[1:]
        if one.ground is not None:
            x, y = np.concatenate([[one.ground], values]), level
        marker = SHAPES[run] if len(level) <= MARKED_FLOORS else ""
        ax.plot(x, y, marker=marker, ms=2.5, mfc="white", label=look.label, clip_on=False, **look.line())
    if one.from_zero:
        ax.set_xlim(left=0.0)


def _whole_floors(ax: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.yaxis.set_major_locator(MaxNLocator(10, integer=True))


def restoring_n(source: Source, runs: Sequence[str]) -> dict[str, Array]:
    """Return the force of spring and laws (n_storeys, n) of runs in N, NaN where it is not known; nothing where a run
    has none."""
    if not all(source.holds(f"{run}/{RESTORING}") for run in runs):
        return {}
    return {run: source.read(f"{run}/{RESTORING}") for run in runs}


def hysteresis(source: Source, width: str) -> Figure:
    """Draw the force over the drift of each chosen storey in SIM and EXP-RTHS, around the largest drift.

    The force is the storey's shear; in a building with laws that of spring and laws, where all runs know it.
    """
    runs = source.runs(("sim", "exp_rths"))
    series = {run: (drifts_m(source, run), shears_n(source, run)) for run in runs}
    known = {run: (d, v) for run, (d, v) in series.items() if d is not None and v is not None}
    if not known:
        raise NotDrawn("no displacements, or no masses of the floors, in the result")
    storeys = chosen_storeys(len(next(iter(known.values()))[0]), interface_storey(source))[::-1]
    restoring = restoring_n(source, tuple(known))
    across = min(len(storeys), 2 if width == "one" else 4)
    down = -(-len(storeys) // across)
    about = f"{LOOPS_S:g} s around the largest drift"
    figure = new_figure(source, width, 18.0 + down * (40.0 if across > 1 else 60.0), about)
    axes = list(figure.subplots(down, across, squeeze=False).ravel())
    titles = lettered(f"storey {storey}" for storey in storeys)
    for place, (ax, storey, title) in enumerate(zip(axes, storeys, titles, strict=False)):
        of_laws = {run: force[storey - 1] for run, force in restoring.items()}
        shown = bool(of_laws) and all(np.isfinite(force).all() for force in of_laws.values())
        for run, (drift, shear) in known.items():
            force = of_laws[run] if shown else shear[storey - 1]
            part = _loops(source, run, drift[storey - 1])
            step = -(-(part.stop - part.start) // POINTS_PER_LOOP)
            loop = slice(part.start, part.stop, max(step, 1))
            look = replace(RUNS[run], width=1.3 if run == "sim" and len(known) > 1 else 0.6, dashes="solid")
            ax.plot(MM_PER_M * drift[storey - 1, loop], force[loop], label=look.label, **look.line())
        said = "spring and laws (N)" if shown else "storey shear (N)"
        ax.set(title=title, xlabel="drift (mm)", ylabel=said if restoring or place % across == 0 else "")
        trimmed_ticks(ax)
    for ax in axes[len(storeys) :]:
        ax.set_visible(False)
    legend_below(figure, [replace(RUNS[run], dashes="solid") for run in known])
    return figure


def _loops(source: Source, run: str, drift: Array) -> slice:
    """Return the samples around the largest drift (n,), or before the end of a run that stopped early."""
    time = source.read(f"{run}/time_s")
    if not reached_the_end(source, time):
        return window_at(time, float(time[-1]), LOOPS_S)
    known = np.where(np.isfinite(drift), np.abs(drift), -1.0)
    return window_at(time, float(time[int(known.argmax())]), LOOPS_S)


def against_sim(source: Source, width: str) -> Figure:
    """Draw each chosen storey's acceleration in SIM and EXP-RTHS, the roof first, with the error to SIM below."""
    runs = [*source.runs(("sim",)), *source.runs(("exp_rths",))]
    accel = {run: source.read(f"{run}/{ACCEL}") for run in runs}
    pairs = []
    for storey in chosen_storeys(len(accel["sim"]), interface_storey(source))[::-1]:
        lines = tuple(Line(RUNS[run], source.read(f"{run}/time_s"), accel[run][storey - 1]) for run in runs)
        time, tested = lines[1].time_s, lines[1].values
        error = accel["sim"][storey - 1, : tested.size] - tested
        note = rms_note(source, "exp_rths.rms_error_m_s2", storey - 1)
        below = error_panel(source, "", "exp_rths", time, error, "")
        close = close_look(source, time, tested)
        near = tuple(line.values[close] for line in lines)
        title = f"storey {storey}{role_of(source, storey)}"
        column = [(Panel(title, ACCELERATION, lines, note=note), below)]
        if width == "two":
            closer = Panel(CLOSE, "", lines, close, reach=largest(*near))
            column.append((closer, replace(below, ylabel="", close=close)))
        pairs.append(column)
    return draw_pairs(source, pairs, width, source.band)


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
