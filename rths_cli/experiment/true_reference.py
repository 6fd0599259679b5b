"""The true reference: SIM and SIM-DELAY of the declared numerical storeys below the specimen as it is.

Control answers for the error against it, the declaration of the specimen for the difference to the error against SIM of
the building as declared. Only a simulated rig knows the specimen as it is: the virtual one, or one of a package that
tells it (docs/decisions/errors_and_bands.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.references import reference_of
from rths_cli.experiment import run_metrics
from rths_cli.experiment.lowest_reliable_frequency import lowest_reliable_hz
from rths_cli.rigs.from_case import true_building

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values
    from rths_cli.structure import Building

PREFIX = "true_reference_"
RMS, NRMSE = "rms_error_m_s2", "nrmse_percent"


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


def metrics_of(setup: Setup, truth: TrueReference, true_accel: Array, found: Values) -> dict[str, ArrayLike]:
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
