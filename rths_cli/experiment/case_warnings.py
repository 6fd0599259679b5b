"""Warnings about a case, printed and stored: doubtful units, several stiffness solutions, doubtful model, slower
feedback than asked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.keys_without_effect import unread_keys
from rths_cli.experiment.adaptive_check import adaptive_verdict
from rths_cli.experiment.check import range_assumption
from rths_cli.experiment.design import is_driven
from rths_cli.experiment.setup import place_of
from rths_cli.experiment.unit_plausibility import doubts_building, unit_doubts, unknown_consents
from rths_cli.findings import Finding, stated, without_repeats
from rths_cli.identification.results import LEAST_HELD_OUT
from rths_cli.structure import modes

if TYPE_CHECKING:
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification

STIFFNESS_SHARE = 0.05  # the same of the stiffness of an attached specimen
FREQUENCY_SHARE, DAMPING_SHARE = 0.02, 0.20  # largest difference from a declared value without a warning, relative
NEGLIGIBLE = 1e-4  # further difference that is ignored, in Hz or as a damping ratio
MOST_ABOVE_BAND = 0.10  # share of a compressed record's power above the test band without a warning
BANDWIDTH_SHARE = 0.9  # fraction of the requested bandwidth below which a warning is given


def of_case(setup: Setup, identified: Identification | None, design: Design | None) -> tuple[Finding, ...]:
    """Return the warnings of a case, on its units, building, identification and controller.

    What speaks against the test comes first, then what the user has to decide, then what the program did by itself.

    `identified` None: no table run, hence no identification; `design` None: no blocks.
    """
    unread = list(filter(None, [unread_keys(setup.case)]))
    of_building = [stated(note, "notes") for note in setup.building.notes]
    doubts, baseline = unit_doubts(setup), baseline_note(setup)
    if doubts_building(setup):  # what a wrong unit makes of bands and model tells nobody what to change
        return without_repeats((*doubts, *baseline, *unread, *of_building))
    found = [*doubts, *unknown_consents(setup), *baseline]
    if identified is not None:
        found += [*identified.verdict.refusals, *differences(setup, identified)]
    found += [
        *unread,
        *of_building,
        *modes_above_the_bands(setup),
        *record_above_the_band(setup),
        *_coupled_sensors(setup),
    ]
    if setup.building.has_laws and design is not None:
        found.append(Finding("assumption.laws"))
        if setup.building.has_program:
            found.append(Finding("assumption.program"))
    if design is not None:
        found += range_assumption(setup.case, design.blocks.counters_reaction)
    adaptive = None if design is None or identified is None else adaptive_verdict(setup, identified, design)
    if design is not None and adaptive is not None:
        values = {"name": design.blocks.feedforward.name, "parameters": ", ".join(adaptive.names)}
        found.append(Finding("assumption.adaptive", values | {"told": adaptive.told}))
    elif design is not None and getattr(design.blocks.feedforward, "declares", False):
        found.append(Finding("assumption.compensator", {"name": design.blocks.feedforward.name}))
    if "numerical" in setup.parts:
        found.append(_of_own_storeys(setup))
    if design is not None:
        found += [*slower_feedback(setup, design), *chosen_feedback(design), *chosen_filter(design)]
        found += [*friction_not_countered(setup, design, identified), *reaction_not_countered(design)]
    if identified is not None:
        found += identified.verdict.notes
    return without_repeats(found)


def baseline_note(setup: Setup) -> tuple[Finding, ...]:
    """Return the findings on the record, with file and line: its baseline, unless the case keeps it in so many words,
    and its other defects; () for a clean record."""
    kept = () if setup.baseline is None or setup.case.record.keeps_baseline else (setup.baseline,)
    place = place_of(setup.case, "record")
    return tuple(found.at("at.place", place=place) for found in (*kept, *setup.record_defects))


def modes_above_the_bands(setup: Setup) -> list[Finding]:
    """Return a warning where the building's first mode is above the test band, or the specimen's above the compared
    one: errors and model are then judged where nothing resonates."""
    building, case, parts = setup.building, setup.case, setup.building.specimen
    whole = float(modes(building.M, building.C, building.K)[0][0])
    if parts.attached:
        return [] if whole <= case.test_band_hz else [
            Finding("case.mode_above_test_band", {
                "band_hz": case.test_band_hz, "mode_hz": whole, "springs": "stiffness_n_per_m"
            })
        ]  # fmt: skip
    fixed = float(modes(np.diag(parts.masses_kg), parts.C, parts.K)[0][0])
    highest, told = case.identification.compared_hz[1], []
    if whole > case.test_band_hz:
        springs = (
            "natural_frequencies_hz" if case.structure.experimental.natural_frequencies_hz else "stiffness_n_per_m"
        )
        values = {"band_hz": case.test_band_hz, "mode_hz": whole, "springs": springs}
        told.append(Finding("case.mode_above_test_band", values))
    if fixed > highest:
        told.append(Finding("case.mode_above_compared_band", {"band_hz": highest, "mode_hz": fixed}))
    return told


def record_above_the_band(setup: Setup) -> list[Finding]:
    """Return warnings on a model larger than its prototype, and on a record whose compression moved much of its power
    (integral of the squared acceleration) above the test band."""
    scale, band_hz = setup.similitude, setup.case.test_band_hz
    if scale is None:
        return []
    told = []
    if scale.length < 1.0:
        told.append(Finding("scale.larger_model", {"length": scale.length, "inverse": 1.0 / scale.length}))
    accel = setup.motion.accel_m_s2
    power = np.abs(np.fft.rfft(accel)) ** 2
    above = float(power[np.fft.rfftfreq(accel.size, setup.motion.dt_s) > band_hz].sum() / power.sum())
    if above > MOST_ABOVE_BAND:
        values = {"factor": scale.factor("s"), "share": above, "band_hz": band_hz}
        told.append(Finding("scale.record_above_band", values))
    return told


def _of_own_storeys(setup: Setup) -> Finding:
    """Return what the result says of a numerical substructure of the caller's own."""
    if not setup.declared:
        return Finding("parts.no_building")
    return Finding("parts.own_building", {"nonlinear": not setup.building.linear})


