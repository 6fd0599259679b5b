"""Every kind of fault in a run: no command beyond a limit leaves, the table comes to rest in time, the reason is true.

`benchmarks/faults.py` plays the same kinds at many more random instants, and those of whole processes.
"""

from __future__ import annotations

from dataclasses import replace

import faulty
import numpy as np
import pytest
from faulty import KINDS, Ended, FaultyRig, bench_info, performed

from rths_cli.errors import RigError
from rths_cli.loop import guard as g
from rths_cli.loop import realtime_run
from rths_cli.loop.step_arrays import NUMERICAL


@pytest.fixture(scope="module")
def seen() -> dict[str, Ended]:
    """Hold one run of each kind, at a random instant."""
    return {name: performed(name, 0) for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_a_fault_breaks_no_limit_rests_the_table_and_is_told(seen: dict[str, Ended], name: str) -> None:
    assert faulty.judged(name, seen[name]) == []


def test_the_judge_sees_what_it_must(seen: dict[str, Ended]) -> None:
    """Without these a mistake in the judge would let every fault pass."""
    good = seen["stop key"]
    assert faulty.judged("stop key", good) == []
    count = len(good.commands_v)
    spoilt = {
        "range": np.where(np.arange(count) < 300, good.commands_v, 10.01),
        "stroke": np.where(np.arange(count) < 300, good.commands_v, 10.01),
        "velocity": good.commands_v + 0.2 * (np.arange(count) % 2),
        "rate": good.commands_v + 0.2 * (np.arange(count) % 2),
        "not a number": np.where(np.arange(count) == 300, np.nan, good.commands_v),
        "not at zero": good.commands_v + 0.01,
        "took": np.concatenate([good.commands_v, np.zeros(1500)]),
    }
    for word, commands in spoilt.items():
        told = faulty.judged("stop key", replace(good, commands_v=commands))
        assert any(word in sentence for sentence in told), (word, told)
    for word, other in {
        "reason": replace(good, reason=g.END),
        "still at": replace(good, place_m=3e-3),
        "moves": replace(good, velocity_m_s=0.1),
        "never asked": replace(good, rested=0),
    }.items():
        assert any(word in sentence for sentence in faulty.judged("stop key", other)), word


def test_there_are_forty_kinds_and_some_must_not_stop_the_test() -> None:
    assert len(KINDS) >= 40
    assert sum(reasons == {g.END} for reasons in KINDS.values()) >= 5


def test_what_the_driver_says_comes_after_the_first_reason(seen: dict[str, Ended]) -> None:
    ended = seen["driver fails on the way to rest"]
    assert (ended.reason, ended.fault) == (g.OPERATOR, "rig bench: the amplifier tripped")


def quiet_run() -> tuple[FaultyRig, realtime_run.Performance]:
    info = bench_info()
    orders = np.zeros(1, dtype=np.int64)
    drive = faulty.shaken()[:300].copy()
    return FaultyRig(info), realtime_run.prepare(
        info, faulty.blocks(), NUMERICAL, drive, faulty.guard_of(info), None, orders, 0.05
    )


def test_a_rig_that_refuses_to_rest_is_told_and_the_run_is_kept() -> None:
    rig, run = quiet_run()

    def refuse() -> None:
        raise RigError("rig bench: the brake does not close")

    rig.resting = refuse
    assert realtime_run.perform(rig, run) == "rig bench: the brake does not close"
    assert run.log.done[0] > 350
    assert run.guard.flags[1] == g.END


def test_a_fault_that_is_no_rig_error_rests_the_table_before_it_is_raised() -> None:
    rig, run = quiet_run()

    def crash(k: int) -> None:
        if k == 200:
            raise ZeroDivisionError

    rig.event = crash
    with pytest.raises(ZeroDivisionError):
        realtime_run.perform(rig, run)
    assert rig.rested == 1


def test_an_order_after_the_end_changes_nothing() -> None:
    rig, run = quiet_run()
    whole = performed("one answer lost", 1)
    assert whole.reason == g.END

    def late(k: int) -> None:
        if k == 380:  # the record of 300 steps is over, the table is on its way to zero
            run.course.orders[0] = 2

    rig.event = late
    assert realtime_run.perform(rig, run) == ""
    assert run.guard.flags[1] == g.END
    assert rig.commands[-1] == 0.0
