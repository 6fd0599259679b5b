"""A table with a displacement sensor, a load cell, a strain gauge and further accelerometers beside the usual ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from bench import specimen
from hybrid import best_like, paper_like

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control import designed_blocks, kalman_filter, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Channel, RigInfo
from rths_cli.rigs.interface import as_commands
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

FIVE_AS_KEYS: list[dict[str, Any]] = [
    {"kind": "displacement", "position": "table", "unit": "mm", "sensitivity_v_per_unit": 0.1, "range": 95,
     "use": "guard"},
    {"kind": "force", "position": "table", "unit": "N", "sensitivity_v_per_unit": 0.02, "range": 450,
     "use": ["guard", "shear"], "plate_mass_kg": 1.5},
    {"kind": "strain", "position": "storey_3", "unit": "um/m", "sensitivity_v_per_unit": 0.001, "range": 9000},
    {"kind": "acceleration", "position": "floor_3", "unit": "m/s^2", "sensitivity_v_per_unit": 0.1, "range": 50},
    {"kind": "displacement", "position": "floor_2", "unit": "mm", "sensitivity_v_per_unit": 0.1, "range": 95},
]  # fmt: skip
"""Five further channels of a rig file, of four kinds."""
PLATE_KG = 1.5
RESIDUAL_HZ = 40.0


def displacement(uses: tuple[str, ...] = ("guard",), **own: float) -> Channel:
    return Channel(
        "table_displacement", 100.0, 0.095, 0.0, 0.0, kind="displacement", position="table", uses=uses, **own
    )  # fmt: skip


def cell(uses: tuple[str, ...] = ("guard", "shear"), **own: float) -> Channel:
    return Channel(
        "table_force", 0.02, 450.0, 0.0, 0.0, kind="force", position="table", uses=uses, plate_mass_kg=PLATE_KG, **own
    )  # fmt: skip


def strain(uses: tuple[str, ...] = ("log",)) -> Channel:
    return Channel("channel_1_strain", 1000.0, 9e-3, 0.0, 0.0, kind="strain", position="channel_1", uses=uses)


def five() -> tuple[Channel, ...]:
    """Return channels of four kinds, two of them logged only."""
    above = Channel("channel_2_acceleration", 0.1, 50.0, 0.0, 0.0, position="channel_2", uses=("log",))
    floor = Channel(
        "channel_1_displacement", 100.0, 0.095, 0.0, 0.0, kind="displacement", position="channel_1", uses=("guard",)
    )  # fmt: skip
    return displacement(), cell(), strain(), above, floor


def with_channels(info: RigInfo, further: tuple[Channel, ...]) -> RigInfo:
    """Return a rig with further channels."""
    return replace(info, further=further)


def with_cell(info: RigInfo, blocks: Blocks, weight: float, interface_mass_kg: float = 0.0) -> Blocks:
    """Return blocks of method best whose base shear has the share `weight` of the rig's load cell."""
    lead = blocks.lead_samples
    lead_s, place = lead * info.dt_s, info.shear_cell
    estimator = kalman_filter.with_residual(blocks.estimator, specimen(), RESIDUAL_HZ, lead_s)
    reads = designed_blocks.cell_reads(specimen().masses_kg, interface_mass_kg, PLATE_KG)
    columns = kalman_filter.cell_in_residual(estimator, RESIDUAL_HZ, lead_s, weight)
    assert place is not None
    return replace(
        blocks,
        estimator=estimator,
        interface=Interface(kalman_filter.plus_residual(blocks.interface.force)),
        further=sensor_correction.further_correction(info.further, info.dt_s),
        cell=designed_blocks.CellInput(place, reads, *columns, np.zeros(1)),
    )


def best_with_cell(info: RigInfo, interface_mass_kg: float = 0.0, weight: float = 0.7) -> Blocks:
    """Return `best_like` with a load cell."""
    return with_cell(info, best_like(info, interface_mass_kg), weight, interface_mass_kg)


def paper_with_cell(info: RigInfo, interface_mass_kg: float = 0.0, weight: float = 0.7) -> Blocks:
    """Return `paper_like` with a load cell."""
    blocks, place = paper_like(info, interface_mass_kg), info.shear_cell
    assert place is not None
    shear = kalman_filter.shear_with_cell(blocks.interface.force, specimen(), interface_mass_kg, weight)
    reads = designed_blocks.cell_reads(specimen().masses_kg, interface_mass_kg, PLATE_KG)
    nothing = np.zeros(len(blocks.estimator.A)), np.zeros(len(blocks.estimator.C))
    return replace(
        blocks,
        interface=Interface(shear),
        further=sensor_correction.further_correction(info.further, info.dt_s),
        cell=designed_blocks.CellInput(place, reads, *nothing, np.array([-weight])),
    )


class SpoiltRig:
    """A virtual table behind the bare interface; `spoil` changes samples (n,) in V, `wire` the command, step by step.

    `place_m` holds the true displacement of the table at every sample.
    """

    def __init__(self, info: RigInfo, physics: VirtualPhysics | None = None) -> None:
        self.info = info
        plant = build_plant(info, physics or VirtualPhysics(), specimen(), 3e-4)
        self.inner = VirtualRig(info, plant, (0, 1))
        self.k = 0
        self.place_m: list[float] = []
        self.commands_v: list[float] = []
        self.spoil: Callable[[int, Array], Array] = lambda k, samples: samples
        self.wire: Callable[[int, float], float] = lambda k, command: command

    def open(self) -> None: ...

    def arm(self) -> Array:
        self.k = 0
        return self._given(self.inner.arm())

    def exchange(self, command_v: float) -> Array:
        self.k += 1
        self.commands_v.append(command_v)
        return self._given(self.inner.exchange(as_commands(np.array([self.wire(self.k, command_v)]))))

    def rest(self) -> None: ...

    def close(self) -> None: ...

    def _given(self, samples: Array) -> Array:
        self.place_m.append(float(self.inner.state.state[0]))
        return self.spoil(self.k, samples.copy())
