"""The virtual table's inner steps: exact responses over one of them, as tiles for the compiled kernel."""

from __future__ import annotations

import pickle
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rths_cli.lti import Array
from rths_cli.matrices import exponential
from rths_cli.tiles import ROWS, padded, squares, tiled


class Parts(NamedTuple):
    """The table with its sensors: n states, of which the mechanical ones come first."""

    a: Array  # (n, n)
    b: Array  # (n, 3) tanh(v / v_s), clip(F_ref) - F_ref, command
    mechanical: int
    rows: Array  # (2, mechanical) v and F_ref from the state
    row_command: Array  # (2,) the same from the command
    velocity_rows: Array  # (c, n) absolute velocities of table and floors
    scale: Array  # (2,) what v and F_ref are multiplied with


class Level(NamedTuple):
    """Arrays of one inner step, as in Plant."""

    push: Array
    filters: Array
    nodes: Array
    feed: Array


def levels(parts: Parts, interval_s: float, count: int) -> tuple[Level, ...]:
    """Return the arrays of `count` levels of inner steps, each half as long as those before, the first an interval.

    They are kept: the runs of a case, and its variants by seed or gain, are on the same table.
    """
    return _levels(pickle.dumps(parts), interval_s, count)


@lru_cache(maxsize=64)
def _levels(pickled: bytes, interval_s: float, count: int) -> tuple[Level, ...]:
    """Make the levels; the end of one level's step is the middle of that before, and one exponential serves both."""
    parts: Parts = pickle.loads(pickled)
    times = [interval_s / 2**k for k in range(count + 1)]
    moved = [_moved(parts, time_s) for time_s in times]
    return tuple(_level(parts, times[k], moved[k + 1], moved[k]) for k in range(count))


def _level(parts: Parts, step_s: float, middle: Array, last: Array) -> Level:
    """Return the arrays of inner steps of this length from the augmented exponentials of half a step and a whole."""
    n, first = parts.mechanical, len(parts.a) - (len(parts.a) - parts.mechanical) // 2
    wide = np.zeros((2, len(parts.a)))
    wide[:, :n] = parts.scale[:, None] * parts.rows
    halfway, half_response = parabola_response(parts, middle, step_s)
    end, response = parabola_response(parts, last, step_s)
    offsets = [
        np.column_stack([wide @ moved[:, :n], wide @ moves[:, 2].sum(axis=1) + parts.scale * parts.row_command])
        for moved, moves in ((halfway, half_response), (end, response))
    ]
    middle_velocities = parts.velocity_rows @ _columns(halfway, half_response, n)
    return Level(
        push=squares(np.vstack([_columns(end, response, n), middle_velocities])),
        filters=np.array([end[n, n], end[first, first], end[first, n]]),
        nodes=tiled(np.array([offsets[0][0], offsets[1][0], offsets[0][1], offsets[1][1]])),
        feed=np.array([np.einsum("wn,nsj->wsj", wide, moves[:, :2]) for moves in (half_response, response)]),
    )


def _columns(moved: Array, moves: Array, mechanical: int) -> Array:
    """Return the response (n, columns) to mechanical state, command, and both nonlinearities at three nodes each."""
    first = padded(mechanical + 1)
    columns = np.zeros((len(moved), first + 2 * ROWS))
    columns[:, :mechanical], columns[:, mechanical] = moved[:, :mechanical], moves[:, 2].sum(axis=1)
    columns[:, first : first + 3], columns[:, first + ROWS : first + ROWS + 3] = moves[:, 0], moves[:, 1]
    return columns


def velocities(states: int, floors: int) -> Array:
    """Return the rows (1 + floors, states) of the absolute velocities of table and floors."""
    rows = np.zeros((1 + floors, states))
    rows[:, 1] = 1.0
    rows[1:, 3 + floors : 3 + 2 * floors] = np.eye(floors)
    return rows


def parabola_response(parts: Parts, moved: Array, step_s: float) -> tuple[Array, Array]:
    """Return exp(A t) (n, n) and the response at t to b times a parabola over [0, step] by its values, (n, m, 3).

    The parabola is given at 0, step / 2 and step; `moved` is the augmented exponential of t.
    """
    n, m = parts.b.shape
    moments = moved[:n, n:].reshape(n, 3, m)
    lagrange = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [4.0, -8.0, 4.0]])
    lagrange /= step_s ** np.arange(3)[:, None]
    return moved[:n, :n], np.einsum("nim,ij->nmj", moments, lagrange)


def _moved(parts: Parts, time_s: float) -> Array:
    """Return the exponential of the system augmented with the powers 1, s, s^2 / 2 of time, (n + 3 m, n + 3 m)."""
    n, m = parts.b.shape
    chain = np.zeros((n + 3 * m, n + 3 * m))
    chain[:n, :n] = parts.a
    chain[:n, n : n + m] = parts.b
    chain[n : n + m, n + m : n + 2 * m] = np.eye(m)
    chain[n + m : n + 2 * m, n + 2 * m :] = np.eye(m)
    return exponential(chain * time_s)
