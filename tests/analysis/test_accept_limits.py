"""Limits on figures: which of a figure's values is judged, and where the edge is."""

from __future__ import annotations

import math

import pytest

from rths_cli.analysis.grade import Judged, figure, judge


@pytest.mark.parametrize(
    ("path", "values", "judged", "met"),
    [
        ("a.b", 0.5, 0.5, True),
        ("a.b", -0.5, -0.5, True),
        ("a.b", -0.6, -0.6, False),  # a signed figure is limited either way
        ("a.b", [0.1, -0.7, 0.3], -0.7, False),  # the largest of several storeys
        ("a.b[1]", [0.1, -0.7, 0.3], 0.1, True),
        ("a.b[3]", [0.1, -0.7, 0.3], 0.3, True),
        ("a.b[4]", [0.1, -0.7, 0.3], None, False),
        ("a.b[0]", [0.1, -0.7, 0.3], None, False),
        ("a.b", [], None, False),
    ],
)
def test_the_value_that_a_limit_of_one_half_judges(
    path: str, values: float | list[float], judged: float | None, met: bool
) -> None:
    assert judge(path, 0.5, values) == Judged(path, 0.5, judged, met)
    assert figure(path) == "a.b"


@pytest.mark.parametrize(
    ("path", "values", "judged", "met"),
    [
        ("exp_rths.ductility", [2.0, math.nan, 3.0], 3.0, True),  # storeys without a yield drift have none
        ("exp_rths.ductility", [2.0, math.nan, 5.0], 5.0, False),
        ("exp_rths.residual_drift_m", [-5.0, math.nan], -5.0, False),
        ("exp_rths.ductility[1]", [2.0, math.nan], 2.0, True),
    ],
)
def test_of_a_figure_that_not_every_storey_has_those_that_have_it_count(
    path: str, values: list[float], judged: float, met: bool
) -> None:
    assert judge(path, 4.0, values) == Judged(path, 4.0, judged, met)


@pytest.mark.parametrize("path", ["exp_rths.ductility", "exp_rths.ductility[2]"])
def test_a_storey_without_the_figure_meets_no_limit(path: str) -> None:
    found = judge(path, math.inf, [math.nan, math.nan])
    assert found.value is not None and math.isnan(found.value) and not found.met


def test_what_is_not_a_number_meets_no_limit() -> None:
    found = judge("a.b", math.inf, [0.1, math.nan])
    assert found.value is not None and math.isnan(found.value) and not found.met
