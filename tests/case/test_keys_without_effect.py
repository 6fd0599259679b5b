"""Keys that nothing reads in what is asked for are named; those of the shipped cases are all read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from rths_cli.case.case_schema import Case, CaseKeys
from rths_cli.case.keys_without_effect import USES, unread_keys, without_effect
from rths_cli.case.load import load_cases

CONFIGS = Path(__file__).parents[2] / "configs"


def sentence(one: Case) -> str:
    return str(unread_keys(one) or "")


def case(*settings: str) -> Case:
    return load_cases(["el_centro_low_ff_fb"], settings)[0]


def test_every_shipped_case_reads_all_its_keys() -> None:
    files = sorted(path for path in CONFIGS.glob("*.yaml") if "controller" in path.read_text(encoding="utf-8"))
    cases = load_cases(files)
    assert len(cases) >= 8
    assert {one.name: sentence(one) for one in cases} == {one.name: "" for one in cases}


@pytest.mark.parametrize(
    ("settings", "key", "why"),
    [
        (("controller=FF", "controller.command_weight=0.02"), "controller.command_weight", "only the controller FF+FB"),
        (("method=paper", "kalman.residual_hz=30"), "kalman.residual_hz", "only method best reads it"),
        (("runs=[sim]", "delay_s=0.006"), "delay_s", "only SIM-DELAY would read it"),
        (("runs=[sim, sim-delay]", "kalman.q=900"), "kalman.q", "only the shake-table test and EXP-RTHS would read it"),
        (("runs=[shake-table]", "integration=cr"), "integration", "only EXP-RTHS would read it"),
    ],
)
def test_a_key_that_is_not_read_is_named_with_the_reason(settings: tuple[str, ...], key: str, why: str) -> None:
    told = sentence(case(*settings))
    assert told.startswith("without effect here: ") and re.search(rf"{re.escape(key)}[^;]*\({re.escape(why)}", told)


def test_a_key_that_is_read_is_not_named() -> None:
    assert sentence(case("controller.command_weight=0.02", "kalman.residual_hz=30", "delay_s=0.006")) == ""
    assert sentence(case("runs=[exp-rths]", "delay_s=0.006")) == ""  # the check of EXP-RTHS has a SIM-DELAY


def test_a_key_that_leaves_the_choice_to_the_program_asks_for_nothing() -> None:
    automatic = "controller={kind: FF, reaction_feedforward: automatic, friction_compensation: automatic}"
    assert (
        sentence(case("method=paper", automatic)) == "" == sentence(case("controller=none", "session_record=automatic"))
    )
    stated = sentence(
        case("method=paper", automatic.replace("reaction_feedforward: automatic", "reaction_feedforward: true"))
    )
    assert "reaction_feedforward (only a feedforward of method best" in stated and "friction" not in stated


def test_only_stated_keys_are_judged() -> None:
    one = case("runs=[sim]")
    assert "kalman" not in sentence(one) and "scaling" in one.stated and "delay_s" not in one.stated


def test_of_a_sweep_the_runs_are_its_own() -> None:
    assert without_effect(case(), ["delay_s", "scaling"], ("exp_rths",)) == {"delay_s": "only SIM-DELAY would read it"}


def test_every_key_of_the_list_is_a_key_of_a_case() -> None:
    for path in USES:
        fields = CaseKeys.model_fields
        first, *rest = path.split(".")
        assert first in fields, path
        for part in rest:
            annotation = fields[first].annotation
            model = next(iter(get_args(annotation)), annotation)  # of a controller: not that of a compensator
            assert part in model.model_fields, path
