"""The virtual servo-hydraulic actuator with its load cell behind the interface of every rig.

The plant is rigs.virtual.servo_hydraulic with the mass of specimen and piston together. The load cell is between them:
it shows F_cell = clip(F) - m_piston x''. Two channels: displacement in m and force in N, each with gain error, noise,
range and bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.compiled import part_class
from rths_cli.numerics.lti import Array, Integers
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.laboratory import drawn, number_of
from rths_cli.rigs.virtual.plant_kernel import END_STOP, convert
from rths_cli.rigs.virtual.servo_hydraulic import (
    DISPLACEMENT,
    FORCE,
    VELOCITY,
    SampledActuator,
    ServoHydraulic,
    advance,
    limited,
    sampled_actuator,
)
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, inverse
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import VirtualActuatorSpec

CHANNELS = 2  # displacement, force


class ActuatorState(NamedTuple):
    """What the plant changes; `state` begins with the displacement, as compiled loops read it."""

    state: Array  # (1,) displacement in m
    inner: Array  # (5,) of the servo-hydraulic plant
    queue: Array  # (latency + 1,) commands under way in V, the oldest first
    middle_velocity: Array  # (2,) mean velocity of the interval in m/s; 0 for the load cell
    fault: Integers  # (1,) 0 or END_STOP


@part_class
class ActuatorPlant(NamedTuple):
    """An actuator and its specimen, with converters and sensors."""

    plant: SampledActuator
    specimen: Array  # (4,) stiffness and dashpot, mass with the piston, piston's mass
    m_per_v: float
    range_v: float
    step_v: float
    steps_per_v: float
    stroke_m: float
    dt_s: float
    noise: Array  # (2,) rms in m and N
    ranges: Array  # (2,) in m and N
    v_per_unit: Array  # (2,) true sensitivities

    def hold_command(self, s: ActuatorState, command_v: float) -> None:
        """Queue a command and hold the one that is due for a sample interval."""
        s.queue[s.queue.size - 1] = convert(command_v, self.step_v, self.steps_per_v, self.range_v)
        before = s.inner[DISPLACEMENT]
        advance(self.plant, s.inner, self.m_per_v * s.queue[0])
        for i in range(s.queue.size - 1):
            s.queue[i] = s.queue[i + 1] + 0.0
        s.state[0] = s.inner[DISPLACEMENT]
        s.middle_velocity[0] = (s.state[0] - before) / self.dt_s
        if not abs(s.state[0]) <= self.stroke_m:
            s.fault[0] = END_STOP

    def read_channels(self, s: ActuatorState, noise: Array, samples: Array) -> None:
        """Write the converted samples in V, (2,), for one row of standard normal noise (2,)."""
        pushed = limited(s.inner[FORCE], self.plant.limit_n)
        left = pushed - self.specimen[1] * s.inner[VELOCITY] - self.specimen[0] * s.inner[DISPLACEMENT]
        for c in range(2):
            value = s.inner[DISPLACEMENT] if c == 0 else pushed - self.specimen[3] / self.specimen[2] * left
            shown = limited(value + self.noise[c] * noise[c], self.ranges[c]) * self.v_per_unit[c]
            samples[c] = convert(shown, self.step_v, self.steps_per_v, self.range_v)


class ActuatorRig(VirtualRig):
    """A virtual actuator with a counted clock."""

    def __init__(self, info: RigInfo, plant: ActuatorPlant, seed: tuple[int, ...]) -> None:
        self._actuator = plant
        super().__init__(info, plant, seed)  # type: ignore[arg-type]

    def fresh(self) -> ActuatorState:
        """Return an actuator at rest."""
        late = self.info.latency_samples
        return ActuatorState(
            np.zeros(1), np.zeros(5), np.zeros(late + 1), np.zeros(CHANNELS), np.zeros(1, dtype=np.int64)
        )  # fmt: skip

    @property
    def normals(self) -> int:
        """Return how many standard normal numbers a reading of the channels takes."""
        return CHANNELS


def specimen_as_it_is(
    spec: VirtualActuatorSpec, specimen: Specimen, case_seed: int
) -> tuple[Specimen, dict[str, float]]:
    """Return the specimen with its true stiffness and damping, and every drawn value by key."""
    number = number_of(spec.imperfections, case_seed)
    values = {
        key: 0.0 if number is None else float(drawn(value, key, number, 1)[0])
        for key, value in spec.imperfections.drawn.items()
    }
    k, c = specimen.K * (1.0 + values["stiffness_error"]), specimen.C * (1.0 + values["damping_error"])
    return Specimen(specimen.masses_kg, k, c, specimen.attached), values


def actuator_rig(
    spec: VirtualActuatorSpec, info: RigInfo, specimen: Specimen, seed: tuple[int, ...], case_seed: int
) -> ActuatorRig:
    """Return the rig of a rig file with this specimen; `seed` names the noise of the run, from `case_seed` a laboratory
    is drawn whose file states no number. Raises InputError where neither piston nor specimen has a mass."""
    physics, sensors = spec.physics, spec.sensors
    there, values = specimen_as_it_is(spec, specimen, case_seed)
    mass = physics.piston_mass_kg + float(there.masses_kg[0])
    if not mass > 0.0:
        raise InputError(
            f"rig {info.name}: neither piston (physics.piston_mass_kg) nor specimen (structure.experimental.masses_kg) "
            "has a mass, and the virtual actuator moves one; state either"
        )
    c, k = float(there.C[0, 0]), float(there.K[0, 0])
    plant = ServoHydraulic(
        physics.valve_gain, physics.velocity_feedback, physics.oil_column_rad_s + values["oil_column_rad_s"],
        physics.valve_damping_rad_s * (1.0 + values["valve_damping_error"]),
        physics.valve_stiffness_rad2_s2 * (1.0 + values["valve_stiffness_error"]), physics.command_gain,
        mass, c, k, physics.force_limit_n,
    )  # fmt: skip
    converters, gains = info.converters, (values["displacement_gain_error"], values["force_gain_error"])
    declared = np.array([one.sensitivity_v_per_unit for one in info.channels])
    return ActuatorRig(
        info,
        ActuatorPlant(
            sampled_actuator(plant, info.dt_s), np.array([k, c, mass, physics.piston_mass_kg]), info.gain_m_per_v,
            converters.range_v, converters.step_v, inverse(converters.step_v), info.limits.stroke_m, info.dt_s,
            np.array([sensors.displacement_noise_m, sensors.force_noise_n]),
            np.array([one.range for one in info.channels]), declared * (1.0 + np.array(gains)),
        ),
        seed,
    )  # fmt: skip
