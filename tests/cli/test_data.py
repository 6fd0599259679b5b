"""`rths data`: what is understood of a recording, and the YAML by which `rths identify --data` reads it."""

import json
from pathlib import Path

import numpy as np
import pytest
from docs_running import run_words

from rths_cli.errors import InputError
from rths_cli.experiment.identify_command import read_roles

N, DT_S = 4000, 0.0005
TIME_S = np.arange(N) * DT_S
SINE = np.sin(2.0 * np.pi * 3.0 * TIME_S)


def write(path: Path, channels: dict[str, np.ndarray]) -> Path:
    table = np.column_stack([TIME_S, *channels.values()])
    np.savetxt(path, table, "%.9g", ",", header=",".join(["time (s)", *channels]), comments="")
    return path


def faulty(path: Path) -> Path:
    """Write 8 channels: one clipped, one stuck for 0.75 s, one with 40 samples missing, one without a unit."""
    stuck, lost = SINE.copy(), SINE.copy()
    stuck[1000:2500] = stuck[1000]
    lost[100:140] = np.nan
    names = ["command (V)", "table (g)", "floor_2 (g)", "floor_3 (g)", "ai5 (g)", "ai6 (g)", "ai7 (g)", "ai8"]
    values = [0.1 * SINE, np.clip(SINE, -0.8, 0.8), stuck, lost, SINE + 0.25, SINE, SINE, SINE]
    return write(path, dict(zip(names, values, strict=True)))


def test_faults_of_channels_are_shown_in_twenty_lines(tmp_path: Path) -> None:
    path = faulty(tmp_path / "d.csv")
    code, page = run_words(["data", str(path)])
    lines = page.splitlines()
    assert (
        code == 0 and len(lines) <= 20 and lines[0].startswith("doubtful: d.csv, text, 8 channels, 4000 samples at 2")
    )
    told = json.loads(run_words(["data", str(path), "--json"])[1])
    channels = {each["name"].partition(" ")[0]: each for each in told["channels"]}
    assert {name for name, each in channels.items() if each["clipped_peaks"]} == {"table"}
    assert channels["table"]["clipped_peaks"] == 12  # six periods, both sides
    assert {name: each["stuck_s"] for name, each in channels.items() if each["stuck_s"]} == {
        "floor_2": pytest.approx(0.75, abs=0.002)
    }
    assert {name: each["missing"] for name, each in channels.items() if each["missing"]} == {"floor_3": 40}
    assert channels["ai5"]["mean"] == pytest.approx(0.25, abs=1e-6) and channels["ai8"]["unit"] == ""
    assert [each["role"] for each in told["channels"]] == ["command", "table", "floor_2", "floor_3", "", "", "", ""]


def test_a_clean_file_is_readable_and_its_yaml_names_its_channels(tmp_path: Path) -> None:
    path = write(tmp_path / "d.csv", {"command (V)": SINE, 'the "first" table: a (g)': SINE, "floor_2 (m/s^2)": SINE})
    told = json.loads(run_words(["data", str(path), "--json"])[1])
    (tmp_path / "channels.yaml").write_text(told["channels_yaml"].replace("role_2", "table"), encoding="utf-8")
    assert read_roles([str(tmp_path / "channels.yaml")]) == {
        "command": ("command (V)", "V"),
        "table": ('the "first" table: a (g)', "g"),
        "floor_2": ("floor_2 (m/s^2)", "m/s^2"),
    }
    clean = write(tmp_path / "e.csv", {"command (V)": SINE, "table (g)": SINE})
    assert run_words(["data", str(clean)])[1].startswith("readable: e.csv, text, 2 channels")


@pytest.mark.parametrize(
    "text", ["channels: {table: [ai0, g, m]}", "table: ai0", "channels: [", "channels: {table: 3}"]
)
def test_a_faulty_file_of_channels_is_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=r"c\.yaml"):
        read_roles([str(tmp_path / "c.yaml")])


def test_a_file_that_is_refused_has_its_sentence_and_exit_code(tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_text("a,b\n1,2\n3,4\n5,6\n")
    code, page = run_words(["data", str(tmp_path / "d.csv")])
    assert code == 2 and page.endswith("d.csv: states no sample rate and has no time column; give --rate HZ")
    assert run_words(["data", str(tmp_path / "d.csv"), "--rate", "100"])[0] == 0
