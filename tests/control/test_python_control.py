"""Conversions to and from python-control: every number comes back, and both programs compute the same from them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import control
import numpy as np
import pytest
from bench import DT_S, ideal_info, specimen
from hybrid import best_like, paper_like, true_model
from open_loop import rig_as_identified

from rths_cli.analysis.closed_loop import closed_loop_matrix, open_loop
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.margins import margins
from rths_cli.control.python_control import from_control, model_from_control, to_control
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, StateSpace

F = np.geomspace(0.05, 0.49 / DT_S, 400)
BLOCKS = best_like(ideal_info())
NAMED = {block.name: block for block in (*BLOCKS.named(), BLOCKS.base_shear(), BLOCKS.staircase())}


def matrices(system: StateSpace | Block) -> tuple[Array, ...]:
    return system.A, system.B, system.C, system.D


def same(found: ComplexArray, wanted: ComplexArray, rel: float = 1e-9) -> None:
    assert np.shape(found) == np.shape(wanted)
    assert np.abs(found - wanted).max() <= rel * np.abs(wanted).max()


def theirs(system: control.StateSpace, frequency_hz: Array = F) -> ComplexArray:
    """Return the frequency response by python-control, (p, m, n)."""
    return np.asarray(control.frequency_response(system, 2.0 * np.pi * frequency_hz, squeeze=False).complex)


def paired(found: ComplexArray, wanted: ComplexArray) -> Array:
    """Return how far each of the found roots is from its own of the wanted ones."""
    left, apart = list(wanted), []
    for root in found:
        nearest = int(np.argmin(np.abs(np.array(left) - root)))
        apart.append(abs(left.pop(nearest) - root))
    assert not left
    return np.array(apart)


@pytest.mark.parametrize("name", NAMED)
def test_a_block_comes_back_with_its_numbers_and_names(name: str) -> None:
    block = NAMED[name]
    there = to_control(block)
    assert there.dt == block.dt_s and (there.ninputs, there.noutputs) == (block.B.shape[1], block.C.shape[0])
    back = from_control(there)
    assert isinstance(back, Block)
    assert all(np.array_equal(*pair) for pair in zip(matrices(back), matrices(block), strict=True))
    assert (back.name, back.inputs, back.outputs, back.dt_s) == (block.name, block.inputs, block.outputs, block.dt_s)


@pytest.mark.parametrize("name", NAMED)
def test_poles_and_response_of_a_block_are_python_controls(name: str) -> None:
    block = NAMED[name]
    there = to_control(block)
    same(theirs(there), block.response(F))
    same(to_control(block, F).frdata, block.response(F), 0.0)
    assert paired(control.poles(there), np.linalg.eigvals(block.A)).max(initial=0.0) < 1e-9


def test_a_continuous_system_comes_back() -> None:
    system = specimen_state_space(specimen())
    there = to_control(system)
    assert there.isctime() and isinstance(back := from_control(there), StateSpace)
    assert all(np.array_equal(*pair) for pair in zip(matrices(back), matrices(system), strict=True))
    same(theirs(there), system.response(F))
    roots = control.poles(there)
    assert paired(roots, np.linalg.eigvals(system.A)).max() < 1e-9 * np.abs(roots).max()


@pytest.mark.parametrize("late", [0.0, 1.5])
def test_the_response_of_a_model_has_its_delay(late: float) -> None:
    model = true_model(late * DT_S)
    same(to_control(model, F).frdata[0, 0], model.response(F), 0.0)


def test_a_model_without_a_delay_is_a_continuous_system_and_comes_back() -> None:
    model = replace(true_model(0.0), dt_s=0.0)  # without the size of a hold
    there = to_control(model)
    same(theirs(there)[0, 0], model.response(F))
    assert paired(control.poles(there), model.poles).max() < 1e-9 * np.abs(model.poles).max()
    back = model_from_control(there, model.band_hz, 0.002)
    same(back.response(F), model.response(F) * np.exp(-2j * np.pi * F * 0.002), 1e-8)
    assert len(back.zeros) == len(model.zeros) and back.band_hz == model.band_hz


def test_a_model_with_a_delay_is_sampled_or_refused() -> None:
    model = true_model(2.5 * DT_S)
    there = to_control(model, dt_s=DT_S)
    assert there.dt == DT_S and np.sum(np.abs(control.poles(there)) < 1e-9) == 2  # two whole samples on their way
    held = control.sample_system(to_control(true_model(0.0)), DT_S, "zoh")
    same(theirs(there), theirs(held) * np.exp(-4j * np.pi * F * DT_S), 1e-8)
    with pytest.raises(InputError, match=r"delay of 1.25 ms .* give dt_s"):
        to_control(model)


def test_a_transfer_function_is_realised_from_its_roots() -> None:
    """The polynomials of a table with specimen: the companion form of them has a condition of 1e16 and more."""
    model = true_model(0.0)
    zeros, poles = np.poly(model.zeros).real, np.poly(model.poles).real
    there = control.tf(model.gain * zeros, poles)
    back = from_control(there)
    assert isinstance(back, StateSpace) and np.linalg.cond(back.A) < 1e6
    same(back.response(F)[0, 0], np.asarray(there(2j * np.pi * F)), 1e-6)
    late, double = (
        from_control(control.tf([1.0], [1.0, 0.0, 0.0], 0.01)),
        from_control(control.tf([2.0], [1.0, 0.0, 0.0])),
    )
    same(late.response(np.array([7.0, 20.0]))[0, 0], np.exp(-4j * np.pi * np.array([7.0, 20.0]) * 0.01))  # type: ignore[union-attr]
    same(double.response(F)[0, 0], -2.0 / (2.0 * np.pi * F) ** 2 + 0j)  # type: ignore[union-attr]
    sampled = from_control(control.tf([0.3, 0.1], [1.0, -0.5, 0.2], 0.01))
    assert isinstance(sampled, Block) and sampled.dt_s == 0.01
    z = np.exp(2j * np.pi * 7.0 * 0.01)
    assert sampled.response(np.array([7.0]))[0, 0, 0] == pytest.approx((0.3 * z + 0.1) / (z * z - 0.5 * z + 0.2))


@pytest.mark.parametrize("count", [1, 2, 300])
def test_a_measured_response_comes_back(count: int) -> None:
    """Two lines stay two lines: python-control reads a list of two frequencies as a range."""
    lines = np.linspace(0.5, 60.0, count)
    measured = Frf(lines, true_model(1.5 * DT_S).response(lines), np.full(count, 0.9), np.full(count, 0.02), 20)
    there = to_control(measured)
    assert there.frdata.shape == (1, 1, count) and np.array_equal(there.omega, 2.0 * np.pi * lines)
    back = from_control(there)
    assert isinstance(back, Frf)
    assert np.array_equal(back.response, measured.response) and back.frequency_hz == pytest.approx(lines, rel=1e-15)
    assert np.all(back.coherence == 1.0) and not back.relative_error.any()
    assert to_control(BLOCKS.feedback, lines).frdata.shape == (1, 2, count)


def test_what_has_no_such_form_is_refused_in_a_sentence() -> None:
    several = control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    with pytest.raises(InputError, match="2 inputs and 2 outputs"):
        model_from_control(several, (0.5, 60.0))
    with pytest.raises(InputError, match="2 inputs and 2 outputs"):
        from_control(control.FRD(np.ones((2, 2, 3)), [1.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="continuous"):
        model_from_control(control.ss(0.5, 1.0, 1.0, 0.0, 0.01), (0.5, 60.0))
    with pytest.raises(InputError, match="without a sample time"):
        from_control(control.ss(0.5, 1.0, 1.0, 0.0, True))
    with pytest.raises(InputError, match="2 zeros and 1 poles"):
        from_control(control.tf([1.0, 0.0, 1.0], [1.0, 1.0]))
    with pytest.raises(InputError, match="got a float"):
        from_control(1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="own lines"):
        to_control(Frf(F, F + 0j, F, F, 1), F)


@pytest.mark.parametrize("make", [paper_like, best_like])
def test_the_loop_of_a_test_closes_in_python_control_as_here(make: Callable[..., Blocks]) -> None:
    """The poles of control.feedback are those of the closed-loop matrix, those of the delay's registers included."""
    rig, blocks = rig_as_identified(ideal_info())[0], make(ideal_info())
    loop = open_loop(rig, blocks)
    closed = control.feedback(to_control(loop), 1)
    found, wanted = control.poles(closed), np.linalg.eigvals(closed_loop_matrix(rig, blocks))
    slow = np.abs(wanted) > 0.5  # of several poles at zero a rounding makes 1e-3
    assert paired(found[np.abs(found) > 0.5], wanted[slow]).max() < 1e-9
    gain = loop.response(F)
    same(theirs(closed), gain / (1.0 + gain), 1e-8)


