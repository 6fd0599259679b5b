"""Declarations of all metrics, of a run, its check, its design: path, unit, meaning, better direction.

To add one, declare it here and have the function that computes it return its value under this path.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from rths_cli.quantities.declaration import (
    ACCEL,
    BAND,
    COMPARED,
    FULL,
    LESS,
    MORE,
    NONE,
    ONE,
    TABLE_RUNS,
    ZERO,
    Quantity,
)

FEI = "Guo, Chen, Xu, Sanchez, Smart Mater. Struct. 23 (2014) 045042"
INDICATOR = "Mercan, Ricles, Earthq. Eng. Struct. Dyn. 36 (2007) 1523"
BENCHMARK = "Silva, Gomez, Maghareh, Dyke, Spencer, Mech. Syst. Signal Process. 135 (2020) 106381"
PSI = "Maghareh, Dyke, Prakash, Bunting, Earthq. Eng. Struct. Dyn. 43 (2014) 2299"
ENERGY = "Mosqueda, Stojadinovic, Mahin, J. Struct. Eng. 133 (2007) 1100"
GROUPS = (
    "ground", "shake_table", "exp_rths", "sim", "sim_delay", "budget", "check", "feedback", "controller", "latency",
    "identification",
)  # fmt: skip
KINDS = {
    "_true_full": "true, in full band",
    "_true": "true: before any sensor, which only a simulated rig knows",
    "_full": "in full band: no low pass",
    "_model": "with the model alone, not the measured response",
}
ALL, BANDS, TRUTH, MODEL = ("_true", "_full", "_true_full"), ("_full",), ("_true",), ("_model",)
CAUSES = {
    "coupling": "the base shear's filter, its prediction and the integration, on a perfect table",
    "latency": "what inverse and feedback leave of the table's lag",
    "model": "gain and delay of the table other than identified",
    "friction": "dry friction of the table, beyond what the model holds",
    "rounding": "rounding of commands to the converter's bits",
}
PREDICTED = {
    "model": "difference between the table's model and its measured response",
    "noise": "noise of the accelerometers, at rest",
    "quantisation": "rounding of samples to the converter's bits",
}
MEASURED = {
    "lost": "steps without samples (real rigs): what the loop got in their place, and commands that did not leave",
    "drift": "what offset, drift and jumps of the sensors did to the loop, the samples themselves freed of them",
    "declared": "the declared building, which SIM has, instead of the identified specimen",
    "specimen": "floors moving otherwise than the identified specimen on the measured table, and their noise",
    "rest": "the rest of the table's motion: noise, and whatever no other cause explains",
}
REACH = {
    "displacement_m": ("m", "table displacement, with room to brake"),
    "velocity_m_s": ("m/s", "table velocity"),
    "acceleration_m_s2": (ACCEL, "table acceleration"),
    "sensor_m_s2": (ACCEL, "acceleration at the accelerometers"),
    "force_n": ("N", "actuator force"),
    "command_v": ("V", "command"),
}
GUARDED = {
    "displacement_m": ("m", "displacement by the command, with room to brake"),
    "deviation_m": ("m", "distance of this displacement from the desired one"),
    "tracking_m_s2": (ACCEL, "tracking error"),
    "acceleration_m_s2": (ACCEL, "measured table acceleration"),
}
SENSORS = {
    "sensor_offset_v": ("V", "offset of each channel in the middle of the run, beside its zero at rest before it"),
    "sensor_offset_uncertainty_v": ("V", "standard uncertainty of the offset of each channel"),
    "sensor_drift_v_per_min": ("V/min", "drift of each channel in the run"),
    "sensor_drift_uncertainty_v_per_min": ("V/min", "standard uncertainty of the drift of each channel"),
    "sensor_jumps": ("1", "jumps of each channel in the run"),
    "sensor_usable_until_s": ("s", "time up to which each channel is usable, the record's end where all of it is"),
}
LATENCIES = {
    "converter": "the wait from samples to the hold they command",
    "hold": "the mean age of a held command",
    "transport": "the link between runner and rig",
    "inverse": "feedforward and table together, beyond the declared delay where that is explicit",
    "integration": "the integration of the numerical storeys, from base shear to interface acceleration",
    "sensor": "the accelerometers' low pass",
    "coupling": "the accelerometers' AC coupling (a lead: negative)",
    "kalman": "the base shear's estimate at one instant; left: in the base shear that the step uses",
}


def declared() -> Iterator[Quantity]:
    """Yield every metric in the order of the groups of a result, each with the suffixes it also has."""
    found = (
        *_of_ground(),
        *_of_table(),
        *_of_losses(),
        *_of_answers(),
        *_of_recordings(),
        *_of_actuators(),
        *_of_response(),
        *_against_sim(),
        *_of_check(),
        *_of_budget(),
        *_of_loop(),
        *_of_identification(),
    )
    yield from sorted(found, key=lambda one: GROUPS.index(one.group))


def variants(base: Quantity) -> Iterator[Quantity]:
    """Yield a quantity and what it also stands as: true, in full band, with the model alone."""
    yield base
    for suffix in base.kinds:
        band = FULL if base.band and suffix.endswith("_full") else base.band
        yield replace(base, path=base.path + suffix, text=f"{base.text}; {KINDS[suffix]}", band=band, kinds=())


def metric(path: str) -> Quantity | None:
    """Return what the metric of a path is (`exp_rths.rms_error_m_s2_true`), None where none is declared."""
    return METRICS.get(path)


def kinds_of(path: str) -> tuple[str, ...]:
    """Return the paths under which a metric stands: the one given and those with its suffixes; none for one unknown."""
    base = METRICS.get(path)
    return () if base is None else tuple(one.path for one in variants(base))


def metrics_of(*groups: str) -> dict[str, Quantity]:
    """Return every metric of some groups (`check`) by its path."""
    return {path: one for path, one in METRICS.items() if one.group in groups}


def _of_ground() -> Iterator[Quantity]:
    t1 = "at 5 % damping and the first period of the declared building"
    for name, units, text, scales in (
        ("pga_m_s2", ACCEL, "largest |acceleration|", ACCEL),
        ("pgv_m_s", "m/s", "largest |velocity|", "m/s"),
        ("pgd_m", "m", "largest |displacement|", "m"),
        ("arias_m_s", "m/s", "Arias intensity", "m^2/s^3"),
        ("cav_m_s", "m/s", "cumulative absolute velocity", "m/s"),
        ("d5_75_s", "s", "time from 5 to 75 % of the Arias intensity", "s"),
        ("d5_95_s", "s", "time from 5 to 95 % of the Arias intensity", "s"),
        ("mean_period_s", "s", "mean period, of Fourier amplitudes at 0.25 to 20 Hz", ""),
        ("housner_m", "m", "integral of the pseudo-velocity at 5 % damping over periods of 0.1 to 2.5 s", ""),
        ("t1_s", "s", "first period of the declared building", "s"),
        ("sa_t1_m_s2", ACCEL, f"pseudo-acceleration {t1}", ACCEL),
        ("sv_t1_m_s", "m/s", f"pseudo-velocity {t1}", "m/s"),
        ("sd_t1_m", "m", f"relative displacement {t1}", "m"),
        ("sa_avg_m_s2", ACCEL, "geometric mean of the pseudo-acceleration at 0.2 to 3 times that period", ACCEL),
    ):
        yield Quantity(
            f"ground.{name}", units, "", NONE, f"{text}, of the ground motion as it is played", scales_as=scales
        )


def _of_table() -> Iterator[Quantity]:
    error = "desired - measured table acceleration"
    for run in TABLE_RUNS:
        yield _lowest(run)
        for name, (units, text) in SENSORS.items():
            yield Quantity(f"{run}.{name}", units, "channel", NONE, text)
        yield Quantity(f"{run}.tracking_max_m_s2", ACCEL, "", LESS, f"largest |{error}|", ALL, BAND, scales_as=ACCEL)
        yield Quantity(f"{run}.tracking_rms_m_s2", ACCEL, "", LESS, f"RMS of {error}", ALL, BAND, scales_as=ACCEL)
        late = "delay of the measured against the desired table acceleration by cross-correlation, positive = late"
        yield Quantity(f"{run}.tracking_delay_s", "s", "", ZERO, late, TRUTH)
        index = "of the frequency evaluation index (FEI), measured over desired table acceleration"
        yield Quantity(f"{run}.fei_amplitude", "1", "", ONE, f"amplitude {index}, 1 = exact", TRUTH, reference=FEI)
        yield Quantity(f"{run}.fei_delay_s", "s", "", ZERO, f"delay {index}, positive = late", TRUTH, reference=FEI)
        area = "tracking indicator at the end of the record, positive = late"
        yield Quantity(
            f"{run}.tracking_indicator_m2_s4", "m^2/s^4", "", ZERO, area, (), BAND, INDICATOR, scales_as="m^2/s^4"
        )
        lag = "J1: lag of best correlation in whole samples, positive = late"
        yield Quantity(f"{run}.j1_s", "s", "", ZERO, lag, (), BAND, BENCHMARK)
        deviation, largest = f"J2: standard deviation of {error} over desired", f"J3: peak of {error} over desired"
        yield Quantity(f"{run}.j2", "1", "", LESS, deviation, BANDS, BAND, BENCHMARK)
        yield Quantity(f"{run}.j3", "1", "", LESS, largest, BANDS, BAND, BENCHMARK)


def _of_actuators() -> Iterator[Quantity]:
    """Yield what a test has whose actuator follows a displacement and whose load cell returns the force."""
    error, only = "desired - measured displacement of the interface", "where a displacement is commanded"
    for name, text in (("max", f"largest |{error}|"), ("rms", f"RMS of {error}")):
        yield Quantity(f"exp_rths.tracking_{name}_m", "m", "", LESS, f"{text} ({only})", TRUTH, BAND)
    about = "RMS of SIM - displacement of each storey, the interface's as measured"
    yield Quantity("exp_rths.rms_disp_error_m", "m", "storey", LESS, f"{about} ({only})", (), BAND)
    yield Quantity(
        "exp_rths.disp_nrmse_percent", "%", "storey", LESS, f"{about}, in percent of SIM's ({only})", (), BAND
    )
    true = "RMS of SIM - true displacement of the interface, in percent of SIM's, which only a simulated rig knows"
    yield Quantity("exp_rths.interface_disp_nrmse_percent_true", "%", "", LESS, f"{true} ({only})", (), BAND)
    yield Quantity("exp_rths.peak_measured_force_n", "N", "", NONE, f"largest |force| of the load cell ({only})")
    predicted = "predicted RMS error of the interface's displacement against SIM as identified, in percent of SIM's"
    yield Quantity("check.interface_disp_error_percent", "%", "", LESS, f"{predicted} ({only})", (), BAND)


def _of_recordings() -> Iterator[Quantity]:
    """Yield how the recording of a run that was made elsewhere lies on the record."""
    only = "run made elsewhere only"
    for run in TABLE_RUNS:
        for name, units, text in (
            ("recording_start_s", "s", "time of the recording at which the record begins"),
            ("recording_start_error_s", "s", "standard uncertainty of it"),
            ("recording_clock_fast", "1", "by how much the recorder's clock is faster than the file states, relative"),
            ("recording_clock_error", "1", "standard uncertainty of it"),
            ("recording_ground_gain", "1", "recorded ground motion over that of the case"),
            ("recording_ground_left", "1", "part of its RMS that is not the case's ground motion"),
            ("recording_interpolated", "1", "whether its samples were interpolated (1) or taken as they are (0)"),
        ):
            yield Quantity(f"{run}.{name}", units, "", NONE, f"{text} ({only})")


def _lowest(run: str) -> Quantity:
    text = "lowest reliable frequency: corner of the zero-phase high pass that all errors are evaluated with"
    return Quantity(f"{run}.high_pass_hz", "Hz", "", NONE, text)


def _of_losses() -> Iterator[Quantity]:
    about = "steps of the record, on a real rig,"
    for run in TABLE_RUNS:
        yield Quantity(f"{run}.lost_steps", "1", "", NONE, f"{about} whose samples were lost")
        yield Quantity(f"{run}.overrun_steps", "1", "", NONE, f"{about} late by an interval, or caught up")
        mixed = f"{about} after a gap, given a mix of samples and expectation that stands in the measured series"
        yield Quantity(f"{run}.mixed_steps", "1", "", NONE, mixed)
        gap = "longest time without samples of the right instant, on a real rig"
        yield Quantity(f"{run}.longest_gap_s", "s", "", NONE, gap)


def _of_answers() -> Iterator[Quantity]:
    only = "simulated time, where a program computes storeys"
    for name, units, text in (
        ("program_late_answers", "1", "answers that came later than compute_time_s"),
        ("program_slow_downs", "1", "requests left out because the answer before was still to come"),
        ("program_extrapolations", "1", "times that the residual force went on beyond its interval"),
        ("program_latest_s", "s", "largest time by which an answer was late"),
    ):
        yield Quantity(f"exp_rths.{name}", units, "", NONE, f"{text} ({only})")


def _of_response() -> Iterator[Quantity]:
    said = {"sim": "SIM", "sim_delay": "SIM-DELAY", "exp_rths": "EXP-RTHS"}
    for run, label in said.items():
        for name, units, about in (
            ("abs_accel_m_s2", ACCEL, "absolute acceleration"),
            ("rel_disp_m", "m", "displacement relative to the ground"),
            ("inter_storey_drift_m", "m", "inter-storey drift"),
            ("drift_ratio", "1", "inter-storey drift over the storey's height (where heights_m is given)"),
            ("storey_shear_n", "N", "storey shear"),
        ):
            text = f"largest |{about}| of {label}, all frequencies"
            yield Quantity(f"{run}.peak_{name}", units, "storey", NONE, text, scales_as=units)
        yield from _of_laws(run, label)
        largest = f"largest |base shear| of the building, {label}"
        yield Quantity(f"{run}.peak_building_base_shear_n", "N", "", NONE, largest, scales_as="N")
        ratio = f"largest |base shear| over the building's weight, {label}"
        # gravity is not scaled, so the weight scales as the mass
        yield Quantity(f"{run}.building_base_shear_ratio", "1", "", NONE, ratio, scales_as=ACCEL)


def _of_laws(run: str, label: str) -> Iterator[Quantity]:
    only = "where storeys have laws"
    ductility = f"largest |inter-storey drift| over the yield drift of the storey's laws, {label} ({only})"
    yield Quantity(f"{run}.ductility", "1", "storey", NONE, ductility, partial=True)
    residual = f"inter-storey drift at the record's last sample, {label}, not at rest ({only}"
    residual += ")" if run.startswith("sim") else "; of the computed storeys: accelerometers do not know the others')"
    yield Quantity(f"{run}.residual_drift_m", "m", "storey", NONE, residual, scales_as="m", partial=True)
    if run == "exp_rths":
        yield from _of_residual_drift(only)
    work = f"work of the storey's spring and laws up to the record's end, {label}, without dashpots ({only})"
    yield Quantity(f"{run}.restoring_work_j", "J", "storey", NONE, work, scales_as="J", partial=True)


def _of_residual_drift(only: str) -> Iterator[Quantity]:
    change = f"larger change of SIM's residual drift by a base shear that is 1 % larger or smaller ({only})"
    yield Quantity("exp_rths.residual_drift_change_m", "m", "storey", NONE, change, scales_as="m", partial=True)
    shear = "relative standard uncertainty of the base shear: that of the case (base_shear_uncertainty) and the "
    shear += f"tracking error over the interface's acceleration, as the root of their squares ({only})"
    yield Quantity("exp_rths.base_shear_uncertainty", "1", "", NONE, shear)
    unsure = f"standard uncertainty of the residual drift, from that of the base shear ({only})"
    yield Quantity("exp_rths.residual_drift_uncertainty_m", "m", "storey", NONE, unsure, scales_as="m", partial=True)


def _against_sim() -> Iterator[Quantity]:
    yield _lowest("sim_delay")
    for run, kinds in (("sim_delay", BANDS), ("exp_rths", ALL)):
        for which, words in (("rms", "RMS of {}"), ("max", "largest |{}|")):
            about = words.format("SIM - absolute acceleration of each storey")
            better = LESS if run == "exp_rths" else NONE
            path = f"{run}.{which}_error_m_s2"
            yield Quantity(path, ACCEL, "storey", better, about, kinds, BAND, scales_as=ACCEL)
            of_sim = f"{about}, in percent of {words.format('SIM')}"
            name = "nrmse" if which == "rms" else "peak_error"
            yield Quantity(f"{run}.{name}_percent", "%", "storey", better, of_sim, kinds, BAND)
    yield from _against_truth()
    yield from _after_run()
    floors = {4: "the interface storey", 6: "the lowest other storey", 7: "the second lowest other storey"}
    for number, storey in floors.items():
        deviation = f"J{number}: standard deviation of SIM - EXP-RTHS over SIM, absolute acceleration of {storey}"
        peak = 5 if number == 4 else number + 2
        yield Quantity(f"exp_rths.j{number}", "1", "", LESS, deviation, BANDS, BAND, BENCHMARK)
        largest = f"J{peak}: peak of SIM - EXP-RTHS over SIM, absolute acceleration of {storey}"
        yield Quantity(f"exp_rths.j{peak}", "1", "", LESS, largest, BANDS, BAND, BENCHMARK)
    energy = "energy that the tracking error feeds into the structure, int f (v_desired - v_measured) dt"
    yield Quantity("exp_rths.energy_error_j", "J", "", ZERO, energy, TRUTH, reference=ENERGY, scales_as="J")
    ratio = f"{energy}, over SIM's largest input energy"
    yield Quantity("exp_rths.energy_error_ratio", "1", "", ZERO, ratio, TRUTH, reference=ENERGY)
    for run in ("sim", "sim_delay"):
        own = "own estimate of the solution's error over its peak"
        yield Quantity(f"{run}.solution_error", "1", "", NONE, own)
    critical = "pure delay of the base shear at which the hybrid test loses stability (0: any delay does)"
    critical += "; with laws of storeys the smallest of all their tangents, an indication"
    yield Quantity("sim_delay.critical_delay_s", "s", "", NONE, critical)
    psi = "predictive stability indicator (PSI): log10 of the critical delay in ms"
    yield Quantity("sim_delay.psi", "1", "", MORE, psi, reference=PSI)
    diverged = "when SIM-DELAY was cut, if it was"
    yield Quantity("sim_delay.diverged_at_s", "s", "", NONE, diverged, scales_as="s")


def _against_truth() -> Iterator[Quantity]:
    """Yield the errors against SIM of the declared numerical storeys below the specimen as it is."""
    about = "against SIM of the declared numerical storeys below the specimen as it is (simulated rig only)"
    for run, what, better in (
        ("exp_rths", "RMS of the true absolute acceleration of each storey", LESS),
        ("sim_delay", "RMS of SIM-DELAY of that building, absolute acceleration of each storey,", NONE),
    ):
        path = f"{run}.true_reference_rms_error_m_s2"
        yield Quantity(path, ACCEL, "storey", better, f"{what} {about}", (), BAND, scales_as=ACCEL)
        path = f"{run}.true_reference_nrmse_percent"
        yield Quantity(path, "%", "storey", better, f"{what} {about}, in percent of RMS of that SIM", (), BAND)
    ratio = "error of EXP-RTHS over that of SIM-DELAY, RMS, both against the true reference (simulated rig only)"
    yield Quantity("exp_rths.true_reference_ratio", "1", "storey", LESS, ratio, (), BAND)
    rank = "probability of a smaller error than the true one, by its distribution after the run (simulated rig only)"
    yield Quantity("exp_rths.true_error_rank", "1", "storey", NONE, rank, (), BAND)
    beyond = "measured RMS error of each storey over the one that the check expected"
    yield Quantity("exp_rths.error_over_expected", "1", "storey", NONE, beyond, (), BAND)


def _after_run() -> Iterator[Quantity]:
    """Yield what a run's own records tell of its true error and of its specimen."""
    reference = "SIM of the declared computed storeys below the specimen as identified, or as found in the run"
    path = "exp_rths.identified_reference_rms_error_m_s2"
    yield Quantity(path, ACCEL, "storey", LESS, f"measured RMS error against {reference}", (), BAND, scales_as=ACCEL)
    path, about = "exp_rths.identified_reference_nrmse_percent", f"the same in percent of the RMS of {reference}"
    yield Quantity(path, "%", "storey", LESS, about, (), BAND)
    about = "RMS error of the loop as measured, by computed storeys beside measured table and floors"
    yield Quantity("exp_rths.measured_loop_rms_error_m_s2", ACCEL, "storey", LESS, about, (), BAND, scales_as=ACCEL)
    for name, what in (
        ("following", "the table not following the desired motion"),
        ("computing", "the desired motion not being what the computed storeys do under ground and base shear"),
    ):
        path, about = f"exp_rths.{name}_rms_error_m_s2", f"part of the loop's RMS error by {what} (recorded run only)"
        yield Quantity(path, ACCEL, "storey", LESS, about, (), BAND, scales_as=ACCEL)
    for name, text in (("median", "is as likely exceeded as not"), ("bound", "is not exceeded with 95 %")):
        about = f"true RMS error that {text}, by what the run measured and what sensors cannot show"
        yield Quantity(f"exp_rths.true_error_{name}_m_s2", ACCEL, "storey", LESS, about, (), BAND, scales_as=ACCEL)
        about = f"{about}, in percent of the RMS of {reference}"
        yield Quantity(f"exp_rths.true_error_{name}_percent", "%", "storey", LESS, about, (), BAND)
    about = "RMS of the true error by the uncertainty of the calibration, after the run"
    yield Quantity("exp_rths.true_error_calibration_m_s2", ACCEL, "storey", NONE, about, (), BAND, scales_as=ACCEL)
    unsure = "its standard uncertainty"
    for name, over, text in (
        ("stiffness_over_declared", "storey", "identified stiffness over the declared one"),
        ("mass_over_declared", "storey", "identified mass of the floor over the declared one"),
        ("damping_over_declared", "mode", "identified damping ratio of the specimen over the declared one"),
        ("stiffness_change", "storey", "stiffness in the run over the identified one, less 1"),
    ):
        partial = over == "storey"
        yield Quantity(f"exp_rths.{name}", "1", over, NONE, f"{text}, of the specimen", partial=partial)
        yield Quantity(f"exp_rths.{name}_error", "1", over, NONE, f"{unsure}: {text}, of the specimen", partial=partial)
    changed = "whether the specimen has changed since the identification (1) or not (0), by more than its uncertainty"
    yield Quantity("exp_rths.specimen_changed", "1", "", NONE, changed)
    left = "part of the floors' motion in the run that a chain of storeys on the measured table does not explain"
    yield Quantity("exp_rths.specimen_unexplained", "1", "", NONE, left)
    share = "base shear of the physical part over the inertia force of the computed interface floor, RMS"
    yield Quantity("exp_rths.specimen_share", "1", "", NONE, share, (), BAND)
    without = "largest change of a computed storey without the physical part, RMS in percent of SIM"
    yield Quantity("exp_rths.without_specimen_percent", "%", "", NONE, without, (), BAND)


