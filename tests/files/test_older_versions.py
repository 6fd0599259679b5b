"""Files written at commit 2e74433 (version 0.1.0), kept as they are: every later version reads them."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest
from declared_contents import declaration_faults

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_files import load
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_checked, read_series
from rths_cli.files.sweep_file import read_sweep

KEPT = Path(__file__).parent / "written_at_2e74433"


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the kept files as they were written."""
    folder = tmp_path_factory.mktemp("kept")
    for path in KEPT.iterdir():
        if path.suffix == ".gz":
            (folder / path.stem).write_bytes(gzip.decompress(path.read_bytes()))
        else:
            shutil.copy(path, folder)
    return folder


def test_a_result_says_what_it_said(unpacked: Path) -> None:
    found = read_checked(unpacked / "result.h5", whole=True)
    assert (found.attributes["status"], found.attributes["case_name"]) == ("complete", "short")
    errors = [0.0010586346021794046, 0.0008375597292407974, 0.0006461731957850717]
    np.testing.assert_array_equal(found.metrics["exp_rths.rms_error_m_s2"], errors)
    assert found.metrics["exp_rths.j2"] == 0.0015097375094266876
    assert found.units["exp_rths.rms_error_m_s2"] == "m/s^2"
    assert read_series(unpacked / "result.h5", "exp_rths/abs_accel_m_s2").shape == (3, 2241)


def test_what_a_result_held_is_declared_with_the_same_unit_origin_and_axes(unpacked: Path) -> None:
    assert declaration_faults(unpacked / "result.h5", texts=False) == []


def test_a_sweep_says_what_it_said(unpacked: Path) -> None:
    found = read_sweep(unpacked / "sweep.h5")
    assert found.texts["status"] == ("complete",) * 4 and found.seed.tolist() == [0, 1, 0, 1]
    assert found.figures["exp_rths.rms_error_m_s2"].values.shape == (4, 3)


def test_a_model_drives_a_case_of_its_rig(unpacked: Path) -> None:
    case = load_cases([str(unpacked / "short.yaml")])[0]
    stored = load(unpacked / "model.h5", make_setup(case))
    assert not stored.found.reasons
    np.testing.assert_allclose(stored.found.specimen.natural_frequency_hz, [3.2, 8.4], rtol=2e-3)
