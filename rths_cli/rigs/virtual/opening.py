"""Make the virtual rig that a rig file describes. Only here is `physics` read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.rigs.virtual.plant import Physics
from rths_cli.rigs.virtual.rig import Change, VirtualRig, build_plant, changed

if TYPE_CHECKING:
    from rths_cli.case.models_rig import RigSpec
    from rths_cli.rigs.interface import RigInfo
    from rths_cli.structure import Specimen


def virtual_rig(
    spec: RigSpec,
    info: RigInfo,
    specimen: Specimen,
    interface_mass_kg: float,
    seed: tuple[int, ...],
    after_identification: bool,
) -> VirtualRig:
    """Return the rig of a rig file with this specimen on it; `seed` names the noise of the run.

    `after_identification` applies the changes of table and specimen that the rig file states under that key.
    """
    physics = Physics(**spec.physics.model_dump())
    if after_identification:
        change = Change(**spec.after_identification.model_dump())
        physics, specimen = changed(physics, specimen, change)
    plant = build_plant(
        info, physics, specimen, spec.sensors.noise_rms_m_s2, interface_mass_kg=interface_mass_kg
    )
    return VirtualRig(info, plant, seed)
