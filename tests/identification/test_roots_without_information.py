"""Tables of known poles of which the data tell nothing: the root is not determined, and what that costs is true.

The oracle is the table itself, and the scatter of fits to many noisy responses of it.
"""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.findings import sentences
from rths_cli.identification.delay import shifts
from rths_cli.identification.results import FitError, Root
from rths_cli.identification.table_fit import Fit, Layout, Timing, fit, pack
from rths_cli.identification.verdict import LIMITS, response_error, roots_of, without_information
from rths_cli.numerics.bands import USUAL
from rths_cli.numerics.lti import Frf, Model
from rths_cli.report.identification_page import UNDETERMINED, root_lines
from rths_cli.report.to_text import text

DT, BAND_HZ = 0.0005, (0.5, 60.0)
LINES = np.arange(0.5, 60.0, 0.05)
TWO_PI = 2.0 * np.pi


def response(corners_hz: tuple[float, ...], pair: tuple[float, float] | None, frequency_hz: np.ndarray) -> np.ndarray:
    """Return the response of a table with real poles, and a pair (Hz, damping ratio) if any."""
    s = 2j * np.pi * frequency_hz
    value = 0.0079 * s**2 * np.exp(-1.5 * DT * s) * np.sinc(frequency_hz * DT)
    for corner in corners_hz:
        value = value / (1.0 + s / (TWO_PI * corner))
    if pair is not None:
        value = value / (1.0 + 2.0 * pair[1] * s / (TWO_PI * pair[0]) + (s / (TWO_PI * pair[0])) ** 2)
    return value


def fitted(
    truth: np.ndarray, layout: Layout, start: np.ndarray, noise: float, seed: int
) -> tuple[Fit, tuple[Root, ...]]:
    """Return a layout fitted to a response with relative noise, and its roots."""
    rng = np.random.default_rng(seed)
    scatter = noise * (rng.standard_normal(len(LINES)) + 1j * rng.standard_normal(len(LINES))) / np.sqrt(2.0)
    ones = np.ones(len(LINES))
    frf = Frf(LINES, truth * (1.0 + scatter), ones, noise * ones / np.sqrt(2.0), 100)
    found = fit(frf, layout, np.append(start, 0.0), Timing(1, DT), BAND_HZ, ripple=True)
    return found, roots_of(found, None, shifts(found, frf, (), np.inf))


def one_pole(corner_hz: float, noise: float, seed: int) -> tuple[Fit, tuple[Root, ...]]:
    """Return the fit of a pair of poles to a table that has one: the other is nowhere."""
    start = pack(0.0079, np.array([[TWO_PI * 7.0, 0.7]]), np.zeros(0), np.zeros((0, 2)))
    return fitted(response((corner_hz,), None, LINES), Layout(1, 0, 0, 1.5 * DT), start, noise, seed)


