"""The cause of a stop by the guard, told from the signals before it: a sensor, the table, a stall, or a group of
these.

The guard detects the first violated limit, which is a symptom: a sensor with a wrong sign, for instance, first shows as
a command that is too fast. After the stop there is time for a comparison. The identified specimen predicts the motion
of every floor, once from the measured motion of the table and once from the desired one.

| a floor fits | fault in |
|---|---|
| the desired motion, not the measured one | the table's sensor |
| the measured motion, not the desired one | the table, or all sensors alike (a sign) |
| neither | the sensor of that floor, or the specimen |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits, GuardState
from rths_cli.loop.lost_samples import CAUGHT_UP, MIXED, NO_ANSWER, without_samples
from rths_cli.loop.run_log import Signals
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

FURTHER_WINDOW_S, FURTHER_LATEST_S = (
    2.0,
    0.3,
)  # time before the stop that is compared; its end, in which the fault must show
TRIED_S = (0.3, 0.2, 0.1, 0.06, 0.03, 0.0)  # times before the stop over which an explanation is tried, the longest
# first: all look alike over a short one, but a fault may be young (0: two samples)
EXPLAINED = 0.3  # of the difference, that an explanation may leave
FREER = 0.05  # the same more for a factor, which explains a reversed sign as well
UNCHANGED_BITS, MOVED_BITS = 3.0, 10.0  # within which a value counts as unchanged; by which it must have changed then
FOLLOWS = 0.3  # error over desired acceleration, below which the table follows
FURTHER_RECENT_S = 0.5  # time before the stop over which the gain is taken, for it may drift
GAIN_CHANGED = 0.03  # change of the table's gain that is worth telling

Flags = NDArray[np.bool_]
WINDOW_S, LATEST_S = 1.0, 0.1  # time before the stop that is simulated; its end, in which differences count
NOW_S, MORE = 5e-3, 2.0  # last instants; table and desired motion diverge if they differ more by this factor
RECENT_S = 0.2  # samples lost within this time before the stop are a cause
OFF, BETTER = 0.25, 0.4  # significant difference over the signal; over the other difference, to explain a floor
JUMP, JUMPED = 3.0, 0.5  # from one sample to the next: over the usual steps, over the usual size of a channel
BITS = 10.0  # a significant difference also exceeds this many bits of the channel
FAST = 0.5  # a command faster than this fraction of the velocity limit may be too fast for the table
KEPT = 3.0 / g.STUCK_BITS  # fraction of the guard's threshold (10 bits): the channel missed three bits of motion
HALF_CYCLES = 9, 24  # of a growing oscillation: fewest, and most that are looked at
GROWTH, UNEVEN = 1.5, 0.25  # its last third over the first; standard deviation of half cycles over their mean
TOGETHER = 0.9  # channels that kept their code for this fraction of the longest such time stopped together
OF_COMMAND = (
    g.STROKE,
    g.VELOCITY,
    g.COMMAND,
    g.RATE,
    g.PLANNED_REACH,
    g.DEVIATION,
)  # reasons that depend on the command alone
OF_TABLE = (g.TRACKING, g.ENERGY)  # reasons that depend on the table's sensor alone
OF_FURTHER = (g.MEASURED_STROKE, g.DISAGREES)  # reasons that a displacement sensor or load cell gives
DIAGNOSED = (*OF_COMMAND, g.ACCELERATION, g.FORCE, g.TRACKING, g.ENERGY, g.STUCK, g.SATURATED, *OF_FURTHER)
HOST_SHARE = 0.1  # late steps over steps without samples, from which this computer is the cause
LATE = 0.5  # fraction of an interval by which a step of a stalled computer begins late
HOST = "end other programs, lower sample_rate_hz (rths doctor recommends one), or raise limits.lost_samples of the rig"
STALLS = (  # values of the log's `lost`
    (NO_ANSWER, "answers of the rig were lost", "the target or the link stalled", "check target and cable"),
    (CAUGHT_UP, "steps overran their interval", "this computer stalled", HOST),
)
CHECK_SENSOR = "check its cable, power, sign and sensitivity"
CHECK_SENSORS = "check their cables, order, power, signs and sensitivities"
CHECK_TABLE = "check amplifier, command cable and end stops; lower scaling, or identify the rig anew"
CHECK_LOOP = (
    "rths check tells the loop's margins; lower feedback_bandwidth_hz, use controller FF, or identify up to there"
)
CHECK_EITHER = f"check the sensor; {CHECK_TABLE}"


def fault_of(info: RigInfo, limits: GuardLimits, log: Signals, last: int, channel: int) -> tuple[int, str] | None:
    """Return the further channel that disagrees at step `last`, and how; None where none does.

    `channel`: the further channel that the guard named, which is judged first, or -1.
    """
    order = sorted(range(len(info.further)), key=lambda j: j != channel)
    for j in order:
        pair = _pair(info, limits, log, last, j)
        if pair is None:
            continue
        compared = [_low_passed(row, info.dt_s) for row in pair] if _is_place(limits, j) else pair
        latest = slice(-max(round(FURTHER_LATEST_S / info.dt_s), 2), None)
        size, off = _rms(compared[1]), _rms((compared[0] - compared[1])[latest])
        if j == channel or off > g.DIFFERS * size + limits.further.tolerated[j]:
            return j, _way(info, *pair, j)
    return None


def _is_place(limits: GuardLimits, j: int) -> bool:
    return bool(limits.further.duty[j] == g.STROKE_SENSOR)


def gain_of_table(info: RigInfo, limits: GuardLimits, log: Signals, last: int, channel: int) -> float | None:
    """Return how far the table moves over what is commanded, by a displacement sensor; None if that is not known."""
    pair = _pair(info, limits, log, last, channel)
    if pair is None or _rms(pair[1]) < limits.further.tolerated[channel]:
        return None
    recent = slice(-max(round(FURTHER_RECENT_S / info.dt_s), 2), None)
    shown, must = (_low_passed(row, info.dt_s)[recent] for row in pair)
    return float(shown @ must / (must @ must))


def table_follows(info: RigInfo, log: Signals, last: int, lead: int) -> bool | None:
    """Return whether the table's accelerometer shows the desired motion; None where nothing is desired."""
    first = max(last - round(FURTHER_WINDOW_S / info.dt_s), lead)
    rows = slice(first, last + 1)
    if last - first < 2 or not log.desired.size:
        return None
    desired, measured = log.desired[0, first - lead : last + 1 - lead], log.corrected[0, rows]
    if not (np.isfinite(desired).all() and np.isfinite(measured).all()) or not desired.any():
        return None
    return bool(_rms(measured - desired) < FOLLOWS * _rms(desired))


