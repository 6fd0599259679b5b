"""The budget names the cause that was switched on, or a group that holds it (benchmarks/budget_causes.py)."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns.budget_causes import CAUSES, Named, Switched, named_causes
from portfolio import parametrize_first

from rths_cli.analysis.error_attribution import Cause
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_metrics import told_causes

SAMPLE = (
    "Coulomb friction x10", "specimen's masses +1 %", "gain of the table +0.5 %", "command 100 us late",
    "gain of floor_2 +0.5 %", "AC corner of table +20 %", "noise of 20 mm/s^2", "13 bits", "softening 2 %",
)  # fmt: skip


@parametrize_first(1, "name", SAMPLE)
def test_what_was_switched_on_is_named_first(name: str, memory: Memory) -> None:
    found = named_causes(CAUSES[name], memory)
    assert found.error >= 0.03
    assert CAUSES[name].name in found.causes[0].told
    assert found.causes[0].largest > 2.0 * found.causes[1].largest
    sizes = [cause.largest for cause in found.causes]
    assert sizes == sorted(sizes, reverse=True)


@pytest.fixture(scope="module")
def one_gain(memory: Memory) -> Named:
    return named_causes(CAUSES["gain of floor_2 +0.5 %"], memory)


@pytest.mark.campaign
def test_friction_that_is_countered_is_no_cause(memory: Memory) -> None:
    found = named_causes(Switched((), ""), memory)
    friction = next(cause for cause in found.causes if cause.names == ("friction",))
    assert found.causes[0].names == ("rounded samples",) and friction.largest < 0.2 * found.causes[0].largest


@pytest.mark.campaign
def test_parameters_of_a_law_that_move_are_not_called_rounding(memory: Memory) -> None:
    """Dry friction of the table moves them; converters of any number of bits give the same error."""
    found = named_causes(Switched(("controller={kind: predictive_adaptive}",), "", before=True), memory)
    assert found.causes[0].told.startswith("what the law commands beyond its linear block")


@pytest.mark.campaign
def test_a_gain_is_named_alone_with_its_size(one_gain: Named) -> None:
    assert one_gain.causes[0].names == ("gain of floor_2",)
    assert float(one_gain.causes[0].size.split()[0]) == pytest.approx(0.5, abs=0.02)


def test_a_result_states_parts_of_the_error_and_the_main_cause() -> None:
    causes = (Cause(("a", "b"), np.array([3.0, 1.0]), "+1 %"), Cause(("c",), np.array([0.5, 1.0])))
    told = told_causes((*causes, Cause(("d",), np.array([0.01, 0.0]))))
    assert told["main_error_cause"] == "a (+1 %) or b"
    assert told["error_causes"].splitlines() == ["a (+1 %) or b: 95 %", "c: 32 %"]
    assert (
        told_causes((causes[1], Cause(("e",), np.array([0.9])), Cause(("f",), np.array([0.9]))))["main_error_cause"]
        == ""
    )
    assert told_causes(()) == {} and told_causes((Cause(("a",), np.zeros(2)),)) == {}
