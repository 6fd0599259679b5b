"""The feedback that a case gets: as stated, the usual one, or one with which the loop keeps its margins."""

from __future__ import annotations

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.closed_loop import closed_loop_matrix
from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.case.load import load_cases
from rths_cli.control import feedback
from rths_cli.control.feedback import DEFAULT, Weights
from rths_cli.errors import InputError
from rths_cli.experiment import design
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.design import FIRMER, Chosen, Design, design_blocks, loop_faults
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.result_contents import design_figures
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.findings import sentences
from rths_cli.identification.results import Identification


@pytest.fixture(scope="module")
def bare(memory: Memory) -> Identification:
    return memory.identify(bare_setup(), lambda _: None)


def bare_setup(controller: str = "FF+FB", *more: str) -> Setup:
    """Return the building of 0.5 % damping with a controller; the shipped case states its weight."""
    return make_setup(load_cases(["el_centro_bare_ff_fb"], [f"controller={controller}", *more])[0])


def radius(setup: Setup, identified: Identification, design: Design, gain: float) -> float:
    """Return the spectral radius of the sampled loop on a table of so many times the identified gain."""
    table = replace(identified.best, gain=gain * identified.best.gain)
    rig = identified_rig(table, identified.specimen.specimen, setup.rig, setup.removes_sensors)
    return float(np.abs(np.linalg.eigvals(closed_loop_matrix(rig, design.blocks))).max())


def test_where_the_usual_feedback_is_safe_it_stays(
    default_setup: Setup, default_identification: Identification
) -> None:
    found = design_blocks(default_setup, default_identification)
    asked = (default_identification.best, default_identification.frfs[0], default_setup.rig.dt_s, None, 1.5, DEFAULT)
    assert found.chosen is None
    assert pickle.dumps(found.blocks.feedback) == pickle.dumps(feedback.design(*asked).block)
    assert not [one for one in sentences(of_case(default_setup, default_identification, found)) if "chosen" in one]
    assert not [one for one in design_figures(default_setup, default_identification, found) if "chosen" in one]


@pytest.mark.campaign
def test_left_open_the_feedback_lets_a_lightly_damped_building_stand_a_tenth_of_gain(bare: Identification) -> None:
    """Judged by the eigenvalues of the whole loop, not by the check's own distances."""
    setup = bare_setup()
    found = design_blocks(setup, bare)
    usual = design_blocks(bare_setup("{kind: FF+FB, command_weight: 0.01}"), bare)
    assert radius(setup, bare, usual, 0.9) > 1.0
    assert max(radius(setup, bare, found, gain) for gain in (0.9, 1.0, 1.1)) < 1.0
    assert found.chosen == Chosen(Weights((1.0, 12.0), 1e-3), 1.5)
    assert found.feedback.sensitivity_peak <= 1.5
    assert loop_faults(setup, bare, found.blocks) == []


def test_what_was_chosen_is_told_and_stored_and_may_be_stated(bare: Identification) -> None:
    setup = bare_setup()
    found = design_blocks(setup, bare)
    (told,) = [one for one in sentences(of_case(setup, bare, found)) if "chosen" in one]
    assert "disturbance_hz: [1, 12], command_weight: 0.001, max_sensitivity: 1.5;" in told
    figures = design_figures(setup, bare, found)
    ends = [figures[f"feedback.chosen_disturbance_{end}_hz"] for end in ("low", "high")]
    assert (*ends, figures["feedback.chosen_command_weight"]) == (1.0, 12.0, 1e-3)
    assert figures["feedback.chosen_max_sensitivity"] == 1.5
    stated = bare_setup("{kind: FF+FB, disturbance_hz: [1, 12], command_weight: 0.001, max_sensitivity: 1.5}")
    assert pickle.dumps(design_blocks(stated, bare).blocks) == pickle.dumps(found.blocks)


def test_a_case_without_a_hybrid_test_gets_the_usual_feedback(bare: Identification) -> None:
    """There is no loop whose margins a choice could keep."""
    setup = make_setup(load_cases(["el_centro_bare_ff_fb"], ["controller=FF+FB", "runs=[shake_table]"])[0])
    asked = (bare.best, bare.frfs[0], setup.rig.dt_s, None, 1.5, DEFAULT)
    found = design_blocks(setup, bare)
    assert found.chosen is None
    assert pickle.dumps(found.blocks.feedback) == pickle.dumps(feedback.design(*asked).block)


def test_a_usual_feedback_that_is_of_no_use_is_told_so(bare: Identification, monkeypatch: pytest.MonkeyPatch) -> None:
    design = feedback.design

    def without_usual(
        model: object, frf: object, dt_s: float, hz: object, peak: float, weights: Weights, *more: object
    ) -> object:
        if weights == DEFAULT:
            raise InputError("controller: no feedback is of use on this table")
        return design(model, frf, dt_s, hz, peak, weights, *more)

    monkeypatch.setattr(feedback, "design", without_usual)
    setup = bare_setup()
    found = design_blocks(setup, bare)
    assert found.chosen == Chosen(Weights((1.0, 12.0), 1e-3), 1.5, usual_of_use=False)
    (told,) = [one for one in sentences(of_case(setup, bare, found)) if "chosen" in one]
    assert "the usual feedback is of no use on this table; chosen instead: disturbance_hz: [1, 12]" in told