def _pair(info: RigInfo, limits: GuardLimits, log: Signals, last: int, j: int) -> tuple[Array, Array] | None:
    """Return what a further channel showed before a stop, and what it must show, (n,) each; None if that is unknown."""
    duty, rows = limits.further.duty[j], slice(max(last + 1 - round(FURTHER_WINDOW_S / info.dt_s), 0), last + 1)
    if duty not in (g.STROKE_SENSOR, g.CELL) or len(log.further) <= j or last < 2:
        return None
    shown = log.further[j, rows]
    if duty == g.CELL:
        must = limits.further.reads[j] @ log.corrected[:, rows]
    else:
        must = limits.gain_m_per_v * np.atleast_2d(log.command_v)[0, rows]
    return (shown, must) if np.isfinite(shown).all() and np.isfinite(must).all() else None


def _low_passed(row: Array, dt_s: float) -> Array:
    """Return what the guard compares of a displacement (n,): behind its two low passes."""
    from scipy.signal import lfilter  # takes half a second; only a run that was stopped is diagnosed

    keeps = 1.0 / (1.0 + 2.0 * np.pi * g.COMPARED_HZ * dt_s)
    for _ in range(2):
        row, _ = lfilter([1.0 - keeps], [1.0, -keeps], row, zi=[keeps * row[0]])
    return np.asarray(row)


def _way(info: RigInfo, shown: Array, must: Array, j: int) -> str:
    """Return how further channel `j` differs from what it must show, (n,) each: the explanation that leaves least, over
    the longest time before the stop that one explains."""
    bit, unit = info.converters.step_v / info.further[j].sensitivity_v_per_unit, info.further[j].unit
    windows = [slice(-max(round(time_s / info.dt_s), 2), None) for time_s in TRIED_S]
    if any(
        np.ptp(shown[latest]) <= UNCHANGED_BITS * bit and np.ptp(must[latest]) > MOVED_BITS * bit
        for latest in windows[:-1]
    ):
        return "its value does not change"
    for latest in windows:
        now, wanted = shown[latest], must[latest]
        off, size = now - wanted, max(float(wanted @ wanted), 1e-24)
        factor, all_of_it = float(now @ wanted) / size, max(_rms(off), 1e-12)
        ways = (
            (_rms(now + wanted) / all_of_it, "its sign is reversed"),
            (float(np.std(off)) / all_of_it, f"it is off by {float(np.mean(off)):.3g} {unit}"),
            (_rms(now - factor * wanted) / all_of_it + FREER, f"it shows {factor:.2g} times what it must"),
        )
        left, told = min(ways)
        if left < EXPLAINED:
            return told
    return "it shows something else than it must"


