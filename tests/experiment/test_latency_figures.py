"""Integration scheme and latency budget from the case to the figures of its result."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.result_contents import design_figures
from rths_cli.experiment.setup import make_setup
from rths_cli.report.case_metric_tables import ITEMS, latency
from rths_cli.report.to_text import text as printed

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.identification.results import Identification

CASE = "el_centro_low_ff_fb"


def figures(identified: Identification, *settings: str) -> dict[str, ArrayLike]:
    setup = make_setup(load_cases([CASE], settings)[0])
    return design_figures(setup, identified, design_blocks(setup, identified))


def test_the_default_case_leaves_little_of_its_latency(default_identification: Identification) -> None:
    found = dict(figures(default_identification))
    total = sum(np.asarray(found[f"latency.{name}_s"]) for name in ITEMS)
    assert found["latency.total_s"] == pytest.approx(total)
    assert found["latency.left_s"] == pytest.approx(sum(np.asarray(found[f"latency.{name}_left_s"]) for name in ITEMS))
    assert np.abs(found["latency.left_s"])[:4].max() < 2e-5  # up to 10 Hz
    assert found["latency.total_s"][2] > 9e-4
    assert found["latency.declared_s"] == pytest.approx(7.5e-4)
    assert abs(found["latency.identified_s"] - 7.5e-4) < 3.0 * found["latency.identified_error_s"]
    assert 1e-6 < found["latency.identified_error_s"] < 5e-5
    assert "identified on the rig" in printed([latency(found)])


def test_the_paper_leaves_the_filters_lag(default_identification: Identification) -> None:
    """NOTES: 0.43 ms at 5 Hz."""
    found = figures(default_identification, "method=paper")
    assert found["latency.kalman_left_s"][2] == pytest.approx(0.43e-3, abs=0.02e-3)
    assert found["latency.predicted_s"] == 0.0


def test_the_case_chooses_the_integration(default_identification: Identification) -> None:
    blocks = {}
    for scheme in ("exact", "cr", "newmark"):
        setup = make_setup(load_cases([CASE], (f"integration={scheme}",))[0])
        design = design_blocks(setup, default_identification)
        blocks[scheme] = design.blocks.numerical
        lag = design_figures(setup, default_identification, design)["latency.integration_s"]
        assert (np.abs(lag).max() > 1e-6) == (scheme != "exact")
    mass, dashpot = 6.93, 22.163
    assert blocks["cr"].D[0, 1] == pytest.approx(1.0 / mass)
    assert blocks["newmark"].D[0, 1] == pytest.approx(1.0 / (mass + 0.25e-3 * dashpot), rel=1e-6)


STIFF = (
    "sample_rate_hz=500",
    "structure={numerical: {masses_kg: [6.93], stiffness_n_per_m: [1.0e7]}, experimental: {masses_kg: [6.91], "
    "stiffness_n_per_m: [7300], damping_ratios: [0.04]}, damping_levels: {low: {dashpots_n_s_per_m: [22]}}}",
)


def test_newmark_beyond_its_limit_is_refused_before_anything_starts() -> None:
    with pytest.raises(InputError, match=r"integration: newmark is unstable at dt = 2 ms .*1\.665 ms"):
        make_setup(load_cases([CASE], (*STIFF, "integration=newmark"))[0])
    for scheme in ("exact", "cr"):
        make_setup(load_cases([CASE], (*STIFF, f"integration={scheme}"))[0])


def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(InputError, match="integration"):
        load_cases([CASE], ("integration=euler",))
