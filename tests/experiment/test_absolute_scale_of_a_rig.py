"""The gain that all accelerometers share, by a displacement sensor, at a rate at which the staircase is large."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

import rths_cli

TABLE = {
    "extends": "aps400_virtual",
    "sensors": {"sensitivity_uncertainty": 0.02},
    "channels": [
        {"kind": "displacement", "position": "table", "unit": "mm", "sensitivity_v_per_unit": 0.1, "range": 95,
         "use": "log", "sensitivity_uncertainty": 0.0005},
    ],
}  # fmt: skip


@pytest.mark.campaign
def test_a_displacement_sensor_finds_the_true_gains_at_a_low_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 500 Hz a sample of the table holds an alias of the held command, which no displacement sensor shows; taken for
    motion it would make the gains 10 % wrong."""
    monkeypatch.chdir(tmp_path)
    settings = {"table": TABLE, "sample_rate_hz": 500, "identification": {"duration_s": 40}}
    found = rths_cli.identify("el_centro_low_ff_fb", "model.h5", settings=settings)
    assert found.accepted
    with h5py.File("model.h5") as file:
        gains = file["calibration/gain"][()]
    assert gains == pytest.approx([1.0, 1.0, 1.0], abs=1.5e-3)
