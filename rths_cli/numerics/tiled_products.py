"""Matrix times vector in compiled code, in tiles of four rows."""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array

ROWS = 4


def padded(count: int) -> int:
    """Return the next multiple of four."""
    return -(-count // ROWS) * ROWS


def tiled(matrix: Array) -> Array:
    """Return a matrix (rows, columns) as tiles (n_tiles, columns, 4), zero rows added at the end."""
    rows, columns = matrix.shape
    count = -(-rows // ROWS)
    padded = np.zeros((count * ROWS, columns))
    padded[:rows] = matrix
    return np.ascontiguousarray(padded.reshape(count, ROWS, columns).transpose(0, 2, 1))


@part
def product(tiles: Array, columns: int, given: Array, made: Array) -> None:
    """Write matrix times vector, its first columns only: tiles (n_tiles, >= columns, 4), made (4 n_tiles,)."""
    for tile in range(tiles.shape[0]):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        for j in range(columns):
            value = given[j]
            first += tiles[tile, j, 0] * value
            second += tiles[tile, j, 1] * value
            third += tiles[tile, j, 2] * value
            fourth += tiles[tile, j, 3] * value
        made[ROWS * tile] = first
        made[ROWS * tile + 1] = second
        made[ROWS * tile + 2] = third
        made[ROWS * tile + 3] = fourth


def squares(matrix: Array) -> Array:
    """Return a matrix (rows, columns) as squares (row tiles, column tiles, 16), column by column, zeros at the ends."""
    full = np.zeros((padded(matrix.shape[0]), padded(matrix.shape[1])))
    full[: matrix.shape[0], : matrix.shape[1]] = matrix
    high, wide = full.shape[0] // ROWS, full.shape[1] // ROWS
    return np.ascontiguousarray(full.reshape(high, ROWS, wide, ROWS).transpose(0, 2, 3, 1)).reshape(high, wide, 16)


@part
def product_of_squares(tiles: Array, wide: int, given: Array, made: Array) -> None:
    """Write matrix times vector, its first column tiles only: given (>= wide, 4), made (row tiles, 4).

    Where zeros at the ends cost little this is faster than `product`: its loops end more seldom.
    """
    for tile in range(tiles.shape[0]):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        for j in range(wide):
            value = given[j, 0]
            first += tiles[tile, j, 0] * value
            second += tiles[tile, j, 1] * value
            third += tiles[tile, j, 2] * value
            fourth += tiles[tile, j, 3] * value
            value = given[j, 1]
            first += tiles[tile, j, 4] * value
            second += tiles[tile, j, 5] * value
            third += tiles[tile, j, 6] * value
            fourth += tiles[tile, j, 7] * value
            value = given[j, 2]
            first += tiles[tile, j, 8] * value
            second += tiles[tile, j, 9] * value
            third += tiles[tile, j, 10] * value
            fourth += tiles[tile, j, 11] * value
            value = given[j, 3]
            first += tiles[tile, j, 12] * value
            second += tiles[tile, j, 13] * value
            third += tiles[tile, j, 14] * value
            fourth += tiles[tile, j, 15] * value
        made[tile, 0] = first
        made[tile, 1] = second
        made[tile, 2] = third
        made[tile, 3] = fourth


@part
def copied(count: int, source: Array, target: Array) -> None:
    """Copy the first values; adding zero keeps the compiler from calling memmove for so few."""
    for i in range(count):
        target[i] = source[i] + 0.0


@part
def shifted(values: Array) -> None:
    """Move every value one place down; the last stays."""
    for i in range(values.size - 1):
        values[i] = values[i + 1] + 0.0
