"""The rate transition of a program: exact without a residual, of second order, and without jumps when answers are late.

The reference is `scipy.signal.lsim` of the undivided building with many samples to each of the step's.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from portfolio import parametrize_first
from scipy.signal import lsim

from rths_cli.analysis.program_stability import LinearProgram, coupled_step, modes_in_transition, specimen_block
from rths_cli.control.program_storeys import Asked, ProgramStoreys, RateTransition, program_storeys
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array
from rths_cli.programs import Description, Program, ProgramFault
from rths_cli.structure import Building, Numerical, Specimen, assemble, build
from rths_cli.structure.programs import ProgramPart, laws_of_program

DT_S = 1.0 / 2048.0
TIME_S = np.arange(0.0, 4.0, DT_S)
GROUND = 2.0 * np.sin(2.0 * np.pi * 2.2 * TIME_S) * np.exp(-((TIME_S - 1.5) ** 2))


def paper(factor: float = 1.0) -> Building:
    """Return the paper's building, with a factor on the stiffness of its lower storey."""
    experimental = SimpleNamespace(
        masses_kg=(6.91, 6.95), natural_frequencies_hz=None, stiffness_n_per_m=(7331.56, 7376.4),
        damping_ratios=(0.043, 0.039), dashpots_n_s_per_m=None,
    )  # fmt: skip
    spec = SimpleNamespace(
        numerical=SimpleNamespace(masses_kg=(6.93,), stiffness_n_per_m=(factor * 7354.0,)), experimental=experimental,
        interface_experimental_mass_kg=0.0,
    )  # fmt: skip
    return build(spec, SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=(22.163,)))


def design(
    rate_hz: float, answer_s: float, factor: float, stalls: tuple[tuple[float, float], ...] = ()
) -> ProgramStoreys:
    part = ProgramPart(Description("python", "", "", "x"), rate_hz, answer_s, factor, stalls)
    building = replace(paper(), program=part, laws=laws_of_program(1))
    return program_storeys(building, DT_S).knowing(GROUND)


def played(made: ProgramStoreys, program: Asked | None = None) -> tuple[Array, Array]:
    """Return the interface's accelerations (n,) on a perfect table, and what is logged (4, n)."""
    assert made.plan is not None
    building = paper()
    floors = RateTransition(made.plan, program or LinearProgram(building.numerical.K))
    specimen = specimen_block(building.specimen, 0.0, DT_S)
    state, accel, logged = np.zeros(len(specimen.A)), np.zeros(len(GROUND)), np.zeros((4, len(GROUND)))
    for k, ground in enumerate(GROUND):
        state, motion = coupled_step(floors, specimen, state, np.array([ground, 0.0, 0.0]))
        accel[k], logged[:, k] = motion[0, 0], floors.logged
    return accel, logged


def undivided() -> Array:
    b, n = paper(), 3
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(b.M, b.K), -np.linalg.solve(b.M, b.C)]])
    B = np.concatenate([np.zeros((n, 1)), -np.ones((n, 1))])
    return np.asarray(lsim((A, B, A[n : n + 1], np.zeros((1, 1))), GROUND, TIME_S)[1])


def error(found: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((found - reference) ** 2) / np.mean(reference**2)))


@pytest.mark.campaign
def test_without_a_residual_the_rate_changes_nothing() -> None:
    fast, slow = (played(design(rate, 1.0 / rate, 1.0))[0] for rate in (2048.0, 64.0))
    assert np.abs(fast - slow).max() <= 1e-9 * np.abs(fast).max()
    assert error(fast, undivided()) < 2e-4


@parametrize_first(1, "factor", [0.8, 1.2])
def test_a_fifth_of_the_force_left_to_the_residual_is_followed_with_second_order(factor: float) -> None:
    exact = played(design(2048.0, DT_S, 1.0))[0]
    found = {rate: error(played(design(rate, 1.0 / rate, factor))[0], exact) for rate in (2048.0, 256.0, 64.0)}
    assert found[2048.0] < 1e-4
    assert found[256.0] < 5e-3
    assert 10.0 < found[64.0] / found[256.0] < 40.0  # 16 is that of second order


def test_a_late_answer_makes_no_jump_and_is_told() -> None:
    usual, logged = played(design(256.0, 1.0 / 256.0, 1.2))
    late, told = played(design(256.0, 1.0 / 256.0, 1.2, stalls=((1.5, 0.010),)))
    assert logged[1].sum() == 0.0
    assert 0.0 < told[1].sum() <= 0.012 / DT_S
    assert told[2].max() == pytest.approx(0.010, abs=DT_S)
    assert (np.sum(told[2] > 0.0), np.sum(told[3])) == (1, 3)  # 10 ms late: three requests of every 3.9 ms are left out
    steps = np.abs(np.diff(late)).max() / np.abs(np.diff(usual)).max()
    assert steps < 1.05
    assert error(late, usual) < 0.02


def test_what_a_late_answer_missed_is_made_up_for_no_faster_than_the_residual_changes_anyway() -> None:
    """At once it would take twice the largest step of the residual, which the acceleration follows."""
    usual, late = (played(design(256.0, 1.0 / 256.0, 1.2, stalls=of))[1] for of in ((), ((1.6, 0.015),)))
    assert np.abs(np.diff(late[0])).max() <= 1.01 * np.abs(np.diff(usual[0])).max()
    after = slice(round(2.0 / DT_S), None)
    assert error(late[0, after], usual[0, after]) < 0.02  # and it has made up for all of it


