"""Write each group of a result file: record, simulations, table runs, identification, controller; design metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.structural_response import inter_storey_drift_m, restoring_force_n, storey_shear_n
from rths_cli.control import latency_budget
from rths_cli.control.numerical_substructure import amplitude_and_lag
from rths_cli.experiment.run_metrics import of_margins
from rths_cli.experiment.session import as_stored
from rths_cli.findings import Finding, as_json, from_json, sentences
from rths_cli.quantities import metrics_of
from rths_cli.quantities.datasets import (
    AS_SENSED,
    CORRECTED,
    DRIFT_REMOVED,
    HOLD_REMOVED,
    UNKNOWN_BELOW,
    WITH_RIG,
    dataset,
)
from rths_cli.rigs.from_case import laboratory_number, true_values
from rths_cli.structure import storey_values

MOST_BYTES = 60_000  # of the findings as JSON: an attribute of HDF5 holds 64 KB

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.control.latency_budget import LatencyBudget
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.run_signals import Series
    from rths_cli.experiment.setup import Setup
    from rths_cli.files.result_reader import ResultWriter
    from rths_cli.identification.results import Identification
    from rths_cli.loop.simulated_time_run import Whole
    from rths_cli.numerics.lti import Array
    from rths_cli.structure import Building


def write_record(writer: ResultWriter, setup: Setup) -> None:
    """Write the scaled, filtered record."""
    changed = {} if setup.as_written_m_s2 is None else {"as_written_accel_m_s2": setup.as_written_m_s2}
    writer.group("record", {"ground_accel_m_s2": setup.motion.accel_m_s2, **changed}, time_s=setup.motion.time_s)


def write_laboratory(writer: ResultWriter, setup: Setup) -> None:
    """Write how a virtual laboratory differs from what its files declare; nothing where it does not."""
    values = true_values(setup.case, setup.rig)
    if values:
        numerical, floors = len(setup.building.numerical.masses_kg), len(setup.floor_masses_kg)
        scales: dict[str, ArrayLike] = {
            "channel": np.arange(1, 1 + len(setup.rig.all_channels)),
            "floor": np.arange(numerical + 1, numerical + 1 + floors),
        }
        number = laboratory_number(setup.case)
        writer.group("truth", {"laboratory": np.float64(number or 0), **true_arrays(values)}, scales=scales)


def write_session(writer: ResultWriter, setup: Setup, identified: Identification) -> None:
    """Write what the record of the session shows; nothing without one."""
    if identified.session is not None:
        scales: dict[str, ArrayLike] = {"channel": np.arange(1, 1 + len(setup.rig.channels))}
        writer.group("session", as_stored(identified.session), scales=scales)


def write_told_specimen(writer: ResultWriter, setup: Setup, told: Building) -> None:
    """Write the specimen that the rig of a package says it has."""
    numerical, floors = len(setup.building.numerical.masses_kg), len(setup.floor_masses_kg)
    one = told.specimen
    values = {
        "specimen_masses_kg": one.masses_kg,
        "specimen_stiffness_n_per_m": one.K,
        "specimen_damping_n_s_per_m": one.C,
    }
    writer.group("truth", values, scales={"floor": np.arange(numerical + 1, numerical + 1 + floors)})


def true_arrays(values: Mapping[str, Array]) -> dict[str, ArrayLike]:
    """Return hidden values by the names of their datasets, single ones without an axis."""
    named = {key.replace(".", "_"): found for key, found in values.items()}
    alone = {name for name in named if (one := dataset(f"truth/{name}")) is not None and not one.axes}
    return {name: found[0] if name in alone else found for name, found in named.items()}


def write_response(writer: ResultWriter, run: str, setup: Setup, response: Response) -> None:
    """Write a computed response (SIM, SIM-DELAY)."""
    motion = (response.rel_disp_m, response.rel_vel_m_s, response.abs_accel_m_s2)
    values = _motion(setup, motion, response.base_shear_n)
    if response.laws is not None:
        values |= _restoring(setup, response.rel_disp_m, response.laws.force_n)
    writer.group(run, values, time_s=setup.motion.time_s, storey=np.arange(1, len(motion[0]) + 1))


def _motion(setup: Setup, motion: tuple[Array, Array, Array], base_shear_n: Array) -> dict[str, ArrayLike]:
    disp, vel, accel = motion
    return {
        "rel_disp_m": disp,
        "rel_vel_m_s": vel,
        "abs_accel_m_s2": accel,
        "base_shear_n": base_shear_n,
        "inter_storey_drift_m": inter_storey_drift_m(disp),
        "storey_shear_n": storey_shear_n(setup.building.shear_masses_kg, accel),
    }


def _restoring(setup: Setup, rel_disp_m: Array, law_force_n: Array) -> dict[str, ArrayLike]:
    """Return the force of springs and laws (n_storeys, n), NaN where the forces of laws (s, n) are not known."""
    building, drift = setup.building, inter_storey_drift_m(rel_disp_m)
    springs = np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)])
    found = np.full(drift.shape, np.nan)
    found[: len(law_force_n)] = restoring_force_n(springs, drift, law_force_n)
    return {"restoring_force_n": found}


def write_table_run(
    writer: ResultWriter,
    run: str,
    setup: Setup,
    series: Series,
    hybrid: tuple[Array, Array, Array] | None,
    hidden: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> None:
    """Write a run on the table: signals, with `hybrid` the whole building's motion, what the parts of the step log,
    timing and, if known, truth, with what is `hidden` from the sensors in this run."""
    time = setup.motion.time_s[: series.command_v.size]
    storeys, floors = len(setup.building.M), len(setup.floor_masses_kg)
    storey = np.arange(1, storeys + 1)
    scales: dict[str, ArrayLike] = {"floor": storey[storeys - floors :]}
    values = _motion(setup, hybrid, series.base_shear_n) if hybrid else {}
    if hybrid and series.law_force_n is not None:
        forces = np.zeros((len(setup.building.numerical.masses_kg), series.command_v.size))
        forces[: len(series.law_force_n)] = series.law_force_n
        values |= _restoring(setup, hybrid[0], forces)
    if setup.building.specimen.attached:
        scales = {}
        values |= {
            "interface_disp_desired_m": series.desired[2],
            "interface_disp_measured_m": series.measured[0],
            "measured_force_n": series.measured[1],
            "command_v": series.command_v,
        }
    else:
        values |= {
            "interface_accel_desired_m_s2": series.desired[0],
            "interface_accel_measured_m_s2": series.measured[0],
            "command_v": series.command_v,
            "floor_accel_measured_m_s2": series.measured[1:],
            "floor_accel_estimated_m_s2": series.estimated[2 * floors : 3 * floors],
        }
    if series.removed is not None:
        values["sensor_drift_m_s2"] = series.removed
        scales["channel"] = np.arange(1, len(series.removed) + 1)
    if len(series.estimated) > 3 * floors:
        values["base_shear_unexplained_n"] = series.estimated[3 * floors]
    if len(series.further):
        names = [f"{channel.name} ({channel.unit})" for channel in setup.rig.further]
        values |= {"further_channels": series.further, "further_channel_names": "\n".join(names)}
    if series.logs:
        values["part_values"] = series.logged
        values["part_value_names"] = "\n".join(f"{one.name} ({one.units})" for one in series.logs)
    writer.group(run, values, time, storey, scales, _remarks_on_samples(setup, series) | _remarks_on_storeys(setup))
    timed = {"compute_s": (WITH_RIG,) if setup.rig.can.counts_steps else ()}
    if run not in setup.recorded:  # whose durations nobody measured
        writer.group(f"{run}/timing", {"compute_s": series.compute_s, **series.live}, time, storey, remarks=timed)
    if setup.building.specimen.attached and series.true_disp_m.size:
        writer.group(f"{run}/truth", {"table_disp_m": series.true_disp_m}, time, storey)
    if series.has_truth:
        truth = {
            "table_accel_m_s2": series.true_accel[0],
            "table_disp_m": series.true_disp_m,
            "floor_accel_m_s2": series.true_accel[1:],
            **hidden,
        }
        if hidden:
            scales["channel"] = np.arange(1, 1 + len(setup.rig.all_channels))
        writer.group(f"{run}/truth", truth, time, storey, scales)


def _remarks_on_samples(setup: Setup, series: Series) -> dict[str, tuple[str, ...]]:
    """Return remarks on the processing of a run's measured accelerations, by dataset."""
    if setup.building.specimen.attached:
        return {}
    drift = (DRIFT_REMOVED,) if series.removed is not None else ()
    sensed = (CORRECTED if setup.removes_sensors else AS_SENSED, *drift)
    hold = (HOLD_REMOVED,) if setup.case.method == "best" else ()
    return {"interface_accel_measured_m_s2": sensed + hold, "floor_accel_measured_m_s2": sensed}


