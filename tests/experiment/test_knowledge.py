"""Who may know what (docs/decisions/knowledge.md): models and controllers come from channels and declared values alone.

The numerical part is the case's own definition: where it is stated by the experimental one (`mean_of_experimental`,
`first_mode_ratio`), the declared values define it. Here it is stated in numbers, so that nothing else may differ.
"""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

import rths_cli
from rths_cli.case.load import load_cases
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.identify_on_rig import excite
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification import excitation
from rths_cli.identification.identify import identify as evaluate
from rths_cli.identification.record_parts import Parts, Record

ROOT = Path(rths_cli.__file__).parent
HIDDEN = {"physics", "after_identification"}
MAY_READ = {ROOT / "rigs" / "virtual", ROOT / "case"}

COMMON = (
    "structure.numerical.stiffness_n_per_m=[7354]",
    "damping={dashpots_n_s_per_m: [22.0]}",
    "identification.duration_s=100",
)
OTHER_PHYSICS = (
    "table.physics={moving_mass_kg: 9.0, coulomb_n: 0.9, loop_frequency_hz: 20, gain_m_per_v: 0.009}",
    "table.sensors.noise_rms_m_s2=0.001",
    "table.after_identification={specimen_stiffness_factor: 0.85, coulomb_factor: 3, payload_factor: 1.1}",
    "structure.experimental.natural_frequencies_hz=[3.5, 9.0]",
    "structure.experimental.damping_ratios=[0.02, 0.03]",
)


def setup_with(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], (*COMMON, *settings))[0])


@pytest.fixture(scope="module")
def recorded() -> tuple[np.ndarray, np.ndarray, Parts]:
    setup = setup_with()
    plan = excitation.plan(setup.rig, excitation.ExcitationSettings(duration_s=100.0), 0)
    command, channels, *_ = excite(setup, plan.command_v)
    return command, channels, plan.parts


def designed(setup: Setup, recorded: tuple[np.ndarray, np.ndarray, Parts]) -> Design:
    command, channels, parts = recorded
    return design_blocks(setup, evaluate([Record(command, channels, parts)], setup.rig, setup.floor_masses_kg))


def as_bytes(design: Design) -> list[bytes]:
    blocks = [getattr(block, m).tobytes() for block in design.blocks.named() for m in "ABCD"]
    model = design.model
    estimates, recent, _, desired = design.blocks.interface.force.of_one()
    scalars = np.array([model.gain, model.delay_s, model.ripple_m_s2_per_v, desired])
    arrays = (estimates, recent, model.zeros, model.poles, scalars)
    return blocks + [array.tobytes() for array in arrays]


def parts_of(limits: object) -> tuple[np.ndarray, ...]:
    """Return a limit of the guard, or the arrays of one that has several, as arrays."""
    return tuple(map(np.asarray, limits if isinstance(limits, tuple) else (limits,)))


@pytest.mark.campaign
@parametrize_first(1, "method", ["best", "paper"])
def test_the_same_channels_under_other_physics_change_no_byte(
    recorded: tuple[np.ndarray, np.ndarray, Parts], method: str
) -> None:
    here = setup_with(f"method={method}")
    there = setup_with(f"method={method}", *OTHER_PHYSICS)
    assert as_bytes(designed(here, recorded)) == as_bytes(designed(there, recorded))
    for one, other in zip(guard_limits(here), guard_limits(there), strict=True):
        assert np.array_equal(
            np.concatenate([*map(np.ravel, parts_of(one))]), np.concatenate([*map(np.ravel, parts_of(other))])
        )


@pytest.mark.campaign
def test_other_channels_change_the_controller(
    recorded: tuple[np.ndarray, np.ndarray, Parts],
) -> None:
    command, channels, parts = recorded
    louder = (command, channels * np.array([[1.01], [1.0], [1.0]]), parts)
    assert as_bytes(designed(setup_with(), recorded)) != as_bytes(designed(setup_with(), louder))


def test_only_the_virtual_rig_reads_hidden_physics() -> None:
    offenders = []
    for path in ROOT.rglob("*.py"):
        if any(path.is_relative_to(folder) for folder in MAY_READ):
            continue
        tree = ast.parse(path.read_text())
        offenders += [
            f"{path.name}:{node.lineno}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and node.attr in HIDDEN
        ]
    assert offenders == []


def test_after_identification_changes_the_runs_not_the_identification() -> None:
    changed = setup_with("table.after_identification.specimen_stiffness_factor=0.85")
    short = np.zeros(400)
    short[100:200] = 0.02
    assert excite(setup_with(), short)[1].tobytes() == excite(changed, short)[1].tobytes()
