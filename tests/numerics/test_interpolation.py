"""The monotone cubic against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from rths_cli.numerics.interpolation import monotone_curve
from rths_cli.numerics.lti import Array


def points(seed: int) -> tuple[Array, Array]:
    """Return points that rise, fall, rest and turn at every place, the ends included."""
    draw = np.random.default_rng(seed)
    y = np.cumsum(draw.choice([-1.0, 0.0, 0.3, 2.0, 9.0], 40))
    return np.cumsum(draw.uniform(0.01, 2.0, 40)), y


@pytest.mark.parametrize("seed", range(20))
def test_it_is_scipys(seed: int) -> None:
    x, y = points(seed)
    curve, oracle = monotone_curve(x, y), PchipInterpolator(x, y)
    shares = np.linspace(0.0, 1.0, 9)
    place = x[:-1, None] + np.diff(x)[:, None] * shares
    assert curve.on(shares) == pytest.approx(oracle(place), abs=1e-12 * np.abs(y).max())
    stretch, share = np.array([0, 7, 38]), np.array([0.3, 0.9, 0.5])
    assert curve.place(stretch, share) == pytest.approx(place[:, 0][stretch] + share * np.diff(x)[stretch])
    assert curve.at(stretch, share) == pytest.approx(oracle(curve.place(stretch, share)), abs=1e-12 * np.abs(y).max())


def test_a_steep_end_keeps_its_shape() -> None:
    """A parabola through the first three points would overshoot: three times the secant at most."""
    x, y = np.array([0.0, 1.0, 1.1, 2.0]), np.array([0.0, 1.0, -9.0, 3.0])
    assert monotone_curve(x, y).slope == pytest.approx(PchipInterpolator(x, y).derivative()(x))
    assert monotone_curve(x, y).slope[0] == pytest.approx(3.0)
