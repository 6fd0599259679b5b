"""Set up the imperfect table before a run: from what the rig file declares and a laboratory as it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.imperfect.plant import (
    ACCELERATION,
    BRISTLE,
    DISPLACEMENT,
    DQ,
    DRIFT,
    FARTHEST,
    FLOORS,
    FORCE,
    PITCH,
    F,
    ImperfectPlant,
    Mechanics,
    Sensing,
    X,
)
from rths_cli.rigs.virtual.laboratory import HUM_PHASE, PER_RUN, Laboratory
from rths_cli.structure.storey_laws import MAXWELL

if TYPE_CHECKING:
    from rths_cli.case.virtual_physics_schema import VirtualPhysics
    from rths_cli.rigs.description import RigInfo
    from rths_cli.structure import Specimen
    from rths_cli.structure.storey_laws import Laws

ERROR_M, ERROR_M_S, ERROR_N = 1e-10, 5e-9, 2e-8  # of a step, in displacements, velocities and the drive's force
ERROR_RAD, ERROR_RAD_S = 1e-10, 5e-9
ERROR_M_S2 = 1e-6  # of the deck's acceleration in the middle of a step
MAXWELL_PHASE = 1e-3  # rad of the specimen's fastest vibration in a step, where its laws need the way


class Output(NamedTuple):
    """What a channel senses: kind and place as in `imperfect.channels`, and the plate on a load cell at the table."""

    kind: int
    place: float
    plate_kg: float = 0.0


def imperfect_plant(
    info: RigInfo,
    physics: VirtualPhysics,
    specimen: Specimen,
    laws: Laws,
    noise_rms_m_s2: float,
    interface_mass_kg: float,
    laboratory: Laboratory,
    of_run: dict[str, Array],
    outputs: tuple[Output, ...] | None = None,
    precision: float = 1.0,
) -> ImperfectPlant:
    """Return the plant of a laboratory in one run.

    `specimen` and `laws` as they are, masses and what laws add at rest included. `outputs`: what each channel senses;
    None: the accelerations of the table and of each floor. `precision` multiplies the errors that a step may make (to
    check the integration). Raises InputError for instants too far from their clock.
    """
    value, stated = laboratory.one, laboratory.stated
    masses = specimen.masses_kg
    coil_kg, deck_kg, spring, dashpot = _deck(physics, laboratory, interface_mass_kg)
    omega = 2.0 * np.pi * physics.loop_frequency_hz
    loop_kg = physics.moving_mass_kg + interface_mass_kg + physics.loop_specimen_mass_kg
    presliding_m = value("friction.presliding_m")
    pitch_hz, heights = value("pitch.frequency_hz"), np.cumsum(laboratory.values["pitch.storey_height_m"])
    inertia, pitch_rate = stated.pitch.inertia_kg_m2, 2.0 * np.pi * pitch_hz
    rigid = inertia + float((masses * heights**2).sum())
    mechanics = Mechanics(
        coil_kg=coil_kg,
        deck_kg=deck_kg,
        deck_n_per_m=spring,
        deck_n_s_per_m=dashpot,
        viscous_n_s_per_m=physics.viscous_n_s_per_m,
        coulomb_n=physics.coulomb_n,
        per_friction_velocity=1.0 / physics.coulomb_velocity_m_s,
        stribeck_n=physics.coulomb_n * value("friction.stribeck_excess"),
        per_stribeck_velocity=1.0 / stated.friction.stribeck_velocity_m_s,
        bristle_n_per_m=physics.coulomb_n / presliding_m if presliding_m > 0.0 else 0.0,
        bristle_n_s_per_m=stated.friction.bristle_damping_n_s_per_m if presliding_m > 0.0 else 0.0,
        suspension_n_per_m=value("suspension.stiffness_n_per_m"),
        suspension_n_per_m3=value("suspension.cubic_n_per_m3"),
        loop_n_per_m=loop_kg * omega**2,
        loop_n_s_per_m=loop_kg * 2.0 * physics.loop_damping_ratio * omega,
        gain_m_per_v=physics.gain_m_per_v,
        per_time_constant=1.0 / physics.actuator_time_constant_s,
        force_limit_n=physics.force_limit_n,
        crossover_n=value("amplifier.crossover_n"),
        distortion_per_v2=value("amplifier.distortion") / stated.amplifier.distortion_at_v**2,
        gain_drift_per_s=value("amplifier.gain_drift_per_s"),
        force_drop_per_m2=value("force_factor.drop") / stated.force_factor.at_m**2,
        pitch_kg_m2=inertia if pitch_hz > 0.0 else 0.0,
        pitch_n_m=rigid * pitch_rate**2,
        pitch_n_m_s=2.0 * stated.pitch.damping_ratio * rigid * pitch_rate,
        gravity_m_s2=STANDARD_GRAVITY_M_S2,
        heights_m=heights if pitch_hz > 0.0 else np.zeros(len(masses)),
        masses_kg=masses,
        stiffness=specimen.K,
        damping=specimen.C,
        law_storey=laws.storey,
        law_code=laws.code,
        law_numbers=laws.numbers,
    )
    converters = info.converters
    return ImperfectPlant(
        mechanics=mechanics,
        sensing=_sensing(info, laboratory, of_run, noise_rms_m_s2, outputs or _outputs(info, interface_mass_kg)),
        tolerance=precision * _tolerance(len(masses)),
        tolerance_m_s2=precision * ERROR_M_S2,
        longest_s=_longest_s(specimen, laws, info.dt_s),
        dt_s=info.dt_s,
        lead_s=0.5 * info.dt_s if info.latency_samples > 0 else 0.0,
        stroke_m=info.limits.stroke_m,
        command_range_v=converters.range_v,
        command_step_v=converters.step_v,
        command_steps_per_v=1.0 / converters.step_v if converters.step_v > 0.0 else 0.0,
        command_skew_s=_instant(info, "converters.command_skew_s", value("converters.command_skew_s")),
        command_jitter_s=value("converters.command_jitter_s"),
        sample_jitter_s=value("converters.sample_jitter_s"),
        sensor_range_v=converters.range_v,
        sensor_step_v=converters.step_v,
        sensor_steps_per_v=1.0 / converters.step_v if converters.step_v > 0.0 else 0.0,
    )


def _deck(
    physics: VirtualPhysics, laboratory: Laboratory, interface_mass_kg: float
) -> tuple[float, float, float, float]:
    """Return masses of coil and deck in kg, and spring and dashpot between them; a rigid drive has no coil of its own.

    Raises InputError for a coil as heavy as all that moves.
    """
    moving, stated = physics.moving_mass_kg, laboratory.stated.deck
    rate = 2.0 * np.pi * laboratory.one("deck.frequency_hz")
    if rate == 0.0:
        return 0.0, moving + interface_mass_kg, 0.0, 0.0
    bare = moving - stated.coil_mass_kg
    if bare <= 0.0:
        raise InputError(
            f"table.imperfections.deck.coil_mass_kg: must be < {moving:g} (physics.moving_mass_kg), got "
            f"{stated.coil_mass_kg:g}; it is the coil's part of that mass"
        )
    return stated.coil_mass_kg, bare + interface_mass_kg, bare * rate**2, 2.0 * stated.damping_ratio * bare * rate


def _sensing(
    info: RigInfo,
    laboratory: Laboratory,
    of_run: dict[str, Array],
    noise_rms_m_s2: float,
    sensed: tuple[Output, ...],
) -> Sensing:
    """Return the constants of the channels."""
    channels, stated = info.all_channels, laboratory.stated
    of_channels = {key.removeprefix("channels."): value for key, value in laboratory.values.items()}
    across = of_channels["transverse_sensitivity"]
    corners = np.array([[one.low_pass_hz, one.high_pass_hz] for one in channels])
    _instant(info, "channels.skew_s", float(np.abs(of_channels["skew_s"]).max()))
    return Sensing(
        kind=np.array([one.kind for one in sensed], dtype=np.int64),
        place=np.array([one.place for one in sensed], dtype=float),
        low_pass=2.0 * np.pi * corners[:, 0] * (1.0 + of_channels["low_pass_error"]),
        high_pass=2.0 * np.pi * corners[:, 1] * (1.0 + of_channels["high_pass_error"]),
        gain=1.0 + of_channels["gain_error"] + of_run[PER_RUN],
        skew_s=of_channels["skew_s"],
        offset_v=of_channels["offset_v"],
        hum_v=of_channels["hum_v"],
        hum_phase=of_run[HUM_PHASE],
        hum_rate=2.0 * np.pi * stated.channels.hum_hz,
        walk_v=of_channels["offset_walk_v_per_sqrt_s"] * np.sqrt(info.dt_s),
        vertical=across * stated.pitch.sensor_arm_m,
        lateral=across * laboratory.one("guides.lateral_share"),
        noise=np.array([noise_rms_m_s2] * len(info.channels) + [one.noise_rms for one in info.further]),
        range=np.array([one.range for one in channels]),
        v_per_unit=np.array([one.sensitivity_v_per_unit for one in channels]),
        plate_kg=np.array([one.plate_kg for one in sensed], dtype=float),
    )


def _outputs(info: RigInfo, interface_mass_kg: float) -> tuple[Output, ...]:
    """Return what each channel of a rig senses, the accelerometers of table and floors first."""
    names = [channel.name for channel in info.channels]
    found = [Output(ACCELERATION, float(c)) for c in range(len(names))]
    kinds = {"acceleration": ACCELERATION, "displacement": DISPLACEMENT, "force": FORCE, "strain": DRIFT}
    for one in info.further:
        at = 0 if one.position == "table" else names.index(one.position.replace("storey_", "floor_"))
        plate = interface_mass_kg + one.plate_mass_kg if one.kind == "force" and at == 0 else 0.0
        found.append(Output(kinds[one.kind], float(at), plate))
    return tuple(found)


def _instant(info: RigInfo, key: str, skew_s: float) -> float:
    """Return a skew; raises InputError where it is too long for the sample interval of a rig with latency."""
    if info.latency_samples > 0 and abs(skew_s) > FARTHEST * info.dt_s:
        raise InputError(
            f"table.imperfections.{key}: must be within +-{1e6 * FARTHEST * info.dt_s:.4g} us, {FARTHEST:g} of the "
            f"sample interval, got {1e6 * skew_s:.4g} us"
        )
    return skew_s


def _tolerance(floors: int) -> Array:
    """Return the errors (k,) that a step may make in the state."""
    found = np.full(FLOORS + 2 * floors, ERROR_M_S)
    found[[X, DQ - 1, BRISTLE]], found[F] = ERROR_M, ERROR_N
    found[PITCH], found[PITCH + 1] = ERROR_RAD, ERROR_RAD_S
    found[FLOORS : FLOORS + floors] = ERROR_M
    return found


def _longest_s(specimen: Specimen, laws: Laws, dt_s: float) -> float:
    """Return the longest step: a law that remembers the time since its last drift needs short ones."""
    if MAXWELL not in laws.code:
        return dt_s
    fastest = np.sqrt(np.linalg.eigvals(specimen.K / specimen.masses_kg[:, None]).real.max())
    return float(min(dt_s, MAXWELL_PHASE / fastest))
