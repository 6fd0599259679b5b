"""Studies without runs: functions whose Sobol indices are known, sampled by a study, and a table of made-up rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rths_cli.files.durable_files import stamp
from rths_cli.files.sweep_file import RowsFile, Sweep, read_sweep, rows_path, write_sweep
from rths_cli.report.sweep_page import page
from rths_cli.studies.grid_points import Points, check_points
from rths_cli.studies.plan import Plan
from rths_cli.studies.sensitivity import SobolIndices, sobol_indices
from rths_cli.studies.study_plan import Asked, read_plan
from rths_cli.studies.sweep_output import Begun, as_line, as_sweep
from rths_cli.studies.sweep_runs import Shared
from rths_cli.studies.sweep_table import Row, Table, width

Array = NDArray[np.float64]
CASE = "case: el_centro_low_ff_fb\n"
FACTORS = "table.after_identification.{}"
G = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0])


@dataclass(frozen=True)
class Known:
    """A function of samples (n, axes), the ends of its uniform axes, and its first-order and total indices (axes,)."""

    of: Callable[[Array], Array]
    low: float
    high: float
    first: Array
    total: Array


def ishigami() -> Known:
    """Return the function of Ishigami and Homma (1990) with a = 7, b = 0.1; indices as derived there."""
    a, b = 7.0, 0.1
    parts = np.array([0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 0.0])
    both = b**2 * np.pi**8 * (1 / 18 - 1 / 50)  # of axes 1 and 3 together
    whole = parts.sum() + both
    total = (parts + np.array([both, 0.0, both])) / whole

    def of(x: Array) -> Array:
        return np.asarray(np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0]))

    return Known(of, -np.pi, np.pi, parts / whole, total)


def sobol_g() -> Known:
    """Return Sobol's g function of eight axes with a = 0, 1, 4.5, 9, 99, 99, 99, 99 (Saltelli and Sobol, 1995)."""
    parts = 1 / (3 * (1 + G) ** 2)
    whole = np.prod(1 + parts) - 1
    total = np.array([parts[k] * np.prod(1 + np.delete(parts, k)) for k in range(len(G))])

    def of(x: Array) -> Array:
        return np.asarray(np.prod((np.abs(4 * x - 2) + G) / (1 + G), axis=1))

    return Known(of, 0.0, 1.0, parts / whole, total / whole)


def sampled_indices(known: Known, count: int, seed: int, folder: Path) -> SobolIndices:
    """Return the indices of a function at the rows that a study file plans for them."""
    axes = len(known.first)
    keys = [FACTORS.format(f"x{k}") for k in range(axes)]
    each = "".join(f"  {key}: {{distribution: uniform, low: {known.low!r}, high: {known.high!r}}}\n" for key in keys)
    samples = f"samples: {{method: sobol_indices, count: {count}, seed: {seed}}}\n"
    path = folder / "indices.yaml"
    path.write_text(f"{CASE}axes:\n{each}{samples}", encoding="utf-8")
    columns = dict(read_plan(Asked(str(path), (), (), None)).plan.columns())
    return sobol_indices(known.of(np.column_stack([columns[key] for key in keys])), axes, seed)


def deviations(found: SobolIndices, known: Known) -> Array:
    """Return how many standard errors the indices (2, axes) are off the known ones."""
    first = (found.first - known.first) / found.first_error
    return np.array([first, (found.total - known.total) / found.total_error])


@dataclass(frozen=True)
class Tabulated:
    """A study of made-up rows: its plan, and its table as it was written and read back."""

    plan: Plan
    sweep: Sweep
    text: str


def one_point() -> Points:
    """Return the checked plan of one case, from which that of a synthetic study is made."""
    return check_points(Asked("el_centro_low_ff_fb", (), (), None), Shared((), lambda _: None), lambda _: None)


