"""Further figures of merit of a table run, by their paths: FEI, tracking indicator, J1 to J9, energy error.

Accelerations, because every rig measures them; docs/figures.md defines each. `figures.of_runs` lists the paths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.files.result_writer import Metric
from rths_cli.metrics import (
    best_lag_s,
    error_energy_j,
    frequency_evaluations,
    high_passed,
    input_energy_j,
    response_criteria,
    test_band,
    tracking_indicator,
    tracking_ratios,
    velocity_error_m_s,
)
from rths_cli.workflows.figures import BAND, FULL, scalar
from rths_cli.workflows.lowest_frequency import lowest_reliable_hz

if TYPE_CHECKING:
    from rths_cli.analysis.sim import Response
    from rths_cli.lti import Array
    from rths_cli.metrics import FrequencyEvaluation
    from rths_cli.workflows.series import Series
    from rths_cli.workflows.setup import Setup

BANDS = {"": BAND, "_full": FULL}
TABLE = "desired and measured table acceleration"
LATE = "positive = late"


def of_table_run(
    setup: Setup, run: str, series: Series, sim: Response, hybrid: tuple[Array, Array, Array] | None
) -> dict[str, Metric]:
    """Return the figures of a whole run on the table; `hybrid` is the building's motion in EXP-RTHS, else None."""
    dt, building, ground = setup.rig.dt_s, setup.building, setup.motion.accel_m_s2
    lowest_hz = lowest_reliable_hz(setup)
    desired, measured = series.desired[0], series.measured[0]
    true = series.true_accel[0] if setup.rig.kind == "virtual" else None
    figures = fidelity(run, desired, measured, true, dt, lowest_hz)
    if hybrid is not None:
        storeys = high_passed([sim.abs_accel_m_s2, hybrid[2]], lowest_hz, dt)
        figures |= response(run, storeys[0], storeys[1], len(building.numerical.masses_kg), dt)
        most = float(np.max(input_energy_j(building.M, sim.rel_vel_m_s, ground, dt)))
        figures |= energy(run, desired, measured, true, series.base_shear_n, most, dt)
    return figures


def fidelity(
    run: str, desired: Array, measured: Array, true: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, Metric]:
    """Return FEI, tracking indicator and J1 to J3 of the table; desired, measured, true accelerations (n,) in m/s^2.

    FEI weighs lines by the desired motion's power, so slow motion has no part in it; the others are evaluated above
    `high_pass_hz`.
    """
    full = high_passed([desired, measured], high_pass_hz, dt_s)
    banded = test_band(full, dt_s)
    indicator = float(tracking_indicator(banded[0], banded[1])[-1])
    values = {"": measured} if true is None else {"": measured, "_true": true}
    figures: dict[str, Metric] = {}
    for suffix, found in zip(values, frequency_evaluations(desired, tuple(values.values()), dt_s), strict=True):
        figures |= _evaluation(run, found, suffix)
    about = f"tracking indicator at the end, {TABLE}, {LATE}, {BAND}"
    figures[f"{run}.tracking_indicator_m2_s4"] = scalar(indicator, "m^2/s^4", about)
    return figures | _tracking_criteria(run, {"": banded, "_full": full}, dt_s)


def _evaluation(run: str, found: FrequencyEvaluation, suffix: str) -> dict[str, Metric]:
    about = f"of the frequency evaluation index, {'true' if suffix else 'measured'} / desired table acceleration"
    band = f"lines up to 12 Hz, equivalent frequency {found.frequency_hz:.3g} Hz"
    return {
        f"{run}.fei_amplitude{suffix}": scalar(found.amplitude, "1", f"amplitude {about}, 1 = exact; {band}"),
        f"{run}.fei_delay_s{suffix}": scalar(found.delay_s, "s", f"delay {about}, {LATE}; {band}"),
    }


def _tracking_criteria(run: str, series: dict[str, Array], dt_s: float) -> dict[str, Metric]:
    """Return J1 (in the test band), J2 and J3 from desired and measured (2, n) by band."""
    about = f"J1: lag of best correlation within 12 ms either way, whole samples, {TABLE}, {LATE}, {BAND}"
    figures = {f"{run}.j1_s": scalar(best_lag_s(series[""][0], series[""][1], dt_s), "s", about)}
    for suffix, (desired, measured) in series.items():
        deviation, largest = tracking_ratios(desired, measured)
        about = f"of desired - measured over desired table acceleration, {BANDS[suffix]}"
        figures[f"{run}.j2{suffix}"] = scalar(deviation, "1", f"J2: standard deviation {about}")
        figures[f"{run}.j3{suffix}"] = scalar(largest, "1", f"J3: peak {about}")
    return figures


def response(run: str, sim_accel: Array, accel: Array, interface: int, dt_s: float) -> dict[str, Metric]:
    """Return J4, J5 of the `interface` storey and, from three storeys on, J6 to J9 of the two lowest others.

    Absolute accelerations (n_storeys, n) in m/s^2; storeys count from 1.
    """
    others = [storey for storey in range(1, len(accel) + 1) if storey != interface]
    numbers = {interface: (4, 5)} | (dict(zip(others, ((6, 8), (7, 9)), strict=False)) if len(others) > 1 else {})
    figures: dict[str, Metric] = {}
    for suffix, band in BANDS.items():
        pair = np.stack([sim_accel, accel])
        found = response_criteria(*(pair if suffix else test_band(pair, dt_s)))
        for storey, (first, second) in numbers.items():
            about = f"of SIM - EXP-RTHS over SIM, absolute acceleration of storey {storey}, {band}"
            deviation, largest = found.deviation[storey - 1], found.peak[storey - 1]
            figures[f"{run}.j{first}{suffix}"] = scalar(deviation, "1", f"J{first}: standard deviation {about}")
            figures[f"{run}.j{second}{suffix}"] = scalar(largest, "1", f"J{second}: peak {about}")
    return figures


def energy(
    run: str, desired: Array, measured: Array, true: Array | None, base_shear_n: Array, input_j: float, dt_s: float
) -> dict[str, Metric]:
    """Return the energy that the table's error feeds in, in J and over `input_j`.

    Table accelerations (n,) in m/s^2, base shear (n,) in N as the numerical part felt it.
    """
    figures: dict[str, Metric] = {}
    values = {"": measured} if true is None else {"": measured, "_true": true}
    errors = velocity_error_m_s(desired - np.array(list(values.values())), dt_s)
    for suffix, error in zip(values, errors, strict=True):
        fed = float(error_energy_j(base_shear_n, error, dt_s)[-1])
        about = f"int f (v_desired - v_{'true' if suffix else 'measured'}) dt, positive = fed into the structure"
        figures[f"{run}.energy_error_j{suffix}"] = scalar(fed, "J", about)
        share = fed / input_j if input_j > 0 else math.nan
        figures[f"{run}.energy_error_ratio{suffix}"] = scalar(share, "1", f"{about}; over SIM's largest input energy")
    return figures
