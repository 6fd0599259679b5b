"""Oracle: scipy.optimize, and functions whose zeros and maxima are known."""

import math
from collections.abc import Callable

import pytest
from scipy.optimize import brentq, minimize_scalar

from rths_cli.numerics.root_finding import crossing, summit

FUNCTIONS: list[tuple[Callable[[float], float], float, float]] = [
    (lambda x: x**3 - 2.0, 0.0, 9.0),
    (lambda x: 2.0 - x**3, 0.0, 9.0),
    (lambda x: math.exp(x) - 1e6, -5.0, 40.0),
    (lambda x: math.atan(1e4 * (x - 0.3)), 0.0, 100.0),
    (lambda x: (x - 1.0) ** 9, 0.0, 3.7),
    (lambda x: x / (1.0 + x * x) - 0.3, 0.0, 1.0),
    (lambda x: math.copysign(1.0, x - 7.25), 0.0, 10.0),
]


@pytest.mark.parametrize("case", range(len(FUNCTIONS)))
def test_a_crossing_is_brents_in_few_steps(case: int) -> None:
    function, low, high = FUNCTIONS[case]
    calls = []

    def counted(x: float) -> float:
        assert low <= x <= high
        calls.append(x)
        return function(x)

    found = crossing(counted, low, high)
    width = 1e-2 if case == 4 else 1e-11  # a ninth power underflows around its zero
    assert found == pytest.approx(brentq(function, low, high, rtol=1e-12, maxiter=9999), rel=width)
    assert len(calls) < 90


def test_a_smooth_crossing_takes_a_dozen_steps() -> None:
    calls: list[float] = []
    crossing(lambda x: calls.append(x) or math.log(x / 3.0), 1.0, 9.5)  # type: ignore[func-returns-value]
    assert len(calls) <= 16


def test_ends_may_be_the_crossing_but_must_enclose_one() -> None:
    assert crossing(lambda x: x - 2.0, 2.0, 5.0) == 2.0
    assert crossing(lambda x: x - 5.0, 2.0, 5.0) == 5.0
    with pytest.raises(ValueError, match="no sign change between 3 and 5"):
        crossing(lambda x: x, 3.0, 5.0)
    with pytest.raises(ValueError, match="no sign change"):
        crossing(lambda x: math.nan, 3.0, 5.0)


@pytest.mark.parametrize("top", [0.0, 0.2, 1.0, 2.9, 3.0])
def test_the_greatest_value_is_where_scipy_finds_it(top: float) -> None:
    def hill(x: float) -> float:
        return 1.0 / (1.0 + (x - top) ** 2) + 0.05 * x

    expected = minimize_scalar(lambda x: -hill(x), bounds=(0.0, 3.0), method="bounded", options={"xatol": 1e-9})
    found = summit(hill, 0.0, 3.0)
    assert found == pytest.approx(expected.x, abs=1e-6)
    assert hill(found) == pytest.approx(-expected.fun, abs=1e-7)
