"""The reason named first is the part that failed, or a group that contains it (benchmarks/fault_reasons.py)."""

from __future__ import annotations

from dataclasses import replace

import faulty
import numpy as np
import pytest
from freezing import HOLDS, freezing_of, told
from told_causes import FAILED, LINK, TABLE, verdict

from rths_cli.loop.guard import ACCELERATION, SATURATED, VELOCITY

LOOSE = replace(faulty.bench_info(), limits=replace(faulty.bench_info().limits, tracking_error_m_s2=np.inf))


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("table sensor sign flipped", "channel channel_0 does not show the motion that the floors show: its sensor"),
        ("first floor sign flipped", "channel channel_1 does not fit the others: its sensor, or the specimen"),
        ("floor sensor unplugged", "channel channel_2 does not fit the others: its sensor (its value does not change)"),
        ("all sensors stuck", "all channels kept their values for"),
        ("floors swapped", "channels channel_1 and channel_2 do not fit each other: their sensors, or the specimen"),
        ("actuator weak", "the table does not move as desired, or all sensors are wrong alike"),
        ("all signs flipped", "channels channel_0, channel_1 and channel_2 do not fit each other: their sensors"),
        ("motion ten times too large", "velocity (estimated from the command) beyond its limit"),
    ],
)
def test_without_a_limit_on_the_tracking_error_the_cause_is_named_all_the_same(kind: str, said: str) -> None:
    ended = faulty.performed(kind, 1, LOOSE)
    assert ended.sentence.startswith(said), ended.sentence
    assert verdict(FAILED[kind], ended.sentence) != "false"
    assert ("lower scaling" in ended.sentence) == (TABLE in FAILED[kind] or said[:5] in ("veloc", "the t"))


def test_a_fault_of_this_sample_leaves_table_and_sensor_apart() -> None:
    ended = faulty.performed("offset jumps", 2)
    assert ended.taken_over == ended.at
    assert ended.sentence.startswith("the table does not follow, or the sensor of channel channel_0 is wrong: tracking")


def test_a_target_that_froze_is_named_before_the_limit_that_its_jump_reaches() -> None:
    """34 ms at 0.14 m/s: the table jumps by 5 mm, beyond 45 m/s^2."""
    laboratory = freezing_of(3_600, 500)
    at = 500 + 1_081  # where the table moves fastest
    run, _ = laboratory.run(np.array([at]), 25, HOLDS)
    assert run.guard.flags[1] in (ACCELERATION, SATURATED, VELOCITY)
    assert told(run).startswith(
        "25 answers of the rig were lost in a row (50 ms) shortly before: the target or the link"
    )
    assert verdict({LINK}, told(run)) == "true"
