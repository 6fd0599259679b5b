"""Metrics of a run by their paths, from analysis/metrics/: errors, tracking, FEI, J1 to J9, energy error.

Accelerations, because every rig measures them; docs/background/metrics.md defines each.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import (
    best_lag_s,
    error_energy_j,
    figures_of_pairs,
    fitted_delays_s,
    frequency_evaluations,
    high_passed,
    input_energy_j,
    response_criteria,
    test_band,
    tracking_indicator,
    tracking_ratios,
    velocity_error_m_s,
)
from rths_cli.experiment.lowest_reliable_frequency import lowest_reliable_hz
from rths_cli.quantities import kinds_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.control.margins import Margins
    from rths_cli.experiment.run_signals import Series
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values


Compared = tuple["Array", "Array", "Array | None"]
"""A reference, what was measured of it and, on a virtual rig, what is true: accelerations in m/s^2."""


def errors(
    run: str,
    table: Compared | None,
    storeys: Compared | None,
    dt_s: float,
    high_pass_hz: float = 0.0,
    room: Array | None = None,
) -> Values:
    """Return tracking errors of the table, of series (n,), and errors against SIM storey by storey, of (n_storeys, n).

    All are computed in one pass; `room` as `room_for_pairs` gives it for their number.
    """
    pairs: list[tuple[Array, Array]] = []
    places: dict[str, int | slice] = {}
    for path, compared in ((f"{run}.tracking_{{}}_m_s2", table), (f"{run}.{{}}_error_m_s2", storeys)):
        reference, *values = compared or (None,)
        for suffix, value in zip(("", "_true"), values, strict=False):
            if value is None or reference is None:
                continue
            single, first = value.ndim == 1, len(pairs)
            pairs += [(reference, value)] if single else list(zip(reference, value, strict=True))
            places[path + suffix] = first if single else slice(first, len(pairs))
    found = figures_of_pairs(pairs, dt_s, room, high_pass_hz)
    kinds = {"max": found.maximum, "rms": found.rms}, {"max": found.maximum_full, "rms": found.rms_full}
    return {
        path.format(which) + band: figures[place]
        for path, place in places.items()
        for band, both in zip(("", "_full"), kinds, strict=True)
        for which, figures in both.items()
    }


def of_margins(group: str, found: Margins, suffix: str) -> dict[str, ArrayLike]:
    """Return the margins of one loop under a group of paths; infinite where nothing is crossed."""
    values = {
        "sensitivity_peak": found.sensitivity_peak,
        "sensitivity_peak_hz": found.peak_hz,
        "gain_margin": found.gain_margin,
        "gain_reduction_margin": found.gain_reduction_margin,
        "phase_margin_deg": found.phase_margin_deg,
        "delay_margin_s": found.delay_margin_s,
    }
    return {f"{group}.{name}{suffix}": value for name, value in values.items()}


def of_table_run(
    setup: Setup, run: str, series: Series, sim: Response, hybrid: tuple[Array, Array, Array] | None
) -> dict[str, ArrayLike]:
    """Return the figures of a whole run on the table; `hybrid` is the building's motion in EXP-RTHS, else None."""
    dt, building, ground = setup.rig.dt_s, setup.building, setup.motion.accel_m_s2
    lowest_hz = lowest_reliable_hz(setup)
    desired, measured = series.desired[0], series.measured[0]
    true = series.true_accel[0] if setup.rig.can.records_truth else None
    figures = delays(run, desired, measured, true, dt) | fidelity(run, desired, measured, true, dt, lowest_hz)
    if hybrid is not None:
        storeys = high_passed([sim.abs_accel_m_s2, hybrid[2]], lowest_hz, dt)
        figures |= response(run, storeys[0], storeys[1], len(building.numerical.masses_kg), dt)
        most = float(np.max(input_energy_j(building.M, sim.rel_vel_m_s, ground, dt)))
        figures |= energy(run, desired, measured, true, series.base_shear_n, most, dt)
    return figures


def delays(run: str, desired: Array, measured: Array, true: Array | None, dt_s: float) -> dict[str, ArrayLike]:
    """Return the delay fitted to the table's motion, measured and, on a virtual rig, true; accelerations (n,)."""
    values = {"": measured} if true is None else {"": measured, "_true": true}
    found = fitted_delays_s(desired, tuple(values.values()), dt_s)
    return {f"{run}.tracking_delay_s{suffix}": delay for suffix, delay in zip(values, found, strict=True)}


