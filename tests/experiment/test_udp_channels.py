"""Eight channels of five kinds behind UDP: identified, run and recorded over loopback."""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from further_channels import FIVE_AS_KEYS
from serving_bench import Running, leave_out_punctuality

import rths_cli
from rths_cli.identification import excitation, low_level_probe
from rths_cli.laboratory.serve import describe

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
RATE_HZ = 500


@pytest.fixture
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Enter a folder with the served rig, a key, a short pulse and the case of a runner."""
    (tmp_path / "served.yaml").write_text(yaml.safe_dump({"extends": "aps400_virtual", "channels": FIVE_AS_KEYS}))
    key = tmp_path / "key"
    key.write_text(bytes(range(16)).hex())
    key.chmod(0o600)
    time_s = np.arange(0.0, 5.0, 0.01)
    pulse = np.sin(2.0 * np.pi * 1.5 * time_s) * np.exp(-(((time_s - 1.2) / 0.5) ** 2))
    columns = np.column_stack([time_s, pulse])
    np.savetxt(tmp_path / "pulse.csv", columns, delimiter=",", header="time_s,accel_m_s2", comments="")
    case = {
        "structure": "three_storey", "damping": "low", "record": "pulse.csv", "scaling": 0.6, "controller": "FF",
        "table": "runner", "sample_rate_hz": RATE_HZ, "runs": ["sim", "exp_rths"],
        "identification": {"duration_s": 40},
    }  # fmt: skip
    (tmp_path / "pulse.yaml").write_text(yaml.safe_dump(case))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.campaign
def test_eight_channels_are_identified_run_and_recorded(laboratory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples that were lost, on a machine that is busy, are left out of the comparison.

    Probe and free vibration are shorter than a laboratory's: the loop and the files are the same in every second.
    """
    leave_out_punctuality(monkeypatch)
    monkeypatch.setattr(low_level_probe, "PROBE_S", 16.0)
    monkeypatch.setattr(excitation, "HOLD_S", 6.0)
    served = describe("served.yaml", "three_storey", (f"sample_rate_hz={RATE_HZ}",), 0)
    assert served.channels == 8
    running = Running(served, laboratory / "key", watchdog_s=2.0)
    try:
        runner = {
            "extends": "udp_loopback", "channels": FIVE_AS_KEYS, "watchdog_s": 2.0,
            "udp": {"host": "127.0.0.1", "port": running.port, "key_file": "key"},
            "limits": {"lost_samples": 200},
        }  # fmt: skip
        (laboratory / "runner.yaml").write_text(yaml.safe_dump(runner))
        model = rths_cli.identify("pulse.yaml", "model.h5", yes=True)
        assert model.natural_frequency_hz is not None
        result = rths_cli.run(
            "pulse.yaml", settings={"identification.model": "model.h5"}, output=laboratory, yes=True,
            overrides=["model", "check"],
        )  # fmt: skip
    finally:
        running.end()
    assert result.status == "complete"
    with h5py.File(result.path) as file:
        run = file["exp_rths"]
        names = run["further_channel_names"][()].decode().splitlines()
        came = run["timing/lost"][()] == 0
        rows = {name: run["further_channels"][i][came] for i, name in enumerate(names)}
        table, floors = run["interface_accel_measured_m_s2"][()][came], run["floor_accel_measured_m_s2"][()][:, came]
        assert "kalman_with_load_cell" in file["controller"]
    assert names == [
        "table_displacement (m)", "table_force (N)", "storey_3_strain (1)", "floor_3_acceleration (m/s^2)",
        "floor_2_displacement (m)",
    ]  # fmt: skip
    cell = 1.5 * table + np.array([6.91, 6.95]) @ floors
    assert np.abs(rows["table_force (N)"]).max() > 3.0
    assert np.abs(rows["table_force (N)"] - cell).max() < 0.1 * np.abs(cell).max()
    assert np.corrcoef(rows["floor_3_acceleration (m/s^2)"], floors[1])[0, 1] > 0.99
    assert np.abs(rows["table_displacement (m)"]).max() > 1e-3
