"""The reason named first is the part that failed, or a group that contains it (benchmarks/fault_reasons.py)."""

from __future__ import annotations

import re
from dataclasses import fields, replace

import faulty
import numpy as np
import pytest
from freezing import HOLDS, freezing_of, told
from portfolio import parametrize_first
from told_causes import FAILED, LINK, MOTION, TABLE, TABLE_SENSOR, verdict

from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.guard import ACCELERATION, ENERGY, LOST, SATURATED, STUCK, TRACKING, VELOCITY, fresh_guard
from rths_cli.loop.lost_samples import NO_ANSWER
from rths_cli.loop.run_log import Log, Signals, Sizes

LOOSE = replace(faulty.bench_info(), limits=replace(faulty.bench_info().limits, tracking_error_m_s2=np.inf))


@pytest.mark.campaign
@parametrize_first(
    3,
    ("kind", "said"),
    [
        (
            "table sensor sign flipped",
            "channel channel_0 does not show the motion that the floors show: its sensor",
        ),
        ("first floor sign flipped", "channel channel_1 does not fit the others: its sensor, or the specimen"),
        (
            "floor sensor unplugged",
            "channel channel_2 does not fit the others: its sensor (its value does not change)",
        ),
        ("all sensors stuck", "all channels kept their values for"),
        (
            "floors swapped",
            "channels channel_1 and channel_2 do not fit each other: their sensors, or the specimen",
        ),
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


@pytest.mark.campaign
def test_a_fault_of_this_sample_leaves_table_and_sensor_apart() -> None:
    ended = faulty.performed("offset jumps", 2)
    assert ended.taken_over == ended.at
    assert ended.sentence.startswith("the table does not follow, or the sensor of channel channel_0 is wrong: tracking")


@pytest.mark.campaign
def test_an_energy_limit_without_evidence_names_the_group_that_contains_the_sensor() -> None:
    ended = faulty.performed("sensitivity halved", 107, LOOSE, 2.0)
    assert ended.reason == ENERGY
    assert ended.sentence.startswith(
        "the table does not follow, or the sensor of channel channel_0 is wrong: the table"
    )
    assert verdict({TABLE_SENSOR}, ended.sentence) == "group"


def test_a_motion_that_is_too_fast_for_the_table_is_named_beside_the_table() -> None:
    ended = faulty.performed("motion ten times too large", 108, None, 0.3)
    assert ended.reason == TRACKING
    assert verdict({MOTION}, ended.sentence) == "group"


def test_channels_that_stopped_together_are_named_together_where_only_one_had_to_move() -> None:
    state = fresh_guard(3)
    state.flags[1:3], state.same[:], state.moved[..., 0] = (STUCK, 0), (310, 300, 305), 1.0
    info, steps = faulty.bench_info(), np.zeros((3, 400))
    none = {part.name: np.zeros(0) for part in fields(Signals)}
    log = Signals(**{**none, "corrected": steps, "command_v": steps[0], "lost": steps[0]})
    cause = cause_of(info, faulty.blocks(), faulty.guard_of(info), state, log)
    assert cause is not None
    assert cause.what.startswith("all channels kept their values for 300 samples")
    state.same[1] = 30
    assert "all channels" not in str(cause_of(info, faulty.blocks(), faulty.guard_of(info), state, log))


@pytest.mark.campaign
def test_a_target_that_froze_is_named_before_the_limit_that_its_jump_reaches() -> None:
    """34 ms at 0.14 m/s: the table jumps by 5 mm, beyond 45 m/s^2."""
    laboratory = freezing_of(3_600, 500)
    at = 500 + 1_081  # where the table moves fastest
    run, _ = laboratory.run(np.array([at]), 25, HOLDS)
    assert run.guard.flags[1] in (ACCELERATION, SATURATED, VELOCITY)
    assert told(run).startswith(
        "25 answers of the rig were lost in a row (50 ms) shortly before: the target or the link"
    )
    assert verdict({LINK}, told(run)) in ("true", "group")


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        ("first floor sign flipped", "channel channel_1 does not fit the others"),
        ("table sensor sign flipped", "channel channel_0 does not show the motion that the floors show"),
        ("actuator weak", "the table does not move as desired"),
    ],
)
def test_a_fault_shortly_after_two_lost_answers_is_named_beside_the_stall(
    kind: str, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _two_lost_answers(monkeypatch)
    sentence = faulty.performed(kind, 1, LOOSE).sentence
    assert sentence.startswith("2 answers of the rig were lost in a row"), sentence
    assert f"the target or the link stalled, or {named}" in sentence


def test_a_link_that_loses_samples_while_this_computer_is_late_is_told_so() -> None:
    info, state = faulty.bench_info(), fresh_guard(3)
    state.flags[1], state.flags[3] = LOST, 399
    none = {part.name: np.zeros(0) for part in fields(Signals)}
    late_ns, lost = np.zeros(400), np.zeros(400)
    lost[330:] = NO_ANSWER
    log = Signals(**{**none, "corrected": np.zeros((3, 400)), "lost": lost, "late_ns": late_ns})
    guard = faulty.guard_of(info)
    late_ns[340] = 0.6e9 * info.dt_s  # one late step does not lose 70 answers
    assert cause_of(info, faulty.blocks(), guard, state, log) is None
    late_ns[330:338] = 12e6
    cause = cause_of(info, faulty.blocks(), guard, state, log)
    assert cause is not None and cause.what.startswith("this computer stalled (9 of "), cause
    assert cause.what.endswith("steps began late, the worst by 12 ms)")
    assert "raise limits.lost_samples" in cause.advice


@pytest.mark.parametrize(("rate", "hz", "told"), [(12.0, 80.0, True), (0.0, 80.0, False), (-12.0, 80.0, False)])
def test_an_oscillation_that_grows_in_the_loop_is_told_with_its_frequency(rate: float, hz: float, told: bool) -> None:
    """A table that oscillates at 80 Hz, by 8 % more in each half cycle, beside a desired motion of 2 Hz."""
    info, state, noise = faulty.bench_info(), fresh_guard(3), np.random.default_rng(5).standard_normal(400)
    state.flags[1], state.flags[3] = TRACKING, 399
    time = info.dt_s * np.arange(400)
    desired, corrected = np.zeros((3, 400)), np.zeros((3, 400))
    desired[0] = 0.2 * np.sin(4.0 * np.pi * time)
    corrected[0] = desired[0] + np.exp(rate * (time - 0.2)) * 0.3 * np.sin(2.0 * np.pi * hz * time) + 3e-3 * noise
    none = {part.name: np.zeros(0) for part in fields(Signals)}
    log = Signals(**{**none, "desired": desired, "corrected": corrected, "command_v": time, "lost": 0.0 * time})
    unknown = replace(faulty.blocks(), specimen=None)
    assert unknown.lead_samples < 3  # by which the desired motion of the log is early
    cause = cause_of(info, unknown, faulty.guard_of(info), state, log)
    assert cause is not None
    found = re.match(r"an oscillation of ([\d.]+) Hz grows in the loop of table and controller", cause.what)
    assert (found is not None) == told, cause
    assert found is None or float(found[1]) == pytest.approx(hz, rel=0.02)


def test_a_sensor_that_kept_its_code_for_half_a_second_is_no_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    _two_lost_answers(monkeypatch)
    stuck = faulty.performed("table sensor stuck", 1, LOOSE)
    assert stuck.reason == STUCK
    assert verdict(FAILED["table sensor stuck"], stuck.sentence) != "false"
    assert "lost" not in stuck.sentence


def _two_lost_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every log say that two answers in a row were lost, 20 times a second; the channels are as they were."""
    read = faulty.signals

    def marked(log: Log, sizes: Sizes) -> Signals:
        named = read(log, sizes)
        named.lost[::50], named.lost[1::50] = NO_ANSWER, NO_ANSWER
        return named

    monkeypatch.setattr(faulty, "signals", marked)
