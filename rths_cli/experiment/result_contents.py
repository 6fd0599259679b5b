"""What stands in each group of a result file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control import latency_budget
from rths_cli.control.numerical_substructure import amplitude_and_lag
from rths_cli.experiment.run_metrics import of_margins
from rths_cli.files.result_reader import Dataset
from rths_cli.quantities import metrics_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.control.latency_budget import LatencyBudget
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.run_series import Series
    from rths_cli.experiment.setup import Setup
    from rths_cli.files.result_reader import ResultWriter
    from rths_cli.identification.results import Identification
    from rths_cli.loop.counted_clock import Whole
    from rths_cli.numerics.lti import Array

ACCEL = "m/s^2"
ON_FLOORS = ("floor", "time_s")
CHANNEL = "channel: 1 the table, then the experimental floors from the lowest"
DRIFT_TAKEN_OUT = "offset, drift and jumps taken out of the measured series after the run: the loop had their sum"
ON_FREQUENCY = ("frequency_hz",)
LIVE = {
    "late_s": ("s", "how late the exchange began that brought the samples of this step"),
    "exchange_s": ("s", "how long that exchange took, from command to samples"),
    "lost": (
        "1",
        "0 samples came, 1 none came in time, 2 the step was caught up without them, 3 after a gap: the loop was"
        " given, and the measured series hold, a mix of the samples that came and of what was expected",
    ),
    "state": ("1", "2 ramp-up, 3 running, 4 ramp-down, 5 stopped"),
}


def write_record(writer: ResultWriter, setup: Setup) -> None:
    """Write the scaled, filtered record."""
    accel = Dataset(setup.motion.accel_m_s2, ACCEL, "ground acceleration, scaled and filtered", "computed")
    writer.group("record", {"ground_accel_m_s2": accel}, time_s=setup.motion.time_s)


def write_response(writer: ResultWriter, run: str, setup: Setup, response: Response) -> None:
    """Write a computed response (SIM, SIM-DELAY)."""
    motion = (response.rel_disp_m, response.rel_vel_m_s, response.abs_accel_m_s2)
    datasets = _motion(motion, response.base_shear_n)
    writer.group(run, datasets, time_s=setup.motion.time_s, storey=np.arange(1, len(motion[0]) + 1))


def _motion(motion: tuple[Array, Array, Array], base_shear: Array) -> dict[str, Dataset]:
    disp, vel, accel = motion
    return {
        "rel_disp_m": Dataset(disp, "m", "displacement relative to the ground", "computed"),
        "rel_vel_m_s": Dataset(vel, "m/s", "velocity relative to the ground", "computed"),
        "abs_accel_m_s2": Dataset(accel, ACCEL, "absolute acceleration", "computed"),
        "base_shear_n": Dataset(base_shear, "N", "force f of the specimen on the interface floor, Eq. 2.6", "computed"),
    }


def write_table_run(
    writer: ResultWriter, run: str, setup: Setup, series: Series, hybrid: tuple[Array, Array, Array] | None
) -> None:
    """Write a run on the table: signals, with `hybrid` the whole building's motion, timing and, if known, truth."""
    time = setup.motion.time_s[: series.command_v.size]
    storeys = len(setup.building.M)
    floors = len(setup.floor_masses_kg)
    floor_scale = Dataset(np.arange(storeys - floors + 1, storeys + 1), "1", "experimental storey", "computed")
    sensed = "corrected for the sensor" if setup.removes_sensors else "as the sensor gives it"
    sensed += ", without offset, drift and jumps" if series.removed is not None else ""
    staircase = ", less the hold's staircase" if setup.case.method == "best" else ""
    datasets = _hybrid_motion(hybrid, series) if hybrid else {}
    datasets |= {
        "interface_accel_desired_m_s2": Dataset(series.desired[0], ACCEL, "desired table acceleration", "computed"),
        "interface_accel_measured_m_s2": Dataset(
            series.measured[0], ACCEL, f"table acceleration, {sensed}{staircase}", "measured"
        ),
        "command_v": Dataset(series.command_v, "V", "command that left the guard", "computed"),
        "floor_accel_measured_m_s2": Dataset(
            series.measured[1:], ACCEL, f"floor acceleration, {sensed}", "measured", ON_FLOORS
        ),
        "floor_accel_estimated_m_s2": Dataset(
            series.estimated[2 * floors : 3 * floors],
            ACCEL,
            "floor acceleration of the Kalman filter",
            "estimated",
            ON_FLOORS,
        ),
    }
    if series.removed is not None:
        kept = Dataset(series.removed, ACCEL, DRIFT_TAKEN_OUT, "estimated", ("channel", "time_s"))
        datasets["sensor_drift_m_s2"] = kept
    if len(series.estimated) > 3 * floors:
        about = "base shear that the identified specimen does not explain, carried to the end of the prediction"
        datasets["base_shear_unexplained_n"] = Dataset(series.estimated[3 * floors], "N", about, "estimated")
    scales = {"floor": floor_scale}
    if series.removed is not None:
        scales["channel"] = Dataset(np.arange(1, len(series.removed) + 1), "1", CHANNEL, "computed")
    storey = np.arange(1, storeys + 1)
    writer.group(run, datasets, time_s=time, storey=storey, scales=scales)
    timed = "step and guard" if not setup.rig.can.counts_steps else "step, guard and virtual rig, mean of 16 steps"
    compute = Dataset(series.compute_s, "s", f"time taken by {timed}", "measured")
    live = {name: Dataset(values, *LIVE[name], "measured") for name, values in series.live.items()}
    writer.group(f"{run}/timing", {"compute_s": compute, **live}, time_s=time, storey=storey)
    if setup.rig.can.records_truth:
        _write_truth(writer, run, series, time, storey, scales)


