"""Products in tiles, compiled, against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.numerics.compiled import entry
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import (
    copied,
    padded,
    product,
    product_of_four,
    product_of_squares,
    shifted,
    squares,
    tiled,
)


@entry
def by_tiles(tiles: Array, columns: int, given: Array, made: Array) -> None:
    product(tiles, columns, given, made)


@entry
def by_squares(tiles: Array, wide: int, given: Array, made: Array) -> None:
    product_of_squares(tiles, wide, given, made)


@entry
def by_four(columns: Array, given: Array, made: Array) -> None:
    made[0], made[1], made[2], made[3] = product_of_four(columns, given)


@entry
def moved(source: Array, target: Array, queue: Array) -> None:
    copied(3, source, target)
    shifted(queue)


@pytest.mark.campaign
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 2), (4, 4), (5, 9), (13, 7), (16, 12), (0, 3), (2, 0)])
def test_products_are_numpys(rows: int, columns: int) -> None:
    random = np.random.default_rng(rows + 20 * columns)
    matrix, given = random.standard_normal((rows, columns)), random.standard_normal(columns)
    made = np.full(padded(rows), np.nan)
    by_tiles(tiled(matrix), columns, given, made)
    np.testing.assert_allclose(made[:rows], matrix @ given, rtol=1e-13, atol=1e-14)
    assert np.all(made[rows:] == 0.0)
    wide, square = np.zeros((padded(columns) // 4, 4)), np.full((padded(rows) // 4, 4), np.nan)
    wide.reshape(-1)[:columns] = given
    by_squares(squares(matrix), len(wide), wide, square)
    np.testing.assert_allclose(square.reshape(-1)[:rows], matrix @ given, rtol=1e-13, atol=1e-14)
    assert np.all(square.reshape(-1)[rows:] == 0.0)


def test_four_rows_and_columns_are_numpys() -> None:
    random = np.random.default_rng(6)
    matrix, given, made = random.standard_normal((4, 4)), random.standard_normal(4), np.zeros(4)
    by_four(np.ascontiguousarray(matrix.T), given, made)
    np.testing.assert_allclose(made, matrix @ given, rtol=1e-13, atol=1e-14)


def test_a_product_takes_the_first_columns_only() -> None:
    random = np.random.default_rng(4)
    matrix, given = random.standard_normal((6, 12)), random.standard_normal(12)
    made, square = np.zeros(8), np.zeros((2, 4))
    by_tiles(tiled(matrix), 5, given, made)
    np.testing.assert_allclose(made[:6], matrix[:, :5] @ given[:5], rtol=1e-13)
    by_squares(squares(matrix), 2, given.reshape(-1, 4), square)
    np.testing.assert_allclose(square.reshape(-1)[:6], matrix[:, :8] @ given[:8], rtol=1e-13)


def test_the_first_values_are_copied_and_a_queue_moves_on() -> None:
    source, target, queue = np.arange(5.0), np.full(5, -1.0), np.array([1.0, 2.0, 3.0])
    moved(source, target, queue)
    assert target.tolist() == [0.0, 1.0, 2.0, -1.0, -1.0]
    assert queue.tolist() == [2.0, 3.0, 3.0]
