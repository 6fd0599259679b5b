"""The table of a sweep as Parquet: numbers to the last bit, units in the schema, absent figures as nulls."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Figure, Sweep, write_sweep
from rths_cli.files.sweep_parquet import check_parquet, write_parquet
from rths_cli.quantities.sweep_datasets import TEXTS

ABOUT = {
    "case_name": "x", "rig": "r", "rig_kind": "virtual", "seeds": "0", "status": "complete", "plan_sha256": "p",
    "software_sha256": "s", "exit_code": 0,
}  # fmt: skip


def made() -> Sweep:
    texts = dict.fromkeys(TEXTS, ("complete", "refused", 'ä, "q"'))
    varied = {"scaling": (0.1, 1 / 3, 2), "controller": ("FF", {"kind": "FF"}, "FF"), "t.stiffness_n_per_m": (1, 2, 3)}
    figures = {
        "exp_rths.tracking_rms_m_s2": Figure(np.array([0.1, np.nan, 5e-324]), "m/s^2", "tracking"),
        "exp_rths.rms_error_m_s2": Figure(np.array([[1 / 3, 2.0], [np.nan, np.nan], [3.0, 4.0]]), "m/s^2", "storeys"),
    }
    return Sweep(dict(ABOUT), "case", "resolved", 1, varied, np.array([5, 6, 2**53 - 1]), texts, figures, "study")


def test_the_table_reads_back_with_units(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    write_parquet(tmp_path / "t.parquet", made())
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.column("variant").to_pylist() == [1, 2, 3]
    assert table.column("seed").to_pylist() == [5, 6, 2**53 - 1]
    assert table.column("scaling").to_pylist() == [0.1, 1 / 3, 2.0]
    assert table.column("controller").to_pylist() == ["FF", '{"kind": "FF"}', "FF"]
    assert table.column("reason").to_pylist()[2] == 'ä, "q"'
    assert table.column("exp_rths.tracking_rms_m_s2").to_pylist() == [0.1, None, 5e-324]
    assert table.column("exp_rths.rms_error_m_s2[2]").to_pylist() == [2.0, None, 4.0]
    units = {field.name: field.metadata[b"units"].decode() for field in table.schema}
    assert units["exp_rths.rms_error_m_s2[1]"] == "m/s^2" and units["t.stiffness_n_per_m"] == "N/m"
    assert all(field.metadata[b"long_name"] for field in table.schema)
    about = table.schema.metadata
    assert json.loads(about[b"rths"]) == ABOUT and about[b"study_yaml"] == b"study" and about[b"case_yaml"] == b"case"


def test_a_report_writes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.chdir(tmp_path)
    write_sweep(Path("s.h5"), made())
    write_sweep(Path("other.h5"), made())
    done = CliRunner().invoke(cli, ["report", "s.h5", "--parquet", "t.parquet"])
    assert done.exit_code == 0, done.output
    assert parquet.read_table("t.parquet").num_rows == 3
    two = CliRunner().invoke(cli, ["report", "s.h5", "other.h5", "--parquet", "u.parquet"])
    assert isinstance(two.exception, InputError) and "the table of one sweep, got 2" in str(two.exception)
    assert not Path("u.parquet").exists()


def test_a_missing_pyarrow_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r"pyarrow is missing; install it: pip install 'rths-cli\[parquet\]'"):
        check_parquet()
