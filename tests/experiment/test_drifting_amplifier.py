"""An amplifier whose gain drifts by a fifth during a run: stopped on the measured stroke, from case to result file."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import make_setup

STROKE_M = 0.019
MEMORY = Memory()  # both runs are in the same laboratory but for what a channel is used for


def played(folder: Path, use: str) -> tuple[Ended, np.ndarray]:
    """Return how a sine of 1 Hz, 100 s long, ended with a displacement sensor of this use, and the true way in m."""
    time_s = np.arange(0.0, 100.0, 0.01)
    sine = np.tanh(time_s / 2.0) ** 2 * np.tanh((100.0 - time_s) / 2.0) ** 2 * np.sin(2.0 * np.pi * time_s)
    columns = np.column_stack([time_s, sine])
    np.savetxt(folder / "sine.csv", columns, delimiter=",", header="time_s,accel_m_s2", comments="")
    sensor = f"{{kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95, use: {use}}}"
    table = (
        f"{{extends: aps400_virtual, limits: {{stroke_m: {STROKE_M}}}, channels: [{sensor}], "
        "imperfections: {amplifier: {gain_drift_per_s: 0.002}}}"
    )
    settings = (
        f"record={folder / 'sine.csv'}", "scaling=0.6", f"table={table}", "runs=[sim, exp_rths]", "controller=FF",
        "sample_rate_hz=1000", "identification.duration_s=40",
    )  # fmt: skip
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0], ("check", "model"))
    ended = run_case(setup, folder / "result.h5", MEMORY, "test", lambda _: None)
    with h5py.File(ended.path) as file:
        return ended, file["exp_rths/truth/table_disp_m"][()]


@pytest.mark.campaign
def test_the_measured_stroke_stops_a_table_whose_command_stays_within_it(tmp_path: Path) -> None:
    ended, place_m = played(tmp_path, "guard")
    assert (ended.status, ended.exit_code) == ("aborted", 3)
    assert "measured displacement (with room to brake) beyond the stroke limit (channel table_disp" in ended.reason
    assert "times as commanded: the gain of amplifier or table" in ended.reason
    told, stopped_s = (float(ended.reason.split(words)[1].split()[0]) for words in ("table moves ", "anew) at "))
    assert told == pytest.approx(1.0 + 0.002 * stopped_s, abs=0.01) and stopped_s > 50.0
    assert 0.97 * STROKE_M < np.abs(place_m).max() < STROKE_M and abs(place_m[-1]) < 1e-4


@pytest.mark.campaign
def test_without_the_sensor_it_runs_into_its_end_stop(tmp_path: Path) -> None:
    ended, _ = played(tmp_path, "log")
    assert (ended.status, ended.exit_code) == ("failed", 4) and "ran into its end stop" in ended.reason
