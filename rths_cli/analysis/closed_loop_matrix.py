"""The loop of a hybrid test as one block, and closed as one matrix, x[k+1] = M x[k]: its spectral radius, roots and
modes."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.numerics.lti import Array, Block, ComplexArray

FORGOTTEN = 0.1  # a smaller eigenvalue decays within a few samples: it is no motion of table or building
# Highest frequency of a motion that may outlast the padding after a record, whose length sets it and no band; fraction
# of the motion that must be left to count
SLOW_HZ, LEFT = 0.3, 1e-4
COINCIDENT = 1e-3  # relative difference of two real roots that count as one double root


class _Rows:
    """Signals of the loop as rows (signals, n + 1) that multiply (state, command); a block has a slice of the state."""

    def __init__(self, sizes: dict[str, int]) -> None:
        ends = np.cumsum(list(sizes.values()))
        self.width = int(ends[-1]) + 1
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def of(self, name: str) -> Array:
        """Return the rows that select the state of a block."""
        return np.eye(self.width)[self.places[name]]

    def output(self, name: str, block: Block, inputs: Array) -> Array:
        """Return the rows of a block's outputs for the rows of its first inputs; further inputs are zero."""
        count = len(inputs)
        return block.C @ self.of(name) + block.D[:, :count] @ inputs

    def following(self, name: str, block: Block, inputs: Array) -> Array:
        """Return the rows of a block's next state for the rows of its first inputs; further inputs are zero."""
        return block.A @ self.of(name) + block.B[:, : len(inputs)] @ inputs


def closed_loop_matrix(rig: IdentifiedRig, blocks: Blocks) -> Array:
    """Return the matrix M (n, n) of a hybrid test without ground motion, guard and rounding: `open_loop`, closed.

    If the rig has a direct path from command to samples, the resulting algebraic loop is solved.
    """
    loop = open_loop(rig, blocks)
    return loop.A - loop.B @ loop.C / (1.0 + loop.D.item())


def open_loop(rig: IdentifiedRig, blocks: Blocks) -> Block:
    """Return the loop of a hybrid test broken at the command, for negative feedback: the command that is sent (V) to
    minus the command that follows from it (V), without ground motion, guard and rounding.

    The order is that of the step. The samples are corrected and give the estimate and the base shear n_p samples ahead.
    The numerical substructure, feedforward and feedback give the command of the same instant. The rig's delay is in the
    states.
    """
    lead, sent = blocks.lead_samples, max(rig.latency_samples, 1) + 1
    numerical, feedforward, feedback = blocks.linear_parts()
    parts = {"rig": rig.plant, "correction": rig.correction, "estimator": blocks.estimator}
    parts |= {"numerical": numerical, "feedforward": feedforward, "feedback": feedback}
    sizes = {"recent": lead, "sent": sent} | {name: len(block.A) for name, block in parts.items()}
    rows = _Rows(sizes)
    command = np.eye(rows.width)[-1:]
    samples = rows.output("rig", rig.plant, command)
    corrected = rows.output("correction", rig.correction, samples)
    (change, total), (now, before) = rig.alias_left(blocks), rows.of("sent")[-2:]
    corrected[0] += change * (now - before) + total * (now + before)
    estimated = rows.output("estimator", blocks.estimator, corrected)
    shear_desired = _coupled(rows, blocks, numerical, corrected, estimated)
    into = np.vstack([np.zeros(rows.width), shear_desired[0]])
    interface = rows.output("numerical", numerical, into)
    driving = np.vstack([interface, corrected])[: feedforward.B.shape[1]]
    recent = np.vstack([rows.of("recent"), interface[0]])
    error = (recent[0] - corrected[0])[None]
    wanted = rows.output("feedforward", feedforward, driving) + rows.output("feedback", feedback, error)
    following = {
        "recent": recent[1:],
        "sent": np.vstack([command, rows.of("sent")[:-1]]),
        "rig": rows.following("rig", rig.plant, command),
        "correction": rows.following("correction", rig.correction, samples),
        "estimator": rows.following("estimator", blocks.estimator, corrected),
        "numerical": rows.following("numerical", numerical, into),
        "feedforward": rows.following("feedforward", feedforward, driving),
        "feedback": rows.following("feedback", feedback, error),
    }
    whole, signals = np.vstack([following[name] for name in sizes]), (("command_v",), ("command_v",))
    return Block("loop", whole[:, :-1], whole[:, -1:], -wanted[:, :-1], -wanted[:, -1:], rig.plant.dt_s, *signals)


