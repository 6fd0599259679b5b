"""SIM of a building with a program: the limit of two step lengths, and one solution in a process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rths_cli.analysis import program_sim
from rths_cli.analysis.program_sim import extrapolated, simulate_with_program
from rths_cli.analysis.sim import simulate
from rths_cli.numerics.lti import Array
from rths_cli.programs import Description
from rths_cli.structure import build
from rths_cli.structure.programs import ProgramPart, laws_of_program

LINEAR = """
class Storey:
    def __init__(self, masses_kg, parameters):
        open(__file__ + ".started", "a").write("x")
    def force(self, u):
        return 7354.0 * u
"""


@pytest.mark.parametrize("samples", [9, 10])
@pytest.mark.parametrize("every", [1, 2])
def test_an_error_of_second_order_is_extrapolated_away(samples: int, every: int) -> None:
    """The error is a straight line in time, which is also known between the samples of the coarse response."""
    time = np.arange(float(samples))
    exact, slope = np.cos(time), 0.3 * time + 0.1
    coarse, fine = (exact + 4.0 * slope)[::every], exact + slope
    found = extrapolated(coarse[None, None], fine[None, None])[0, 0]
    known = samples if samples % 2 or every == 1 else samples - 1  # the last sample may have no coarse one
    assert found[:known] == pytest.approx(exact[:known], abs=1e-12)
    assert abs(found[-1] - exact[-1]) <= 0.3 + 1e-12


def test_a_response_is_exact_and_solved_once(tmp_path: Path) -> None:
    experimental = SimpleNamespace(
        masses_kg=(6.91, 6.95), natural_frequencies_hz=None, stiffness_n_per_m=(7331.56, 7376.4),
        damping_ratios=(0.043, 0.039), dashpots_n_s_per_m=None,
    )  # fmt: skip
    numerical = SimpleNamespace(masses_kg=(6.93,), stiffness_n_per_m=(7354.0,))
    spec = SimpleNamespace(numerical=numerical, experimental=experimental, interface_experimental_mass_kg=0.0)
    linear = build(spec, SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=(22.163,)))
    file = tmp_path / "storey.py"
    file.write_text(LINEAR, encoding="utf-8")
    part = ProgramPart(Description("python", str(file), "", "Storey", masses_kg=(6.93,)), 200.0)
    whole = replace(linear, program=part, laws=laws_of_program(1))
    time_s = np.arange(0.0, 2.0, 1e-3)
    ground = 2.0 * np.sin(2.0 * np.pi * 2.0 * time_s) * np.exp(-((time_s - 1.0) ** 2))
    started = Path(f"{file}.started")

    found = simulate_with_program(whole, 1e-3, ground)
    exact = simulate(linear, 1e-3, ground)
    assert np.abs(found.rel_disp_m - exact.rel_disp_m).max() < 1e-6 * np.abs(exact.rel_disp_m).max()
    first = len(started.read_text())
    simulate_with_program(replace(whole, laws=laws_of_program(1, np.array([[-1.0, 0.0]]))), 1e-3, ground)
    assert len(started.read_text()) == first
    file.write_text(LINEAR.replace("7354.0", "7000.0"), encoding="utf-8")
    other = simulate_with_program(whole, 1e-3, ground)
    assert len(started.read_text()) > first
    assert np.abs(other.rel_disp_m - found.rel_disp_m).max() > 1e-3 * np.abs(found.rel_disp_m).max()


def test_steps_are_halved_from_the_first_to_the_most() -> None:
    """A method of second and fourth order in closed form: y (1 + a h^2 + b h^4). Each halving leaves a sixteenth."""
    asked, wave = [], np.sin(0.05 * np.arange(201))[None, None]

    def solve(every: int, steps: int) -> Array:
        asked.append((every, steps))
        h = every / steps
        return np.asarray((wave * (1.0 + 0.01 * h**2 + 0.0004 * h**4))[..., ::every])

    found, error = program_sim.refined(solve, 1, 4)
    assert asked == [(2, 1), (1, 1), (4, 1), (1, 2)]
    assert np.abs(found / np.where(wave == 0.0, 1.0, wave) - 1.0)[wave != 0.0].max() < error < program_sim.ACCURATE
    asked.clear()
    program_sim.refined(solve, 1, 1)  # most is met before the accuracy
    assert asked == [(2, 1), (1, 1), (4, 1)]
