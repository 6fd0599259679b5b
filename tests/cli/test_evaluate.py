"""`rths evaluate`: what stands on the screen, exit codes, what is written, and that `rths run` of a case with the key
does the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from rths_cli.case.load import load_cases
from rths_cli.cli import cli
from rths_cli.control.kalman_filter import open_loop
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.errors import InputError
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result

CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: none\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a case and the recording of a test whose table follows 1 ms late."""
    monkeypatch.chdir(tmp_path)
    time_s = np.arange(0.0, 9.0, 0.01)
    waves = sum(np.sin(2 * np.pi * f * time_s + f) for f in np.geomspace(0.5, 8.0, 15))
    accel = 1.5 * waves * np.sin(np.pi * time_s / 9.0) ** 2
    Path("short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{a:.6f}" for a in accel))
    Path("lab.yaml").write_text(CASE)
    setup = make_setup(load_cases(["lab.yaml"])[0])
    ground = setup.motion.accel_m_s2
    specimen, storeys = open_loop(setup.building.specimen, setup.rig.dt_s), all_storeys(setup.building.numerical, 5e-4)
    desired, table, shear = (np.zeros_like(ground) for _ in range(3))
    floors, below = np.zeros((2, ground.size)), np.zeros(len(storeys.A))
    above = np.zeros(len(specimen.A))
    for k in range(ground.size):  # a table that is two samples late in a hybrid test
        table[k] = desired[k - 2] if k > 1 else 0.0
        floors[:, k] = specimen.C @ above + specimen.D @ table[k : k + 1]
        shear[k] = -float(setup.building.specimen.masses_kg @ floors[:, k])
        inputs = np.array([ground[k], shear[k]])
        desired[k] = (storeys.C @ below + storeys.D @ inputs)[-1]
        above = specimen.A @ above + specimen.B @ table[k : k + 1]
        below = storeys.A @ below + storeys.B @ inputs
    names = ("time (s)", "ground (m/s^2)", "desired (m/s^2)", "table (g)", "floor 2 (g)", "floor 3 (g)", "shear (kN)")
    columns = [setup.motion.time_s, ground, desired, table / 9.80665, *floors / 9.80665, shear / 1e3]
    rows = (",".join(f"{value:.17g}" for value in row) for row in zip(*columns, strict=True))
    Path("monday.csv").write_text("\n".join([",".join(names), *rows, ""]))
    return tmp_path


def rths(*words: str) -> Result:
    """Judge the recording; the exit code is the return value, as the entry point takes it."""
    told = ["evaluate", "lab.yaml", "--data", "monday.csv", *words]
    return CliRunner().invoke(cli, told, catch_exceptions=False, standalone_mode=False)


def test_a_recording_is_judged_and_the_case_with_its_key_is_the_same(folder: Path) -> None:
    done = rths("--channel", "base_shear=shear (kN)", "--set", "name=a")
    assert done.return_value == 0 and done.stdout.startswith("NOT GRADED: no bound of the true error is stated")
    assert "own (recorded)" in done.output and "Table 1.00 ms late" in done.output
    found = read_result(Path("results/a-monday.h5"))
    assert float(np.asarray(found.metrics["exp_rths.tracking_delay_s"])) == pytest.approx(1e-3, abs=2e-6)
    keys = 'exp_rths: {recording: monday.csv, channels: {base_shear: "shear (kN)"}}\n'
    Path("b.yaml").write_text(f"{CASE}{keys}")
    done = CliRunner().invoke(cli, ["run", "b.yaml", "--json"], catch_exceptions=False, standalone_mode=False)
    assert done.return_value == 0 and json.loads(done.stdout)["cases"][0]["status"] == "complete"
    other = read_result(Path("results/b-monday.h5"))
    assert {path: np.asarray(value).tobytes() for path, value in found.metrics.items()} == {
        path: np.asarray(value).tobytes() for path, value in other.metrics.items()
    }
    with pytest.raises(InputError, match=r"a-monday\.h5: exists; remove it"):
        rths("--channel", "base_shear=shear (kN)", "--set", "name=a", "--no-replace")
    listed = CliRunner().invoke(cli, ["report", "results"], catch_exceptions=False)
    assert listed.exit_code == 0 and "a-monday" in listed.output and "b-monday" in listed.output


@pytest.mark.campaign
def test_what_cannot_be_judged_is_refused_before_anything_is_written(folder: Path) -> None:
    for words, told in (
        (("--set", "scaling=0.1"), "the test was scaled by 0.3, the case says 0.1"),
        (("--set", "record=el_centro"), "is not the record el_centro of the case"),
        (("--channel", "table=nothing"), "table: there is no channel 'nothing'"),
        (("--channel", "roof=shear (kN)"), "roof: there is no such role; roles of this run are ground, desired"),
        (("--set", "sample_rate_hz=500"), "sampled at 2000 Hz, the case runs at 500 Hz; judge it at its own rate"),
    ):
        with pytest.raises(InputError, match=r"monday\.csv") as caught:
            rths(*words)
        assert told in str(caught.value) and not list(Path("results").glob("*.h5"))


@pytest.mark.campaign
def test_a_test_of_another_building_ends_with_exit_code_1(folder: Path) -> None:
    done = rths("--channel", "base_shear=shear (kN)", "--set", "structure.numerical.masses_kg=[6.0]", "--quiet")
    assert done.return_value == 1 and "is not what the computed storeys of the case do" in done.stdout


@pytest.mark.campaign
def test_nothing_moves_where_the_rig_of_the_case_is_a_real_one(folder: Path) -> None:
    done = rths("--channel", "base_shear=shear (kN)", "--set", "table=udp_example", "--quiet")
    assert done.return_value == 0
    assert read_result(Path("results/lab-monday.h5")).attributes["rig_kind"] == "recorded"
    assert rths("--channel", "base_shear=shear (kN)", "--set", "table=udp_example", "--quiet").return_value == 0
