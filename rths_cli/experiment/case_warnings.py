"""Warnings about a case, printed and stored: doubtful units, several stiffness solutions, doubtful model, slower
feedback than asked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.keys_without_effect import sentence
from rths_cli.experiment.check import ASSUMPTIONS, range_assumption
from rths_cli.experiment.design import is_driven
from rths_cli.experiment.setup import placed
from rths_cli.experiment.unit_plausibility import doubts_building, unit_doubts, unknown_consents
from rths_cli.findings import Finding, sentences
from rths_cli.identification.results import LEAST_HELD_OUT
from rths_cli.structure import modes

if TYPE_CHECKING:
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification

FREQUENCY_SHARE, DAMPING_SHARE = 0.02, 0.20  # largest difference from a declared value without a warning, relative
NEGLIGIBLE = 1e-4  # further difference that is ignored, in Hz or as a damping ratio
MOST_ABOVE_BAND = 0.10  # share of a compressed record's power above the test band without a warning
BANDWIDTH_SHARE = 0.9  # fraction of the requested bandwidth below which a warning is given


def of_case(setup: Setup, identified: Identification | None, design: Design | None) -> tuple[str, ...]:
    """Return the warnings of a case, one sentence each, on its units, building, identification and controller.

    What speaks against the test comes first, then what the user has to decide, then what the program did by itself.

    `identified` None: no table run, hence no identification; `design` None: no blocks.
    """
    unread, doubts, baseline = sentence(setup.case), unit_doubts(setup), baseline_note(setup)
    if doubts_building(setup):  # what a wrong unit makes of bands and model tells nobody what to change
        return tuple(dict.fromkeys((*doubts, *baseline, *([unread] if unread else []), *setup.building.notes)))
    found = [*doubts, *unknown_consents(setup), *baseline]
    if identified is not None:
        found += [*identified.reasons, *sentences(differences(setup, identified))]
    found += [
        *([unread] if unread else []),
        *setup.building.notes,
        *modes_above_the_bands(setup),
        *record_above_the_band(setup),
        *_coupled_sensors(setup),
    ]
    if setup.building.has_laws and design is not None:
        found.append(ASSUMPTIONS)
    if design is not None and (told := range_assumption(setup.case, design.blocks.counters_reaction)):
        found.append(told)
    if "numerical" in setup.parts:
        found.append(_of_own_storeys(setup))
    if design is not None:
        found += [*slower_feedback(setup, design), *chosen_feedback(design), *chosen_filter(design)]
        found += [*friction_not_countered(setup, design, identified), *reaction_not_countered(design)]
    if identified is not None:
        found += identified.warnings
    return tuple(dict.fromkeys(found))


def baseline_note(setup: Setup) -> tuple[str, ...]:
    """Return the sentence on the baseline of the record, with file and line, () for a clean record and for one whose
    baseline the case keeps in so many words."""
    return () if not setup.baseline or setup.case.record.baseline == "none" else (placed(setup.case, setup.baseline),)


def modes_above_the_bands(setup: Setup) -> list[str]:
    """Return a sentence where the building's first mode is above the test band, or the specimen's above the compared
    one: errors and model are then judged where nothing resonates."""
    building, case, parts = setup.building, setup.case, setup.building.specimen
    whole = float(modes(building.M, building.C, building.K)[0][0])
    fixed = float(modes(np.diag(parts.masses_kg), parts.C, parts.K)[0][0])
    highest, told = case.identification.compared_hz[1], []
    if whole > case.test_band_hz:
        springs = (
            "natural_frequencies_hz" if case.structure.experimental.natural_frequencies_hz else "stiffness_n_per_m"
        )
        told.append(
            f"test_band_hz: errors up to {case.test_band_hz:g} Hz leave out the building's first mode, {whole:.3g} Hz; "
            f"raise it, or check the units of structure.experimental.{springs}"
        )
    if fixed > highest:
        told.append(
            f"identification.compared_hz: the model is compared up to {highest:.3g} Hz, below the specimen's first "
            f"mode, {fixed:.3g} Hz; raise it, or test_band_hz"
        )
    return told


def record_above_the_band(setup: Setup) -> list[str]:
    """Return sentences on a model larger than its prototype, and on a record whose compression moved much of its power
    (integral of the squared acceleration) above the test band."""
    scale, band_hz = setup.similitude, setup.case.test_band_hz
    if scale is None:
        return []
    told = []
    if scale.length < 1.0:
        told.append(
            f"scale.length: {scale.length:g} makes the model larger than its prototype; factors are prototype over "
            f"model, write {1.0 / scale.length:.4g} for a model that is smaller"
        )
    accel = setup.motion.accel_m_s2
    power = np.abs(np.fft.rfft(accel)) ** 2
    above = float(power[np.fft.rfftfreq(accel.size, setup.motion.dt_s) > band_hz].sum() / power.sum())
    if above > MOST_ABOVE_BAND:
        told.append(
            f"scale: the record, compressed in time by {scale.factor('s'):.4g}, has {100.0 * above:.0f} % of its "
            f"power above the test band, {band_hz:g} Hz, where errors are not judged; raise test_band_hz if the table "
            "reaches higher, or build a larger model"
        )
    return told


def _of_own_storeys(setup: Setup) -> str:
    """Return what the result says of a numerical substructure of the caller's own."""
    if not setup.declared:
        return (
            "the numerical substructure is the caller's own and declares no building: SIM, SIM-DELAY and errors are "
            "those of the case's building, and the storeys below the interface are not known (NaN)"
        )
    below = "" if setup.building.linear else "; the storeys below the interface are not known (NaN)"
    return (
        "the numerical substructure is the caller's own: SIM, SIM-DELAY and errors are those of the building that it "
        f"declares{below}"
    )