def _rms(row: Array) -> float:
    return float(np.sqrt(np.mean(row**2))) if row.size else 0.0


@dataclass(frozen=True)
class Cause:
    """A cause in words, and the remedy."""

    what: str
    advice: str
    of_table: bool = False  # whether the cause is that the table does not follow


@dataclass(frozen=True)
class Seen:
    """Result of the comparison of all channels with the identified specimen."""

    alone: Flags  # (n,) floors that fit neither the desired nor the measured motion of the table
    as_desired: bool  # whether a floor fits the desired motion only
    as_measured: bool  # whether a floor fits the measured motion only
    astray: bool  # whether desired and measured motion of the table differ
    parted: bool  # whether they began to differ in the last instants


Foreseen = Mapping[int, Cause]
"""Causes that were known before a run, by the guard's reasons that they explain."""
NOTHING_FORESEEN: Foreseen = {}


def cause_of(
    info: RigInfo,
    blocks: Blocks,
    limits: GuardLimits,
    state: GuardState,
    log: Signals,
    foreseen: Foreseen = NOTHING_FORESEEN,
) -> Cause | None:
    """Return the cause of a stop, None if nothing is known beyond the guard's own reason.

    `log` holds all steps, also those before the record. What was `foreseen` goes before what the signals tell.
    """
    reason, last = int(state.flags[1]), int(state.flags[3])
    if reason == g.LOST:
        gap = max(round(RECENT_S / info.dt_s), info.limits.lost_samples)
        return stall_of_this_computer(log, max(last + 1 - gap, 0), last, info.dt_s)
    if reason not in DIAGNOSED or last >= log.corrected.shape[1]:
        return None
    names = [channel.name for channel in info.channels]
    kept = _kept(limits, state)
    found = foreseen.get(reason) or _all_kept(kept, state) or _of_further(info, blocks, limits, state, log)
    if found is None and reason not in OF_FURTHER:
        found = _of_signals(info, blocks, state, log, kept)
    stall = None if reason == g.STUCK else _lost(log, last, info.dt_s)  # no stall lasts as long as STUCK_S
    if stall is None:
        return found
    # a table that holds during a stall and then catches up looks like a faulty one: both causes are named
    found = found or _of_mixed(names, state, log)
    return Cause(f"{stall.what}, or {found.what}", f"{stall.advice}; {found.advice}") if found else stall


def _of_signals(info: RigInfo, blocks: Blocks, state: GuardState, log: Signals, kept: Flags) -> Cause | None:
    """Return the cause that follows from comparing all channels with the identified specimen."""
    reason, last, names = int(state.flags[1]), int(state.flags[3]), [channel.name for channel in info.channels]
    seen = _compared(info, blocks.specimen, blocks.lead_samples, log, last) if blocks.specimen else None
    fits = reason not in OF_COMMAND and int(state.flags[2]) in (g.NO_CHANNEL, 0)
    stuck = int(state.flags[2]) if reason == g.STUCK else g.NO_CHANNEL
    one = _singled_out(kept, state, log, last, info.dt_s)
    found = (_named(names, seen, kept, stuck, fits, one) if seen else None) or _group(names[0], seen, reason)
    if (found is None or found.of_table) and (hz := _growing_hz(log, blocks.lead_samples, last, info.dt_s)):
        return Cause(f"an oscillation of {hz:.3g} Hz grows in the loop of table and controller", CHECK_LOOP, True)
    return _or_too_fast(found) if found and found.of_table and _moved_fast(info, log, last) else found


