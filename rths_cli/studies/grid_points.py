"""The case of each grid point: all are read and checked before the first run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rths_cli.case.keys_without_effect import without_effect
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.unit_plausibility import unit_doubts
from rths_cli.studies.sweep_grid import Grid, read_grid

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.studies.sweep_runs import Keys, Shared

SWEPT_RUNS = ("exp_rths",)
LISTED = 20  # faults shown of a grid, the rest counted
FAULTY = 1000  # grid points at fault after which the others are not read


@dataclass(frozen=True)
class Asked:
    """The case of a sweep, settings KEY=VALUE, the texts of --vary, and that of --seeds (None: the case's own)."""

    path: str
    settings: tuple[str, ...]
    vary: tuple[str, ...]
    seeds: str | None


@dataclass(frozen=True)
class Points:
    """A checked grid: its case without what is varied, the order to make the points in (neighbours share most), the
    most storeys of any, the hash of all that the runs' figures depend on, and a sentence for each doubt on units."""

    base: Setup
    grid: Grid
    order: tuple[int, ...]
    storeys: int
    sha256: str
    doubts: tuple[str, ...] = ()


def point_case(asked: Asked, grid: Grid, point: int) -> Case:
    """Return the case of a grid point; raises InputError with its faults."""
    return load_cases([asked.path], (*asked.settings, *grid.settings(point)))[0]


def check_points(asked: Asked, shared: Shared, progress: Progress) -> Points:
    """Read and check every point of the grid; raises InputError with every fault and the point it is at."""
    grid = read_grid(asked.vary, asked.seeds, own_seed=0)
    stages: list[Keys] = []
    digest, storeys = hashlib.sha256(), 0
    first: Setup | None = None
    unread: dict[str, str] | None = None
    doubts: dict[str, list[str]] = {}
    for setup in _setups(asked, grid, shared, progress):
        stages.append(shared.keys(setup))
        digest.update(repr((stages[-1].content, setup.record_sha256, sorted(setup.case.accept.items()))).encode())
        unread = _still_unread(unread, setup.case, grid)
        for doubt in unit_doubts(setup):
            doubts.setdefault(doubt.rpartition(": ")[2], []).append(doubt)  # by its question
        storeys, first = max(storeys, setup.case.n_storeys), first or setup
    assert first is not None  # a grid has a point
    if unread:
        changes = "changes nothing in a sweep"
        raise InputError(*(f"--vary {key}: {changes}, {why}; vary what does" for key, why in unread.items()))
    if asked.seeds is None:
        grid = replace(grid, seeds=range(first.case.seed, first.case.seed + 1))
    digest.update(repr((grid, first.overrides)).encode())
    told = tuple(_doubt(each, grid) for each in doubts.values())
    return Points(_base(asked, shared, first), grid, _order(stages), storeys, digest.hexdigest(), told)


def _doubt(same: Sequence[str], grid: Grid) -> str:
    """Return the first of the doubts with one question, and how many grid points raise it where not all do."""
    return same[0] if len(same) == grid.points else f"{same[0]} (at {len(same)} of {grid.points} grid points)"


def _setups(asked: Asked, grid: Grid, shared: Shared, progress: Progress) -> Iterator[Setup]:
    """Yield the setup of every grid point; raise InputError with all faults in the end, or when there are very many."""
    faults: dict[str, list[int]] = {}
    for point in range(grid.points):
        progress(f"reading grid point {point + 1} of {grid.points}")
        try:
            yield shared.setup(point_case(asked, grid, point))
        except InputError as error:
            for fault in error.faults:
                faults.setdefault(_as_varied(fault, grid), []).append(point)
            if sum(map(len, faults.values())) >= FAULTY:
                break
    if faults:
        raise InputError(*_told(faults, grid))


def _still_unread(before: dict[str, str] | None, case: Case, grid: Grid) -> dict[str, str]:
    """Return the varied keys that neither this point nor those before it read, with the reason."""
    found = without_effect(case, (axis.key for axis in grid.axes), SWEPT_RUNS)
    return found if before is None else {key: why for key, why in found.items() if key in before}


def _base(asked: Asked, shared: Shared, first: Setup) -> Setup:
    """Return the case without what is varied, or the first point where it needs a varied key to be one."""
    try:
        return shared.setup(load_cases([asked.path], asked.settings)[0])
    except InputError:
        return first


def _order(keys: Sequence[Keys]) -> tuple[int, ...]:
    """Return the points so that those which share a model, then a design, then a check are neighbours."""
    stages = [(key.model, key.design, key.check) for key in keys]
    ranks: list[dict[str, int]] = [{} for _ in stages[0]]
    ranked = [tuple(rank.setdefault(key, len(rank)) for rank, key in zip(ranks, one, strict=True)) for one in stages]
    return tuple(sorted(range(len(stages)), key=lambda point: ranked[point]))


def _as_varied(fault: str, grid: Grid) -> str:
    """Return a fault with --vary as its source where a varied key is at fault."""
    for axis in grid.axes:
        fault = fault.replace(f"--set {axis.key}:", f"--vary {axis.key}:")
    return fault


def _told(faults: dict[str, list[int]], grid: Grid) -> Iterator[str]:
    """Yield each fault once, with the first grid point it is at and how many more."""
    for fault, points in list(faults.items())[:LISTED]:
        others = f" and {len(points) - 1} more" if len(points) > 1 else ""
        yield fault if len(points) == grid.points else f"{fault} (at grid point {grid.label(points[0])}{others})"
    if len(faults) > LISTED:
        yield f"{len(faults) - LISTED} more faults are not shown; correct these first"
