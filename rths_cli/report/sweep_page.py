"""`rths sweep` and `rths report SWEEP` as text and JSON: errors of each grid point, percentiles, failures, Sobol
indices."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import NEEDED, Figure, Sweep
from rths_cli.numerics.lti import Array
from rths_cli.quantities.declaration import ENDINGS, typeset
from rths_cli.report.document import Block, Column, Document, Line, Row, Table, across, verdict_line
from rths_cli.report.numbers import json_value, six_wide, three
from rths_cli.report.result_scale import MODEL, stored_scale
from rths_cli.report.to_text import text
from rths_cli.structure.similitude import factors_text
from rths_cli.studies.sensitivity import SobolIndices, sobol_indices

STOREYS = "exp_rths.rms_error_m_s2"
PLAYED = "exp_rths."
WHOSE = {"exp_rths": "EXP-RTHS:", "check": "predicted:"}
IN_THOUSANDTHS = {"m/s^2": "mm/s^2", "m": "mm", "s": "ms"}

PERCENTILES = (5, 16, 50, 84, 95)
MOST_METRICS = 10  # printed; with more, those that every sweep has
SMALL = 0.01  # below it four decimals are fewer than three digits
TRACKING = "exp_rths.tracking_rms_m_s2"
STATISTICS = {"median": 50.0, "95 %": 95.0, "largest": 100.0}
POINTS_SHOWN = 40
REASONS_SHOWN = 5
MM_PER_M = 1e3
MOST_STOREYS = 6


@dataclass(frozen=True)
class Gridded:
    """A metric at the grid points of a sweep.

    `values` (n_points, n_seeds) in `unit`, NaN where a run has none; `unfinished` (n_points,): whether a run of the
    point was refused, aborted or failed.
    """

    label: str
    unit: str
    values: Array
    unfinished: NDArray[np.bool_]
    keys: dict[str, list[Any]]  # values (n_points,) by varied key


def gridded(sweep: Sweep, metric: str = "") -> Gridded:
    """Return a metric of a sweep by grid point: of the storey in brackets, from 1, or the largest of all storeys.

    Metrics of EXP-RTHS are those of complete runs. Raises InputError for a metric that the sweep does not hold.
    """
    path, _, index = (metric or STOREYS).partition("[")
    figure = sweep.figures.get(path)
    if figure is None:
        raise InputError(f"--metric {metric}: is not in the sweep; known: {', '.join(sweep.figures)}.")
    values, where = _of_storey(figure.values, metric, index)
    ended = np.array([status == "complete" for status in sweep.texts["status"]])
    if path.startswith(PLAYED):
        values = np.where(ended, values, np.nan)
    unit = IN_THOUSANDTHS.get(figure.units, figure.units)
    factor = 1e3 if figure.units in IN_THOUSANDTHS else 1.0
    shape = (-1, sweep.seeds_per_point)
    keys = {key: list(found[:: sweep.seeds_per_point]) for key, found in sweep.varied.items()}
    kept = np.where(np.isfinite(values), factor * values, np.nan).reshape(shape)
    return Gridded(f"{_in_words(path)}{where}", unit, kept, np.any(~ended.reshape(shape), axis=1), keys)


def _in_words(path: str) -> str:
    """Return the name of a metric as an axis shows it: without its unit, which stands in brackets behind it."""
    run, _, leaf = path.partition(".")
    for ending, _ in ENDINGS:
        head, found, kind = leaf.rpartition(ending)
        if found and (not kind or kind.startswith("_")):
            leaf = f"{head}{kind}"
            break
    return f"{WHOSE.get(run, run)} {leaf.replace('_', ' ').replace('rms', 'RMS')}"


def _of_storey(values: Array, metric: str, index: str) -> tuple[Array, str]:
    """Return one number per run (n_runs,), and which storey that is in words."""
    if values.ndim == 1:
        if index:
            raise InputError(f"--metric {metric}: is one number, not one per storey; leave out the brackets.")
        return values, ""
    if not index:
        return np.where(np.isnan(values), -np.inf, values).max(axis=1), ", worst storey"
    count = values.shape[1]
    storey = index.removesuffix("]")
    if not storey.isdecimal() or not 1 <= int(storey) <= count:
        raise InputError(f"--metric {metric}: name a storey from 1 to {count} in the brackets.")
    return values[:, int(storey) - 1], f", storey {int(storey)}"


def named(found: Gridded) -> str:
    """Return a metric with its unit, as an axis names it."""
    unit = typeset(found.unit)
    return f"{found.label} ({unit})" if unit not in ("", "1") else found.label


def short_key(key: str, keys: Sequence[str]) -> str:
    """Return the shortest end of a dotted key that no other key has, and that is not the seed of a run."""
    parts = key.split(".")
    ends = (".".join(parts[start:]) for start in range(len(parts) - 1, 0, -1))
    others = [".seed", *(f".{other}" for other in keys if other != key)]
    return next((end for end in ends if not any(other.endswith(f".{end}") for other in others)), key)


def as_text(value: Any) -> str:
    """Return a varied value as short text."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value).replace('"', "")