def _coupled_sensors(setup: Setup) -> list[Finding]:
    """Return a warning if the step does not correct the accelerometers' AC coupling."""
    corner = max(channel.high_pass_hz for channel in setup.rig.channels)
    if setup.removes_sensors or corner == 0.0:
        return []
    return [Finding("case.sensor_coupling", {"corner_hz": corner})]


def slower_feedback(setup: Setup, design: Design) -> list[Finding]:
    """Return a note if the bandwidth of the feedback is below the requested one."""
    wanted = setup.case.controller.feedback_bandwidth_hz
    if wanted is None or design.feedback is None or design.feedback.bandwidth_hz >= BANDWIDTH_SHARE * wanted:
        return []
    return [Finding("design.slower_feedback", {"asked_hz": wanted, "designed_hz": design.feedback.bandwidth_hz})]


def chosen_feedback(design: Design) -> list[Finding]:
    """Return a note if the design chose other feedback weights than the default ones."""
    if design.chosen is None:
        return []
    weights = design.chosen.weights
    low, high = weights.disturbance_hz
    chosen = {"low_hz": low, "high_hz": high, "command_weight": weights.command_weight}
    usual = {"of_use": design.chosen.usual_of_use, "max_sensitivity": design.chosen.max_sensitivity}
    return [Finding("design.feedback", {**chosen, **usual})]


def chosen_filter(design: Design) -> list[Finding]:
    """Return a note if another filter than the usual one was chosen."""
    chosen = design.chosen_filter
    return [] if chosen is None else [Finding("design.filter", {"q": chosen.q, "residual_hz": chosen.residual_hz})]


def friction_not_countered(setup: Setup, design: Design, identified: Identification | None) -> list[Finding]:
    """Return a note if friction compensation was asked for and the identification does not show that it helps."""
    asked = is_driven(setup.case) and setup.case.controller.friction_compensation is True
    if not asked or design.blocks.friction_compensation is not None:
        return []
    friction = identified.friction if identified is not None else None
    if friction is None or friction.held_out is None:
        return [Finding("friction.not_countered")]
    return [Finding("friction.not_countered", {"removed": max(friction.held_out, 0.0), "needed": LEAST_HELD_OUT})]


def reaction_not_countered(design: Design) -> list[Finding]:
    """Return a note if the reaction of a changed specimen is not countered for a reason that is worth knowing."""
    return [Finding("reaction.not_countered", {"cause": design.reaction_left})] if design.reaction_left else []


def differences(setup: Setup, identified: Identification) -> list[Finding]:
    """Return a warning for each frequency and damping ratio of the specimen far from the declared value."""
    if identified.specimen is None:
        return []
    declared = setup.building.specimen
    if declared.attached:
        found_k, stated_k = float(identified.specimen.specimen.K[0, 0]), float(declared.K[0, 0])
        off = {"identified": found_k, "declared": stated_k, "share": STIFFNESS_SHARE}
        return [Finding("specimen.attached_stiffness", off)] if abs(found_k / stated_k - 1.0) > STIFFNESS_SHARE else []
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
