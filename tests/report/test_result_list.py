"""`rths list results`: a line for each result, what is none is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.errors import InputError
from rths_cli.files.result_reader import read_result
from rths_cli.report.answer import grade
from rths_cli.report.result_list import as_document, list_results
from rths_cli.report.to_text import text
from tests.helpers.page_results import write as write_result


def test_a_folder_is_listed_with_grades_and_faults(tmp_path: Path) -> None:
    write_result(tmp_path / "whole.h5")
    write_result(tmp_path / "sims.h5", runs=("sim", "sim_delay"))
    (tmp_path / "none.h5").write_text("no file of HDF5")
    found = {one.name: one for one in list_results(tmp_path)}
    graded = grade(read_result(tmp_path / "whole.h5"))
    assert found["whole"].grade == (graded.grade if graded else "-")
    assert found["whole"].error_percent == (graded.percent if graded else None)
    assert found["sims"].grade == "-" and found["sims"].error_percent is None
    assert "is not an HDF5 file" in found["none"].fault and list(found)[-1] == "none"
    page = text(as_document(list(found.values()), tmp_path))
    assert page.startswith("result  grade") and "none.h5: is not an HDF5 file" in " ".join(page.split())
    assert f"{(tmp_path / 'whole.h5').stat().st_size / 1e6:.3f}"[:4] in page


def test_what_is_no_folder_or_empty_is_said(tmp_path: Path) -> None:
    assert "holds no result file" in text(as_document(list_results(tmp_path), tmp_path))
    with pytest.raises(InputError, match=r"nowhere: is no folder"):
        list_results(tmp_path / "nowhere")
