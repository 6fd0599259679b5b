"""The identified rig as one sampled block: command to the corrected samples of table and floors.

The identified table moves the identified specimen; between samples everything is exact for a held command. The
sensors' AC coupling is left out together with its correction, which cancels it but for the hold's alias: that passes
the coupling, and its integral is what `ripple_sum_m_s2_per_v` stands for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.sensor_correction import correction
from rths_cli.control.state_space import discretise, from_roots
from rths_cli.numerics.lti import Array, Block, Model, StateSpace, staircase
from rths_cli.numerics.matrix_equations import exponential
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

RIPPLE_HZ = np.array([2.0, 5.0, 10.0])  # where the hold's own alias in the sampled model is read off


@dataclass(frozen=True)
class IdentifiedRig:
    """`plant`: command (V) to raw samples (c,) in V; `correction` as the step has it, less what undoes AC coupling.

    `ripple_m_s2_per_v`: what a corrected table sample carries of a command change beyond what `plant` has;
    `ripple_sum_m_s2_per_v`: the whole alias's integral, from correcting the AC coupling; `plant` has none of it.
    `excess`: share of a table sample that is alias like an acceleration. An identification cannot tell it from the
    table's gain: table and floors move by that much less than the model says.
    """

    plant: Block
    correction: Block
    ripple_m_s2_per_v: float
    latency_samples: int
    ripple_sum_m_s2_per_v: float = 0.0
    excess: float = 0.0

    def alias_left(self, blocks: Blocks) -> tuple[float, float]:
        """Return what the step of these blocks leaves of the alias beside what `plant` has, m/s^2 per V of difference
        and of sum of the last two commands that act."""
        change = self.ripple_m_s2_per_v - blocks.ripple_m_s2_per_v
        return change, self.ripple_sum_m_s2_per_v - blocks.ripple_sum_m_s2_per_v


def identified_rig(model: Model, specimen: Specimen, info: RigInfo, removes_sensors: bool) -> IdentifiedRig:
    """Return the rig that a table model, a specimen and the declared sensors make.

    `removes_sensors`: the step takes the sensors' dynamics out of the samples, and the model knows nothing of them.
    """
    corners = [c.low_pass_hz if removes_sensors else 0.0 for c in info.channels]
    scale = np.array([c.sensitivity_v_per_m_s2 for c in info.channels])
    chain = _with_sensors(_with_specimen(_table(model), specimen), corners)
    sampled = _held(chain, model, info.dt_s) if model.delay_s > 0.0 else _smooth(chain, info.dt_s)
    plant = replace(sampled, C=scale[:, None] * sampled.C, D=scale[:, None] * sampled.D)
    fixed = _correction(info, removes_sensors)
    own, excess = _own_alias(plant, fixed, model) if model.delay_s > 0.0 else (0.0, 0.0)
    beyond = model.ripple_m_s2_per_v - own
    return IdentifiedRig(plant, fixed, beyond, model.latency_samples, model.ripple_sum_m_s2_per_v, excess)


def _table(model: Model) -> StateSpace:
    """Return the table's rational part, command to acceleration."""
    return from_roots(model.zeros, model.poles, model.gain)


def _with_specimen(table: StateSpace, specimen: Specimen) -> StateSpace:
    """Return command to the absolute accelerations of table and floors, (1 + n,)."""
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
    """Return the chain behind a hold and the rest of the model's delay, half a sample of which is the hold's own.

    With a delay of L + part samples the command of k - L - 1 acts for the first `part` of the interval k, that of
    k - L for the rest. States: the chain's, then the last L + 1 commands, the latest first.
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
    both = exponential(np.block([[chain.A, chain.B], [np.zeros((1, n + 1))]]) * time_s)
    return both[:n, :n], both[:n, n]


def _smooth(chain: StateSpace, dt_s: float) -> Block:
    """Return the chain for a model whose roots carry hold and latency: no hold of its own."""
    return discretise(chain, dt_s, "foh", "rig", ("command_v",), ())


def _correction(info: RigInfo, removes_sensors: bool) -> Block:
    """Return the step's sensor correction without the integrators that undo the AC coupling."""
    channels = tuple(replace(channel, high_pass_hz=0.0) for channel in info.channels)
    block = correction(channels, info.dt_s, removes_sensors)
    kept = np.flatnonzero(np.arange(len(block.A)) % 3 < 2)
    return replace(block, A=block.A[np.ix_(kept, kept)], B=block.B[kept], C=block.C[:, kept])


def _own_alias(plant: Block, fixed: Block, model: Model) -> tuple[float, float]:
    """Return what the sampled model's own hold adds to a corrected table sample: per V of command change (first order
    in the frequency), and as a share of the response (second order, like an acceleration)."""
    response = model.response(RIPPLE_HZ)
    added = fixed.response(RIPPLE_HZ)[0, 0] * plant.response(RIPPLE_HZ)[0, 0] / response - 1.0
    alias = staircase(RIPPLE_HZ, model.latency_samples, model.dt_s) / response
    rows = np.stack([alias, np.ones_like(alias)], axis=-1)
    both = np.concatenate([rows.real, rows.imag]), np.concatenate([added.real, added.imag])
    own, excess = np.linalg.lstsq(*both, rcond=None)[0]
    return float(own), float(excess)
