"""Powers of the step, read from curves of short polynomials that are made before the run.

The force of a damper C abs(v)^p lowers the rate at which it acts within an instant: F = C v^p, v = rate - gives F, with
`gives` in m/s per N. Nothing in that equation changes during a run, so it is solved for all rates before, and the step
evaluates one polynomial: no power, no iteration, no memory. With C = 1 and gives = 0 the curve is a power alone.
The pieces of a curve grow with its argument, so that the bits of the argument are the number of its piece.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from rths_cli.numerics.compiled import fused_part
from rths_cli.numerics.lti import Array

TERMS = 7  # of a polynomial
EXACT = 1e-9  # of a curve, over its values, for powers from 0.001 on; from 0.3 to 3 it is 1e-13
PIECES = (16, 32, 64, 128, 256)  # per octave, the fewest that are exact
END = 1000.0  # of a curve at the earliest; beyond, it goes straight on
ROUNDS = 60  # of Newton's method before the run, at most
MANTISSA_BITS = 52  # of a float


@lru_cache(maxsize=64)
def power_curve(c: float, power: float, knee: float, gives: float) -> Array:
    """Return the curve (2 + pieces, 8) of the force F in N over a rate in m/s, for `on_curve`; all callers share it.

    `c` in N (s/m)^power; where v is below `knee`, in m/s, the force is a straight line. First row: the rates between
    which the pieces hold, force and slope at their end, and how the bits of a rate become the row of its piece. Then
    the straight line and the pieces, each as the rate of its middle and the coefficients of powers of the distance.
    """
    straight = c * knee ** (power - 1.0)
    first = knee * (1.0 + gives * straight)
    for pieces in PIECES:
        shift = MANTISSA_BITS - int(math.log2(pieces))
        begin, end = (int(np.float64(rate).view(np.int64)) >> shift for rate in (first, max(END, 2.0 * first)))
        edges = (np.arange(begin, end + 2) << shift).view(np.float64)
        rows, error = _polynomials(c, power, gives, edges)
        if error <= EXACT:
            break
    last = edges[-1]
    force = float(_forces(c, power, gives, last))
    slope = power * force / (last - gives * force)  # of F over v
    curve = np.zeros((2 + len(rows), TERMS + 1))
    curve[0, :4] = first, last, force, slope / (1.0 + gives * slope)
    curve[0, 4:6] = np.array([begin - 1, shift]).view(np.float64)  # integers, read as such
    curve[1, 2] = straight / (1.0 + gives * straight)
    curve[2:] = rows
    return curve


def _polynomials(c: float, power: float, gives: float, edges: Array) -> tuple[Array, float]:
    """Return the pieces between edges in m/s, rows of a curve, and their largest error at the edges, over the force."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = np.append(np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS), [-1.0, 1.0])  # Chebyshev's, then the edges
    forces = _forces(c, power, gives, middle[:, None] + half[:, None] * nodes)
    powers = np.vander(nodes, TERMS, increasing=True)
    coefficients = np.linalg.solve(powers[:TERMS], forces[:, :TERMS].T).T
    error = np.abs(coefficients @ powers[TERMS:].T / forces[:, TERMS:] - 1.0).max()
    return np.column_stack([middle, coefficients / half[:, None] ** np.arange(TERMS)]), float(error)


def _forces(c: float, power: float, gives: float, rates: Array) -> Array:
    """Return the forces F = c v^power, v = rate - gives F, by Newton's method for the logarithm of v.

    The logarithm of v + gives F is a convex function of it with slopes between 1 and the power: each start converges.
    """
    log_v = np.log(rates)
    for _ in range(ROUNDS):
        v, lost = np.exp(log_v), gives * c * np.exp(power * log_v)
        change = np.log((v + lost) / rates) * (v + lost) / (v + power * lost)
        log_v = log_v - change
        if np.abs(change).max() < 1e-14:
            break
    return np.asarray(c * np.exp(power * log_v))


@intrinsic
def bits_of(typingctx: Any, value: Any) -> Any:
    """Return the bits of a float as an integer, in compiled code."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@fused_part
def on_curve(curve: Array, rate: float) -> float:
    """Return the value of a curve, the force in N at a rate in m/s; odd, and NaN of NaN."""
    size = abs(rate)
    if not size < curve[0, 1]:
        return math.copysign(curve[0, 2] + curve[0, 3] * (size - curve[0, 1]), rate)
    beyond = (bits_of(size) >> bits_of(curve[0, 5])) - bits_of(curve[0, 4])
    row = np.uint64(
        1 + int(size > curve[0, 0]) * beyond
    )  # a branch would be taken without a rule where rates are small
    x = size - curve[row, 0]
    value = curve[row, TERMS]
    for i in range(TERMS - 1, 0, -1):
        value = value * x + curve[row, i]
    return math.copysign(value, rate)
