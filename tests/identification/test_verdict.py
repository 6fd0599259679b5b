"""The verdict against made-up errors: where the reach ends, what is unsafe, and uncertainties that hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rths_cli.findings import stated
from rths_cli.identification.results import FitError, Friction, LevelBand, LevelCauses
from rths_cli.identification.table_fit import Timing, first_fit, fit_error, refit
from rths_cli.identification.verdict import (
    LIMITS,
    judge,
    level_bands,
    low_frequency_lag,
    reach_hz,
    residuals,
    roots_given,
    roots_of,
    without_friction,
)
from rths_cli.numerics.lti import Array, Frf, Model

DT, BAND_HZ = 5e-4, (0.5, 60.0)
LINES = np.arange(0.5, 60.05, 0.1)
FINE = FitError(0.001, 0.002, 0.001)


def pair(hz: float, ratio: float) -> np.ndarray:
    return 2.0 * np.pi * hz * np.roots([1.0, 2.0 * ratio, 1.0]).astype(complex)


def table(delay_s: float = 7.5e-4, corner_hz: float = 80.0) -> Model:
    poles = np.concatenate([pair(3.14, 0.045), pair(14.0, 0.6), [-2.0 * np.pi * corner_hz]])
    zeros = np.concatenate([[0.0, 0.0], pair(3.2, 0.043)])
    gain = 0.0079 * float(np.real(np.prod(-poles) / np.prod(-zeros[2:])))
    return Model(zeros, poles, gain, delay_s, BAND_HZ, -1.4, 1, DT)


def measured(model: Model, error: Array, scatter: float = 1e-4) -> Frf:
    """Return a response from which the model differs by a relative error (m,)."""
    response = model.sampled_response(LINES) / (1.0 + error)
    return Frf(LINES, response, np.full(len(LINES), 0.99), np.full(len(LINES), scatter), 20)


def complex_noise(seed: int, size: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    return size * (random.standard_normal(len(LINES)) + 1j * random.standard_normal(len(LINES)))


@pytest.mark.parametrize("bump_hz", [15.0, 25.0, 40.0])
def test_reach_ends_where_the_model_begins_to_err(bump_hz: float) -> None:
    error = 0.06 * np.exp(-(((LINES - bump_hz) / 1.0) ** 2))
    begins = bump_hz - np.sqrt(np.log(0.06 / LIMITS.largest))  # here the bump passes 3 %
    assert reach_hz(table(), measured(table(), error), LIMITS) == pytest.approx(begins, abs=0.25)


def test_exact_model_reaches_to_the_end_of_its_band() -> None:
    assert reach_hz(table(), measured(table(), np.zeros(len(LINES))), LIMITS) == 60.0


@pytest.mark.parametrize("seed", range(10))
def test_scatter_above_eleven_hertz_does_not_end_the_reach(seed: int) -> None:
    error = np.where(LINES > 11.0, complex_noise(seed, 0.02), 0.0)
    assert reach_hz(table(), measured(table(), error, scatter=0.02), LIMITS) == 60.0
    sure = reach_hz(table(), measured(table(), error, scatter=1e-4), LIMITS)  # the same errors, known to be real
    assert sure < 60.0


def test_scatter_of_a_line_below_eleven_hertz_does_not_end_the_reach() -> None:
    error = np.where(np.abs(LINES - 3.1) < 0.05, 0.04, 0.0)
    assert reach_hz(table(), measured(table(), error, scatter=0.02), LIMITS) == 60.0
    assert reach_hz(table(), measured(table(), error, scatter=0.004), LIMITS) == pytest.approx(3.0)


def test_an_error_that_neighbouring_lines_share_does_not_hide_in_their_scatter() -> None:
    inside = (LINES > 4.0) & (LINES < 6.0)
    frf = measured(table(), np.where(inside, 0.08, 0.0))
    noisy = replace(frf, relative_error=np.where(inside, 0.05, 2e-4))
    assert reach_hz(table(), noisy, LIMITS) == pytest.approx(4.1, abs=0.3)


def test_slow_growth_of_the_error_ends_the_reach_by_its_rms() -> None:
    error = np.where(LINES > 11.0, 0.02, 0.0)
    low = int(np.sum((LINES > 0.65) & (LINES < 11.05)))
    ends = 11.0 + 0.1 * low / 3.0  # k of n lines at 2 % make 1 % rms when k = n / 4
    assert reach_hz(table(), measured(table(), error), LIMITS) == pytest.approx(ends, abs=0.5)


def test_error_in_the_first_lines_leaves_no_reach() -> None:
    frf = measured(table(), np.where(LINES < 1.0, 0.05, 0.0))
    assert reach_hz(table(), frf, LIMITS) == 0.0
    assert judge(table(), FINE, frf, LIMITS, ()).feedforward_hz == (0.0, 0.0)


def test_bump_below_eleven_hertz_is_a_reason() -> None:
    frf = measured(table(), 0.06 * np.exp(-(((LINES - 9.0) / 0.3) ** 2)))
    found = judge(table(), FINE, frf, LIMITS, (stated("a warning"),))
    assert not found.accepted
    assert "fit only up to 8." in found.reasons[0]
    assert found.warnings == ("a warning",)


@pytest.mark.parametrize(("delay_s", "corner_hz"), [(7.5e-4, 80.0), (3e-3, 80.0), (0.0, 20.0)])
def test_low_frequency_lag_is_the_slope_of_the_phase(delay_s: float, corner_hz: float) -> None:
    model = table(delay_s, corner_hz)
    f = np.array([0.001, 0.002])
    phase = np.angle(-model.response(f) / f**2)  # of displacement over command
    slope = -np.diff(phase)[0] / (2.0 * np.pi * np.diff(f)[0])
    assert low_frequency_lag(model) == pytest.approx(slope, rel=1e-4)
    assert judge(model, FINE, measured(model, np.zeros(len(LINES))), LIMITS, ()).lag_s == low_frequency_lag(model)


@pytest.mark.parametrize("ratio", [0.01, 3.0])
def test_roots_below_the_band_have_no_part_in_the_low_frequency_gain(ratio: float) -> None:
    """A pair of poles at 0.02 Hz and of zeros at 0.05 Hz, below a band from 0.5 Hz, changes nothing there."""
    model = table(7.5e-4, 80.0)
    low, high = (2.0 * np.pi * np.array([f * np.exp(1j * 2.0), f * np.exp(-1j * 2.0)]) for f in (0.02, 0.05))
    extended = replace(model, poles=np.append(model.poles, low), zeros=np.append(model.zeros, ratio * high))
    assert extended.low_frequency_gain_m_per_v == pytest.approx(model.low_frequency_gain_m_per_v, rel=0.12 * ratio)


@pytest.mark.parametrize(
    ("error", "named"),
    [
        (FitError(0.011, 0.002, 0.001), ["rms in 0.7-11 Hz"]),
        (FitError(0.001, 0.031, 0.001), ["largest in 0.7-11 Hz"]),
        (FitError(0.001, 0.002, 0.0041), ["rms in 2-10 Hz"]),
        (FitError(math.nan, 0.05, 0.001), ["rms in 0.7-11 Hz", "largest in 0.7-11 Hz"]),
        (FINE, []),
    ],
)
def test_each_missed_limit_is_a_reason(error: FitError, named: list[str]) -> None:
    found = judge(table(), error, measured(table(), np.zeros(len(LINES))), LIMITS, ())
    assert found.accepted == (not named)
    assert len(found.reasons) == len(named)
    assert all(name in reason for name, reason in zip(named, found.reasons, strict=True))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("unstable", "poles on or right of the imaginary axis"),
        ("integrator", "poles on or right of the imaginary axis"),
        ("not minimum phase", "zeros right of the imaginary axis"),
        ("one origin", "needs two zeros at the origin"),
        ("three origins", "needs two zeros at the origin"),
    ],
)
def test_unsafe_roots_are_named(change: str, sentence: str) -> None:
    model = table()
    changed = {
        "unstable": replace(model, poles=np.append(model.poles, 1.0)),
        "integrator": replace(model, poles=np.append(model.poles, 0.0)),
        "not minimum phase": replace(model, zeros=np.append(model.zeros, 300.0)),
        "one origin": replace(model, zeros=model.zeros[1:]),
        "three origins": replace(model, zeros=np.append(model.zeros, 0.0)),
    }[change]
    found = judge(changed, FINE, measured(changed, np.zeros(len(LINES))), LIMITS, ())
    assert not found.accepted
    assert len(found.reasons) == 1
    assert sentence in found.reasons[0]
    assert math.isnan(found.lag_s) == (change == "integrator")


def test_residuals_by_band() -> None:
    error = np.where(LINES < 5.05, 0.01, 0.03)
    bands = residuals(table(), measured(table(), error, scatter=0.002))
    assert [band.low_hz for band in bands] == [0.7, 2.0, 5.0, 11.0, 20.0, 40.0]
    assert [band.rms for band in bands[:2]] == pytest.approx([0.01, 0.01])
    assert [band.largest for band in bands[3:]] == pytest.approx([0.03, 0.03, 0.03])
    assert [band.scatter for band in bands] == pytest.approx([0.002 * np.sqrt(2.0)] * 6)
    assert all(band.coherence == 0.99 for band in bands)


def near_one(value: complex, seed: int, size: float) -> Frf:
    error = np.linspace(0.5 * size, 1.5 * size, len(LINES))
    response = value * (1.0 + complex_noise(seed, 1.0) * error)
    return Frf(LINES, response, np.ones(len(LINES)), error, 20)


def test_level_bands_are_the_ratio_and_its_scatter() -> None:
    """The errors stated are those of the real or the imaginary part, as the responses' are."""
    draws = [level_bands(near_one(0.97 - 0.02j, i, 0.05), near_one(1.01, 1000 + i, 0.02)) for i in range(100)]
    for band in range(6):
        ratio = np.array([bands[band].ratio for bands in draws])
        stated = np.mean([bands[band].error for bands in draws])
        assert ratio.mean() == pytest.approx((0.97 - 0.02j) / 1.01, abs=4.0 * stated / 10.0)
        assert ratio.real.std() == pytest.approx(stated, rel=0.25)
        assert ratio.imag.std() == pytest.approx(stated, rel=0.25)


