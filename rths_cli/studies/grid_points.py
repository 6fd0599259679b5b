"""The case of each point of a plan: all are read and checked before the first run."""

from __future__ import annotations

import hashlib
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rths_cli.case.keys_without_effect import without_effect
from rths_cli.case.load import PlacedSettings, load_written
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import baseline_note
from rths_cli.experiment.true_reference import is_another
from rths_cli.experiment.unit_plausibility import unit_doubts
from rths_cli.rigs.from_case import laboratory_follows_seed
from rths_cli.studies.plan import Plan
from rths_cli.studies.study_plan import Asked, Planned, read_plan
from rths_cli.studies.sweep_table import kept_columns

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.studies.sweep_runs import Keys, Shared
    from rths_cli.studies.sweep_table import Column

SWEPT_RUNS = ("exp_rths",)
LISTED = 20  # faults shown of a plan, the rest counted
FAULTY = 1000  # points at fault after which the others are not read


@dataclass(frozen=True)
class Points:
    """A checked plan: what was asked, its case without what is varied, the rows, the metrics that are kept of each,
    the order (n_points,) to make the points in (neighbours share most), the most storeys of any, the hash of all that
    the runs' figures depend on, and a sentence for each doubt on units."""

    asked: Asked
    planned: Planned
    base: Setup
    plan: Plan
    columns: tuple[Column, ...]
    order: NDArray[np.int64]
    storeys: int
    sha256: str
    doubts: tuple[str, ...] = ()

    def case(self, point: int) -> Case:
        """Return the case of a point; raises InputError with its faults."""
        return _point_case(self.asked, self.planned, point)


def check_points(asked: Asked, shared: Shared, progress: Progress, planned: Planned | None = None) -> Points:
    """Read and check every point of the plan, that of what is asked unless it is given; raises InputError with every
    fault and the point it is at."""
    planned = planned or read_plan(asked)
    plan, has_laws, has_truth = planned.plan, False, False
    kept_columns(planned.metrics, planned.study)  # an unknown metric is told before the points are read
    stages = _Stages()
    digest, storeys = hashlib.sha256(), 0
    first: Setup | None = None
    unread: dict[str, str] | None = None
    doubts: dict[str, list[str]] = {}
    own = False
    for setup in _setups(asked, planned, shared, progress):
        own = own or laboratory_follows_seed(setup.case)
        keys = shared.keys(setup)
        stages.add(keys)
        digest.update(repr((keys.content, setup.record_sha256, sorted(setup.case.accept.items()))).encode())
        unread = _still_unread(unread, setup.case, plan)
        for doubt in unit_doubts(setup):
            doubts.setdefault(str(doubt.values["question"]), []).append(str(doubt))
        for doubt in baseline_note(setup):
            doubts.setdefault(setup.case.record.name, []).append(str(doubt))
        storeys, first = max(storeys, setup.building.storeys), first or setup
        has_laws, has_truth = has_laws or not setup.building.linear, has_truth or is_another(setup)
    assert first is not None  # a plan has a point
    if unread:
        names = {axis.key: axis.name for axis in plan.axes}
        raise InputError(
            *(f"{names[key]}: changes nothing in a sweep, {why}; vary {_instead(key)}" for key, why in unread.items())
        )
    if planned.own_seed:
        plan = replace(plan, seeds=range(first.case.seed, first.case.seed + 1))
    columns = kept_columns(planned.metrics, planned.study, has_laws, has_truth)
    if own and plan.seeds != range(first.case.seed, first.case.seed + 1):
        raise InputError(
            f"seeds: another seed is another laboratory of rig {first.rig.name}, with an identification of its own; "
            "state table.imperfections.laboratory for seeds in one laboratory, or vary that key"
        )
    digest.update(repr((plan.digest(), [column.path for column in columns], first.overrides)).encode())
    if planned.about:
        digest.update(repr(sorted(planned.about.items())).encode())
    base, told = _base(asked, planned, shared, first), tuple(_doubt(each, plan) for each in doubts.values())
    return Points(asked, planned, base, plan, columns, stages.order(), storeys, digest.hexdigest(), told)


