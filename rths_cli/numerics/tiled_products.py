"""Matrix times vector in compiled code, in tiles of four rows.

Each product and the sum that takes it are one instruction with one rounding, where the processor has it.
"""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.compiled import fused_part, part
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


@fused_part
def product(tiles: Array, columns: int, given: Array, made: Array) -> None:
    """Write matrix times vector, its first columns only: tiles (n_tiles, >= columns, 4), made (4 n_tiles,).

    Even and odd columns are summed apart, so that a sum waits for the one before it half as often.
    """
    for tile in range(tiles.shape[0]):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        first_odd, second_odd, third_odd, fourth_odd = 0.0, 0.0, 0.0, 0.0
        for pair in range(columns >> 1):
            j = 2 * pair
            value, odd = given[j], given[j + 1]
            first += tiles[tile, j, 0] * value
            second += tiles[tile, j, 1] * value
            third += tiles[tile, j, 2] * value
            fourth += tiles[tile, j, 3] * value
            first_odd += tiles[tile, j + 1, 0] * odd
            second_odd += tiles[tile, j + 1, 1] * odd
            third_odd += tiles[tile, j + 1, 2] * odd
            fourth_odd += tiles[tile, j + 1, 3] * odd
        if columns & 1:
            j = columns - 1
            value = given[j]
            first += tiles[tile, j, 0] * value
            second += tiles[tile, j, 1] * value
            third += tiles[tile, j, 2] * value
            fourth += tiles[tile, j, 3] * value
        made[ROWS * tile] = first + first_odd
        made[ROWS * tile + 1] = second + second_odd
        made[ROWS * tile + 2] = third + third_odd
        made[ROWS * tile + 3] = fourth + fourth_odd


@fused_part
def product_of_four(columns: Array, given: Array) -> tuple[float, float, float, float]:
    """Return a matrix of four rows and columns times a vector (4,): columns (4, 4), the first index the column."""
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    for j in range(ROWS):
        value = given[j]
        first += columns[j, 0] * value
        second += columns[j, 1] * value
        third += columns[j, 2] * value
        fourth += columns[j, 3] * value
    return first, second, third, fourth


def squares(matrix: Array) -> Array:
    """Return a matrix (rows, columns) as squares (row tiles, column tiles, 16), column by column, zeros at the ends."""
    full = np.zeros((padded(matrix.shape[0]), padded(matrix.shape[1])))
    full[: matrix.shape[0], : matrix.shape[1]] = matrix
    high, wide = full.shape[0] // ROWS, full.shape[1] // ROWS
    return np.ascontiguousarray(full.reshape(high, ROWS, wide, ROWS).transpose(0, 2, 3, 1)).reshape(high, wide, 16)


@fused_part
def product_of_squares(tiles: Array, wide: int, given: Array, made: Array) -> None:
    """Write matrix times vector, its first column tiles only: given (>= wide, 4), made (row tiles, 4).

    Where zeros at the ends cost little this is faster than `product`: its loops end more seldom.
    """
    for tile in range(tiles.shape[0]):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        first_odd, second_odd, third_odd, fourth_odd = 0.0, 0.0, 0.0, 0.0
        for j in range(wide):
            value = given[j, 0]
            first += tiles[tile, j, 0] * value
            second += tiles[tile, j, 1] * value
            third += tiles[tile, j, 2] * value
            fourth += tiles[tile, j, 3] * value
            value = given[j, 1]
            first_odd += tiles[tile, j, 4] * value
            second_odd += tiles[tile, j, 5] * value
            third_odd += tiles[tile, j, 6] * value
            fourth_odd += tiles[tile, j, 7] * value
            value = given[j, 2]
            first += tiles[tile, j, 8] * value
            second += tiles[tile, j, 9] * value
            third += tiles[tile, j, 10] * value
            fourth += tiles[tile, j, 11] * value
            value = given[j, 3]
            first_odd += tiles[tile, j, 12] * value
            second_odd += tiles[tile, j, 13] * value
            third_odd += tiles[tile, j, 14] * value
            fourth_odd += tiles[tile, j, 15] * value
        made[tile, 0] = first + first_odd
        made[tile, 1] = second + second_odd
        made[tile, 2] = third + third_odd
        made[tile, 3] = fourth + fourth_odd


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
