"""Tables of functions and the bell against the functions themselves."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tabulated_functions import FAR, FROM, FUNCTIONS, TO, bell, piece_of, read_four, table_of


@entry
def looked_up(table: Array, arguments: Array, four: int, values: Array) -> None:
    """Write four functions and their slopes (n, 8) of arguments (n,)."""
    table, arguments, values = borrowed((table, arguments, values))
    for k in range(arguments.size):
        read_four(table, piece_of(table, arguments[k]), arguments[k], four, values[k], 0)


@entry
def bells(arguments: Array, values: Array) -> None:
    """Write exp(-x^2) (n,) of arguments (n,)."""
    arguments, values = borrowed((arguments, values))
    for k in range(arguments.size):
        values[k] = bell(arguments[k])


def smooth(x: Array) -> Array:
    """Return seven functions (7, n)."""
    return np.array(
        [
            1.0 - 0.9 * np.exp(-3.0 * x),
            1.0 / (1.0 + x),
            (1.0 + 2.0 * x) ** -0.3,
            x,
            np.sqrt(2.0 + x),
            np.expm1(-x),
            x * x,
        ]
    )


@pytest.mark.campaign
@pytest.mark.parametrize("four", [0, 3])
def test_a_table_holds_values_and_slopes(four: int) -> None:
    scale, most = 6.0, 40.0
    table = table_of(smooth, scale, most)
    assert table[0, FROM] <= 0.0 and table[0, TO] == pytest.approx(most, rel=0.1)
    x = np.concatenate([np.linspace(0.0, 1.0, 500), np.linspace(1.0, 0.999 * table[0, TO], 500)])
    found, step = np.zeros((len(x), 8)), 1e-5 * (1.0 + x)
    looked_up(table, x, four, found)
    wanted, slopes = smooth(x), (smooth(x + step) - smooth(x - step)) / (2.0 * step)
    scales = np.maximum(np.abs(wanted), 1e-3 * (1.0 + x))
    assert (np.abs(found[:, :4].T - wanted[four : four + 4]) / scales[four : four + 4]).max() < 1e-10
    assert np.abs(scale * found[:, 4:].T - slopes[four : four + 4]).max() < 1e-6


@pytest.mark.campaign
def test_a_table_begins_where_it_is_exact_and_reads_an_end_beyond_it() -> None:
    def steep(x: Array) -> Array:
        return np.stack([1.0 / x] + [x] * (FUNCTIONS - 1))

    table = table_of(steep, 100.0, 10.0)
    assert 0.0 < table[0, FROM] < 1.0
    x = np.linspace(table[0, FROM], table[0, TO], 1000)
    found = np.zeros((1000, 8))
    looked_up(table, x, 0, found)
    np.testing.assert_allclose(found[:, 0], 1.0 / x, rtol=1e-10)
    beyond, guarded = np.zeros((6, 8)), np.vstack([table, np.full_like(table[:1], np.nan)])
    looked_up(guarded, np.array([-1e9, -1.0, 1e9, np.inf, -np.inf, np.nan]), 0, beyond)
    assert np.isnan(beyond[5]).any() and np.isfinite(beyond[1:3]).all()


def test_the_bell() -> None:
    x = np.concatenate([np.linspace(-7.0, 7.0, 3001), [FAR, -FAR, np.inf, -np.inf]])
    found = np.zeros(len(x))
    bells(x, found)
    assert np.abs(found - np.exp(-(x**2))).max() < 1e-12
    beyond = np.zeros(1)
    bells(np.array([np.nan]), beyond)
    assert beyond[0] == 0.0
