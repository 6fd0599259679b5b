"""Plan an incremental dynamic analysis: a set of records, each scaled to levels of one intensity measure, in stripes
or by hunt-and-fill (Vamvatsikos and Cornell, Earthq. Eng. Struct. Dyn. 31, 2002, 491).

It is a sweep over `record.file` and `record.scale_to.value`. A hunt goes up in growing steps over the levels until a
record exceeds every limit, then halves the gap until two neighbouring levels hold it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.field_types import near
from rths_cli.case.load import PlacedSettings, WrittenCase, load_written, read_case
from rths_cli.case.yaml_reader import dump
from rths_cli.errors import InputError
from rths_cli.experiment.record_scaling import OF_MEASURE
from rths_cli.experiment.run_case import response_metrics, sim_of
from rths_cli.experiment.setup import first_period_s
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.studies.ida_curves import ABOUT, COMPONENT, FILE, LEVEL, RUN, SIM, About, Limit, as_data
from rths_cli.studies.plan import Axis, Block, Plan, checked_plan
from rths_cli.studies.record_sets import is_set, records_of
from rths_cli.studies.study_plan import Planned, read_axes
from rths_cli.studies.sweep_runs import Shared

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup

RUNS = {SIM: (SIM,), RUN: (RUN,), "both": (RUN, SIM)}
LIMITS = {
    "drift_ratio": "peak_drift_ratio", "drift": "peak_drift_ratio", "drift_m": "peak_inter_storey_drift_m",
    "accel_m_s2": "peak_abs_accel_m_s2", "base_shear_n": "peak_building_base_shear_n", "ductility": "ductility",
}  # fmt: skip
"""What a limit may be on, by the last part of the metric's path; the largest of all storeys counts."""
STRIPES, HUNTED = 8, 24  # levels where none are stated
AROUND = 2.5  # times the level at which half of the records reach the first limit in SIM, and the same below it
DIGITS = 3  # of such levels


@dataclass(frozen=True)
class AskedIda:
    """What `rths ida` was asked: the case, the texts of --records, --measure, --levels (empty: by SIM), --limit, the
    runs, whether it hunts, and settings KEY=VALUE."""

    case: str
    records: str
    measure: str
    levels: str
    limits: tuple[str, ...]
    on: str
    hunt: bool
    settings: tuple[str, ...] = ()


def plan_ida(asked: AskedIda, shared: Shared) -> tuple[Planned, tuple[str, ...]]:
    """Return the rows of an analysis, and the settings of all of them; raises InputError with all faults."""
    faults = [f"--set {text}: is what rths ida varies; leave it out" for text in asked.settings if _is_ours(text)]
    limits = tuple(_limit(text, faults) for text in asked.limits)
    records = _record_axes(asked.records, faults)
    typed = (f"{LEVEL}={asked.levels}",) if asked.levels else ()
    wrong: list[str] = []
    levels = read_axes(typed, wrong)
    faults += [f"--levels{fault.removeprefix(f'--vary {LEVEL}')}" for fault in wrong]
    faults += [fault for axis in levels for fault in _level_faults(axis)]
    if faults:
        raise InputError(*faults)
    written = read_case(asked.case)
    settings = (*asked.settings, "scaling=1", f"record.scale_to={{measure: {asked.measure}, value: 1}}")
    points = Plan((records,), range(1))
    setup = shared.setup(_case(written, settings, points, 0))
    _check_limits(setup, limits)
    settings = (*settings, f"plausible={dump([*(setup.case.plausible or ()), 'scaling'])}")  # weak levels are meant
    count = HUNTED if asked.hunt else STRIPES
    level = levels[0] if levels else _found_levels(written, settings, points, limits[0], count)
    level = Axis(LEVEL, tuple(sorted(map(float, level.values))), "--levels")
    runs = RUNS[asked.on]
    period_s = first_period_s(setup.case) if asked.measure == "sa_t1" else 0.0
    about = About(asked.measure, OF_MEASURE[asked.measure], period_s, limits, runs, asked.hunt)
    plan = checked_plan(Plan((records, (level,)), range(1)))
    metrics = tuple(dict.fromkeys(f"{run}.{limit.metric}" for run in runs for limit in limits))
    name = f"{setup.case.name}-ida"
    told = {ABOUT: json.dumps(as_data(about))}
    return Planned(written, plan, True, metrics, name=name, about=told, sim_alone=runs == (SIM,)), settings


