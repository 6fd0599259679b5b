"""Declarations of the datasets and attributes of a model file.

In a path `METHOD` stands for best or paper, `RECORD` for excitation, free_vibration or low_level,
`CHANNEL` for a channel's name. Numbers are stored as float64, true and false as 1 and 0; what was not found
is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from rths_cli.quantities.declaration import AttributeDeclaration, DatasetDeclaration, Kind

METHODS = ("best", "paper")
RECORDS = ("excitation", "free_vibration", "low_level")
GROUPS = {
    "frf/CHANNEL": "Frequency response from command to a channel.",
    "table/METHOD": "The table's model that a method uses.",
    "fit_error/METHOD": "Relative error |model / response - 1| of that model.",
    "specimen/RECORD": "The specimen as a chain of storeys, from each part of the records.",
    "nonlinear_specimen": "The specimen as a chain of storeys that are not linear, by the records at both levels.",
    "verdict": "Whether the model may drive the table.",
    "compared": "The band in which the models were compared with their data.",
    "friction": "Dry friction of the table, as the change of the command that it is worth.",
    "latency": "Delay from command to table: converter, hold and transport.",
    "calibration": "Sensors and weighed masses relative to what is declared, as the records show them.",
    "pitch": "Pitch of the specimen's base; only where no sensor or mass is declared exact and a record at low level "
    "shows that storeys do not bend or rub.",
    "level_causes": "What makes the responses at low and at full level differ.",
    "actuator": "Of an actuator: what its channels show at rest.",
    "low_level": "The record at low level, with which a later verification is compared.",
    "low_level_lines": "Lines of that record, by a Hann window over all of it, for the record of a session.",
    "channels": "A row per channel: what it showed under excitation.",
    "candidates": "A row per model order that was tried.",
    "roots": "A row per pair of roots of the model of method best, or per single real one.",
    "residuals": "A row per band: relative error |model / response - 1|.",
    "levels": "A row per band: the table's response at low level over that at full level.",
}
"""The groups and what they hold."""
TABLES = ("channels", "candidates", "roots", "residuals", "levels")
"""Groups whose datasets have a value per row."""

FRF, N_PER_M, N_S_PER_M = "m/s^2/V", "N/m", "N*s/m"
LINES, FLOORS, MODES, SQUARE = ("frequency_hz",), ("floor",), ("mode",), ("floor", "of_floor")
Entry = tuple[str, str, tuple[str, ...], str]


def declared_model_datasets() -> Iterator[DatasetDeclaration]:
    """Yield every dataset of a model file in the order of its groups, tables last."""
    for group, entries in _numbers().items():
        for name, units, axes, text in entries:
            yield DatasetDeclaration(f"{group}/{name}", units, axes, "estimated", text, _kind(group, name))
    for group, entries in _rows().items():
        for name, units, _, text in entries:
            yield DatasetDeclaration(f"{group}/{name}", units, ("row",), "estimated", text, _kind(group, name))


def model_dataset(group: str, name: str) -> DatasetDeclaration | None:
    """Return what a dataset of a group of a model file is, None where none is declared."""
    return MODEL_DATASETS.get((_pattern(group), name))


def _pattern(group: str) -> str:
    """Return the declared group that a group of a file belongs to; a channel may have any name."""
    return "frf/CHANNEL" if group.startswith("frf/") else GROUP_OF.get(group, group)


def _kind(group: str, name: str) -> Kind:
    if (group, name) in TEXTS:
        return "text"
    return "complex" if (group, name) in COMPLEX else "real"


COMPLEX = {
    ("frf/CHANNEL", "response"),
    ("table/METHOD", "zeros"),
    ("table/METHOD", "poles"),
    ("levels", "ratio"),
    ("low_level_lines", "command_v"),
    ("low_level_lines", "accel_m_s2"),
}
TEXTS = {
    ("verdict", "reasons"),
    ("verdict", "warnings"),
    ("verdict", "findings"),
    ("level_causes", "table"),
    ("channels", "name"),
    ("candidates", "name"),
    ("roots", "kind"),
}


def _numbers() -> dict[str, tuple[Entry, ...]]:
    """Return name, unit, axes and meaning of each dataset of the groups that are no tables."""
    unsure = "standard uncertainty of"
    return {
        "frf/CHANNEL": (
            ("response", FRF, LINES, "frequency response H of the channel to the command"),
            ("coherence", "1", LINES, "coherence of command and channel"),
            ("relative_error", "1", LINES, "standard error of |H| over |H|"),
            ("averages", "1", (), "number of averages"),
            ("bandwidth_lines", "1", (), "lines over which the noise of one is spread"),
            ("noise_floor", FRF, LINES, "|H| that noise at rest alone would show"),
        ),
        "table/METHOD": (
            ("zeros", "rad/s", ("zero",), "zeros"),
            ("poles", "rad/s", ("pole",), "poles"),
            ("gain", "as zeros and poles", (), "gain: G(s) = gain prod(s - zeros) / prod(s - poles) exp(-s delay_s)"),
            ("delay_s", "s", (), "explicit delay, half a sample of the hold included"),
            ("band_hz", "Hz", ("band_hz_entry",), "band that the model was fitted in"),
            ("ripple_m_s2_per_v", "m/s^2/V", (), "share of a command change in a table sample (hold)"),
            ("latency_samples", "1", (), "declared latency in samples"),
            ("dt_s", "s", (), "sample interval"),
            ("coupling_hz", "Hz", (), "corner of the AC coupling that table samples are corrected for; 0: none"),
        ),
        "fit_error/METHOD": (
            ("rms", "1", (), "RMS over the compared band"),
            ("largest", "1", (), "largest over the compared band"),
            ("rms_mid", "1", (), "RMS over the middle of the compared band (2-10 Hz of 0.7-11 Hz)"),
        ),
        "specimen/RECORD": (
            ("masses_kg", "kg", FLOORS, "floor masses"),
            ("K", N_PER_M, SQUARE, "stiffness matrix, relative to the table"),
            ("C", N_S_PER_M, SQUARE, "damping matrix, relative to the table"),
            ("stiffness_n_per_m", N_PER_M, FLOORS, "storey stiffnesses"),
            ("dashpots_n_s_per_m", N_S_PER_M, FLOORS, "storey dashpots that give the same modal damping ratios"),
            ("natural_frequency_hz", "Hz", MODES, "natural frequencies, fixed base"),
            ("damping_ratio", "1", MODES, "modal damping ratios, fixed base"),
            ("mode_shapes", "1", ("floor", "mode"), "mode shapes, the largest floor of each 1"),
            ("stiffness_error_n_per_m", N_PER_M, FLOORS, f"{unsure} the storey stiffnesses"),
            ("frequency_error_hz", "Hz", MODES, f"{unsure} the natural frequencies"),
            ("damping_error", "1", MODES, f"{unsure} the damping ratios"),
            ("frequency_scatter_hz", "Hz", MODES, "natural frequencies' standard deviation over parts of the record"),
            ("damping_scatter", "1", MODES, "damping ratios' standard deviation over parts of the record"),
            ("residual", "1", (), "RMS of what the fit does not explain over RMS of the floors' accelerations"),
        ),
        "nonlinear_specimen": (
            ("stiffness_n_per_m", N_PER_M, FLOORS, "storey stiffnesses at small drifts, without joints"),
            ("dashpots_n_s_per_m", N_S_PER_M, SQUARE, "forces of the storeys by the rates of their drifts, symmetric"),
            ("joint_n", "N", ("floor", "joint"), "forces at which joints of a storey slide"),
            ("joint_m", "m", ("floor", "joint"), "drifts over which they stick"),
            ("bend_n_per_m", N_PER_M, ("floor", "bend"), "changes of its stiffness beyond drifts of either side"),
            ("bend_m", "m", ("floor", "bend"), "these drifts"),
        ),
        "verdict": (
            ("accepted", "1", (), "1: the model may drive the table"),
            ("feedforward_hz", "Hz", ("feedforward_hz_entry",), "band that is fit for feedforward; (0, 0): none"),
            ("delay_s", "s", (), "transport delay in the model"),
            ("lag_s", "s", (), "phase lag of command to displacement at low frequency as a time, delay included"),
            ("reasons", "1", ("reasons_entry",), "why the model may not drive the table"),
            ("warnings", "1", ("warnings_entry",), "what else to know"),
            ("findings", "1", ("findings_entry",), "reasons, then warnings, as JSON: code, values, advice, text"),
            ("known_hz", "Hz", (), "above, the model says nothing; infinite: the data determine all its roots"),
        ),
        "compared": (
            ("low_hz", "Hz", (), "its lower end"),
            ("high_hz", "Hz", (), "its upper end"),
        ),
        "friction": (
            ("command_v", "V", (), "dry friction"),
            ("error_v", "V", (), f"{unsure} the dry friction"),
            ("velocity_rms_m_s", "m/s", (), "RMS velocity of the table in the record"),
            ("explained", "1", (), "share of the power that the model leaves of the record, beside linear parts"),
            ("scale_m_s", "m/s", (), "velocity below which the change of sign is smooth, to a factor of two"),
            ("held_out", "1", (), "share of the power left of the low-level record that it removes, nothing fitted"),
            ("sliding_v", "V", (), "dry friction in slip, without a law at reversals"),
            ("sliding_error_v", "V", (), f"{unsure} the friction in slip"),
        ),
        "latency": (
            ("identified_s", "s", (), "as identified"),
            ("error_s", "s", (), f"{unsure} the identified delay"),
            ("declared_s", "s", (), "as the rig declares it"),
        ),
        "calibration": (
            ("gain", "1", ("channel",), "reading of a channel over that by its declared sensitivity"),
            ("coupling", "1", ("channel",), "corner of a channel's AC coupling over the declared one"),
            ("late_s", "s", ("channel",), "lag of a channel beyond its declared dynamics"),
            ("mass", "1", FLOORS, "mass of a floor over the weighed one"),
            ("further_gain", "1", ("further_channel",), "the same as gain, of the channels beside the accelerometers"),
            ("gain_widening", "1", ("channel",), "factor by which gains that differ widen the declared uncertainty"),
            ("mass_widening", "1", FLOORS, "factor by which masses that differ widen the declared uncertainty"),
            (
                "covariance", "1", ("parameter", "of_parameter"),
                "of log gain, log coupling, late_s (in s) and log mass, one after the other",
            ),
        ),
        "pitch": (
            ("flexibility_m_per_n", "m/N", (), "motion of the top floor by pitch of the base per force on it"),
            ("error_m_per_n", "m/N", (), f"{unsure} it"),
            ("stiffness_ratio", "1", FLOORS, "storey stiffnesses on a rigid base over the identified ones"),
        ),
        "level_causes": (
            ("table", "1", ("table_entry",), "causes in the table, the likeliest first"),
            ("storeys", "1", ("storeys_entry",), "storeys of the specimen, from 1, whose stiffness depends on level"),
        ),
        "actuator": (
            ("displacement_noise_m", "m", (), "rms of the displacement sensor at rest"),
            ("force_noise_n", "N", (), "rms of the load cell at rest"),
        ),
        "low_level": (("accel_rms_m_s2", "m/s^2", (), "its nominal RMS acceleration below the excitation's corner"),),
        "low_level_lines": (
            ("command_v", "V", LINES, "of the command"),
            ("accel_m_s2", "m/s^2", ("channel", *LINES), "of table and floors"),
            ("noise", "m/s^2", ("channel",), "standard deviation in a line of the noise of a channel at rest"),
        ),
    }  # fmt: skip


def _rows() -> dict[str, tuple[Entry, ...]]:
    """Return the same of the tables; every dataset has a value per row."""
    row, unsure = ("row",), "standard uncertainty of"
    band = (
        ("low_hz", "Hz", row, "lower end of the band"),
        ("high_hz", "Hz", row, "upper end of the band"),
    )
    return {
        "channels": (
            ("name", "1", row, "name of the channel"),
            ("rms_m_s2", "m/s^2", row, "RMS under excitation"),
            ("largest_m_s2", "m/s^2", row, "largest under excitation"),
            ("rest_rms_m_s2", "m/s^2", row, "RMS at rest; NaN: no silence"),
            ("coherence", "1", row, "median coherence in the compared band"),
            ("hum_m_s2", "m/s^2", row, "amplitude of mains hum; 0: none"),
            ("hum_hz", "Hz", row, "frequency of mains hum"),
            ("zero_m_s2", "m/s^2", row, "zero in motion beside the mean at rest; NaN: no silence"),
        ),
        "candidates": (
            ("name", "1", row, "name of the structure"),
            ("poles", "1", row, "number of poles"),
            ("zeros", "1", row, "number of finite zeros"),
            ("held_out", "1", row, "RMS error over the response's standard error, on the half that was held out"),
            ("chosen", "1", row, "1: the one chosen"),
        ),
        "roots": (
            ("kind", "1", row, "pole or zero"),
            ("frequency_hz", "Hz", row, "frequency"),
            ("damping_ratio", "1", row, "damping ratio; NaN: a single real root"),
            ("frequency_error_hz", "Hz", row, f"{unsure} the frequency; NaN: not known"),
            ("damping_error", "1", row, f"{unsure} the damping ratio; NaN: not known"),
        ),
        "residuals": (
            *band,
            ("rms", "1", row, "RMS in the band"),
            ("largest", "1", row, "largest in the band"),
            ("scatter", "1", row, "the response's own standard error, RMS"),
            ("coherence", "1", row, "median coherence in the band"),
        ),
        "levels": (
            *band,
            ("ratio", "1", row, "mean ratio in the band"),
            ("error", "1", row, "standard error of the ratio"),
        ),
    }


MODEL_DATASETS = {(one.group, one.name): one for one in declared_model_datasets()}
"""Every dataset by its declared group and name."""
GROUP_OF = {
    group.replace(word, name): group
    for word, names in (("METHOD", METHODS), ("RECORD", RECORDS))
    for group, name in product(GROUPS, names)
    if word in group
}
"""The declared group of each group that stands for several."""

MODEL_ATTRIBUTES: dict[str, AttributeDeclaration] = {
    one.name: one
    for one in (
        AttributeDeclaration("format", "text", "`rths-model`"),
        AttributeDeclaration("format_version", "number", "1; files of a later version are refused"),
        AttributeDeclaration("created_utc", "text", "when it was identified"),
        AttributeDeclaration("rths_version", "text", "version of rths"),
        AttributeDeclaration("git_commit", "text", "commit of rths, empty where it is installed as a package"),
        AttributeDeclaration("rig", "text", "name of the rig"),
        AttributeDeclaration("rig_kind", "text", "its kind"),
        AttributeDeclaration("rig_sha256", "text", "SHA-256 of the rig file's values that a model depends on"),
        AttributeDeclaration(
            "laboratory",
            "number",
            "number of the virtual laboratory",
            present="only of a virtual rig with imperfections",
        ),
        AttributeDeclaration("structure", "text", "name of the structure whose specimen stood on the table"),
        AttributeDeclaration("specimen_sha256", "text", "SHA-256 of what a model depends on of the specimen"),
        AttributeDeclaration("floor_masses_kg", "text", "weighed floor masses"),
        AttributeDeclaration(
            "interface_experimental_mass_kg", "number", "part of the interface floor's mass on the table"
        ),
        AttributeDeclaration("sample_rate_hz", "number", "sample rate in Hz"),
        AttributeDeclaration("latency_samples", "number", "declared latency in samples"),
        AttributeDeclaration("latency", "text", "removed or kept, as in the case"),
        AttributeDeclaration("sensor_dynamics", "text", "removed or kept, as in the case"),
        AttributeDeclaration("settings", "text", "the identification's settings, as JSON"),
        AttributeDeclaration("seed", "number", "seed of excitation and noise"),
        AttributeDeclaration("data_source", "text", "where the records come from"),
        AttributeDeclaration("data_sha256", "text", "SHA-256 of the records"),
        AttributeDeclaration(
            "sha256", "text", "SHA-256 of datasets and attributes; a file that holds others is refused"
        ),
    )
}
"""Every attribute of a model file by its name."""
