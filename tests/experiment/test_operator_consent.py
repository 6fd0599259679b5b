"""A real table moves only when somebody said that it may."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.real_rig_readiness import AtRest, ask_to_move, channel_faults
from rths_cli.experiment.setup import make_setup
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.quantities import Interval
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo


def rig_info() -> RigInfo:
    g = STANDARD_GRAVITY_M_S2
    channels = tuple(Channel(f"channel_{i}", 1.0 / g, 5.0 * g, 0.024, 1549.0) for i in range(3))
    limits = Limits(0.079, 1.0, 45.0, 445.0)
    return RigInfo("lab", "udp", 5e-4, channels, Converters(16, 10.0), 1, limits, 0.0079, 7.0, 13.86)


def setups(**about: object) -> list[SimpleNamespace]:
    rig: RigInfo = replace(rig_info(), **({"kind": "udp", "name": "lab"} | about))  # type: ignore[arg-type]
    case = SimpleNamespace(
        name="demo", scaling=0.3, table=SimpleNamespace(kind="udp"), record=SimpleNamespace(name="el_centro")
    )
    motion = SimpleNamespace(time_s=np.array([0.0, 20.0, 40.0]), accel_m_s2=np.array([0.0, -1.234, 1.0]))
    return [SimpleNamespace(rig=rig, case=case, motion=motion)]


class Person:
    """Somebody at the terminal, who remembers what was shown."""

    def __init__(self, answer: bool) -> None:
        self.answer, self.shown = answer, ""

    def __call__(self, lines: Sequence[str]) -> bool:
        self.shown = "\n".join(lines)
        return self.answer


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_rig_readiness.sys, "stdin", SimpleNamespace(isatty=lambda: True))


@pytest.fixture
def undoubted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_rig_readiness, "doubts", lambda setup: ())


def test_a_virtual_rig_asks_nobody() -> None:
    person = Person(False)
    ask_to_move(setups(kind="virtual"), False, person)
    assert person.shown == ""


@pytest.mark.usefixtures("terminal", "undoubted")
def test_a_person_sees_rig_limits_and_checklist_and_may_refuse() -> None:
    person = Person(True)
    ask_to_move(setups(), False, person)
    for told in ("demo", "lab", "79 mm", "1 m/s", "45 m/s^2", "445 N", "2000 Hz", "emergency stop"):
        assert told in person.shown
    assert "demo: record el_centro times 0.3, 40 s, ground 1.23 m/s^2\n" in person.shown
    with pytest.raises(InputError, match="not confirmed; nothing was moved"):
        ask_to_move(setups(), False, Person(False))


@pytest.mark.usefixtures("terminal", "undoubted")
def test_a_person_sees_the_peaks_that_a_check_predicts() -> None:
    peaks = {"displacement_m": 0.0123, "velocity_m_s": 0.25, "acceleration_m_s2": np.array([4.5, 6.5]), "force_n": 81.2}
    figures = {f"check.peak_{path}": value for path, value in peaks.items()}
    person = Person(True)
    ask_to_move(setups(), False, person, lambda setup: figures)
    assert "; predicted peaks of the table 12.3 mm, 0.25 m/s, 6.5 m/s^2, 81.2 N\n" in person.shown
    figures["check.peak_velocity_m_s"] = Interval(0.25, 0.2, 0.31, 0.9)
    ask_to_move(setups(), False, person, lambda setup: figures)
    assert "; predicted peaks of the table 12.3 mm, 0.31 m/s, 6.5 m/s^2, 81.2 N\n" in person.shown  # the largest


@pytest.mark.usefixtures("terminal", "undoubted")
@pytest.mark.usefixtures("undoubted")
def test_yes_answers_for_unattended_rigs_alone() -> None:
    person = Person(False)
    ask_to_move(setups(unattended=True), True, person)
    assert person.shown == ""
    with pytest.raises(InputError, match="rig lab does not say `unattended: true`"):
        ask_to_move([*setups(), *setups(unattended=True, name="other")], True, Person(True))


@pytest.mark.usefixtures("undoubted")
def test_without_a_terminal_nobody_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_rig_readiness.sys, "stdin", SimpleNamespace(isatty=lambda: False))
    person = Person(True)
    with pytest.raises(InputError, match="nobody can be asked here"):
        ask_to_move(setups(unattended=True), False, person)
    assert person.shown == ""


@pytest.mark.parametrize(
    ("zero", "noise", "fault"),
    [
        (0.4, 0.05, ""),
        (0.6, 0.0, "shows 0.6 V at rest, more than 10 % of its range"),
        (-0.6, 0.0, "shows -0.6 V at rest"),
        (0.0, 0.2, "shows 0.2 V rms at rest, more than 2 % of its range"),
        (np.nan, np.nan, "gives no numbers at rest"),
    ],
)
def test_a_channel_that_is_not_at_rest_is_named(zero: float, noise: float, fault: str) -> None:
    """5 g at 1 V per g are a range of 5 V: a tenth is 0.5 V, a fiftieth 0.1 V."""
    found = channel_faults(rig_info(), AtRest(np.array([0.0, zero, 0.0]), np.array([0.0, noise, 0.0])))
    assert [fault in text and "channel channel_1" in text for text in found] == ([True] if fault else [])


@pytest.mark.parametrize("move", ["a person", "--yes"])
def test_a_real_rig_with_a_doubted_number_moves_only_where_the_case_names_it_plausible(
    move: str, terminal: None, tmp_path: Path
) -> None:
    """A force limit in mN switches the guard's off: nobody is asked until it is corrected or called plausible."""
    (tmp_path / "key").write_text("0123456789abcdef" * 2)
    (tmp_path / "key").chmod(0o600)
    rig, person = tmp_path / "rig.yaml", Person(True)
    rig.write_text("extends: udp_example\nlimits: {force_n: 400000}\nunattended: true\nudp: {key_file: key}\n")

    def ask(*settings: str) -> None:
        setup = make_setup(load_cases(["el_centro_low_ff_fb"], (f"table={rig}", *settings))[0])
        ask_to_move([setup], move == "--yes", person)

    with pytest.raises(InputError) as refused:
        ask()
    assert "table.limits.force_n: 400000 N" in refused.value.faults[0] and "400 N would fit" in refused.value.faults[0]
    assert "state plausible: [table.limits.force_n] in the case" in refused.value.faults[-1] and person.shown == ""
    with pytest.raises(InputError, match=r"table\.limits\.force_n"):
        ask("plausible=[table.limits.stroke_m]")  # another number's consent is none
    ask("plausible=[table.limits.force_n]")
    assert ("400000 N" in person.shown) == (move == "a person")
    person.shown = ""
    (tmp_path / "key").unlink()  # is told before anybody is asked and anything is measured
    with pytest.raises(InputError, match=r"key file .* cannot be read"):
        ask("plausible=[table.limits.force_n]")
    assert person.shown == ""
