"""The hidden physics of a virtual rig: only the virtual rig itself may read it, the import layers say so."""

from __future__ import annotations

from typing import Annotated

from rths_cli.case.field_types import Range, Strict


class VirtualPhysics(Strict):
    """Hold a virtual table's physics, m_t a = F - c_t v - F_c tanh(v/v_s) + f; defaults: APS 400."""

    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = 7.0
    viscous_n_s_per_m: Annotated[float, Range(ge=0, le=1e7)] = 8.0
    coulomb_n: Annotated[float, Range(ge=0, le=1e7)] = 0.3
    coulomb_velocity_m_s: Annotated[float, Range(gt=0, le=1)] = 0.001
    loop_frequency_hz: Annotated[float, Range(gt=0, le=1000)] = 14.0
    loop_damping_ratio: Annotated[float, Range(gt=0, le=10)] = 0.6
    actuator_time_constant_s: Annotated[float, Range(ge=1e-5, le=1)] = 0.0015
    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = 0.0079
    loop_specimen_mass_kg: Annotated[float, Range(ge=0, le=1e6)] = 13.86
    force_limit_n: Annotated[float, Range(gt=0, le=1e8)] = 445.0


class AfterIdentification(Strict):
    """Hold what changes in table and specimen after identification (damage, wear); 1 changes nothing."""

    specimen_stiffness_factor: Annotated[float, Range(gt=0, le=10)] = 1.0
    coulomb_factor: Annotated[float, Range(ge=0, le=100)] = 1.0
    payload_factor: Annotated[float, Range(gt=0, le=10)] = 1.0