def tabulate(rows: int, folder: Path, alone: Points) -> Tabulated:
    """Plan `rows` rows (a multiple of 8) of four correlated samples and two lists, go through all of them, fill, write
    and read the table, and return its page."""
    points = planned(rows, folder, alone)
    table = filled(points, np.arange(points.plan.variants))
    begun = Begun(folder / "many.h5", about(points), False)
    sweep = as_sweep(points, begun, table)
    assert write_sweep(begun.path, sweep, stamp(begun.path)) == begun.path
    del table, sweep
    back = read_sweep(begun.path)
    return Tabulated(points.plan, back, page(back, begun.path))


def written_parts(rows: int, count: int, folder: Path, alone: Points) -> list[Path]:
    """Write the table of `tabulate` in parts, and return their files."""
    points = planned(rows, folder, alone)
    paths = [folder / f"part{k}.h5" for k in range(1, count + 1)]
    for k, (path, variants) in enumerate(zip(paths, np.array_split(np.arange(rows), count), strict=True), 1):
        begun = Begun(path, about(points) | {"part": f"{k}/{count}"}, False)
        assert write_sweep(path, as_sweep(points, begun, filled(points, variants), variants), stamp(path)) == path
    return paths


def kept_rows(rows: int, folder: Path, alone: Points) -> tuple[Begun, Table]:
    """Write the rows of an interrupted sweep of all but ten rows; return that sweep and a table for its rows."""
    points = planned(rows, folder, alone)
    begun = Begun(folder / "kept.h5", about(points), True)
    with RowsFile(rows_path(begun.path), begun.attributes, False) as file:
        for variant in range(rows - 10):
            file.append(as_line(made_up(points, variant)))
    return begun, Table(points.columns, points.storeys, np.arange(rows))


def planned(rows: int, folder: Path, alone: Points) -> Points:
    """Return the plan of `tabulate`."""
    whole = "table.after_identification.coulomb_factor"
    study = folder / "many.yaml"
    study.write_text(
        f"{CASE}axes:\n  controller: [FF, FF+FB]\n  record: [el_centro, hachinohe]\n"
        f"  {whole}: {{distribution: lognormal, median: 1.0, cov: 0.3}}\n"
        f"  {FACTORS.format('specimen_stiffness_factor')}: {{distribution: normal, mean: 1, std: 0.1}}\n"
        "  scaling: {distribution: uniform, low: 0.1, high: 0.5}\n"
        "  kalman.q: {distribution: truncated_normal, mean: 1e3, std: 100, low: 500, high: 2000}\n"
        f"samples: {{count: {rows // 8}, seed: 1}}\n"
        f"correlations: [{{between: [{whole}, scaling], rank: 0.4}}]\n"
        f"constraints: [{{left: {whole}, op: '>', right: 0}}]\nseeds: 2\n",
        encoding="utf-8",
    )
    read = read_plan(Asked(str(study), (), (), None))
    return replace(alone, plan=read.plan, planned=read, order=np.arange(read.plan.points))


def about(points: Points) -> dict[str, str | int]:
    """Return the attributes of a synthetic study."""
    identity = {"plan_sha256": points.plan.digest(), "software_sha256": "", "grid_points": points.plan.points}
    return {"case_name": "many", "rig": "r", "rig_kind": "virtual", "seeds": "0:1"} | identity


def filled(points: Points, variants: NDArray[np.int64]) -> Table:
    """Return a table with a made-up row for each of these runs (n,) of a plan."""
    table = Table(points.columns, points.storeys, variants)
    for variant in variants.tolist():
        table.add(made_up(points, variant))
    return table


def made_up(points: Points, variant: int) -> Row:
    """Return the row of a run: every tenth is refused, with one of 50 reasons."""
    seeds = len(points.plan.seeds)
    values, refused = points.plan.values(variant // seeds), variant % 10 == 0
    size = width(points.columns, points.storeys)
    figures = np.full(size, np.nan if refused else values[2] * (1 + variant % seeds))
    status, reason = ("refused", f"unsafe: reason {variant % 499 // 10}") if refused else ("complete", "")
    return Row(variant, status, reason, int(refused), "unsafe" if refused else "safe", "0" * 64, "", figures)
