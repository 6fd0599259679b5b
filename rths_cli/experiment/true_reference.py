"""The true reference (SIM and SIM-DELAY of the declared numerical storeys below the specimen as it is), the errors
that the check expected, and how certain a residual drift is.

Control answers for the error against it, the declaration of the specimen for the difference to the error against SIM of
the building as declared. Only a simulated rig knows the specimen as it is: the virtual one, or one of a package that
tells it (docs/decisions/errors_and_bands.md).

A storey that yields keeps a drift that depends on small differences: 1 % of base shear may move it by 10 %. The base
shear of a hybrid test is masses times measured accelerations, and it is that of the table as it moved. Both errors are
taken for one of its size: SIM of the building whose specimen pulls 1 % more, or less, says what that does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import rms
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.structural_response import inter_storey_drift_m
from rths_cli.experiment import run_metrics
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.findings import Finding
from rths_cli.rigs.from_case import true_building
from rths_cli.structure import Building, Specimen, assemble

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.analysis.true_error import TrueError
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values

PREFIX = "true_reference_"
RMS, NRMSE = "rms_error_m_s2", "nrmse_percent"

FACTOR = 1.5  # by which the measured error may differ from the expected one before it is told
LEAST_PERCENT = 0.5  # of SIM's RMS; a smaller error, measured and expected, is not worth a sentence
CHANGE = 0.01  # of the base shear, for which the change of the residual drift is computed


@dataclass(frozen=True)
class TrueReference:
    """Absolute accelerations (n_storeys, n) in m/s^2 of SIM and, where asked for, of SIM-DELAY of the true building.

    `as_declared`: the specimen is as declared, and so both are those of the case.
    """

    sim_accel: Array
    delayed_accel: Array | None
    as_declared: bool


def is_another(setup: Setup) -> bool:
    """Tell whether the specimen is known, and another one than declared."""
    building = true_building(setup.case, setup.building)
    return building is not None and building is not setup.building


def true_reference(setup: Setup, sim: Response, progress: Progress) -> TrueReference | None:
    """Return the true reference of a case; None where nobody knows its specimen.

    `sim`: that of the building as declared. A specimen as declared is not solved again.
    """
    building = true_building(setup.case, setup.building)
    if building is None:
        return None
    if building is setup.building:
        return TrueReference(sim.abs_accel_m_s2, None, as_declared=True)
    return reference_of_building(setup, building, progress)


def reference_of_building(setup: Setup, building: Building, progress: Progress) -> TrueReference:
    """Return the true reference of a case whose specimen as it is stands in `building`."""
    progress("SIM and SIM-DELAY of the specimen as it is")
    dt_s, ground, reference = setup.rig.dt_s, setup.motion.accel_m_s2, reference_of(building)
    true_sim, delayed = reference.sim(building, dt_s, ground), None
    if "sim_delay" in setup.case.runs:
        delayed = reference.sim_delay(building, dt_s, ground, setup.case.delay_s, true_sim).abs_accel_m_s2
    return TrueReference(true_sim.abs_accel_m_s2, delayed, as_declared=False)


def true_reference_metrics(
    setup: Setup, truth: TrueReference, true_accel: Array, found: Values
) -> dict[str, ArrayLike]:
    """Return the errors against the true reference by path, of EXP-RTHS and of SIM-DELAY, and their ratio.

    `true_accel` (n_storeys, n) are the true accelerations of EXP-RTHS in m/s^2. `found`: the metrics of the case, whose
    errors are the same where the specimen is as declared.
    """
    values: dict[str, ArrayLike] = {}
    if truth.as_declared:
        same = {"exp_rths": "_true", "sim_delay": ""}
        for run, kind in same.items():
            for name in (RMS, NRMSE):
                if f"{run}.{name}{kind}" in found:
                    values[f"{run}.{PREFIX}{name}"] = found[f"{run}.{name}{kind}"]
    else:
        values |= _errors(setup, "exp_rths", truth.sim_accel, true_accel)
        if truth.delayed_accel is not None:
            values |= _errors(setup, "sim_delay", truth.sim_accel, truth.delayed_accel)
    late = values.get(f"sim_delay.{PREFIX}{RMS}")
    if late is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.asarray(values[f"exp_rths.{PREFIX}{RMS}"]) / np.asarray(late)
        values[f"exp_rths.{PREFIX}ratio"] = ratio
    return values


def _errors(setup: Setup, run: str, sim_accel: Array, accel: Array) -> dict[str, ArrayLike]:
    """Return RMS errors in the test band, also in percent of SIM, by path."""
    settings = setup.rig.dt_s, lowest_reliable_hz(setup)
    errors = run_metrics.errors(run, None, (sim_accel, accel, None), *settings, None, setup.case.test_band_hz)
    percent = run_metrics.relative_errors(run, errors, sim_accel, *settings, setup.case.test_band_hz)
    found = {**errors, **percent}
    return {f"{run}.{PREFIX}{name}": found[f"{run}.{name}"] for name in (RMS, NRMSE)}


def expected_error_metrics(predicted: TrueError | None, values: Values) -> dict[str, ArrayLike]:
    """Return the measured errors over the expected ones, and the ranks of the true errors, by path; `values` holds the
    errors."""
    found: dict[str, ArrayLike] = {}
    expected, measured = (values.get(name) for name in ("check.expected_error_m_s2", "exp_rths.rms_error_m_s2"))
    if expected is not None and measured is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            found["exp_rths.error_over_expected"] = np.asarray(measured) / np.asarray(expected)
    true = values.get("exp_rths.true_reference_rms_error_m_s2")
    if predicted is not None and true is not None:
        found["exp_rths.true_error_rank"] = predicted.rank(np.asarray(true))
    return found


def disagreement(values: Values) -> tuple[Finding, ...]:
    """Return a warning where the measured error of a storey is not the expected one, the one farthest off."""
    needed = ("exp_rths.error_over_expected", "exp_rths.rms_error_m_s2", "exp_rths.nrmse_percent")
    if any(name not in values for name in needed):
        return ()
    over, error, percent = (np.asarray(values[name], dtype=float) for name in needed)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart, largest = np.abs(np.log(over)), percent * np.maximum(1.0, 1.0 / over)
    told = np.isfinite(apart) & (apart > np.log(FACTOR)) & (largest > LEAST_PERCENT)
    if not told.any():
        return ()
    worst = int(np.argmax(np.where(told, apart, 0.0)))
    values = {"error_m_s2": error[worst], "storey": worst + 1, "ratio": over[worst], "larger": bool(over[worst] > 1.0)}
    return (Finding("run.not_as_expected", values),)


def with_base_shear(building: Building, factor: float) -> Building:
    """Return a building whose specimen moves as before and pulls `factor` times as strongly: mass, stiffness and
    damping of all that stands on the table are multiplied."""
    stated = building.specimen
    specimen = Specimen(factor * stated.masses_kg, factor * stated.K, factor * stated.C)
    mass = factor * building.interface_experimental_mass_kg
    M, C, K = assemble(building.numerical, specimen, mass)
    return replace(building, specimen=specimen, interface_experimental_mass_kg=mass, M=M, C=C, K=K)


def change_by_base_shear_m(setup: Setup, sim: Response) -> Array:
    """Return the larger change (n_storeys,) in m of SIM's drift at the record's last sample by a base shear that is 1 %
    larger or smaller. Raises InputError where such a building has no SIM."""
    building, ends = setup.building, []
    for factor in (1.0 - CHANGE, 1.0 + CHANGE):
        changed = with_base_shear(building, factor)
        found = reference_of(changed).sim(changed, setup.rig.dt_s, setup.motion.accel_m_s2)
        ends.append(inter_storey_drift_m(found.rel_disp_m)[:, -1] - inter_storey_drift_m(sim.rel_disp_m)[:, -1])
    return np.asarray(np.abs(ends).max(axis=0))


def residual_drift_metrics(setup: Setup, sim: Response, change_m: Array, found: Values) -> dict[str, ArrayLike]:
    """Return the metrics of the residual drift's uncertainty by path.

    `change_m` (n_storeys,): that of `change_by_base_shear_m`. `found`: the metrics of EXP-RTHS, of which its tracking
    error counts. Storeys on the table are NaN.
    """
    computed = len(setup.building.numerical.masses_kg)
    change = np.where(np.arange(len(change_m)) < computed, change_m, np.nan)
    tracking = float(np.asarray(found["exp_rths.tracking_rms_m_s2"])) / float(rms(sim.abs_accel_m_s2[computed - 1]))
    shear = float(np.hypot(setup.case.base_shear_uncertainty, tracking))
    return {
        "exp_rths.residual_drift_change_m": change,
        "exp_rths.base_shear_uncertainty": shear,
        "exp_rths.residual_drift_uncertainty_m": change * shear / CHANGE,
    }
