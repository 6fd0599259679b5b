"""One table defines every figure: whatever a run can write stands in it, with the unit it is written in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rths_cli.analysis import budget as causes_of_budget
from rths_cli.analysis import prediction
from rths_cli.metrics.catalogue import KINDS, catalogue, define
from rths_cli.report.formats.reference import reference_page
from rths_cli.workflows import budget, check_figures, figures, merit

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_every_figure_that_a_case_may_limit_is_defined() -> None:
    paths = {**figures.of_runs(), **check_figures.paths(), **budget.paths()}
    assert len(paths) > 140
    assert [path for path in paths if define(path) is None] == []
    several = {path for path in paths if paths[path]}
    assert {path for path in paths if define(path).over in ("storey", "mode", "channel")} == several  # type: ignore[union-attr]


def test_units_are_those_that_are_written() -> None:
    rng = np.random.default_rng(1)
    desired, measured, true = rng.normal(size=(3, 4000))
    storeys = rng.normal(size=(3, 4000))
    written = figures.tracking("exp_rths", desired, measured, true, 5e-4)
    written |= figures.against_sim("exp_rths", storeys, storeys + 0.1, storeys + 0.2, 5e-4)
    written |= merit.fidelity("exp_rths", desired, measured, true, 5e-4)
    written |= merit.response("exp_rths", storeys, storeys + measured, 1, 5e-4)
    written |= merit.energy("exp_rths", desired, measured, true, desired, 2.0, 5e-4)
    assert len(written) > 40
    for path, metric in written.items():
        found = define(path)
        assert found is not None and found.units == metric.units, path
        number = metric.definition[:3]
        assert not number.startswith("J") or found.text.startswith(number), path


def test_causes_are_those_of_the_budgets() -> None:
    for group, names in (
        ("check", prediction.CAUSES),
        ("budget", [*causes_of_budget.ABOUT, causes_of_budget.LOST, causes_of_budget.DRIFT]),
    ):
        expected = {f"{group}.rms_error_{name}_m_s2" for name in names}
        found = {one.path for one in catalogue() if one.path.startswith(f"{group}.rms_error_")}
        assert found - {f"{group}.rms_error_m_s2"} == expected


def test_a_path_is_defined_once_and_a_kind_only_where_it_exists() -> None:
    paths = [one.path for one in catalogue()]
    assert len(paths) == len(set(paths))
    assert define("exp_rths.j1_s_true") is None and define("nothing.at_all") is None
    found = define("exp_rths.rms_error_m_s2_true_full")
    assert found is not None and found.text.endswith(KINDS["_true_full"]) and found.units == "m/s^2"


def test_the_reference_page_is_the_generated_one() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference_page(), (
        "write rths_cli.report.formats.reference.reference_page()"
    )
