"""`rths records FOLDER --rig`: the largest scale against another integration, and every limit that may be the first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import cumulative_simpson
from scipy.signal import bilinear_zpk, butter, lfilter, zpk2tf

from rths_cli.case.load import load_rig
from rths_cli.case.named_files import find
from rths_cli.case.rig_schema import RigSpec
from rths_cli.cli import cli
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.laboratory.playable_scale import playable

DT_S, RATE_HZ = 0.01, 2000.0
TIME_S = np.arange(0.0, 12.0, DT_S)
ACCEL = 2.0 * np.sin(2 * np.pi * 1.3 * TIME_S) * np.sin(np.pi * TIME_S / 12.0) ** 2
RIG = load_rig(find("aps400_virtual", "rigs", Path.cwd()))


def record(accel: np.ndarray) -> Accelerogram:
    return Accelerogram(DT_S, accel, "made", "", "m/s^2", "", "0" * 64)


def with_limits(**limits: float) -> RigSpec:
    return RIG.model_copy(update={"limits": RIG.limits.model_copy(update=limits)})


def peaks() -> tuple[float, float, float]:
    """Return displacement, velocity and acceleration by Simpson's rule behind a filter of its own."""
    fine_s = np.arange(0.0, TIME_S[-1], 1.0 / RATE_HZ)
    warped = 2.0 * RATE_HZ * np.tan(np.pi * 0.25 / RATE_HZ)
    b, a = zpk2tf(*bilinear_zpk(*butter(2, warped, "high", analog=True, output="zpk"), RATE_HZ))
    accel = lfilter(b, a, np.interp(fine_s, TIME_S, ACCEL))
    velocity = cumulative_simpson(accel, dx=1.0 / RATE_HZ, initial=0)
    displacement = cumulative_simpson(velocity, dx=1.0 / RATE_HZ, initial=0)
    return tuple(float(np.abs(each).max()) for each in (displacement, velocity, accel))  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("limits", "which", "allowed", "told"),
    [
        ({}, 0, 0.079, "stroke"),
        ({"stroke_m": 0.5}, 0, 0.079, "command range"),
        ({"velocity_m_s": 0.01}, 1, 0.01, "velocity"),
        ({"acceleration_m_s2": 0.1}, 2, 0.1, "acceleration"),
        ({"force_n": 3.0}, 2, 0.1, "force with the whole payload"),
    ],
)
def test_the_first_limit_is_named_with_the_scale_that_keeps_the_reserve(
    limits: dict[str, float], which: int, allowed: float, told: str
) -> None:
    found = playable(record(ACCEL), with_limits(**limits))
    assert found.limited_by == told
    assert found.largest_scale == pytest.approx(0.9 * allowed / peaks()[which], rel=2e-3)


def test_a_folder_is_a_row_for_each_record(tmp_path: Path) -> None:
    for name, factor in (("one", 1.0), ("two", 2.0)):
        rows = "\n".join(f"{a:.6f}" for a in factor * ACCEL)
        (tmp_path / f"{name}.csv").write_text(f"# dt: {DT_S} s\n# units: m/s^2\n{rows}\n")
    done = CliRunner().invoke(cli, ["records", str(tmp_path), "--rig", "aps400_virtual"])
    rows = [line.split() for line in done.output.splitlines() if line.startswith(("one.csv", "two.csv"))]
    scale = playable(record(ACCEL), RIG).largest_scale
    assert not done.exit_code and [row[0] for row in rows[:2]] == ["one.csv", "two.csv"]
    assert any(f"{scale:.3g}" in row for row in rows) and any(f"{scale / 2.0:.3g}" in row for row in rows)
    assert CliRunner().invoke(cli, ["records", "--rig", "aps400_virtual"], standalone_mode=False).exception is not None