def _remarks_on_storeys(setup: Setup) -> dict[str, tuple[str, ...]]:
    """Return remarks on the motion of the whole building in EXP-RTHS, by dataset."""
    unknown = not setup.knows_storeys and len(setup.building.numerical.masses_kg) > 1
    motion = ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2", "inter_storey_drift_m", "storey_shear_n")
    return dict.fromkeys(motion, (UNKNOWN_BELOW,)) if unknown else {}


def write_rest(writer: ResultWriter, run: str, setup: Setup, whole: Whole) -> None:
    """Write the channels' samples at rest before and after a run."""
    spans = ((whole.before_s, whole.before_v), (whole.after_s, whole.after_v))
    time = np.concatenate([begin + setup.rig.dt_s * np.arange(shown.shape[1]) for begin, shown in spans])
    scales = {"channel": np.arange(1, len(whole.before_v) + 1), "rest_time_s": time}
    writer.group(f"{run}/rest", {"samples_v": np.hstack([whole.before_v, whole.after_v])}, scales=scales)


def told(warnings: Sequence[Finding], refusals: Sequence[Finding] = ()) -> dict[str, str]:
    """Return the attributes of what a user should read before trusting a result: as text, and with code and values."""
    data = as_json((*refusals, *warnings))
    return {"warnings": "\n".join(sentences(warnings)), "findings": data if len(data) < MOST_BYTES else "[]"}


