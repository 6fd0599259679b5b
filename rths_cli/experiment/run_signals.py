"""Signals of a run: its log on the record's clock, the motion of the whole building, drift of sensors found and
taken out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.analysis.sensor_drift import ChannelDrift, channel_drifts, coupled_again
from rths_cli.control.interface import Logged
from rths_cli.control.numerical_substructure import Scheme, all_storeys
from rths_cli.control.storeys_with_laws import LAW_FORCE, StoreysWithLaws
from rths_cli.experiment.ground_motion import GroundMotion
from rths_cli.findings import Finding
from rths_cli.loop import guard
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.run_log import Signals
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.numerics.lti import Array, Block
from rths_cli.structure import Building

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.loop.simulated_time_run import Whole
    from rths_cli.rigs.description import RigInfo

SHORTEST_S = 3.0  # shortest run in which drift can be distinguished from motion
TOLD_BY = (
    guard.NONE, guard.END, guard.STROKE, guard.VELOCITY, guard.ACCELERATION, guard.FORCE, guard.COMMAND, guard.RATE,
    guard.TRACKING, guard.ENERGY, guard.RIG_FAULT, guard.PLANNED_REACH, guard.DEVIATION,
)  # fmt: skip
"""Reasons for which runs are examined for drift: for others the guard has already named sensor, link or operator."""
UNSETTLED_S = 0.3  # time after missing samples that is excluded, because table and samples return gradually
LEAST_SHARE = 0.5  # least fraction of a run that must have samples
BLOCKS, NUMBERS = ("plant", "rig_correction", "correction", "estimator"), ("change", "total", "late")  # of Expected
SENSORS = ("corner_hz", "v_per_m_s2")  # of Expected, by channel
MOST_LATE = 1000  # intervals
IMPACT_S = 0.1  # time before a rig ended a run that is excluded, because the table may have hit its end stop


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
    if building.specimen.attached:  # the actuator shows its displacement; accelerations are the computed ones
        return BuildingMotion(np.vstack([disp[:-1], series.measured[:1]]), vel, accel)
    rel_disp = np.vstack([disp, disp[-1] + series.estimated[:floors]])
    rel_vel = np.vstack([vel, vel[-1] + series.estimated[floors : 2 * floors]])
    return BuildingMotion(rel_disp, rel_vel, np.vstack([accel[:-1], series.measured]))


def base_shear_of(setup: Setup, table: Array, floors: Array) -> Array:
    """Return the base shear (n,) in N by the floors' masses and their accelerations (c, n) above the table's (n,)
    (paper, Eq. 2.6)."""
    building = setup.building
    return np.asarray(-(building.interface_experimental_mass_kg * table + building.specimen.masses_kg @ floors))


def computed_interface(setup: Setup, ground: Array, base_shear_n: Array) -> Array:
    """Return the absolute acceleration (n,) of the interface that the computed storeys of a linear building have."""
    p = len(setup.building.numerical.masses_kg)
    block = all_storeys(setup.building.numerical, setup.rig.dt_s, setup.case.integration)
    return np.asarray(run_block(block, np.vstack([ground, base_shear_n]))[3 * p - 1])


@dataclass(frozen=True)
class SensorDrift:
    """Offset, drift and jumps of the channels in a run."""

    channels: tuple[ChannelDrift, ...]
    removed: Array  # (c, n) m/s^2, their part in the corrected samples, on the log's clock from the record's first step
    first: int  # sample of the record's start
    v_per_m_s2: Array  # (c,) sensitivities of the samples, without sign

    @property
    def any(self) -> bool:
        """Return whether anything was removed."""
        return bool(self.removed.any())


@dataclass(frozen=True)
class Expected:
    """Prediction with which the channels of a run are compared: blocks of the identified rig and of the step."""

    plant: Block  # commands in V to samples of the identified rig in V
    rig_correction: Block  # these samples to the accelerations in the step's corrected samples
    correction: Block  # the step's own sensor correction
    estimator: Block  # the step's own estimator
    change: float  # remaining alias of the hold: m/s^2 per V of difference of the last two commands,
    total: float  # and per V of their sum,
    late: int  # this number of intervals ago
    corner_hz: tuple[float, ...] | None = None  # (c,) of the AC couplings that the correction takes out, as identified
    v_per_m_s2: tuple[float, ...] | None = None  # (c,) sensitivities, as identified; None: an earlier log has none

    def answer(self, command_v: Array) -> Array:
        """Return the response of the identified rig to commands (n,) in V, as corrected samples (c, n)."""
        answer = run_block(self.rig_correction, run_block(self.plant, command_v[None]))
        earlier = np.concatenate([np.zeros(self.late + 1), command_v])
        now, before = earlier[1 : command_v.size + 1], earlier[: command_v.size]
        answer[0] += self.change * (now - before) + self.total * (now + before)
        return answer


def as_stored(expected: Expected) -> dict[str, Any]:
    """Return the prediction as values for JSON, from which `as_read` restores it."""
    numbers = {name: getattr(expected, name) for name in NUMBERS}
    blocks = {name: getattr(expected, name) for name in BLOCKS}
    sensors = {name: getattr(expected, name) for name in SENSORS if getattr(expected, name) is not None}
    return (
        sensors
        | numbers
        | {
            name: {part: getattr(block, part).tolist() for part in "ABCD"} | {"dt_s": block.dt_s}
            for name, block in blocks.items()
        }
    )


def as_read(stored: Mapping[str, Any], channels: int) -> Expected:
    """Return a stored prediction; raises ValueError if it does not fit a rig with that number of channels."""
    try:
        blocks = {name: _block(name, stored[name]) for name in BLOCKS}
        numbers = {name: float(stored[name]) for name in NUMBERS}
        late = int(numbers["late"])
        sensors = {name: tuple(map(float, stored[name])) for name in SENSORS if name in stored}
    except (KeyError, TypeError, OverflowError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from error
    fits = blocks["plant"].D.shape[1] == 1 and len(blocks["plant"].D) == blocks["rig_correction"].D.shape[1]
    fits &= len(blocks["rig_correction"].D) == channels and blocks["correction"].D.shape == (channels, channels)
    fits &= blocks["estimator"].D.shape[1] == channels and 1 <= late <= MOST_LATE
    fits &= all(len(each) == channels and np.isfinite(each).all() and min(each) >= 0.0 for each in sensors.values())
    if not fits or not np.isfinite([numbers["change"], numbers["total"]]).all() or 0.0 in sensors.get(SENSORS[1], ()):
        raise ValueError("blocks that do not fit the rig")
    corner_hz, v_per_m_s2 = (sensors.get(name) for name in SENSORS)
    return Expected(
        **blocks,
        change=numbers["change"],
        total=numbers["total"],
        late=late,
        corner_hz=corner_hz,
        v_per_m_s2=v_per_m_s2,
    )


def _block(name: str, stored: Mapping[str, Any]) -> Block:
    """Return a stored block; raises ValueError if its matrices do not fit each other."""
    a, b, c, d = (np.array(stored[part], dtype=float) for part in "ABCD")
    states, outputs, inputs = len(a), d.shape[0], d.shape[-1]
    if d.ndim != 2 or not all(np.isfinite(part).all() for part in (a, b, c, d)):
        raise ValueError(f"{name} is no block")
    shapes = ((states, states), (states, inputs), (outputs, states))
    a, b, c = (part.reshape(shape) for part, shape in zip((a, b, c), shapes, strict=True))
    return Block(name, a, b, c, d, float(stored["dt_s"]))


def expected_of(setup: Setup, identified: Identification, blocks: Blocks) -> Expected:
    """Return the prediction with which the channels of a run with these blocks are compared."""
    assert identified.specimen is not None  # every case has experimental storeys
    setup, specimen = setup.calibrated(identified), identified.specimen.specimen
    rig = identified_rig(identified.best, specimen, setup.rig, setup.removes_sensors, setup.compared)
    late = max(rig.latency_samples, 1)
    corner_hz = tuple(channel.high_pass_hz if setup.removes_sensors else 0.0 for channel in setup.rig.channels)
    v_per_m_s2 = tuple(sensitivities(setup.rig).tolist())
    return Expected(
        rig.plant, rig.correction, blocks.correction, blocks.estimator, *rig.alias_left(blocks), late,
        corner_hz, v_per_m_s2,
    )  # fmt: skip


def drift_of(setup: Setup, expected: Expected, outcome: Outcome) -> SensorDrift | None:
    """Return offset, drift and jumps of the channels in a run, by comparison with the identified rig's response.

    Samples that are missing, and those shortly after, are replaced by straight lines. A run that the rig ended is
    evaluated up to shortly before its end, because a drift may have driven the table to its end stop. None is returned
    for a run without recorded rest before its record, for a short one, and for one that ended for a reason that a
    drifting sensor cannot cause.
    """
    dt, whole = setup.rig.dt_s, outcome.whole
    if whole is None or not (outcome.played or outcome.reason in TOLD_BY):
        return None
    missing = _untold(whole, dt)
    judged = slice(0, min(_judged_samples(outcome, whole, dt), _last_told(missing)))
    command_v, corrected = whole.command_v[judged], whole.corrected[:, judged]
    told = ~missing[judged]
    if command_v.size * dt < SHORTEST_S or told.mean() < LEAST_SHARE or not np.isfinite(corrected).all():
        return None
    declared = [channel.high_pass_hz if setup.removes_sensors else 0.0 for channel in setup.rig.channels]
    corners = declared if expected.corner_hz is None else expected.corner_hz
    left = _bridged(coupled_again(corrected - expected.answer(command_v), corners, dt), told)
    sizes = sensitivities(setup.rig) if expected.v_per_m_s2 is None else np.array(expected.v_per_m_s2)
    channels = channel_drifts(left, dt, setup.rig.converters.step_v / sizes)
    samples = whole.command_v.size
    shown = np.array([each.shown(samples, dt) if stands_out(each) else np.zeros(samples) for each in channels])
    removed = run_block(expected.correction, sizes[:, None] * shown) if shown.any() else np.zeros_like(shown)
    return SensorDrift(channels, removed[:, whole.first :], whole.first, sizes)


def _judged_samples(outcome: Outcome, whole: Whole, dt_s: float) -> int:
    """Return the number of samples that are evaluated: all, or those up to IMPACT_S before the rig ended the run."""
    if outcome.reason == guard.RIG_FAULT:
        return max(whole.first + round((outcome.stopped_at_s - IMPACT_S) / dt_s), 0)
    return max(whole.command_v.size - (round(IMPACT_S / dt_s) if outcome.rig_fault else 0), 0)


def _untold(whole: Whole, dt_s: float) -> NDArray[np.bool_]:
    """Return the steps (n,) whose samples were missing, or came within UNSETTLED_S after missing ones."""
    if whole.missing is None:
        return np.zeros(whole.command_v.size, dtype=bool)
    return np.asarray(np.convolve(whole.missing, np.ones(1 + round(UNSETTLED_S / dt_s)))[: whole.missing.size] > 0.5)


def _last_told(missing: NDArray[np.bool_]) -> int:
    """Return the number of steps up to the last one that is not excluded."""
    return 1 + int(np.max(np.flatnonzero(~missing), initial=-1))


def _bridged(series: Array, told: NDArray[np.bool_]) -> Array:
    """Return series (c, n) with straight lines in place of the steps that are excluded."""
    if told.all():
        return series
    k, there = np.arange(told.size), np.flatnonzero(told)
    return np.array([np.interp(k, there, row[there]) for row in series])


def stands_out(channel: ChannelDrift) -> bool:
    """Return whether a channel has a significant offset or drift, or jumps, or is not usable."""
    return channel.drifts or bool(channel.jumps) or channel.unusable_from is not None


def sensitivities(rig: RigInfo) -> Array:
    """Return the sensitivity of each channel in V per m/s^2, without its sign."""
    return np.array([channel.sensitivity_v_per_unit for channel in rig.channels])


def as_figures(run: str, found: SensorDrift, setup: Setup, lead_samples: int) -> dict[str, ArrayLike]:
    """Return the metrics of offset, drift and jumps, for each channel, in V as the channel shows them."""
    sizes, dt, end = found.v_per_m_s2 * setup.rig.signs, setup.rig.dt_s, len(setup.motion.time_s)
    start = found.first + lead_samples

    def until(each: ChannelDrift) -> float:
        return dt * (end if each.unusable_from is None else max(min(each.unusable_from - start, end), 0))

    values = {
        "sensor_offset_v": sizes * [each.offset for each in found.channels],
        "sensor_offset_uncertainty_v": abs(sizes) * [each.offset_uncertainty for each in found.channels],
        "sensor_drift_v_per_min": 60.0 * sizes * [each.rate for each in found.channels],
        "sensor_drift_uncertainty_v_per_min": 60.0 * abs(sizes) * [each.rate_uncertainty for each in found.channels],
        "sensor_jumps": np.array([float(len(each.jumps)) for each in found.channels]),
        "sensor_usable_until_s": np.array([until(each) for each in found.channels]),
    }
    return {f"{run}.{name}": value for name, value in values.items()}


def findings_of(label: str, found: SensorDrift, setup: Setup, lead_samples: int) -> tuple[Finding, ...]:
    """Return the warnings on offset, drift and jumps of the channels of a run."""
    start, dt, said = found.first + lead_samples, setup.rig.dt_s, []
    for channel, each, v_per_m_s2 in zip(setup.rig.channels, found.channels, found.v_per_m_s2, strict=True):
        size, named = channel.sign * float(v_per_m_s2), {"channel": channel.name}
        if each.drifts:
            sure = 120.0 * abs(size) * each.rate_uncertainty
            drift = {"drift_v_per_min": 60.0 * size * each.rate, "within_v_per_min": sure}
            said.append(Finding("sensor.drift", {**named, "offset_v": size * each.offset, **drift}))
        for jump in each.jumps:
            values = {**named, "jump_v": size * jump.size, "at_s": dt * (jump.at - start)}
            said.append(Finding("sensor.jump", values))
        if each.unusable_from is not None:
            said.append(Finding("sensor.unusable", {**named, "from_s": dt * (each.unusable_from - start)}))
    return tuple(one.at("at.run", run=label) for one in said)
