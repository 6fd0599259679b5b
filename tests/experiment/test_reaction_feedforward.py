"""A feedforward of the specimen's reaction: its accuracy with a damaged specimen, and how the check judges it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.analysis.closed_loop import closed_loop_matrix
from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.case.load import load_cases
from rths_cli.control.interface import PartDesign
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check import stated_ends, tangent_verdicts
from rths_cli.experiment.design import design_blocks, loop_parts
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.findings import sentences
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.structure.tangents import at_rest

ON = "controller={kind: FF+FB, reaction_feedforward: true, friction_compensation: false}"
OFF = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"
DAMAGE = "table.after_identification.specimen_stiffness_factor"


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


def ratio(path: Path, memory: Memory, *settings: str) -> Array:
    """Return the error of EXP-RTHS over that of SIM-DELAY (n_storeys,), both against the true reference."""
    setup = setup_of("runs=[sim, sim_delay, exp_rths]", *settings)
    ended = run_case(setup, path, memory, "test", lambda _: None)
    assert ended.status == "complete", ended.reason
    return np.asarray(read_result(path).metrics["exp_rths.true_reference_ratio"])


@pytest.mark.campaign
def test_a_damaged_specimen_costs_a_quarter_of_the_error(tmp_path: Path, memory: Memory) -> None:
    found = ratio(tmp_path / "on.h5", memory, ON, f"{DAMAGE}=0.7")
    assert found.max() < 0.02  # 0.115 without


@pytest.mark.campaign
def test_a_specimen_as_identified_costs_nothing(tmp_path: Path, memory: Memory) -> None:
    """By the noise of single runs it costs up to 5 %, or spares them."""
    over = []
    for seed in range(4):
        on, off = (ratio(tmp_path / f"{key}{seed}.h5", memory, key, f"seed={seed}") for key in (ON, OFF))
        over.append(on / off)
    assert (np.mean(over, axis=0) < 1.02).all() and np.max(over) < 1.1


@pytest.mark.campaign
def test_a_specimen_that_degrades_keeps_the_accuracy_of_a_linear_one(tmp_path: Path, memory: Memory) -> None:
    """Identified below yielding, at a tenth of the usual level, where friction weighs more: that is countered, too."""
    both = "controller={kind: FF+FB, reaction_feedforward: true, friction_compensation: true}"
    law = "{kind: clough, yield_displacement_m: 0.002, hardening: 0.05, unloading_exponent: 0.4}"
    level = "identification.accel_rms_m_s2=0.2"
    found = ratio(tmp_path / "yields.h5", memory, both, level, f"table.physics.specimen_laws=[{law}, null]")
    assert found.max() < 0.02  # 0.148 without, 0.069 with the reaction alone


@pytest.mark.campaign
def test_the_check_judges_it_at_both_ends(default_identification: Identification) -> None:
    """On a table that moves as the changed reaction makes it. The ends are a half and one, or those that are stated."""
    for stated, factors in ((), (0.5,)), (("check.specimen_range=[0.7, 1.2]",), (0.7, 1.2)):
        setup = setup_of(ON, *stated)
        design, building = design_blocks(setup, default_identification), at_rest(setup.building)
        blocks, ends = design.blocks, stated_ends(setup.case, design.blocks.counters_reaction)
        verdicts = tangent_verdicts(setup, default_identification, blocks, building, SharedValues(), ends)
        names = [f"specimen at {100 * factor:.3g} % of its stiffness, at rest" for factor in factors]
        assert [one.name for one in verdicts] == ["at rest", *names]
        assert "moves as the changed reaction makes it" in " ".join(
            sentences(of_case(setup, default_identification, design))
        )
        assert all(0.99 < one.stability.radius < 1.0 for one in verdicts)


def test_the_table_of_the_check_moves_as_the_reaction_makes_it(default_identification: Identification) -> None:
    setup, identified = setup_of(ON), default_identification
    assert identified.specimen is not None
    specimen = identified.specimen.specimen
    there = replace(specimen, K=0.7 * specimen.K)
    rig, _ = loop_parts(setup, identified, there, counters_reaction=True)
    stays = identified_rig(identified.best, there, setup.rig, setup.removes_sensors)
    frequency = np.array([2.68, 3.2])  # of the specimen on a fixed base, now and as identified
    moved, before = (each.plant.response(frequency)[:, 0] for each in (rig, stays))
    assert np.abs(moved[0] / before[0] - 1.0).min() > 0.05
    assert moved[1:] / moved[0] == pytest.approx(before[1:] / before[0], rel=3e-3)
    matrix = closed_loop_matrix(rig, design_blocks(setup, identified).blocks)
    assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0


def test_another_feedforward_is_refused(default_identification: Identification) -> None:
    def same(designed: PartDesign) -> PartDesign:
        return designed

    case = load_cases(["el_centro_low_ff_fb"], (ON,))[0]
    with pytest.raises(InputError, match=r"reaction_feedforward: .* parts has another; remove the key"):
        design_blocks(make_setup(case, parts={"feedforward": same}), default_identification)


def test_method_paper_does_not_read_it() -> None:
    (told,) = [
        one for one in sentences(of_case(setup_of(ON, "method=paper"), None, None)) if "reaction_feedforward" in one
    ]
    assert "a feedforward of method best reads it" in told
