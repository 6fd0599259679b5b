"""Warnings that masses, stiffnesses or accelerations seem to be in another unit than their keys say."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.experiment.setup import placed
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building, mode_shapes, storey_values

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup

LARGEST_DRIFT_M = 10.0  # of a storey under 1 g sideways; by P-Delta, a storey lower than this drift does not stand
SMALLEST_DRIFT_M = 2.5e-4  # the same of the softest storey: 31 Hz of a single floor
LIGHTEST_FLOOR = 0.01  # heaviest numerical floor over the mean experimental one
LIGHTEST_SPECIMEN = 1e-3  # of the payload of its table
LARGEST_PEAK_M_S2 = 2.0 * STANDARD_GRAVITY_M_S2  # of a record before scaling
SMALLEST_PEAK_M_S2 = 0.5  # of a record that is scaled down further


def unit_doubts(setup: Setup) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a case: building, specimen on its table, record.

    Each begins with file and line of the key in doubt.
    """
    return (*specimen_doubts(setup), *(placed(setup.case, doubt) for doubt in _record_doubts(setup)))


def key_in_doubt(setup: Setup) -> str:
    """Return the first key whose value speaks for another unit than it must have, "" if none does."""
    doubts = (*(f"structure.{doubt}" for doubt in _specimen_doubts(setup)), *_record_doubts(setup))
    return doubts[0].partition(": ")[0] if doubts else ""


def specimen_doubts(setup: Setup) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a building and of its specimen on the case's table, with file
    and line of the key."""
    return tuple(placed(setup.case, f"structure.{doubt}") for doubt in _specimen_doubts(setup))


def _specimen_doubts(setup: Setup) -> tuple[str, ...]:
    found = building_doubts(setup.building)
    weight = float(setup.building.specimen.masses_kg.sum()) + setup.building.interface_experimental_mass_kg
    payload = setup.case.table.nominal.payload_kg
    if found or weight >= LIGHTEST_SPECIMEN * payload:
        return found
    share = f"{100.0 * weight / payload:.2g} % of what rig {setup.case.table.name} carries"
    return (f"experimental.masses_kg: the specimen weighs {weight:.3g} kg, {share}: are they in kg?",)


def building_doubts(building: Building) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a building, () if its masses and stiffnesses are plausible.

    Each begins with the key in a structure file.
    """
    drift = drift_under_1_g(building)
    worst = int(np.argmax(drift))
    if drift[worst] > LARGEST_DRIFT_M:
        part = "numerical" if worst < len(building.numerical.masses_kg) else "experimental"
        return (
            f"{part}.stiffness_n_per_m: first mode {_first_hz(building):.2g} Hz (under 1 g sideways storey "
            f"{worst + 1} would drift {drift[worst]:.3g} m): is it in N/m, and masses_kg in kg?",
        )
    if drift[worst] < SMALLEST_DRIFT_M:
        return (
            f"numerical.masses_kg: first mode {_first_hz(building):.2g} Hz (under 1 g sideways no storey would drift "
            f"more than {1e3 * drift[worst]:.2g} mm): are they in kg, and stiffness_n_per_m in N/m?",
        )
    numerical, experimental = np.diag(building.M)[: len(building.numerical.masses_kg)], building.specimen.masses_kg
    if numerical.max() < LIGHTEST_FLOOR * experimental.mean():
        return (
            f"numerical.masses_kg: floors of at most {numerical.max():.3g} kg carry experimental ones of "
            f"{experimental.mean():.3g} kg: are they in kg in both parts?",
        )
    return ()


def _first_hz(building: Building) -> float:
    return float(mode_shapes(building.M, building.K)[0][0])


def drift_under_1_g(building: Building) -> Array:
    """Return the drift (n,) in m of each storey, from the ground, under the weight of the floors above it sideways."""
    masses = np.diag(building.M)
    carried = np.cumsum(masses[::-1])[::-1]
    stiffness = np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)])
    return np.asarray(STANDARD_GRAVITY_M_S2 * carried / stiffness)


def _record_doubts(setup: Setup) -> tuple[str, ...]:
    """Return a sentence if the record is stronger than any, or is weak and scaled down further."""
    scaling = setup.case.scaling
    peak = float(np.abs(setup.motion.accel_m_s2).max()) / scaling
    size = f"record: {setup.case.record.name} peaks at {peak:.3g} m/s^2 ({peak / STANDARD_GRAVITY_M_S2:.2g} g)"
    if peak > LARGEST_PEAK_M_S2:
        return (f"{size} before scaling: is its unit right (m/s^2, cm/s^2, g)?",)
    if peak < SMALLEST_PEAK_M_S2 and scaling < 1.0:
        return (f"{size} before it is scaled down further: is its unit right (m/s^2, cm/s^2, g)?",)
    return ()


def before_error(doubts: Sequence[str], error: Exception) -> tuple[str, ...]:
    """Return doubts on units and the error that followed, without its figures and advice, which are of other causes."""
    if not doubts:
        return (str(error),)
    return (*doubts, f"a wrong unit would explain what followed: {re.split('[,;] ', str(error))[0]}")
