"""A discrete block in modal coordinates, for speed: the step's cost grows with the storeys, not with their square.

A discrete block x+ = A x + B u is transformed into uncoupled pairs of states, each for a complex pair of eigenvalues or
for two real ones. The transformation is exact to rounding; `modal` checks this before it returns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.control.interface import Interface
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.numerics.compiled import part_class
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.tiled_products import product, tiled

EXACT = 1e-7  # tolerated error of the change of coordinates, relative to the largest entry


@part_class
class Modal(NamedTuple):
    """A block of m pairs of states; inputs are ground acceleration and i forces, outputs an interface motion (3 i,)."""

    turn: Array  # (4, m) of each pair: first from first, first from second, second from first, second from second
    drive: Array  # (1 + i, 2, m) of each input: into the firsts, into the seconds
    outputs: Array  # (tiles, 2 m, 4), tiled_products.tiled
    through: Array  # (3 i, 1 + i) outputs per input of the same instant
    direct: Array  # (i, i) its accelerations per force
    state: Array  # (2 m,) all firsts, then all seconds
    made: Array  # (4 tiles,) outputs without the direct part of the inputs
    logged: Array  # nothing
    axes: tuple[int, ...]  # (i,) degrees of freedom of the interface

    def free(self, ground: Array, accel: Array) -> None:
        """Write the accelerations (i,) without interface force, as parts.NumericalSubstructure."""
        product(self.outputs, self.state.size, self.state, self.made)
        for i in range(len(self.axes)):
            accel[i] = self.made[i] + self.through[i, 0] * ground[0]

    def advance(self, ground: Array, force: Array, motion: Array) -> None:
        """Write the interface's absolute motion (3, i) and go on, as parts.NumericalSubstructure."""
        m, axes = self.turn.shape[1], len(self.axes)
        for q in range(3):
            for i in range(axes):
                value = self.made[q * axes + i] + self.through[q * axes + i, 0] * ground[0]
                for j in range(axes):
                    value += self.through[q * axes + i, 1 + j] * force[j]
                motion[q, i] = value if q == 0 else value + ground[q]
        for i in range(m):
            first, second = self.state[i], self.state[m + i]
            inputs = self.drive[0, 0, i] * ground[0] + self.drive[1, 0, i] * force[0]
            self.state[i] = self.turn[0, i] * first + self.turn[1, i] * second + inputs
            inputs = self.drive[0, 1, i] * ground[0] + self.drive[1, 1, i] * force[0]
            self.state[m + i] = self.turn[2, i] * first + self.turn[3, i] * second + inputs
        for j in range(1, axes):
            for i in range(m):
                self.state[i] += self.drive[1 + j, 0, i] * force[j]
                self.state[m + i] += self.drive[1 + j, 1, i] * force[j]


def modal(block: Block, interface: Interface, room: Room) -> Modal:
    """Return a block at rest in modal coordinates: ground acceleration and i forces to the interface's motion relative
    to the ground (3 i,), accelerations absolute.

    Raises InputError if the change of coordinates would lose accuracy (modes that coincide).
    """
    turn, drives, arranged = modal_arrays(block)
    forces, through = len(interface.channels), np.ascontiguousarray(block.D)
    direct = np.ascontiguousarray(through[:forces, 1:])
    state, made = room.take(2 * turn.shape[1]), np.zeros(4 * len(arranged))
    return Modal(turn, drives, arranged, through, direct, state, made, np.zeros(0), interface.channels)


def modal_arrays(block: Block) -> tuple[Array, Array, Array]:
    """Return `turn` (4, m), `drive` (inputs, 2, m) and `outputs` (tiles, 2 m, 4) of a block, as in `Modal`.

    Raises InputError if the change of coordinates would lose accuracy (modes that coincide).
    """
    basis = real_basis(block.A)
    try:
        turned, drive = (np.asarray(np.linalg.solve(basis, right)) for right in (block.A @ basis, block.B))
        back = np.linalg.multi_dot([basis, pairs_only(turned), np.linalg.inv(basis)])
        lost = float(np.abs(back - block.A).max(initial=0.0))
    except np.linalg.LinAlgError:
        lost = np.inf
    if not lost <= EXACT * np.abs(block.A).max(initial=1.0):
        raise InputError(
            f"{block.name}: modes of the computed storeys coincide, the step would lose {lost:.1e} of them; change a"
            " storey's stiffness or damping by a thousandth"
        )
    m, outputs = len(block.A) // 2, block.C @ basis
    first, second = slice(0, 2 * m, 2), slice(1, 2 * m, 2)
    turn = np.array([np.diag(turned[i, j]) for i in (first, second) for j in (first, second)])
    drives = np.ascontiguousarray(np.stack([drive[first].T, drive[second].T], axis=1))
    return turn, drives, tiled(np.hstack([outputs[:, first], outputs[:, second]]))


def real_basis(a: Array) -> Array:
    """Return a real basis (n, n) of A, n even, whose columns 2 i and 2 i + 1 span a pair of A's modes.

    Two neighbouring real eigenvalues form a pair; their columns are orthogonalised, so that they may be close.
    """
    values, vectors = np.linalg.eig(a)
    upper = np.flatnonzero(values.imag > 0.0)
    columns = [part for i in upper for part in (vectors[:, i].real, vectors[:, i].imag)]
    real = np.flatnonzero(values.imag == 0.0)
    real = real[np.argsort(values.real[real])]
    for one, two in zip(real[::2], real[1::2], strict=True):
        pair = np.linalg.svd(np.column_stack([vectors[:, one].real, vectors[:, two].real]), full_matrices=False)[0]
        columns += list(pair.T)
    return np.column_stack(columns) if columns else np.zeros((0, 0))


def pairs_only(turned: Array) -> Array:
    """Return the 2 x 2 blocks on the diagonal of a matrix (n, n), zeros elsewhere."""
    keep = np.kron(np.eye(len(turned) // 2), np.ones((2, 2)))
    return np.asarray(turned * keep, dtype=float)
