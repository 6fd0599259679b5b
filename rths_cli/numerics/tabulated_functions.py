"""Functions of one number, read in the step from polynomials that are made before the run: values and slopes.

A table holds up to seven smooth functions, for instance of the energy that a storey has dissipated, in pieces that grow
with their argument. A row is a piece: for each power eight columns, so that four functions take one instruction.
`bell` is exp(-x^2).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rths_cli.numerics.compiled import fused_part, part
from rths_cli.numerics.lti import Array
from rths_cli.numerics.power_curves import MANTISSA_BITS, TERMS, bits_of

FUNCTIONS, COLUMNS = 7, 8  # of each power in a row; the last column of the first power holds the middle of the piece
EXACT = 1e-12  # of a function, over its largest value in the piece
PIECES = (16, 32, 64, 128)  # per octave of 1 + scale times the argument, the fewest that are exact
FROM, TO, SCALE, BEGIN, SHIFT, LAST = range(6)  # places in the first row
FAR, PER_ONE = 6.25, 16  # the bell is below 1.1e-17 beyond; pieces per one


def table_of(functions: Callable[[Array], Array], scale: float, most: float) -> Array:
    """Return the table (1 + pieces, TERMS COLUMNS) of functions, which return (FUNCTIONS, n) of arguments (n,).

    First row: the arguments between which the table is exact, `scale`, and how the bits of 1 + scale times an argument
    become the number of its piece, and the last of these. The table begins at -0.5 / scale and ends at about `most`,
    but where a function is too steep for the smallest pieces it is exact from the next larger arguments on.
    """
    for pieces in PIECES:
        shift = MANTISSA_BITS - int(math.log2(pieces))
        begin, end = (int(np.float64(x).view(np.int64)) >> shift for x in (0.5, 1.0 + scale * most))
        edges = (np.arange(begin, end + 2) << shift).view(np.float64)
        middle, coefficients, exact = _polynomials(functions, scale, edges)
        if exact[edges[:-1] >= 1.0].all():
            break
    first = 0 if exact.all() else len(exact) - int(np.argmin(exact[::-1]))  # after the last that is not
    table = np.zeros((1 + len(middle), TERMS * COLUMNS))
    table[0, : SCALE + 1] = (edges[first] - 1.0) / scale, (edges[-2] - 1.0) / scale, scale
    table[0, BEGIN : LAST + 1] = np.array([begin, shift, len(middle) - 1]).view(np.float64)  # integers, read as such
    rows = table[1:].reshape(len(middle), TERMS, COLUMNS)
    rows[first:, :, :FUNCTIONS] = coefficients[:, first:].transpose(1, 2, 0)
    rows[:, 0, FUNCTIONS] = middle
    return table


def _polynomials(functions: Callable[[Array], Array], scale: float, edges: Array) -> tuple[Array, Array, Array]:
    """Return the middles (n,) of pieces between edges, the coefficients (FUNCTIONS, n, TERMS) of powers of the distance
    from them, and whether all are exact (n,)."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = np.append(_nodes(), [-1.0, 1.0])
    x = middle[:, None] + half[:, None] * nodes
    with np.errstate(all="ignore"):  # where a function has no value, nothing is exact
        values = functions(((x - 1.0) / scale).ravel()).reshape(FUNCTIONS, *x.shape)
        powers = np.vander(nodes, TERMS, increasing=True)
        coefficients = values[..., :TERMS] @ np.linalg.inv(powers[:TERMS]).T
        error = np.abs(coefficients @ powers[TERMS:].T - values[..., TERMS:]).max(axis=2)
        exact = (error <= EXACT * np.abs(values).max(axis=2)).all(axis=0)
    return middle, coefficients / half[:, None] ** np.arange(TERMS), exact


def _nodes() -> Array:
    """Return Chebyshev's nodes."""
    return np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)


@part
def piece_of(table: Array, argument: float) -> int:
    """Return the row of a table for an argument; the first or the last one beyond its ends, and for NaN."""
    piece = (bits_of(1.0 + table[0, SCALE] * argument) >> bits_of(table[0, SHIFT])) - bits_of(table[0, BEGIN])
    return 1 + max(0, min(piece, bits_of(table[0, LAST])))


@fused_part
def read_four(table: Array, piece: int, argument: float, four: int, values: Array, place: int) -> None:
    """Write four functions of an argument, then their slopes over `scale`, into `values` from `place` on: those from
    column `four` on of a row of the table."""
    row = np.uint64(piece)  # numba counts negative ones from the end, which takes time
    d = 1.0 + table[0, SCALE] * argument - table[row, FUNCTIONS]
    last = (TERMS - 1) * COLUMNS + four
    first, second, third, fourth = table[row, last], table[row, last + 1], table[row, last + 2], table[row, last + 3]
    slope, second_slope, third_slope, fourth_slope = first, second, third, fourth
    for i in range(1, TERMS):
        at = last - i * COLUMNS
        first = first * d + table[row, at]
        second = second * d + table[row, at + 1]
        third = third * d + table[row, at + 2]
        fourth = fourth * d + table[row, at + 3]
        if i < TERMS - 1:
            slope = slope * d + first
            second_slope = second_slope * d + second
            third_slope = third_slope * d + third
            fourth_slope = fourth_slope * d + fourth
    values[place], values[place + 1], values[place + 2], values[place + 3] = first, second, third, fourth
    values[place + 4], values[place + 5] = slope, second_slope
    values[place + 6], values[place + 7] = third_slope, fourth_slope


@fused_part
def bell(x: float) -> float:
    """Return exp(-x^2) within 1e-12, zero beyond FAR and for NaN."""
    size = abs(x)
    if not size < FAR:
        return 0.0
    row = np.uint64(int(size * PER_ONE))
    d = size - BELL[row, 0]
    value = BELL[row, TERMS]
    for i in range(TERMS - 1, 0, -1):
        value = value * d + BELL[row, i]
    return value


def _bell() -> Array:
    """Return the pieces of the bell, each as its middle and the coefficients of powers of the distance."""
    half = 0.5 / PER_ONE
    middle = (np.arange(round(FAR * PER_ONE)) + 0.5) / PER_ONE
    values = np.exp(-((middle[:, None] + half * _nodes()) ** 2))
    coefficients = np.linalg.solve(np.vander(_nodes(), TERMS, increasing=True), values.T).T
    return np.ascontiguousarray(np.column_stack([middle, coefficients / half ** np.arange(TERMS)]))


BELL = _bell()
