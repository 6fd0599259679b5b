"""The table's compliance, and the command that counters a reaction which the identified specimen does not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, linear_table, specimen
from hybrid import true_model
from scipy.signal import ss2tf

from rths_cli.control.kalman_filter import open_loop, specimen_state_space
from rths_cli.control.reaction import (
    Compliance,
    compliance,
    reaction_block,
    table_with_another,
    with_reaction,
)
from rths_cli.control.state_space import from_roots, static
from rths_cli.errors import InputError
from rths_cli.structure import Specimen

MASS_KG = LINEAR.moving_mass_kg + LINEAR.loop_specimen_mass_kg
N_PER_V = MASS_KG * (2.0 * np.pi * LINEAR.loop_frequency_hz) ** 2 * LINEAR.gain_m_per_v  # of the displacement loop
F = np.array([0.5, 2.0, 3.2, 5.0, 8.4, 12.0, 20.0])
S = 2j * np.pi * F


def damaged(factor: float) -> Specimen:
    return replace(specimen(), K=factor * specimen().K)


def test_the_compliance_of_a_known_table_is_found() -> None:
    """A force F acts like the command (1 + tau s) F / (K g): the displacement loop is a spring K behind the lag tau."""
    found = compliance(true_model(0.00075), specimen())
    assert found.volts_per_newton == pytest.approx(1.0 / N_PER_V, rel=1e-6)
    assert found.lag_s == pytest.approx(LINEAR.actuator_time_constant_s, rel=1e-5)
    assert found.misfit < 1e-8


def test_a_model_that_no_such_table_has_is_refused() -> None:
    model = true_model(0.00075)
    with pytest.raises(InputError, match=r"reaction_feedforward: .* does not show how .* remove the key"):
        compliance(replace(model, zeros=np.where(model.zeros != 0.0, 1.2 * model.zeros, 0.0)), specimen())


@pytest.mark.parametrize("lag_s", [1.5e-4, -1.5e-4])
def test_a_lag_that_would_be_negative_is_none(lag_s: float) -> None:
    """A table made of its equation s^2 / G = p(s) + rho (1 + lag s) s^2 M(s)."""
    system, rho, gain = specimen_state_space(specimen()), 8e-4, 0.0079
    above, below = ss2tf(system.A, system.B, (specimen().masses_kg @ system.C)[None], np.zeros((1, 1)))
    alone = np.polymul([LINEAR.actuator_time_constant_s, 1.0], [1.0 / (2 * np.pi * 30.0) ** 2, 2e-3, 1.0]) / gain
    reacts = np.polymul([rho * lag_s, rho, 0.0, 0.0], above[0])
    whole = np.polyadd(np.polymul(alone, below), reacts)
    zeros = np.concatenate([[0.0, 0.0], np.roots(below)])
    made = replace(true_model(0.0), zeros=zeros, poles=np.roots(whole), gain=below[0] / whole[0])
    found = compliance(made, specimen())
    assert found.lag_s == pytest.approx(max(lag_s, 0.0), abs=1e-7)
    assert found.volts_per_newton == pytest.approx(rho, rel=0.02)


@pytest.mark.parametrize("factor", [0.5, 0.7, 1.3])
def test_a_table_with_another_specimen_is_that_of_its_equations_of_motion(factor: float) -> None:
    model = true_model(0.0)
    table = from_roots(model.zeros, model.poles, model.gain)
    found = table_with_another(table, specimen(), damaged(factor), compliance(model, specimen())).response(F)[:, 0]
    a, b, _, true = linear_table(LINEAR, damaged(factor), 1.0)
    a, b, rows = a[:7, :7], b[:7], true[:, :7]
    wanted = np.array([rows @ np.linalg.solve(s * np.eye(7) - a, b) for s in S]).T
    assert found == pytest.approx(wanted, rel=1e-5)


def test_the_identified_specimen_needs_no_further_command() -> None:
    block = reaction_block(specimen(), Compliance(1.0, 0.0, 0.0), 0.0, 40.0, DT_S)
    floors = open_loop(specimen(), DT_S).response(F)[:, 0]
    by_table, by_floors = block.response(F)[0, 0], np.sum(block.response(F)[0, 1:] * floors, axis=0)
    assert np.abs(by_table + by_floors).max() < 2e-5 * np.abs(by_table).max()  # straight lines between samples


def test_a_changed_reaction_is_countered_ahead_of_lag_and_delay() -> None:
    """Up to half the corner the command is that which the changed table needs, -rho (1 + lag s) exp(s delay) F."""
    table, delay, change = Compliance(1e-3, 1.5e-3, 0.0), 7.5e-4, damaged(0.7)
    block = reaction_block(specimen(), table, delay, 200.0, DT_S)
    floors, expected = (open_loop(one, DT_S).response(F)[:, 0] for one in (change, specimen()))
    force = -specimen().masses_kg @ (floors - expected)
    wanted = -table.volts_per_newton * (1.0 + table.lag_s * S) * np.exp(S * delay) * force
    found = block.response(F)[0, 0] + np.sum(block.response(F)[0, 1:] * floors, axis=0)
    assert np.abs(found - wanted) == pytest.approx(0.0, abs=0.03 * np.abs(wanted).max())
    assert np.abs(found[:4] / wanted[:4] - 1.0).max() < 0.01


def test_both_commands_are_added() -> None:
    block = reaction_block(specimen(), Compliance(1e-3, 1e-3, 0.0), 0.0, 40.0, DT_S)
    motion = static(np.array([[1.0, 2.0, 3.0]]), DT_S, "feedforward", ("a", "v", "x"), ("feedforward_v",))
    both = with_reaction(motion, block).response(F)
    assert both[0, :3] == pytest.approx(np.array([1.0, 2.0, 3.0])[:, None] + np.zeros(len(F)))
    assert both[0, 3:] == pytest.approx(block.response(F)[0])
