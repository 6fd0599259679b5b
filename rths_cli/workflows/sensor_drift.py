"""Offset, drift and jumps of the channels in a run, told and taken out of its samples once the table is at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.identified_rig import identified_rig
from rths_cli.analysis.sensor_drift import ChannelDrift, channel_drifts, coupled_again
from rths_cli.loop import guard
from rths_cli.loop.replay import run_block

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.control.blocks import Blocks
    from rths_cli.identification.found import Identification
    from rths_cli.loop.drive import Outcome, Whole
    from rths_cli.lti import Array
    from rths_cli.rig_info import RigInfo
    from rths_cli.workflows.setup import Setup

SHORTEST_S = 3.0  # of a run that tells drift from motion
TOLD_BY = (
    guard.NONE, guard.END, guard.STROKE, guard.VELOCITY, guard.ACCELERATION, guard.FORCE, guard.COMMAND, guard.RATE,
    guard.TRACKING, guard.ENERGY, guard.RIG_FAULT,
)  # fmt: skip
"""Ends of runs of which drift and jumps are told: of others the guard has named sensor, link or operator already."""
IMPACT_S = 0.1  # before a rig ended a run, in which the table may have met its end stop


@dataclass(frozen=True)
class SensorDrift:
    """What the channels of a run show beside motion, and `removed` (c, n) m/s^2, on the log's clock from the record's
    first step on: what of that stood in the step's corrected samples. `first`: the sample of the record's start."""

    channels: tuple[ChannelDrift, ...]
    removed: Array
    first: int

    @property
    def any(self) -> bool:
        """Tell whether anything was taken out."""
        return bool(self.removed.any())


def drift_of(setup: Setup, identified: Identification, blocks: Blocks, outcome: Outcome) -> SensorDrift | None:
    """Return what the channels of a run show beside the motion that the identified rig makes of its commands.

    Of a run that the rig ended, what came before: a drift may have driven the table to where the rig gave up. None for
    a run that was not watched at rest before its record, was short, or ended for another reason than motion.
    """
    dt, whole = setup.rig.dt_s, outcome.whole
    if whole is None or not (outcome.played or outcome.reason in TOLD_BY):
        return None
    judged = slice(0, _judged_samples(outcome, whole, dt))
    command_v, corrected = whole.command_v[judged], whole.corrected[:, judged]
    if command_v.size * dt < SHORTEST_S or not np.isfinite(corrected).all():
        return None
    removes = setup.removes_sensors
    corners = [channel.high_pass_hz if removes else 0.0 for channel in setup.rig.channels]
    left = coupled_again(corrected - _answer(setup, identified, blocks, command_v), corners, dt)
    sizes = sensitivities(setup.rig)
    channels = channel_drifts(left, dt, setup.rig.converters.step_v / sizes)
    samples = whole.command_v.size
    shown = np.array([each.shown(samples, dt) if stands_out(each) else np.zeros(samples) for each in channels])
    removed = run_block(blocks.correction, sizes[:, None] * shown) if shown.any() else np.zeros_like(shown)
    return SensorDrift(channels, removed[:, whole.first :], whole.first)


def _judged_samples(outcome: Outcome, whole: Whole, dt_s: float) -> int:
    """Return how many of a run's first samples tell of its sensors: all, or those well before the rig ended it."""
    if outcome.reason == guard.RIG_FAULT:
        return max(whole.first + round((outcome.stopped_at_s - IMPACT_S) / dt_s), 0)
    return max(whole.command_v.size - (round(IMPACT_S / dt_s) if outcome.rig_fault else 0), 0)


def stands_out(channel: ChannelDrift) -> bool:
    """Tell whether a channel has an offset, a drift or jumps that are more than their uncertainties."""
    return channel.drifts or bool(channel.jumps) or channel.unusable_from is not None


def sensitivities(rig: RigInfo) -> Array:
    """Return V per m/s^2 of each channel, without its sign."""
    return np.array([channel.sensitivity_v_per_m_s2 for channel in rig.channels])


def _answer(setup: Setup, identified: Identification, blocks: Blocks, command_v: Array) -> Array:
    """Return what the identified rig answers to commands (n,), as corrected samples (c, n)."""
    assert identified.specimen is not None  # every case has experimental storeys
    rig = identified_rig(identified.best, identified.specimen.specimen, setup.rig, setup.removes_sensors)
    answer = run_block(rig.correction, run_block(rig.plant, command_v[None]))
    change, total = rig.alias_left(blocks)
    late = max(rig.latency_samples, 1)
    earlier = np.concatenate([np.zeros(late + 1), command_v])
    now, before = earlier[1 : command_v.size + 1], earlier[: command_v.size]
    answer[0] += change * (now - before) + total * (now + before)
    return answer


def as_figures(run: str, found: SensorDrift, setup: Setup, lead_samples: int) -> dict[str, ArrayLike]:
    """Return offset, drift and jumps of each channel in the channel's unit."""
    sizes, dt, end = sensitivities(setup.rig) * setup.rig.signs, setup.rig.dt_s, len(setup.motion.time_s)
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
    """Return what a user should know of the channels of a run, each with its unit."""
    start, dt, said = found.first + lead_samples, setup.rig.dt_s, []
    for channel, each in zip(setup.rig.channels, found.channels, strict=True):
        size, who = channel.sign * channel.sensitivity_v_per_m_s2, f"{label}: channel {channel.name}"
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
