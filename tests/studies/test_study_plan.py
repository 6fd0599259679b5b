"""From a study file to its rows: every kind of axis, combinations, constraints, and where its names start."""

from __future__ import annotations

import itertools
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest

from rths_cli.case.load import PlacedSettings, load_written
from rths_cli.errors import InputError
from rths_cli.studies.study_plan import Asked, Planned, read_plan

STIFF, FRICTION = "table.after_identification.specimen_stiffness_factor", "table.after_identification.coulomb_factor"
SERIES = "# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{k % 7}.5" for k in range(300)) + "\n"
SAMPLED = f"""
axes:
  {STIFF}: {{distribution: lognormal, median: 1.0, cov: 0.2}}
  {FRICTION}: {{distribution: uniform, low: 0.5, high: 2}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a case, and with two records in a folder of it."""
    (tmp_path / "suite").mkdir()
    for name in ("b.csv", "a.txt"):
        (tmp_path / "suite" / name).write_text(SERIES)
    (tmp_path / "suite" / "notes.txt").write_text("no record\n")
    (tmp_path / "own.csv").write_text(SERIES)
    case = "structure: three_storey\ndamping: low\nrecord: own\nscaling: 0.3\ncontroller: FF+FB\n"
    (tmp_path / "mine.yaml").write_text(case)
    return tmp_path


def planned(folder: Path, text: str, vary: tuple[str, ...] = (), seeds: str | None = None) -> Planned:
    (folder / "s.yaml").write_text(f"case: mine\n{text}")
    return read_plan(Asked(str(folder / "s.yaml"), (), vary, seeds))


def faults(folder: Path, text: str, vary: tuple[str, ...] = ()) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        planned(folder, text, vary)
    return caught.value.faults


def test_lists_and_ranges_are_combined_the_last_fastest(folder: Path) -> None:
    text = (
        "axes:\n  controller: [FF, none]\n  table.converters.latency_samples: {start: 1, stop: 3, count: 3}\n"
        "  delay_s: {start: 0.001, stop: 0.1, count: 3, spacing: log}\nseeds: 2\n"
    )
    plan = planned(folder, text).plan
    assert plan.variants == 36 and list(plan.seeds) == [0, 1]
    wanted = list(itertools.product(("FF", "none"), (1, 2, 3), (0.001, 0.01, 0.1)))
    for point, values in enumerate(wanted):
        found = plan.values(point)
        assert found[:2] == values[:2] and type(found[1]) is int
        assert found[2] == pytest.approx(values[2], rel=1e-12)
    assert (plan.values(0)[2], plan.values(2)[2]) == (0.001, 0.1)


def test_samples_vary_together_and_are_combined_with_the_other_axes(folder: Path) -> None:
    text = f"{SAMPLED}  scaling: [0.2, 0.3]\nsamples: {{count: 10, seed: 4}}\n"
    plan = planned(folder, text).plan
    assert plan.points == 20
    by_scaling = [[plan.values(point) for point in range(20) if plan.values(point)[0] == s] for s in (0.2, 0.3)]
    assert [row[1:] for row in by_scaling[0]] == [row[1:] for row in by_scaling[1]]
    friction = sorted(row[2] for row in by_scaling[0])
    assert [int((value - 0.5) / 0.15) for value in friction] == list(range(10))


def test_the_same_seed_gives_the_same_rows(folder: Path) -> None:
    plans = [planned(folder, f"{SAMPLED}samples: {{count: 16, seed: {seed}}}\n").plan for seed in (4, 4, 5)]
    rows = [[plan.settings(point) for point in range(16)] for plan in plans]
    assert rows[0] == rows[1] and rows[0] != rows[2]
    assert plans[0].digest() == plans[1].digest() != plans[2].digest()


def test_every_row_meets_the_constraints_and_every_one_that_does_is_there(folder: Path) -> None:
    free = planned(folder, f"{SAMPLED}samples: {{count: 64, seed: 4}}\n").plan
    text = (
        f"constraints:\n  - {{left: {STIFF}, op: <, right: {FRICTION}, times: 0.8}}\n"
        f"  - {{left: 1.7, op: '>=', right: {FRICTION}}}\n"
    )
    plan = planned(folder, f"{SAMPLED}samples: {{count: 64, seed: 4}}\n{text}").plan
    rows = [free.values(point) for point in range(64)]
    wanted = [row for row in rows if row[0] < 0.8 * row[1] and row[1] <= 1.7]
    assert 5 < len(wanted) < 60 and [plan.values(point) for point in range(plan.points)] == wanted
    assert np.column_stack([column for _, column in plan.columns()]).tolist() == [list(row) for row in wanted]


