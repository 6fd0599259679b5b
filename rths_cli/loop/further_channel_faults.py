"""After a stop: which displacement sensor or load cell did not show what it must, and in what way."""

from __future__ import annotations

import numpy as np

from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.run_log import Signals
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

WINDOW_S, LATEST_S = 2.0, 0.3  # time before the stop that is compared; its end, in which the fault must show
TRIED_S = (0.3, 0.2, 0.1, 0.06, 0.03, 0.0)  # times before the stop over which an explanation is tried, the longest
# first: all look alike over a short one, but a fault may be young (0: two samples)
EXPLAINED = 0.3  # of the difference, that an explanation may leave
FREER = 0.05  # the same more for a factor, which explains a reversed sign as well
BITS, MOVED_BITS = 3.0, 10.0  # within which a value counts as unchanged; by which it must have changed then
FOLLOWS = 0.3  # error over desired acceleration, below which the table follows
RECENT_S = 0.5  # time before the stop over which the gain is taken, for it may drift
GAIN_CHANGED = 0.03  # change of the table's gain that is worth telling


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
        latest = slice(-max(round(LATEST_S / info.dt_s), 2), None)
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
    recent = slice(-max(round(RECENT_S / info.dt_s), 2), None)
    shown, must = (_low_passed(row, info.dt_s)[recent] for row in pair)
    return float(shown @ must / (must @ must))


def table_follows(info: RigInfo, log: Signals, last: int, lead: int) -> bool | None:
    """Return whether the table's accelerometer shows the desired motion; None where nothing is desired."""
    first = max(last - round(WINDOW_S / info.dt_s), lead)
    rows = slice(first, last + 1)
    if last - first < 2 or not log.desired.size:
        return None
    desired, measured = log.desired[0, first - lead : last + 1 - lead], log.corrected[0, rows]
    if not (np.isfinite(desired).all() and np.isfinite(measured).all()) or not desired.any():
        return None
    return bool(_rms(measured - desired) < FOLLOWS * _rms(desired))


def _pair(info: RigInfo, limits: GuardLimits, log: Signals, last: int, j: int) -> tuple[Array, Array] | None:
    """Return what a further channel showed before a stop, and what it must show, (n,) each; None if that is unknown."""
    duty, rows = limits.further.duty[j], slice(max(last + 1 - round(WINDOW_S / info.dt_s), 0), last + 1)
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
    if any(np.ptp(shown[latest]) <= BITS * bit and np.ptp(must[latest]) > MOVED_BITS * bit for latest in windows[:-1]):
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