def _of_check() -> Iterator[Quantity]:
    for path, units, text in (
        ("spectral_radius", "1", "largest |eigenvalue| of the sampled closed loop (1: limit)"),
        ("growth", "1", "factor by which the loop's slowest motion changes over the record"),
        ("critical_delay_s", "s", "delay at which the building as identified, on a perfect table, loses stability"),
        ("critical_delay_hz", "Hz", "where that delay makes it unstable"),
        ("gain_at_infinity", "1", "loop gain at infinite frequency: interface mass on the table over that computed"),
        (
            "tolerated_table_error",
            "1",
            "error of the table's response that makes the loop unstable, together with a change of its gain",
        ),
        ("required_table_error", "1", "relative error of the table's response that the loop must stand there"),
        ("table_error_hz", "Hz", "where the two are nearest to each other"),
        ("table_gain_change", "1", "that change, relative, up or down: three times uncertainty.table_gain of the rig"),
        (
            "feedback_tolerated_error",
            "1",
            "error above the identified band that makes the feedback unstable by itself",
        ),
        ("feedback_required_error", "1", "the error of the table's response that the feedback must tolerate there"),
        ("feedback_error_hz", "Hz", "where the two are nearest to each other"),
        ("tolerated_table_error_in_band", "1", "smallest such error up to the end of the compared band"),
        ("table_error_in_band_hz", "Hz", "where that is"),
        ("largest_scaling", "1", "scaling of the record up to which the test is safe, rounded down (0: at none)"),
        ("friction_v", "V", "dry friction of the table as identified, as a change of command (0: none seen)"),
    ):
        yield Quantity(f"check.{path}", units, "", NONE, text)
    for what, units, name in (("frequency_hz", "Hz", "frequencies"), ("damping_ratio", "1", "damping ratios")):
        yield Quantity(f"check.building_{what}", units, "mode", NONE, f"{name} of the undivided building")
        yield Quantity(f"check.loop_{what}", units, "mode", NONE, f"{name} of the sampled closed loop")
    yield from _margins("check", "of the hybrid loop broken at the command")
    for leaf, (units, name) in REACH.items():
        yield Quantity(f"check.peak_{leaf}", units, "", NONE, f"{name}: predicted peak")
        yield Quantity(f"check.limit_{leaf}", units, "", NONE, f"{name}: limit")
    for run, label in (("shake_table", "shake-table test"), ("exp_rths", "EXP-RTHS")):
        for leaf, (units, name) in GUARDED.items():
            yield Quantity(f"check.{run}_planned_{leaf}", units, "", NONE, f"{label}: largest {name} that it needs")
            yield Quantity(
                f"check.{run}_guard_{leaf}", units, "", NONE, f"{label}: {name} from which its guard stops it"
            )
    for name, units, text in (
        ("spectral_radius", "1", "largest |eigenvalue| of the loop of table and controller"),
        ("tolerated_table_error", "1", "error of the table's response that makes that loop unstable"),
        ("required_table_error", "1", "relative error of the table's response that it must stand there"),
        ("table_error_hz", "Hz", "where the two are nearest to each other"),
        ("delay_margin_s", "s", "smallest further delay that makes that loop unstable"),
        *((f"peak_{leaf}", units, f"{name}: predicted peak") for leaf, (units, name) in REACH.items()),
    ):
        yield Quantity(f"check.shake_table_{name}", units, "", NONE, f"shake-table test: {text}")
    late = "RMS of SIM - SIM-DELAY of the building as identified"
    yield Quantity("check.sim_delay_rms_error_m_s2", ACCEL, "storey", NONE, late, (), BAND, scales_as=ACCEL)
    for name, text in (
        ("true_error", "true RMS error that is as likely exceeded as not"),
        ("true_error_bound", "true RMS error that is not exceeded with 95 %"),
        ("calibration_error", "part of the true RMS error by sensors and masses, root mean square"),
    ):
        about = f"{text}, by the uncertainty of the calibration, against SIM with the specimen as it is"
        yield Quantity(f"check.{name}_m_s2", ACCEL, "storey", NONE, about, (), BAND, scales_as=ACCEL)
    about = "part of the true RMS error by pitch of the specimen's base, where the identification sees it"
    yield Quantity("check.pitch_error_m_s2", ACCEL, "storey", NONE, about, (), BAND, scales_as=ACCEL)
    about = (
        "RMS error of EXP-RTHS that the sensors will show: predicted by all causes together, and SIM of the building "
    )
    about += "as identified less SIM as declared"
    yield Quantity("check.expected_error_m_s2", ACCEL, "storey", NONE, about, (), BAND, scales_as=ACCEL)
    yield from _of_tangents()
    drift = "largest |inter-storey drift| of the test simulated on the identified rig (where storeys have laws)"
    yield Quantity("check.peak_inter_storey_drift_m", "m", "storey", NONE, drift, scales_as="m")
    yield from _of_laws("check", "the test simulated on the identified rig")
    yield from _by_cause("check", "predicted", {"": "all causes together", **CAUSES, **PREDICTED})