def told_also(before: Mapping[str, object], warnings: Sequence[Finding]) -> dict[str, str]:
    """Return the attributes of `told` with further warnings."""
    texts = (str(before.get("warnings") or ""), *sentences(warnings))
    every = (*from_json(str(before.get("findings") or "")), *warnings)
    return {"warnings": "\n".join(filter(None, texts)), "findings": as_json(every)}


def write_identification(writer: ResultWriter, identified: Identification, design: Design) -> None:
    """Write the identification, and the table model that the controllers use."""
    error = identified.best_error if design.model is identified.best else identified.paper_error
    model, fit = design.model, identified.specimen
    assert fit is not None  # every case has experimental storeys
    table = identified.frfs[0]
    values: dict[str, ArrayLike] = {
        "frf": table.response,
        "coherence": table.coherence,
        "zeros": model.zeros,
        "poles": model.poles,
        "gain": model.gain,
        "delay_s": model.delay_s,
        "ripple_m_s2_per_v": model.ripple_m_s2_per_v,
        "coupling_hz": model.coupling_hz,
        "fit_error_rms": error.rms,
        "fit_error_max": error.largest,
        "natural_frequency_hz": fit.natural_frequency_hz,
        "damping_ratio": fit.damping_ratio,
    }
    writer.group("identification", values, scales={"frequency_hz": table.frequency_hz})


def write_controller(writer: ResultWriter, design: Design) -> None:
    """Write every discrete block of the step."""
    blocks = design.blocks
    known = tuple(block for block in (blocks.open_loop, blocks.further, blocks.cell_block()) if block is not None)
    for block in (*blocks.named(), blocks.base_shear(), blocks.staircase(), *known):
        if block.outputs:  # there is no estimator in a test with an actuator
            writer.block(block.name, block.A, block.B, block.C, block.D, block.dt_s, block.inputs, block.outputs)


def design_figures(setup: Setup, identified: Identification, design: Design) -> dict[str, ArrayLike]:
    """Return metrics of the identified model, the feedback and the loop's latency."""
    best = setup.case.method == "best"
    error, fit = (identified.best_error if best else identified.paper_error), identified.specimen
    assert fit is not None  # every case has experimental storeys
    values: dict[str, ArrayLike] = {
        "controller.rounding_step_v": design.blocks.shaping_step_v,
        "controller.reaction_feedforward": float(design.blocks.counters_reaction),
        "controller.friction_compensation": float(design.blocks.friction_compensation is not None),
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
    if design.chosen is not None:
        low, high = design.chosen.weights.disturbance_hz
        values["feedback.chosen_disturbance_low_hz"] = low
        values["feedback.chosen_disturbance_high_hz"] = high
        values["feedback.chosen_command_weight"] = design.chosen.weights.command_weight
        values["feedback.chosen_max_sensitivity"] = design.chosen.max_sensitivity
    if design.chosen_filter is not None:
        values["controller.chosen_kalman_q"] = design.chosen_filter.q
        values["controller.chosen_kalman_residual_hz"] = design.chosen_filter.residual_hz
    if setup.building.specimen.attached or not design.blocks.judged:
        return values
    return values | _latency_figures(setup, identified, design)


def _latency_figures(setup: Setup, identified: Identification, design: Design) -> dict[str, ArrayLike]:
    """Return the metrics of all latencies of the loop, their compensation and remainder, and the identified delay."""
    assert identified.specimen is not None  # every case has experimental storeys
    rig, blocks, specimen = setup.rig, design.blocks, identified.specimen.specimen
    loop = latency_budget.Loop(
        rig, blocks, design.model, setup.building.numerical, specimen, design.shear_now, setup.removes_sensors,
        setup.case.controller.kind != "none",
    )  # fmt: skip
    frequency = latency_budget.frequencies_hz(setup.case.test_band_hz)
    amplitude, _ = amplitude_and_lag(setup.building.numerical, blocks.numerical.linearised(), frequency)
    _, noise = latency_budget.shear_response(blocks.estimator, design.shear_now, specimen, frequency)
    values: dict[str, ArrayLike] = {
        **_budget_figures(latency_budget.budget(loop, frequency)),
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


def remarks(setup: Setup) -> dict[str, str]:
    """Return remarks on the latency's metrics: the frequencies at which they are given in this run."""
    listed = ", ".join(f"{f:g}" for f in latency_budget.frequencies_hz(setup.case.test_band_hz))
    return {path: f"at {listed} Hz" for path, one in metrics_of("latency").items() if one.over}
