"""Sentences a user should read before trusting a result."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.structure import modes

if TYPE_CHECKING:
    from rths_cli.identification.evaluate import Identification
    from rths_cli.workflows.setup import Setup

FREQUENCY_SHARE, DAMPING_SHARE = 0.02, 0.20


def of_case(setup: Setup, identified: Identification | None) -> tuple[str, ...]:
    """Return what building and identification want said: other stiffness solutions, doubts, differences."""
    found = list(setup.building.notes)
    if identified is not None:
        found += [*identified.warnings, *identified.reasons, *differences(setup, identified)]
    return tuple(found)


def differences(setup: Setup, identified: Identification) -> list[str]:
    """Return a sentence per mode of the specimen whose identified value is far from the declared one."""
    if identified.specimen is None:
        return []
    declared = setup.building.specimen
    frequency, damping = modes(np.diag(declared.masses_kg), declared.C, declared.K)
    pairs = (
        ("natural frequency", frequency, identified.specimen.natural_frequency_hz, "Hz", FREQUENCY_SHARE),
        ("damping ratio", damping, identified.specimen.damping_ratio, "", DAMPING_SHARE),
    )
    return [
        f"specimen, mode {mode + 1}: identified {name} {found[mode]:.4g} {unit} differs from the declared "
        f"{stated[mode]:.4g} {unit} by more than {share:.0%}; SIM uses the declared one"
        for name, stated, found, unit, share in pairs
        for mode in range(len(stated))
        if abs(found[mode] - stated[mode]) > share * stated[mode]
    ]