@parametrize_first(
    1,
    ("stated", "weights"),
    [
        ("command_weight: 0.01", DEFAULT),
        ("disturbance_hz: [1, 12]", DEFAULT),
        ("disturbance_hz: [2, 8], command_weight: 0.03", Weights((2.0, 8.0), 0.03)),
        ("feedback_bandwidth_hz: 20", DEFAULT),
    ],
)
def test_a_stated_value_is_never_changed(bare: Identification, stated: str, weights: Weights) -> None:
    setup = bare_setup(f"{{kind: FF+FB, {stated}}}")
    found = design_blocks(setup, bare)
    asked = (bare.best, bare.frfs[0], setup.rig.dt_s, setup.case.controller.feedback_bandwidth_hz, 1.5, weights)
    assert loop_faults(setup, bare, found.blocks) != []  # there was a reason to change it
    assert found.chosen is None
    assert pickle.dumps(found.blocks.feedback) == pickle.dumps(feedback.design(*asked).block)


def test_the_printed_method_keeps_its_weights(bare: Identification) -> None:
    setup = bare_setup("FF+FB", "method=paper")
    asked = (bare.paper, bare.frfs[0], setup.rig.dt_s, None, 1.5, replace(DEFAULT, high_pass_hz=0.0))
    found = design_blocks(setup, bare)
    assert loop_faults(setup, bare, found.blocks) != []
    assert pickle.dumps(found.blocks.feedback) == pickle.dumps(feedback.design(*asked).block)


class Tries:
    """Stands for the design: a feedback amplifies 0.4 at worst, or what its limit allows, and some are of no use."""

    def __init__(self, useless: Weights | None = None, below: float = np.inf) -> None:
        self.asked: list[tuple[Weights, float]] = []
        self.useless, self.below = useless, below

    def make(self, weights: Weights, limit: float) -> SimpleNamespace:
        self.asked.append((weights, limit))
        if weights == self.useless and limit < self.below:
            raise InputError("of no use")
        peak = min(limit, 1.4)
        return SimpleNamespace(sensitivity_peak=peak, modelled=SimpleNamespace(sensitivity_peak=peak), of=weights)


def test_firmer_feedbacks_are_tried_before_gentler_ones() -> None:
    tries = Tries()
    assert design.first_safe(tries.make, lambda _: ["no"], 1.5) is None
    limits = [1.5] * 4 + [1.2] * 4 + [1.1] * 4 + [1.05] * 4
    assert tries.asked == list(zip(FIRMER * 4, limits, strict=True))


def test_the_first_safe_one_is_taken() -> None:
    tries = Tries()
    found = design.first_safe(
        tries.make, lambda one: [] if one.sensitivity_peak < 1.3 and one.of != DEFAULT else ["no"], 1.5
    )
    assert found is not None
    assert found[1] == Chosen(FIRMER[1], 1.2) == Chosen(*tries.asked[-1])


@pytest.mark.parametrize(("below", "limits"), [(np.inf, [1.5]), (1.3, [1.5, 1.2])])
def test_a_feedback_of_no_use_is_not_made_gentler(below: float, limits: list[float]) -> None:
    tries = Tries(FIRMER[1], below)
    assert design.first_safe(tries.make, lambda _: ["no"], 1.5) is None
    assert [limit for weights, limit in tries.asked if weights == FIRMER[1]] == limits


@pytest.mark.campaign
def test_where_no_choice_is_safe_the_usual_feedback_and_its_refusal_stay(
    bare: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(design, "FIRMER", (DEFAULT,))
    monkeypatch.setattr(design, "HALVINGS", 1)
    setup = bare_setup()
    found = design_blocks(setup, bare)
    stated = design_blocks(bare_setup("{kind: FF+FB, command_weight: 0.01}"), bare)
    assert found.chosen is None
    assert pickle.dumps(found.blocks) == pickle.dumps(stated.blocks)


@parametrize_first(1, ("missed", "told"), [(0.24, "misses the measured response by 0.24"), (0.005, "peak of 1.001")])
def test_the_printed_method_names_its_own_model_where_that_is_wrong(
    default_setup: Setup, default_identification: Identification, missed: float, told: str
) -> None:
    setup = make_setup(
        load_cases(
            [str(default_setup.case.path)], ["method=paper", "controller={kind: FF+FB, max_sensitivity: 1.001}"]
        )[0]
    )
    error = replace(default_identification.paper_error, rms=missed)
    with pytest.raises(InputError) as caught:
        design_blocks(setup, replace(default_identification, paper_error=error))
    assert len(caught.value.faults) == 1 and told in caught.value.faults[0]