def test_level_bands_against_the_model_itself() -> None:
    (first, *_) = level_bands(near_one(0.9, 1, 1e-6), None)
    assert (first.low_hz, first.high_hz) == (0.7, 2.0)
    assert first.ratio == pytest.approx(0.9, abs=1e-5)


def test_friction_that_other_levels_show_rejects() -> None:
    bands = [LevelBand(0.7, 2.0, 1.10 + 0j, 0.001), LevelBand(2.0, 11.0, 1.0 + 0j, 0.001)]
    share = 1.25 * 0.10 * np.sqrt(1.3 / 10.3) / 3.0  # rms over the bands' widths, at level ratio 4
    assert without_friction(bands, 4.0) == pytest.approx(share)
    assert without_friction(bands, 1.0) == without_friction([], 4.0) == 0.0
    frf = measured(table(), np.zeros(len(LINES)))
    friction = LevelCauses(("friction",))
    found = judge(table(), FINE, frf, LIMITS, (), bands, 4.0, causes=friction)
    assert share > LIMITS.rms
    assert not found.accepted
    assert "friction: at 1/4 of the level" in found.reasons[0]
    assert "louder" not in found.reasons[0]  # the limits leave no room
    assert judge(table(), FINE, frf, LIMITS, (), bands, 8.0, causes=friction).accepted
    (louder,) = judge(table(), FINE, frf, LIMITS, (), bands, 4.0, causes=friction, louder=2.0).reasons
    assert "excite louder: the limits leave room for a factor of 2" in louder


