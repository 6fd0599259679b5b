"""A metric of a sweep at its grid points, and how its name and the varied keys are told."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Sweep
from rths_cli.numerics.lti import Array
from rths_cli.quantities.units import ENDINGS, typeset

STOREYS = "exp_rths.rms_error_m_s2"
PLAYED = "exp_rths."
WHOSE = {"exp_rths": "EXP-RTHS:", "check": "predicted:"}
IN_THOUSANDTHS = {"m/s^2": "mm/s^2", "m": "mm", "s": "ms"}


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
