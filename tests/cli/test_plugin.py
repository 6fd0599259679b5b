"""`rths plugin test`: the verdict first, each clause of the contract, and no hardware is moved."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from slow_table import slow_table

from rths_cli.case import plugin_interface
from rths_cli.cli import entry_point
from rths_cli.laboratory import plugin

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rths(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Call:
    """Return the command line in a process in which the example of a rig package is installed."""
    slow_table(monkeypatch)
    monkeypatch.setattr(plugin, "entry_points", lambda group: plugin_interface.entry_points(group))
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["rths", *words])
        code = entry_point.run_to_exit_code()
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    return call


def installed(monkeypatch: pytest.MonkeyPatch, make: Any) -> None:
    """Install a package with one rig."""
    module = ModuleType("shaker_package")
    module.make, module.RTHS_INTERFACE = make, 2  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "shaker_package", module)
    points = {"rths.rigs": [EntryPoint("shaker", "shaker_package:make", "rths.rigs")]}
    monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points.get(group, []))


def test_the_example_keeps_the_contract_and_the_verdict_stands_first(rths: Call) -> None:
    code, out, _ = rths("plugin", "test", "slow_table")
    assert code == 0 and out.startswith("verdict                 slow_table keeps the contract: slow_table\n")
    assert out.count("  kept") == 7 and "broken" not in out and "interface 2 of rths.rigs" in out
    quiet = rths("plugin", "test", "rths_slow_table", "--quiet")
    assert quiet == (0, "rths_slow_table keeps the contract: slow_table\n", "")


def test_a_rig_file_gives_its_limits_and_options(rths: Call) -> None:
    code, out, _ = rths("plugin", "test", "slow_table", "--rig", "plugin_example", "--json")
    found = json.loads(out)
    assert code == 0 and found["kept"] and found["exit_code"] == 0
    (plugin,) = found["plugins"]
    assert (plugin["name"], plugin["group"], plugin["interface"]) == ("slow_table", "rths.rigs", 2)
    assert all(one["kept"] and not one["fault"] for one in plugin["clauses"])


def test_what_is_broken_is_named(rths: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    import rths_slow_table

    class Late(rths_slow_table.SlowTable):  # type: ignore[misc]
        def exchange(self, command_v: float) -> Any:
            before = self._samples.copy()
            super().exchange(command_v)
            return before

    installed(monkeypatch, lambda info, options: Late(info, 0.02))
    code, out, _ = rths("plugin", "test", "shaker")
    shown = " ".join(out.split())
    assert code == 1 and shown.startswith("verdict shaker breaks the contract: shaker")
    assert (
        "broken the declared latency is true: the first sample that a command changes shows a latency of 2, not 1"
        in shown
    )


def test_hardware_is_not_moved(rths: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    import rths_slow_table

    class Real(rths_slow_table.SlowTable):  # type: ignore[misc]
        def __init__(self, info: Any) -> None:
            super().__init__(info, 0.02)
            self.info = info

        def arm(self) -> Any:
            raise AssertionError("the table of a laboratory was armed")

    installed(monkeypatch, lambda info, options: Real(info))
    code, out, err = rths("plugin", "test", "shaker")
    assert code == 2 and not out and "states that hardware is behind it, which the contract would move" in err


def test_names_that_nothing_has_are_refused_with_those_that_are_there(rths: Call) -> None:
    code, _, err = rths("plugin", "test", "nobody")
    assert code == 2 and "nobody: no package of that name is installed" in err and "installed: slow_table" in err
    code, _, err = rths("plugin", "test", "numpy")
    assert code == 2 and "numpy: names nothing in the entry point groups rths.rigs, rths.laws, rths.compensators" in err
    code, _, err = rths("plugin", "test", "slow_table", "--rig", "aps400_virtual")
    assert code == 2 and "its kind is virtual, which no package brings" in err


def test_a_package_that_cannot_be_loaded_breaks_the_contract(rths: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch, None)
    code, out, _ = rths("plugin", "test", "shaker")
    assert code == 1 and "names no function that makes a rig" in " ".join(out.split())


LAW = "def command(p, state, next_state, desired, measured, sent):\n    "
BOUND_UP = f"STATES = 1\n{LAW}next_state[0] = state[0] + desired[2]\n    return min(max(state[0], -9.0), 9.0)\n"


def test_a_new_compensator_keeps_the_contract_as_it_is_written(rths: Call, tmp_path: Path) -> None:
    code, out, _ = rths("new", "compensator", "mine.py")
    assert code == 0 and out == "wrote mine.py and test_mine.py; try: rths plugin test mine.py\n"
    code, out, _ = rths("plugin", "test", "mine.py", "--json")
    (found,) = json.loads(out)["plugins"]
    assert code == 0 and found["group"] == "rths.compensators" and len(found["clauses"]) == 7
    tested = {"__name__": "test_mine"}
    sys.modules.pop("mine", None)
    sys.path.insert(0, str(tmp_path))
    try:
        exec((tmp_path / "test_mine.py").read_text(), tested)
        tested["test_a_ramp_is_led_by_the_delay"]()  # type: ignore[operator]
    finally:
        sys.path.remove(str(tmp_path))
        sys.modules.pop("mine", None)
    assert rths("new", "compensator", "mine.py")[0] == 2
    code, _, err = rths("new", "compensator")
    assert code == 2 and "give one file: rths new compensator FILE" in err
    code, _, err = rths("new", "compensator", "other.txt")
    assert code == 2 and "must be the name of a Python module" in err and not (tmp_path / "other.txt").exists()


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f"STATES = 1\n{LAW}next_state[0] = 1.01 * state[0] + desired[2]\n    return state[0]\n", "radius is 1.01"),
        (BOUND_UP, "behind a motion beyond the range it does not stay wound up: 5 s after"),
        (f"{LAW}return 1.0\n", "at rest (state and inputs zero) command and next_state must be 0"),
        pytest.param(
            f"{LAW}return abs(desired[2]) + 0 * sum(list(range(20000)))\n", "us in Python, at most 100 us",
            marks=pytest.mark.campaign,
        ),
        (f"{LAW}return 2 * desired[2] + abs(desired[2])\ndef linear(p, dt_s):\n    return [], [], [], [[0, 0, 2]]\n",
         "agrees with the code for small motions: they differ by"),
        ("x = 1\n", "has no function command, no class Compensator"),
    ],
)  # fmt: skip
def test_what_a_compensator_breaks_is_named(rths: Call, tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "law.py").write_text(text)
    code, out, _ = rths("plugin", "test", "law.py")
    shown = " ".join(out.split())
    assert code == 1 and shown.startswith("verdict law.py breaks the contract: law.py") and sentence in shown
