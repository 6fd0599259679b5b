"""Ground motions in files that recorders and controllers write: the figures that were written, or the reason."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram, read_components

DT_S = 0.005
TIME_S = DT_S * np.arange(400)
GROUND = np.round(1.2 * np.sin(9.0 * TIME_S) * np.exp(-((TIME_S - 1.0) ** 2)), 6)  # m/s^2
FLOOR = np.round(0.7 * GROUND**2, 6)


def controldesk(path: Path) -> None:
    y = np.zeros(3, dtype=[("Name", "O"), ("Data", "O"), ("Unit", "O")])
    y["Name"], y["Data"], y["Unit"] = ["drive", "ground", "floor_2"], [GROUND / 9.0, GROUND, FLOOR], ["V", "m/s^2", "g"]
    savemat(path, {"run": {"X": {"Name": "time", "Data": TIME_S, "Unit": "s"}, "Y": y}})


def labview(path: Path) -> None:
    head = (
        "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\nTime_Pref\tRelative\n"
        "***End_of_Header***\t\nChannels\t2\nSamples\t400\t400\nY_Unit_Label\tMeters/Second^2\tVolts\n"
        "X_Dimension\tTime\tTime\nX0\t0.0\t0.0\nDelta_X\t0.005\t0.005\n***End_of_Header***\t\n"
        "X_Value\tground\tdrive\tComment\n"
    )
    rows = (f"{t:.3f}\t{a:.6f}\t{a / 9.0:.6f}\t" for t, a in zip(TIME_S, GROUND, strict=True))
    path.write_text(head.replace("Meters/Second^2", "m/s^2").replace("Volts", "V") + "\n".join(rows) + "\n")


def stamped(path: Path) -> None:
    rows = (f"2026-02-03T10:00:{t:09.6f},{a:.6f}" for t, a in zip(TIME_S, GROUND, strict=True))
    path.write_text("time,ground (m/s^2)\n" + "\n".join(rows) + "\n")


def archive(path: Path) -> None:
    np.savez(path, time_s=TIME_S, ground_m_s2=GROUND)


@pytest.mark.parametrize(
    ("write", "name", "component"),
    [(controldesk, "a.mat", "ground"), (labview, "a.lvm", None), (stamped, "a.csv", None), (archive, "a.npz", None)],
)
def test_the_channel_of_the_ground_is_the_record(
    write: Callable[[Path], None], name: str, component: str | None, tmp_path: Path
) -> None:
    write(tmp_path / name)
    found = read_accelerogram(tmp_path / name, component=component)
    assert found.dt_s == pytest.approx(DT_S, rel=1e-9)
    np.testing.assert_allclose(found.accel_m_s2, GROUND, rtol=0.0, atol=1e-12)


def test_channels_of_accelerations_are_components_and_one_has_to_be_named(tmp_path: Path) -> None:
    controldesk(tmp_path / "a.mat")
    ground, floor = read_components(tmp_path / "a.mat")
    assert (ground.component, floor.component) == ("ground", "floor_2")
    np.testing.assert_allclose(floor.accel_m_s2, 9.80665 * FLOOR, rtol=1e-12)
    with pytest.raises(InputError, match=r"holds 2 components \(ground, floor_2\); state one"):
        read_accelerogram(tmp_path / "a.mat")


def test_what_is_no_ground_motion_or_not_whole_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "volts.npz", time_s=TIME_S, **{"drive (V)": GROUND})
    with pytest.raises(InputError, match=r"none of its channels \(drive \(V\) in V\) is an acceleration"):
        read_accelerogram(tmp_path / "volts.npz")
    np.savez(tmp_path / "gaps.npz", time_s=TIME_S, ground_m_s2=np.where(np.arange(400) == 70, np.nan, GROUND))
    with pytest.raises(InputError, match=r"1 of 400 samples of 'ground_m_s2' are missing; mend or cut the record"):
        read_accelerogram(tmp_path / "gaps.npz")
    np.savez(tmp_path / "plain.npz", time_s=TIME_S, ground=GROUND)
    with pytest.raises(InputError, match=r"plain.npz: states no unit of acceleration; state it in the case"):
        read_accelerogram(tmp_path / "plain.npz")
    assert read_accelerogram(tmp_path / "plain.npz", unit="g").unit_read == "g"
