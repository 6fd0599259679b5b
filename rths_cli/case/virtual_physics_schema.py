"""Keys of a virtual rig's hidden physics; only rigs/virtual/ may read it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from rths_cli.case.field_types import Range, Strict
from rths_cli.case.storey_law_schema import StoreyLaws

Positive = Annotated[float, Range(gt=0, le=1e18)]


class VirtualPhysics(Strict):
    """Hold a virtual table's physics, m_t a = F - c_t v - F_c tanh(v/v_s) + f; defaults: APS 400."""

    moving_mass_kg: Annotated[float, Range(gt=0, le=1e5)] = Field(default=7.0, description="m_t, armature and table")
    viscous_n_s_per_m: Annotated[float, Range(ge=0, le=1e7)] = Field(default=8.0, description="c_t, viscous friction")
    coulomb_n: Annotated[float, Range(ge=0, le=1e7)] = Field(default=0.3, description="F_c, dry friction; 0: none")
    coulomb_velocity_m_s: Annotated[float, Range(gt=0, le=1)] = Field(
        default=0.001, description="v_s, velocity over which it changes its sign"
    )
    loop_frequency_hz: Annotated[float, Range(gt=0, le=1000)] = Field(
        default=14.0, description="w_c / 2 pi, of the displacement loop around the coil"
    )
    loop_damping_ratio: Annotated[float, Range(gt=0, le=10)] = Field(default=0.6, description="z_c of that loop")
    actuator_time_constant_s: Annotated[float, Range(ge=1e-5, le=1)] = Field(
        default=0.0015, description="tau, from wanted to actual force"
    )
    gain_m_per_v: Annotated[float, Range(gt=0, le=10)] = Field(
        default=0.0079, description="g, displacement per command"
    )
    loop_specimen_mass_kg: Annotated[float, Range(ge=0, le=1e6)] = Field(
        default=13.86, description="m_s, specimen mass that the loop was tuned for"
    )
    force_limit_n: Annotated[float, Range(gt=0, le=1e8)] = Field(default=445.0, description="largest force, +-")
    specimen_laws: StoreyLaws = Field(
        default=(),
        description="laws of the specimen's storeys from the table, which nobody knows of: per storey a law, a list of "
        "laws in parallel, or nothing; none: the specimen is linear",
    )

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out laws that there are none of, so that models of older versions stay those of their rig."""
        data: dict[str, Any] = write(self)
        return data if self.specimen_laws else {key: data[key] for key in data if key != "specimen_laws"}


class ActuatorNumbers(Strict):
    """Hold the numbers of rigs.virtual.servo_hydraulic."""

    valve_gain: Positive = Field(description="a_1 beta_0, from displacement error to valve")
    velocity_feedback: Annotated[float, Range(ge=0, le=1e12)] = Field(description="a_2, natural velocity feedback")
    oil_column_rad_s: Annotated[float, Range(ge=-1e6, le=1e6)] = Field(description="a_3, pole of the oil column")
    valve_damping_rad_s: Positive = Field(description="beta_1 of the valve")
    valve_stiffness_rad2_s2: Positive = Field(description="beta_2 of the valve")
    command_gain: Positive = Field(description="gain of the command")
    force_limit_n: Positive = Field(description="limit of the force, at which it is clipped")


class ServoHydraulicPhysics(ActuatorNumbers):
    """Hold the hidden physics of a servo-hydraulic actuator."""

    piston_mass_kg: Annotated[float, Range(ge=0, le=1e6)] = Field(
        default=0.0, description="mass that moves between oil and load cell, which the cell does not feel"
    )


class AfterIdentification(Strict):
    """Hold what changes in table and specimen after identification (damage, wear); 1 changes nothing."""

    specimen_stiffness_factor: Annotated[float, Range(gt=0, le=10)] = Field(
        default=1.0, description="on the specimen's stiffness (damage)"
    )
    coulomb_factor: Annotated[float, Range(ge=0, le=100)] = Field(default=1.0, description="on dry friction (wear)")
    payload_factor: Annotated[float, Range(gt=0, le=10)] = Field(default=1.0, description="on the specimen's masses")
    command_skew_s: Annotated[float, Range(ge=-0.01, le=0.01)] = Field(
        default=0.0,
        description="instant of the command after that of the identification, on a rig with latency within 0.45 of a "
        "sample interval; 0 changes nothing",
    )
