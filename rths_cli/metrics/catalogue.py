"""What every figure of a result means: one table, from which the reference page and the JSON of a report are made."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

ACCEL = "m/s^2"
LESS, MORE, ZERO, ONE, NONE = "smaller", "larger", "near zero", "near one", "none"
TABLE_RUNS = ("shake_table", "exp_rths")
GROUPS = (
    "shake_table", "exp_rths", "sim", "sim_delay", "budget", "check", "feedback", "controller", "latency",
    "identification",
)  # fmt: skip
KINDS = {
    "_true_full": "true, in full band",
    "_true": "true: before any sensor, which only a virtual rig knows",
    "_full": "in full band: no low pass",
    "_model": "with the model alone, not the measured response",
}
ALL, BANDS, TRUTH, MODEL = ("_true", "_full", "_true_full"), ("_full",), ("_true",), ("_model",)
CAUSES = {
    "coupling": "the base shear's filter, its prediction and the integration",
    "latency": "what inverse and feedback leave of the table's lag",
    "model": "gain and delay of the table other than identified",
    "friction": "dry friction of the table beyond what the model holds",
    "rounding": "rounding of commands to the converter's bits",
}
PREDICTED = {"noise": "the sensors' noise", "quantisation": "rounding of samples to the converter's bits"}
MEASURED = {
    "lost": "steps without samples of their own, bridged (real rigs)",
    "drift": "what offset, drift and jumps of the sensors did to the loop, the samples themselves freed of them",
    "declared": "the declared building, which SIM has, instead of the identified specimen",
    "specimen": "floors moving otherwise than the identified specimen, and their noise",
    "rest": "the rest of the table's motion",
}
REACH = {
    "displacement_m": ("m", "table displacement, with room to brake"),
    "velocity_m_s": ("m/s", "table velocity"),
    "acceleration_m_s2": (ACCEL, "table acceleration"),
    "sensor_m_s2": (ACCEL, "acceleration at the accelerometers"),
    "force_n": ("N", "actuator force"),
    "command_v": ("V", "command"),
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
    "inverse": "feedforward and table together",
    "integration": "the integration of the numerical storeys",
    "sensor": "the accelerometers' low pass",
    "coupling": "the accelerometers' AC coupling",
    "kalman": "the base shear's estimate",
}


@dataclass(frozen=True)
class Definition:
    """Hold what a figure is: its path, unit, what it has several values over ("" for one number), which way is
    better, and its meaning. `kinds` are the suffixes under which it also stands."""

    path: str
    units: str
    over: str
    better: str
    text: str
    kinds: tuple[str, ...] = ()


def catalogue() -> tuple[Definition, ...]:
    """Return the definition of every figure, in the order of the groups of a result."""
    found = (
        *_of_table(),
        *_of_losses(),
        *_against_sim(),
        *_of_check(),
        *_of_budget(),
        *_of_loop(),
        *_of_identification(),
    )
    return tuple(sorted(found, key=lambda one: GROUPS.index(one.path.partition(".")[0])))


def define(path: str) -> Definition | None:
    """Return the definition of a figure by its path (`exp_rths.rms_error_m_s2_true`), None for one that has none."""
    if path in _TABLE:
        return _TABLE[path]
    for suffix, words in KINDS.items():
        base = _TABLE.get(path.removesuffix(suffix)) if path.endswith(suffix) else None
        if base is not None and suffix in base.kinds:
            return Definition(path, base.units, base.over, base.better, f"{base.text}; {words}")
    return None


def _of_table() -> Iterator[Definition]:
    error = "desired - measured table acceleration"
    for run in TABLE_RUNS:
        yield _lowest(run)
        for name, (units, text) in SENSORS.items():
            yield Definition(f"{run}.{name}", units, "channel", NONE, text)
        yield Definition(f"{run}.tracking_max_m_s2", ACCEL, "", LESS, f"largest |{error}|", ALL)
        yield Definition(f"{run}.tracking_rms_m_s2", ACCEL, "", LESS, f"RMS of {error}", ALL)
        late = "delay of the measured against the desired table acceleration by cross-correlation, positive = late"
        yield Definition(f"{run}.tracking_delay_s", "s", "", ZERO, late, TRUTH)
        index = "of the frequency evaluation index (FEI), measured over desired table acceleration"
        yield Definition(f"{run}.fei_amplitude", "1", "", ONE, f"amplitude {index}, 1 = exact", TRUTH)
        yield Definition(f"{run}.fei_delay_s", "s", "", ZERO, f"delay {index}, positive = late", TRUTH)
        area = "tracking indicator at the end of the record, positive = late"
        yield Definition(f"{run}.tracking_indicator_m2_s4", "m^2/s^4", "", ZERO, area)
        yield Definition(f"{run}.j1_s", "s", "", ZERO, "J1: lag of best correlation in whole samples, positive = late")
        deviation, largest = f"J2: standard deviation of {error} over desired", f"J3: peak of {error} over desired"
        yield Definition(f"{run}.j2", "1", "", LESS, deviation, BANDS)
        yield Definition(f"{run}.j3", "1", "", LESS, largest, BANDS)


def _lowest(run: str) -> Definition:
    text = "lowest reliable frequency: corner of the zero-phase high pass that all errors are evaluated with"
    return Definition(f"{run}.high_pass_hz", "Hz", "", NONE, text)


def _of_losses() -> Iterator[Definition]:
    about = "steps of the record, on a real rig,"
    for run in TABLE_RUNS:
        yield Definition(f"{run}.lost_steps", "1", "", NONE, f"{about} whose samples were lost")
        yield Definition(f"{run}.overrun_steps", "1", "", NONE, f"{about} late by an interval, or caught up")
        gap = "longest time without samples of the right instant, on a real rig"
        yield Definition(f"{run}.longest_gap_s", "s", "", NONE, gap)


def _against_sim() -> Iterator[Definition]:
    yield _lowest("sim_delay")
    for run, kinds in (("sim_delay", BANDS), ("exp_rths", ALL)):
        for which, words in (("rms", "RMS of {}"), ("max", "largest |{}|")):
            about = words.format("SIM - absolute acceleration of each storey")
            better = LESS if run == "exp_rths" else NONE
            yield Definition(f"{run}.{which}_error_m_s2", ACCEL, "storey", better, about, kinds)
    floors = {4: "the interface storey", 6: "the lowest other storey", 7: "the second lowest other storey"}
    for number, storey in floors.items():
        deviation = f"J{number}: standard deviation of SIM - EXP-RTHS over SIM, absolute acceleration of {storey}"
        peak = 5 if number == 4 else number + 2
        yield Definition(f"exp_rths.j{number}", "1", "", LESS, deviation, BANDS)
        largest = f"J{peak}: peak of SIM - EXP-RTHS over SIM, absolute acceleration of {storey}"
        yield Definition(f"exp_rths.j{peak}", "1", "", LESS, largest, BANDS)
    energy = "energy that the tracking error feeds into the structure, int f (v_desired - v_measured) dt"
    yield Definition("exp_rths.energy_error_j", "J", "", ZERO, energy, TRUTH)
    yield Definition("exp_rths.energy_error_ratio", "1", "", ZERO, f"{energy}, over SIM's largest input energy", TRUTH)
    for run in ("sim", "sim_delay"):
        own = "own estimate of the solution's error over its peak"
        yield Definition(f"{run}.solution_error", "1", "", NONE, own)
    critical = "pure delay of the base shear at which the hybrid test loses stability (0: any delay does)"
    yield Definition("sim_delay.critical_delay_s", "s", "", NONE, critical)
    yield Definition("sim_delay.diverged_at_s", "s", "", NONE, "when SIM-DELAY was cut, if it was")


def _of_check() -> Iterator[Definition]:
    for path, units, text in (
        ("spectral_radius", "1", "largest |eigenvalue| of the sampled closed loop (1: limit)"),
        ("growth", "1", "factor by which the loop's slowest motion changes over the record"),
        ("critical_delay_s", "s", "delay at which the building as identified, on a perfect table, loses stability"),
        ("critical_delay_hz", "Hz", "where that delay makes it unstable"),
        ("gain_at_infinity", "1", "loop gain at infinite frequency: interface mass on the table over that computed"),
        ("tolerated_table_error", "1", "relative error of the table's response that makes the loop unstable"),
        ("required_table_error", "1", "relative error of the table's response that the loop must stand there"),
        ("table_error_hz", "Hz", "where the two are nearest to each other"),
        ("tolerated_table_error_in_band", "1", "smallest relative error up to 11 Hz that makes the loop unstable"),
        ("table_error_in_band_hz", "Hz", "where that is"),
        ("largest_scaling", "1", "scaling of the record up to which the test is safe, rounded down (0: at none)"),
        ("friction_v", "V", "dry friction of the table as identified, as a change of command (0: none seen)"),
    ):
        yield Definition(f"check.{path}", units, "", NONE, text)
    for what, units, name in (("frequency_hz", "Hz", "frequencies"), ("damping_ratio", "1", "damping ratios")):
        yield Definition(f"check.building_{what}", units, "mode", NONE, f"{name} of the undivided building")
        yield Definition(f"check.loop_{what}", units, "mode", NONE, f"{name} of the sampled closed loop")
    yield from _margins("check", "of the hybrid loop broken at the command")
    for leaf, (units, name) in REACH.items():
        yield Definition(f"check.peak_{leaf}", units, "", NONE, f"{name}: predicted peak")
        yield Definition(f"check.limit_{leaf}", units, "", NONE, f"{name}: limit")
    late = "RMS of SIM - SIM-DELAY of the building as identified"
    yield Definition("check.sim_delay_rms_error_m_s2", ACCEL, "storey", NONE, late)
    yield from _by_cause("check", "predicted", {"": "all causes together", **CAUSES, **PREDICTED})


def _by_cause(group: str, words: str, causes: dict[str, str]) -> Iterator[Definition]:
    for cause, about in causes.items():
        part = f"_{cause}" if cause else ""
        storeys, tracking = f"{words} RMS error to SIM, {about}", f"{words} RMS tracking error, {about}"
        yield Definition(f"{group}.rms_error{part}_m_s2", ACCEL, "storey", NONE, storeys)
        yield Definition(f"{group}.tracking_rms{part}_m_s2", ACCEL, "", NONE, tracking)


def _of_budget() -> Iterator[Definition]:
    yield from _by_cause("budget", "measured", {**CAUSES, **MEASURED})
    rest = "RMS error to SIM that the parts do not add up to"
    yield Definition("budget.unexplained_rms_m_s2", ACCEL, "storey", NONE, rest)
    yield Definition("budget.table_gain_error", "1", "", NONE, "gain of the table in the run over identified, less 1")
    late = "delay of the table in the run less identified"
    yield Definition("budget.table_delay_error_s", "s", "", NONE, late)
    friction = "friction of the table in the run, as a change of command"
    yield Definition("budget.friction_v", "V", "", NONE, friction)
    unsure = "standard uncertainty of the"
    gain = f"{unsure} gain of the table in the run over identified, less 1"
    yield Definition("budget.table_gain_error_uncertainty", "1", "", NONE, gain)
    yield Definition("budget.table_delay_error_uncertainty_s", "s", "", NONE, f"{unsure} {late}")
    yield Definition("budget.friction_uncertainty_v", "V", "", NONE, f"{unsure} {friction}")


def _margins(group: str, where: str) -> Iterator[Definition]:
    for name, units, text in (
        ("sensitivity_peak", "1", "largest |S| = |1 / (1 + loop)|"),
        ("sensitivity_peak_hz", "Hz", "where |S| is largest"),
        ("gain_margin", "1", "smallest factor > 1 on the loop gain that makes it unstable"),
        ("gain_reduction_margin", "1", "the same, dividing the loop gain"),
        ("phase_margin_deg", "deg", "smallest change of phase that makes the loop unstable"),
        ("delay_margin_s", "s", "smallest further delay that makes the loop unstable"),
    ):
        yield Definition(f"{group}.{name}", units, "", NONE, f"{text}, {where}", MODEL)


def _of_loop() -> Iterator[Definition]:
    yield from _margins("feedback", "of the feedback on the table")
    worst = "largest |S| when every line of the FRF is off by two standard errors in the worst direction"
    yield Definition("feedback.sensitivity_peak_uncertain", "1", "", NONE, worst)
    yield Definition("feedback.bandwidth_hz", "Hz", "", NONE, "highest frequency with a loop gain of one")
    step = "bit to which commands are rounded, the error carried over (0: not)"
    yield Definition("controller.rounding_step_v", "V", "", NONE, step)
    yield Definition("latency.frequency_hz", "Hz", "frequency", NONE, "frequencies of the latency budget")
    for name, about in LATENCIES.items():
        yield Definition(f"latency.{name}_s", "s", "frequency", NONE, f"lag by {about}")
        yield Definition(f"latency.{name}_left_s", "s", "frequency", NONE, f"what is left of the lag by {about}")
    for name in ("total", "compensated", "left"):
        yield Definition(f"latency.{name}_s", "s", "frequency", NONE, f"{name} latency of the loop")
    yield Definition("latency.predicted_s", "s", "", NONE, "lead of the hybrid clock over the table")
    yield Definition("latency.declared_s", "s", "", NONE, "converter, hold and transport, as the rig declares them")
    seen = "delay from command to table as identified: converter, hold and transport"
    yield Definition("latency.identified_s", "s", "", NONE, seen)
    yield Definition("latency.identified_error_s", "s", "", NONE, f"standard uncertainty of the {seen}")
    integration = "amplitude error of the integration"
    yield Definition("latency.integration_amplitude", "1", "frequency", NONE, integration)
    noise = "noise of the estimated over noise of the raw base shear"
    yield Definition("latency.kalman_noise_gain", "1", "frequency", NONE, noise)


def _of_identification() -> Iterator[Definition]:
    for name, text in (
        ("rms", "RMS of |fit / FRF - 1| over 0.7-11 Hz"),
        ("mid", "RMS of |fit / FRF - 1| over 2-10 Hz"),
        ("max", "largest |fit / FRF - 1| over 0.7-11 Hz"),
    ):
        yield Definition(f"identification.fit_error_{name}", "1", "", NONE, text)
    frequency = "identified natural frequencies of the specimen"
    yield Definition("identification.natural_frequency_hz", "Hz", "mode", NONE, frequency)
    ratio = "identified damping ratios of the specimen"
    yield Definition("identification.damping_ratio", "1", "mode", NONE, ratio)


_TABLE = {definition.path: definition for definition in catalogue()}
