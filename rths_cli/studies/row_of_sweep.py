"""The case of one row of a finished sweep, to run it in full: `rths run --from FILE --row N`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from rths_cli.case.case_schema import RUNS
from rths_cli.case.load import PlacedSettings, load_written, written_case
from rths_cli.case.rig_schema import CERTAIN, VirtualRigSpec
from rths_cli.case.yaml_reader import dump
from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.files.sweep_file import Sweep, read_sweep

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.numerics.lti import Array

ORIGIN = ("case_file", "settings", "settings_folder", "values_folder")
SAME = 1e-9  # relative: a sweep filters by another program than a run
LATER = ("controller.reaction_feedforward", "controller.friction_compensation")
"""Keys with a default that decides; the case of a sweep by an rths without them does not state them."""
WHOLE = 2.0**53  # numbers up to it are whole where they have no fraction


@dataclass(frozen=True)
class SweptRow:
    """One row of a sweep: its file and number, its case, the seed of the session that it is played in, what overrode
    the check, its figures by path, a number or one per storey (n_storeys,), NaN where it has none, and the settings
    that state what was the default when it was swept and is another now."""

    path: Path
    number: int
    case: Case
    session_seed: int
    overrides: tuple[str, ...]
    figures: dict[str, Array]
    later: tuple[str, ...] = ()

    @property
    def left_out(self) -> set[str]:
        """Return the figures of runs that the case leaves out: those are no difference."""
        runs = self.case.runs
        gone = {name for name in RUNS if name not in runs} | (set() if "exp_rths" in runs else {"check", "budget"})
        return {path for path in self.figures if path.partition(".")[0] in gone}

    def differences(self, result: Result) -> list[str]:
        """Return a sentence for each figure of the row that a result has otherwise."""
        found = []
        for path, row in self.figures.items():
            if path in self.left_out:
                continue
            run = np.full(len(row), np.nan)
            own = np.atleast_1d(np.asarray(result.metrics.get(path, np.nan), dtype=float))
            run[: len(own)] = own[: len(row)]
            odd = np.flatnonzero(~np.isclose(run, row, rtol=SAME, atol=0.0, equal_nan=True))
            if odd.size:
                place = int(odd[0])
                storey = f"[{place + 1}]" if len(row) > 1 else ""
                found.append(f"{path}{storey} is {run[place]:.10g}, {row[place]:.10g} in the row")
        return found


def read_row(path: Path, number: int, settings: Sequence[str] = ()) -> SweptRow:
    """Return row `number` (from 1) of a sweep's file, with `settings` KEY=VALUE put into its case.

    Names and paths in the case are looked up where the sweep looked them up. Raises InputError when the file is no
    finished sweep, has no such row, or its case has faults now.
    """
    if not path.is_file():
        raise InputError(f"--from {path}: no such file; name the result file of a sweep, such as sweeps/NAME.h5")
    sweep = read_sweep(path)
    if not 1 <= number <= len(sweep.seed):
        raise InputError(f"--row {number}: must be 1 to {len(sweep.seed)}, the rows of {path}")
    about = sweep.attributes
    if not all(isinstance(about.get(name), str) for name in ORIGIN):
        raise InputError(f"{path}: does not say where its case comes from, it is of an older rths; run the sweep again")
    written = written_case(sweep.case_yaml, Path(str(about["case_file"])))
    shared = PlacedSettings(_texts(path, str(about["settings"])), Path(str(about["settings_folder"])))
    varied = {key: _as_given(_one(values, number - 1)) for key, values in sweep.varied.items()}
    own = [f"{key}={dump(value)}" for key, value in varied.items()]
    placed = PlacedSettings(own, Path(str(about["values_folder"])))
    named = load_written(written, shared, placed)
    last = PlacedSettings([f"seed={sweep.seed[number - 1]}", f"name={named.name}-row{number}", *settings])
    case = load_written(written, shared, placed, last)
    overrides = tuple(str(about.get("overrides", "")).split())
    given = {setting.partition("=")[0] for setting in settings}
    read = case.method == "best" and case.controller.inverts
    later = tuple(
        f"{key}=false"
        for key in LATER
        if read and f" {key.partition('.')[2]}:" not in sweep.resolved_yaml and key not in given
    )
    if not any(key == "table" or key.startswith("table.uncertainty") for key in (*given, *varied)):
        later += _uncertainty_then(sweep, case)
    return SweptRow(path, number, case, named.seed, overrides, _figures(sweep, number), later)


def _uncertainty_then(sweep: Sweep, case: Case) -> tuple[str, ...]:
    """Return the setting that states the uncertainties of the sweep's rig, () where the case has the same."""
    try:
        resolved = yaml.safe_load(sweep.resolved_yaml)
    except yaml.YAMLError:
        return ()
    table = resolved.get("table") if isinstance(resolved, dict) else None
    then = table.get("uncertainty", {}) if isinstance(table, dict) else None
    if not isinstance(then, dict) or not isinstance(case.table, VirtualRigSpec):
        return ()
    stated = {**CERTAIN.model_dump(), **then}  # a key that was not there yet: as rths judged then
    if stated == case.table.uncertainty.model_dump():
        return ()
    return (
        f"table.uncertainty={yaml.safe_dump(stated, default_flow_style=True, sort_keys=False, width=1000).strip()}",
    )


def _texts(path: Path, text: str) -> list[str]:
    """Return the settings that a sweep's file holds as JSON."""
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        raise InputError(f"{path}: has lost the settings of its case; run the sweep again")
    return found


def _figures(sweep: Sweep, number: int) -> dict[str, Array]:
    return {path: np.atleast_1d(figure.values[number - 1]) for path, figure in sweep.figures.items()}


def _one(values: tuple[Any, ...] | NDArray[Any], place: int) -> Any:
    """Return one of the values of an axis, of an array as an object of Python's own."""
    return values[place].item() if isinstance(values, np.ndarray) else values[place]


def _as_given(value: Any) -> Any:
    """Return a varied value as it was given: a sweep's file holds whole numbers as numbers, mappings as JSON."""
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < WHOLE else value
    try:
        found = json.loads(value)
    except ValueError:
        return value
    return value if isinstance(found, str) else found