def _is_ours(setting: str) -> bool:
    key = setting.partition("=")[0].strip()
    return key in ("scaling", "record", FILE, COMPONENT) or key.startswith("record.scale_to")


def _limit(text: str, faults: list[str]) -> Limit:
    """Return the limit of NAME=VALUE; what is wrong with it is added to `faults`."""
    name, _, number = (part.strip() for part in text.partition("="))
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if name not in LIMITS:
        faults.append(f"--limit {text[:60]}: must be NAME=VALUE with one of {', '.join(LIMITS)}{near(name, LIMITS)}")
    elif not 0.0 < value < np.inf:
        faults.append(f"--limit {text[:60]}: the value must be a number > 0, as in {name}=0.02")
    return Limit(name, LIMITS.get(name, ""), value)


def _record_axes(text: str, faults: list[str]) -> Block:
    """Return the axes that name the records of a set, or of V1,V2,...: files, and components where they are stated."""
    try:
        if is_set(Path(text)):
            values = records_of(text, Path.cwd())
        else:
            wrong: list[str] = []
            values = tuple(value for axis in read_axes([f"{FILE}={text}"], wrong) for value in axis.values)
            faults += [f"--records{fault.removeprefix(f'--vary {FILE}')}" for fault in wrong]
    except InputError as error:
        faults += [f"--records {fault}" for fault in error.faults]
        return ()
    entries = [value if isinstance(value, dict) else {"file": value} for value in values]
    keys = list(dict.fromkeys(key for entry in entries for key in entry))
    if any(set(entry) != set(keys) for entry in entries):
        faults.append(f"--records {text}: every line must state the same keys, {', '.join(keys)}")
        return ()
    return tuple(Axis(f"record.{key}", tuple(entry[key] for entry in entries), "--records") for key in keys)


def _level_faults(axis: Axis) -> list[str]:
    numbers = axis.numbers()
    if numbers is None or not np.all(numbers > 0.0):
        return ["--levels: every level must be a number > 0"]
    return [] if numbers.size > 1 else ["--levels: give at least two levels, LOW:HIGH:COUNT or V1,V2,..."]


def _case(written: WrittenCase, settings: Sequence[str], plan: Plan, point: int) -> Any:
    return load_written(written, PlacedSettings(settings), PlacedSettings(plan.settings(point)))


def _check_limits(setup: Setup, limits: Sequence[Limit]) -> None:
    """Raise InputError for a limit on what the building does not have."""
    building, faults = setup.building, []
    for limit in limits:
        if limit.metric == "peak_drift_ratio" and building.heights_m is None:
            faults.append(
                f"--limit {limit.name}={limit.value:g}: needs heights_m in the structure; add it, or limit drift_m"
            )
        if limit.metric == "ductility" and building.linear:
            faults.append(f"--limit {limit.name}={limit.value:g}: no storey of this building has a law; limit drift_m")
    if faults:
        raise InputError(*faults)


def _found_levels(written: WrittenCase, settings: Sequence[str], records: Plan, limit: Limit, count: int) -> Axis:
    """Return levels in even ratios around that at which SIM of half of the records reaches a limit, as if the building
    were linear."""
    shared, reached = Shared((), lambda _: None), []
    for point in range(records.points):
        setup = shared.setup(_case(written, settings, records, point))
        found = response_metrics(SIM, setup.building, sim_of(setup, SharedValues()))
        reached.append(limit.value / float(np.nanmax(found[f"{SIM}.{limit.metric}"])))
    spread = np.geomspace(1.0 / AROUND, AROUND, count)
    return Axis(LEVEL, tuple(float(f"{level:.{DIGITS}g}") for level in np.median(reached) * spread), "--levels")
