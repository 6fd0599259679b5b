"""What made the guard stop a test, from the signals of the last second: evidence that separates causes, or their group.

The guard sees one limit violated; a sensor with a wrong sign, for instance, first shows as a command that is too fast.
After the stop there is time to compare. The identified specimen, driven by the table's motion, gives what every floor
must have shown: once driven by the measured motion of the table, once by the desired one.

| a floor fits | wrong is |
|---|---|
| the desired motion, not the measured one | the table's sensor |
| the measured motion, not the desired one | the table, or all sensors alike (a sign) |
| neither | the sensor of that floor, or the specimen |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits, GuardState
from rths_cli.loop.run_log import CAUGHT_UP, MIXED, NO_ANSWER, Signals
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

Flags = NDArray[np.bool_]

WINDOW_S, LATEST_S = 1.0, 0.1  # before the stop: what is computed again, and where a difference counts
NOW_S, MORE = 5e-3, 2.0  # table and desired motion part where they differ MORE than in the window before
RECENT_S = 0.2  # before the stop: samples that were lost there are its cause
OFF, BETTER = 0.25, 0.4  # a difference beyond OFF of the signal counts; below BETTER of the other it explains
BITS = 10.0  # of a channel, beside OFF
FAST = 0.5  # of the velocity limit: a command that moved faster may ask too much of the table
KEPT = 3.0 / g.STUCK_BITS  # of what the guard calls stuck: a channel that kept its code through three bits of motion
TOGETHER = 0.9  # of the longest time that a channel kept its code: those that kept it as long stopped with it
OF_COMMAND = (g.STROKE, g.VELOCITY, g.COMMAND, g.RATE)  # known before the table answers
OF_TABLE = (g.TRACKING, g.ENERGY)  # known from the table's sensor alone
DIAGNOSED = (*OF_COMMAND, g.ACCELERATION, g.FORCE, g.TRACKING, g.ENERGY, g.STUCK, g.SATURATED)

STALLS = (  # values of the log's `lost`
    (NO_ANSWER, "answers of the rig were lost", "the target or the link stalled", "check target and cable"),
    (CAUGHT_UP, "steps overran their interval", "this computer stalled", "end other programs, or lower sample_rate_hz"),
)

CHECK_SENSOR = "check its cable, power, sign and sensitivity"
CHECK_SENSORS = "check their cables, order, power, signs and sensitivities"
CHECK_TABLE = "check amplifier, command cable and end stops; lower scaling, or identify the rig anew"
CHECK_EITHER = f"check the sensor; {CHECK_TABLE}"


@dataclass(frozen=True)
class Cause:
    """What the evidence says, and what to do about it; `of_table`: whether it says that the table does not follow."""

    what: str
    advice: str
    of_table: bool = False


@dataclass(frozen=True)
class Seen:
    """What the comparison shows: floors (n,) that fit neither motion of the table; whether some fit the desired one
    alone, or the measured one alone; whether the two differ, and whether they began to in the last instants."""

    alone: Flags
    as_desired: bool
    as_measured: bool
    astray: bool
    parted: bool


def cause_of(info: RigInfo, blocks: Blocks, limits: GuardLimits, state: GuardState, log: Signals) -> Cause | None:
    """Return why a test was stopped, None where the guard's own reason is all that is known.

    `log` holds all steps, also those before the record.
    """
    reason, last = int(state.flags[1]), int(state.flags[3])
    if reason not in DIAGNOSED or last >= log.corrected.shape[1]:
        return None
    names = [channel.name for channel in info.channels]
    kept = _kept(limits, state)
    found = _all_kept(kept, state) or _of_signals(info, blocks, state, log, kept)
    stall = None if reason == g.STUCK else _lost(log.lost[: last + 1], info.dt_s)  # none keeps one code for so long
    if stall is None:
        return found
    # a table that holds for the stall and then catches up differs from the desired motion as a fault does: the group
    found = found or _of_mixed(names, state, log)
    return Cause(f"{stall.what}, or {found.what}", f"{stall.advice}; {found.advice}") if found else stall


def _of_signals(info: RigInfo, blocks: Blocks, state: GuardState, log: Signals, kept: Flags) -> Cause | None:
    """Return what the comparison of all channels with the identified specimen shows."""
    reason, last, names = int(state.flags[1]), int(state.flags[3]), [channel.name for channel in info.channels]
    seen = _compared(info, blocks.specimen, blocks.lead_samples, log, last) if blocks.specimen else None
    fits = reason not in OF_COMMAND and int(state.flags[2]) in (g.NO_CHANNEL, 0)
    stuck = int(state.flags[2]) if reason == g.STUCK else g.NO_CHANNEL
    found = (_named(names, seen, kept, stuck, fits) if seen else None) or _group(names[0], seen, reason)
    return _or_too_fast(found) if found and found.of_table and _moved_fast(info, log, last) else found


def _of_mixed(names: list[str], state: GuardState, log: Signals) -> Cause | None:
    """Return the channel that was stopped for while samples came back: the log holds too little of what it showed to
    tell whether its sensor is wrong. None where the reason is about no channel, or samples had come back."""
    channel = int(state.flags[2])
    if channel == g.NO_CHANNEL or log.lost[int(state.flags[3])] != MIXED:
        return None
    return Cause(f"the sensor of channel {names[channel]} is wrong", CHECK_SENSOR)


def _lost(lost: Array, dt_s: float) -> Cause | None:
    """Return that samples were missing shortly before; one alone shakes nothing."""
    recent = lost[-max(round(RECENT_S / dt_s), 1) :]
    for kind, what, stalled, advice in STALLS:
        if (count := _longest(recent == kind)) > 1:
            return Cause(f"{count} {what} in a row ({1e3 * count * dt_s:.0f} ms) shortly before: {stalled}", advice)
    return None


def _longest(flags: Flags) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _kept(limits: GuardLimits, state: GuardState) -> Flags:
    """Return which channels kept their code to the bit while they had to move, (c,)."""
    return (state.moved.min(axis=0) > KEPT * limits.stuck_m_s2) & (state.same > 1)


def _all_kept(kept: Flags, state: GuardState) -> Cause | None:
    """Return that all channels are stuck, where that is so: one had to move, and all stopped with it."""
    samples = int(state.same.min())
    if not kept.any() or samples < TOGETHER * int(state.same.max()):
        return None
    return Cause(
        f"all channels kept their values for {samples} samples: the sensors' power, the converter, or the table",
        "check power and converter, amplifier and command cable",
    )


def _compared(info: RigInfo, specimen: Specimen, lead: int, log: Signals, last: int) -> Seen | None:
    """Compare all channels with the identified specimen; None where the signals do not permit it."""
    first = max(last - round(WINDOW_S / info.dt_s), lead)
    rows, floors = slice(first, last + 1), len(specimen.masses_kg)
    if len(log.estimated) < 2 * floors:  # a lean log keeps no estimates
        return None
    table, shown = log.corrected[0, rows], log.corrected[1:, rows]
    desired = log.desired[0, first - lead : last + 1 - lead]
    start = log.estimated[: 2 * floors, first]
    if last - first < 2 or not all(np.isfinite(part).all() for part in (table, shown, desired, start)):
        return None
    by_measured = _floors(specimen, table, start, info.dt_s)
    by_desired = _floors(specimen, desired, start, info.dt_s)
    latest = slice(-max(round(LATEST_S / info.dt_s), 1), None)
    least = BITS * np.array([info.converters.step_v / channel.sensitivity_v_per_m_s2 for channel in info.channels])
    off_measured, off_desired = (_peak((shown - other)[:, latest]) for other in (by_measured, by_desired))
    size = np.maximum(_peak(shown), np.minimum(_peak(by_measured), _peak(by_desired)))
    off = np.maximum(off_measured, off_desired) > OFF * size + least[1:]
    as_desired, as_measured = off & (off_desired < BETTER * off_measured), off & (off_measured < BETTER * off_desired)
    error, now = np.abs(table - desired), max(round(NOW_S / info.dt_s), 1)
    astray = error[latest].max() > OFF * np.maximum(_peak(table), _peak(desired)) + least[0]
    parted = error[-now:].max() > MORE * error[:-now].max(initial=0.0) + least[0]
    alone = off & ~as_desired & ~as_measured
    return Seen(alone, bool(as_desired.any()), bool(as_measured.any()), bool(astray), bool(parted))


def _moved_fast(info: RigInfo, log: Signals, last: int) -> bool:
    """Tell whether the commands that passed shortly before asked for more than FAST of the velocity limit."""
    passed = log.command_v[max(last - round(LATEST_S / info.dt_s), 0) : last]
    fastest = np.abs(np.diff(passed)).max(initial=0.0) * info.gain_m_per_v / info.dt_s
    return bool(fastest > FAST * info.limits.velocity_m_s)


def _or_too_fast(cause: Cause) -> Cause:
    return Cause(f"the motion asked for is too fast for the table, or {cause.what}", cause.advice)


def _either(table: str) -> Cause:
    return Cause(f"the table does not follow, or the sensor of channel {table} is wrong", CHECK_EITHER, of_table=True)


def _named(names: list[str], seen: Seen, kept: Flags, stuck: int, of_table: bool) -> Cause | None:
    """Return the cause that fits what was seen; `stuck`: the channel that the guard found stuck, `of_table`: the limit
    violated may be about table or table sensor."""
    table = names[0]
    own = [name for c, name in enumerate(names[1:]) if seen.alone[c] or c + 1 == stuck]
    beside = bool(seen.astray and own and (of_table or (len(own) > 1 and seen.alone.all())))
    wrong = [table] * (seen.as_desired or beside or stuck == 0) + own
    still = " (its value does not change)" if len(wrong) == 1 and kept[names.index(wrong[0])] else ""
    if own and seen.as_measured:
        advice = f"{CHECK_TABLE}; {CHECK_SENSORS}"
        return Cause(f"the table, or the sensors of {_list(own)}, or the specimen", advice, of_table=True)
    if len(wrong) > 1:
        return Cause(f"{_list(wrong)} do not fit each other: their sensors, or the specimen", CHECK_SENSORS)
    if own:
        return Cause(f"{_list(wrong)} does not fit the others: its sensor{still}, or the specimen", CHECK_SENSOR)
    if wrong and not seen.as_measured:
        what = f"channel {table} does not show the motion that the floors show: its sensor{still}"
        return Cause(what, CHECK_SENSOR)
    if seen.as_measured and not wrong:
        return Cause("the table does not move as desired, or all sensors are wrong alike", CHECK_TABLE, of_table=True)
    if wrong or (seen.astray and of_table):
        return _either(table)
    return None


def _group(table: str, seen: Seen | None, reason: int) -> Cause | None:
    """Return the parts that may have failed where no channel stands out; a command beyond its limits may answer to a
    table that has just left its way."""
    if reason in OF_TABLE:
        return _either(table)
    return _or_too_fast(_either(table)) if reason in OF_COMMAND and seen and seen.parted else None


def _list(names: list[str]) -> str:
    """Return names of channels as `channels a, b and c`."""
    if len(names) == 1:
        return f"channel {names[0]}"
    return f"channels {', '.join(names[:-1])} and {names[-1]}"


def _peak(rows: Array) -> Array:
    return np.abs(rows).max(axis=-1)


def _floors(specimen: Specimen, table_m_s2: Array, start: Array, dt_s: float) -> Array:
    """Return the floors' accelerations (floors, n) under a motion of the table (n,), from a state (2 floors,)."""
    from scipy.signal import lsim  # takes half a second; only a run that was stopped is diagnosed

    system = specimen_state_space(specimen)
    time = dt_s * np.arange(table_m_s2.size)
    return np.asarray(
        lsim((system.A, system.B, system.C, system.D), table_m_s2, time, X0=start)[1].T.reshape(-1, time.size)
    )