def write_rest(writer: ResultWriter, run: str, setup: Setup, whole: Whole) -> None:
    """Write what the channels showed while the table stood still before and after a run."""
    spans = ((whole.before_s, whole.before_v), (whole.after_s, whole.after_v))
    time = np.concatenate([begin + setup.rig.dt_s * np.arange(shown.shape[1]) for begin, shown in spans])
    about = "samples as the rig gave them, the table told to stand still before and after the run; NaN where none came"
    shown = Dataset(np.hstack([whole.before_v, whole.after_v]), "V", about, "measured", ("channel", "rest_time_s"))
    channel = Dataset(np.arange(1, len(whole.before_v) + 1), "1", CHANNEL, "computed")
    clock = Dataset(time, "s", "time since the start of the record, the rest before it and after it", "computed")
    writer.group(f"{run}/rest", {"samples_v": shown}, scales={"channel": channel, "rest_time_s": clock})


def _hybrid_motion(motion: tuple[Array, Array, Array], series: Series) -> dict[str, Dataset]:
    datasets = _motion(motion, series.base_shear_n)
    accel = "absolute acceleration: numerical storeys computed, interface and experimental floors measured"
    estimated = "relative to the ground: experimental floors estimated by the Kalman filter"
    datasets["abs_accel_m_s2"] = Dataset(motion[2], ACCEL, accel, "measured")
    shear = "force f of the specimen on the interface floor, Eq. 2.6, as the numerical part felt it"
    datasets["base_shear_n"] = Dataset(series.base_shear_n, "N", shear, "estimated")
    datasets["rel_disp_m"] = Dataset(motion[0], "m", f"displacement {estimated}", "estimated")
    datasets["rel_vel_m_s"] = Dataset(motion[1], "m/s", f"velocity {estimated}", "estimated")
    return datasets


def _write_truth(
    writer: ResultWriter, run: str, series: Series, time: Array, storey: ArrayLike, scales: dict[str, Dataset]
) -> None:
    about = "absolute, before any sensor, mean over the step around the sample (virtual rig only)"
    datasets = {
        "table_accel_m_s2": Dataset(series.true_accel[0], ACCEL, f"table acceleration, {about}", "true"),
        "table_disp_m": Dataset(series.true_disp_m, "m", "table displacement (virtual rig only)", "true"),
        "floor_accel_m_s2": Dataset(series.true_accel[1:], ACCEL, f"floor acceleration, {about}", "true", ON_FLOORS),
    }
    writer.group(f"{run}/truth", datasets, time_s=time, storey=storey, scales=scales)


def write_identification(writer: ResultWriter, identified: Identification, design: Design) -> None:
    """Write what was identified and the table model the controllers use."""
    error = identified.best_error if design.model is identified.best else identified.paper_error
    model, fit = design.model, identified.specimen
    assert fit is not None  # every case has experimental storeys
    table = identified.frfs[0]
    frequency = Dataset(table.frequency_hz, "Hz", "frequency", "computed")
    datasets = {
        "frf": Dataset(table.response, "m/s^2/V", "H1, command to table acceleration", "measured", ON_FREQUENCY),
        "coherence": Dataset(table.coherence, "1", "coherence of command and table", "measured", ON_FREQUENCY),
        "zeros": Dataset(model.zeros, "rad/s", "zeros of the table model", "estimated", ("zero",)),
        "poles": Dataset(model.poles, "rad/s", "poles of the table model", "estimated", ("pole",)),
        "gain": Dataset(model.gain, "as zeros and poles", "gain of the table model", "estimated"),
        "delay_s": Dataset(model.delay_s, "s", "explicit delay of the table model", "estimated"),
        "ripple_m_s2_per_v": Dataset(
            model.ripple_m_s2_per_v, "m/s^2/V", "share of a command change in a table sample (hold)", "estimated"
        ),
        "coupling_hz": Dataset(
            model.coupling_hz, "Hz", "corner of the AC coupling that table samples are corrected for", "computed"
        ),
        "fit_error_rms": Dataset(error.rms, "1", "RMS of |fit / FRF - 1| over 0.7-11 Hz", "estimated"),
        "fit_error_max": Dataset(error.largest, "1", "largest |fit / FRF - 1| over 0.7-11 Hz", "estimated"),
        "natural_frequency_hz": Dataset(fit.natural_frequency_hz, "Hz", "specimen, fixed base", "estimated", ("mode",)),
        "damping_ratio": Dataset(fit.damping_ratio, "1", "specimen, fixed base", "estimated", ("mode",)),
    }
    writer.group("identification", datasets, scales={"frequency_hz": frequency})


