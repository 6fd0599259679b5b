"""The loop's error by the residual of the computed storeys, beside the error against an exact solution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from rths_cli.experiment.error_after_run import loop_error, loop_error_lines, residual_of_computed_storeys
from rths_cli.structure import Building, Numerical, Specimen, assemble, modal_damping_matrix, storey_matrix
from rths_cli.structure.tangents import with_specimen

DT = 1e-3


def building(p: int = 2, stiffness: float = 1.0) -> Building:
    masses, k = np.array([6.0, 4.0]), stiffness * np.array([9000.0, 5000.0])
    K = storey_matrix(k)
    specimen = Specimen(masses, K, modal_damping_matrix(masses, K, np.array([0.02, 0.01])))
    own = np.array([7.0, 5.0, 8.0])[:p]
    numerical = Numerical(own, storey_matrix(np.full(p, 8000.0)), storey_matrix(np.full(p, 14.0)))
    return Building(numerical, specimen, 1.5, *assemble(numerical, specimen, 1.5))


def exact(of: Building, inputs: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Return absolute accelerations of a building under ground acceleration (inputs[0]) and forces (inputs[1:])."""
    n, M = len(of.M), np.linalg.inv(of.M)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-M @ of.K, -M @ of.C]])
    b = np.vstack([np.zeros((n, 1 + forced.shape[1])), np.hstack([-np.ones((n, 1)), M @ forced])])
    outputs = np.hstack([np.zeros((n, 1)), M @ forced])
    time_s = DT * np.arange(inputs.shape[1])
    return np.asarray(lsim(StateSpace(a, b, a[n:], outputs), inputs.T, time_s)[1].T)


def ground(samples: int = 12000) -> np.ndarray:
    smooth = np.convolve(np.random.default_rng(3).standard_normal(samples + 60), np.hanning(61) / 30.0, "valid")
    return np.asarray(smooth[:samples] * np.hanning(samples))


@pytest.mark.parametrize("p", [1, 3])
def test_a_push_at_the_interface_is_found_as_the_error_that_it_makes(p: int) -> None:
    """The test is the undivided building with a wrong force on the interface, which no sensor shows as such."""
    of, accel = building(p), ground()
    push = 3.0 * np.roll(accel, 400)
    forced = np.eye(len(of.M))[:, [p - 1]]
    sim, test = exact(of, np.vstack([accel, 0.0 * push]), forced), exact(of, np.vstack([accel, push]), forced)
    found = loop_error(of, DT, residual_of_computed_storeys(of, DT, accel, test))
    wanted = test - sim
    assert np.abs(wanted).max() > 0.05
    assert np.abs(found - wanted).max() < 2e-3 * np.abs(wanted).max()
    assert np.abs(residual_of_computed_storeys(of, DT, accel, sim)).max() < 1e-4 * np.abs(sim).max()


def test_a_specimen_that_is_softer_than_taken_does_not_look_like_an_error_of_the_loop() -> None:
    taken, there, accel = building(), building(stiffness=0.8), ground()
    forced = np.eye(4)[:, [1]]
    test = exact(there, np.vstack([accel, 0.1 * np.roll(accel, 300)]), forced)
    wanted = test - exact(there, np.vstack([accel, 0.0 * accel]), forced)
    against_taken = test - exact(taken, np.vstack([accel, 0.0 * accel]), forced)
    found = loop_error(taken, DT, residual_of_computed_storeys(taken, DT, accel, test))
    right = loop_error(with_specimen(taken, 0.8), DT, residual_of_computed_storeys(taken, DT, accel, test))
    size = np.sqrt(np.mean(wanted**2, axis=1))
    assert np.all(np.sqrt(np.mean(found**2, axis=1)) < 3.0 * size)
    assert np.all(np.sqrt(np.mean(against_taken**2, axis=1)) > 10.0 * size)
    assert np.abs(right - wanted).max() < 0.3 * np.abs(wanted).max()  # its damping matrix is scaled otherwise


@pytest.mark.parametrize("p", [1, 3])
def test_the_loop_error_of_one_frequency_is_that_of_its_series(p: int) -> None:
    of, hz = building(p), 4.7
    time_s, n = DT * np.arange(60000), len(of.M)
    reported = np.array([np.sin(2.0 * np.pi * hz * time_s + phase) for phase in np.arange(n)])
    reported *= np.minimum(time_s / 10.0, 1.0) ** 2
    series = loop_error(of, DT, residual_of_computed_storeys(of, DT, 0.0 * time_s, reported))[:, 40000:]
    lines = loop_error_lines(of, np.array([hz]), np.exp(1j * (np.arange(n) - 0.5 * np.pi))[:, None])
    wanted = (lines * np.exp(2j * np.pi * hz * time_s[40000:])).real
    assert np.abs(series - wanted).max() < 0.03 * np.abs(wanted).max()
