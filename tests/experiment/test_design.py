"""What a run's blocks take out of the samples is what was identified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import Identification


@pytest.mark.parametrize("coupling_hz", [0.024, 0.0])
def test_the_step_takes_out_the_alias_of_the_model(
    default_setup: Setup, default_identification: Identification, coupling_hz: float
) -> None:
    f = np.array([0.3, 1.0, 8.0])
    assert default_identification.best.coupling_hz == pytest.approx(0.024, rel=0.1)
    best = replace(default_identification.best, coupling_hz=coupling_hz)
    blocks = design_blocks(default_setup, replace(default_identification, best=best)).blocks
    assert blocks.staircase().response(f)[0, 0] == pytest.approx(best.alias(f), rel=1e-9)
