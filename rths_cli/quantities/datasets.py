"""Declarations of the datasets of a result file outside /metrics: path, unit, axes, origin, meaning.

To add one, declare it here and have `experiment.result_contents` write its values under this path. In a path `RUN`
stands for a run on the table, `SOLUTION` for a computed one, `BLOCK` for a block of the step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from rths_cli.quantities.declaration import ACCEL, COMPARED, TABLE_RUNS, DatasetDeclaration, Source

SOLUTIONS = ("sim", "sim_delay")
"""Computed responses, which reach to the end of the record; a run on the table may be shorter."""
BLOCKS = {
    "sensor_correction": "samples (V) to accelerations, known corners of the sensors taken out",
    "kalman": "accelerations to the specimen's state and floor accelerations",
    "specimen_open_loop": "table acceleration to floor accelerations that the guard expects; no measured floor enters",
    "base_shear": "estimates and accelerations to the base shear at the instant at which the command acts",
    "numerical": "ground acceleration and base shear to the interface's motion",
    "feedforward": "desired motion to command",
    "feedback": "tracking error to command",
    "further_correction": "samples (V) of the channels beside the accelerometers to their values",
    "kalman_with_load_cell": "the filter as the step runs it where the base shear is taken from a load cell too",
    "staircase": "commands to the share of the hold's staircase in a table sample",
}
"""The discrete blocks of the step by their names, and what each does."""
BLOCKS_BESIDE = ("further_correction", "kalman_with_load_cell")
"""Those of a rig with further channels."""
KEPT_SERIES = ("all", "essential", "none")
"""The series that a result keeps (`--series`): every one, those that are declared essential, no one."""
PLACEHOLDERS = {"RUN": TABLE_RUNS, "SOLUTION": SOLUTIONS, "BLOCK": tuple(BLOCKS)}

GROUPS = {
    "case": "The case file, as text.",
    "record": "The ground motion that the runs have in common.",
    "session": "What changed in sensors and converters since the identification, by the record before the table runs.",
    "truth": "How a simulated laboratory differs from what its files declare.",
    "SOLUTION": "A computed response of the whole building: `sim` without, `sim_delay` with the delay of the case.",
    "exp_rths": "The hybrid building in EXP-RTHS, beside what every run on the table holds.",
    "RUN": "A run on the table: `shake_table` or `exp_rths`.",
    "RUN/rest": "The channels while the table stood still before and after the run.",
    "RUN/timing": "How long steps took and, on a real rig, what became of each exchange.",
    "RUN/truth": "What only a simulated rig knows.",
    "identification": "What was identified of table and specimen, and the table model that the controllers use.",
    "controller/BLOCK": "A discrete block of the step, x[k+1] = A x + B u, y = C x + D u.",
}
"""The groups outside /metrics and what they hold."""

CORRECTED, AS_SENSED = "corrected for the sensor", "as the sensor gives it"
DRIFT_REMOVED = "without offset, drift and jumps"
HOLD_REMOVED = "less the hold's staircase"
UNKNOWN_BELOW = "not known (NaN) below the interface, because the caller's own part computed these storeys"
WITH_RIG = "with the virtual rig, mean of 16 steps"
SENSED = (CORRECTED, AS_SENSED, DRIFT_REMOVED)

REAL, DRIFTED, BEST, LINKED = "real rig only", "only where there was any", "method best only", "UDP rig only"
SINCE_0_2 = "since version 0.2.0"
BESIDE = "only of a rig with further channels"
LOGGING = "only where parts log values of their own"
IMPERFECT = "only of a virtual rig with imperfections"
SESSION = "only where the record at low level was played again before the table runs"
TOLD = "only of a package's rig that tells its specimen"
OF_CHANNELS = (
    ("channels_gain_error", "1", "true over declared sensitivity, less 1"),
    ("channels_high_pass_error", "1", "true over declared corner of the AC coupling, less 1"),
    ("channels_low_pass_error", "1", "true over declared corner of the low pass, less 1"),
    ("channels_skew_s", "s", "sampling instant after the clock"),
    ("channels_offset_v", "V", "zero of the conditioning"),
    ("channels_transverse_sensitivity", "1", "sensitivity across over that along the axis"),
    ("channels_hum_v", "V", "amplitude of the mains' hum"),
    ("channels_offset_walk_v_per_sqrt_s", "V/s^0.5", "standard deviation of the zero's random walk after 1 s"),
)
OF_STOREYS = (
    ("masses_weighing_error", "1", "true over declared mass, less 1"),
    ("pitch_storey_height_m", "m", "height of the storey"),
    ("specimen_softening", "1", "share of the stiffness that is lost at large drifts"),
    ("specimen_joint_friction_n", "N", "friction of the joints"),
)
OF_LABORATORY = (
    ("converters_command_skew_s", "s", "instant of the command after the clock"),
    ("converters_command_jitter_s", "s", "standard deviation of that instant"),
    ("converters_sample_jitter_s", "s", "standard deviation of the sampling instant"),
    ("deck_frequency_hz", "Hz", "frequency of the deck without specimen, the coil held; 0: rigid"),
    ("amplifier_crossover_n", "N", "crossover distortion of the force"),
    ("amplifier_distortion", "1", "cubic distortion of the command"),
    ("amplifier_gain_drift_per_s", "1/s", "relative change of the command's gain"),
    ("friction_presliding_m", "m", "Coulomb friction over the bristles' stiffness; 0: none"),
    ("friction_stribeck_excess", "1", "static over Coulomb friction, less 1"),
    ("suspension_stiffness_n_per_m", "N/m", "stiffness of the suspension at the middle"),
    ("suspension_cubic_n_per_m3", "N/m^3", "its hardening"),
    ("force_factor_drop", "1", "share of the force that is lost off the middle"),
    ("pitch_frequency_hz", "Hz", "frequency of pitch, the specimen rigid; 0: none"),
    ("guides_lateral_share", "1", "acceleration across over that along the table"),
)
OF_EACH_RUN = (
    ("channels_gain_change_between_runs", "1", "further gain error in this run"),
    ("channels_hum_phase_rad", "rad", "phase of the mains' hum at the start of this run"),
)
"""What of a laboratory with imperfections is kept, by the keys of its rig file."""
LINK_COUNTS = {
    "sent": "packets sent to the target",
    "answered": "answers taken",
    "lost": "commands that no answer came to in time",
    "late": "answers that came after their time",
    "doubled": "answers that came twice, or after a newer one",
    "bad": "packets that were not genuine",
    "stray": "genuine packets that were never asked for",
    "unsent": "packets that could not be sent",
    "unreachable": "times the network called the target unreachable",
}
"""What a link counts, by the name of the count."""

TIME, ON_STOREYS, ON_FLOORS, ON_CHANNELS = (
    ("time_s",), ("storey", "time_s"), ("floor", "time_s"), ("channel", "time_s"),
)  # fmt: skip
SHEAR = "force f of the specimen on the interface floor, Eq. 2.6"
LAWS = "where storeys have laws, since 0.2"
ACTUATOR = "where a displacement is commanded"
RESTORING = "force of the storey's spring and laws, without dashpots"
DRIFT = "inter-storey drift: displacement less that of the floor, or ground, below"
STOREY_SHEAR = (
    "shear of the storey, -sum of mass times absolute acceleration from there up; storey 1: the building's base"
)

STEPS, LOGGED_OF_CHANNELS, OF_ESTIMATES = ("step",), ("channel", "step"), ("estimate", "step")
OF_FURTHER = ("further_channel", "step")
OF_LOGGED = ("value", "step")


def declared_datasets() -> Iterator[DatasetDeclaration]:
    """Yield every dataset of a result outside /metrics in the order of its groups."""
    yield DatasetDeclaration("case/yaml", "1", (), "computed", "case file as written", "text")
    yield DatasetDeclaration("case/resolved", "1", (), "computed", "case file with all defaults", "text")
    ground = "ground acceleration, scaled and filtered"
    yield DatasetDeclaration("record/ground_accel_m_s2", ACCEL, TIME, "computed", ground, essential=True)
    written = "ground acceleration as its file has it, times the scaling: neither changed nor filtered"
    changed = "only where the case changes the record"
    yield DatasetDeclaration("record/as_written_accel_m_s2", ACCEL, TIME, "computed", written, present=changed)
    yield from _of_laboratory()
    yield from _of_session()
    yield from _of_solution()
    yield from _of_hybrid_building()
    yield from _of_table_run()
    yield from _of_timing()
    yield from _of_truth()
    yield from _of_identification()
    yield from _of_block()


def dataset(path: str) -> DatasetDeclaration | None:
    """Return what the dataset of a path is (`exp_rths/command_v`), None where none is declared."""
    return DATASETS.get(path)


def of_a_run(path: str) -> bool:
    """Return whether a path belongs to the record, a computed response or a run on the table."""
    return path.partition("/")[0] in ("record", *SOLUTIONS, *TABLE_RUNS)


def keeps(series: str, one: DatasetDeclaration) -> bool:
    """Return whether a result with these series, one of KEPT_SERIES, holds a dataset."""
    return series == "all" or not of_a_run(one.path) or (series == "essential" and one.essential)


def stored_dataset(path: str) -> DatasetDeclaration | None:
    """Return what stands in a file under a path: `identification/frf_imag` is a part of `identification/frf`."""
    return STORED.get(path)


def _of_laboratory() -> Iterator[DatasetDeclaration]:
    number = "number of the laboratory, from which its values are drawn"
    yield DatasetDeclaration("truth/laboratory", "1", (), "true", number, present=IMPERFECT)
    for axes, entries in ((("channel",), OF_CHANNELS), (("floor",), OF_STOREYS), ((), OF_LABORATORY)):
        for name, units, text in entries:
            yield DatasetDeclaration(f"truth/{name}", units, axes, "true", text, present=IMPERFECT)
    masses, square = "masses of the floors on the table", ("floor", "of_floor")
    yield DatasetDeclaration("truth/specimen_masses_kg", "kg", ("floor",), "true", masses, present=TOLD)
    for name, units in (("stiffness_n_per_m", "N/m"), ("damping_n_s_per_m", "N*s/m")):
        text = f"{name.partition('_')[0]} of the specimen at rest, what laws add included"
        yield DatasetDeclaration(f"truth/specimen_{name}", units, square, "true", text, present=TOLD)


def _of_solution() -> Iterator[DatasetDeclaration]:
    for name, units, text in (
        ("rel_disp_m", "m", "displacement relative to the ground"),
        ("rel_vel_m_s", "m/s", "velocity relative to the ground"),
        ("abs_accel_m_s2", ACCEL, "absolute acceleration"),
    ):
        essential = name == "abs_accel_m_s2"
        yield DatasetDeclaration(f"SOLUTION/{name}", units, ON_STOREYS, "computed", text, essential=essential)
    yield DatasetDeclaration("SOLUTION/base_shear_n", "N", TIME, "computed", SHEAR)
    for name, units, text in (("inter_storey_drift_m", "m", DRIFT), ("storey_shear_n", "N", STOREY_SHEAR)):
        yield DatasetDeclaration(
            f"SOLUTION/{name}", units, ON_STOREYS, "computed", text, present=SINCE_0_2, follows=True
        )  # fmt: skip
    yield DatasetDeclaration("SOLUTION/restoring_force_n", "N", ON_STOREYS, "computed", RESTORING, present=LAWS)


def _of_hybrid_building() -> Iterator[DatasetDeclaration]:
    motion: tuple[tuple[str, str, Source, str], ...] = (
        (
            "rel_disp_m", "m", "estimated",
            "displacement relative to the ground: experimental floors estimated by the Kalman filter",
        ),
        (
            "rel_vel_m_s", "m/s", "estimated",
            "velocity relative to the ground: experimental floors estimated by the Kalman filter",
        ),
        (
            "abs_accel_m_s2", ACCEL, "measured",
            "absolute acceleration: numerical storeys computed, interface and experimental floors measured",
        ),
    )  # fmt: skip
    for name, units, source, text in motion:
        essential = name != "rel_vel_m_s"
        yield DatasetDeclaration(
            f"exp_rths/{name}", units, ON_STOREYS, source, text, remarks=(UNKNOWN_BELOW,), essential=essential
        )  # fmt: skip
    felt = f"{SHEAR}, as the numerical part felt it"
    yield DatasetDeclaration("exp_rths/base_shear_n", "N", TIME, "estimated", felt)
    for name, units, text in (("inter_storey_drift_m", "m", DRIFT), ("storey_shear_n", "N", STOREY_SHEAR)):
        yield DatasetDeclaration(
            f"exp_rths/{name}", units, ON_STOREYS, "estimated", text, present=SINCE_0_2, remarks=(UNKNOWN_BELOW,),
            follows=True,
        )  # fmt: skip
    known = f"{RESTORING}; NaN for the storeys on the table"
    yield DatasetDeclaration("exp_rths/restoring_force_n", "N", ON_STOREYS, "computed", known, present=LAWS)


def _of_table_run() -> Iterator[DatasetDeclaration]:
    desired, measured = "RUN/interface_accel_desired_m_s2", "RUN/interface_accel_measured_m_s2"
    yield DatasetDeclaration(desired, ACCEL, TIME, "computed", "desired table acceleration", essential=True)
    yield DatasetDeclaration(
        measured, ACCEL, TIME, "measured", "table acceleration", remarks=(*SENSED, HOLD_REMOVED), essential=True
    )  # fmt: skip
    yield DatasetDeclaration("RUN/command_v", "V", TIME, "computed", "command that left the guard", essential=True)
    for name, units, source, text in (
        ("interface_disp_desired_m", "m", "computed", "desired displacement of the interface relative to the ground"),
        ("interface_disp_measured_m", "m", "measured", "displacement of the actuator"),
        ("measured_force_n", "N", "measured", "force of the load cell, the specimen's inertia included"),
    ):
        yield DatasetDeclaration(f"RUN/{name}", units, TIME, source, text, present=ACTUATOR, essential=True)  # type: ignore[arg-type]
    floors = "RUN/floor_accel_measured_m_s2"
    yield DatasetDeclaration(floors, ACCEL, ON_FLOORS, "measured", "floor acceleration", remarks=SENSED)
    filtered = "floor acceleration of the Kalman filter"
    yield DatasetDeclaration("RUN/floor_accel_estimated_m_s2", ACCEL, ON_FLOORS, "estimated", filtered, follows=True)
    beside = "values of the channels beside the accelerometers, corrected for their sensors"
    yield DatasetDeclaration(
        "RUN/further_channels", "as their names", ("further_channel", "time_s"), "measured", beside, present=BESIDE
    )  # fmt: skip
    named = "names and units of the rows of further_channels, one per line"
    yield DatasetDeclaration("RUN/further_channel_names", "1", (), "computed", named, "text", present=BESIDE)
    values = "what the parts of the step log, such as parameters of an adaptive compensator"
    yield DatasetDeclaration(
        "RUN/part_values", "as their names", ("value", "time_s"), "computed", values, present=LOGGING
    )  # fmt: skip
    names = "names and units of the rows of part_values, one per line"
    yield DatasetDeclaration("RUN/part_value_names", "1", (), "computed", names, "text", present=LOGGING)
    rest = "base shear that the identified specimen does not explain, carried to the end of the prediction"
    yield DatasetDeclaration("RUN/base_shear_unexplained_n", "N", TIME, "estimated", rest, present=BEST, follows=True)
    drift = "offset, drift and jumps taken out of the measured series after the run: the loop had their sum"
    yield DatasetDeclaration("RUN/sensor_drift_m_s2", ACCEL, ON_CHANNELS, "estimated", drift, present=DRIFTED)
    still = "samples as the rig gave them, the table told to stand still before and after the run; NaN where none came"
    yield DatasetDeclaration("RUN/rest/samples_v", "V", ("channel", "rest_time_s"), "measured", still)


def _of_timing() -> Iterator[DatasetDeclaration]:
    taken = "time taken by one step, guard included"
    yield DatasetDeclaration("RUN/timing/compute_s", "s", TIME, "measured", taken, remarks=(WITH_RIG,))
    for name, units, text in (
        ("late_s", "s", "how late the exchange began that brought the samples of this step"),
        ("exchange_s", "s", "how long that exchange took, from command to samples"),
        (
            "lost", "1", "0 samples came, 1 none came in time, 2 the step was caught up without them, 3 after a gap: "
            "the loop was given, and the measured series hold, a mix of the samples that came and of what was expected",
        ),
        ("state", "1", "2 ramp-up, 3 running, 4 ramp-down, 5 stopped"),
    ):  # fmt: skip
        yield DatasetDeclaration(f"RUN/timing/{name}", units, TIME, "measured", text, present=REAL)
    for name, text in LINK_COUNTS.items():
        counted = f"{text}, in the session, from arming to rest"
        yield DatasetDeclaration(f"RUN/timing/link_{name}", "1", (), "measured", counted, present=LINKED)


def _of_truth() -> Iterator[DatasetDeclaration]:
    mean = "absolute, before any sensor, mean over the step around the sample (simulated rig only)"
    yield DatasetDeclaration("RUN/truth/table_accel_m_s2", ACCEL, TIME, "true", f"table acceleration, {mean}")
    yield DatasetDeclaration("RUN/truth/table_disp_m", "m", TIME, "true", "table displacement (simulated rig only)")
    yield DatasetDeclaration("RUN/truth/floor_accel_m_s2", ACCEL, ON_FLOORS, "true", f"floor acceleration, {mean}")
    for name, units, text in OF_EACH_RUN:
        yield DatasetDeclaration(f"RUN/truth/{name}", units, ("channel",), "true", text, present=IMPERFECT)


def _of_identification() -> Iterator[DatasetDeclaration]:
    lines = ("frequency_hz",)
    response = "H1, command to table acceleration"
    yield DatasetDeclaration("identification/frf", "m/s^2/V", lines, "measured", response, "complex")
    yield DatasetDeclaration("identification/coherence", "1", lines, "measured", "coherence of command and table")
    for name, axis in (("zeros", "zero"), ("poles", "pole")):
        about = f"{name} of the table model"
        yield DatasetDeclaration(f"identification/{name}", "rad/s", (axis,), "estimated", about, "complex")
    numbers: tuple[tuple[str, str, Source, str], ...] = (
        ("gain", "as zeros and poles", "estimated", "gain of the table model"),
        ("delay_s", "s", "estimated", "explicit delay of the table model"),
        ("ripple_m_s2_per_v", "m/s^2/V", "estimated", "share of a command change in a table sample (hold)"),
        ("coupling_hz", "Hz", "computed", "corner of the AC coupling that table samples are corrected for"),
        ("fit_error_rms", "1", "estimated", f"RMS of |fit / FRF - 1| over {COMPARED}"),
        ("fit_error_max", "1", "estimated", f"largest |fit / FRF - 1| over {COMPARED}"),
    )
    for name, units, source, text in numbers:
        yield DatasetDeclaration(f"identification/{name}", units, (), source, text)
    for name, units, text in (
        ("natural_frequency_hz", "Hz", "natural frequencies of the specimen, fixed base"),
        ("damping_ratio", "1", "damping ratios of the specimen, fixed base"),
    ):
        yield DatasetDeclaration(f"identification/{name}", units, ("mode",), "estimated", text)


def _of_session() -> Iterator[DatasetDeclaration]:
    channel, since = ("channel",), "from the identification to this session"
    numbers: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
        ("gain_change", "1", channel, f"relative change of a sensor's gain {since}"),
        ("gain_change_error", "1", channel, "its standard uncertainty, the part that all sensors share included"),
        ("gain_over_table_change", "1", channel, f"change of the ratio of a sensor's gain to the table's {since}"),
        ("gain_over_table_change_error", "1", channel, "its standard uncertainty"),
        ("late_change_s", "s", channel, f"change of a channel's lag after the table's {since}"),
        ("late_change_error_s", "s", channel, "its standard uncertainty; 0: no change is shown, none was taken"),
        ("ripple_change_m_s2_per_v", "m/s^2/V", (), f"change of the held command's alias in a table sample {since}"),
        ("ripple_change_error_m_s2_per_v", "m/s^2/V", (), "its standard uncertainty; 0: none is shown, none was taken"),
        (
            "delay_change_s",
            "s",
            (),
            f"change of the delay from the command to the table {since}, where another instant changed",
        ),
        ("delay_change_error_s", "s", (), "its standard uncertainty; 0: none is shown"),
        ("unexplained", "1", (), "rms of what these changes do not explain, in units of the channels' noise at rest"),
    )
    for name, units, axes, text in numbers:
        yield DatasetDeclaration(f"session/{name}", units, axes, "estimated", text, present=SESSION)


def _of_block() -> Iterator[DatasetDeclaration]:
    for name, axes in (
        ("A", ("next_state", "state")),
        ("B", ("next_state", "input")),
        ("C", ("output", "state")),
        ("D", ("output", "input")),
    ):
        text, units = f"{name} of the block", "as inputs and outputs"
        yield DatasetDeclaration(f"controller/BLOCK/{name}", units, axes, "computed", text)


def _expanded(one: DatasetDeclaration) -> Iterator[DatasetDeclaration]:
    """Yield a declaration under each path that it stands for."""
    parts = [PLACEHOLDERS.get(part, (part,)) for part in one.path.split("/")]
    for names in product(*parts):
        present = BESIDE if names[1:2] and names[1] in BLOCKS_BESIDE else one.present
        yield replace(one, path="/".join(names), present=present)


DATASETS: dict[str, DatasetDeclaration] = {one.path: one for each in declared_datasets() for one in _expanded(each)}
"""Every dataset by its path."""
STORED: dict[str, DatasetDeclaration] = {path: one for one in DATASETS.values() for path in one.stored_paths}
"""Every dataset by the paths it stands under in a file."""


RAW_LOG_COLUMNS: dict[str, DatasetDeclaration] = {
    one.path: one
    for one in (
        DatasetDeclaration(
            "corrected", ACCEL, LOGGED_OF_CHANNELS, "measured", "accelerations as the step used them: samples "
            "corrected for their sensors, or what stood in for samples that did not come",
        ),
        DatasetDeclaration(
            "further", "m/s^2, m, N or 1", OF_FURTHER, "measured", "values of the channels beside the "
            "accelerometers, in the order of the rig file",
        ),
        DatasetDeclaration("desired_accel_m_s2", ACCEL, STEPS, "computed", "desired acceleration of the table"),
        DatasetDeclaration("desired_velocity_m_s", "m/s", STEPS, "computed", "desired velocity of the table"),
        DatasetDeclaration("desired_displacement_m", "m", STEPS, "computed", "desired displacement of the table"),
        DatasetDeclaration("command_v", "V", STEPS, "computed", DATASETS["exp_rths/command_v"].text),
        DatasetDeclaration("base_shear_n", "N", STEPS, "estimated", DATASETS["exp_rths/base_shear_n"].text),
        DatasetDeclaration(
            "estimated", "m, m/s, m/s^2 or N", OF_ESTIMATES, "estimated", "outputs of the Kalman filter, in the order "
            "of its block in the result file",
        ),
        DatasetDeclaration(
            "logged", "as its name", OF_LOGGED, "computed", "what the parts of the step log, in the order of "
            "`exp_rths/part_values` of the result file; most parts log nothing",
        ),
        DatasetDeclaration("samples_v", "V", LOGGED_OF_CHANNELS, "measured", "samples as the rig gave them"),
        DatasetDeclaration("further_v", "V", OF_FURTHER, "measured", "the same of the further channels"),
        *(
            DatasetDeclaration(f"{name}_ns", "ns", STEPS, "measured", DATASETS[f"exp_rths/timing/{name}_s"].text)
            for name in ("late", "exchange")
        ),
        *(
            DatasetDeclaration(name, "1", STEPS, "measured", DATASETS[f"exp_rths/timing/{name}"].text)
            for name in ("lost", "state")
        ),
        DatasetDeclaration("compute_ns", "ns", STEPS, "measured", DATASETS["exp_rths/timing/compute_s"].text),
    )
}  # fmt: skip
"""Every column by its name, in the order of a log; one of several channels or estimates ends in its number, from 0.

Desired motion and base shear of step k are those of k + n_p, everything else of k.
"""