def _of_tangents() -> Iterator[Quantity]:
    where = "at rest and at each tangent of the laws or end of the specimen's range, an indication"
    for name, units, text in (
        ("spectral_radius", "1", "largest |eigenvalue| of the sampled closed loop"),
        ("tolerated_table_error", "1", "error of the table's response that makes the loop unstable"),
        ("required_table_error", "1", "error of the table's response that the loop must stand there"),
        ("table_error_hz", "Hz", "where the two are nearest to each other"),
        ("delay_margin_s", "s", "smallest further delay that makes the loop unstable"),
        ("critical_delay_s", "s", "critical delay of the building on a perfect table"),
        ("faults", "1", "number of reasons why the loop is not safe"),
    ):
        yield Quantity(f"check.tangent_{name}", units, "tangent", NONE, f"{text}, {where}")
    for name, word in (("least", "smallest"), ("most", "largest")):
        text = f"{word} critical delay of all these, on a perfect table"
        yield Quantity(f"check.critical_delay_{name}_s", "s", "", NONE, text)


def _by_cause(group: str, words: str, causes: dict[str, str]) -> Iterator[Quantity]:
    for cause, about in causes.items():
        part = f"_{cause}" if cause else ""
        storeys, tracking = f"{words} RMS error to SIM, {about}", f"{words} RMS tracking error, {about}"
        path = f"{group}.rms_error{part}_m_s2"
        yield Quantity(path, ACCEL, "storey", NONE, storeys, (), BAND, scales_as=ACCEL)
        path = f"{group}.tracking_rms{part}_m_s2"
        yield Quantity(path, ACCEL, "", NONE, tracking, (), BAND, scales_as=ACCEL)


