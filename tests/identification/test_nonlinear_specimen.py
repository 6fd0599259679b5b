"""A specimen whose springs soften and whose joints rub, found at two levels, moves at others as it should.

The oracle is an integration of its own (central differences): of softening springs and joints with numbers that are no
multiples of those which the identification tries, and of what was identified.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import signal

from rths_cli.identification.identify_specimen import identify_nonlinear
from rths_cli.identification.results import NonlinearSpecimen
from rths_cli.identification.specimen_fit import Motion, Start, fit_specimen

DT = 5e-4
TIME = np.arange(80000) * DT
MASSES, STIFFNESS, DASHPOTS = np.array([7.0, 7.0]), np.array([7300.0, 7400.0]), np.array([20.0, 15.0])
BAND_HZ = 0.5, 13.5
Force = Callable[[float], float]


def softening(k: float, share: float, half_m: float) -> Force:
    return lambda u: k * u * (1.0 - share * abs(u) / (abs(u) + half_m))


def joint(limit_n: float, sticks_m: float) -> Force:
    held = [0.0]  # place of the slider

    def force(u: float) -> float:
        held[0] = min(max(held[0], u - sticks_m), u + sticks_m)
        return limit_n * (u - held[0]) / sticks_m

    return force


def touched(k: float, beyond_m: float) -> Force:
    return lambda u: k * (max(u - beyond_m, 0.0) + min(u + beyond_m, 0.0))


def moved(table: np.ndarray, storeys: list[list[Force]], dashpots: np.ndarray) -> np.ndarray:
    """Return the absolute accelerations (2, n) of two floors with these forces of drifts, by central differences."""
    (m1, m2), ((c11, c12), (c21, c22)) = MASSES.tolist(), dashpots.tolist()
    x1 = x2 = v1 = v2 = 0.0
    found = np.empty((2, len(table)))
    for n, ground in enumerate(table.tolist()):
        d1, d2 = v1, v2 - v1
        f1 = sum(force(x1) for force in storeys[0]) + c11 * d1 + c12 * d2
        f2 = sum(force(x2 - x1) for force in storeys[1]) + c21 * d1 + c22 * d2
        a1, a2 = (f2 - f1) / m1, -f2 / m2
        found[0, n], found[1, n] = a1, a2
        v1, v2 = v1 + DT * (a1 - ground), v2 + DT * (a2 - ground)
        x1, x2 = x1 + DT * v1, x2 + DT * v2
    return found


def as_it_is(table: np.ndarray, share: float, limit_n: float) -> np.ndarray:
    storeys = [[softening(k, share, 0.0013), joint(limit_n, 7e-5)] for k in STIFFNESS]
    return moved(table, storeys, np.diag(DASHPOTS))


def as_found(table: np.ndarray, found: NonlinearSpecimen) -> np.ndarray:
    storeys: list[list[Force]] = []
    for i, k in enumerate(found.stiffness_n_per_m):
        joints = [joint(*each) for each in zip(found.joint_n[i], found.joint_m[i], strict=True)]
        bends = [touched(*each) for each in zip(found.bend_n_per_m[i], found.bend_m[i], strict=True)]
        storeys.append([softening(k, 0.0, 1.0), *joints, *bends])
    return moved(table, storeys, found.dashpots_n_s_per_m)


def table_motion(rms_m_s2: float, seed: int) -> np.ndarray:
    sections = signal.butter(4, [0.7, 12.0], "band", fs=1.0 / DT, output="sos")
    motion = signal.sosfilt(sections, np.random.default_rng(seed).standard_normal(len(TIME) + 20000))[20000:]
    return rms_m_s2 * motion / motion.std() * np.minimum(1.0, np.minimum(TIME, TIME[::-1]))


@cache
def records(share: float, limit_n: float, noise_m_s2: float = 0.0) -> tuple[Motion, Motion]:
    """Return records at full and at low level, 2 and 0.4 m/s^2."""
    random, found = np.random.default_rng(5), []
    for level, seed in ((2.0, 1), (0.4, 2)):
        table = table_motion(level, seed)
        seen = np.vstack([table, as_it_is(table, share, limit_n)])
        seen = seen + noise_m_s2 * random.standard_normal(seen.shape)
        found.append(Motion(seen[0], seen[1:]))
    return found[0], found[1]


def identified(*specimen: float) -> NonlinearSpecimen | None:
    loud, quiet = records(*specimen)
    return identify_nonlinear([loud], quiet, DT, MASSES, STIFFNESS, BAND_HZ)


@pytest.mark.campaign
@pytest.mark.parametrize("level_m_s2", [0.25, 1.0])
def test_a_specimen_found_at_two_levels_moves_at_others_as_it_does(level_m_s2: float) -> None:
    found = identified(0.02, 0.1)
    assert found is not None
    table = table_motion(level_m_s2, 3)
    truth = as_it_is(table, 0.02, 0.1)
    start = Start(STIFFNESS, np.array([0.04, 0.04]))
    linear = fit_specimen([records(0.02, 0.1)[0]], DT, MASSES, BAND_HZ[0], start)
    straight = replace(
        found,
        stiffness_n_per_m=linear.stiffness_n_per_m,
        dashpots_n_s_per_m=by_drifts(linear.specimen.C),
        joint_n=0.0 * found.joint_n,
        bend_n_per_m=0.0 * found.bend_n_per_m,
    )
    off, by_linear = (np.std(as_found(table, each) - truth, axis=1) for each in (found, straight))
    assert (off < 0.25 * by_linear).all()


def by_drifts(dampers: np.ndarray) -> np.ndarray:
    """Return a damping matrix (2, 2) of displacements as one of storeys' drifts."""
    summed = np.tril(np.ones((2, 2)))
    return np.asarray(summed.T @ dampers @ summed)


@pytest.mark.campaign
def test_its_specimen_and_laws_are_what_was_found() -> None:
    found = identified(0.02, 0.1)
    assert found is not None
    specimen, laws = found.specimen(MASSES), found.laws
    at_rest = found.stiffness_n_per_m + (found.joint_n / found.joint_m).sum(axis=1)
    assert pytest.approx(np.array([[at_rest.sum(), -at_rest[1]], [-at_rest[1], at_rest[1]]])) == specimen.K
    assert by_drifts(specimen.C) == pytest.approx(found.dashpots_n_s_per_m)
    assert laws.storey.tolist() == sorted(laws.storey.tolist()) and set(laws.storey.tolist()) == {0, 1}
    assert found.possible and not replace(found, bend_n_per_m=found.bend_n_per_m - 2000.0).possible
    assert not replace(found, dashpots_n_s_per_m=-found.dashpots_n_s_per_m).possible


@pytest.mark.campaign
def test_a_linear_specimen_is_linear() -> None:
    assert identified(0.0, 0.0) is None
    assert identified(0.0, 0.0, 0.02) is None


@pytest.mark.campaign
def test_what_noise_hides_is_not_found() -> None:
    assert identified(0.02, 0.1, 1.0) is None


def test_bends_that_no_drift_reaches_are_left_out() -> None:
    # both records at one level: no drift is eight times the rms one
    quiet = records(0.02, 0.1)[1]
    found = identify_nonlinear([quiet], quiet, DT, MASSES, STIFFNESS, BAND_HZ)
    assert found is not None
    assert (np.abs(found.bend_n_per_m[:, -1]) < 1e-12 * STIFFNESS).all() and found.joint_n.any()
