"""Drift of sensors in a finished run: taken out of its samples, as metrics and as sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.analysis.sensor_drift import ChannelDrift, channel_drifts, coupled_again
from rths_cli.loop import guard
from rths_cli.loop.block_replay import run_block
from rths_cli.numerics.lti import Block

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.loop.simulated_time_run import Outcome, Whole
    from rths_cli.numerics.lti import Array
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


def sentences(label: str, found: SensorDrift, setup: Setup, lead_samples: int) -> list[str]:
    """Return the warnings on offset, drift and jumps of the channels of a run."""
    start, dt, said = found.first + lead_samples, setup.rig.dt_s, []
    for channel, each, v_per_m_s2 in zip(setup.rig.channels, found.channels, found.v_per_m_s2, strict=True):
        size, who = channel.sign * float(v_per_m_s2), f"{label}: channel {channel.name}"
        if each.drifts:
            off, rate, sure = 1e3 * size * each.offset, 6e4 * size * each.rate, 6e4 * abs(size) * each.rate_uncertainty
            said.append(
                f"{who} has an offset of {off:.3g} mV and drifts by {rate:.3g} mV/min (+-{2.0 * sure:.2g}); taken out "
                "of its samples after the run, the loop had them"
            )
        said += [
            f"{who} jumps by {1e3 * size * jump.size:.3g} mV at {dt * (jump.at - start):.3f} s; taken out of its "
            "samples after the run, the loop had it; check cable and connector"
            for jump in each.jumps
        ]
        if each.unusable_from is not None:
            said.append(
                f"{who} is not usable from {dt * (each.unusable_from - start):.2f} s on: it shows what neither motion "
                "nor drift explains; check cable, connector and mounting"
            )
    return said