def summary(sweep: Sweep) -> dict[str, Any]:
    """Return the summary for JSON.

    `statuses` and `verdicts`: runs and share of all runs; `metrics`: by path the unit, the number of runs that have it,
    and its percentiles over these, per storey where it has one value for each.
    """
    runs = len(sweep.seed)
    return {
        "runs": runs,
        "statuses": _shares(sweep.texts["status"], runs),
        "verdicts": _shares(sweep.texts.get("verdict", ()), runs),
        "metrics": {path: _of_metric(figure) for path, figure in sweep.figures.items()},
    }


def percentiles(values: Array) -> Array:
    """Return PERCENTILES (5, m) of values (n_runs, m) over the runs that have one, NaN where none has.

    Linear between runs; where some are infinite the lower run's.
    """
    found = np.full((len(PERCENTILES), values.shape[1]), np.nan)
    for column, numbers in enumerate(values.T):
        held = numbers[~np.isnan(numbers)]
        if held.size:
            way = "linear" if np.isfinite(held).all() else "lower"
            found[:, column] = np.percentile(held, PERCENTILES, method=way)  # type: ignore[call-overload]
    return found


def summary_section(sweep: Sweep) -> list[Block]:
    """Return the summary of a study, nothing for another sweep."""
    if not sweep.study_yaml:
        return []
    found = summary(sweep)
    ends = [Line(f"Of {found['runs']} runs: {_shares_text(found['statuses'])}.")]
    verdicts = {name: share for name, share in found["verdicts"].items() if name}
    ends += [Line(f"Verdict of the check: {_shares_text(verdicts)}.")] if verdicts else []
    whole = len(sweep.figures) <= MOST_METRICS
    shown = {path: figure for path, figure in sweep.figures.items() if whole or path in NEEDED}
    columns = tuple(Column(f"{share} %") for share in PERCENTILES)
    rows = tuple(row for path, figure in shown.items() for row in _summary_rows(path, figure))
    title = "Percentiles over the runs that have the metric; units as in its name"
    more = [] if whole else [Line("Percentiles of the other metrics: --json.")]
    return [*ends, Line(""), Table(columns, rows, title, "metric"), *more]


def _summary_rows(path: str, figure: Figure) -> Iterator[Row]:
    values = figure.values if figure.values.ndim > 1 else figure.values[:, np.newaxis]
    for place, column in enumerate(percentiles(values).T, 1):
        storey = f"[{place}]" if figure.values.ndim > 1 else ""
        yield Row(f"{path}{storey}", tuple(_shown(one) for one in column))


def _shown(value: float) -> str:
    """Return a number with three digits at least, "-" for none."""
    return six_wide(value) if math.isfinite(value) and abs(value) >= SMALL else three(value)


def _shares(texts: tuple[str, ...], runs: int) -> dict[str, dict[str, float]]:
    return {name: {"runs": count, "share": count / runs} for name, count in sorted(Counter(texts).items())}


def _shares_text(shares: Mapping[str, Mapping[str, float]]) -> str:
    return ", ".join(f"{one['runs']} {name} ({100 * one['share']:.3g} %)" for name, one in shares.items())


def _of_metric(figure: Figure) -> dict[str, Any]:
    one = figure.values.ndim == 1
    values = figure.values[:, np.newaxis] if one else figure.values
    found = percentiles(values)
    counts = (~np.isnan(values)).sum(axis=0).tolist()
    rows = {str(share): [json_value(x) for x in row] for share, row in zip(PERCENTILES, found, strict=True)}
    return {
        "units": figure.units,
        "runs": counts[0] if one else counts,
        "percentiles": {share: row[0] if one else row for share, row in rows.items()},
    }


