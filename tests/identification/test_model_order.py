"""Records of tables whose structure is known: that structure is chosen, and its roots come back."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from made_linear import DT
from made_records import make_info, make_specimen
from portfolio import parametrize_first

from rths_cli.findings import sentences
from rths_cli.identification import model_order
from rths_cli.identification.excitation import ExcitationSettings, Kind, plan
from rths_cli.identification.frequency_response import estimate, simulate, without_leakage
from rths_cli.identification.model_order import choose, doubtful
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.results import Candidate
from rths_cli.identification.table_fit import Fit, Layout, Timing, first_fit, pack, refit
from rths_cli.numerics.lti import Array, Frf, Model

MODES = ((3.2, 0.043), (8.4, 0.039))
SEGMENT_S, BAND_HZ = 12.0, (0.5, 60.0)
Pairs = tuple[tuple[float, float], ...]


def roots(pairs: Pairs) -> np.ndarray:
    """Return the roots of pairs (Hz, damping ratio) in rad/s."""
    return np.concatenate([2.0 * np.pi * hz * np.roots([1.0, 2.0 * z, 1.0]).astype(complex) for hz, z in pairs])


def table(lags_hz: tuple[float, ...], extra_s: float, frame: Pairs, modes: Pairs = MODES) -> Model:
    """Return a table of two coupled modes and a 14 Hz loop; `frame`: a pole and a zero pair more."""
    lags = -2.0 * np.pi * np.array(lags_hz, dtype=complex)
    poles = np.concatenate([roots(((3.14, 0.045), (8.35, 0.042), (14.0, 0.6), *frame[:1])), lags])
    zeros = np.concatenate([[0.0, 0.0], roots((*modes, *frame[1:]))])
    gain = 0.0079 * float(np.real(np.prod(-poles) / np.prod(-zeros[2:])))
    return Model(zeros, poles, gain, 1.5 * DT + extra_s, BAND_HZ, -1.4, 1, DT)


@cache
def command(kind: Kind) -> tuple[Array, Parts]:
    planned = plan(make_info(make_specimen()), ExcitationSettings(duration_s=60.0, kind=kind), 5)
    return planned.command_v, planned.parts


def chosen(truth: Model, noise_m_s2: float, kind: Kind = "noise") -> tuple[Fit, tuple[Candidate, ...]]:
    """Return the structure chosen from a record of a table, fitted to the response without its leakage."""
    command_v, parts = command(kind)
    noise = noise_m_s2 * np.random.default_rng(1).standard_normal(len(command_v))
    record = Record(command_v, (simulate(truth, command_v, 90.0) + noise)[None], parts)
    raw = estimate([record], DT, BAND_HZ, SEGMENT_S)[0]
    first = first_fit(raw, (np.array([3.2, 8.4]), np.array([0.043, 0.039])), Timing(1, DT), BAND_HZ)
    found, candidates, _ = choose(*improved(first, raw, record), [record], "h1", False)
    return improved(found, raw, record)[0], candidates


def improved(found: Fit, raw: Frf, record: Record) -> tuple[Fit, Frf]:
    for _ in range(3):
        clean = without_leakage(raw, found.model, [record], SEGMENT_S)
        found = refit(clean, found)
    return found, clean


@pytest.mark.campaign
@parametrize_first(
    3,
    ("name", "lags_hz", "extra_s", "frame", "noise_m_s2"),
    [
        ("no lag", (), 0.0, (), 1e-2),
        ("one lag", (80.0,), 0.0, (), 1e-2),
        ("two lags", (30.0, 90.0), 0.0, (), 1e-2),
        ("two lags", (60.0, 100.0), 0.0, (), 1e-3),
        ("one lag, delay fitted", (80.0,), 1e-3, (), 1e-2),
        ("one lag, delay fitted", (80.0,), 3e-3, (), 1e-3),
        ("one lag, one more mode", (80.0,), 0.0, ((30.0, 0.04), (31.5, 0.04)), 1e-2),
    ],
)
def test_known_structure_is_chosen_and_its_roots_come_back(
    name: str, lags_hz: tuple[float, ...], extra_s: float, frame: Pairs, noise_m_s2: float
) -> None:
    truth = table(lags_hz, extra_s, frame)
    found, candidates = chosen(truth, noise_m_s2)
    assert [candidate.name for candidate in candidates if candidate.chosen] == [name]
    assert doubtful(found) == ()
    score = next(candidate.held_out for candidate in candidates if candidate.chosen)
    assert score < 2.0
    assert len(found.model.poles) == len(truth.poles)
    for one, other in ((found.model.poles, truth.poles), (found.model.zeros[2:], truth.zeros[2:])):
        apart = np.abs(one[:, None] / other[None, :] - 1.0)
        assert apart.min(axis=0).max() < 0.02 * max(1.0, noise_m_s2 / 1e-3 * 0.5)
    assert found.model.delay_s == pytest.approx(truth.delay_s, abs=5e-5)
    f = np.linspace(1.0, 40.0, 100)
    assert np.abs(found.model.response(f) / truth.response(f) - 1.0).max() < 0.005


@pytest.mark.parametrize(
    ("pole", "zero", "told"),
    [
        (
            (167.0, 0.09),
            (900.0, 0.93),
            ["pole pair at 167 Hz: it resonates far above 60 Hz, where nothing was measured"],
        ),
        ((167.0, 0.9), (130.0, 0.1), ["zero pair at 130 Hz: it resonates far above 60 Hz, where nothing was measured"]),
        ((110.0, 0.09), (900.0, 0.93), []),
    ],
)
def test_a_pair_that_resonates_far_above_the_band_is_doubted(
    pole: tuple[float, float], zero: tuple[float, float], told: list[str]
) -> None:
    layout = Layout(1, 0, 1, 0.0)
    parameters = pack(1.0, np.array([pole]) * [2 * np.pi, 1.0], np.zeros(0), np.array([zero]) * [2 * np.pi, 1.0])
    model = Model(np.zeros(0), np.zeros(0), 1.0, 0.0, BAND_HZ, 0.0, 1, DT)
    assert list(sentences(doubtful(Fit(model, layout, parameters, 1e-6 * np.eye(5))))) == told


def test_score_of_the_right_structure_is_about_one_where_noise_rules() -> None:
    _, candidates = chosen(table((80.0,), 0.0, ()), 0.05)
    scores = {candidate.name: candidate.held_out for candidate in candidates}
    assert 0.85 < scores["one lag"] < 1.15
    assert scores["no lag"] > 5.0


@pytest.mark.parametrize("kind", ["multisine", "step"])
def test_one_lag_is_enough_under_other_excitations(kind: Kind) -> None:
    found, candidates = chosen(table((80.0,), 0.0, ()), 1e-2, kind)
    assert [candidate.name for candidate in candidates if candidate.chosen] == ["one lag"]
    assert found.model.poles.real.min() == pytest.approx(-2.0 * np.pi * 80.0, rel=0.01)


def test_zeros_that_are_not_the_specimen_s_are_set_free() -> None:
    """Masses weighed wrongly put the held zeros in the wrong place."""
    truth = table((80.0,), 0.0, (), modes=((3.27, 0.05), (8.15, 0.039)))
    found, candidates = chosen(truth, 1e-3)
    assert [candidate.name for candidate in candidates if candidate.chosen] == ["one lag, zeros free"]
    apart = np.abs(found.model.zeros[2:, None] / truth.zeros[None, 2:] - 1.0)
    assert apart.min(axis=0).max() < 1e-3


def test_a_structure_is_judged_by_the_half_it_was_not_fitted_to() -> None:
    f = np.arange(0.5, 60.05, 0.1)
    poles = 2.0 * np.pi * np.concatenate([14.0 * np.roots([1.0, 1.2, 1.0]), [-100.0]]).astype(complex)
    truth = Model(np.zeros(2, dtype=complex), poles, 30.0, 7.5e-4, (0.5, 60.0), -1.4, 1, 5e-4)
    known = np.full(len(f), 1e-3)
    one = Frf(f, truth.sampled_response(f), np.ones(len(f)), known, 20)
    other = Frf(f, 1.02 * one.response, np.ones(len(f)), known, 20)  # another day, another gain
    base = first_fit(one, (np.zeros(0), np.zeros(0)), Timing(1, 5e-4), (0.5, 60.0))
    as_it_is = model_order.Trial("one lag", base.layout, base.parameters, base.held_zeros)
    found = model_order.held_out_error(as_it_is, base, (one, other))
    assert found == pytest.approx(0.02 / (np.sqrt(2.0) * np.hypot(1e-3, 1e-3)), rel=0.03)


@pytest.mark.parametrize("noise_m_s2", [1.8, 2.5])
def test_a_lag_that_the_data_determine_stays_also_where_noise_hides_its_use(noise_m_s2: float) -> None:
    """Without it the held-out error is less than a ninth larger, but the table far above the band is another one."""
    truth = table((250.0,), 0.0, ())
    found, candidates = chosen(truth, noise_m_s2)
    scores = {candidate.name: candidate.held_out for candidate in candidates}
    assert scores["one lag"] < scores["no lag"] < scores["one lag"] / model_order.WORTH
    assert [candidate.name for candidate in candidates if candidate.chosen] == ["one lag"]
    f = np.array([100.0, 300.0, 900.0])
    assert np.abs(found.model.response(f) / truth.response(f) - 1.0).max() < 0.3
