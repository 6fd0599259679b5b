"""The paper's eight cases by `best`: what issue and README promise, measured and true, in the test band."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result

CELLS = [(record, damping) for record in ("el_centro", "hachinohe") for damping in ("low", "high")]


PLAIN = "controller.reaction_feedforward=false", "controller.friction_compensation=false"


def figures(name: str, memory: Memory, folder: Path, *settings: str) -> dict[str, float | np.ndarray]:
    setup = make_setup(load_cases([name], settings)[0])
    ended = run_case(setup, folder / f"{name}.h5", memory, "test", lambda _: None)
    assert (ended.status, ended.exit_code) == ("complete", 0), ended.reason
    assert ended.path is not None
    return read_result(ended.path).metrics


@parametrize_first(1, ("record", "damping"), CELLS)
def test_hybrid_beats_delay_and_feedback_beats_feedforward(
    record: str, damping: str, memory: Memory, tmp_path: Path
) -> None:
    """Feedback where there is something left for it: a table whose friction nothing else counters."""
    alone = figures(f"{record}_{damping}_ff", memory, tmp_path, *PLAIN)
    both = figures(f"{record}_{damping}_ff_fb", memory, tmp_path, *PLAIN)
    delayed = np.asarray(both["sim_delay.rms_error_m_s2"])
    for kind in ("", "_true"):
        hybrid = np.asarray(both[f"exp_rths.rms_error_m_s2{kind}"])
        assert hybrid.shape == (3,)
        assert np.all(hybrid < 0.02 * delayed), hybrid / delayed
        for run in ("shake_table", "exp_rths"):
            path = f"{run}.tracking_rms_m_s2{kind}"
            assert both[path] < 0.5 * alone[path], path


@pytest.mark.campaign
@parametrize_first(1, ("record", "damping"), CELLS)
def test_what_the_command_counters_by_default_leaves_noise_and_rounding(
    record: str, damping: str, memory: Memory, tmp_path: Path
) -> None:
    found = figures(f"{record}_{damping}_ff_fb", memory, tmp_path)
    for kind in ("", "_true"):
        hybrid = np.asarray(found[f"exp_rths.rms_error_m_s2{kind}"])
        assert np.all(hybrid < 0.008 * np.asarray(found["sim_delay.rms_error_m_s2"]))
