"""The silent rehearsal before a run: which delays of its steps refuse a rate, and in which words."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.experiment import real_rig_readiness
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.rigs.description import capabilities_of

DT_S, STEPS = 1e-3, 2000


def rehearsed(
    monkeypatch: pytest.MonkeyPatch, late: dict[float, int], took_s: float, kind: str = "udp", overrun: str = "skip"
) -> None:
    """Judge a rehearsal in which so many steps began so late, in s, all others in time."""
    late_s = np.concatenate([np.full(count, value) for value, count in late.items()])
    late_s = np.concatenate([late_s, np.zeros(STEPS - late_s.size)])
    monkeypatch.setattr(real_rig_readiness, "prepare", lambda *given: None)
    monkeypatch.setattr(real_rig_readiness, "guard_limits", lambda setup: None)
    monkeypatch.setattr(real_rig_readiness, "rehearse_watched", lambda run, seconds: (late_s, np.full(STEPS, took_s)))
    setup: Any = SimpleNamespace(rig=SimpleNamespace(dt_s=DT_S, kind=kind, can=capabilities_of(kind), overrun=overrun))
    blocks: Any = None
    real_rig_readiness.rehearsed(setup, blocks, NUMERICAL)


def test_a_rate_is_held_at_the_edges_of_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 % may begin later than an eighth of an interval: their commands do not leave; 0.5 % by a whole one."""
    rehearsed(monkeypatch, {126e-6: 19}, 20e-6)
    rehearsed(monkeypatch, {1000e-6: 10}, 20e-6)
    rehearsed(monkeypatch, {124e-6: STEPS}, 370e-6)


@pytest.mark.parametrize(("kind", "overrun"), [("udp", "hold"), ("udp", "stop"), ("ni", "skip"), ("other", "skip")])
def test_where_late_commands_leave_all_the_same_half_an_interval_will_do(
    monkeypatch: pytest.MonkeyPatch, kind: str, overrun: str
) -> None:
    rehearsed(monkeypatch, {470e-6: 40}, 20e-6, kind, overrun)
    with pytest.raises(InputError, match=r"within 501 us \(at most 500\)"):
        rehearsed(monkeypatch, {501e-6: 40}, 0.0, kind, overrun)


BEGAN, READY = "99 % of the steps began within", "99 % of the steps were ready within"
LATE = "2000 late by a whole interval (at most 10)"


@pytest.mark.parametrize(
    ("late", "took_s", "words"),
    [
        ({126e-6: 40}, 20e-6, f"{BEGAN} 126 us (at most 125), 0 of {LATE}"),
        ({1000e-6: 11}, 20e-6, f"{BEGAN} 0 us (at most 125), 11 of {LATE}"),
        ({124e-6: 40}, 380e-6, f"{READY} 504 us (at most 500), 0 of {LATE}"),
    ],
)
def test_a_rate_that_was_not_held_is_refused_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, late: dict[float, int], took_s: float, words: str
) -> None:
    with pytest.raises(InputError) as refused:
        rehearsed(monkeypatch, late, took_s)
    sentence = str(refused.value)
    assert sentence.startswith("sample_rate_hz: 1000 Hz was not held in a silent rehearsal of 2 s: ")
    assert words in sentence and "rths doctor recommends one" in sentence
