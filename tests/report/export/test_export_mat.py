"""A .mat file holds every number of a result as scipy and Octave read it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_result import STOPPED, YAML, contents, make
from scipy.io import loadmat

from rths_cli.errors import InputError
from rths_cli.files.result_reader import ResultWriter
from rths_cli.report import export_files
from rths_cli.report.export_files import ExportRequest, export

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = make(tmp_path_factory.mktemp("mat") / "demo.h5")
    export(ExportRequest((path,), "mat", path.parent))
    return path


@pytest.fixture(scope="module")
def mat(result: Path) -> dict[str, Any]:
    return loadmat(result.with_suffix(".mat"), struct_as_record=False)


def field(mat: dict[str, Any], path: str) -> Any:
    """Return what stands at a path of structs."""
    top, *rest = path.split("/")
    found = mat[top]
    for name in rest:
        found = getattr(found[0, 0], name)
    return found


def test_every_dataset_is_there_with_time_down_the_rows(result: Path, mat: dict[str, Any]) -> None:
    compared = 0
    for path, numbers in contents(result).items():
        block = path.startswith("controller/") and path[-2:] in ("/A", "/B", "/C", "/D")
        if path.startswith("case/") or (path.startswith("controller/") and not block):
            continue
        found = field(mat, path)
        expected = (
            np.atleast_2d(numbers)
            if block
            else np.atleast_1d(numbers).reshape(-1, np.shape(numbers)[-1] if np.shape(numbers) else 1).T
        )
        assert found.shape == expected.shape, path
        assert np.array_equal(found, expected, equal_nan=True), path
        compared += 1
    assert compared > 25


def test_units_meaning_and_origin_stand_beside_the_numbers(mat: dict[str, Any]) -> None:
    assert field(mat, "exp_rths/units/command_v")[0] == "V"
    assert field(mat, "exp_rths/source/abs_accel_m_s2")[0] == "measured"
    assert field(mat, "exp_rths/truth/source/table_disp_m")[0] == "true"
    assert field(mat, "metrics/exp_rths/long_name/rms_error_m_s2")[0].startswith("RMS of SIM - absolute acceleration")


def test_blocks_are_what_ss_takes(mat: dict[str, Any]) -> None:
    block = field(mat, "controller/feedforward")[0, 0]
    assert (block.A.shape, block.B.shape, block.C.shape, block.D.shape) == ((2, 2), (2, 3), (1, 2), (1, 3))
    assert block.Ts[0, 0] == 0.0005
    assert [str(cell[0]) for cell in block.inputs[:, 0]] == ["accel_m_s2", "vel_m_s", "disp_m"]
    static = field(mat, "controller/base_shear")[0, 0]
    assert (static.A.shape, static.B.shape, static.C.shape) == ((0, 0), (0, 2), (1, 0))


def test_texts_are_characters(mat: dict[str, Any]) -> None:
    assert field(mat, "attributes/status")[0] == "complete"
    assert field(mat, "attributes/rig_kind")[0] == "virtual"
    assert field(mat, "attributes/seed")[0, 0] == 3.0
    assert field(mat, "case_/yaml")[0].rstrip(" ") == YAML


@pytest.mark.parametrize(
    ("name", "legal"),
    [
        ("case", "case_"),
        ("end", "end_"),
        ("2nd", "x2nd"),
        ("_a", "x_a"),
        ("a-b c", "a_b_c"),
        ("é", "x_"),
        ("x" * 70, "x" * 63),
    ],
)
def test_names_are_matlabs(name: str, legal: str) -> None:
    assert export_files.legal_name(name) == legal


def test_long_names_of_figures_keep_63_characters(tmp_path: Path) -> None:
    name = "sensor_drift_uncertainty_v_per_min"
    assert len(name) > 31
    with ResultWriter(tmp_path / "long.h5", {"rig_kind": "virtual"}) as writer:
        writer.metrics({f"exp_rths.{name}": [1.5, 2.5]})
        writer.finish("complete")
    export(ExportRequest((tmp_path / "long.h5",), "mat", tmp_path))
    assert field(loadmat(tmp_path / "long.mat", struct_as_record=False), f"metrics/exp_rths/{name}")[1, 0] == 2.5


def test_the_header_has_no_time_of_writing(result: Path) -> None:
    head = result.with_suffix(".mat").read_bytes()[:128]
    assert head.startswith(b"MATLAB 5.0 MAT-file, exported") and head[124:] == b"\x00\x01IM"
    assert b"Created" not in head


def test_more_than_the_format_holds_is_refused_before_it_is_read(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export_files, "LARGEST_BYTES", 2000)
    with pytest.raises(InputError, match=r"group exp_rths takes 0\.0 GB, a \.mat file of version 5 holds") as refused:
        export(ExportRequest((result,), "mat", tmp_path))
    assert "h5read" in refused.value.faults[0] and list(tmp_path.iterdir()) == []
    export(ExportRequest((result,), "mat", tmp_path, ("record",)))


def test_a_stopped_run_goes_as_far_as_it_went_and_says_so(tmp_path: Path) -> None:
    export(ExportRequest((make(tmp_path / "cut.h5", "aborted"),), "mat", tmp_path))
    found = loadmat(tmp_path / "cut.mat", struct_as_record=False)
    assert field(found, "exp_rths/command_v").shape == (STOPPED, 1)
    assert field(found, "attributes/status")[0] == "aborted"
    assert field(found, "attributes/status_reason")[0] == "EXP-RTHS: stroke limit at 0.0125 s"


@pytest.mark.skipif(OCTAVE is None, reason="needs Octave")
def test_octave_reads_numbers_blocks_and_texts(result: Path, tmp_path: Path) -> None:
    held = contents(result)
    script = tmp_path / "read.m"
    script.write_text(
        f"""r = load('{result.with_suffix(".mat")}');
a = r.exp_rths.abs_accel_m_s2;
printf('%.17g\\n', a(5, 2), r.exp_rths.time_s(7), size(a, 1) + 100 * size(a, 2));
b = r.controller.feedforward;
x = b.A * [1; 2] + b.B * [1; 0; 0]; y = b.C * x + b.D * [0; 1; 0];
printf('%.17g\\n', y, b.Ts);
printf('%s\\n', b.inputs{{2}}, r.attributes.status, r.exp_rths.units.command_v);
printf('%d ', size(r.controller.base_shear.B)); printf('\\n%s', r.case_.yaml);
"""
    )
    done = subprocess.run([str(OCTAVE), "--norc", "--quiet", str(script)], capture_output=True, timeout=60, check=False)
    lines = done.stdout.decode().splitlines()
    assert float(lines[0]) == held["exp_rths/abs_accel_m_s2"][1, 4]
    assert float(lines[1]) == held["exp_rths/time_s"][6]
    assert float(lines[2]) == held["exp_rths/abs_accel_m_s2"].shape[1] + 300
    a, b, c, d = (held[f"controller/feedforward/{name}"] for name in "ABCD")
    assert float(lines[3]) == pytest.approx((c @ (a @ [1, 2] + b[:, 0]) + d[:, 1])[0], rel=1e-12)
    assert lines[4:9] == ["0.00050000000000000001", "vel_m_s", "complete", "V", "0 2 "]
    assert "\n".join(lines[9:]).rstrip() == YAML.rstrip()
