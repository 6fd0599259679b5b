"""A sample of the cases at the ends of the documented ranges: SIM and SIM-DELAY answer, or refuse in a sentence.

`benchmarks/range_ends.py` runs hundreds of them as processes, and ends them by signals.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml
from campaigns.range_end_cases import an_end, documented, drawn

from rths_cli.analysis.sim import simulate
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.setup import make_setup


def test_the_documented_ranges_are_read() -> None:
    ranges = documented("case.md")
    assert ranges["sample_rate_hz"] == "[100, 50000]"
    ends = {an_end(ranges["sample_rate_hz"], np.random.default_rng(seed)) for seed in range(20)}
    assert ends == {100.0, 50_000.0}
    assert "physics.coulomb_n" in documented("rig.md", "virtual") and len(ranges) > 40


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(7))
def test_a_case_at_the_ends_of_its_ranges_is_answered_or_refused(seed: int, tmp_path: Path) -> None:
    case = drawn(np.random.default_rng(seed), tmp_path)
    (tmp_path / "case.yaml").write_text(yaml.safe_dump(case))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            setup = make_setup(load_cases([str(tmp_path / "case.yaml")])[0])
            sim = simulate(setup.building, setup.rig.dt_s, setup.motion.accel_m_s2)
            delayed = simulate_delayed(
                setup.building, setup.rig.dt_s, setup.motion.accel_m_s2, setup.case.delay_s, sim=sim
            )
        except InputError as refused:
            assert all(len(fault) < 1000 for fault in refused.faults)
            return
    assert np.isfinite(sim.abs_accel_m_s2).all() and sim.error_estimate <= 1e-2
    assert delayed.diverged_at_s is not None or np.isfinite(delayed.abs_accel_m_s2).all()