def indexed_keys(sweep: Sweep) -> tuple[str, ...]:
    """Return the keys of a study that was sampled for Sobol indices, () for another sweep."""
    if not sweep.study_yaml:
        return ()
    from pydantic import ValidationError

    from rths_cli.case.study_schema import StudyKeys, is_sampled
    from rths_cli.case.yaml_reader import Source, parse, plain

    tree, _ = parse(sweep.study_yaml, Source("study_yaml", Path.cwd()))
    try:
        study = StudyKeys.model_validate(plain(tree)) if tree is not None else None
    except ValidationError:  # of another version of rths
        study = None
    if study is None or study.samples is None or study.samples.method != "sobol_indices":
        return ()
    return tuple(key for key, axis in study.axes.items() if is_sampled(axis))


def indices_of(sweep: Sweep, metric: str = "") -> tuple[Gridded, SobolIndices]:
    """Return a metric and its Sobol indices over the sampled keys, in the order of `indexed_keys`.

    With several seeds the indices are those of their mean. Raises InputError where the study varies other keys too, a
    run has no metric, or SALib is not installed.
    """
    keys, found = indexed_keys(sweep), gridded(sweep, metric)
    if others := [key for key in sweep.varied if key not in keys]:
        raise InputError(f"Sobol indices: the study also varies {', '.join(others)}; fix it, or give a distribution")
    return found, sobol_indices(found.values.mean(axis=1), len(keys))


def indices_section(sweep: Sweep) -> list[Block]:
    """Return the Sobol indices of the error of the worst storey, [] for a study without."""
    if not (keys := indexed_keys(sweep)):
        return []
    try:
        found, indices = indices_of(sweep)
    except InputError as error:
        return [Line(fault) for fault in error.faults]
    rows = tuple(
        Row(short_key(key, keys), (_index_text(first, off), _index_text(total, total_off)))
        for key, first, off, total, total_off in zip(
            keys, indices.first, indices.first_error, indices.total, indices.total_error, strict=True
        )
    )
    title = f"Sobol indices of {found.label}{_seeds(sweep)}, with standard errors"
    return [Table((Column("first order"), Column("total")), rows, title, "key")]


def indices_document(sweep: Sweep) -> dict[str, Any]:
    """Return the Sobol indices of every metric that has them for JSON: by path and key, of each storey."""
    keys, found = indexed_keys(sweep), {}
    for path, figure in sweep.figures.items() if keys else ():
        storeys = [f"{path}[{k}]" for k in range(1, figure.values.shape[1] + 1)] if figure.values.ndim > 1 else [path]
        for metric in storeys:
            try:
                _, indices = indices_of(sweep, metric)
            except InputError:
                continue
            found[metric] = {
                key: {name: _finite(getattr(indices, name)[place]) for name in SobolIndices.__dataclass_fields__}
                for place, key in enumerate(keys)
            }
    return found


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _index_text(value: float, error: float) -> str:
    return f"{six_wide(value)} +- {six_wide(error)}"


def _seeds(sweep: Sweep) -> str:
    return f" (mean of {sweep.seeds_per_point} seeds)" if sweep.seeds_per_point > 1 else ""


@dataclass(frozen=True)
class Point:
    """One grid point of a sweep."""

    label: str  # varied values as text
    varied: dict[str, Any]  # varied values by key
    statuses: dict[str, int]  # number of runs by status
    errors: Array  # (n_runs, 1 + n_storeys) RMS errors in m/s^2 of the complete runs: tracking, then each storey


def points_of(sweep: Sweep) -> Iterator[Point]:
    """Yield the grid points of a sweep."""
    size = sweep.seeds_per_point
    table = np.column_stack([sweep.figures[TRACKING].values, sweep.figures[STOREYS].values])
    for start in range(0, len(sweep.seed), size):
        runs = slice(start, start + size)
        varied = {key: values[start] for key, values in sweep.varied.items()}
        whole = np.array([status == "complete" for status in sweep.texts["status"][runs]])
        yield Point(label(varied), varied, dict(Counter(sweep.texts["status"][runs])), table[runs][whole])


def label(varied: dict[str, Any]) -> str:
    """Return varied values as text KEY=VALUE, each key shortened to an end that no other key has."""
    told = [f"{short_key(key, list(varied))}={as_text(value)}" for key, value in varied.items()]
    return ", ".join(told) or "the case as it is"


