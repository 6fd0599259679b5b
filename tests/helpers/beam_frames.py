"""A plane frame of textbook beam elements (Euler-Bernoulli, with axial force), assembled for tests of structures.

Przemieniecki, Theory of Matrix Structural Analysis, 1968: stiffness and consistent mass of a beam in its own axes.
"""

from __future__ import annotations

import numpy as np

E_PA, DENSITY = 200e9, 7850.0


def element(start, end, area_m2, inertia_m4):
    """Return stiffness and consistent mass (6, 6) of a beam between two points in global axes x, y, rotation."""
    dx, dy = np.subtract(end, start)
    length = float(np.hypot(dx, dy))
    a, b = E_PA * area_m2 / length, E_PA * inertia_m4 / length**3
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    k[np.ix_([0, 3], [0, 3])] = a * np.array([[1, -1], [-1, 1]])
    m[np.ix_([0, 3], [0, 3])] = np.array([[2, 1], [1, 2]]) / 6.0
    bending, n = [1, 2, 4, 5], length
    k[np.ix_(bending, bending)] = b * np.array(
        [[12, 6 * n, -12, 6 * n], [6 * n, 4 * n**2, -6 * n, 2 * n**2],
         [-12, -6 * n, 12, -6 * n], [6 * n, 2 * n**2, -6 * n, 4 * n**2]]
    )  # fmt: skip
    m[np.ix_(bending, bending)] = (
        np.array(
            [[156, 22 * n, 54, -13 * n], [22 * n, 4 * n**2, 13 * n, -3 * n**2],
             [54, 13 * n, 156, -22 * n], [-13 * n, -3 * n**2, -22 * n, 4 * n**2]]
        )
        / 420.0
    )  # fmt: skip
    m *= DENSITY * area_m2 * length
    turn = np.eye(6)
    for first in (0, 3):
        turn[first : first + 2, first : first + 2] = np.array([[dx, dy], [-dy, dx]]) / length
    return turn.T @ k @ turn, turn.T @ m @ turn


def plane_frame(storeys, bays, floor_kg=200.0, storey_m=1.0, bay_m=1.5, lumped=False):
    """Return M, K, influence of a frame with hinged bases, and the horizontal displacement of the roof's first node.

    Displacements x, y and the rotation of each node from the first floor up, then the rotations of the bases. Lumped:
    the mass stands at the nodes' horizontal displacements alone.
    """
    columns = bays + 1
    nodes = [(bay_m * c, storey_m * s) for s in range(storeys + 1) for c in range(columns)]
    size, count = 3 * len(nodes), len(nodes)
    K, M = np.zeros((size, size)), np.zeros((size, size))

    def add(i, j, area, inertia):
        k, m = element(nodes[i], nodes[j], area, inertia)
        at = [*range(3 * i, 3 * i + 3), *range(3 * j, 3 * j + 3)]
        K[np.ix_(at, at)] += k
        M[np.ix_(at, at)] += m

    for s in range(1, storeys + 1):
        for c in range(columns):
            add((s - 1) * columns + c, s * columns + c, 1e-3, 1e-6)
            if c < bays:
                add(s * columns + c, s * columns + c + 1, 8e-4, 8e-7)
    if lumped:
        M = np.zeros((size, size))
    for node in range(columns, count):
        for axis in (0,) if lumped else (0, 1):
            M[3 * node + axis, 3 * node + axis] += floor_kg
    free = [*range(3 * columns, size), *(3 * c + 2 for c in range(columns))]
    influence = np.array([1.0 if dof % 3 == 0 else 0.0 for dof in free])
    return M[np.ix_(free, free)], K[np.ix_(free, free)], influence, free.index(3 * storeys * columns)
