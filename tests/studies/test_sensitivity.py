"""Sobol indices through the study's own sampler against functions whose indices are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from campaigns.synthetic_study import Known, deviations, ishigami, sampled_indices, sobol_g

from rths_cli.errors import InputError
from rths_cli.studies.sensitivity import sobol_indices

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


@pytest.mark.parametrize(
    ("figures", "told"),
    [
        (np.ones(20), "a figure that changes"),
        (np.r_[np.nan, np.arange(19.0)], "1 of 20 have none"),
        (np.arange(15.0), "a power of 2 times 5 runs, got 15"),
    ],
)
def test_what_has_no_indices_is_refused(figures: np.ndarray, told: str) -> None:
    with pytest.raises(InputError, match=told):
        sobol_indices(figures, 3)
