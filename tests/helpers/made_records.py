"""Records and systems the identification tests share: a rig's description, specimens, the default table excited."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control import sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import no_force
from rths_cli.control.state_space import static
from rths_cli.identification.excitation import Excitation, ExcitationSettings, plan
from rths_cli.identification.record_parts import Record
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.simulated_time_run import play
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array, Block, ComplexArray
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo, Uncertainty
from rths_cli.rigs.virtual.plant import accelerations, continuous
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant
from rths_cli.structure import Specimen, modal_damping_matrix, storey_matrix

PHYSICS = VirtualPhysics()


def make_specimen(
    stiffness: tuple[float, ...] = (7331.56, 7376.40), ratios: tuple[float, ...] = (0.043, 0.039)
) -> Specimen:
    """Return a specimen of floors near 7 kg."""
    masses = np.array([6.91, 6.95, 6.80][: len(stiffness)])
    K = storey_matrix(stiffness)
    return Specimen(masses, K, modal_damping_matrix(masses, K, ratios))


def make_info(
    specimen: Specimen, bits: int = 16, dt_s: float = 5e-4, stroke_m: float = 0.079, latency_samples: int = 1
) -> RigInfo:
    """Return what a laboratory knows of the default rig, whose sensors are exactly as declared."""
    names = ["table", *(f"floor_{i + 1}" for i in range(len(specimen.masses_kg)))]
    range_m_s2 = 5.0 * STANDARD_GRAVITY_M_S2
    one = Channel("", 1.0 / STANDARD_GRAVITY_M_S2, range_m_s2, 0.024, 1549.0, uncertainty=0.0)
    channels = tuple(replace(one, name=name) for name in names)
    limits = Limits(stroke_m, 1.0, 45.0, 445.0)
    payload = float(specimen.masses_kg.sum())
    converters = Converters(bits, 10.0)
    known = RigInfo("aps", "virtual", dt_s, channels, converters, latency_samples, limits, 0.0079, 7.0, payload)
    return replace(known, uncertainty=Uncertainty(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Excited:
    """A virtual rig's record: its plan, the command (n,) and the corrected channels (c, n)."""

    info: RigInfo
    specimen: Specimen
    plan: Excitation
    command_v: Array
    corrected: Array

    @property
    def record(self) -> Record:
        """Return it as identification takes it."""
        return Record(self.command_v, self.corrected, self.plan.parts)


def excite(
    specimen: Specimen, seed: int, duration_s: float = 60.0, info: RigInfo | None = None, coulomb_n: float = 0.3,
    noise_m_s2: float = 3e-4,
) -> Excited:  # fmt: skip
    """Play a planned excitation on the default table, or on one of another latency, rate, friction or noise."""
    info = info or make_info(specimen)
    excitation = plan(info, ExcitationSettings(duration_s=duration_s), seed)
    channels = len(info.channels)
    blocks = Blocks(
        correction=sensor_correction.correction(info.channels, info.dt_s),
        estimator=_silent(1, channels),
        numerical=_silent(3, 2),
        feedforward=_silent(1, 3),
        feedback=_silent(1, 1),
        interface=no_force(channels),
    )
    masses = np.concatenate([[7.0], specimen.masses_kg])
    limits = GuardLimits(
        0.079,
        1.0,
        45.0,
        445.0,
        10.0,
        np.inf,
        0.0079,
        info.dt_s,
        masses,
        np.full(channels, 5.0),
        np.full(channels, 1.0),
        np.full(channels, 45.0),
    )
    drive = np.column_stack([excitation.command_v, np.zeros((excitation.command_v.size, 2))])
    physics = PHYSICS.model_copy(update={"coulomb_n": coulomb_n})
    rig = VirtualRig(info, build_plant(info, physics, specimen, noise_m_s2), (seed, 7))
    outcome = play(rig, info, blocks, EXCITATION, drive, limits)
    assert outcome.stopped_by_limit == ""
    assert outcome.rig_fault == ""
    return Excited(info, specimen, excitation, outcome.log.command_v, outcome.log.corrected)


def _silent(outputs: int, inputs: int) -> Block:
    return static(np.zeros((outputs, inputs)), 5e-4, "silent", (), ())


def true_response(specimen: Specimen, frequency_hz: Array, delay_s: float = 7.5e-4) -> ComplexArray:
    """Return the default table's linear response to its command, from the equations of motion."""
    a, b_u, b_n, *_ = continuous(PHYSICS, specimen)
    rows, _ = accelerations(a, b_n, len(specimen.masses_kg))
    s = 2j * np.pi * frequency_hz
    states = np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b_u[:, None].astype(complex))
    return (rows[0] @ states)[:, 0] * np.exp(-s * delay_s)