def _of_budget() -> Iterator[Quantity]:
    yield from _by_cause("budget", "measured", {**CAUSES, **MEASURED})
    rest = "RMS error to SIM that the parts do not add up to"
    yield Quantity("budget.unexplained_rms_m_s2", ACCEL, "storey", NONE, rest, (), BAND, scales_as=ACCEL)
    yield Quantity("budget.table_gain_error", "1", "", NONE, "gain of the table in the run over identified, less 1")
    late = "delay of the table in the run less identified"
    yield Quantity("budget.table_delay_error_s", "s", "", NONE, late)
    friction = "friction of the table in the run, as a change of command"
    yield Quantity("budget.friction_v", "V", "", NONE, friction)
    unsure = "standard uncertainty of the"
    gain = f"{unsure} gain of the table in the run over identified, less 1"
    yield Quantity("budget.table_gain_error_uncertainty", "1", "", NONE, gain)
    yield Quantity("budget.table_delay_error_uncertainty_s", "s", "", NONE, f"{unsure} {late}")
    yield Quantity("budget.friction_uncertainty_v", "V", "", NONE, f"{unsure} {friction}")


def _margins(group: str, where: str) -> Iterator[Quantity]:
    for name, units, text in (
        ("sensitivity_peak", "1", "largest |S| = |1 / (1 + loop)|"),
        ("sensitivity_peak_hz", "Hz", "where |S| is largest"),
        ("gain_margin", "1", "smallest factor > 1 on the loop gain that makes it unstable"),
        ("gain_reduction_margin", "1", "the same, dividing the loop gain"),
        ("phase_margin_deg", "deg", "smallest change of phase that makes the loop unstable"),
        ("delay_margin_s", "s", "smallest further delay that makes the loop unstable"),
    ):
        yield Quantity(f"{group}.{name}", units, "", NONE, f"{text}, {where}", MODEL)


