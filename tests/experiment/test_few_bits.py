"""The error of a motion of a few bits is predicted, and its bound holds (long form: benchmarks/few_bits.py)."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from campaigns.few_bits import laboratory, summary

from rths_cli.case.load import load_cases
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, errors_of, plan_run, play_run, run_of
from rths_cli.experiment.run_case import sim_of
from rths_cli.experiment.setup import make_setup
from rths_cli.numerics.shared_values import SharedValues

SHORT = 1, 5  # a laboratory of 15 bits, and how many of its tests


@pytest.mark.campaign
def test_a_motion_of_a_few_bits_is_predicted_and_its_bound_holds(tmp_path: Path) -> None:
    rows = list(islice(laboratory(SHORT[0], tmp_path), SHORT[1]))
    played = [row for row in rows if not row.refused]
    assert len(played) >= 3, [row.refused for row in rows]
    assert all(row.right and row.true_over_bound < 1.0 for row in played), summary(rows)
    assert max(row.size for row in played) > 0.1  # a motion that its converters hardly show


@pytest.mark.parametrize("method", ["best", "paper"])  # commands rounded with noise shaping, and as they are
def test_rounding_of_a_bit_is_predicted_on_the_virtual_table(method: str, memory: Memory, tmp_path: Path) -> None:
    """The oracle is the virtual table: another plant, with converters of its own, than the identified one."""
    time = np.arange(0.0, 8.0, 0.01)
    accel = np.sin(2.0 * np.pi * 2.2 * time) * np.sin(np.pi * time / 8.0) ** 2
    np.savetxt(tmp_path / "burst.csv", np.stack([time, accel], axis=1), delimiter=",", header="time_s,accel_m_s2",
               comments="")  # fmt: skip
    settings = (
        f"record={tmp_path / 'burst.csv'}", "scaling=0.05", "table.converters.bits=10",
        f"method={method}", "controller=FF",
    )  # fmt: skip
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0], ("check", "model"))
    known = memory.known(setup, lambda _: None)
    setup = setup.calibrated(known.found)
    checked = verdict_on(setup, known)
    assert checked.design is not None
    plan = plan_run(setup, checked.design, HYBRID_TEST, known.found)
    run = run_of(play_run(plan, 0), setup, HYBRID_TEST, checked.design.blocks.lead_samples, plan.expected)
    found = errors_of(run, setup, sim_of(setup, SharedValues()))
    predicted = np.asarray(checked.figures["check.expected_error_m_s2"])
    measured, true = (np.asarray(found[f"exp_rths.rms_error_m_s2{end}"]) for end in ("", "_true"))
    assert predicted == pytest.approx(measured, rel=0.4)
    assert np.all(true <= np.asarray(checked.figures["check.true_error_bound_m_s2"]))
