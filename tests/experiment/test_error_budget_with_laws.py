"""The error budget of storeys with laws: parts that add up, and known changes come out as what they are."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.error_budget import CAUSES
from rths_cli.case.load import load_cases
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, evaluated, plan_run, play_run, run_of
from rths_cli.experiment.run_case import sim_of
from rths_cli.experiment.setup import make_setup
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import Values

LAW = "structure.numerical.law=[{kind: bilinear, yield_displacement_m: 0.002, hardening: 0.05}]"
CHANGED = "table.after_identification."
PLAIN = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"  # friction is a cause


def budget_of(memory: Memory, *settings: str) -> tuple[Values, str]:
    """Return the metrics of a test of a yielding storey, and its first named cause."""
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], (LAW, PLAIN, *settings))[0])
    identified = memory.identify(setup, lambda _: None)
    design = design_blocks(setup, identified)
    found = judge(setup, identified, design)
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    run = run_of(outcome, setup, HYBRID_TEST, design.blocks.lead_samples, None)
    run = evaluated(run, setup, sim_of(setup, SharedValues()), found.known, found.replay)
    return run.metrics, run.causes[0].told


def part(found: Values, name: str) -> np.ndarray:
    return np.asarray(found[f"budget.rms_error_{name}_m_s2"])


@pytest.mark.campaign
def test_friction_is_the_error_of_a_rig_as_identified(memory: Memory) -> None:
    found, named = budget_of(memory)
    error = np.asarray(found["exp_rths.rms_error_m_s2"])
    assert (np.asarray(found["budget.unexplained_rms_m_s2"]) < 0.01 * error).all()
    assert part(found, "friction") == pytest.approx(error, rel=0.15)
    assert named == "friction"
    assert all((part(found, name) < 0.7 * part(found, "friction")).all() for name in CAUSES if name != "friction")


@pytest.mark.campaign
def test_a_softer_specimen_is_told(memory: Memory) -> None:
    found, named = budget_of(memory, f"{CHANGED}specimen_stiffness_factor=0.97")
    error = np.asarray(found["exp_rths.rms_error_m_s2"])
    assert (np.asarray(found["budget.unexplained_rms_m_s2"]) < 0.01 * error).all()
    assert part(found, "specimen") == pytest.approx(error, rel=0.25)
    assert named.startswith("specimen")
