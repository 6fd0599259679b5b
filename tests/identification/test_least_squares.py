"""Least squares against closed forms and another method: the same minimum, whatever the scale, within bounds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares as scipys

from rths_cli.identification.least_squares import Function, covariance, least_squares, linear, parts

TIME = np.linspace(0.0, 4.0, 60)
SCALES = (np.ones(4), np.array([1e-8, 1e6, 1e3, 1e-3]))


def rosenbrock(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return residual and slopes of a curved valley whose minimum is (1, 1)."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([[-20.0 * x[0], -1.0], [10.0, 0.0]])


def powell(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return residual and slopes of Powell's function, singular at its minimum 0."""
    a, b = x[1] - 2.0 * x[2], x[0] - x[3]
    residual = np.array([x[0] + 10.0 * x[1], np.sqrt(5.0) * (x[2] - x[3]), a * a, np.sqrt(10.0) * b * b])
    slopes = np.zeros((4, 4))
    slopes[:2, 0], slopes[2:, 1] = (1.0, 10.0), (np.sqrt(5.0), -np.sqrt(5.0))
    slopes[1:3, 2], slopes[[0, 3], 3] = (2.0 * a, -4.0 * a), (np.sqrt(40.0) * b, -np.sqrt(40.0) * b)
    return residual, slopes


def decays(scale: np.ndarray) -> Function:
    """Return the fit of two decays to noisy samples, its parameters in units of `scale` (4,)."""
    noise = 1e-2 * np.random.default_rng(3).standard_normal(len(TIME))
    measured = 3.0 * np.exp(-0.7 * TIME) + 1.0 * np.exp(-4.0 * TIME) + noise

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, p, b, q = x / scale
        first, second = np.exp(-p * TIME), np.exp(-q * TIME)
        slopes = np.array([first, -a * TIME * first, second, -b * TIME * second])
        return a * first + b * second - measured, slopes / scale[:, None]

    return function


def by_trust_region(function: Function, start: np.ndarray) -> np.ndarray:
    """Return the minimum that another method finds: scipy's trust region."""
    found = scipys(
        lambda x: function(x)[0], start, lambda x: function(x)[1].T, method="trf", x_scale="jac",
        xtol=1e-14, ftol=1e-14, gtol=None, max_nfev=1000,
    )  # fmt: skip
    return np.asarray(found.x)


@pytest.mark.parametrize("start", [(-1.2, 1.0), (30.0, -20.0), (-5.0, 400.0)])
def test_a_curved_valley_is_followed_to_its_end(start: tuple[float, float]) -> None:
    found = least_squares(rosenbrock, np.array(start), 1e-12)
    assert found.parameters == pytest.approx([1.0, 1.0], abs=1e-8)


def test_a_singular_minimum_is_reached() -> None:
    found = least_squares(powell, np.array([3.0, -1.0, 0.0, 1.0]), 1e-12)
    assert found.size < 1e-12


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("start", [(2.0, 1.0, 2.0, 3.0), (1.0, 0.1, 1.0, 9.0), (9.0, 0.5, -3.0, 6.0)])
def test_decays_are_those_that_another_method_finds(scale: np.ndarray, start: tuple[float, ...]) -> None:
    function, first = decays(scale), np.array(start) * scale
    found = least_squares(function, first, 1e-12, 300)
    assert found.parameters == pytest.approx(by_trust_region(function, first), rel=1e-6)


@pytest.mark.parametrize("scale", SCALES[1:])
def test_units_change_nothing(scale: np.ndarray) -> None:
    start = np.array([2.0, 1.0, 2.0, 3.0])
    plain = least_squares(decays(np.ones(4)), start).parameters
    assert least_squares(decays(scale), start * scale).parameters / scale == pytest.approx(plain, rel=1e-9)


