"""The virtual rig: kernel, sensors' noise and converters behind the interface of a real rig."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import RigError
from rths_cli.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.virtual import kernel
from rths_cli.rigs.virtual.plant import Plant, accelerations, continuous, parabola_response, with_sensors
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.case.virtual_physics import AfterIdentification, VirtualPhysics

LEVELS = 9  # inner steps from dt / 2 to dt / 512
NOISE_ROWS = 4096


def changed(
    physics: VirtualPhysics, specimen: Specimen, change: AfterIdentification
) -> tuple[VirtualPhysics, Specimen]:
    """Return table and specimen with what wear, damage or payload change after identification."""
    worn = physics.model_copy(update={"coulomb_n": physics.coulomb_n * change.coulomb_factor})
    masses, stiffness = specimen.masses_kg * change.payload_factor, specimen.K * change.specimen_stiffness_factor
    return worn, Specimen(masses, stiffness, specimen.C)


def build_plant(
    info: RigInfo,
    physics: VirtualPhysics,
    specimen: Specimen,
    noise_rms_m_s2: float,
    refine: int = 0,
    interface_mass_kg: float = 0.0,
) -> Plant:
    """Return the kernel's constant arrays; `refine` halves every inner step so often (to check the integration).

    The part of the interface floor's mass that stands on the table adds to the table's moving mass.
    """
    sensor, converters = info.channels[0], info.converters
    a, b_u, b_n, rows, row_command = continuous(physics, specimen, interface_mass_kg)
    accel_rows, accel_friction = accelerations(a, b_n, len(specimen.masses_kg))
    full, full_u, full_n = with_sensors(
        a, b_u, b_n, accel_rows, accel_friction, sensor.low_pass_hz, sensor.high_pass_hz
    )
    rows = np.hstack([rows, np.zeros((2, 2 * accel_rows.shape[0]))])
    steps = [info.dt_s / 2 ** (level + 1) for level in range(LEVELS + refine)]
    levels = [_level(full, np.column_stack([full_n, full_u]), rows, row_command, step) for step in steps]
    transition, hold, drive, node_rows, node_hold, node_drive = (
        np.array([level[i] for level in levels]) for i in range(6)
    )
    return Plant(
        transition=transition,
        hold=hold,
        drive=drive,
        node_rows=node_rows,
        node_hold=node_hold,
        node_drive=node_drive,
        start_rows=rows,
        start_hold=row_command,
        accel_rows=np.ascontiguousarray(accel_rows),
        accel_friction=accel_friction,
        mechanical=a.shape[0],
        has_low_pass=sensor.low_pass_hz > 0.0,
        dt_s=info.dt_s,
        friction_velocity_m_s=physics.coulomb_velocity_m_s,
        force_limit_n=physics.force_limit_n,
        stroke_m=info.limits.stroke_m,
        command_range_v=converters.range_v,
        command_step_v=converters.step_v,
        sensor_range_m_s2=sensor.range_m_s2,
        sensor_v_per_m_s2=sensor.sensitivity_v_per_m_s2,
        sensor_range_v=converters.range_v,
        sensor_step_v=converters.step_v,
        noise_rms_m_s2=noise_rms_m_s2,
        refine=refine,
    )


def _level(
    a: Array, b: Array, rows: Array, row_command: Array, step: float
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return transition, hold, drive, node_rows, node_hold, node_drive of one inner step; b ends with b_u."""
    middle, response = parabola_response(a, b, 0.5 * step, step)
    end, full = parabola_response(a, b, step, step)
    hold_middle, hold_end = response[:, 2].sum(axis=1), full[:, 2].sum(axis=1)
    node_rows = np.array([rows @ middle, rows @ end])
    node_hold = np.array([rows @ hold_middle + row_command, rows @ hold_end + row_command])
    node_drive = np.array([np.einsum("wn,nsj->wsj", rows, r[:, :2]) for r in (response, full)])
    return end, hold_end, full[:, :2], node_rows, node_hold, node_drive


class VirtualRig:
    """A simulated table and specimen with a counted clock: `exchange` returns at once, one interval later.

    The noise of each run comes from its own stream: `seed` is any sequence of integers that names the run.
    """

    def __init__(self, info: RigInfo, plant: Plant, seed: tuple[int, ...]) -> None:
        self.info = info
        self.plant = plant
        self._seed = seed
        self.restart()

    def restart(self) -> None:
        """Put the table at rest and start the noise anew."""
        self.state = kernel.fresh_state(self.plant, self.info.latency_samples)
        self._random = np.random.default_rng(self._seed)
        self._rows = np.empty((0, len(self.info.channels)))
        self._row = 0
        self._samples = np.zeros(len(self.info.channels))

    def noise(self, rows: int) -> Array:
        """Return the next rows of standard normal noise, (rows, n_channels)."""
        return self._random.standard_normal((rows, len(self.info.channels)))

    def open(self) -> None:
        """Take hold of the rig (nothing to do)."""

    def arm(self) -> Array:
        """Put the table at rest, return its first samples in V, (n_channels,)."""
        self.restart()
        return self._read()

    def exchange(self, command_v: float) -> Array:
        """Hold the command that is due for one interval and return the next samples in V, (n_channels,)."""
        kernel.hold_interval(self.plant, self.state, float(command_v))
        if self.state.fault[0] == kernel.END_STOP:
            raise RigError(f"rig {self.info.name}: the table ran into its end stop ({self.plant.stroke_m} m)")
        return self._read()

    def rest(self) -> None:
        """Bring the table to rest at zero (a virtual table may simply be put there)."""
        self.state = kernel.fresh_state(self.plant, self.info.latency_samples)

    def close(self) -> None:
        """Let go of the rig (nothing to do)."""

    def _read(self) -> Array:
        if self._row == len(self._rows):
            self._rows, self._row = self.noise(NOISE_ROWS), 0
        kernel.read_samples(self.plant, self.state, self._rows[self._row], self._samples)
        self._row += 1
        return self._samples
