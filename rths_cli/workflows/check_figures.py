"""The figures of a check by their paths, `check.*`, with units and definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.analysis.prediction import ABOUT, CAUSES
from rths_cli.files.result_writer import Metric
from rths_cli.workflows.figures import BAND, of_margins, scalar

if TYPE_CHECKING:
    from rths_cli.analysis.prediction import Prediction
    from rths_cli.analysis.preflight import Preflight
    from rths_cli.workflows.check import Judged

ACCEL = "m/s^2"
REACH = {
    "displacement (with room to brake)": "displacement_m",
    "velocity": "velocity_m_s",
    "acceleration": "acceleration_m_s2",
    "accelerometers' range": "sensor_m_s2",
    "actuator force": "force_n",
    "command": "command_v",
}
BROKEN = "of the hybrid loop broken at the command"


def check_figures(judged: Judged) -> dict[str, Metric]:
    """Return the figures of a check; without those of the motion when the loop is unstable and has none."""
    found = judged.preflight
    values = _stability(found) | _modes(judged) | _table_error(found)
    values |= of_margins("check", found.stability.measured, "", f"{BROKEN}, FRF in its band, model outside")
    values |= of_margins("check", found.stability.modelled, "_model", f"{BROKEN}, model alone")
    about = "up to which the check finds the test safe, rounded down (0: at none)"
    values["check.largest_scaling"] = scalar(judged.largest_scaling, "1", f"scaling of the record {about}")
    friction = "dry friction of the table as identified, as a change of command (0: none seen)"
    values["check.friction_v"] = scalar(judged.friction_v, "V", friction)
    if judged.sim_delay_rms_m_s2 is not None:
        late = f"RMS of SIM - SIM-DELAY of the building as identified {BAND}"
        values["check.sim_delay_rms_error_m_s2"] = Metric(judged.sim_delay_rms_m_s2, ACCEL, late)
    if found.prediction is None:
        return values
    return values | _reach(found) | _errors(found.prediction)


def _stability(found: Preflight) -> dict[str, Metric]:
    critical, loop = found.critical, found.stability
    return {
        "check.spectral_radius": scalar(loop.radius, "1", "largest |eigenvalue| of the sampled closed loop (1: limit)"),
        "check.growth": scalar(loop.growth, "1", "factor by which the loop's slowest motion changes over the record"),
        "check.critical_delay_s": scalar(
            critical.delay_s, "s", "pure delay of the base shear at which the building as identified, on a perfect "
            "table, loses stability (0: any delay does)"
        ),
        "check.critical_delay_hz": scalar(critical.frequency_hz, "Hz", "where that delay makes it unstable"),
        "check.gain_at_infinity": scalar(
            critical.gain_at_infinity, "1", "loop gain at infinite frequency: the interface floor's mass on the table "
            "over that computed"
        ),
    }  # fmt: skip


def _modes(judged: Judged) -> dict[str, Metric]:
    """Return the building's modes, by themselves and in the loop."""
    (own_hz, own_ratio), (loop_hz, loop_ratio) = judged.building, judged.in_loop
    own, loop = "of the undivided building as identified", "of the sampled closed loop, nearest to the building's mode"
    return {
        "check.building_frequency_hz": Metric(own_hz, "Hz", f"natural frequencies {own}", "mode"),
        "check.building_damping_ratio": Metric(own_ratio, "1", f"damping ratios {own}", "mode"),
        "check.loop_frequency_hz": Metric(loop_hz, "Hz", f"frequencies {loop}", "mode"),
        "check.loop_damping_ratio": Metric(loop_ratio, "1", f"damping ratios {loop}", "mode"),
    }


def _table_error(found: Preflight) -> dict[str, Metric]:
    loop = found.stability
    error = "relative error of the table's response"
    return {
        "check.tolerated_table_error": scalar(loop.tolerates, "1", f"{error} that makes the loop unstable"),
        "check.required_table_error": scalar(loop.required, "1", f"{error} that the loop must stand there"),
        "check.table_error_hz": scalar(loop.at_hz, "Hz", "where the two are nearest to each other"),
        "check.tolerated_table_error_in_band": scalar(
            loop.in_band, "1", f"smallest {error} up to 11 Hz that makes the loop unstable"
        ),
        "check.table_error_in_band_hz": scalar(loop.in_band_hz, "Hz", "where that is"),
    }


def _reach(found: Preflight) -> dict[str, Metric]:
    """Return predicted peaks and limits."""
    values = {}
    for row in found.reach:
        leaf = REACH[row.name]
        values[f"check.peak_{leaf}"] = scalar(row.peak, row.units, f"{row.name}: predicted peak")
        values[f"check.limit_{leaf}"] = scalar(row.limit, row.units, f"{row.name}: limit")
    return values


def _errors(found: Prediction) -> dict[str, Metric]:
    """Return the predicted errors, all causes together and each by itself."""
    parts = [("", found.total, "all causes together")]
    parts += [(f"_{cause}", found.causes[cause], f"{cause}: {ABOUT[cause]}") for cause in CAUSES]
    storeys = {
        f"check.rms_error{part}_m_s2": Metric(errors.storeys, ACCEL, f"predicted RMS error to SIM {BAND}, {about}")
        for part, errors, about in parts
    }
    return storeys | {
        f"check.tracking_rms{part}_m_s2": scalar(
            errors.tracking, ACCEL, f"predicted RMS tracking error {BAND}, {about}"
        )
        for part, errors, about in parts
    }


def paths() -> dict[str, bool]:
    """Return the path of every figure of a check, and whether it has several values (storeys or modes)."""
    parts = ["", *(f"_{cause}" for cause in CAUSES)]
    several = [f"rms_error{part}_m_s2" for part in parts] + ["sim_delay_rms_error_m_s2"]
    several += [f"{of}_{what}" for of in ("building", "loop") for what in ("frequency_hz", "damping_ratio")]
    single = ["spectral_radius", "growth", "critical_delay_s", "critical_delay_hz", "gain_at_infinity"]
    single += ["tolerated_table_error", "required_table_error", "table_error_hz", "largest_scaling", "friction_v"]
    single += ["tolerated_table_error_in_band", "table_error_in_band_hz"]
    margins = ["gain_margin", "gain_reduction_margin", "phase_margin_deg", "delay_margin_s"]
    margins += ["sensitivity_peak", "sensitivity_peak_hz"]
    single += [f"{margin}{kind}" for margin in margins for kind in ("", "_model")]
    single += [f"{which}_{leaf}" for which in ("peak", "limit") for leaf in REACH.values()]
    single += [f"tracking_rms{part}_m_s2" for part in parts]
    return {f"check.{name}": False for name in single} | {f"check.{name}": True for name in several}