@pytest.mark.parametrize(("missed", "named"), [(0.012, True), (0.05, False)])
def test_friction_explains_no_misfit_larger_than_what_it_leaves(missed: float, named: bool) -> None:
    bands = [LevelBand(0.7, 11.0, 1.05 + 0j, 0.001)]  # friction leaves 1.25 * 5 % / 3
    frf = measured(table(), np.zeros(len(LINES)))
    error = FitError(missed, 0.02, 0.003)
    reason = judge(table(), error, frf, LIMITS, (), bands, 4.0, causes=LevelCauses(("friction",))).reasons[0]
    assert ("dry friction takes a larger share" in reason) == named
    assert ("the data do not tell the cause" in reason) != named


@pytest.mark.parametrize(
    ("change", "friction", "limit"),
    [
        (0.06, Friction(0.02, 0.001, 0.06, 0.9, 0.001), None),  # leaves 2.5 %, of known size
        (0.08, Friction(0.02, 0.001, 0.06, 0.9, 0.001), "3 %"),
        (0.06, Friction(0.02, 0.01, 0.06, 0.9, 0.001), "1 %"),  # nobody knows whether it is zero
        (0.06, None, "1 %"),
    ],
)
def test_friction_of_known_size_may_leave_as_much_as_the_largest_error(
    change: float, friction: Friction | None, limit: str | None
) -> None:
    bands = [LevelBand(0.7, 11.0, 1.0 + change, 0.001)]
    frf = measured(table(), np.zeros(len(LINES)))
    causes = LevelCauses(("friction",))
    found = judge(table(), FINE, frf, LIMITS, (), bands, 4.0, causes=causes, friction=friction)
    if limit is None:
        assert found.accepted
    else:
        assert f"the limit is {limit}" in found.reasons[0]


