"""A discrete block in modal coordinates, for speed: the step's cost grows with the storeys, not with their square.

A discrete block x+ = A x + B u is transformed into uncoupled pairs of states, each for a complex pair of eigenvalues or
for two real ones. The transformation is exact to rounding; `modal` checks this before it returns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.compiled import part
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.tiled_products import product, tiled

EXACT = 1e-7  # tolerated error of the change of coordinates, relative to the largest entry


class Modal(NamedTuple):
    """A block of m pairs of states, two inputs and up to four outputs."""

    turn: Array  # (4, m) of each pair: first from first, first from second, second from first, second from second
    drive: Array  # (4, m) first from input 0, first from input 1, second from input 0, second from input 1
    outputs: Array  # (1, 2 m, 4), tiled_products.tiled
    direct: Array  # (p, 2)
    state: Array  # (2 m,) all firsts, then all seconds
    made: Array  # (4,) outputs without the direct part of the inputs


def modal(block: Block) -> Modal:
    """Return a block at rest in modal coordinates; 2 inputs, up to 4 outputs.

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
    drives = np.array([drive[first, 0], drive[first, 1], drive[second, 0], drive[second, 1]])
    arranged = tiled(np.hstack([outputs[:, first], outputs[:, second]]))
    return Modal(turn, drives, arranged, np.ascontiguousarray(block.D), np.zeros(2 * m), np.zeros(4))


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


@part
def read_modal(block: Modal) -> None:
    """Write the outputs without the direct part of the inputs of this instant."""
    product(block.outputs, block.state.size, block.state, block.made)


@part
def advance_modal(block: Modal, one: float, two: float) -> None:
    """Advance the state with the two inputs of this instant."""
    m = block.turn.shape[1]
    for i in range(m):
        first, second = block.state[i], block.state[m + i]
        inputs = block.drive[0, i] * one + block.drive[1, i] * two
        block.state[i] = block.turn[0, i] * first + block.turn[1, i] * second + inputs
        inputs = block.drive[2, i] * one + block.drive[3, i] * two
        block.state[m + i] = block.turn[2, i] * first + block.turn[3, i] * second + inputs
