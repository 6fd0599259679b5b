"""Compiled recursion of SIM-DELAY: two linear parts, the force between them delayed.

Every derivative here is per substep (h d/dt).
"""

import math
from typing import NamedTuple

from rths_cli.compiled import entry, part
from rths_cli.lti import Array, Integers

_MOST_PASSES = 100
_SETTLED = 1e-14


class Part(NamedTuple):
    """A linear part and its state: over a substep y+ = E y + G inputs, output and its derivative are W y + V inputs.

    `band` (n, w) holds w neighbours of each row of E, from column `first` (n,) on: n in full, 2 in modal form. G is
    (n, .), W (2, n), V (2, .); state y (n,) and the next one `following` (n,).
    """

    band: Array
    first: Integers
    G: Array
    W: Array
    V: Array
    y: Array
    following: Array


class Scratch(NamedTuple):
    """Zeroed room of `integrate`: `ends` (6,) ground, its end, force and derivative, theirs at the end; `table` (4,)
    acceleration and derivative, theirs at the end; `now` (3,) ground, force, derivative; `force` (2,) of the specimen.
    """

    ends: Array
    table: Array
    now: Array
    force: Array


@part
def _advance(x: Part, inputs: Array) -> None:
    """Write the state a substep later to `following`."""
    for i in range(x.y.size):
        total = 0.0
        for j in range(x.band.shape[1]):
            total += x.band[i, j] * x.y[x.first[i] + j]
        for j in range(inputs.size):
            total += x.G[i, j] * inputs[j]
        x.following[i] = total


@part
def _read_out(x: Part, state: Array, inputs: Array, result: Array, place: int) -> None:
    """Write output and derivative at one instant to two places of `result`."""
    for i in range(2):
        total = 0.0
        for j in range(state.size):
            total += x.W[i, j] * state[j]
        for j in range(x.V.shape[1]):
            total += x.V[i, j] * inputs[j]
        result[place + i] = total


@part
def _past(history: Array, position: float) -> tuple[float, float]:
    """Return force and derivative at `position` (in substeps) by cubic Hermite, zero before the start."""
    if position <= 0.0:
        return 0.0, 0.0
    base = int(position)
    s = position - base
    start, end = base % history.shape[0], (base + 1) % history.shape[0]
    f0, d0, f1, d1 = history[start, 0], history[start, 1], history[end, 0], history[end, 1]
    c2 = 3.0 * (f1 - f0) - 2.0 * d0 - d1
    c3 = 2.0 * (f0 - f1) + d0 + d1
    return f0 + s * (d0 + s * (c2 + s * c3)), d0 + s * (2.0 * c2 + 3.0 * s * c3)


@part
def _keep(x: Part, result: Array, sample: int, place: int) -> None:
    """Write a state to its places in a row of `result`."""
    for i in range(x.y.size):
        result[sample, place + i] = x.y[i]


@part
def _pass(numerical: Part, specimen: Part, s: Scratch) -> None:
    """Carry both parts over a substep whose inputs at the end are assumed in `ends`: table and force there."""
    _advance(numerical, s.ends)
    s.now[0], s.now[1], s.now[2] = s.ends[1], s.ends[4], s.ends[5]
    _read_out(numerical, numerical.following, s.now, s.table, 2)
    _advance(specimen, s.table)
    _read_out(specimen, specimen.following, s.table[2:], s.force, 0)


@part
def _settle(x: Part) -> None:
    """Take the state a substep later as the state."""
    for i in range(x.y.size):
        x.y[i] = x.following[i]


@entry
def integrate(
    ground: Array,
    substeps: int,
    most: int,
    lag: float,
    force_limit: float,
    numerical: Part,
    specimen: Part,
    s: Scratch,
    history: Array,
    result: Array,
) -> int:
    """Advance both parts from rest; return the number of samples reached within the force limit and `most` substeps.

    `ground` (n,) in m/s^2, `lag` the delay in substeps. `numerical` takes [ground, ground+, f, f', f+,
    f'+], f in N being the delayed force, and gives the table's [a1, a1'] from [ground, f, f']; `specimen`
    takes [a1, a1', a1+, a1'+] and gives [f, f'] from [a1, a1']. `history` (lag + 3 or more, 2) is a zeroed
    ring; `result` (n, n_states + 1) takes the states of both and the delayed force at every sample. When
    lag < 1 the force is iterated until it agrees with its own history.
    """
    states = numerical.y.size + specimen.y.size
    largest = 0.0
    s.now[0] = ground[0]
    _read_out(numerical, numerical.y, s.now, s.table, 2)
    _read_out(specimen, specimen.y, s.table[2:], s.force, 0)
    history[0, 0], history[0, 1] = s.force[0], s.force[1]
    for i in range(states + 1):
        result[0, i] = 0.0
    new, step = 0, 0
    for sample in range(ground.shape[0] - 1):
        if step + substeps > most:
            return sample + 1
        rise = (ground[sample + 1] - ground[sample]) / substeps
        for inner in range(substeps):
            step += 1
            new = 0 if new + 1 == history.shape[0] else new + 1
            s.ends[0], s.ends[1] = ground[sample] + rise * inner, ground[sample] + rise * (inner + 1)
            s.ends[2], s.ends[3] = s.ends[4], s.ends[5]
            s.table[0], s.table[1] = s.table[2], s.table[3]
            history[new, 0], history[new, 1] = s.force[0] + s.force[1], s.force[1]
            for _ in range(_MOST_PASSES):
                s.ends[4], s.ends[5] = _past(history, step - lag)
                _pass(numerical, specimen, s)
                change = abs(s.force[0] - history[new, 0]) + abs(s.force[1] - history[new, 1])
                largest = max(largest, abs(s.force[0]))
                history[new, 0], history[new, 1] = s.force[0], s.force[1]
                if lag >= 1.0 or change <= _SETTLED * largest or not math.isfinite(change):
                    break
            if not abs(s.force[0]) <= force_limit:
                return sample + 1
            _settle(numerical)
            _settle(specimen)
        _keep(numerical, result, sample + 1, 0)
        _keep(specimen, result, sample + 1, numerical.y.size)
        result[sample + 1, states] = s.ends[4]
    return ground.shape[0]
