"""The step on a rig with the command cut: every block as a plain program, its matrices read off by unit vectors.

An oracle for the closed-loop analysis: signals are followed in the order in which the design states them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from bench import LINEAR, held, linear_table, specimen
from hybrid import storeys, true_model

from rths_cli.analysis.identified_rig_block import IdentifiedRig, identified_rig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.numerics.lti import Array, Block, ComplexArray, Model
from rths_cli.rigs.description import RigInfo


def points(frequency_hz: Array, dt_s: float) -> ComplexArray:
    """Return exp(j w dt)."""
    return np.exp(2j * np.pi * frequency_hz * dt_s)


def floors_per_table(frequency_hz: Array) -> ComplexArray:
    """Return accelerations of table (one) and floors per table acceleration, from M s^2 x + C s x + K x = -M 1 a."""
    parts, found = specimen(), []
    for s in 2j * np.pi * frequency_hz:
        restoring = parts.K + s * parts.C
        found.append(1.0 - s**2 * np.linalg.solve(np.diag(parts.masses_kg) * s**2 + restoring, parts.masses_kg))
    return np.vstack([np.ones(len(frequency_hz)), np.array(found).T])


def true_rig(info: RigInfo, interface_mass_kg: float = 0.0) -> Block:
    """Return command to raw samples from the equations of motion, the late commands in a queue."""
    a, b, rows, _ = linear_table(LINEAR, specimen(), info.channels[0].low_pass_hz, 0.0, interface_mass_kg)
    step, drive = held(a, b, info.dt_s)
    n, late = len(a), info.latency_samples
    whole, into = np.zeros((n + late, n + late)), np.zeros((n + late, 1))
    whole[:n, :n] = step
    if late:
        whole[:n, n], whole[n:-1, n + 1 :], into[-1] = drive, np.eye(late - 1), 1.0
    else:
        into[:n, 0] = drive
    out = np.hstack([rows * info.channels[0].sensitivity_v_per_unit, np.zeros((len(rows), late))])
    return Block("rig", whole, into, out, np.zeros((len(rows), 1)), info.dt_s)


def rig_as_identified(
    info: RigInfo, interface_mass_kg: float = 0.0, ripple: float = 0.0, delay_samples: float | None = None
) -> tuple[IdentifiedRig, Model]:
    """Return the rig that the true linear table, known without error, makes, and its model."""
    late = info.latency_samples + 0.5 if delay_samples is None else delay_samples
    model = replace(true_model(late * info.dt_s, interface_mass_kg), latency_samples=info.latency_samples)
    model = replace(model, ripple_m_s2_per_v=ripple, dt_s=info.dt_s)
    return identified_rig(model, specimen(), info, True), model


@dataclass(frozen=True)
class OpenLoop:
    """Inputs: command at the rig, ground (3), disturbances of the corrected samples (c). Outputs: command wanted,
    corrected samples (c), desired acceleration, base shear, the numerical storeys' accelerations (p)."""

    A: Array
    B: Array
    C: Array
    D: Array

    def response(self, z: ComplexArray) -> ComplexArray:
        """Return outputs over inputs with the command cut, (outputs, inputs, m)."""
        eye = np.eye(len(self.A))
        each = [self.C @ np.linalg.solve(point * eye - self.A, self.B) + self.D for point in z]
        return np.moveaxis(np.array(each), 0, -1)

    def closed(self, z: ComplexArray) -> ComplexArray:
        """Return outputs over inputs of the closed loop, the first input added to the command wanted."""
        cut = self.response(z)
        return cut + cut[:, :1] * cut[:1] / (1.0 - cut[0, 0])

    def determinant(self, z: ComplexArray) -> ComplexArray:
        """Return det(z I - M) of the closed loop."""
        own = np.array([np.linalg.det(p * np.eye(len(self.A)) - self.A) for p in z])
        return own * (1.0 - self.response(z)[0, 0]) / (1.0 - self.D[0, 0])


def open_loop(rig: Block, blocks: Blocks, numerical_storeys: int = 1, mass_kg: float = 6.93) -> OpenLoop:
    """Return the open loop of a hybrid test."""
    parts, every = [rig, *blocks.named()], all_storeys(storeys(numerical_storeys, mass_kg=mass_kg), rig.dt_s)
    lead, sent, channels = blocks.lead_samples, max(blocks.latency_samples, 1) + 1, len(rig.C)
    ends = np.cumsum([*(len(part.A) for part in parts), lead, sent])

    def one(both: Array) -> Array:
        *states, recent, old, u = np.split(both, ends)
        command, ground, noise = u[:1], u[1:4], u[4:]

        def out(i: int, given: Array) -> Array:
            return parts[i].C @ states[i] + parts[i].D[:, : len(given)] @ given

        samples = out(0, command)
        corrected = out(1, samples) + noise
        change, total = blocks.ripple_m_s2_per_v, blocks.ripple_sum_m_s2_per_v
        corrected[0] -= change * (old[-2] - old[-1]) + total * (old[-2] + old[-1])
        estimated = out(2, corrected)
        weights, recent_weights, sample_weights, desired_weight = blocks.interface.force.of_one()
        shear = weights @ estimated + recent_weights @ recent + sample_weights @ corrected
        without = out(3, np.array([ground[0], 0.0]))[0]
        share = parts[3].D[0, 1] * desired_weight
        shear = (shear + desired_weight * without) / (1.0 - share)
        forces = np.array([ground[0], shear])
        interface = out(3, forces) + ground * np.array([0.0, 1.0, 1.0])
        issued = np.append(recent, interface[0])
        error = np.array([issued[0] - corrected[0]])
        driving = np.concatenate([interface, corrected])[: parts[4].B.shape[1]]
        wanted = out(4, driving) + out(5, error)
        p = len(every.C) // 3
        floors = (every.C @ states[3] + every.D @ forces)[2 * p :]
        inputs = [command, samples, corrected, forces, driving, error]
        following = [q.A @ x + q.B[:, : len(v)] @ v for q, x, v in zip(parts, states, inputs, strict=True)]
        return np.concatenate(
            [*following, issued[1:], command, old[:-1], wanted, corrected, interface[:1], [shear], floors]
        )

    n = int(ends[-1])
    whole = np.array([one(unit) for unit in np.eye(n + 4 + channels)]).T
    return OpenLoop(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:])
