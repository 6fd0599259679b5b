"""The numerical part in modal coordinates against the block it was made from, step by step in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.control.interface import no_force
from rths_cli.control.numerical_substructure import interface
from rths_cli.errors import InputError
from rths_cli.loop.parts import Room
from rths_cli.loop.storey_forces import Modal, modal
from rths_cli.numerics.compiled import entry
from rths_cli.numerics.lti import Array, Block
from rths_cli.structure import Numerical
from rths_cli.structure.shear_chain import storey_matrix

DT_S = 5e-4


@entry
def played(block: Modal, inputs: Array, outputs: Array, without: Array) -> None:
    ground, force, motion, accel = np.zeros(3), np.zeros(1), np.zeros((3, 1)), np.zeros(1)
    for k in range(inputs.shape[1]):
        ground[0], force[0] = inputs[0, k], inputs[1, k]
        block.free(ground, accel)
        block.advance(ground, force, motion)
        without[k] = accel[0]
        for q in range(3):
            outputs[q, k] = motion[q, 0]


def dense(block: Block, inputs: Array) -> Array:
    x, outputs = np.zeros(len(block.A)), np.zeros((len(block.C), inputs.shape[1]))
    for k in range(inputs.shape[1]):
        outputs[:, k] = block.C @ x + block.D @ inputs[:, k]
        x = block.A @ x + block.B @ inputs[:, k]
    return outputs


def compare(block: Block, tolerance: float, samples: int = 3000) -> None:
    inputs = np.random.default_rng(1).standard_normal((2, samples))
    wanted, found, without = dense(block, inputs), np.zeros((len(block.C), samples)), np.zeros(samples)
    made = modal(block, no_force(1), Room())
    played(made, inputs, found, without)
    for row, other in zip(found, wanted, strict=True):
        assert np.abs(row - other).max() <= tolerance * np.abs(other).max()
    affine = without + made.direct[0, 0] * inputs[1]
    assert np.abs(affine - found[0]).max() <= 1e-12 * np.abs(found[0]).max()


def building(masses: Array, stiffness: Array, dashpots: Array) -> Numerical:
    return Numerical(masses, storey_matrix(stiffness), storey_matrix(dashpots))


@pytest.mark.campaign
@parametrize_first(4, "scheme", ["exact", "cr", "newmark"])
@parametrize_first(4, "storeys", [1, 2, 5, 40])
def test_buildings_of_any_height_move_as_the_block_says(storeys: int, scheme: str) -> None:
    random = np.random.default_rng(storeys)
    one = building(
        random.uniform(3.0, 9.0, storeys), random.uniform(4e3, 9e3, storeys), random.uniform(2.0, 40.0, storeys)
    )
    compare(interface(one, DT_S, scheme), 1e-10)  # type: ignore[arg-type]


@pytest.mark.parametrize("damping", [0.0, 0.999999, 1.0, 1.000001, 5.0, 60.0])
def test_one_storey_without_damping_critically_and_over_damped(damping: float) -> None:
    mass, stiffness = 7.0, 7000.0
    dashpot = 2.0 * damping * np.sqrt(mass * stiffness)
    compare(interface(building(np.array([mass]), np.array([stiffness]), np.array([dashpot])), DT_S), 1e-9)


def test_many_real_eigenvalues() -> None:
    compare(interface(building(np.full(6, 5.0), np.full(6, 300.0), np.full(6, 900.0)), DT_S), 1e-9)


def test_modes_that_coincide_are_told_apart_or_refused() -> None:
    """Two equal Jordan blocks of size two: four equal eigenvalues that no pair can hold."""
    a = np.kron(np.eye(2), np.array([[0.9, 1.0], [0.0, 0.9]])) + np.diag([0.0, 0.01, 0.0], 1)
    block = Block("jordan", a, np.ones((4, 2)), np.ones((1, 4)), np.zeros((1, 2)), DT_S)
    with pytest.raises(InputError, match="coincide"):
        modal(block, no_force(1), Room())
