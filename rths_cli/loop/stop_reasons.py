"""The finding of each stop of the guard: what was seen, the limit, the key that states it, what to do."""

from __future__ import annotations

import math

from rths_cli.findings import Finding, stated
from rths_cli.findings.of_stop import TEXTS
from rths_cli.loop import guard as g
from rths_cli.loop.diagnosis import HOST, Cause
from rths_cli.loop.guard import GuardLimits, GuardState
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.rigs.description import RigInfo

PLANNED = "the limit by the planned motion"
KEYS = {
    g.STROKE: ("limits.stroke_m", "m"),
    g.VELOCITY: ("limits.velocity_m_s", "m/s"),
    g.ACCELERATION: ("limits.acceleration_m_s2", "m/s^2"),
    g.FORCE: ("limits.force_n", "N"),
    g.COMMAND: ("converters.range_v", "V"),
    g.RATE: ("limits.command_rate_v_s", "V/s"),
    g.TRACKING: ("limits.tracking_error_m_s2", "m/s^2"),
    g.ENERGY: ("limits.energy_ratio", ""),
    g.SATURATED: ("its range", "V"),
    g.STUCK: ("the motion it must show", "m/s^2"),
    g.LOST: ("limits.lost_samples", ""),
    g.OVERRUN: ("limits.lost_samples", ""),
    g.MEASURED_STROKE: ("limits.stroke_m", "m"),
    g.LEVEL: ("its abort", ""),
    g.DISAGREES: ("tolerated RMS difference", ""),
    g.PLANNED_REACH: (PLANNED, "m"),
    g.DEVIATION: (PLANNED, "m"),
}
BY_MOTION = (g.STROKE, g.MEASURED_STROKE, g.LEVEL, g.VELOCITY, g.ACCELERATION, g.FORCE, g.COMMAND, g.RATE)
SENSOR = "check its cable and power"
AS_PLANNED = "rths check tells the motion that the test needs; lower scaling, or identify the rig anew"
TABLE = "identify the rig anew; rths check tells which error of the table the test bears"
ADVICE = {
    g.TRACKING: TABLE,
    g.ENERGY: TABLE,
    g.SATURATED: "check its cable, its range_g and the level of the test",
    g.STUCK: SENSOR,
    g.DISAGREES: "check its cable, power, sign and sensitivity, and whether the table follows its command",
    g.LOST: "check target (one on this computer stalls with it) and cable, lower sample_rate_hz, or raise "
    "limits.lost_samples of the rig",
    g.OVERRUN: HOST,
    g.PLANNED_REACH: AS_PLANNED,
    g.DEVIATION: AS_PLANNED,
}


def reason_of(
    info: RigInfo, limits: GuardLimits, state: GuardState, source: int, cause: Cause | None = None, fault: str = ""
) -> str:
    """Return the guard's reason in words, "" if the guard did not stop the test before the end of the record."""
    found = stop_of(info, limits, state, source, cause, fault)
    return "" if found is None else str(found)


def stop_of(
    info: RigInfo, limits: GuardLimits, state: GuardState, source: int, cause: Cause | None = None, fault: str = ""
) -> Finding | None:
    """Return why the guard stopped the test before the end of the record, None if it did not.

    `source` is that of the step; for an excitation no advice on too large motions is given, because its plan gives it.
    `cause`: the cause found in the signals, which is named first. `fault`: what a part of the step raised, after which
    its outputs are no numbers.
    """
    reason, channel = int(state.flags[1]), int(state.flags[2])
    if reason in (g.NONE, g.END):
        return None
    if fault and reason == g.NOT_A_NUMBER:
        return stated(fault)
    named = f"channel {info.all_channels[channel].name}" if channel != g.NO_CHANNEL else ""
    number, units = float(state.seen[0]), KEYS.get(reason, ("", ""))[1]
    if channel >= len(info.channels) and reason in (g.LEVEL, g.DISAGREES):
        units = info.all_channels[channel].unit
    seen = "" if reason not in KEYS or math.isnan(number) else f"{number:.4g} {units}".strip()
    key, limit = _limit(info, limits, state, reason, channel)
    said = key if math.isnan(limit) else f"{key} is {limit:.4g}"
    advice = cause.advice if cause else _advice(reason, channel, source)
    if reason == g.OVERRUN and info.overrun == "stop":
        advice = "end other programs, lower sample_rate_hz (rths doctor recommends one), or state overrun: hold"
    facts = ", ".join(filter(None, (named, seen, said)))
    values = {
        "details": "; ".join(filter(None, (facts, advice))),
        "cause": cause.what if cause else None,
        "channel": named.removeprefix("channel ") or None,
        "seen": number if seen else None,
        "limit": None if math.isnan(limit) else limit,
        "units": units or None,
        "key": key or None,
    }
    return Finding(f"stop.{tuple(TEXTS)[reason - 1]}", values)


def _limit(info: RigInfo, limits: GuardLimits, state: GuardState, reason: int, channel: int) -> tuple[str, float]:
    """Return the key of the limit, "" without one, and its value, NaN where the key is a sentence."""
    if reason not in KEYS:
        return "", math.nan
    if reason == g.OVERRUN and info.overrun == "stop":
        return "overrun is stop", math.nan
    key, limit = KEYS[reason][0], _number(info, limits, state, reason, channel)
    if reason == g.STROKE and limit < limits.stroke_m:
        key = "converters.range_v by nominal.gain_m_per_v"
    if reason == g.ACCELERATION and limit < limits.acceleration_m_s2:
        key = "its abort_m_s2" if limit == info.channels[channel].abort else PLANNED
    if reason == g.TRACKING and limit < info.limits.tracking_error_m_s2:
        key = PLANNED
    return key, limit


def _number(info: RigInfo, limits: GuardLimits, state: GuardState, reason: int, channel: int) -> float:
    """Return the value of the limit that belongs to a reason."""
    if reason in (g.LOST, g.OVERRUN):
        return info.limits.lost_samples
    own = len(info.channels)
    if channel >= own and reason in (g.SATURATED, g.LEVEL):
        return float((limits.further.saturation_v if reason == g.SATURATED else limits.further.abort)[channel - own])
    if reason == g.DISAGREES:
        size = g.DIFFERS**2 * state.compared[channel - own, g.SIZE]
        return math.sqrt(size + limits.further.tolerated[channel - own] ** 2)
    by_channel = {g.ACCELERATION: limits.abort, g.SATURATED: limits.saturation_v, g.STUCK: limits.stuck}
    if reason in by_channel:
        return float(by_channel[reason][channel])
    alone = {
        g.MEASURED_STROKE: limits.stroke_m,
        g.STROKE: min(limits.stroke_m, limits.gain_m_per_v * limits.command_v),
        g.VELOCITY: limits.velocity_m_s,
        g.FORCE: limits.force_n,
        g.COMMAND: limits.command_v,
        g.RATE: limits.command_rate_v_s,
        g.TRACKING: limits.tracking_error,
        g.ENERGY: limits.energy_ratio,
        g.PLANNED_REACH: limits.reach_m,
        g.DEVIATION: limits.deviation_m,
    }
    return alone[reason]


def _advice(reason: int, channel: int, source: int) -> str:
    """Return the advice, "" if the rig, a person or the plan of an excitation gives it."""
    if reason in BY_MOTION:
        return "" if source == EXCITATION else "lower scaling"
    if reason == g.NOT_A_NUMBER:
        return "rths check tells whether the loop is stable" if channel == g.NO_CHANNEL else SENSOR
    return ADVICE.get(reason, "")