def statistics(errors: Array) -> dict[str, Array]:
    """Return median, 95 % quantile and largest of errors (n_runs, m), each (m,); {} without runs."""
    if len(errors) == 0:
        return {}
    return {name: np.percentile(errors, share, axis=0) for name, share in STATISTICS.items()}


def page(sweep: Sweep, path: Path) -> str:
    """Return the summary of a sweep as text, of a part how its runs ended."""
    return text(sections(sweep, path))


def sections(sweep: Sweep, path: Path) -> Document:
    """Return the summary of a sweep, of a part how its runs ended; the verdict first, then reasons, then tables."""
    return [verdict_lines(sweep, path), grid_points(sweep), *below_grid_points(sweep)]


def verdict(sweep: Sweep, path: Path) -> str:
    """Return in one sentence how the runs of a sweep ended, how far they err, and its file."""
    ends, runs = Counter(sweep.texts["status"]), len(sweep.seed)
    complete = ends["complete"]
    others = ", ".join(f"{count} {status}" for status, count in sorted(ends.items()) if status != "complete")
    told = f"{_runs(runs)} of EXP-RTHS" if complete == runs else f"{complete} of {runs} complete, {others}"
    word = "COMPLETE" if complete == runs else "NOT COMPLETE"
    return f"{word}: {sweep.attributes['case_name']}, {told}{_error_range(sweep)}; {path}"


def _error_range(sweep: Sweep) -> str:
    """Return the range of the errors in words; each run counts by its worst storey. "" where none was played."""
    worst = MM_PER_M * _worst_storeys(sweep)[1]
    if not len(worst):
        return ""
    low, mid, high = (three(value) for value in (np.min(worst), np.median(worst), np.max(worst)))
    told = low if len(worst) == 1 else f"{low} to {high}, median {mid}"
    return f"; RMS error of the worst storey {told} mm/s^2"


def _worst_storeys(sweep: Sweep) -> tuple[NDArray[np.intp], Array]:
    """Return the places (m,) of the runs that have errors, and the largest of each (m,) in m/s^2."""
    errors = sweep.figures[STOREYS].values
    played = np.flatnonzero(np.isfinite(errors).any(axis=1))
    return played, np.nanmax(errors[played], axis=1) if played.size else np.empty(0)


def verdict_lines(sweep: Sweep, path: Path) -> list[Block]:
    """Return the verdict, of a part its number, what was not run, the runs with the smallest and largest error."""
    of_part = [] if sweep.numbers is None else [_of_part(sweep)]
    extremes = _extremes(sweep) if sweep.numbers is None else []
    return [verdict_line(verdict(sweep, path)), *map(Line, (*of_part, *not_run(sweep), *extremes))]


def grid_points(sweep: Sweep) -> list[Block]:
    """Return the errors of each grid point of a sweep, of a part nothing."""
    return [] if sweep.numbers is not None else [_table(sweep), *map(Line, (*_scale(sweep), *_more_points(sweep)))]


def below_grid_points(sweep: Sweep) -> Document:
    """Return what stands below the grid points of a sweep, percentiles and indices; of a part nothing."""
    return [] if sweep.numbers is not None else [summary_section(sweep), indices_section(sweep)]


def document(sweep: Sweep, path: Path) -> dict[str, Any]:
    """Return the summary of a sweep for JSON: every grid point with its runs and the statistics of its errors.

    Of a part, whose grid points may lack runs, no grid point.
    """
    points = []
    for point in points_of(sweep) if sweep.numbers is None else ():
        found = {
            name: {TRACKING: json_value(row[0]), STOREYS: [json_value(value) for value in row[1:]]}
            for name, row in statistics(point.errors).items()
        }
        points.append({"varied": point.varied, "runs": point.statuses, "errors": found})
    about: dict[str, Any] = {
        name: sweep.attributes[name] for name in ("case_name", "rig", "rig_kind", "seeds", "status", "plan_sha256")
    }
    about |= {} if sweep.numbers is None else {"part": sweep.attributes["part"]}
    scale = stored_scale(sweep.attributes)
    about |= {} if scale is None or _varies(sweep) else {"scale": {"reported_in": MODEL, "factors": scale.factors}}
    indices = indices_document(sweep) if sweep.numbers is None else {}
    about |= {"sobol_indices": indices} if indices else {}
    return {
        "sweep": str(path),
        "verdict": verdict(sweep, path),
        **about,
        "runs": len(sweep.seed),
        "summary": summary(sweep),
        "points": points,
    }