def test_a_program_silent_for_four_intervals_stops_the_test() -> None:
    with pytest.raises(ProgramFault, match="has not answered for"):
        played(design(256.0, 1.0 / 256.0, 1.2, stalls=((1.5, 0.5),)))


FEW, MANY = (0.5, 1.6, 2.9), tuple(np.linspace(0.1, 3.2, 20).tolist())


def stalled(lasts_s: float, instants_s: tuple[float, ...]) -> None:
    """Have each stall change the motion little, or stop the test; a short one never stops it.

    While the residual is held, a sample's change of acceleration lacks what the residual changes by in a sample.
    """
    usual, logged = played(design(256.0, 1.0 / 256.0, 1.2))
    residual = 1.01 * np.abs(np.diff(logged[0])).max() / paper().numerical.masses_kg[0]
    for at_s in instants_s:
        made = design(256.0, 1.0 / 256.0, 1.2, stalls=((at_s, lasts_s),))
        if lasts_s > 4.0 / 256.0:
            with pytest.raises(ProgramFault, match="has not answered for"):
                played(made)
            continue
        late, told = played(made)
        assert error(late, usual) < 0.02
        assert np.sum(told[2] > 0.0) == 1
        assert np.abs(np.diff(late) - np.diff(usual)).max() < 2.0 * residual


FAULTS = {
    "os._exit(4)": "ended by itself, exit code 4",
    "sys.exit(3)": r"called exit\(3\)",
    "return u * float('nan')": "gave a force that is not finite",
    "raise ArithmeticError('does not converge')": "failed: ArithmeticError: does not converge",
}
BODY = """
import os, sys
class Storey:
    def __init__(self, masses_kg, parameters):
        self.left = parameters["calls"]
    def force(self, u):
        self.left -= 1
        if self.left < 0:
            {fault}
        return 7354.0 * u
"""


def faulty(folder: Path, fault: str, instants_s: tuple[float, ...]) -> None:
    """Have a program fail at instants of the record: the reason is the true one, and its process is gone."""
    file = folder / "storey.py"
    file.write_text(BODY.format(fault=fault), encoding="utf-8")
    for at_s in instants_s:
        calls = (("calls", 1.0 + 256.0 * at_s),)  # one at rest
        stated = Description("python", str(file), "", "Storey", masses_kg=(6.93,), parameters=calls)
        with Program(stated) as program:
            process = program.process_id
            with pytest.raises(ProgramFault, match=FAULTS[fault]):
                played(design(256.0, 1.0 / 256.0, 1.2), program)
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


@pytest.mark.parametrize("lasts_s", [0.005, 0.05, 0.5])
def test_stalls_change_little_or_stop_the_test(lasts_s: float) -> None:
    stalled(lasts_s, FEW)


@pytest.mark.campaign
@pytest.mark.parametrize("lasts_s", [0.005, 0.05, 0.5])
def test_stalls_at_many_instants(lasts_s: float) -> None:
    stalled(lasts_s, MANY)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_program_has_its_reason_and_leaves_no_process(tmp_path: Path, fault: str) -> None:
    faulty(tmp_path, fault, (1.6,))


@pytest.mark.campaign
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_at_many_instants(tmp_path: Path, fault: str) -> None:
    faulty(tmp_path, fault, MANY)


@pytest.mark.parametrize(
    ("rate_hz", "answer_s", "told"), [(300.0, 0.001, "whole multiple"), (256.0, 0.01, "between two answers")]
)
def test_a_rate_that_cannot_be_held_is_refused(rate_hz: float, answer_s: float, told: str) -> None:
    with pytest.raises(InputError, match=told):
        design(rate_hz, answer_s, 1.0)


@pytest.mark.campaign
@pytest.mark.parametrize("answer_s", [0.5 / 256.0, 1.0 / 256.0])
def test_the_modes_in_the_transition_are_those_of_a_free_vibration(answer_s: float) -> None:
    """The interval matrix foretells the decay of the transition played in time."""
    plan = design(256.0, answer_s, 1.0).plan
    assert plan is not None
    softer = at_stiffness(0.5)
    mode = modes_in_transition(softer, plan, DT_S)[0]
    floors, specimen = (
        RateTransition(plan, LinearProgram(softer.numerical.K)),
        specimen_block(softer.specimen, 0.0, DT_S),
    )
    state, accel = np.zeros(len(specimen.A)), []
    for k in range(round(20.0 / mode.hz / DT_S)):
        kick = 1.0 if k * DT_S < 0.5 / mode.hz else 0.0
        state, motion = coupled_step(floors, specimen, state, np.array([kick, 0.0, 0.0]))
        accel.append(motion[0, 0])
    period = round(1.0 / mode.hz / DT_S)
    early, late = (max(map(abs, accel[n * period : (n + 1) * period])) for n in (8, 18))
    ratio = np.log(early / late) / (2.0 * np.pi * 10.0)
    assert mode.ratio + mode.added == pytest.approx(ratio, rel=0.03)


def at_stiffness(factor: float) -> Building:
    b = paper()
    numerical = Numerical(b.numerical.masses_kg, factor * b.numerical.K, b.numerical.C)
    specimen = Specimen(b.specimen.masses_kg, b.specimen.K, b.specimen.C)
    return Building(numerical, specimen, 0.0, *assemble(numerical, specimen, 0.0))
