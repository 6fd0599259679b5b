"""The silent rehearsal before a run: which delays of its steps refuse a rate, and in which words."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like

from rths_cli.control.compensator import CalledLaw
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.python_parts import PythonFeedforward
from rths_cli.errors import InputError
from rths_cli.experiment import real_rig_readiness
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.compiled import entry
from rths_cli.numerics.user_functions import Callback, call
from rths_cli.rigs.description import capabilities_of

DT_S, STEPS = 1e-3, 2000


def rehearsed(
    monkeypatch: pytest.MonkeyPatch, late: dict[float, int], took_s: float, kind: str = "udp", overrun: str = "skip",
    blocks: Blocks | None = None, watchdog_s: float = 0.1,
) -> None:  # fmt: skip
    """Judge a rehearsal in which so many steps began so late, in s, all others in time."""
    late_s = np.concatenate([np.zeros(0), *(np.full(count, value) for value, count in late.items())])
    late_s = np.concatenate([late_s, np.zeros(STEPS - late_s.size)])
    monkeypatch.setattr(real_rig_readiness, "prepare", lambda *given: None)
    monkeypatch.setattr(real_rig_readiness, "guard_limits", lambda setup: None)
    monkeypatch.setattr(real_rig_readiness, "rehearse_watched", lambda run, seconds: (late_s, np.full(STEPS, took_s)))
    info = SimpleNamespace(dt_s=DT_S, kind=kind, can=capabilities_of(kind), overrun=overrun, watchdog_s=watchdog_s)
    info.name = "a rig"
    setup: Any = SimpleNamespace(rig=info)
    real_rig_readiness.rehearsed(setup, blocks or best_like(rig_info()), NUMERICAL)


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


def test_a_part_in_python_needs_a_watchdog_and_must_not_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """An object that hangs is ended by the target alone."""

    def fails() -> None:
        raise ValueError("no licence")

    part: PythonFeedforward = PythonFeedforward("a model", fails)  # type: ignore[arg-type]
    blocks = replace(best_like(rig_info()), feedforward=part)
    rehearsed(monkeypatch, {}, 20e-6, blocks=blocks)
    with pytest.raises(InputError, match="a model is a Python object, which may hang, and rig a rig has no watchdog"):
        rehearsed(monkeypatch, {}, 20e-6, blocks=blocks, watchdog_s=0.0)
    failed = Callback(fails)
    call_once(failed.address)
    part.callbacks.append((failed,))
    with pytest.raises(InputError, match="in the rehearsal, a model failed: ValueError: no licence"):
        rehearsed(monkeypatch, {}, 20e-6, blocks=blocks)


def test_a_slow_compensator_in_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fifth of the interval of 1 ms is 200 us."""

    def law(seconds: float) -> Blocks:
        def command(motion: object, measured: object, sent: object) -> np.ndarray:
            time.sleep(seconds)
            return np.zeros(1)

        made = CalledLaw("law.py", lambda: SimpleNamespace(command=command))
        return replace(best_like(rig_info()), feedforward=made)

    rehearsed(monkeypatch, {}, 20e-6, blocks=law(0.0))
    with pytest.raises(
        InputError, match=r"controller: law\.py takes .* us per step in Python, at most 200 us at 1000 Hz"
    ):
        rehearsed(monkeypatch, {}, 20e-6, blocks=law(3e-4))
    with pytest.raises(InputError, match=r"controller: law\.py is a Python object, which may hang"):
        rehearsed(monkeypatch, {}, 20e-6, blocks=law(0.0), watchdog_s=0.0)


@entry
def call_once(address: int) -> int:
    return call(address)
