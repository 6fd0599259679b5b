"""Friction countered by the command: its accuracy, what the check and the budget say of it, and when it stays off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.control.interface import PartDesign
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.findings import sentences
from rths_cli.identification.results import Identification

ON = "controller={kind: FF+FB, friction_compensation: true}"
SMALL = ("scaling=0.05", "table.physics.coulomb_n=1")


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


def with_held_out(found: Identification, share: float | None) -> Identification:
    assert found.friction is not None
    return replace(found, friction=replace(found.friction, held_out=share))


@pytest.mark.campaign
def test_a_small_motion_with_friction_is_as_accurate_as_one_without(tmp_path: Path, memory: Memory) -> None:
    """Independent of the design: errors of the true accelerations, and those that the check has predicted."""
    setup = setup_of("runs=[sim, sim_delay, exp_rths]", ON, *SMALL)
    path = tmp_path / "on.h5"
    ended = run_case(setup, path, memory, "test", lambda _: None)
    assert ended.status == "complete", ended.reason
    values = read_result(path).metrics
    late = np.asarray(values["sim_delay.rms_error_m_s2"])
    measured = np.asarray(values["exp_rths.rms_error_m_s2"])
    assert (measured / late).max() < 0.05  # 0.137 without
    predicted = np.asarray(values["check.rms_error_m_s2"])
    # it is the rounding of samples, which the command's own rounding dithers on the table
    assert (measured < 1.5 * predicted).all() and (predicted < 1.5 * measured).all()
    # the friction that the budget finds is what the identification found
    assert abs(float(values["budget.friction_v"]) / float(values["check.friction_v"]) - 1.0) < 0.05
    assert (np.asarray(values["budget.rms_error_friction_m_s2"]) < 0.04 * late).all()
    assert (np.asarray(values["budget.rms_error_rounding_m_s2"]) < 0.04 * late).all()


@pytest.mark.campaign
def test_the_low_level_record_decides(default_identification: Identification) -> None:
    """Of friction as the virtual table has it nearly all is removed; no more than half of it, or nothing known: off."""
    friction = default_identification.friction
    assert friction is not None and friction.held_out is not None and friction.held_out > 0.995
    for share, told in ((0.49, "49 %"), (-2.0, "0 %"), (None, "no low-level record")):
        found, setup = with_held_out(default_identification, share), setup_of(ON)
        design = design_blocks(setup, found)
        assert design.blocks.friction_compensation is None
        (sentence,) = [one for one in sentences(of_case(setup, found, design)) if "friction_compensation" in one]
        assert "is off" in sentence and told in sentence.replace("%", " %").replace("  ", " ")
    on = design_blocks(setup_of(ON), with_held_out(default_identification, 0.51))
    assert on.blocks.friction_compensation is not None
    off = setup_of("controller={kind: FF+FB, friction_compensation: false}")
    assert design_blocks(off, default_identification).blocks.friction_compensation is None


@pytest.mark.campaign
def test_automatic_is_on_where_it_is_shown_and_says_nothing_where_it_is_not(
    default_identification: Identification,
) -> None:
    """A rig that is sent a preview of the commands keeps it: that needs a step without friction's part."""
    setup, found = setup_of(), default_identification
    assert setup.case.controller.friction_compensation == "automatic"
    on = design_blocks(setup_of(ON), found).blocks.friction_compensation
    assert on is not None and design_blocks(setup, found).blocks.friction_compensation is not None
    less = with_held_out(found, 0.49)
    design = design_blocks(setup, less)
    assert design.blocks.friction_compensation is None
    assert not [one for one in sentences(of_case(setup, less, design)) if "friction_compensation" in one]
    for overrun, kept in (("skip", False), ("hold", True)):
        rig = replace(setup.rig, kind="udp", overrun=overrun)
        linked = design_blocks(replace(setup, rig=rig), found).blocks
        assert rig.previews is not kept and (linked.friction_compensation is not None) is kept
        assert linked.counters_reaction


def test_another_feedforward_is_refused(default_identification: Identification) -> None:
    def same(designed: PartDesign) -> PartDesign:
        return designed

    case = load_cases(["el_centro_low_ff_fb"], (ON,))[0]
    with pytest.raises(InputError, match=r"friction_compensation: .* parts has another; remove the key"):
        design_blocks(make_setup(case, parts={"feedforward": same}), default_identification)
