"""Signals of a run: its log moved from the loop's clock to the record's, and the motion of the whole building."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rths_cli.control.numerical_substructure import Scheme, all_storeys
from rths_cli.control.part_designs import Logged
from rths_cli.control.storeys_with_laws import LAW_FORCE, StoreysWithLaws
from rths_cli.experiment.ground_motion import GroundMotion
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.run_log import Signals
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.numerics.lti import Array, Block
from rths_cli.structure import Building


@dataclass(frozen=True)
class Series:
    """Signals of a table run on the record's clock, n samples; all values with the same index belong to one instant.

    `desired` (3, n): acceleration, velocity, displacement; `measured` (1 + n_exp, n): corrected accelerations of table
    and floors; `estimated` (3 n_exp or more, n): the Kalman filter's displacements and velocities relative to the
    table, and floor accelerations; `true_accel` (1 + n_exp, n), `true_disp_m` (n,): NaN or empty unless the rig tells.
    `live`: delays, durations of exchanges, losses and states on a real rig, (n,) each. `removed` (1 + n_exp, n):
    offset, drift and jumps that were removed from `measured`; None: nothing was removed. `logged` (l, n): what the
    parts of the step log, named by `logs`. `further` (f, n): values of the further channels. `samples_v` (c, n): as a
    rig in real time gave them, also where the step took others; empty else.
    """

    desired: Array
    measured: Array
    estimated: Array
    base_shear_n: Array
    command_v: Array
    true_accel: Array
    true_disp_m: Array
    compute_s: Array
    live: Mapping[str, Array] = field(default_factory=dict)
    further: Array = field(default_factory=lambda: np.zeros((0, 0)))
    removed: Array | None = None
    logged: Array = field(default_factory=lambda: np.zeros((0, 0)))
    logs: tuple[Logged, ...] = ()
    samples_v: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def has_truth(self) -> bool:
        """Return whether the rig told the true motion of table and floors."""
        return self.true_accel.size > 0 and bool(np.isfinite(self.true_accel).any())

    @property
    def law_force_n(self) -> Array | None:
        """Return the forces (s, n) of the laws of the lowest s storeys, beside their springs; None without laws."""
        rows = {one.name: row for one, row in zip(self.logs, self.logged, strict=True) if one.ahead}
        named = {int(name.split("_")[2]): row for name, row in rows.items() if name.startswith(LAW_FORCE)}
        if not named:
            return None
        return np.array([named.get(storey, 0.0 * self.base_shear_n) for storey in range(1, max(named) + 1)])

    def with_true(self, abs_accel: Array) -> Array:
        """Return the accelerations (n_storeys, n) with true instead of measured ones of table and specimen."""
        computed = abs_accel[: len(abs_accel) - len(self.true_accel)]
        return np.vstack([computed, self.true_accel]) if len(computed) else self.true_accel


class OwnInterface(NamedTuple):
    """What is known of the computed storeys if the caller's own part computed them."""

    ground: GroundMotion
    knows_storeys: bool  # whether those below the interface follow from the building, which the part declares


class BuildingMotion(NamedTuple):
    """Motion of the whole building, (n_storeys, n) each: relative to the ground, and absolute accelerations."""

    rel_disp_m: Array
    rel_vel_m_s: Array
    abs_accel_m_s2: Array


def without_drift(series: Series, removed: Array, lead_samples: int, estimator: Block) -> Series:
    """Return signals from which `removed` (c, n) and its effect on the estimates are subtracted.

    `removed` is the sensors' drift in the corrected samples, on the loop's clock. Base shear and desired motion stay as
    the loop had them.
    """
    table = slice(lead_samples, lead_samples + series.measured.shape[1])
    taken = removed[:, table]
    estimated = series.estimated - run_block(estimator, removed)[:, table]
    return replace(series, measured=series.measured - taken, estimated=estimated, removed=taken)