@pytest.mark.parametrize(
    ("causes", "words"),
    [
        (LevelCauses(("hardening",)), "the table's suspension stiffens as its motion grows; identify at the level"),
        (LevelCauses((), (2,)), "the specimen's stiffness depends on its motion (storey 2); identify at the level"),
        (LevelCauses(), "no single cause explains how; identify at the level"),
    ],
)
def test_what_grows_with_the_motion_is_not_called_friction(causes: LevelCauses, words: str) -> None:
    bands = [LevelBand(0.7, 11.0, 1.04 + 0j, 0.001)]
    (reason,) = judge(table(), FINE, measured(table(), np.zeros(len(LINES))), LIMITS, (), bands, 4.0, causes=causes,
                      louder=3.0).reasons  # fmt: skip
    assert words in reason
    assert "friction" not in reason
    assert "louder" not in reason


def test_a_model_that_does_not_fit_tells_nothing_of_levels_without_a_cause() -> None:
    bands = [LevelBand(0.7, 11.0, 1.4 + 0j, 0.001)]
    bad = FitError(0.7, 1.6, 0.7)
    frf = measured(table(), np.zeros(len(LINES)))
    assert not [r for r in judge(table(), bad, frf, LIMITS, (), bands, 4.0).reasons if r.startswith("level")]
    known = judge(table(), bad, frf, LIMITS, (), bands, 4.0, causes=LevelCauses(("hardening",))).reasons
    assert [reason for reason in known if reason.startswith("level")]


@pytest.mark.campaign
def test_uncertainties_of_roots_are_the_scatter_of_repeated_fits() -> None:
    truth, noise = table(), 0.01
    clean = measured(truth, np.zeros(len(LINES)), scatter=noise)
    start = replace(first_fit(clean, (np.array([3.2]), np.array([0.043])), Timing(1, DT), BAND_HZ), held_zeros=0)
    rows = []
    for seed in range(40):
        noisy = replace(clean, response=clean.response * (1.0 + complex_noise(seed, noise)))
        rows.append(roots_of(refit(noisy, start), None))
    assert [root.kind for root in rows[0]] == ["pole", "pole", "pole", "zero"]
    for root in range(4):
        hz = [row[root].frequency_hz for row in rows]
        assert np.mean([row[root].frequency_error_hz for row in rows]) == pytest.approx(np.std(hz), rel=0.4)
        ratios = [row[root].damping_ratio for row in rows]
        if not math.isnan(ratios[0]):
            assert np.mean([row[root].damping_error for row in rows]) == pytest.approx(np.std(ratios), rel=0.4)
    assert math.isnan(rows[0][2].damping_ratio)
    assert np.mean([row[2].frequency_hz for row in rows]) == pytest.approx(80.0, rel=0.02)
    assert fit_error(start.model, clean).rms < 1e-6


def test_roots_of_a_given_model() -> None:
    rows = roots_given(table())
    assert [(root.kind, round(root.frequency_hz, 6)) for root in rows] == [
        ("pole", 3.14), ("pole", 14.0), ("pole", 80.0), ("zero", 3.2),
    ]  # fmt: skip
    assert [root.damping_ratio for root in rows] == pytest.approx([0.045, 0.6, math.nan, 0.043], nan_ok=True)
    assert all(math.isnan(root.frequency_error_hz) for root in rows)