def error_of(found: Fit, corner_hz: float, frequency_hz: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * frequency_hz
    truth = 0.0079 * s**2 * np.exp(-1.5 * DT * s) / (1.0 + s / (TWO_PI * corner_hz))
    return np.abs(found.model.response(frequency_hz) / truth - 1.0)


@pytest.mark.parametrize(("corner_hz", "noise"), [(3.0, 0.01), (9.0, 0.003), (1.2, 0.02)])
def test_a_pole_that_is_nowhere_is_not_determined_and_the_other_comes_back(corner_hz: float, noise: float) -> None:
    known = np.linspace(*USUAL.hz, 50)
    beyond_limit = 0
    for seed in range(8):
        found, (slow, far) = one_pole(corner_hz, noise, seed)
        assert slow.determined and abs(slow.frequency_hz - corner_hz) < 4.0 * slow.frequency_error_hz
        assert slow.frequency_error_hz < 0.1 * corner_hz
        assert not far.determined and far.frequency_hz > BAND_HZ[1]
        known_hz, warnings, reasons = without_information(found, (slow, far), LIMITS, USUAL)
        (warning,) = sentences(warnings)
        assert not reasons and known_hz > USUAL.high_hz
        assert warning.startswith(
            "table model: a real pole beyond the fitted band (0.5-60 Hz) is not determined by the data; in "
        )
        assert f"above {known_hz:.3g} Hz the model says nothing" in warning or np.isinf(known_hz)
        assert error_of(found, corner_hz, known).max() < LIMITS.largest
        if np.isfinite(known_hz):
            beyond_limit += bool(error_of(found, corner_hz, np.array([known_hz]))[0] > LIMITS.largest)
    assert beyond_limit <= 2  # two standard uncertainties


def test_what_is_said_of_the_compared_band_is_the_scatter_of_fits_there() -> None:
    fits = [one_pole(3.0, 0.02, seed)[0] for seed in range(40)]
    for hz in (2.0, 10.0, 50.0):
        at = np.array([hz])
        scatter = np.std([found.model.response(at)[0] / fits[0].model.response(at)[0] for found in fits])
        assert response_error(fits[0], at)[0] == pytest.approx(scatter, rel=0.6)


def test_determined_roots_cost_nothing() -> None:
    truth = response((20.0,), (8.0, 0.5), LINES)
    start = pack(0.0079, np.array([[TWO_PI * 7.0, 0.7]]), np.array([TWO_PI * 30.0]), np.zeros((0, 2)))
    found, roots = fitted(truth, Layout(1, 1, 0, 1.5 * DT), start, 0.002, 1)
    assert [root.frequency_hz for root in roots] == pytest.approx([8.0, 20.0], rel=0.05)
    assert all(root.determined for root in roots)
    assert without_information(found, roots, LIMITS, USUAL) == (np.inf, (), ())


def test_a_root_that_matters_in_the_compared_band_rejects_the_model() -> None:
    found, roots = one_pole(3.0, 0.5, 1)
    known_hz, warnings, reasons = without_information(found, roots, FitError(0.01, 0.001, 0.004), USUAL)
    assert not warnings and known_hz < USUAL.high_hz
    assert "not determined by the data, which leaves the model uncertain by" in str(reasons[0])
    assert str(reasons[0]).endswith("the limit is 0.1 %; excite longer or louder, or over a wider band")


def test_an_overdamped_pair_is_the_two_real_roots_of_its_polynomial() -> None:
    pair = np.array([[TWO_PI * 10.0, 4.0]])
    layout = Layout(1, 0, 0, 0.0)
    covariance = np.zeros((3, 3))
    covariance[1:, 1:] = [[0.5, 0.499], [0.499, 0.5]]  # frequency and damping move together: the slow root is known
    model = Model(np.zeros(2), np.zeros(2), 1.0, 0.0, BAND_HZ, 0.0, 1, DT)
    slow, fast = roots_of(Fit(model, layout, pack(1.0, pair, np.zeros(0), np.zeros((0, 2))), covariance), None)
    exact = np.sort(-np.roots([1.0, 2.0 * 4.0 * 10.0, 100.0]).real)
    assert [slow.frequency_hz, fast.frequency_hz] == pytest.approx(exact)
    assert slow.frequency_known and not fast.frequency_known
    change = 1e-6  # d log corner along the two logarithms, by differences
    for root, sign in ((slow, 0), (fast, 1)):
        steps = []
        for d_w, d_z in ((change, 0.0), (0.0, change)):
            ratio = 4.0 * np.exp(d_z)
            corner = np.sort(-np.roots([1.0, 2.0 * ratio * 10.0 * np.exp(d_w), (10.0 * np.exp(d_w)) ** 2]).real)[sign]
            steps.append(np.log(corner / exact[sign]) / change)
        variance = np.array(steps) @ covariance[1:, 1:] @ np.array(steps)
        assert root.frequency_error_hz == pytest.approx(root.frequency_hz * np.sqrt(variance), rel=1e-3)


def test_the_page_says_not_determined_in_place_of_numbers() -> None:
    rows = root_lines([Root("pole", 3.0, 0.7, 95.0, 2150.0), Root("pole", 3.0, np.nan, 0.01, np.nan)])
    shown = text([rows])
    assert shown.count(UNDETERMINED) == 2 and "3.000 +- 0.020" in shown and "190" not in shown


def test_the_model_says_nothing_where_two_standard_uncertainties_pass_the_limit() -> None:
    found, roots = one_pole(3.0, 0.1, 2)
    known_hz, (warning,), _ = without_information(found, roots, LIMITS, USUAL)
    assert USUAL.high_hz < known_hz < 0.5 / DT
    assert 2.0 * response_error(found, np.array([0.98 * known_hz]))[0] < LIMITS.largest
    assert 2.0 * response_error(found, np.array([1.02 * known_hz]))[0] > LIMITS.largest
    inside = 200.0 * response_error(found, np.linspace(*USUAL.hz, 300)).max()
    said = float(str(warning).partition("matters by at most ")[2].partition(" %")[0])
    assert said == pytest.approx(inside, rel=0.05)
