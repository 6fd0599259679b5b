"""The table and specimen that `rths serve` moves, made for the sample interval a runner asks for."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.loop.guard import fresh_guard
from rths_cli.loop.serving import TICKS_PER_INTERVAL, Table
from rths_cli.lti import Array
from rths_cli.rig_info import capabilities_of
from rths_cli.rigs.from_case import simulated
from rths_cli.rigs.udp.way import fresh_way
from rths_cli.rigs.virtual.kernel import fresh_state
from rths_cli.rigs.virtual.opening import virtual_rig
from rths_cli.rigs.virtual.plant import Plant
from rths_cli.workflows.rigs import EXP_RTHS, guard_limits
from rths_cli.workflows.setup import Setup, make_setup

if TYPE_CHECKING:
    from rths_cli.case.models_rig import VirtualRigSpec

CASE = "el_centro_low_ff_fb"  # lends what a rig and a structure do not state: they stand in its place
NOISE_ROWS = 1 << 17  # 131 s at 1 kHz, then it repeats


@dataclass(frozen=True)
class ServedRig:
    """A virtual rig with its specimen; its noise is that of the offline run EXP-RTHS with the same seed."""

    setup: Setup
    table: VirtualRigSpec
    seed: int

    @property
    def title(self) -> str:
        """Return what is served, in words."""
        return f"rig {self.setup.rig.name} with {self.channels - 1} floors of {self.setup.case.structure.name}"

    @property
    def channels(self) -> int:
        """Return how many channels the rig has."""
        return len(self.setup.rig.channels)

    @property
    def usual_dt_s(self) -> float:
        """Return the sample interval of the case that stands behind the rig."""
        return self.setup.rig.dt_s

    @cached_property
    def noise(self) -> Array:
        """Return rows of standard normal noise, (NOISE_ROWS, channels)."""
        return np.random.default_rng((self.seed, EXP_RTHS)).standard_normal((NOISE_ROWS, self.channels))


def describe(rig: str, structure: str, settings: tuple[str, ...], seed: int) -> ServedRig:
    """Return a rig file's virtual table with a structure's specimen; raises InputError."""
    from rths_cli.case.load import load_cases

    named = (f"table={json.dumps(rig)}", f"structure={json.dumps(structure)}", "damping={first_mode_ratio: 0.03}")
    typed = dict(zip(named, (f"rths serve {rig}", f"--structure {structure}", ""), strict=True))
    case = load_cases([CASE], (*named, *settings), typed)[0]
    if capabilities_of(case.table.kind).moves_hardware:
        raise InputError(f"{rig}: its kind is {case.table.kind}; only a virtual rig can be served")
    undamped = case.damping.model_copy(
        update={"first_mode_ratio": None, "dashpots_n_s_per_m": (0.0,) * len(case.structure.numerical.masses_kg)}
    )  # the computed storeys are not served
    return ServedRig(make_setup(case.model_copy(update={"damping": undamped})), simulated(case), seed)


def make_table(rig: ServedRig, interval_ns: int) -> Table:
    """Return table and specimen at rest, in ticks of a quarter of the interval."""
    tick_s = 1e-9 * interval_ns / TICKS_PER_INTERVAL
    plant = _plant(rig, tick_s)
    return Table(
        plant,
        fresh_state(plant, 0),
        guard_limits(rig.setup)._replace(dt_s=tick_s),
        fresh_guard(rig.channels),
        rig.noise,
        np.zeros(rig.channels),
        np.zeros(2),
        fresh_way(),
    )


def _plant(rig: ServedRig, tick_s: float) -> Plant:
    info = replace(rig.setup.rig, dt_s=tick_s)
    building = rig.setup.building
    mass = building.interface_experimental_mass_kg
    return virtual_rig(rig.table, info, building.specimen, mass, (0,), after_identification=True).plant