def _of_further(info: RigInfo, blocks: Blocks, limits: GuardLimits, state: GuardState, log: Signals) -> Cause | None:
    """Return the cause that a displacement sensor or load cell tells of, or is; None without one."""
    if not info.further:
        return None
    reason, last, own = int(state.flags[1]), int(state.flags[3]), len(info.channels)
    named = int(state.flags[2]) - own if int(state.flags[2]) >= own else -1
    if reason == g.MEASURED_STROKE:
        gain = gain_of_table(info, limits, log, last, named)
        if gain is not None and abs(gain - 1.0) > GAIN_CHANGED:
            what = f"the table moves {gain:.2f} times as commanded: the gain of amplifier or table, or the sensor's"
            return Cause(what, "check the amplifier and the sensor's sensitivity; identify the rig anew", of_table=True)
        return None
    found = fault_of(info, limits, log, last, named if reason == g.DISAGREES else -1)
    if found is None:
        return None
    channel, way = info.further[found[0]], found[1]
    sensor = Cause(f"the sensor of channel {channel.name} is wrong, {way}", CHECK_SENSOR)
    if limits.further.duty[found[0]] == g.STROKE_SENSOR:
        follows = table_follows(info, log, last, blocks.lead_samples)
        if follows:
            return sensor
        told = f"the table does not follow its command, or the sensor of channel {channel.name} is wrong, {way}"
        return Cause(told, CHECK_EITHER, of_table=True)
    kept, stuck = _kept(limits, state), g.NO_CHANNEL
    seen = _compared(info, blocks.specimen, blocks.lead_samples, log, last) if blocks.specimen else None
    single = _singled_out(kept, state, log, last, info.dt_s)
    other = _named([one.name for one in info.channels], seen, kept, stuck, False, single) if seen else None
    return other if other is not None and not other.of_table else sensor


def _of_mixed(names: list[str], state: GuardState, log: Signals) -> Cause | None:
    """Return the channel that caused a stop during the return of samples after a gap, as a possible cause.

    The log then holds too few measured samples to judge its sensor. None if the reason concerns no channel, or if the
    samples had returned.
    """
    channel = int(state.flags[2])
    if channel == g.NO_CHANNEL or log.lost[int(state.flags[3])] != MIXED:
        return None
    return Cause(f"the sensor of channel {names[channel]} is wrong", CHECK_SENSOR)


def _lost(log: Signals, last: int, dt_s: float) -> Cause | None:
    """Return the stall, if two or more consecutive samples were missing shortly before the stop; else None."""
    first = max(last + 1 - max(round(RECENT_S / dt_s), 1), 0)
    recent, own = log.lost[first : last + 1], stall_of_this_computer(log, first, last, dt_s)
    for kind, what, stalled, advice in STALLS:
        if (count := _longest(recent == kind)) > 1:
            where, remedy = (own.what, own.advice) if own else (stalled, advice)
            return Cause(f"{count} {what} in a row ({1e3 * count * dt_s:.0f} ms) shortly before: {where}", remedy)
    return None


def stall_of_this_computer(log: Signals, first: int, last: int, dt_s: float) -> Cause | None:
    """Return the cause that the loop itself woke up late in the steps `first` to `last`, None if it was punctual."""
    if last >= log.late_ns.size:
        return None  # a rig without a log of the clock
    late_s, lost = 1e-9 * log.late_ns[first : last + 1], log.lost[first : last + 1]
    late = int(np.count_nonzero((late_s > LATE * dt_s) | (lost == CAUGHT_UP)))
    if late < max(HOST_SHARE * np.count_nonzero(without_samples(lost)), 1.0):
        return None
    worst = 1e3 * float(late_s.max())
    return Cause(f"this computer stalled ({late} of {late_s.size} steps began late, the worst by {worst:.3g} ms)", HOST)


def _longest(flags: Flags) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _kept(limits: GuardLimits, state: GuardState) -> Flags:
    """Return which channels (c,) kept exactly their code while they should have moved."""
    return (state.moved.min(axis=0) > KEPT * limits.stuck) & (state.same > 1)


def _all_kept(kept: Flags, state: GuardState) -> Cause | None:
    """Return the cause that all channels are stuck: one should have moved, and all stopped at the same time."""
    samples = int(state.same.min())
    if not kept.any() or samples < TOGETHER * int(state.same.max()):
        return None
    return Cause(
        f"all channels kept their values for {samples} samples: the sensors' power, the converter, or the table",
        "check power and converter, amplifier and command cable",
    )


def _compared(info: RigInfo, specimen: Specimen, lead: int, log: Signals, last: int) -> Seen | None:
    """Compare all channels with the identified specimen; None if the signals do not permit it."""
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
    least = BITS * np.array([info.converters.step_v / channel.sensitivity_v_per_unit for channel in info.channels])
    off_measured, off_desired = (_peak((shown - other)[:, latest]) for other in (by_measured, by_desired))
    size = np.maximum(_peak(shown), np.minimum(_peak(by_measured), _peak(by_desired)))
    off = np.maximum(off_measured, off_desired) > OFF * size + least[1:]
    as_desired, as_measured = off & (off_desired < BETTER * off_measured), off & (off_measured < BETTER * off_desired)
    error, now = np.abs(table - desired), max(round(NOW_S / info.dt_s), 1)
    astray = error[latest].max() > OFF * np.maximum(_peak(table), _peak(desired)) + least[0]
    parted = error[-now:].max() > MORE * error[:-now].max(initial=0.0) + least[0]
    alone = off & ~as_desired & ~as_measured
    return Seen(alone, bool(as_desired.any()), bool(as_measured.any()), bool(astray), bool(parted))


