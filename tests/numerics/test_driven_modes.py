"""Oracle: the recursion itself."""

import numpy as np
import pytest

from rths_cli.numerics.lti import driven_modes


def test_modes_follow_their_recursion_from_rest() -> None:
    series = np.random.default_rng(5).normal(size=3000)
    poles = np.exp(np.array([-0.01 + 0.3j, -1e-4 - 0.02j, -0.5, 2.0j, -0.003 + 1.0j]))
    now, before = np.array([1.0, 2.0j, 0.3, -1.0, 0.0]), np.array([0.5j, 0.0, 1.0 - 1.0j, 0.2, 3.0])
    modes = driven_modes(poles, now, before, series)
    assert modes.shape == (2, 5, 3000)
    expected = np.zeros((5, 3000), dtype=complex)
    for k in range(1, 3000):
        expected[:, k] = poles * expected[:, k - 1] + now * series[k] + before * series[k - 1]
    rounding = 1e-12 * np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(modes[0] + 1j * modes[1] - expected) <= rounding).all()
    assert driven_modes(poles[0], now[0], before[0], series)[:, 0] == pytest.approx(modes[:, 0])
