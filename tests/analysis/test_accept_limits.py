"""Limits on figures: which of a figure's values is judged, and where the edge is."""

from __future__ import annotations

import math

import pytest

from rths_cli.analysis.accept_limits import Judged, figure, judge


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


def test_what_is_not_a_number_meets_no_limit() -> None:
    found = judge("a.b", math.inf, [0.1, math.nan])
    assert found.value is not None and math.isnan(found.value) and not found.met
