"""Sobol indices of a metric of a study that was sampled for them: as numbers for figures, text and JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Sweep
from rths_cli.report.numbers import six_wide
from rths_cli.report.sweep_metric import Gridded, gridded, short_key
from rths_cli.report.text_layout import Cell, Row, Table, render
from rths_cli.studies.sensitivity import SobolIndices, sobol_indices

COLUMN = 20


def indexed_keys(sweep: Sweep) -> tuple[str, ...]:
    """Return the keys of a study that was sampled for Sobol indices, () for another sweep."""
    if not sweep.study_yaml:
        return ()
    from pydantic import ValidationError

    from rths_cli.case.study_schema import StudyKeys, is_sampled
    from rths_cli.case.yaml_reader import parse
    from rths_cli.case.yaml_tree import Source, plain

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


def indices_text(sweep: Sweep) -> list[str]:
    """Return the Sobol indices of the error of the worst storey as text, [] for a study without."""
    if not (keys := indexed_keys(sweep)):
        return []
    try:
        found, indices = indices_of(sweep)
    except InputError as error:
        return ["", *error.faults]
    rows = tuple(
        Row(short_key(key, keys), (Cell(_told(first, off)), Cell(_told(total, total_off))))
        for key, first, off, total, total_off in zip(
            keys, indices.first, indices.first_error, indices.total, indices.total_error, strict=True
        )
    )
    title = f"Sobol indices of {found.label}{_seeds(sweep)}, with standard errors"
    heads = (Cell("first order"), Cell("total"))
    return ["", render(Table(title, "key", (2,), COLUMN, (heads,), rows))]


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


def _told(value: float, error: float) -> str:
    return f"{six_wide(value)} +- {six_wide(error)}"


def _seeds(sweep: Sweep) -> str:
    return f" (mean of {sweep.seeds_per_point} seeds)" if sweep.seeds_per_point > 1 else ""