def test_correlated_axes_are_ranked_alike(folder: Path) -> None:
    text = f"samples: {{method: sobol, count: 1024}}\ncorrelations: [{{between: [{FRICTION}, {STIFF}], rank: 0.9}}]\n"
    plan = planned(folder, SAMPLED + text).plan
    stiff, friction = (np.argsort(np.argsort(values)) for _, values in plan.columns())
    assert np.corrcoef(stiff, friction)[0, 1] == pytest.approx(0.9, abs=0.02)


def test_records_of_a_folder_are_an_axis_and_paths_start_at_the_study(folder: Path, tmp_path: Path) -> None:
    found = planned(folder, "axes: {record: {folder: suite}}\n")
    assert [found.plan.values(point) for point in range(2)] == [("suite/a.txt",), ("suite/b.csv",)]
    (tmp_path / "elsewhere").mkdir()
    with chdir(tmp_path / "elsewhere"):
        case = load_written(found.case, PlacedSettings(found.plan.settings(1), found.plan.folder))
    assert case.record.path == folder / "suite" / "b.csv"
    assert faults(folder, "axes: {record: {folder: nowhere}}\n")[0].endswith("nowhere; check the path")


def test_observed_values_come_from_a_list_or_a_column(folder: Path) -> None:
    (folder / "m.csv").write_text("k, f\n1.5, 0.1\n2.5, 0.2\n")
    text = (
        f"axes:\n  {STIFF}: {{distribution: empirical, file: m.csv, column: f}}\n"
        "  record: {distribution: empirical, values: [el_centro, hachinohe]}\nsamples: {method: sobol, count: 16}\n"
    )
    plan = planned(folder, text).plan
    values = [plan.values(point) for point in range(16)]
    for place, wanted in ((0, (0.1, 0.2)), (1, ("el_centro", "hachinohe"))):
        assert [sum(row[place] == one for row in values) for one in wanted] == [8, 8]
    assert "has no column 'g'; known: k, f" in faults(folder, text.replace("column: f", "column: g"))[0]
    (folder / "m.csv").write_text("k, f\n1.5, x\n")
    assert "m.csv:2: f must be a number, got 'x'" in faults(folder, text)[0]


def test_options_add_axes_and_replace_seeds(folder: Path) -> None:
    plan = planned(folder, "axes: {scaling: [0.2, 0.3]}\nseeds: 5\n", ("method=paper,best",), "7:8").plan
    assert plan.values(1) == ("paper", 0.3) and list(plan.seeds) == [7, 8]


def test_a_case_may_stand_in_the_study(folder: Path) -> None:
    (folder / "s.yaml").write_text(
        "case: {structure: three_storey, damping: low, record: own, scaling: 0.3, controller: FF}\n"
        "axes: {scaling: [0.2]}\n"
    )
    found = read_plan(Asked(str(folder / "s.yaml"), (), (), None))
    case = load_written(found.case, PlacedSettings(found.plan.settings(0), found.plan.folder))
    assert (case.name, case.scaling, case.record.path) == ("s", 0.2, folder / "own.csv") and found.own_seed


@pytest.mark.parametrize(
    ("text", "vary", "fault"),
    [
        ("axes: {seed: [1, 2]}\n", (), "s.yaml:2:8: axes.seed: is no key to vary; give --seeds, or seeds in a study"),
        ("axes: {scaling: [1]}\n", ("scaling=1,2",), "s.yaml:2:8: axes.scaling: is given twice"),
        ("axes: {table: [a], table.physics.coulomb_n: [1]}\n", (), "axes.table: holds table.physics.coulomb_n"),
        ("axes: {scaling: [1, 2]}\nconstraints: [{left: scaling, op: <, right: 0}]\n", (), "no row of 2 meets them"),
        (
            "axes: {method: [best]}\nconstraints: [{left: method, op: <, right: 0}]\n",
            (),
            "method has values that are no",
        ),
        ("axes: {scaling: {start: 0.1, stop: 1, count: 1000}}\nseeds: 1001\n", (), "1001000 runs"),
    ],
)
def test_what_is_no_plan_is_one_sentence(folder: Path, text: str, vary: tuple[str, ...], fault: str) -> None:
    (told,) = faults(folder, text, vary)
    assert fault in told


def test_a_case_that_is_not_found_is_a_fault_of_the_study(folder: Path) -> None:
    (folder / "s.yaml").write_text("case: mien\naxes: {scaling: [1, 2]}\n")
    with pytest.raises(InputError, match=r"^s\.yaml: case: mien: no case is called 'mien'"):
        read_plan(Asked(str(folder / "s.yaml"), (), (), None))


def test_a_value_that_cannot_be_read_is_told_once(folder: Path) -> None:
    (told,) = faults(folder, "axes: {scaling: [.inf]}\n")
    assert told.endswith("s.yaml:2:18: axes.scaling[1]: must be a finite number, got .inf")
