"""A user's own law in SIM and SIM-DELAY: equal to the built-in one that it repeats, and to an adaptive solver."""

from __future__ import annotations

import numpy as np
import pytest
from repeated_laws import REPEATED, SPRING, own
from scipy.integrate import solve_ivp

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.sim import Response
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building, Numerical, Specimen, assemble, storey_matrix
from rths_cli.structure.storey_laws import Law, arranged


def building(*laws: Law) -> Building:
    """Return two computed storeys with laws in the first, below one that stands on the table."""
    below = Numerical(np.array([6.0, 5.0]), storey_matrix([SPRING, 6000.0]), storey_matrix([3.0, 2.0]))
    above = Specimen(np.array([4.0]), storey_matrix([5000.0]), storey_matrix([2.0]))
    return Building(below, above, 0.0, *assemble(below, above, 0.0), laws=arranged((laws, ())))


def ground(dt_s: float, seconds: float = 4.0) -> Array:
    """Return a motion that is linear between points of 4 ms."""
    coarse = np.arange(0.0, seconds + 1e-9, 0.004)
    accel = 3.0 * np.sin(2.0 * np.pi * 2.3 * coarse) * np.sin(np.pi * coarse / 4.0) ** 2
    return np.interp(np.arange(round(seconds / dt_s)) * dt_s, coarse, accel)


def difference(one: Response, other: Response) -> float:
    """Return the largest difference of displacements, velocities and accelerations over their peaks."""
    pairs = [(getattr(r, name) for r in (one, other)) for name in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2")]
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in pairs)


@pytest.mark.parametrize("name", REPEATED)
def test_a_law_that_repeats_a_built_in_one_gives_its_response(name: str) -> None:
    make, built_in = REPEATED[name]
    ours, theirs = building(make()), building(built_in)
    record = ground(1e-3)
    one, other = (simulate_with_laws(each, 1e-3, record) for each in (ours, theirs))
    assert difference(one, other) < 1e-6
    assert one.laws is not None and other.laws is not None
    assert one.laws.work_j == pytest.approx(other.laws.work_j, abs=1e-6 * np.abs(other.laws.work_j).max())
    if name in ("bilinear", "cubic"):
        late = [simulate_delayed_with_laws(each, 1e-3, record[:1500], 0.005) for each in (ours, theirs)]
        assert difference(*late) < 1e-6 + late[0].error_estimate + late[1].error_estimate


def test_a_smooth_law_agrees_with_an_adaptive_solver() -> None:
    """A cubic spring beside a damper of tanh, written once more as equations of motion."""
    stiff, knee = 4e8, 0.05
    whole, plain = building(own(2, stiff, 0.02, knee)), building()
    record, dt_s = ground(1e-3), 1e-3
    response = simulate_with_laws(whole, dt_s, record)
    M, C, K = plain.M, plain.C, plain.K
    solved = np.linalg.inv(M)

    def rates(t: float, x: Array, k: int) -> Array:
        accel = record[k] + (record[k + 1] - record[k]) * (t / dt_s - k)
        force = stiff * x[0] ** 3 + 5.0 * np.tanh(x[3] / knee)
        pushed = -K @ x[:3] - C @ x[3:] - M.sum(axis=1) * accel
        pushed[0] -= force
        return np.concatenate([x[3:], solved @ pushed])

    points, x = range(0, 2000, 4), np.zeros(6)
    states = [x]
    for k in points:  # the ground is a straight line over 4 ms
        x = solve_ivp(rates, (k * dt_s, (k + 4) * dt_s), x, "DOP853", rtol=1e-11, atol=1e-13, args=(k,)).y[:, -1]
        states.append(x)
    wanted = np.array(states).T
    for found, exact in ((response.rel_disp_m, wanted[:3]), (response.rel_vel_m_s, wanted[3:])):
        assert np.abs(found[:, :2001:4] - exact).max() < 1e-7 * np.abs(exact).max()
    assert np.abs(response.rel_disp_m[0]).max() > 0.003  # where the cubic spring is as stiff as the linear one
