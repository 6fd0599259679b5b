"""Make the virtual rig that a rig file describes. Only here is `physics` read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.rigs.virtual.rig import VirtualRig, build_plant, changed

if TYPE_CHECKING:
    from rths_cli.case.models_rig import VirtualRigSpec
    from rths_cli.rigs.interface import RigInfo
    from rths_cli.structure import Specimen


def virtual_rig(
    spec: VirtualRigSpec,
    info: RigInfo,
    specimen: Specimen,
    interface_mass_kg: float,
    seed: tuple[int, ...],
    after_identification: bool,
) -> VirtualRig:
    """Return the rig of a rig file with this specimen on it; `seed` names the noise of the run.

    `after_identification` applies the changes of table and specimen that the rig file states under that key.
    """
    physics, noise = spec.physics, spec.sensors.noise_rms_m_s2
    if after_identification:
        physics, specimen = changed(physics, specimen, spec.after_identification)
    plant = build_plant(info, physics, specimen, noise, interface_mass_kg=interface_mass_kg)
    return VirtualRig(info, plant, seed)
