"""Shifts of roots that no scatter shows, against the fit made again to a response distorted by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_records import make_specimen, true_response

from rths_cli.identification.delay import UNKNOWN_LAW, of_specimen, of_structure, shifts, together
from rths_cli.identification.results import Friction, LevelBand
from rths_cli.identification.specimen_fit import CLOCK, SKEW
from rths_cli.identification.table_fit import Fit, Timing, first_fit, fit, refit
from rths_cli.numerics.bands import USUAL
from rths_cli.numerics.lti import Frf

DT, RATIO = 5e-4, 5.0


@pytest.fixture(scope="module")
def frf() -> Frf:
    f = np.arange(0.5, 60.0, 0.05)
    size = np.full(len(f), 1e-3)
    return Frf(f, true_response(make_specimen(), f), np.ones(len(f)), size, 10)


def levels(change: complex) -> tuple[LevelBand, ...]:
    """Return the same change of the response at low level in every band."""
    return tuple(LevelBand(low, high, 1.0 + change, 1e-6) for low, high in pairwise(USUAL.edges_hz))


def test_shifts_are_those_of_a_fit_to_a_distorted_response(frf: Frf) -> None:
    modes = (np.array([3.2, 8.4]), np.array([0.043, 0.039]))
    found = refit(frf, first_fit(frf, modes, Timing(1, DT), (0.5, 60.0)))
    late = np.exp(-2j * np.pi * frf.frequency_hz * SKEW * DT)
    by_delay = refit(replace(frf, response=frf.response * late), found).parameters - found.parameters
    change = 0.004 * (1.0 - 0.5j)
    share = UNKNOWN_LAW * change / (RATIO - 1.0)
    by_friction = refit(replace(frf, response=frf.response * (1.0 + share)), found).parameters - found.parameters
    got = shifts(found, frf, levels(change), RATIO)
    free = np.ones(len(got), dtype=bool)
    free[found.layout.zeros(found.held_zeros)] = False
    assert got[free] == pytest.approx(np.hypot(by_delay, by_friction)[free], rel=0.05, abs=2e-6)
    assert np.all(got[~free] < 1e-4)  # held
    assert np.all(shifts(found, frf, (), RATIO) <= got + 1e-12)


MODES = (np.array([3.2, 8.4]), np.array([0.043, 0.039]))


@pytest.fixture(scope="module")
def found(frf: Frf) -> Fit:
    return refit(frf, first_fit(frf, MODES, Timing(1, DT), (0.5, 60.0)))


def test_known_friction_moves_roots_as_its_equivalent_dashpot_does(frf: Frf, found: Fit) -> None:
    """A dashpot that is as strong as friction, taken off the response by hand: G / (1 - kappa c G exp(s T) / s)."""
    friction, s = Friction(4e-4, 1e-6, 0.05, 0.99, 1e-3, held_out=0.9), 2j * np.pi * frf.frequency_hz
    accel = found.model.response(frf.frequency_hz) * np.exp(s * found.model.delay_s)
    without = frf.response / (1.0 - friction.command_v * np.sqrt(2.0 / np.pi) / 0.05 * accel / s)
    moved = np.abs(refit(replace(frf, response=without), found).parameters - found.parameters)
    got = np.sqrt(np.maximum(shifts(found, frf, (), RATIO, friction) ** 2 - shifts(found, frf, (), RATIO) ** 2, 0.0))
    poles = slice(1, 2 + 2 * found.layout.pole_pairs)
    assert moved[poles].max() > 1e-3
    assert got[poles] == pytest.approx(moved[poles], rel=0.1, abs=0.02 * moved[poles].max())
    unseen = replace(friction, held_out=0.1)  # the low-level record contradicts it
    assert np.array_equal(shifts(found, frf, (), RATIO, unseen), shifts(found, frf, (), RATIO))


def test_a_mode_beyond_the_band_makes_poles_uncertain_by_what_a_model_that_has_it_says(frf: Frf) -> None:
    s, omega = 2j * np.pi * frf.frequency_hz, 2.0 * np.pi * 90.0
    beyond = 1.0 / (1.0 + 0.1 * s / omega + (s / omega) ** 2)
    bent = replace(frf, response=frf.response * beyond)
    true, missing = (refit(each, first_fit(each, MODES, Timing(1, DT), (0.5, 60.0))) for each in (frf, bent))
    layout = replace(missing.layout, pole_pairs=missing.layout.pole_pairs + 1)
    pairs, single = 1 + 2 * missing.layout.pole_pairs, missing.layout.single_poles
    start = np.insert(missing.parameters, pairs, np.log([omega, 0.05]))
    complete = fit(bent, layout, start, Timing(1, DT), (0.5, 60.0), True, missing.held_zeros)
    got = of_structure(missing, complete)
    off = np.abs(missing.parameters - true.parameters)[1 : pairs + single]
    assert off.max() > 0.01
    assert got[1 : pairs + single] == pytest.approx(off, rel=0.2, abs=0.02 * off.max())
    assert not got[0] and not got[pairs + single :].any()
    scattered = replace(complete, covariance=np.diag(np.full(len(complete.parameters), 1.0)))
    assert not of_structure(missing, scattered).any() and not of_structure(missing, None).any()


def test_a_lag_that_a_better_structure_does_not_have_is_not_known(found: Fit) -> None:
    without = replace(
        found, layout=replace(found.layout, single_poles=0), parameters=np.delete(found.parameters, 7),
        covariance=np.delete(np.delete(found.covariance, 7, 0), 7, 1),
    )  # fmt: skip
    assert np.flatnonzero(np.isnan(of_structure(found, without))).tolist() == [7]


def test_a_pole_is_as_uncertain_as_the_mode_of_the_floors_that_it_is(found: Fit) -> None:
    got = of_specimen(found, np.array([0.01, 0.02]), np.array([0.1, 0.2]))
    hz = np.exp(found.parameters[1:7:2]) / (2.0 * np.pi)
    near = {0.01: np.argmin(np.abs(hz - 3.2)), 0.02: np.argmin(np.abs(hz - 8.4))}
    for size, place in near.items():
        assert got[1 + 2 * place : 3 + 2 * place] == pytest.approx([size, 10.0 * size])
    assert np.count_nonzero(got) == 4
    clock = together(found, np.zeros(len(found.parameters)))
    assert clock[1:8].tolist() == [CLOCK, 0.0, CLOCK, 0.0, CLOCK, 0.0, CLOCK] and not clock[8:].any()


@pytest.mark.parametrize("damping_ratio", [0.01, 0.05])
def test_the_damping_of_a_deck_beyond_the_band_is_as_uncertain_as_its_dashpot_makes_it(
    frf: Frf, damping_ratio: float
) -> None:
    """A deck driven through spring k and dashpot c: (k + c s) / (k + c s + m s^2), of two masses with a known pole."""
    s, omega = 2j * np.pi * frf.frequency_hz, 2.0 * np.pi * 190.0
    carried = 1.0 + 2.0 * damping_ratio * s / omega
    bent = replace(frf, response=frf.response * carried / (carried + (s / omega) ** 2))
    deck = refit(bent, first_fit(bent, MODES, Timing(1, DT), (0.5, 60.0), flexible=True))
    column = 2 * deck.layout.pole_pairs - 1
    found_omega, found_ratio = np.exp(deck.parameters[column : column + 2])
    assert found_omega == pytest.approx(omega, rel=0.05)
    assert found_ratio < 0.7 * damping_ratio  # the dashpot's lead hides its damping
    stated = found_ratio * shifts(deck, bent, (), RATIO)[column + 1]
    assert damping_ratio - found_ratio < 2.0 * stated < 0.2


def test_declared_instants_count_for_command_and_samples(frf: Frf, found: Fit) -> None:
    certain, uncertain = (shifts(found, frf, (), RATIO, skew_s=skew_s) for skew_s in (0.0, 25e-6))
    assert uncertain == pytest.approx(certain * np.hypot(SKEW * DT, np.sqrt(2.0) * 25e-6) / (SKEW * DT), rel=1e-6)
