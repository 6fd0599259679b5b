"""Figures over time: tracking (the paper's Fig. 5.1), Kalman filter (5.2), storeys in all runs (5.3), errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.report.figures.figure_data import (
    ACCEL,
    DESIRED,
    MEASURED,
    NotDrawn,
    Source,
    busiest,
    chosen_storeys,
    interface_storey,
    known_part,
    quietest,
    reached_the_end,
    window_at,
    without_diverged,
)
from rths_cli.report.figures.panels import ACCELERATION, ERROR_UNITS, MM_PER_M, Line, Panel, draw_rows, largest
from rths_cli.report.figures.style import DESIRED as DESIRED_LOOK
from rths_cli.report.figures.style import ESTIMATED, RUNS, SKY, TRUE, VERMILLION, Look
from rths_cli.report.numbers import three
from rths_cli.report.results_by_case import COMPUTED_RUNS, TABLE_RUNS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CLOSE = "close look"
NEAR_S = 1.0  # how close the Kalman filter is looked at
ERROR = f"error ({ERROR_UNITS})"
DIFFERENCE = f"difference ({ERROR_UNITS})"
FLOOR_MEASURED = Look("measured", SKY, "solid", 1.8, below=True)
AS_WRITTEN = Look("as its file has it", SKY, "solid", 1.8, below=True)
AS_PLAYED = Look("as it is played", VERMILLION, "solid", 0.8)
MOTIONS = (
    ("acceleration", ACCELERATION, 1.0), ("velocity", "velocity (m/s)", 1.0),
    ("displacement", "displacement (mm)", MM_PER_M),
)  # fmt: skip
MEASURES = {  # name, metric, factor, units
    "acceleration": (
        ("PGA", "pga_m_s2", 1.0, "m/s²"), ("Arias", "arias_m_s", 1.0, "m/s"), ("D5-95", "d5_95_s", 1.0, "s"),
        ("Sa(T1)", "sa_t1_m_s2", 1.0, "m/s²"),
    ),
    "velocity": (
        ("PGV", "pgv_m_s", 1.0, "m/s"), ("CAV", "cav_m_s", 1.0, "m/s"), ("Housner", "housner_m", 1.0, "m"),
    ),
    "displacement": (("PGD", "pgd_m", MM_PER_M, "mm"), ("mean period", "mean_period_s", 1.0, "s")),
}  # fmt: skip
NAMES = "part_value_names"
MOVED = Look("change from the start", RUNS["exp_rths"].color)
FILTERED_OUT = Look("measured − filtered", VERMILLION, "solid", 0.8)


def tracking(source: Source, width: str) -> Figure:
    """Draw desired and measured acceleration of the table in each test on it (Fig. 5.1)."""
    rows = []
    for run in source.runs(TABLE_RUNS):
        time = source.read(f"{run}/time_s")
        desired = source.read(f"{run}/{DESIRED}")
        measured = replace(RUNS[run], label=f"measured, {RUNS[run].label}")
        lines = (Line(DESIRED_LOOK, time, desired), Line(measured, time, source.read(f"{run}/{MEASURED}")))
        whole = Panel(RUNS[run].label, ACCELERATION, lines, note=rms_note(source, f"{run}.tracking_rms_m_s2"))
        rows.append((whole, Panel(CLOSE, "", lines, close_look(source, time, desired))))
    return draw_rows(source, rows, width, about=source.band)


def kalman(source: Source, width: str) -> Figure:
    """Draw the top floor's acceleration before and after the Kalman filter, and their difference (Fig. 5.2)."""
    run = source.runs(TABLE_RUNS)[-1]
    time = source.read(f"{run}/time_s")
    measured = source.read(f"{run}/floor_accel_measured_m_s2")[-1]
    estimated = source.read(f"{run}/floor_accel_estimated_m_s2")[-1]
    lines = [Line(FLOOR_MEASURED, time, measured)]
    if source.virtual:
        lines.append(Line(TRUE, time, source.read(f"{run}/truth/floor_accel_m_s2")[-1]))
    lines.append(Line(ESTIMATED, time, estimated))
    near = (
        busiest(time, measured, NEAR_S) if reached_the_end(source, time) else window_at(time, float(time[-1]), NEAR_S)
    )
    floor = int(source.read(f"{run}/floor")[-1])
    rows = [
        (
            Panel(f"storey {floor}, {RUNS[run].label}", ACCELERATION, tuple(lines)),
            Panel(CLOSE, "", tuple(lines), near),
        ),
        (
            Panel("measured − filtered", DIFFERENCE, (Line(FILTERED_OUT, time, MM_PER_M * (measured - estimated)),)),
            Panel("quietest second", "", tuple(lines), quietest(time, measured, NEAR_S)),
        ),
    ]
    return draw_rows(source, rows, width)


