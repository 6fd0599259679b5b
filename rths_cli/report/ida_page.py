"""`rths ida` as text and JSON: the fragility first, then what is missing, fractiles by level, responses by record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Sweep
from rths_cli.report.document import Block, Column, Document, Line, Row, Table, verdict_line
from rths_cli.report.numbers import json_value, three
from rths_cli.report.sweep_page import label, not_run
from rths_cli.studies.ida_curves import FRACTILES, RUN, SIM, About, Curves, Outcome, about_of, curves_of, outcome_of

NAMES = {RUN: "EXP-RTHS", SIM: "SIM"}
MEASURES = {"sa_t1": "Sa", "pga": "PGA", "arias": "Arias intensity"}
SAFE = "safe"
MARK = "*"  # of a point whose hybrid test the check does not call safe
MOST_RECORDS, MOST_LEVELS = 40, 8  # in the table of responses


def analysis(sweep: Sweep) -> About:
    """Return what a sweep's file says of its analysis; raises InputError where it is none."""
    about = about_of(sweep.attributes)
    if about is None:
        raise InputError("the sweep is no incremental dynamic analysis; rths ida makes one")
    return about


def outcomes(sweep: Sweep, about: About) -> Iterator[tuple[Curves, Outcome]]:
    """Yield the curves and the outcome of every limit in every run."""
    for run in about.runs:
        for limit in about.limits:
            curves = curves_of(sweep, run, limit.metric)
            yield curves, outcome_of(curves, run, limit, about.hunt)


def measure(about: About) -> str:
    """Return the intensity measure in words."""
    at = f"({about.period_s:.3g} s)" if about.period_s else ""
    return f"{MEASURES[about.measure]}{at}"


def verdict(sweep: Sweep, path: Path) -> str:
    """Return the first fragility, or why there is none, and the file in one sentence."""
    about = analysis(sweep)
    return f"{_told(sweep, about, next(outcomes(sweep, about))[1])}; {path}"


def _told(sweep: Sweep, about: About, found: Outcome) -> str:
    """Return the fragility of one limit in one run as a sentence."""
    what = f"{sweep.attributes['case_name']}, {NAMES[found.run]}, {found.limit.name} {found.limit.value:g}"
    if found.fragility is None:
        return f"NO FRAGILITY: {what}: {found.why}"
    one = found.fragility
    (low, high), (least, most) = one.interval(0), one.interval(1)
    return (
        f"FRAGILITY: {what}: median {measure(about)} {three(one.theta)} {about.unit} ({three(low)} to {three(high)}), "
        f"dispersion {three(one.beta)} ({three(least)} to {three(most)}), each with 95 %"
    )


def sections(sweep: Sweep, path: Path) -> Document:
    """Return the analysis of a sweep that `rths ida` played, the fragility first."""
    about = analysis(sweep)
    found = list(outcomes(sweep, about))
    lines: list[Block] = [verdict_line(verdict(sweep, path))]
    lines += [Line(_told(sweep, about, one)) for _, one in found[1:]]
    lines += [Line(text) for _, one in found for text in _counts(one, about)]
    lines += [Line(text) for text in (*_missing(sweep, found[0][0], about), *not_run(sweep))]
    tables = [_levels(sweep, curves, one, about) for curves, one in found]
    return [lines, *([table] for table in tables), *([_responses(sweep, curves, one, about)] for curves, one in found)]


def _counts(found: Outcome, about: About) -> Iterator[str]:
    """Yield how the fit counts, of one run and limit."""
    told = f"{NAMES[found.run]}, {found.limit.name} {found.limit.value:g}: {found.exceeded} points exceed it"
    told += f", {found.missing} are missing (refused or stopped) and left out" if found.missing else ""
    if about.hunt and found.censored:
        told += f"; {found.censored} records do not reach it, of which the fit knows so much alone"
    yield told


def _missing(sweep: Sweep, curves: Curves, about: About) -> Iterator[str]:
    """Yield a line on each level with points that are missing."""
    statuses = sweep.texts["status"]
    for place, level in enumerate(curves.levels):
        gone = np.flatnonzero(curves.missing[:, place])
        if gone.size:
            names = ", ".join(f"{curves.records[k]} ({statuses[curves.row[k, place]]})" for k in gone)
            yield f"missing at {three(level)} {about.unit}: {names}"