@pytest.mark.campaign
@pytest.mark.parametrize("make", [paper_like, best_like])
def test_the_margins_of_the_loop_of_a_test_are_python_controls(make: Callable[..., Blocks]) -> None:
    f = np.geomspace(0.5, 0.45 / DT_S, 6000)
    loop = open_loop(rig_as_identified(ideal_info())[0], make(ideal_info()))
    found = margins(loop.response(f)[0, 0], f)
    factors, phases, distances, _, crossed, _ = control.stability_margins(to_control(loop, f), returnall=True)
    factors, phases, crossed = (np.asarray(each) for each in (factors, phases, crossed))
    assert len(phases) > 2 and found.gain_margin == pytest.approx(factors[factors > 1.0].min(), rel=1e-6)
    assert found.phase_margin_deg == pytest.approx(np.abs((phases + 180.0) % 360.0 - 180.0).min(), rel=1e-6)
    assert found.delay_margin_s == pytest.approx((np.deg2rad(phases % 360.0) / crossed).min(), rel=1e-6)
    assert found.sensitivity_peak == pytest.approx(1.0 / np.min(distances), rel=1e-5)


@pytest.mark.campaign
def test_python_control_is_imported_by_its_conversions_alone() -> None:
    code = "import sys, rths_cli.control.python_control; print({'control', 'matplotlib'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.strip() == "set()"