def responses(source: Source, width: str) -> Figure:
    """Draw the absolute acceleration of the storeys in SIM, SIM-DELAY and EXP-RTHS (Fig. 5.3)."""
    runs, left_out = without_diverged(source, source.runs((*COMPUTED_RUNS, "exp_rths")))
    motions = {run: (source.read(f"{run}/time_s"), source.read(f"{run}/{ACCEL}")) for run in runs}
    storeys = len(motions[runs[0]][1])
    rows = []
    for storey in reversed(chosen_storeys(storeys, interface_storey(source))):
        lines = tuple(Line(RUNS[run], time, accel[storey - 1]) for run, (time, accel) in motions.items())
        shown = [line.values for line in lines if line.look is not RUNS["sim_delay"]] or [line.values for line in lines]
        guide = lines[-1]
        title = f"storey {storey}{role_of(source, storey)}"
        whole = Panel(title, ACCELERATION, lines, reach=largest(*shown))
        close = close_look(source, guide.time_s, guide.values)
        rows.append((whole, Panel(CLOSE, "", lines, close, reach=largest(*(values[close] for values in shown)))))
    return draw_rows(source, rows, width, left_out=left_out)


def ground_motion(source: Source, width: str) -> Figure:
    """Draw the ground motion as it is played, and where the case changes the record, as its file has it: acceleration,
    velocity, displacement, with the intensity measures of what is played."""
    from rths_cli.analysis.intensity import integrate

    time = source.read("record/time_s")
    dt_s = float(time[1] - time[0])
    written = ("record/as_written_accel_m_s2",) if source.holds("record/as_written_accel_m_s2") else ()
    motions = [(AS_WRITTEN, source.read(name)) for name in written] + [
        (AS_PLAYED, source.read("record/ground_accel_m_s2"))
    ]
    series = [(look, (accel, *integrate(accel, dt_s))) for look, accel in motions]
    rows = []
    for place, (title, ylabel, factor) in enumerate(MOTIONS):
        lines = tuple(Line(look, time, factor * each[place]) for look, each in series)
        whole = Panel(title, ylabel, lines, note=_measures_note(source, title, 2 if width == "one" else 4))
        rows.append((whole, Panel(CLOSE, "", lines, close_look(source, time, motions[-1][1]))))
    treated = str(source.result.attributes.get("record_treatment") or "")
    return draw_rows(source, rows, width, about=treated)


def part_values(source: Source, width: str) -> Figure:
    """Draw what parts of the step log of their own in EXP-RTHS, such as the parameters of a law that adapts, as changes
    from the start; forces of computed storeys and what is told of a program are left out."""
    names = own_values(source)
    if not names:
        raise NotDrawn("no part of the step logs values of its own, as a law that adapts does")
    time, values, rows = source.read("exp_rths/time_s"), source.read("exp_rths/part_values"), []
    for place, (name, units) in names.items():
        moved = values[place] - values[place, 0]
        line = (Line(MOVED, time, moved),)
        label, start = name if units in ("", "1") else f"{name} ({units})", three(values[place, 0])
        reach = largest(moved) or None
        close = close_look(source, time, moved)
        rows.append((Panel(name, label, line, note=f"start {start}", reach=reach), Panel(CLOSE, "", line, close)))
    return draw_rows(source, rows, width)