def _scale(sweep: Sweep) -> list[str]:
    """Return the line on the scale of the model, [] where the case states none."""
    scale = stored_scale(sweep.attributes)
    if _varies(sweep):
        return ["Model scale, which the sweep varies: every error is that of the model in the laboratory."]
    return [] if scale is None else [f"Model scale; prototype over model: {factors_text(scale.factors)}."]


def _varies(sweep: Sweep) -> bool:
    return any(key == "scale" or key.startswith("scale.") for key in sweep.varied)


def _of_part(sweep: Sweep) -> str:
    part, case = sweep.attributes["part"], sweep.attributes["case_name"]
    return f"{case}: part {part} of a sweep, {_runs(len(sweep.seed))} of EXP-RTHS; rths merge joins all parts"


def _runs(count: int) -> str:
    return f"{count} run" if count == 1 else f"{count} runs"


def _table(sweep: Sweep) -> Table:
    storeys = sweep.figures[STOREYS].values.shape[1]
    shown = min(storeys, MOST_STOREYS)
    columns = (Column("tracking"), *(Column(f"storey {1 + k}") for k in range(shown)))
    rows = [row for _, point in zip(range(POINTS_SHOWN), points_of(sweep), strict=False) for row in _rows(point, shown)]
    title = (
        f"{sweep.attributes['case_name']}: RMS errors (mm/s^2, test band, measured) of {_runs(len(sweep.seed))} of "
        f"EXP-RTHS; virtual shake table {sweep.attributes['rig']}"
    )
    corner = "grid point" if sweep.seeds_per_point == 1 else "over the seeds"
    return Table(columns, tuple(rows), title, corner)


def _rows(point: Point, storeys: int) -> Iterator[Row]:
    """Yield the rows of a grid point: one row for a single run, else a heading and a row per statistic."""
    runs = sum(point.statuses.values())
    ends = ", ".join(f"{count} {status}" for status, count in sorted(point.statuses.items()))
    found = statistics(MM_PER_M * point.errors[:, : 1 + storeys])
    if runs == 1:
        yield Row(point.label, _cells(found["largest"]) if found else across(ends[2:], 1 + storeys))
        return
    yield Row(f"{point.label}: {ends}")
    for name, row in found.items():
        yield Row(name, _cells(row))


def _cells(errors: Array) -> tuple[str, ...]:
    return tuple(map(six_wide, errors))


def _more_points(sweep: Sweep) -> list[str]:
    """Return a line if there are more grid points or storeys than shown."""
    points = len(sweep.seed) // sweep.seeds_per_point
    storeys = sweep.figures[STOREYS].values.shape[1]
    lines = [f"{points - POINTS_SHOWN} more grid points stand in the file."] if points > POINTS_SHOWN else []
    return lines + (["More storeys stand in the file."] if storeys > MOST_STOREYS else [])


def _extremes(sweep: Sweep) -> list[str]:
    """Return the lines on the runs with the smallest and the largest error; each run counts by its worst storey."""
    errors = sweep.figures[STOREYS].values
    played, worst = _worst_storeys(sweep)
    if played.size < 2:
        return []
    lines = []
    for name, place in (("smallest", int(np.argmin(worst))), ("largest", int(np.argmax(worst)))):
        run = int(played[place])
        varied = {key: values[run] for key, values in sweep.varied.items()}
        where = f"{label(varied)}, seed {sweep.seed[run]}" if varied else f"seed {sweep.seed[run]}"
        storey = 1 + int(np.nanargmax(errors[run]))
        lines.append(
            f"{name} error: {six_wide(MM_PER_M * worst[place])} mm/s^2 (storey {storey}) at {where}, run {run + 1}"
        )
    return lines


def not_run(sweep: Sweep) -> list[str]:
    """Return the lines on runs that are not complete and accepted: number, status and most frequent reasons."""
    ends = Counter(zip(sweep.texts["status"], sweep.texts["reason"], strict=True))
    told = [(status, reason, count) for (status, reason), count in ends.most_common() if reason]
    lines = [f"{count} {status}: {reason}" for status, reason, count in told[:REASONS_SHOWN]]
    more = sum(count for _, _, count in told[REASONS_SHOWN:])
    lines += [f"{more} more with other reasons, which stand in the file"] if more else []
    return lines
