"""Sobol indices through the study's own sampler against functions whose indices are known."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from campaigns.synthetic_study import Known, deviations, ishigami, sampled_indices, sobol_g
from scipy import stats

from rths_cli.errors import InputError
from rths_cli.studies.sensitivity import sobol_indices
from rths_cli.studies.study_plan import unit_samples

COUNT = 4096


def test_the_indices_of_ishigami_are_those_in_print() -> None:
    """Saltelli et al., Global Sensitivity Analysis. The Primer, 2008 (a = 7, b = 0.1)."""
    assert ishigami().first == pytest.approx([0.3139, 0.4424, 0.0], abs=1e-4)
    assert ishigami().total == pytest.approx([0.5576, 0.4424, 0.2437], abs=1e-4)


def test_the_indices_of_the_g_function_are_those_of_its_integrals() -> None:
    """Given one axis, the mean over the others is that axis's factor, as each of the others has the mean 1."""
    known, ends = sobol_g(), (np.arange(20_000) + 0.5) / 20_000
    inside = np.full((len(ends), 8), 0.25)  # where |4 x - 2| = 1, every factor is 1
    parts = []
    for axis in range(8):
        rows = inside.copy()
        rows[:, axis] = ends
        parts.append(np.var(known.of(rows)))
    whole = np.prod(1 + np.array(parts)) - 1
    assert known.first == pytest.approx(np.array(parts) / whole, rel=1e-6)
    assert known.total == pytest.approx(
        [1 - (np.prod(1 + np.delete(parts, k)) - 1) / whole for k in range(8)], rel=1e-6
    )


@pytest.mark.parametrize("known", [ishigami(), sobol_g()], ids=["ishigami", "g"])
def test_indices_are_within_three_standard_errors_of_the_known_ones(known: Known, tmp_path: Path) -> None:
    found = sampled_indices(known, COUNT, 0, tmp_path)
    assert np.max(np.abs(deviations(found, known))) < 3
    assert max(found.first_error.max(), found.total_error.max()) < 0.05  # the errors are no excuse
    assert found.first == pytest.approx(known.first, abs=0.01) and found.total == pytest.approx(known.total, abs=0.01)


def test_the_indices_are_those_of_print_and_of_a_second_program() -> None:
    """Saltelli et al. (2010), equation (b) of table 2, of figures less their mean; total indices as scipy has them."""
    figures = np.random.default_rng(1).gamma(2.0, size=64 * 5)
    found = sobol_indices(figures, 3)
    first, *mixed, second = (figures - figures.mean()).reshape(64, 5).T
    own = [np.mean(second * (each - first)) / np.var([first, second]) for each in mixed]
    assert found.first == pytest.approx(own, rel=1e-9)
    known = stats.sobol_indices(func={"f_A": first[None], "f_B": second[None], "f_AB": np.array(mixed)[:, None]}, n=64)
    assert found.total == pytest.approx(np.ravel(known.total_order), rel=1e-9)


def test_the_standard_errors_are_the_scatter_between_independent_samples() -> None:
    """A sum of two uniform variables, at samples that are independent as the bootstrap takes them for."""
    rng, found = np.random.default_rng(3), []
    for seed in range(200):
        one, two = rng.random((2, 256, 2))
        rows = np.stack([one, np.stack([two[:, 0], one[:, 1]], 1), np.stack([one[:, 0], two[:, 1]], 1), two], 1)
        found.append(sobol_indices(rows.sum(axis=2).ravel(), 2, seed))
    for name in ("first", "total"):
        scatter = np.std([getattr(each, name) for each in found], axis=0, ddof=1)
        assert np.mean([getattr(each, f"{name}_error") for each in found], axis=0) == pytest.approx(scatter, rel=0.2)


def test_a_seed_gives_the_same_errors_twice() -> None:
    figures = np.random.default_rng(1).random(64 * 4)
    one, two, other = (sobol_indices(figures, 2, seed).first_error for seed in (0, 0, 1))
    assert one.tobytes() == two.tobytes() != other.tobytes()


def test_a_missing_salib_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "SALib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "SALib", None)
    for call in (lambda: sobol_indices(np.arange(20.0), 3), lambda: unit_samples("sobol_indices", 4, 3, 0)):
        with pytest.raises(InputError, match=r"SALib is missing; install it: pip install 'rths-cli\[studies\]'"):
            call()


@pytest.mark.parametrize(
    ("figures", "told"),
    [
        (np.ones(20), "a figure that changes"),
        (np.r_[np.nan, np.arange(19.0)], "1 of 20 have none"),
        (np.arange(14.0), "a multiple of 5 runs, got 14"),
    ],
)
def test_what_has_no_indices_is_refused(figures: np.ndarray, told: str) -> None:
    with pytest.raises(InputError, match=told):
        sobol_indices(figures, 3)
