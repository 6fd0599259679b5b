"""The arithmetic of one step in C, block by block, from the sizes of its arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

TILE = 4  # rows that a product computes at once, zero rows included


class Operations(NamedTuple):
    """Operations of a block in one step: a multiplication with the addition that takes it, other additions and
    comparisons, divisions and functions (tanh, floor, sqrt)."""

    products: int
    others: int
    functions: int = 0

    def __add__(self, other: object) -> Operations:  # type: ignore[override]
        """Return the sum of two blocks."""
        assert isinstance(other, Operations)
        return Operations(*(one + two for one, two in zip(self, other, strict=True)))


def product_of(rows: int, columns: int) -> Operations:
    """Return the operations of a matrix times a vector, as rths_step.c computes it."""
    whole = -(-rows // TILE) * TILE
    return Operations(whole * columns, whole)


def operations(sizes: Mapping[str, int], counters_friction: bool) -> dict[str, Operations]:
    """Return the operations of each block, with the most that a step without a fault takes; storey laws, whose work
    depends on the drift, count by their products alone."""
    n = sizes
    channels, accelerometers = n["ACCELEROMETERS"] + n["FURTHER"], n["ACCELEROMETERS"]
    states, laws = 2 * n["PAIRS"], n["LAW_STOREYS"]
    columns, observed = states + 2 + laws, n["OBSERVER_STATES"] + n["ESTIMATES"] + 1
    floors = n["FLOOR_STATES"] + n["EXPECTED_FLOORS"]
    friction = Operations(4, 0, 1) if counters_friction else Operations(0, 0)
    cell = Operations(3, 3) if n["CELL"] >= 0 else Operations(0, 0)
    blocks = {
        "sense": Operations(16 * channels, 0) + Operations(2, 3) + cell
        + product_of(observed, n["OBSERVER_STATES"] + n["OBSERVER_INPUTS"]),
        "numerical substructure": Operations(n["LEAD"] + 2, 0) + product_of(1, columns - 1) + Operations(3, 2)
        + product_of(states, 2 + laws) + Operations(2 * states, states)
        + (product_of(n["DRIFT_ROWS"], columns) + Operations(1, 1 + n["LAWS"]) if n["LAWS"] else Operations(0, 0)),
        "tracking": Operations(0, 1)
        + (product_of(floors, n["FLOOR_STATES"] + 1) + product_of(floors, n["FLOOR_STATES"] + 1)
           if n["EXPECTED_FLOORS"] else Operations(0, 0)),
        "feedforward": product_of(n["FORWARD_STATES"] + 1, n["FORWARD_STATES"] + 3 + n["REACTION_INPUTS"]) + friction,
        "feedback": product_of(n["BACK_STATES"] + 1, n["BACK_STATES"] + 1) + Operations(n["BACK_STATES"], 10),
        "rounding": Operations(2, 3, 1),
        "guard": Operations(4 * accelerometers + 20, 8 * accelerometers + 20, 1 if n["FURTHER"] else 0)
        + Operations((13 + accelerometers) * n["FURTHER"], 12 * n["FURTHER"]),
    }  # fmt: skip
    total = Operations(0, 0)
    for block in blocks.values():
        total = total + block
    return {**blocks, "all": total}
