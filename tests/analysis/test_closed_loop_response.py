"""The loop line by line against the blocks followed one by one, the compiled loop's matrix, and the whole building."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, ideal_info, specimen
from hybrid import best_like, closed_loop, paper_like, reacting, storeys
from open_loop import OpenLoop, floors_per_table, open_loop, points, rig_as_identified, true_rig

from rths_cli.analysis import closed_loop as loop_block
from rths_cli.analysis.closed_loop import (
    LoopResponse,
    Motion,
    closed_loop_matrix,
    hybrid,
    loop_response,
    on_perfect_table,
)
from rths_cli.control import kalman_filter, numerical_substructure
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface
from rths_cli.numerics.lti import ComplexArray
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Numerical, assemble

F = np.array([0.3, 1.1, 2.3, 3.2, 4.7, 6.5, 8.4, 9.3, 14.0, 27.0, 60.0, 300.0, 900.0])
Z = points(F, DT_S)
UNIT = np.ones(len(F), dtype=complex)


def several(info: RigInfo, mass: float = 0.0) -> Blocks:
    return best_like(info, mass, numerical_storeys=3)


def made(
    make: Callable[..., Blocks], latency: int = 1, mass: float = 0.0, z: ComplexArray = Z
) -> tuple[LoopResponse, OpenLoop, Blocks]:
    """Return the responses under test and the loop followed block by block, on the true rig."""
    info = ideal_info(latency_samples=latency)
    blocks, count = make(info, mass), 3 if make is several else 1
    rig = replace(rig_as_identified(info, mass)[0], ripple_m_s2_per_v=0.0)
    every = numerical_substructure.all_storeys(storeys(count, mass_kg=6.93 - mass), DT_S)
    loop = loop_response(rig, blocks, every, z)
    return loop, open_loop(true_rig(info, mass), blocks, count, mass_kg=6.93 - mass), blocks


def same(found: ComplexArray, wanted: ComplexArray) -> None:
    assert found == pytest.approx(wanted, rel=1e-6, abs=1e-9 * float(np.abs(wanted).max(initial=1e-3)))


CASES = [
    (paper_like, 1, 0.0),
    (paper_like, 0, 1.2),
    (best_like, 1, 0.0),
    (best_like, 2, 1.2),
    (several, 1, 0.0),
    (reacting, 2, 1.2),
]


@pytest.mark.parametrize(("make", "latency", "mass"), CASES)
def test_the_loop_gain_is_what_comes_back_to_the_cut_command(
    make: Callable[..., Blocks], latency: int, mass: float
) -> None:
    loop, cut, _ = made(make, latency, mass)
    same(loop.loop, -cut.response(Z)[0, 0])
    same(loop.with_rig(1.1 * UNIT), loop.loop * 1.1)
    same(loop.with_rig(1j * UNIT), loop.loop * 1j)


@pytest.mark.parametrize(("make", "latency", "mass"), CASES)
def test_the_loop_as_a_block_has_its_gain(make: Callable[..., Blocks], latency: int, mass: float) -> None:
    loop, _, blocks = made(make, latency, mass)
    rig = replace(rig_as_identified(ideal_info(latency_samples=latency), mass)[0], ripple_m_s2_per_v=0.0)
    same(loop_block.open_loop(rig, blocks).response(F)[0, 0], loop.loop)


def driven(cut: OpenLoop, source: int) -> ComplexArray:
    """Return every output for one input: 0 what is added to the command, 1-3 ground, 4 and up the samples."""
    return cut.closed(Z)[:, source]


def unit(rows: int, place: int) -> ComplexArray:
    found = np.zeros((rows, len(Z)), dtype=complex)
    found[place] = 1.0
    return found


def compare(motion: Motion, exact: ComplexArray, blocks: Blocks, source: int) -> None:
    """Compare all signals of a motion; exact: command wanted, corrected (3), desired, shear, storeys."""
    same(motion.command_v, exact[0] + (1.0 if source == 0 else 0.0))
    same(motion.corrected, exact[1:4])
    same(motion.desired, exact[4])
    ahead = Z**blocks.lead_samples
    same(motion.tracking, exact[4] - exact[1] * ahead)
    same(motion.storeys[-3:], exact[1:4] * ahead)


def sources(source: int) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
    """Return ground, samples and rounding of one unit input."""
    ground, samples = np.zeros((3, len(Z)), dtype=complex), np.zeros((3, len(Z)), dtype=complex)
    if 1 <= source <= 3:
        ground = unit(3, source - 1)
    if source >= 4:
        samples = unit(3, source - 4)
    return ground, samples, UNIT if source == 0 else None


@pytest.mark.parametrize("source", range(7))
@pytest.mark.parametrize(("make", "latency", "mass"), CASES)
def test_every_disturbance_of_a_hybrid_test(
    make: Callable[..., Blocks], latency: int, mass: float, source: int
) -> None:
    loop, cut, blocks = made(make, latency, mass)
    motion, exact = hybrid(loop, *sources(source)), driven(cut, source)
    compare(motion, exact, blocks, source)
    same(motion.shear_n, exact[5])
    upper = exact[6:-1]
    assert len(motion.storeys) == len(upper) + 3
    same(motion.storeys[: len(upper)], upper)


@pytest.mark.parametrize("make", [paper_like, best_like])
def test_ground_motion_makes_what_the_compiled_loops_matrix_says(make: Callable[..., Blocks]) -> None:
    """That matrix equals every signal of a compiled run (tests/loop/test_closed_loop.py)."""
    loop, _, blocks = made(make)
    matrix = closed_loop(ideal_info(), blocks)
    for column in range(3):
        motion = hybrid(loop, *sources(1 + column))
        states = np.array([np.linalg.solve(z * np.eye(len(matrix.M)) - matrix.M, matrix.N[:, column]) for z in Z])
        both = np.concatenate([states, np.tile(np.eye(3)[column], (len(Z), 1))], axis=1)
        signals = {name: rows @ both.T for name, rows in matrix.rows.items()}
        same(motion.command_v, signals["command_v"][0])
        same(motion.desired, signals["desired"][0])
        same(motion.corrected, signals["corrected"])
        same(motion.shear_n, signals["base_shear_n"][0])


def test_a_net_ripple_of_the_rig_acts_like_less_of_its_correction() -> None:
    info, blocks = ideal_info(), best_like(ideal_info(), ripple=-1.35)
    rig = replace(rig_as_identified(info)[0], ripple_m_s2_per_v=0.4, ripple_sum_m_s2_per_v=0.002)
    assert blocks.ripple_sum_m_s2_per_v == pytest.approx(-0.00135)
    every = numerical_substructure.all_storeys(storeys(), DT_S)
    cut = open_loop(true_rig(info), replace(blocks, ripple_m_s2_per_v=-1.75, ripple_sum_m_s2_per_v=-0.00335))
    same(loop_response(rig, blocks, every, Z).loop, -cut.response(Z)[0, 0])


@pytest.mark.parametrize(("latency", "unstable"), [(1, 0), (24, 2), (40, None)])
def test_turns_about_minus_one_count_unstable_roots(latency: int, unstable: int | None) -> None:
    """Nyquist: all blocks are stable by themselves, so 1 + L turns clockwise once per root outside the circle."""
    blocks = replace(paper_like(ideal_info()), latency_samples=latency)
    rig = replace(rig_as_identified(ideal_info(latency_samples=latency))[0], ripple_m_s2_per_v=0.0)
    every = numerical_substructure.all_storeys(storeys(), DT_S)
    roots = np.linalg.eigvals(closed_loop_matrix(rig, blocks))
    modes = np.abs(np.angle(roots[np.abs(roots) > 0.9])) / (2.0 * np.pi * DT_S)
    near = np.outer(modes, 1.0 + 0.2 * np.linspace(-1.0, 1.0, 41) ** 3).ravel()
    f = np.unique(np.concatenate([np.geomspace(1e-4, 1.0, 100), np.linspace(1.0, 1000.0, 600), near]))
    f = f[(f >= 1e-4) & (f <= 1000.0)]
    loop = loop_response(rig, blocks, every, points(f, DT_S)).loop
    turns = np.sum(np.diff(np.unwrap(np.angle(1.0 + loop)))) / np.pi
    outside = int(np.sum(np.abs(roots) > 1.0))
    assert -turns == pytest.approx(outside, abs=0.02)
    assert unstable is None or outside == unstable


def whole_building(below: Numerical, mass: float) -> ComplexArray:
    """Return the exact absolute accelerations per ground acceleration, (n_storeys, m)."""
    M, C, K = assemble(below, specimen(), mass)
    found = []
    for f in F[:10]:
        s = 2j * np.pi * f
        found.append(1.0 - s**2 * np.linalg.solve(M * s**2 + C * s + K, M @ np.ones(len(M))))
    return np.array(found).T


@pytest.mark.parametrize(("make", "count", "mass"), [(best_like, 1, 0.0), (best_like, 1, 1.2), (several, 3, 0.0)])
def test_on_a_perfect_table_the_building_is_whole_when_the_step_shrinks(
    make: Callable[..., Blocks], count: int, mass: float
) -> None:
    """A Kalman filter that knows the table's motion, prediction and straight lines: second order."""
    below, errors = storeys(count, mass_kg=6.93 - mass), []
    floors = floors_per_table(F[:10])
    for dt_s in (1e-3, 5e-4, 2.5e-4):
        info = ideal_info(dt_s=dt_s)
        shear = kalman_filter.predicted_shear(specimen(), mass, 2, dt_s)
        blocks = replace(
            best_like(ideal_info(), mass, numerical_storeys=count),
            estimator=kalman_filter.kalman_block(specimen(), 1e3, 1.0, dt_s, knows_table=True),
            numerical=numerical_substructure.interface(below, dt_s),
            interface=Interface(shear),
        )
        rig, _ = rig_as_identified(info, mass)
        z = points(F[:10], dt_s)
        loop = loop_response(rig, blocks, numerical_substructure.all_storeys(below, dt_s), z)
        motion = on_perfect_table(loop, floors, np.ones((3, 10), dtype=complex))
        exact = whole_building(below, mass)
        assert motion.storeys.shape == exact.shape
        errors.append(float(np.abs(motion.storeys - exact).max()))
        assert np.abs(motion.tracking).max() < 1e-12
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.2)
    assert errors[-1] < 5e-3


def test_a_perfect_table_moves_as_desired_and_late_by_the_lead() -> None:
    """The samples of a rig without any dynamics: the desired acceleration, n_p samples later on the table's clock."""
    loop, _, _ = made(best_like, z=points(F[:10], DT_S))
    floors = floors_per_table(F[:10])
    motion = on_perfect_table(loop, floors, np.full((3, 10), 2.0 + 0.0j))
    same(motion.corrected, floors * motion.desired * points(F[:10], DT_S) ** -2)
    shear = np.sum(loop.from_samples * motion.corrected, axis=0) + loop.from_desired * motion.desired
    same(motion.shear_n, shear)
    same(motion.desired, 2.0 * loop.numerical[0, 0] + loop.numerical[0, 1] * shear)