def fidelity(
    run: str, desired: Array, measured: Array, true: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, ArrayLike]:
    """Return FEI, tracking indicator and J1 to J3 of the table; desired, measured, true accelerations (n,) in m/s^2.

    FEI weighs lines by the desired motion's power, so slow motion has no part in it; the others are evaluated above
    `high_pass_hz`.
    """
    full = high_passed([desired, measured], high_pass_hz, dt_s)
    banded = test_band(full, dt_s)
    values = {"": measured} if true is None else {"": measured, "_true": true}
    figures: dict[str, ArrayLike] = {}
    for suffix, found in zip(values, frequency_evaluations(desired, tuple(values.values()), dt_s), strict=True):
        figures[f"{run}.fei_amplitude{suffix}"] = found.amplitude
        figures[f"{run}.fei_delay_s{suffix}"] = found.delay_s
    figures[f"{run}.tracking_indicator_m2_s4"] = float(tracking_indicator(banded[0], banded[1])[-1])
    figures[f"{run}.j1_s"] = best_lag_s(banded[0], banded[1], dt_s)
    for suffix, series in (("", banded), ("_full", full)):
        figures[f"{run}.j2{suffix}"], figures[f"{run}.j3{suffix}"] = tracking_ratios(*series)
    return figures


def response(run: str, sim_accel: Array, accel: Array, interface: int, dt_s: float) -> dict[str, ArrayLike]:
    """Return J4, J5 of the `interface` storey and, from three storeys on, J6 to J9 of the two lowest others.

    Absolute accelerations (n_storeys, n) in m/s^2; storeys count from 1.
    """
    numbers = criteria_of_storeys(interface, len(accel))
    figures: dict[str, ArrayLike] = {}
    for suffix in ("", "_full"):
        pair = np.stack([sim_accel, accel])
        found = response_criteria(*(pair if suffix else test_band(pair, dt_s)))
        for storey, (first, second) in numbers.items():
            figures[f"{run}.j{first}{suffix}"] = found.deviation[storey - 1]
            figures[f"{run}.j{second}{suffix}"] = found.peak[storey - 1]
    return figures


def criteria_of_storeys(interface: int, storeys: int) -> dict[int, tuple[int, int]]:
    """Return the numbers of the J's of deviation and peak by storey: the `interface`, then the two lowest others."""
    others = [storey for storey in range(1, storeys + 1) if storey != interface]
    return {interface: (4, 5)} | (dict(zip(others, ((6, 8), (7, 9)), strict=False)) if len(others) > 1 else {})


def remarks(setup: Setup, run: str, desired: Array) -> dict[str, str]:
    """Return what the definitions of some figures say of this run: the storeys of the J's, the FEI's frequency."""
    interface, storeys = len(setup.building.numerical.masses_kg), len(setup.building.M)
    hz = frequency_evaluations(desired, (desired,), setup.rig.dt_s)[0].frequency_hz
    about = dict.fromkeys(("fei_amplitude", "fei_delay_s"), f"equivalent frequency {hz:.3g} Hz")
    for storey, numbers in criteria_of_storeys(interface, storeys).items():
        about |= {f"j{number}": f"storey {storey}" for number in numbers}
    return {path: words for name, words in about.items() for path in kinds_of(f"{run}.{name}")}


def energy(
    run: str, desired: Array, measured: Array, true: Array | None, base_shear_n: Array, input_j: float, dt_s: float
) -> dict[str, ArrayLike]:
    """Return the energy that the table's error feeds in, in J and over `input_j`.

    Table accelerations (n,) in m/s^2, base shear (n,) in N as the numerical part felt it.
    """
    figures: dict[str, ArrayLike] = {}
    values = {"": measured} if true is None else {"": measured, "_true": true}
    errors = velocity_error_m_s(desired - np.array(list(values.values())), dt_s)
    for suffix, error in zip(values, errors, strict=True):
        fed = float(error_energy_j(base_shear_n, error, dt_s)[-1])
        figures[f"{run}.energy_error_j{suffix}"] = fed
        figures[f"{run}.energy_error_ratio{suffix}"] = fed / input_j if input_j > 0 else math.nan
    return figures