def _of_loop() -> Iterator[Quantity]:
    yield from _margins("feedback", "of the feedback on the table")
    worst = "largest |S| when every line of the FRF is off by two standard errors in the worst direction"
    yield Quantity("feedback.sensitivity_peak_uncertain", "1", "", NONE, worst)
    yield Quantity("feedback.bandwidth_hz", "Hz", "", NONE, "highest frequency with a loop gain of one")
    instead = "chosen where the loop lacks its margins with the usual feedback"
    yield Quantity("feedback.chosen_disturbance_low_hz", "Hz", "", NONE, f"lower end of disturbance_hz, {instead}")
    yield Quantity("feedback.chosen_disturbance_high_hz", "Hz", "", NONE, f"upper end of disturbance_hz, {instead}")
    yield Quantity("feedback.chosen_command_weight", "1", "", NONE, f"command_weight, {instead}")
    yield Quantity("feedback.chosen_max_sensitivity", "1", "", NONE, f"max_sensitivity, {instead}")
    instead = "chosen where noise and rounding of the samples would be most of the error"
    yield Quantity("controller.chosen_kalman_q", "1", "", NONE, f"q with the stated r, {instead}")
    yield Quantity("controller.chosen_kalman_residual_hz", "Hz", "", NONE, f"residual_hz, {instead}")
    countered = "1: the command counters {}; 0: it does not"
    reaction = countered.format("what a changed specimen does to the table")
    yield Quantity("controller.reaction_feedforward", "1", "", NONE, reaction)
    friction = countered.format("the table's dry friction")
    yield Quantity("controller.friction_compensation", "1", "", NONE, friction)
    step = "bit to which commands are rounded, the error carried over (0: not)"
    yield Quantity("controller.rounding_step_v", "V", "", NONE, step)
    yield Quantity("latency.frequency_hz", "Hz", "frequency", NONE, "frequencies of the latency budget")
    for name, about in LATENCIES.items():
        yield Quantity(f"latency.{name}_s", "s", "frequency", NONE, f"lag by {about}")
        yield Quantity(f"latency.{name}_left_s", "s", "frequency", NONE, f"what is left of the lag by {about}")
    for name in ("total", "compensated", "left"):
        yield Quantity(f"latency.{name}_s", "s", "frequency", NONE, f"{name} latency of the loop")
    yield Quantity("latency.predicted_s", "s", "", NONE, "lead of the hybrid clock over the table")
    yield Quantity("latency.declared_s", "s", "", NONE, "converter, hold and transport, as the rig declares them")
    seen = "delay from command to table as identified: converter, hold and transport"
    yield Quantity("latency.identified_s", "s", "", NONE, seen)
    yield Quantity("latency.identified_error_s", "s", "", NONE, f"standard uncertainty of the {seen}")
    integration = "amplitude error of the integration"
    yield Quantity("latency.integration_amplitude", "1", "frequency", NONE, integration)
    noise = "noise of the estimated over noise of the raw base shear"
    yield Quantity("latency.kalman_noise_gain", "1", "frequency", NONE, noise)


def _of_identification() -> Iterator[Quantity]:
    for name, text in (
        ("rms", f"RMS of |fit / FRF - 1| over {COMPARED}"),
        ("mid", "RMS of |fit / FRF - 1| over the middle of the compared band (2-10 Hz by default)"),
        ("max", f"largest |fit / FRF - 1| over {COMPARED}"),
    ):
        yield Quantity(f"identification.fit_error_{name}", "1", "", NONE, text)
    frequency = "identified natural frequencies of the specimen"
    yield Quantity("identification.natural_frequency_hz", "Hz", "mode", NONE, frequency)
    ratio = "identified damping ratios of the specimen"
    yield Quantity("identification.damping_ratio", "1", "mode", NONE, ratio)


METRICS: dict[str, Quantity] = {one.path: one for base in declared() for one in variants(base)}
"""Every metric by its path."""
