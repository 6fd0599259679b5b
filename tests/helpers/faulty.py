"""Play runs with faults of every kind at random instants, and judge them by what the table was given and did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from faulty_rig import DT_S, RAMP_S, RECORD, FaultyRig, Play, bench_info, blocks, guard_of, plant, shaken
from loop_faults import DRIVES, EVENTS, KINDS, SENSORS, TABLES, WIRES

from rths_cli.loop import guard as g
from rths_cli.loop import realtime_run
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.realtime_run import Performance
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

__all__ = ["KINDS", "FaultyRig", "bench_info", "blocks", "guard_of", "shaken"]

REST_S = 2.0
PLACE_AT_REST_M, VELOCITY_AT_REST_M_S = 2e-3, 0.02  # a specimen that still swings moves the table by less


@dataclass(frozen=True)
class Ended:
    """How a faulty run ended: guard's reason, the rig's fault, and what the table was given and did."""

    reason: int
    fault: str
    phase: int
    at: int
    rested: int
    commands_v: Array
    place_m: float
    velocity_m_s: float
    taken_over: int  # steps that passed the guard
    sentence: str  # what is told of the guard's reason, empty where there is none


def performed(name: str, seed: int, info: RigInfo | None = None, amplitude: float = 1.0) -> Ended:
    """Run with one kind of fault at a random instant, on the usual bench or with other limits or a larger motion."""
    info, random = info or bench_info(), np.random.default_rng((seed, *name.encode()))
    rig, orders = FaultyRig(info), np.zeros(1, dtype=np.int64)
    ramp = round(RAMP_S / DT_S)
    at = int(random.integers(ramp + 200, ramp + RECORD - 900))
    play = Play(at, random, rig, orders, amplitude * shaken())
    _spoil(name, play)
    run = realtime_run.prepare(info, blocks(), NUMERICAL, play.drive, guard_of(info), None, orders, RAMP_S)
    fault = realtime_run.perform(rig, run)
    return ended(rig, run, fault, play.at)


def ended(rig: FaultyRig, run: Performance, fault: str, at: int) -> Ended:
    """Return how a run went."""
    flags, state = run.guard.flags, rig.inner.state.state
    log = signals(run.log, sizes_of(run.step))
    cause = cause_of(run.info, run.blocks, run.limits, run.guard, log)
    return Ended(
        int(flags[1]), fault, int(flags[0]), at, rig.rested, np.array(rig.commands), float(state[0]), float(state[1]),
        int(flags[3]), reason_of(run.info, run.limits, run.guard, NUMERICAL, cause),
    )  # fmt: skip


def _spoil(name: str, play: Play) -> None:
    rig = play.rig
    if name in SENSORS:
        rig.sensors = lambda k, samples: SENSORS[name][0](play, k, samples)
    if name in WIRES:
        rig.wire = lambda k, command: WIRES[name][0](play, k, command)
    if name in EVENTS:
        rig.event = lambda k: EVENTS[name][0](play, k)
    if name in DRIVES:
        play.at -= round(RAMP_S / DT_S)
        DRIVES[name][0](play)
        play.at += round(RAMP_S / DT_S)
    if name in TABLES:
        worn = plant(**TABLES[name][0])

        def change(k: int) -> None:
            if k == play.at:
                rig.inner.wear(worn)

        rig.event = change


def beyond_limits(info: RigInfo, commands_v: Array) -> list[str]:
    """Return a sentence for each limit that a series of commands breaks, seen from the table at rest at 0 V."""
    series = np.concatenate([[0.0], commands_v])
    place = info.gain_m_per_v * series
    share = {
        "stroke": np.abs(place).max() / info.limits.stroke_m,
        "range": np.abs(series).max() / info.converters.range_v,
        "velocity": np.abs(np.diff(place)).max() / info.dt_s / info.limits.velocity_m_s,
        "rate": np.abs(np.diff(series)).max() / info.dt_s / info.limits.command_rate_v_s,
    }
    told = [] if np.isfinite(series).all() else ["a command is not a number"]
    return told + [f"{name} {used:.6f} of its limit" for name, used in share.items() if not used <= 1.0 + 1e-9]


def judged(name: str, ended: Ended) -> list[str]:
    """Return a sentence for everything that is wrong with how a run with this fault ended."""
    told = beyond_limits(bench_info(), ended.commands_v)
    if ended.reason not in KINDS[name]:
        told.append(f"the reason is {g.REASONS[ended.reason] or 'none'!r}")
    if ended.rested < 1:
        told.append("the rig was never asked to rest")
    return told + ([] if ended.fault else _unrest(name, ended))


def _unrest(name: str, ended: Ended) -> list[str]:
    """Return why a table that the loop led to rest is not at rest; one that does not obey is judged by its command."""
    told = []
    if ended.phase != g.STOPPED or ended.commands_v[-1] != 0.0:
        told.append(f"the last command is {ended.commands_v[-1]:g} V, not at zero")
    if (took := DT_S * (len(ended.commands_v) - ended.taken_over)) > REST_S:
        told.append(f"the way to zero took {took:.2f} s")
    obeys = name not in WIRES and name not in TABLES
    if obeys and abs(ended.place_m) > PLACE_AT_REST_M:
        told.append(f"the table is still at {1e3 * ended.place_m:.2f} mm")
    if abs(ended.velocity_m_s) > VELOCITY_AT_REST_M_S:
        told.append(f"the table still moves at {1e3 * ended.velocity_m_s:.1f} mm/s")
    return told