def write_controller(writer: ResultWriter, design: Design) -> None:
    """Write every discrete block of the step."""
    blocks = design.blocks
    known = (blocks.open_loop,) if blocks.open_loop else ()
    for block in (*blocks.named(), blocks.base_shear(), blocks.staircase(), *known):
        writer.block(block.name, block.A, block.B, block.C, block.D, block.dt_s, block.inputs, block.outputs)


def design_figures(setup: Setup, identified: Identification, design: Design) -> dict[str, ArrayLike]:
    """Return metrics of the identified model, the feedback and the loop's latency."""
    best = setup.case.method == "best"
    error, fit = (identified.best_error if best else identified.paper_error), identified.specimen
    assert fit is not None  # every case has experimental storeys
    values: dict[str, ArrayLike] = {
        "controller.rounding_step_v": design.blocks.shaping_step_v,
        "identification.fit_error_rms": error.rms,
        "identification.fit_error_mid": error.rms_mid,
        "identification.fit_error_max": error.largest,
        "identification.natural_frequency_hz": fit.natural_frequency_hz,
        "identification.damping_ratio": fit.damping_ratio,
    }
    if design.feedback is not None:
        values |= of_margins("feedback", design.feedback.measured, "")
        values |= of_margins("feedback", design.feedback.modelled, "_model")
        values["feedback.sensitivity_peak_uncertain"] = design.feedback.worst_peak
        values["feedback.bandwidth_hz"] = design.feedback.bandwidth_hz
    return values | _latency_figures(setup, identified, design)


def _latency_figures(setup: Setup, identified: Identification, design: Design) -> dict[str, ArrayLike]:
    """Return every latency of the loop, what takes it out and what is left, and the delay identified on the rig."""
    assert identified.specimen is not None  # every case has experimental storeys
    rig, blocks, specimen = setup.rig, design.blocks, identified.specimen.specimen
    loop = latency_budget.Loop(
        rig, blocks, design.model, setup.building.numerical, specimen, design.shear_now, setup.removes_sensors,
        setup.case.controller.kind != "none",
    )  # fmt: skip
    frequency = latency_budget.FREQUENCIES_HZ
    amplitude, _ = amplitude_and_lag(setup.building.numerical, blocks.numerical, frequency)
    _, noise = latency_budget.shear_response(blocks.estimator, design.shear_now, specimen, frequency)
    values: dict[str, ArrayLike] = {
        **_budget_figures(latency_budget.budget(loop)),
        "latency.predicted_s": blocks.lead_samples * rig.dt_s,
        "latency.declared_s": latency_budget.declared_s(rig),
        "latency.integration_amplitude": amplitude,
        "latency.kalman_noise_gain": noise,
    }
    if identified.latency is not None:
        values["latency.identified_s"] = identified.latency.identified_s
        values["latency.identified_error_s"] = identified.latency.error_s
    return values


def _budget_figures(budget: LatencyBudget) -> dict[str, ArrayLike]:
    """Return the items of a latency budget and their sums, each (n_frequencies,) in s."""
    values: dict[str, ArrayLike] = {"latency.frequency_hz": budget.frequency_hz}
    for item in budget.items:
        values[f"latency.{item.name}_s"] = item.delay_s
        values[f"latency.{item.name}_left_s"] = item.left_s
    sums = (("total", budget.total_s), ("compensated", budget.compensated_s), ("left", budget.left_s))
    return values | {f"latency.{name}_s": total for name, total in sums}


def remarks() -> dict[str, str]:
    """Return what the definitions of the latency's metrics say of this run: the frequencies they are given at."""
    listed = ", ".join(f"{f:g}" for f in latency_budget.FREQUENCIES_HZ)
    return {path: f"at {listed} Hz" for path, one in metrics_of("latency").items() if one.over}