def _doubt(same: Sequence[str], plan: Plan) -> str:
    """Return the first of the doubts with one question, and how many grid points raise it where not all do."""
    return same[0] if len(same) == plan.points else f"{same[0]} (at {len(same)} of {plan.points} grid points)"


def _point_case(asked: Asked, planned: Planned, point: int) -> Case:
    varied = PlacedSettings(planned.plan.settings(point), planned.plan.folder)
    return load_written(planned.case, PlacedSettings(asked.settings), varied)


def _setups(asked: Asked, planned: Planned, shared: Shared, progress: Progress) -> Iterator[Setup]:
    """Yield the setup of every point; raise InputError with all faults in the end, or when there are very many."""
    faults: dict[str, tuple[str, list[int]]] = {}
    plan = planned.plan
    for point in range(plan.points):
        progress(f"reading grid point {point + 1} of {plan.points}")
        try:
            yield shared.setup(_point_case(asked, planned, point))
        except InputError as error:
            for fault in error.faults:
                told = _as_varied(fault, plan)
                faults.setdefault(_kind(told, plan), (told, []))[1].append(point)
            if sum(len(points) for _, points in faults.values()) >= FAULTY:
                break
    if faults:
        raise InputError(*_told(list(faults.values()), plan))


def _instead(key: str) -> str:
    """Return what to vary instead of a key that changes nothing."""
    if key == "delay_s":
        return "table.converters.latency_samples, by which the table answers later"
    return "another key (rths schema case lists them)"


def _still_unread(before: dict[str, str] | None, case: Case, plan: Plan) -> dict[str, str]:
    """Return the varied keys that neither this point nor those before it read, with the reason."""
    found = without_effect(case, (axis.key for axis in plan.axes), SWEPT_RUNS)
    return found if before is None else {key: why for key, why in found.items() if key in before}


def _base(asked: Asked, planned: Planned, shared: Shared, first: Setup) -> Setup:
    """Return the case without what is varied, or the first point where it needs a varied key to be one."""
    try:
        return shared.setup(load_written(planned.case, PlacedSettings(asked.settings)))
    except InputError:
        return first


class _Stages:
    """What each point shares with others, stage by stage: eight bytes of a hash of each stage, for a million points."""

    def __init__(self) -> None:
        self._keys = tuple(array("Q") for _ in range(3))

    def add(self, keys: Keys) -> None:
        """Take note of the next point."""
        for known, key in zip(self._keys, (keys.model, keys.design, keys.check), strict=True):
            known.append(int(key[:16], 16))

    def order(self) -> NDArray[np.int64]:
        """Return the points so that those which share a model, then a design, then a check are neighbours."""
        return np.lexsort([_first_met(keys) for keys in reversed(self._keys)])


def _first_met(keys: array[int]) -> NDArray[np.int64]:
    """Return of each key (n,) the place where it is met first."""
    _, first, where = np.unique(np.frombuffer(keys, dtype=np.uint64), return_index=True, return_inverse=True)
    return np.asarray(first[where])


def _as_varied(fault: str, plan: Plan) -> str:
    """Return a fault with the axis as its source where a varied key is at fault."""
    for axis in plan.axes:
        fault = fault.replace(f"--set {axis.key}:", f"{axis.name}:")
    return fault


def _kind(fault: str, plan: Plan) -> str:
    """Return what tells a fault from others: of a sampled axis, its sentence without the sample's value."""
    sampled = any(axis.sampled and fault.startswith(axis.name) for axis in plan.axes)
    return re.sub(r"got [^;]*", "got", fault) if sampled else fault


def _told(faults: list[tuple[str, list[int]]], plan: Plan) -> Iterator[str]:
    """Yield each fault once, with the first point it is at and how many more."""
    for fault, points in faults[:LISTED]:
        others = f" and {len(points) - 1} more" if len(points) > 1 else ""
        yield fault if len(points) == plan.points else f"{fault} (at grid point {plan.label(points[0])}{others})"
    if len(faults) > LISTED:
        yield f"{len(faults) - LISTED} more faults are not shown; correct these first"
