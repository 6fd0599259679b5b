"""Answers of a program in a run, in simulated time: late ones, slow-downs and extrapolations, as they were logged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.control.program_storeys import EXTRAPOLATED, LATE, SLOWED
from rths_cli.findings import Finding
from rths_cli.programs import step_times

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.run_signals import Series
    from rths_cli.structure import Building


def answer_metrics(run: str, series: Series) -> dict[str, ArrayLike]:
    """Return how often a program's answers came late in a run, by path; {} without a program."""
    rows = {one.name: row for one, row in zip(series.logs, series.logged, strict=True)}
    if LATE not in rows:
        return {}
    begins = np.diff(rows[EXTRAPOLATED], prepend=0.0) > 0.0  # after a fault of the program rows are not numbers
    return {
        f"{run}.program_late_answers": int(np.sum(rows[LATE] > 0.0)),
        f"{run}.program_slow_downs": int(np.sum(rows[SLOWED] > 0.0)),
        f"{run}.program_extrapolations": int(np.sum(begins)),
        f"{run}.program_latest_s": float(np.nanmax(rows[LATE], initial=0.0)),
    }


def answer_findings(run: str, label: str, metrics: dict[str, ArrayLike]) -> tuple[Finding, ...]:
    """Return what to say of a program's late answers in a run, () where none was late."""
    names = {"late": "late_answers", "slow": "slow_downs", "extrapolated": "extrapolations", "latest_s": "latest_s"}
    values = {name: metrics.get(f"{run}.program_{path}", 0) for name, path in names.items()}
    if not values["late"] and not values["extrapolated"]:
        return ()
    return (Finding("run.late_answers", values).at("at.run", run=label),)


def step_time_note(building: Building, sim: Response) -> tuple[Finding, ...]:
    """Return what a program's answers take here over displacements up to those of SIM, and the share of them that would
    miss the time that the case states; () without a program."""
    program = building.program
    if program is None:
        return ()
    floors = len(building.numerical.masses_kg)
    taken = step_times(program.description, np.abs(sim.rel_disp_m[:floors]).max(axis=1))
    half, most = np.percentile(taken, [50.0, 99.0])
    values = {
        "half_s": float(half), "most_s": float(most), "longest_s": float(taken.max()), "stated_s": program.answer_s,
        "missed": float(np.mean(taken > program.answer_s)),
    }  # fmt: skip
    return (Finding("assumption.step_times", values),)
