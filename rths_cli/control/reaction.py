"""The table's compliance: what the specimen's reaction does to the table, identified, and a command that counters it.

The identified table contains the identified specimen: its zeros are the specimen's frequencies on a fixed base. When
the specimen yields or is damaged, its reaction changes, and the table's inverse is wrong near these frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.control.kalman_filter import leading_low_pass, specimen_state_space
from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Block, Model, StateSpace
from rths_cli.structure import Specimen

FIT = 0.3, 1.5  # of the specimen's lowest and highest frequency: band of the fit
LINES = 200
LEAST_ORDER = 2  # of the table without specimen
MOST_MISFIT = 0.01


@dataclass(frozen=True)
class Compliance:
    """A force F in N on the table acts like the command rho (1 + lag s) F without delay."""

    volts_per_newton: float  # rho
    lag_s: float
    misfit: float  # rms of the relative difference between table model and fit


def compliance(model: Model, specimen: Specimen) -> Compliance:
    """Return the table's compliance from its model and the identified specimen that stands on it.

    Left alone, the table moves by x = u / p(s) with its command u, whose delay is left out. The specimen reacts to the
    table's acceleration with -M(s) s^2 x, therefore s^2 / G(s) = p(s) + rho (1 + lag s) s^2 M(s). M has peaks and the
    polynomial p has none: linear least squares of the relative difference finds both, with a lag of zero or more. p has
    as many roots as the model has poles beyond the specimen's. Raises InputError where a table is not of this kind.
    """
    n = len(specimen.masses_kg)
    own = np.sqrt(np.linalg.eigvals(np.linalg.solve(np.diag(specimen.masses_kg), specimen.K)).real) / (2.0 * np.pi)
    frequency = np.geomspace(FIT[0] * own.min(), FIT[1] * own.max(), LINES)
    s = 2j * np.pi * frequency
    rational = model.gain * np.prod(s[:, None] - model.zeros, axis=1) / np.prod(s[:, None] - model.poles, axis=1)
    inverse = s**2 / rational
    apparent_kg = specimen.masses_kg @ specimen_state_space(specimen).response(frequency)[:, 0]
    order = max(len(model.poles) - 2 * n, LEAST_ORDER)
    unit = 2.0 * np.pi * own.max()
    table = [(s / unit) ** k for k in range(order + 1)]
    for powers in (2, 1):  # a lag below zero is one that the record does not show: then there is none
        columns = table + [s**2 * apparent_kg * (s / unit) ** k for k in range(powers)]
        relative = np.array(columns).T / inverse[:, None]
        rows, wanted = np.vstack([relative.real, relative.imag]), np.repeat([1.0, 0.0], LINES)
        size = np.linalg.norm(rows, axis=0)
        found = np.linalg.lstsq(rows / size, wanted, rcond=None)[0] / size
        rho, slope = float(found[order + 1]), float(found[-1]) / unit if powers == 2 else 0.0
        if slope * rho >= 0.0:
            break
    misfit = float(np.sqrt(np.mean(np.abs(relative @ found - 1.0) ** 2)))
    if not (misfit <= MOST_MISFIT and rho > 0.0):
        raise InputError(
            "controller.reaction_feedforward: the identified table does not show how the specimen's reaction moves it "
            f"(misfit {misfit:.2g}, at most {MOST_MISFIT:g}; {rho:.3g} V/N, must be > 0); remove the key"
        )
    return Compliance(rho, slope / rho, misfit)


def force_lag_s(model: Model, specimen: Specimen) -> float:
    """Return by how much a force on the table is early against a command; 0 where the table does not show it."""
    try:
        return compliance(model, specimen).lag_s
    except InputError:
        return 0.0


def reaction_block(specimen: Specimen, table: Compliance, delay_s: float, corner_hz: float, dt_s: float) -> Block:
    """Return the block from corrected accelerations (table, floors) to the command that counters the part of the
    specimen's reaction which the identified specimen does not explain.

    That part is F = -sum m (measured - expected floor acceleration), expected of the identified specimen on the
    measured table. The command is -rho H(s) F with the `leading_low_pass` H(s), which leads by lag and by the command's
    delay. It is zero while the specimen is the identified one.
    """
    n, h = len(specimen.masses_kg), leading_low_pass(corner_hz, table.lag_s + delay_s)
    system, masses, order = specimen_state_space(specimen), specimen.masses_kg, len(h.A)
    a, b = np.zeros((2 * n + order, 2 * n + order)), np.zeros((2 * n + order, 1 + n))
    a[: 2 * n, : 2 * n], b[: 2 * n, 0] = system.A, system.B[:, 0]
    a[2 * n :, 2 * n :] = h.A
    a[2 * n :, : 2 * n], b[2 * n :, 1:] = np.outer(h.B, masses @ system.C), -np.outer(h.B, masses)
    c = np.zeros((1, 2 * n + order))
    c[:, 2 * n :] = -table.volts_per_newton * h.C
    inputs = ("table_accel_m_s2", *(f"floor_accel_{i + 1}_m_s2" for i in range(n)))
    return discretise(StateSpace(a, b, c, np.zeros((1, 1 + n))), dt_s, "foh", "reaction", inputs, ("reaction_v",))


def with_reaction(feedforward: Block, reaction: Block) -> Block:
    """Return a feedforward that adds the command of a `reaction_block`, whose inputs follow its own."""
    n, m = feedforward.B.shape
    q, c = reaction.B.shape
    return Block(
        feedforward.name,
        np.block([[feedforward.A, np.zeros((n, q))], [np.zeros((q, n)), reaction.A]]),
        np.block([[feedforward.B, np.zeros((n, c))], [np.zeros((q, m)), reaction.B]]),
        np.hstack([feedforward.C, reaction.C]),
        np.hstack([feedforward.D, reaction.D]),
        feedforward.dt_s,
        (*feedforward.inputs, *reaction.inputs),
        feedforward.outputs,
    )


def table_with_another(table: StateSpace, identified: Specimen, there: Specimen, compliance: Compliance) -> StateSpace:
    """Return the system from command to the absolute accelerations (1 + n,) of table and floors with another specimen
    than the identified one on the table.

    The difference of the two reactions acts like a command (`Compliance`). `table`: command to acceleration, with the
    identified specimen, its delay left out.
    """
    expected, real = specimen_state_space(identified), specimen_state_space(there)
    n, m, rho = len(table.A), len(real.A), compliance.volts_per_newton
    a = np.block([[expected.A, np.zeros((m, m))], [np.zeros((m, m)), real.A]])
    b = np.vstack([expected.B, real.B])
    unexplained = np.concatenate([identified.masses_kg @ expected.C, -there.masses_kg @ real.C])
    by_state = rho * (unexplained + compliance.lag_s * unexplained @ a)  # command of the difference
    by_accel = rho * compliance.lag_s * float((unexplained @ b).item())
    own = 1.0 / (1.0 - table.D.item() * by_accel)
    accel = own * np.hstack([table.C, table.D * by_state])  # (1, n + 2 m) the table's
    direct = own * table.D
    command = np.concatenate([np.zeros(n), by_state]) + by_accel * accel[0]
    whole = np.block([[table.A, np.zeros((n, 2 * m))], [np.zeros((2 * m, n)), a]])
    whole[:n] += table.B @ command[None]
    whole[n:] += b @ accel
    driven = np.vstack([table.B * (1.0 + by_accel * direct), b @ direct])
    floors = np.hstack([np.zeros((len(real.C), n + m)), real.C])
    return StateSpace(whole, driven, np.vstack([accel, floors]), np.vstack([direct, np.zeros((len(floors), 1))]))
