"""The equation of a chain of storeys on the table, in the frequency domain, and what it leaves of measured lines.

The discrete Fourier transform of a stretch of record obeys, for the motion of every floor,
Y(s) = H(s) A(s) + sum over modes of phi (alpha + beta s) / (s^2 + 2 zeta w s + w^2): H is the transmissibility, A the
table's acceleration, and alpha, beta stand for the state at the stretch's start less that at its end. With these free
there is no leakage however light the damping, and one equation serves noise and free vibration: the coupled motion of
table and specimen is input and output at once.

What enters linearly (alpha, beta, a slow drift) is projected out: variable projection, with the slopes of
L. Kaufman, BIT 15 (1975) 49.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.identification.least_squares import parts
from rths_cli.lti import Array, ComplexArray
from rths_cli.structure import storey_matrix

ROUNDING = float(np.finfo(float).eps)
LOST = 1e-12  # of the largest singular value of the linear terms' normal equations


@dataclass(frozen=True)
class Lines:
    """Fourier lines s (m,) in rad/s of the accelerations of table (m,) and floors (n, m)."""

    s: ComplexArray
    table: ComplexArray
    floors: ComplexArray


def modal(masses_kg: Array, stiffness_n_per_m: Array) -> tuple[Array, Array]:
    """Return natural frequencies in rad/s, ascending, (n,) and mass-normalised mode shapes (n, n).

    An eigenvalue is known to rounding of the largest one; one that is lost in it is taken as that large.
    """
    root = np.sqrt(masses_kg)
    eigenvalues, shapes = np.linalg.eigh(storey_matrix(stiffness_n_per_m) / np.outer(root, root))
    known = np.maximum(eigenvalues, ROUNDING * eigenvalues[-1])
    return np.sqrt(known), shapes / root[:, None]


def frequency_slopes(omega: Array, shapes: Array, stiffness_n_per_m: Array) -> Array:
    """Return d w_r / d log k_j in rad/s, (n modes, n storeys)."""
    return _stiffness_slopes(shapes, stiffness_n_per_m).diagonal().T / (2.0 * omega[:, None])


def _stiffness_slopes(shapes: Array, stiffness_n_per_m: Array) -> Array:
    """Return phi_q^T (d K / d log k_j) phi_r, (n modes q, n modes r, n storeys j)."""
    drift = np.diff(shapes, axis=0, prepend=0.0)
    return np.einsum("jq,jr,j->qrj", drift, drift, stiffness_n_per_m)


def evaluated(lines: Sequence[Lines], masses_kg: Array, theta: Array) -> tuple[Array, Array]:
    """Return what transmissibility and linear terms leave of the floors' lines, and its slopes (2 n + 1, ...).

    `theta`: logarithms of the storeys' stiffnesses and of the modal damping ratios (2 n,). The last slope is that by
    a time in s by which the table's signal is delayed.
    """
    each = [_evaluated(part, masses_kg, theta) for part in lines]
    return np.concatenate([residual for residual, _ in each]), np.hstack([slopes for _, slopes in each])


def without_time(both: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return residual and slopes without the slope by the table's delay."""
    return both[0], both[1][:-1]


def _evaluated(lines: Lines, masses_kg: Array, theta: Array) -> tuple[Array, Array]:
    """Return the residual (2 n m,) of one set of lines and its slopes (2 n + 1, 2 n m)."""
    stiffness, ratios = np.split(np.exp(theta), 2)
    omega, shapes = modal(masses_kg, stiffness)
    s, table, participation = lines.s, lines.table, (masses_kg @ shapes)[:, None]
    given = (2.0 * ratios * omega)[:, None] * s + (omega**2)[:, None]
    under = 1.0 / (s**2 + given)
    carried = given * under * table
    state = np.stack([(omega**2)[:, None] * under, omega[:, None] * s * under])
    left = lines.floors - shapes @ (participation * carried)
    columns, size = _linear_terms(state, shapes, omega[0] / s)
    residual, found = _without(parts(left).reshape(1, -1), columns)
    free = (found[0, : 2 * len(omega)] / size).reshape(2, len(omega), 1)
    moved = participation * carried + np.sum(free * state, axis=0)
    pulled = (participation * table - moved) * under
    basis = parts(np.concatenate([moved, carried, pulled, s * pulled, s * carried]))
    slopes = -(_weights(masses_kg, stiffness, ratios, omega, shapes) @ basis).reshape(len(theta) + 1, -1)
    return residual[0], _without(slopes, columns)[0]


def _linear_terms(state: ComplexArray, shapes: Array, drift: ComplexArray) -> tuple[Array, Array]:
    """Return the rows (3 n, 2 n m), of length 1, of initial and final state, and of a slow drift of each floor's
    channel; and how long the first 2 n were."""
    n = len(shapes)
    of_modes = shapes.T[None, :, :, None] * parts(state)[:, :, None, :]
    of_floors = np.eye(n)[:, :, None] * parts(drift)
    rows = np.concatenate([of_modes.reshape(2 * n, -1), of_floors.reshape(n, -1)])
    size = np.sqrt(np.sum(rows**2, axis=1))
    return np.asarray(rows / size[:, None]), np.asarray(size[: 2 * n])


def _without(values: Array, rows: Array) -> tuple[Array, Array]:
    """Return values (k, m) less their projection on rows (p, m) of length 1, and that projection's parts (k, p)."""
    found = np.linalg.lstsq(rows @ rows.T, rows @ values.T, rcond=LOST)[0].T.astype(float)
    return values - found @ rows, found


def _weights(masses_kg: Array, stiffness: Array, ratios: Array, omega: Array, shapes: Array) -> Array:
    """Return how the model's slopes (2 n + 1 parameters, n floors) are made of the 5 n rows of their basis.

    By log k_j: shapes and frequencies change, d phi_r = sum over q of phi_q phi_q^T K_j phi_r / (w_r^2 - w_q^2). By
    log zeta_r: one mode's damping. By the table's delay: -s times what it carries.
    """
    n, coupled = len(omega), _stiffness_slopes(shapes, stiffness)
    apart = np.subtract.outer(-(omega**2), -(omega**2))  # w_r^2 - w_q^2, q first
    apart = np.copysign(np.maximum(np.abs(apart), ROUNDING * omega[-1] ** 2), apart) + np.diag(np.full(n, np.inf))
    turned = np.einsum("iq,qrj->jir", shapes, coupled / apart[:, :, None])
    faster = (coupled.diagonal() / (2.0 * omega)).reshape(n, 1, n)  # d w_r / d log k_j, (j, 1, r)
    weights = np.zeros((2 * n + 1, n, 5, n))
    weights[:n, :, 0] = turned
    weights[:n, :, 1] = shapes * np.einsum("i,jir->jr", masses_kg, turned)[:, None]
    weights[:n, :, 2] = shapes * (2.0 * omega) * faster
    weights[:n, :, 3] = shapes * (2.0 * ratios) * faster
    weights[n : 2 * n, :, 3] = np.eye(n)[:, None] * (shapes * 2.0 * ratios * omega)
    weights[-1, :, 4] = -shapes * (masses_kg @ shapes)
    return weights.reshape(2 * n + 1, n, 5 * n)