def test_a_point_is_evaluated_once_for_residual_and_slopes() -> None:
    start, calls = np.array([1.0, 0.1, 1.0, 9.0]), [0]

    def counted(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls[0] += 1
        return decays(np.ones(4))(x)

    least_squares(counted, start)
    function = decays(np.ones(4))
    reference = scipys(
        lambda x: function(x)[0], start, lambda x: function(x)[1].T, method="lm", x_scale="jac", ftol=1e-8
    )
    assert calls[0] <= reference.nfev + 1


def test_no_more_evaluations_than_allowed() -> None:
    calls = [0]

    def counted(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls[0] += 1
        return rosenbrock(x)

    before = least_squares(counted, np.array([-1.2, 1.0]), evaluations=7).size
    assert 7 <= calls[0] <= 8  # the slopes at the result may take one more
    assert before < np.linalg.norm(rosenbrock(np.array([-1.2, 1.0]))[0])


def forbidden(bad: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return x - 3 with slopes that ask for too long steps, into x > 4 where the residual is `bad`."""

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([bad]) if x[0] > 4.0 else x - 3.0), np.array([[0.3]])

    return function


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_steps_to_where_nothing_is_known_are_not_taken(bad: float) -> None:
    assert least_squares(forbidden(bad), np.array([2.0])).parameters == pytest.approx([3.0], abs=1e-6)


def test_a_start_where_nothing_is_known_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite at the start"):
        least_squares(forbidden(np.nan), np.array([5.0]))


def test_a_parameter_without_effect_stays_where_it_is() -> None:
    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.append(rosenbrock(x[:2])[0], 0.5), np.pad(rosenbrock(x[:2])[1], ((0, 1), (0, 1)))

    found = least_squares(function, np.array([-1.2, 1.0, 7.0]), 1e-12)
    assert found.parameters == pytest.approx([1.0, 1.0, 7.0], abs=1e-8)


def test_covariance_is_that_of_the_normal_equations() -> None:
    slopes = np.random.default_rng(0).standard_normal((3, 40)) * np.array([[1e-6], [1.0], [1e5]])
    expected = 0.25 * np.linalg.inv(slopes @ slopes.T)
    assert covariance(slopes, 0.25) == pytest.approx(expected, rel=1e-9)
    blind = np.vstack([slopes[:2], slopes[1] * 3.0])
    assert np.diag(covariance(blind, 0.25))[1:].min() > 1e10 * expected[1, 1]


def test_linear_least_squares_are_numpys() -> None:
    random = np.random.default_rng(1)
    slopes, wanted = random.standard_normal((4, 50)), random.standard_normal(50)
    assert linear(slopes, wanted) == pytest.approx(np.linalg.lstsq(slopes.T, wanted, rcond=None)[0], rel=1e-10)


def test_what_slopes_do_not_determine_is_left_alone() -> None:
    random = np.random.default_rng(2)
    slope, wanted = random.standard_normal(50), random.standard_normal(50)
    share = float(slope @ wanted / (slope @ slope))
    assert linear(np.array([slope, 3.0 * slope]), wanted) == pytest.approx([0.5 * share, share / 6.0], rel=1e-9)


def test_parts_keep_the_sum_of_squares() -> None:
    values = np.array([[1.0 + 2.0j, 3.0], [0.0, -4.0j]])
    assert parts(values).tolist() == [[1.0, 2.0, 3.0, 0.0], [0.0, 0.0, 0.0, -4.0]]


def test_a_parameter_that_nothing_determines_ends_at_its_reach() -> None:
    """exp(p) beyond any number would overflow: e^p / (1 + e^p) falls short of 1 the less, the larger p is."""

    def towards_one(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        grown = np.exp(x[0])
        return np.array([grown / (1.0 + grown) - 1.0, x[1] - 3.0]), np.array(
            [[grown / (1.0 + grown) ** 2, 0.0], [0.0, 1.0]]
        )

    with np.errstate(all="raise"):
        found = least_squares(towards_one, np.array([0.0, 0.0]), 1e-14, 2000, reach=np.array([5.0, 10.0]))
    assert found.parameters == pytest.approx([5.0, 3.0])


def test_a_reach_that_is_not_needed_changes_nothing() -> None:
    free, held = (least_squares(rosenbrock, np.array([-1.2, 1.0]), 1e-12, reach=reach) for reach in (np.inf, 50.0))
    assert np.array_equal(free.parameters, held.parameters)


def test_a_step_beyond_the_reach_does_not_end_the_search() -> None:
    """From 3 the linear model leads to -1.7, beyond the bound -1, where the residual is smaller than at 3."""

    def bent(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        under = 1.0 + x**2
        return x / under**0.2, (1.0 / under**0.2 - 0.4 * x**2 / under**1.2)[None]

    assert least_squares(bent, np.array([3.0]), reach=4.0).parameters == pytest.approx([0.0], abs=1e-8)


def test_a_parameter_at_its_reach_does_not_hold_the_others_and_is_never_evaluated_beyond_it() -> None:
    def valley_and_slope(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert abs(x[2]) <= 2.0
        fallen = np.exp(-x[2])
        residual, slopes = rosenbrock(x[:2])
        return np.append(residual, fallen), np.block([[slopes, np.zeros((2, 1))], [np.zeros(2), -fallen]])

    found = least_squares(valley_and_slope, np.array([-1.2, 1.0, 0.0]), 1e-12, reach=np.array([50.0, 50.0, 2.0]))
    assert found.parameters == pytest.approx([1.0, 1.0, 2.0], abs=1e-8)
