"""The identified rig (table and specimen) as one sampled block: command to corrected samples.

The identified table moves the identified specimen; the discretisation is exact for a held command. The sensors' AC
coupling and its correction cancel and are left out. They do not cancel for the hold's alias, which passes the coupling
and is integrated by the correction: this integral is `ripple_sum_m_s2_per_v`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.reaction import Compliance, table_with_another
from rths_cli.control.sensor_correction import correction
from rths_cli.control.state_space import discretise, from_roots
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Block, Model, StateSpace, staircase
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

RIPPLE_HZ = np.array([2.0, 5.0, 10.0])  # of the usual band: where the hold's alias in the sampled model is found


@dataclass(frozen=True)
class IdentifiedRig:
    """The identified rig, with the alias that the held command leaves in the table's samples."""

    plant: Block  # command in V to raw samples (c,) in V
    correction: Block  # the step's sensor correction, without the correction of the AC coupling
    ripple_m_s2_per_v: float  # alias in a corrected table sample per command change, beyond that of `plant`
    latency_samples: int
    ripple_sum_m_s2_per_v: float = 0.0  # integral of the whole alias by the AC correction; `plant` has none of it
    # Fraction of a table sample that is alias with the shape of an acceleration. An identification cannot distinguish
    # it from the table's gain, so that table and floors move by this fraction less than the model predicts.
    excess: float = 0.0

    def alias_left(self, blocks: Blocks) -> tuple[float, float]:
        """Return the alias that the step with these blocks does not remove, beyond that of `plant`.

        The two numbers are in m/s^2 per V, for the difference and for the sum of the last two commands that act.
        """
        change = self.ripple_m_s2_per_v - blocks.ripple_m_s2_per_v
        return change, self.ripple_sum_m_s2_per_v - blocks.ripple_sum_m_s2_per_v


def identified_rig(
    model: Model, specimen: Specimen, info: RigInfo, removes_sensors: bool, compared: ComparedBand = USUAL
) -> IdentifiedRig:
    """Return the rig composed of a table model, a specimen and the declared sensors.

    `removes_sensors`: the step corrects the samples for the sensors' dynamics, and the model does not contain them.
    `compared`: band in which the model was compared with its data.
    """
    corners = [c.low_pass_hz if removes_sensors else 0.0 for c in info.channels]
    scale = np.array([c.sensitivity_v_per_unit for c in info.channels])
    chain = _with_sensors(_with_specimen(_table(model), specimen), corners)
    sampled = _held(chain, model, info.dt_s) if model.delay_s > 0.0 else _smooth(chain, info.dt_s)
    plant = replace(sampled, C=scale[:, None] * sampled.C, D=scale[:, None] * sampled.D)
    fixed = _correction(info, removes_sensors)
    own, excess = _own_alias(plant, fixed, model, compared) if model.delay_s > 0.0 else (0.0, 0.0)
    beyond = model.ripple_m_s2_per_v - own
    return IdentifiedRig(plant, fixed, beyond, model.latency_samples, model.ripple_sum_m_s2_per_v, excess)


def identified_actuator(model: Model, specimen: Specimen, info: RigInfo) -> IdentifiedRig:
    """Return the rig composed of an actuator's model, which has no zeros but two at the origin, and the specimen that
    it moves: command in V to displacement and force F = m x'' + c x' + k x, in V of their channels."""
    n, size = len(model.poles), float(np.exp(np.mean(np.log(np.abs(model.poles)))))
    coefficients = np.real(np.poly(model.poles / size))  # in time units of 1 / size, so that they are of one size
    a = np.vstack([np.eye(n)[1:], -coefficients[:0:-1]])
    b = np.zeros((n, 1))
    b[-1, 0] = model.gain / size**n
    rows = np.eye(n)[:1], size * np.eye(n)[1:2], size**2 * a[1:2]  # displacement, velocity, acceleration
    direct = size**2 * b[1:2]
    weights = specimen.K[0, 0], specimen.C[0, 0], float(specimen.masses_kg[0])
    force = sum(weight * row for weight, row in zip(weights, rows, strict=True))
    scale = np.array([one.sensitivity_v_per_unit for one in info.channels])[:, None]
    through = np.vstack([np.zeros((1, 1)), weights[2] * direct])
    chain = StateSpace(size * a, size * b, scale * np.vstack([rows[0], force]), scale * through)
    return IdentifiedRig(_held(chain, model, info.dt_s), _correction(info, False), 0.0,
                         model.latency_samples)  # fmt: skip


def with_another_specimen(
    rig: IdentifiedRig,
    model: Model,
    identified: Specimen,
    there: Specimen,
    table: Compliance,
    info: RigInfo,
    removes_sensors: bool,
) -> IdentifiedRig:
    """Return an identified rig on whose table another specimen stands than the identified one, with the same alias."""
    corners = [c.low_pass_hz if removes_sensors else 0.0 for c in info.channels]
    scale = np.array([c.sensitivity_v_per_unit for c in info.channels])
    chain = _with_sensors(table_with_another(_table(model), identified, there, table), corners)
    sampled = _held(chain, model, info.dt_s) if model.delay_s > 0.0 else _smooth(chain, info.dt_s)
    return replace(rig, plant=replace(sampled, C=scale[:, None] * sampled.C, D=scale[:, None] * sampled.D))


