"""Figures of an incremental dynamic analysis: a curve of each record with the fractiles, and the fragility."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Sweep
from rths_cli.quantities.declaration import typeset
from rths_cli.report.figures.figure_data import NotDrawn
from rths_cli.report.figures.panels import empty_figure
from rths_cli.report.figures.study_figures import heading_of
from rths_cli.report.figures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILLION
from rths_cli.report.ida_page import NAMES, analysis, measure, outcomes
from rths_cli.studies.ida_curves import FRACTILES, RUN, About, Curves, Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rths_cli.numerics.lti import Array

STYLES = dict(zip(FRACTILES, ("dotted", "solid", "dashed"), strict=True))
COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE)
POINTS = 200  # of a drawn fragility
UNITS = {"peak_inter_storey_drift_m": "m", "peak_abs_accel_m_s2": "m/s^2", "peak_building_base_shear_n": "N"}
RESPONSES = {
    "peak_drift_ratio": "inter-storey drift ratio",
    "peak_inter_storey_drift_m": "inter-storey drift",
    "peak_abs_accel_m_s2": "absolute acceleration",
    "peak_building_base_shear_n": "base shear",
    "ductility": "ductility",
}
PANEL_MM = 65.0


def _found(sweep: Sweep) -> tuple[About, list[tuple[Curves, Outcome]]]:
    try:
        about = analysis(sweep)
    except InputError as error:
        raise NotDrawn(str(error)) from error
    return about, list(outcomes(sweep, about))


def _runs(about: About) -> str:
    return " and ".join(NAMES[run] for run in about.runs)


def _intensity(about: About) -> str:
    return f"{measure(about)} ({typeset(about.unit)})"


def ida_curves(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw response against intensity: a panel for each limit in each run, grey curves of the records, fractiles, the
    limit. `metric` is not used. Raises NotDrawn for another sweep."""
    about, found = _found(sweep)
    figure = empty_figure(width, PANEL_MM * len(found))
    panels = figure.subplots(len(found), 1, squeeze=False)[:, 0]
    for ax, (curves, one) in zip(panels, found, strict=True):
        _panel(ax, curves, one)
        ax.set_ylabel(_intensity(about))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2 if width == "one" else 5)
    return heading_of(figure, sweep, width, headed, runs=_runs(about))


def _panel(ax: Axes, curves: Curves, found: Outcome) -> None:
    """Draw the curves of one limit in one run."""
    for place, row in enumerate(curves.response):
        known = np.isfinite(row)
        x, y = np.concatenate([[0.0], row[known]]), np.concatenate([[0.0], curves.levels[known]])
        ax.plot(x, y, color="#BBBBBB", lw=0.6, marker=".", ms=2.0, label="each record" if place == 0 else None)
    for share, row in zip(FRACTILES, curves.fractiles(), strict=True):
        ax.plot(np.append(0.0, row), np.append(0.0, curves.levels), color=BLUE, ls=STYLES[share], label=f"{share} %")
    ax.axvline(found.limit.value, color=VERMILLION, lw=0.8, label="limit")
    unit = UNITS.get(found.limit.metric, "")
    ax.set_xlabel(f"{NAMES[found.run]}: largest {RESPONSES[found.limit.metric]}{f' ({typeset(unit)})' if unit else ''}")
    ax.set_xlim(left=0.0)
    ax.set_ylim(bottom=0.0)


def fragility(sweep: Sweep, width: str, metric: str = "", headed: bool = True) -> Figure:
    """Draw the fragility of each limit in each run with its 95 % confidence, and the shares that exceed at each level.

    `metric` is not used. Raises NotDrawn for another sweep, and where no fragility is stated.
    """
    about, found = _found(sweep)
    if all(one.fragility is None for _, one in found):
        raise NotDrawn(f"no fragility is stated: {found[0][1].why}")
    figure = empty_figure(width, PANEL_MM + 10.0)
    ax = figure.subplots()
    for number, (curves, one) in enumerate(found):
        color = COLOURS[number % len(COLOURS)]
        if not about.hunt:
            ax.plot(curves.levels, _shares(curves, one), "o" if one.run == RUN else "s", color=color, ms=3.0)
        if one.fragility is None:
            continue
        x = np.linspace(0.0, 1.15 * curves.levels.max(), POINTS + 1)[1:]
        middle, low, high = one.fragility.probability(x)
        ax.fill_between(x, low, high, color=color, alpha=0.2, lw=0.0)
        limit = f"{one.limit.value:g} {UNITS.get(one.limit.metric, '')}".rstrip()
        ax.plot(x, middle, color=color, label=f"{NAMES[one.run]}, {RESPONSES[one.limit.metric]} {limit}")
    ax.axhline(0.5, color=BLACK, lw=0.4)
    ax.set(xlabel=_intensity(about), ylabel="probability of exceedance", ylim=(0.0, 1.0))
    ax.set_xlim(left=0.0)
    figure.legend(loc="outside lower center", ncols=1 if width == "one" else 2)
    note = "band: 95 % confidence" + ("" if about.hunt else "; dots: shares at the levels")
    return heading_of(figure, sweep, width, headed, note, _runs(about))


def _shares(curves: Curves, found: Outcome) -> Array:
    """Return the share of the records that were run at each level (l,) and exceed the limit there."""
    known = np.isfinite(curves.response)
    over = known & (np.nan_to_num(curves.response) > found.limit.value)
    return np.asarray(over.sum(axis=0) / np.maximum(known.sum(axis=0), 1))