def own_values(source: Source) -> dict[int, tuple[str, str]]:
    """Return name and units of what parts of the step log of their own, by its row in `part_values`."""
    if not source.holds(f"exp_rths/{NAMES}") or not source.holds("exp_rths/part_values"):
        return {}
    from rths_cli.control.displacement_interface import FELT
    from rths_cli.control.interface import LAW_FORCE
    from rths_cli.control.program_storeys import EXTRAPOLATED, LATE, SLOWED
    from rths_cli.files.result_reader import read_dataset

    of_storeys = (FELT.name, EXTRAPOLATED, LATE, SLOWED)
    lines = str(read_dataset(source.result.path, f"exp_rths/{NAMES}").data).splitlines()
    told = {place: line[:-1].rpartition(" (") for place, line in enumerate(lines)}
    return {place: (name, units) for place, (name, _, units) in told.items()
            if name not in of_storeys and not name.startswith(LAW_FORCE)}  # fmt: skip


def _measures_note(source: Source, title: str, most: int) -> str:
    """Return at `most` so many measures of the motion that belong to a panel, "" where the result has none."""
    told = []
    for name, path, factor, units in MEASURES[title][:most]:
        found = source.metric(f"ground.{path}")
        told += [] if found is None else [f"{name} {three(factor * float(found[0]))} {units}".strip()]
    return ", ".join(told)


def errors(source: Source, width: str) -> Figure:
    """Draw tracking errors and the storeys' errors to SIM over time, in the test band."""
    tracked = tuple(_tracking_errors(source))
    against = [tuple(_storey_errors(source, storey)) for storey in _storeys_with_errors(source)]
    rows = [row for row in (tracked, *against) if row]
    if not rows:
        raise NotDrawn("no run on a table and no two runs to compare")
    return draw_rows(source, rows, width, (1.0, 1.0), source.band, legend=False)


def _tracking_errors(source: Source) -> Iterator[Panel]:
    for run in TABLE_RUNS:
        if run in source.result.groups:
            error = source.read(f"{run}/{DESIRED}") - source.read(f"{run}/{MEASURED}")
            look = RUNS[run]
            note = rms_note(source, f"{run}.tracking_rms_m_s2", what="RMS")
            yield error_panel(source, f"tracking, {look.label}", run, source.read(f"{run}/time_s"), error, note)


def _storeys_with_errors(source: Source) -> list[int]:
    groups = source.result.groups
    if "sim" not in groups or not {"sim_delay", "exp_rths"} & set(groups):
        return []
    return list(reversed(chosen_storeys(len(source.read(f"sim/{ACCEL}")), interface_storey(source))))


def _storey_errors(source: Source, storey: int) -> Iterator[Panel]:
    exact = source.read(f"sim/{ACCEL}")[storey - 1]
    for run in ("sim_delay", "exp_rths"):
        if run in source.result.groups:
            values = source.read(f"{run}/{ACCEL}")[storey - 1]
            note = rms_note(source, f"{run}.rms_error_m_s2", storey - 1, "RMS")
            title = f"storey {storey}, SIM − {RUNS[run].label}"
            time = source.read(f"{run}/time_s")
            yield error_panel(source, title, run, time, exact[: values.size] - values, note)


def error_panel(source: Source, title: str, run: str, time: Array, error: Array, note: str) -> Panel:
    """Return the panel in mm/s^2 of an error (n,) in m/s^2 of a run, with the filters of its RMS, up to its last
    finite sample."""
    from rths_cli.report.filtered_errors import evaluated_error

    n = known_part(error)
    shown = np.full(error.size, np.nan)
    shown[:n] = MM_PER_M * evaluated_error(source.result, run, error[:n], 1.0 / source.rate_hz)
    look = replace(RUNS[run], dashes="solid", width=0.8)
    return Panel(title, ERROR, (Line(look, time, shown),), note=note)


def close_look(source: Source, time: Array, values: Array) -> slice:
    """Return the stretch around the peak, or before the end of a run that stopped early."""
    return busiest(time, values) if reached_the_end(source, time) else window_at(time, float(time[-1]))


def role_of(source: Source, storey: int) -> str:
    """Return the role of a storey in the hybrid test in words, after a comma."""
    interface = interface_storey(source)
    if not interface:
        return ""
    return ", computed" if storey < interface else ", interface" if storey == interface else ", on the table"


def rms_note(source: Source, path: str, place: int = 0, what: str = "RMS error") -> str:
    """Return an RMS error in mm/s^2 as text after `what` it is, "" where the result does not have it."""
    found = source.metric(path)
    if found is None or not np.isfinite(found[place]):
        return ""
    return f"{what} {three(MM_PER_M * float(found[place]))} {ERROR_UNITS}"