def _table(model: Model) -> StateSpace:
    """Return the table's rational part, command to acceleration."""
    return from_roots(model.zeros, model.poles, model.gain)


def _with_specimen(table: StateSpace, specimen: Specimen) -> StateSpace:
    """Return the system from command to the absolute accelerations (1 + n,) of table and floors."""
    parts = specimen_state_space(specimen)
    n, m = len(table.A), len(parts.A)
    a = np.block([[table.A, np.zeros((n, m))], [parts.B @ table.C, parts.A]])
    b = np.vstack([table.B, parts.B @ table.D])
    c = np.vstack([np.hstack([table.C, np.zeros((1, m))]), np.hstack([parts.D @ table.C, parts.C])])
    return StateSpace(a, b, c, np.vstack([table.D, parts.D @ table.D]))


def _with_sensors(chain: StateSpace, low_pass_hz: list[float]) -> StateSpace:
    """Return the chain with a first-order low pass on each output; a corner of 0 Hz leaves it as it is."""
    every = 2.0 * np.pi * np.array(low_pass_hz)
    slow = np.flatnonzero(every)
    corner = every[slow, None]
    n, c = len(chain.A), slow.size
    a = np.block([[chain.A, np.zeros((n, c))], [corner * chain.C[slow], -np.diag(corner[:, 0])]])
    b = np.vstack([chain.B, corner * chain.D[slow]])
    out, direct = np.hstack([chain.C, np.zeros((len(every), c))]), chain.D.copy()
    out[slow], direct[slow] = np.eye(n + c)[n:], 0.0
    return StateSpace(a, b, out, direct)


def _held(chain: StateSpace, model: Model, dt_s: float) -> Block:
    """Return the chain, sampled, behind a hold and the model's delay less the half sample of the hold itself.

    With a remaining delay of L + part samples the command of step k - L - 1 acts during the fraction `part` of interval
    k, and that of step k - L during the rest. The states are the chain's, then the last L + 1 commands, latest first.
    """
    late = max(model.delay_s / dt_s - 0.5, 0.0)
    whole = math.floor(late + 1e-9)
    part = max(late - whole, 0.0)
    a, early = _hold(chain, part * dt_s)
    rest, later = _hold(chain, (1.0 - part) * dt_s)
    n, size = len(chain.A), len(chain.A) + whole + 1
    step, drive = np.zeros((size, size)), np.zeros((size, 1))
    step[:n, :n] = rest @ a
    step[:n, size - 1] = rest @ early
    if whole:
        step[:n, size - 2] = later
    else:
        drive[:n, 0] = later
    step[n + 1 :, n:-1] = np.eye(whole)
    drive[n, 0] = 1.0
    out = np.zeros((len(chain.C), size))
    out[:, :n], out[:, size - 1] = chain.C, chain.D[:, 0]
    return Block("rig", step, drive, out, np.zeros((len(out), 1)), dt_s, ("command_v",), ())


def _hold(chain: StateSpace, time_s: float) -> tuple[Array, Array]:
    """Return transition (n, n) and response (n,) of a held unit command over a time."""
    n = len(chain.A)
    both = expm(np.block([[chain.A, chain.B], [np.zeros((1, n + 1))]]) * time_s)
    return both[:n, :n], both[:n, n]


def _smooth(chain: StateSpace, dt_s: float) -> Block:
    """Return the chain, sampled, for a model whose roots represent hold and latency, so that no hold is added."""
    return discretise(chain, dt_s, "foh", "rig", ("command_v",), ())


def _correction(info: RigInfo, removes_sensors: bool) -> Block:
    """Return the step's sensor correction without the integrators that correct the AC coupling."""
    channels = tuple(replace(channel, high_pass_hz=0.0) for channel in info.channels)
    block = correction(channels, info.dt_s, removes_sensors)
    kept = np.flatnonzero(np.arange(len(block.A)) % 3 < 2)
    return replace(block, A=block.A[np.ix_(kept, kept)], B=block.B[kept], C=block.C[:, kept])


def _own_alias(plant: Block, fixed: Block, model: Model, compared: ComparedBand) -> tuple[float, float]:
    """Return the alias that the sampled model's own hold adds to a corrected table sample.

    The first number is in m/s^2 per V of command change (first order in frequency), the second is a fraction of the
    response (second order, like an acceleration).
    """
    frequency = compared.with_high(1.0) * RIPPLE_HZ
    response = model.response(frequency)
    added = fixed.response(frequency)[0, 0] * plant.response(frequency)[0, 0] / response - 1.0
    alias = staircase(frequency, model.latency_samples, model.dt_s) / response
    rows = np.stack([alias, np.ones_like(alias)], axis=-1)
    both = np.concatenate([rows.real, rows.imag]), np.concatenate([added.real, added.imag])
    own, excess = np.linalg.lstsq(*both, rcond=None)[0]
    return float(own), float(excess)
