"""The virtual rig: kernel, sensor noise and converters behind the interface of every rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.storey_law_schema import FrictionLaw, SofteningLaw, StoreyLaws
from rths_cli.errors import RigError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import padded, tiled
from rths_cli.rigs.interface import COMPILED_PLANT, Commands, RigInfo, one_actuator, only_command
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.further_outputs import further_outputs
from rths_cli.rigs.virtual.imperfect import plant as imperfect
from rths_cli.rigs.virtual.imperfect.from_laboratory import imperfect_plant
from rths_cli.rigs.virtual.imperfect.plant import ImperfectPlant, ImperfectState
from rths_cli.rigs.virtual.laboratory import Laboratory, laboratory_of, number_of, of_run
from rths_cli.rigs.virtual.plant import Parts, accelerations, continuous, levels, velocities, with_sensors
from rths_cli.rigs.virtual.plant_kernel import (
    NoLaws,
    Plant,
    PlantState,
    SpecimenLaws,
    law_columns,
    law_rows,
    level_of,
    specimen_with_laws,
)
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import VirtualRigSpec
    from rths_cli.case.virtual_physics_schema import AfterIdentification, VirtualPhysics
    from rths_cli.rigs.interface import RigInfo
    from rths_cli.structure import Specimen
    from rths_cli.structure.storey_laws import Laws

LEVELS = 10  # inner steps from dt to dt / 512
NOISE_ROWS = 4096
FURTHER, AT_REST = 21, 22  # stand behind the seed of the further channels' noise, and of that at rest before a run
LAWS_SOLVED = 1e-13  # of the specimen's weight, by which a law's force may still change
INTERPOLATED_M_S2 = 5e-7  # what interpolated friction may err by, as an acceleration of the table


def changed(
    physics: VirtualPhysics, specimen: Specimen, change: AfterIdentification
) -> tuple[VirtualPhysics, Specimen]:
    """Return table and specimen with what wear, damage or payload change after identification."""
    worn = physics.model_copy(update={"coulomb_n": physics.coulomb_n * change.coulomb_factor})
    masses, stiffness = specimen.masses_kg * change.payload_factor, specimen.K * change.specimen_stiffness_factor
    return worn, Specimen(masses, stiffness, specimen.C)


def true_specimen(spec: VirtualRigSpec, specimen: Specimen, seed: int) -> tuple[Specimen, Laws]:
    """Return the specimen as it stands on the table after the identification, and the laws of its storeys.

    Masses, stiffness and damping hold what the laws add at rest; storeys count from 0 at the table. `seed` is that of
    the case, from which a laboratory is drawn whose file states no number.
    """
    _, changed_specimen = changed(spec.physics, specimen, spec.after_identification)
    floors = len(specimen.masses_kg)
    further = [channel.sensitivity_uncertainty for channel in spec.channels or ()]
    return as_it_is(spec, changed_specimen, true_laboratory(spec, seed, floors, further))


def true_laboratory(spec: VirtualRigSpec, seed: int, floors: int, further: Sequence[float]) -> Laboratory | None:
    """Return the laboratory of a rig file, None for one that is exactly as declared.

    `further`: declared uncertainties of the sensitivities of the further channels.
    """
    number = number_of(spec.imperfections, seed)
    return None if number is None else laboratory_of(spec.imperfections, number, 1 + floors, floors, further)


def as_it_is(spec: VirtualRigSpec, specimen: Specimen, laboratory: Laboratory | None) -> tuple[Specimen, Laws]:
    """Return a specimen with its true masses and with what its laws add at rest, and its laws."""
    stated = spec.physics.specimen_laws
    if laboratory is not None:
        masses = specimen.masses_kg * (1.0 + laboratory.values["masses.weighing_error"])
        specimen, own = Specimen(masses, specimen.K, specimen.C), own_laws(laboratory)
        stated = tuple(of + more for of, more in zip(stated, own, strict=True)) if stated else own
    return specimen_with_laws(specimen, stated, STANDARD_GRAVITY_M_S2)


def own_laws(laboratory: Laboratory) -> StoreyLaws:
    """Return the laws of the storeys that a laboratory states as imperfections of its specimen."""
    stated, values = laboratory.stated.specimen, laboratory.values
    pairs = zip(values["specimen.softening"], values["specimen.joint_friction_n"], strict=True)
    laws: list[tuple[SofteningLaw | FrictionLaw, ...]] = []
    for softening, friction_n in pairs:
        soft = SofteningLaw(kind="softening", share=softening, half_drift_m=stated.softening_drift_m)
        joint = FrictionLaw(kind="friction", force_n=friction_n, sticking_displacement_m=stated.joint_sticking_m)
        laws.append(tuple(law for law, size in ((soft, softening), (joint, friction_n)) if size > 0.0))
    return tuple(laws)


def build_plant(
    info: RigInfo,
    physics: VirtualPhysics,
    specimen: Specimen,
    noise_rms_m_s2: float,
    refine: int = 0,
    interface_mass_kg: float = 0.0,
) -> Plant:
    """Return the kernel's constant arrays; `refine` halves every inner step so often (to check the integration).

    The part of the interface floor's mass that stands on the table adds to the table's moving mass. Raises InputError
    for laws of the specimen's storeys that do not fit it, or that no inner step is short enough for.
    """
    sensor, converters, floors = info.channels[0], info.converters, len(specimen.masses_kg)
    specimen, stated = specimen_with_laws(specimen, physics.specimen_laws, STANDARD_GRAVITY_M_S2)
    storeys, which = np.unique(stated.storey, return_inverse=True)
    a, b_u, b_n, rows, row_command = continuous(physics, specimen, interface_mass_kg)
    accel_rows, accel_friction = accelerations(a, b_n, floors)
    b_laws = law_columns(specimen.masses_kg, physics.moving_mass_kg + interface_mass_kg, storeys, len(a))
    accel_laws = velocities(len(a), floors) @ b_laws
    accel_inputs = np.column_stack([accel_friction, np.zeros(1 + floors), accel_laws])
    full, full_u, full_n = with_sensors(
        a, b_u, np.hstack([b_n, b_laws]), accel_rows, accel_inputs, sensor.low_pass_hz, sensor.high_pass_hz
    )
    scale = np.array([1.0 / physics.coulomb_velocity_m_s, 1.0])
    inputs, drifts = np.column_stack([full_n[:, :2], full_u, full_n[:, 2:]]), law_rows(floors, storeys, len(a))
    parts = Parts(full, inputs, len(a), rows, row_command, velocities(len(full), floors), scale, drifts)
    steps = levels(parts, info.dt_s, LEVELS + refine)
    laws: NoLaws | SpecimenLaws = NoLaws()
    if len(storeys):
        arguments, forces = np.array([one.arguments for one in steps]), padded(len(a) + 1)
        level = level_of(stated, which, specimen, arguments[:LEVELS], forces, info.dt_s)
        solved_n = LAWS_SOLVED * STANDARD_GRAVITY_M_S2 * float(specimen.masses_kg.sum())
        laws = SpecimenLaws(len(storeys), which, stated.code, stated.numbers, arguments, accel_laws, level, solved_n)
    swing = rows[1, 0] * np.eye(a.shape[0])[1] + rows[1, 1] * accel_rows[0]
    surge = a[1, 2] * (rows[1] - np.eye(a.shape[0])[2]) * info.dt_s / physics.actuator_time_constant_s
    surge_hold = a[1, 2] * row_command[1] * info.dt_s / physics.actuator_time_constant_s
    rates = 1.0 / physics.actuator_time_constant_s + abs(b_n[1, 0]) / physics.coulomb_velocity_m_s
    start = np.column_stack([np.vstack([accel_rows[0], rows[1], swing, surge]), [0.0, row_command[1], 0.0, surge_hold]])
    return Plant(
        push=np.array([one.push for one in steps]),
        filters=np.array([one.filters for one in steps]),
        nodes=np.array([one.nodes for one in steps]),
        feed=np.array([one.feed for one in steps]),
        start=np.concatenate([tiled(start), steps[0].nodes]),
        accel_rows=np.ascontiguousarray(accel_rows),
        accel_friction=accel_friction,
        steps_cubed=0.008 * physics.coulomb_n * a[1, 2] / INTERPOLATED_M_S2,
        bend=(info.dt_s * rates) ** 2,
        reference_per_velocity=float(rows[1, 1]),
        mechanical=a.shape[0],
        forces=padded(a.shape[0] + 1),
        has_low_pass=sensor.low_pass_hz > 0.0,
        dt_s=info.dt_s,
        per_friction_velocity=1.0 / physics.coulomb_velocity_m_s,
        force_limit_n=physics.force_limit_n,
        stroke_m=info.limits.stroke_m,
        command_range_v=converters.range_v,
        command_step_v=converters.step_v,
        command_steps_per_v=inverse(converters.step_v),
        sensor_range_m_s2=sensor.range,
        sensor_v_per_m_s2=sensor.sensitivity_v_per_unit,
        sensor_range_v=converters.range_v,
        sensor_step_v=converters.step_v,
        sensor_steps_per_v=inverse(converters.step_v),
        noise_rms_m_s2=noise_rms_m_s2,
        refine=refine,
        laws=laws,
        further=further_outputs(info, accel_rows, accel_friction, specimen.masses_kg, interface_mass_kg),
    )


def inverse(step: float) -> float:
    """Return 1 / step, 0 for none."""
    return 1.0 / step if step > 0.0 else 0.0


def normals(plant: Plant | ImperfectPlant) -> int:
    """Return how many standard normal numbers a reading of the channels takes."""
    if isinstance(plant, ImperfectPlant):
        return imperfect.normals(plant.sensing.kind.size)
    return int(plant.accel_rows.shape[0] + plant.further.range.size)


def fresh_state(plant: Plant | ImperfectPlant, latency_samples: int) -> PlantState | ImperfectState:
    """Return a table at rest."""
    if isinstance(plant, ImperfectPlant):
        return imperfect.fresh_state(plant, latency_samples)
    return plant_kernel.fresh_state(plant, latency_samples)


class VirtualRig:
    """A simulated table and specimen with a counted clock: `exchange` returns at once, one interval later.

    The noise of each run comes from its own stream: `seed` is any sequence of integers that names the run. Further
    channels have a stream beside it, so that they change nothing in the accelerometers.
    """

    offers = (COMPILED_PLANT,)

    def __init__(self, info: RigInfo, plant: Plant | ImperfectPlant, seed: tuple[int, ...]) -> None:
        one_actuator(info)
        self.info = info
        self.plant = plant
        self._seed = seed
        self.restart()

    def fresh(self) -> Any:
        """Return a table at rest."""
        return fresh_state(self.plant, self.info.latency_samples)

    @property
    def normals(self) -> int:
        """Return how many standard normal numbers a reading of the channels takes."""
        return normals(self.plant)

    def restart(self) -> None:
        """Put the table at rest and start the noise anew."""
        self._random = np.random.default_rng(self._seed)
        self._further_random = np.random.default_rng((*self._seed, FURTHER))
        self._rows = np.empty((0, self.normals))
        self._row = 0
        self.rest()

    def noise(self, rows: int) -> Array:
        """Return the next rows of standard normal noise, (rows, normals of the plant)."""
        if isinstance(self.plant, ImperfectPlant) or not self.info.further:
            return self._random.standard_normal((rows, self.normals))
        own = self._random.standard_normal((rows, len(self.info.channels)))
        return np.hstack([own, self._further_random.standard_normal((rows, len(self.info.further)))])

    def noise_at_rest(self, rows: int) -> Array | None:
        """Return noise of a rest before the run, (rows, normals): a stream of its own, so that no run depends on
        whether its rest is kept. None for a rig whose channels have no zero to be taken."""
        if not isinstance(self.plant, ImperfectPlant):
            return None
        return np.random.default_rng((*self._seed, AT_REST)).standard_normal((rows, normals(self.plant)))

    def open(self) -> None:
        """Take hold of the rig (nothing to do)."""

    def arm(self) -> Array:
        """Put the table at rest, return its first samples in V, (n_channels,)."""
        self.restart()
        return self._read()

    def exchange(self, command_v: Commands) -> Array:
        """Hold the command that is due for one interval and return the next samples in V, (n_channels,)."""
        self._command[0] = only_command(self.info, command_v)
        self._calls()[0]()
        if self.state.fault[0] == plant_kernel.END_STOP:
            raise RigError(f"rig {self.info.name}: the table ran into its end stop ({self.plant.stroke_m} m)")
        return self._read()

    def rest(self) -> None:
        """Bring the table to rest at zero (a virtual table may simply be put there)."""
        self.state = self.fresh()
        self._command, self._noise = np.zeros(1), np.zeros(self.normals)
        self._samples = np.zeros(len(self.info.all_channels))
        self._bound: tuple[Callable[[], object], Callable[[], object]] | None = None

    def close(self) -> None:
        """Let go of the rig (nothing to do)."""

    def _read(self) -> Array:
        if self._row == len(self._rows):
            self._rows, self._row = self.noise(NOISE_ROWS), 0
        self._noise[:] = self._rows[self._row]
        self._row += 1
        self._calls()[1]()
        return self._samples

    def _calls(self) -> tuple[Callable[[], object], Callable[[], object]]:
        """Return what holds and what reads, bound when first needed: a run in compiled code needs neither."""
        if self._bound is None:
            hold = plant_kernel.hold_interval.bind(self.plant, self.state, self._command)
            self._bound = hold, plant_kernel.read_samples.bind(self.plant, self.state, self._noise, self._samples)
        return self._bound


def virtual_rig(
    spec: VirtualRigSpec,
    info: RigInfo,
    specimen: Specimen,
    interface_mass_kg: float,
    seed: tuple[int, ...],
    after_identification: bool,
    case_seed: int = 0,
    session: tuple[int, ...] | None = None,
) -> VirtualRig:
    """Return the rig of a rig file with this specimen on it; `seed` names the noise of the run, `session` the runs
    between which nothing drifts (None: this one alone).

    `after_identification` applies the changes of table and specimen that the rig file states under that key. From
    `case_seed` a laboratory with imperfections is drawn whose file states no number.
    """
    physics, noise = spec.physics, spec.sensors.noise_rms_m_s2
    if after_identification:
        physics, specimen = changed(physics, specimen, spec.after_identification)
    floors, further = len(specimen.masses_kg), [one.uncertainty for one in info.further]
    laboratory = true_laboratory(spec, case_seed, floors, further)
    if after_identification and spec.after_identification.command_skew_s != 0.0:
        laboratory = laboratory or laboratory_of(spec.imperfections, case_seed, 1 + floors, floors, further)
        laboratory = _with_later_command(laboratory, spec.after_identification.command_skew_s)
    if laboratory is None:
        return VirtualRig(info, build_plant(info, physics, specimen, noise, 0, interface_mass_kg), seed)
    specimen, laws = as_it_is(spec, specimen, laboratory)
    this_run = of_run(laboratory, seed, len(info.all_channels), session)
    plant = imperfect_plant(info, physics, specimen, laws, noise, interface_mass_kg, laboratory, this_run)
    return VirtualRig(info, plant, seed)


def _with_later_command(laboratory: Laboratory, skew_s: float) -> Laboratory:
    """Return a laboratory whose commands act later."""
    key = "converters.command_skew_s"
    return replace(laboratory, values={**laboratory.values, key: laboratory.values[key] + skew_s})
