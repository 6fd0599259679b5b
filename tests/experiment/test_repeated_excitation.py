"""An excitation that a stalled computer ended is played again, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.experiment import identify_on_rig
from rths_cli.experiment.identify_on_rig import MOST_PLAYED, SamplesLost, measure
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.findings import stated
from rths_cli.loop import simulated_time_run
from rths_cli.loop.guard import LOST, VELOCITY


def setup_of() -> Setup:
    settings = ["identification.duration_s=40", "sample_rate_hz=1000"]
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


def stopping(monkeypatch: pytest.MonkeyPatch, ends: list[int]) -> list[int]:
    """Let excitations end for these reasons of the guard, 0 to their end; return the lengths that are played."""
    played: list[int] = []
    play = simulated_time_run.play

    def ended(*given: object) -> object:
        outcome = play(*given)  # type: ignore[arg-type]
        played.append(len(outcome.log.command_v))
        reason = ends[len(played) - 1] if len(played) <= len(ends) else 0
        return replace(outcome, reason=reason, stop=stated("lost") if reason else outcome.stop)

    monkeypatch.setattr(identify_on_rig, "play", ended)
    return played


def test_the_lost_record_alone_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = stopping(monkeypatch, [])
    expected, said = measure(setup_of(), lambda _: None), list[str]()
    played = stopping(monkeypatch, [0, LOST, LOST])
    again = measure(setup_of(), said.append)
    assert played == [whole[0], whole[1], whole[1], whole[1]]  # the probe once
    assert np.array_equal(again.records[0].accel_m_s2, expected.records[0].accel_m_s2)
    assert [text.rpartition(", ")[2] for text in said if text.endswith("3")] == ["attempt 2 of 3", "attempt 3 of 3"]


@pytest.mark.campaign
def test_it_is_not_repeated_for_ever_nor_for_another_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    played = stopping(monkeypatch, [LOST] * 9)
    with pytest.raises(SamplesLost, match=f"{MOST_PLAYED} attempts ended so"):
        measure(setup_of(), lambda _: None)
    assert len(played) == MOST_PLAYED
    played = stopping(monkeypatch, [VELOCITY])
    with pytest.raises(identify_on_rig.LimitError, match=r"lost; lower identification\.accel_rms"):
        measure(setup_of(), lambda _: None)
    assert len(played) == 1