def _coupled_sensors(setup: Setup) -> list[str]:
    """Return a sentence if the step does not correct the accelerometers' AC coupling."""
    corner = max(channel.high_pass_hz for channel in setup.rig.channels)
    if setup.removes_sensors or corner == 0.0:
        return []
    return [
        f"identification.sensor_dynamics: kept leaves the accelerometers' AC coupling ({corner:g} Hz) in the base "
        "shear, which costs a fifth of SIM-DELAY's error on the default rig; the check does not count it; use removed"
    ]


def slower_feedback(setup: Setup, design: Design) -> list[str]:
    """Return a sentence if the bandwidth of the feedback is below the requested one."""
    wanted = setup.case.controller.feedback_bandwidth_hz
    if wanted is None or design.feedback is None or design.feedback.bandwidth_hz >= BANDWIDTH_SHARE * wanted:
        return []
    return [
        f"controller.feedback_bandwidth_hz: {wanted:g} Hz asked, {design.feedback.bandwidth_hz:.3g} Hz designed: the "
        "most that the identified band and max_sensitivity permit"
    ]


def chosen_feedback(design: Design) -> list[str]:
    """Return a sentence if the design chose other feedback weights than the default ones."""
    if design.chosen is None:
        return []
    weights = design.chosen.weights
    low, high = weights.disturbance_hz
    fault = "would leave the loop without the margins that the check asks for"
    return [
        f"controller: the usual feedback {fault if design.chosen.usual_of_use else 'is of no use on this table'}; "
        f"chosen instead: disturbance_hz: [{low:g}, {high:g}], command_weight: {weights.command_weight:g}, "
        f"max_sensitivity: {design.chosen.max_sensitivity:g}; state disturbance_hz or command_weight to choose yourself"
    ]


def chosen_filter(design: Design) -> list[str]:
    """Return a sentence if another filter than the usual one was chosen."""
    if design.chosen_filter is None:
        return []
    q, residual_hz = design.chosen_filter.q, design.chosen_filter.residual_hz
    return [
        "kalman: noise and rounding of the samples would be most of the error, so the base shear is taken from the "
        f"identified specimen more than from the measured floors: q: {q:g}, residual_hz: {residual_hz:.3g}; a specimen "
        "that changes between identification and test costs more so, and the loop is judged down to 85 % of it"
        " only; state q, residual_hz or kalman.choice: stated if it may lose more"
    ]


def friction_not_countered(setup: Setup, design: Design, identified: Identification | None) -> list[str]:
    """Return a sentence if friction compensation was asked for and the identification does not show that it helps."""
    asked = is_driven(setup.case) and setup.case.controller.friction_compensation is True
    if not asked or design.blocks.friction_compensation is not None:
        return []
    friction = identified.friction if identified is not None else None
    if friction is None or friction.held_out is None:
        shown = "the identification holds no low-level record on which it could be tried"
    else:
        shown = (
            f"the identified friction removes {100 * max(friction.held_out, 0.0):.0f} % of what the model leaves of "
            f"the low-level record, {100 * LEAST_HELD_OUT:.0f} % are needed"
        )
    return [f"controller.friction_compensation is off: {shown}"]


def reaction_not_countered(design: Design) -> list[str]:
    """Return a sentence if the reaction of a changed specimen is not countered for a reason that is worth knowing."""
    if not design.reaction_left:
        return []
    return [f"controller.reaction_feedforward: automatic leaves it off: {design.reaction_left}"]


def differences(setup: Setup, identified: Identification) -> list[Finding]:
    """Return a warning for each frequency and damping ratio of the specimen far from the declared value."""
    if identified.specimen is None:
        return []
    declared = setup.building.specimen
    frequency, damping = modes(np.diag(declared.masses_kg), declared.C, declared.K)
    pairs = (
        ("natural_frequency", frequency, identified.specimen.natural_frequency_hz, "Hz", FREQUENCY_SHARE),
        ("damping_ratio", damping, identified.specimen.damping_ratio, None, DAMPING_SHARE),
    )
    return [
        Finding(
            "specimen.not_as_declared",
            {
                "mode": mode + 1, "quantity": name, "identified": found[mode], "declared": abs(stated[mode]),
                "units": units, "share": share,
            },
        )
        for name, stated, found, units, share in pairs
        for mode in range(len(stated))
        if abs(found[mode] - stated[mode]) > share * abs(stated[mode]) + NEGLIGIBLE
    ]  # fmt: skip