def _growing_hz(log: Signals, lead: int, last: int, dt_s: float) -> float:
    """Return the frequency in Hz of a tracking error that oscillates evenly and grows up to the stop; 0 without one."""
    first = max(last + 1 - round(WINDOW_S / dt_s), lead)
    if log.desired.ndim < 2 or last <= first:
        return 0.0
    error = log.desired[0, first - lead : last + 1 - lead] - log.corrected[0, first : last + 1]
    crossings = np.flatnonzero(np.diff(np.signbit(error))) + 1
    fewest, most = HALF_CYCLES
    if crossings.size <= fewest or not np.isfinite(error).all():
        return 0.0
    ends = crossings[-most - 1 :]
    lengths, sizes = np.diff(ends), np.maximum.reduceat(np.abs(error), ends)[:-1]  # of whole half cycles
    first_third, middle, last_third = (float(part.mean()) for part in np.array_split(sizes, 3))
    grows = first_third < middle < last_third and last_third > GROWTH * first_third
    return float(0.5 / (dt_s * lengths.mean())) if grows and lengths.std() < UNEVEN * lengths.mean() else 0.0


def _moved_fast(info: RigInfo, log: Signals, last: int) -> bool:
    """Return whether the commands sent shortly before exceeded FAST of the velocity limit."""
    passed = log.command_v[max(last - round(LATEST_S / info.dt_s), 0) : last]
    fastest = np.abs(np.diff(passed)).max(initial=0.0) * info.gain_m_per_v / info.dt_s
    return bool(fastest > FAST * info.limits.velocity_m_s)


def _or_too_fast(cause: Cause) -> Cause:
    return Cause(f"the motion asked for is too fast for the table, or {cause.what}", cause.advice)


def _either(table: str) -> Cause:
    return Cause(f"the table does not follow, or the sensor of channel {table} is wrong", CHECK_EITHER, of_table=True)


def _singled_out(kept: Flags, state: GuardState, log: Signals, last: int, dt_s: float) -> int:
    """Return the channel that alone kept its code while it missed much of its motion, or that was the first to jump
    from one sample to the next as no floor can; NO_CHANNEL without one."""
    rows = log.corrected[:, max(last - round(WINDOW_S / dt_s), 0) : last + 1]
    latest = max(round(LATEST_S / dt_s), 1)
    if rows.shape[1] < 3 * latest or not np.isfinite(rows).all():
        return g.NO_CHANNEL
    size, steps = _peak(rows), np.abs(np.diff(rows))
    frozen = np.flatnonzero(kept & (state.moved.min(axis=0) > OFF * size))
    if frozen.size == 1:
        return int(frozen[0])
    least = np.maximum(JUMP * _peak(steps[:, :-latest]), JUMPED * _peak(rows[:, :-latest]))
    jumped = steps[:, -latest:] > least[:, None]
    begun = np.where(jumped.any(axis=1), jumped.argmax(axis=1), latest)
    first = np.flatnonzero(begun == begun.min())
    return int(first[0]) if first.size == 1 else g.NO_CHANNEL


def _named(names: list[str], seen: Seen, kept: Flags, stuck: int, of_table: bool, one: int) -> Cause | None:
    """Return the cause that fits the comparison, None if no channel stands out.

    `kept` (c,): channels that kept their code; `stuck`: channel that the guard found stuck; `of_table`: whether the
    violated limit may concern the table or its sensor; `one`: the channel of several that `_singled_out` found.
    """
    table = names[0]
    own = [name for c, name in enumerate(names[1:]) if seen.alone[c] or c + 1 == stuck]
    beside = bool(seen.astray and own and (of_table or (len(own) > 1 and seen.alone.all())))
    wrong = [table] * (seen.as_desired or beside or stuck == 0) + own
    # three channels or more may have failed together, one after the other: then none of them is singled out
    alone = one != g.NO_CHANNEL and names[one] in wrong and len(wrong) <= 2
    if alone:
        wrong, own = [names[one]], [names[one]] if one else []
    still = " (its value does not change)" if len(wrong) == 1 and kept[names.index(wrong[0])] else ""
    if own and seen.as_measured and not alone:
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
    """Return the group of parts that may have failed if no channel stands out, None if there is no such group.

    A command beyond its limits may be the response to a table that has just left its desired motion.
    """
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