def on_record_clock(outcome: Outcome, lead_samples: int, dt_s: float, samples: int) -> Series:
    """Return at most `samples` samples on the record's clock.

    The hybrid clock is `lead_samples` ahead of the table: the motion desired at step k is measured at step k + lead.
    """
    log = outcome.log
    count = min(samples, max(outcome.steps - lead_samples, 0))
    table = slice(lead_samples, lead_samples + count)
    return Series(
        desired=log.desired[:, :count],
        measured=log.corrected[:, table],
        estimated=log.estimated[:, table],
        base_shear_n=log.base_shear_n[:count],
        command_v=log.command_v[table],
        true_accel=mean_accelerations(log.true_velocity_m_s, table, dt_s),
        true_disp_m=log.true_displacement_m[table],
        compute_s=log.compute_ns[table] * 1e-9,
        live=_live(log, table),
        further=log.further[:, table],
        logged=_logged(outcome, count, table),
        samples_v=log.samples_v[:, table],
        logs=outcome.logs,
    )


def _logged(outcome: Outcome, count: int, table: slice) -> Array:
    """Return what the parts log on the record's clock: those of the numerical substructure belong to the hybrid one."""
    rows = zip(outcome.log.logged, outcome.logs, strict=True)
    found = [row[:count] if one.ahead else row[table] for row, one in rows]
    return np.array(found).reshape(len(found), count)


def _live(log: Signals, table: slice) -> dict[str, Array]:
    """Return the timing signals of a loop on a real rig by the name of their dataset; empty for a virtual rig."""
    if not log.state.size:
        return {}
    named = {"late_s": 1e-9 * log.late_ns, "exchange_s": 1e-9 * log.exchange_ns, "lost": log.lost, "state": log.state}
    return {name: values[table] for name, values in named.items()}


def mean_accelerations(velocity_m_s: Array, at: slice, dt_s: float) -> Array:
    """Return the mean accelerations (c, .) over the steps around samples `at`, from velocities (c, n) between samples,
    the first half a step after the start from rest."""
    accel = np.empty((len(velocity_m_s), at.stop - at.start))
    first = min(max(at.start, 1), at.stop)
    accel[:, : first - at.start] = velocity_m_s[:, at.start : first]
    before, after = velocity_m_s[:, first - 1 : at.stop - 1], velocity_m_s[:, first : at.stop]
    np.subtract(after, before, accel[:, first - at.start :])
    accel /= dt_s
    return accel


def whole_building(
    building: Building,
    series: Series,
    ground_accel: Array,
    dt_s: float,
    scheme: Scheme = "exact",
    own: OwnInterface | None = None,
) -> BuildingMotion:
    """Return the motion of the hybrid building.

    Numerical storeys as the step computed them (`scheme`: its integration), interface and experimental floors as
    measured; the displacements and velocities of the experimental floors are the Kalman filter's. With a numerical
    substructure of the caller's `own`, the interface's displacement and velocity are those that it gave, and storeys
    below the interface that are not known are NaN.
    """
    numerical = len(building.numerical.masses_kg)
    floors = len(building.specimen.masses_kg)
    inputs = np.vstack([ground_accel[: series.base_shear_n.size], series.base_shear_n])
    if building.linear or own is not None:
        computed = run_block(all_storeys(building.numerical, dt_s, scheme), inputs)
    else:  # the laws' forces are those of the run
        design = StoreysWithLaws(building.numerical, building.laws, dt_s)
        computed = run_block(design.all_storeys, np.vstack([inputs, series.logged[: len(design.storeys)]]))
    disp, vel, accel = (computed[i * numerical : (i + 1) * numerical] for i in range(3))
    if own is not None:
        if not own.knows_storeys:
            disp[:-1], vel[:-1], accel[:-1] = np.nan, np.nan, np.nan
        samples = series.desired.shape[1]
        vel[-1] = series.desired[1] - own.ground.velocity_m_s[:samples]
        disp[-1] = series.desired[2] - own.ground.displacement_m[:samples]
    rel_disp = np.vstack([disp, disp[-1] + series.estimated[:floors]])
    rel_vel = np.vstack([vel, vel[-1] + series.estimated[floors : 2 * floors]])
    return BuildingMotion(rel_disp, rel_vel, np.vstack([accel[:-1], series.measured]))