def _coupled(rows: _Rows, blocks: Blocks, numerical: Block, corrected: Array, estimated: Array) -> Array:
    """Return the rows (2, n + 1) of base shear and desired acceleration at k + n_p, which depend on each other."""
    estimates, recent, measured, desired_weight = blocks.interface.force.of_one()
    known = estimates @ estimated + measured @ corrected
    if blocks.lead_samples:
        known = known + recent @ rows.of("recent")
    free = numerical.C[0] @ rows.of("numerical")
    direct = numerical.D[0, 1]
    desired = (free + direct * known) / (1.0 - direct * desired_weight)
    return np.vstack([known + desired_weight * desired, desired])


def spectral_radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue of a matrix (n, n); below one, every motion decays."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def loop_roots(matrix: Array, dt_s: float) -> ComplexArray:
    """Return the closed loop's oscillating modes as roots log(z) / dt_s in rad/s, (n,), the slowest to decay first.

    Of each conjugate pair the root above the real axis is returned.
    """
    z = np.linalg.eigvals(matrix).astype(complex)
    roots = np.log(z[(np.abs(z) > FORGOTTEN) & (z.imag > 0.0)]) / dt_s
    return roots[np.argsort(-roots.real)]


def slow_roots(matrix: Array, dt_s: float, time_s: float) -> ComplexArray:
    """Return the closed loop's slow roots log(z) / dt_s in rad/s, (n,).

    They are below SLOW_HZ, and more than the fraction LEFT of their motion is left after `time_s`. Real roots are
    included, and of each conjugate pair the root above the real axis. Two real roots that coincide, as those of a
    leaky inverse, are returned as a pair that is nearly real: the motions of both together are exp(r t) and t exp(r t).
    """
    z = np.linalg.eigvals(matrix).astype(complex)
    roots = np.log(z[(np.abs(z) > FORGOTTEN) & (z.imag >= 0.0)]) / dt_s
    slow = roots[(np.abs(roots) < 2.0 * np.pi * SLOW_HZ) & (roots.real * time_s > np.log(LEFT))]
    return _without_coincident(slow)


def _without_coincident(roots: ComplexArray) -> ComplexArray:
    """Return roots (k,) in which each two real ones within COINCIDENT of their size are one root of a pair."""
    real, found = np.sort(roots[roots.imag == 0.0].real), list(roots[roots.imag != 0.0])
    while len(real):
        if len(real) > 1 and real[1] - real[0] <= COINCIDENT * abs(real[0]):
            middle = 0.5 * (real[0] + real[1])
            found.append(middle + 1j * COINCIDENT * abs(middle))
            real = real[2:]
        else:
            found.append(complex(real[0]))
            real = real[1:]
    return np.array(found, dtype=complex)


def modes_in_loop(roots: ComplexArray, frequency_hz: Array, damping_ratio: Array) -> tuple[Array, Array]:
    """Return frequencies in Hz and damping ratios (m,) of the loop's roots nearest to those of given modes (m,).

    Each root is assigned to one mode only. An overdamped mode gets NaN, because it has no frequency.
    """
    size = 2.0 * np.pi * frequency_hz
    wanted = size * (-damping_ratio + 1j * np.sqrt(np.maximum(1.0 - damping_ratio**2, 0.0)))
    nearest, free = np.full(len(wanted), np.nan, dtype=complex), np.asarray(roots)
    for mode in np.flatnonzero(damping_ratio < 1.0):
        taken = np.abs(free - wanted[mode]).argmin()
        nearest[mode], free = free[taken], np.delete(free, taken)
    return np.abs(nearest) / (2.0 * np.pi), -nearest.real / np.abs(nearest)
