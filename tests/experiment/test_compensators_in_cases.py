"""Compensators named in a case: their faults, what a check judges, and the same commands in every way."""

from __future__ import annotations

import hashlib
import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rths_cli
from rths_cli.case import compensator_schema
from rths_cli.case.case_schema import Case
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.template import compensator_files
from rths_cli.errors import InputError
from rths_cli.experiment.setup import make_setups
from rths_cli.files import user_code

KEYS = {"structure": "three_storey", "damping": "low", "record": "el_centro", "scaling": 0.05}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the compensator that `rths new` writes."""
    monkeypatch.chdir(tmp_path)
    for path, text in compensator_files(tmp_path / "mine.py").items():
        path.write_text(text)
    return tmp_path


def case_with(controller: object, **more: object) -> Case:
    return load_cases([{**KEYS, "controller": controller, **more}])[0]


@pytest.mark.parametrize(
    ("controller", "sentence"),
    [
        ({"kind": "own"}, "controller.file: is missing; add the file of the compensator"),
        ({"kind": "own", "file": "none.py"}, "controller.file: no such file: "),
        ({"kind": "chen", "file": "mine.py"}, "kind chen reads none; remove it"),
        ({"kind": "chen", "sha256": "0"}, "is the checksum of file, which is not given"),
        ({"kind": "own", "file": "mine.py", "sha256": "0"}, "controller.sha256: is not that of mine.py, which is "),
        ({"kind": "state_space", "file": "mine.py", "gain": 1}, "gain: unknown key; kind state_space has no options"),
        ({"kind": "chen", "delay_s": "x"}, "controller.delay_s: must be a number, got 'x'; in s"),
        ({"kind": "chen", "lead_samples": 1.5}, "controller.lead_samples: must be a whole number, got 1.5"),
        ("horuchi", "own or state_space, got 'horuchi'; did you mean horiuchi?"),
        ({"kind": "FF", "delay_s": 1}, "controller.delay_s: unknown key"),
    ],
)
def test_a_wrong_key_is_told_with_its_place(controller: object, sentence: str) -> None:
    with pytest.raises(InputError) as told:
        case_with(controller)
    assert sentence in str(told.value)


def test_method_paper_has_its_own_controllers() -> None:
    with pytest.raises(InputError, match=r"method: paper takes the controllers FF, FF\+FB and none, got chen"):
        case_with("chen", method="paper")


def test_every_wrong_option_is_told_at_once() -> None:
    case = case_with({"kind": "own", "file": "mine.py", "delay": 1, "delay_s": 7})
    with pytest.raises(InputError) as told:
        make_setups([case])
    first, second = told.value.faults
    assert "controller.delay: mine.py has no such option; did you mean delay_s?" in first
    assert "controller.delay_s: must be from 0 to 0.1 (delay of the table in s" in second and ", got 7" in second


def test_a_resolved_case_pins_the_file(folder: Path) -> None:
    case = case_with({"kind": "own", "file": "mine.py", "delay_s": 0.011})
    (folder / "again.yaml").write_text(resolved_yaml(case))
    again = load_cases([folder / "again.yaml"])[0]
    assert again.controller == case.controller and again.controller.options == {"delay_s": 0.011}
    assert again.controller.sha256 == hashlib.sha256((folder / "mine.py").read_bytes()).hexdigest()
    (folder / "mine.py").write_text("# another\n")
    with pytest.raises(InputError, match=r"mine\.py has changed since the case was read; start again"):
        make_setups([case])
    with pytest.raises(InputError, match=r"sha256: is not that of mine\.py"):
        load_cases([folder / "again.yaml"])


def test_a_package_brings_a_compensator(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("our_laws")
    module.__file__ = str(folder / "mine.py")
    exec(compile((folder / "mine.py").read_text(), str(folder / "mine.py"), "exec"), vars(module))
    monkeypatch.setitem(sys.modules, "our_laws", module)
    point = EntryPoint("ours", "our_laws", "rths.compensators")

    def installed(group: str, name: str = "ours") -> list[EntryPoint]:
        return [point] if (group, name) == ("rths.compensators", "ours") else []

    for one in (compensator_schema, user_code):
        monkeypatch.setattr(one, "entry_points", installed)
    case = case_with({"kind": "ours", "delay_s": 0.011})
    (setup,) = make_setups([case])
    assert setup.compensator is not None and setup.compensator.options == {"delay_s": 0.011}
    module.RTHS_INTERFACE = 2  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=r"was written for interface 2 of rths\.compensators, this rths has 1"):
        make_setups([case])


@pytest.mark.campaign
def test_one_law_in_every_way_sends_the_same_commands(folder: Path) -> None:
    """The file, its block from a file and from python-control, and chen send the same bits; so do code in Python and
    compiled code, where a limit that is never reached makes the law one that is not linear."""
    import control

    lag_s, dt_s = 0.011, 5e-4
    record = folder / "short.csv"
    lines = (Path(rths_cli.__file__).parents[1] / "records" / "el_centro.csv").read_text().splitlines()
    record.write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *[x for x in lines if x[0] != "#"][:300]]) + "\n")

    def commands(controller: object, parts: object = None) -> np.ndarray:
        keys = {**KEYS, "record": str(record), "controller": controller, "runs": ["sim", "exp_rths"]}
        result = rths_cli.run(keys, parts=parts, overrides=["check"])
        assert result.status == "complete", result.status_reason
        return np.asarray(result.exp_rths.command_v), result.controller.feedforward

    text = (folder / "mine.py").read_text()
    wanted, block = commands({"kind": "chen", "delay_s": lag_s})
    per_m = float(block.D[0, 2]) / (1.0 + lag_s / dt_s)
    content = {"A": [[0.0]], "B": [[1.0]], "C": [[-per_m * lag_s / dt_s]], "D": [[per_m * (1.0 + lag_s / dt_s)]]}
    names = {"inputs": ["desired_disp_m"], "outputs": ["command_v"]}
    (folder / "law.json").write_text(json.dumps(content | names | {"dt_s": dt_s}))
    declared = (
        "\n\ndef linear(p, dt_s):\n"
        "    return [[0.0]], [[0.0, 0.0, 1.0]], [[-p[0] * p[1]]], [[0.0, 0.0, p[0] * (1 + p[1])]]\n"
    )
    limited = text.replace("return per_metre * (", "return min(50.0, 0.0 + per_metre * (").replace(
        "state[0]))\n", "state[0])))\n"
    )
    (folder / "compiled.py").write_text(limited + declared)
    (folder / "called.py").write_text(
        limited.replace("displacement = desired[2]", "displacement = list(desired)[2]") + declared
    )
    system = control.ss(*content.values(), dt_s, **names)
    of_control = {"feedforward": lambda designed: system}
    ways = [
        commands({"kind": "own", "file": "mine.py", "delay_s": lag_s}),
        commands({"kind": "state_space", "file": "law.json"}),
        commands("none", of_control),
        commands({"kind": "own", "file": "compiled.py", "delay_s": lag_s}),
        commands({"kind": "own", "file": "called.py", "delay_s": lag_s}),
    ]
    for made, _ in ways:
        assert np.abs(wanted).max() > 0.1 and np.abs(made - wanted).max() <= 2 * 20.0 / 2**16
    assert np.array_equal(ways[3][0], ways[4][0])