def _levels(sweep: Sweep, curves: Curves, found: Outcome, about: About) -> Table:
    """Return for each level how many tests are valid, exceed the limit and are missing, and the fractiles."""
    verdicts = np.array([*sweep.texts["verdict"], SAFE], dtype=object)
    run, safe = curves.row >= 0, (verdicts[curves.row] == SAFE) & (curves.row >= 0)
    over = np.isfinite(curves.response) & (np.nan_to_num(curves.response) > found.limit.value)
    columns = tuple(
        Column(name) for name in ("points", "valid tests", "missing", "exceed", *(f"{f} %" for f in FRACTILES))
    )
    rows = tuple(
        Row(
            three(level),
            (*(str(int(each[:, k].sum())) for each in (run, safe, curves.missing, over)), *map(_number, fractile)),
        )
        for k, (level, fractile) in enumerate(zip(curves.levels, curves.fractiles().T, strict=True))
    )
    title = f"{NAMES[found.run]}: {found.limit.name} over {len(curves.records)} records, by level, with fractiles"
    notes = ("valid tests: those that the check calls safe", "- of a fractile: above what was run")
    return Table(columns, rows, title, f"{measure(about)} ({about.unit})", notes)


def _responses(sweep: Sweep, curves: Curves, found: Outcome, about: About) -> Table:
    """Return the response of each record at each level."""
    verdicts = sweep.texts["verdict"]
    step = -(-len(curves.levels) // MOST_LEVELS)
    shown = range(0, len(curves.levels), step)

    def cell(record: int, place: int) -> str:
        row = curves.row[record, place]
        mark = MARK if row >= 0 and verdicts[row] != SAFE else ""
        return f"{_number(curves.response[record, place])}{mark}" if row >= 0 else ""

    columns = tuple(Column(three(curves.levels[place])) for place in shown)
    rows = tuple(
        Row(name, tuple(cell(record, place) for place in shown))
        for record, name in enumerate(curves.records[:MOST_RECORDS])
    )
    title = f"{NAMES[found.run]}: {found.limit.name} by record and {measure(about)} ({about.unit})"
    notes = [f"{MARK}: the check calls the hybrid test of this point unsafe or unstable; -: refused or stopped"]
    notes += ["more levels stand in the file"] if step > 1 else []
    notes += ["more records stand in the file"] if len(curves.records) > MOST_RECORDS else []
    return Table(columns, rows, title, "record", tuple(notes))


def _number(value: float) -> str:
    return three(value) if np.isfinite(value) else "-"


def document(sweep: Sweep, path: Path) -> dict[str, Any]:
    """Return the analysis for JSON: every fragility with its intervals, fractiles by level, every point."""
    about = analysis(sweep)
    found = list(outcomes(sweep, about))
    return {
        "ida": str(path),
        "verdict": verdict(sweep, path),
        "case_name": sweep.attributes["case_name"],
        **asdict(about),
        "records": list(found[0][0].records),
        "levels": found[0][0].levels.tolist(),
        "outcomes": [_outcome(curves, one) for curves, one in found],
        "points": [_point(sweep, place) for place in range(len(sweep.seed))],
    }


def _outcome(curves: Curves, found: Outcome) -> dict[str, Any]:
    one = found.fragility
    fitted = None if one is None else {
        "theta": one.theta, "beta": one.beta, "theta_95": one.interval(0), "beta_95": one.interval(1),
        "error_of_ln_theta": one.errors[0], "error_of_ln_beta": one.errors[1],
    }  # fmt: skip
    rows = zip(FRACTILES, curves.fractiles(), strict=True)
    return {
        "run": found.run,
        "limit": asdict(found.limit),
        "fragility": fitted,
        "why_none": found.why,
        "exceeded": found.exceeded,
        "missing": found.missing,
        "censored_records": found.censored,
        "fractiles": {str(share): [json_value(x) for x in row] for share, row in rows},
        "response": [[json_value(x) for x in row] for row in curves.response],
    }


def _point(sweep: Sweep, place: int) -> dict[str, Any]:
    varied = {key: values[place] for key, values in sweep.varied.items()}
    texts = {name: sweep.texts[name][place] for name in ("status", "verdict", "reason")}
    return {"row": place + 1, "point": label(varied), **varied, **texts}


def exit_code(sweep: Sweep) -> int:
    """Return the exit code of an analysis: that of a failure, else 1 where a limit has no fragility, else 0.

    Refused, unaccepted and stopped runs are points that are missing, and no failure.
    """
    code = int(sweep.attributes["exit_code"])
    none = any(found.fragility is None for _, found in outcomes(sweep, analysis(sweep)))
    return code if code not in (0, 1, 3) else int(none)
