"""The notebook works as it is written, and a case shown in it is one screen."""

from __future__ import annotations

import json
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import matplotlib
import pytest

import rths_cli

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first_hour.ipynb"


def code_cells() -> list[str]:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def test_the_notebook_is_stored_without_what_it_printed() -> None:
    stored = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert stored["nbformat"] == 4 and len({cell["id"] for cell in stored["cells"]}) == len(stored["cells"])
    assert all(not cell["outputs"] for cell in stored["cells"] if cell["cell_type"] == "code")


@pytest.mark.campaign
def test_the_notebook_works_as_it_is_written(tmp_path: Path) -> None:
    """Its cells run in order, in one namespace, as a kernel runs them; the table has a row per scaling and seed."""
    matplotlib.use("Agg")
    names: dict[str, Any] = {"__name__": "__main__"}
    with chdir(tmp_path), redirect_stdout(StringIO()) as told:
        for number, cell in enumerate(code_cells()):
            exec(compile(cell, f"first_hour.ipynb, code cell {number}", "exec"), names)
    assert names["result"].status == "complete" and (names["error"] < 0.01 * names["of_delay"]).all()
    assert len(names["figure"].axes) > 3
    assert [row["scaling"] for row in names["rows"]] == ["0.1", "0.1", "0.2", "0.2", "0.3", "0.3"]
    assert len(names["columns"]) == 6 and "storey 3: " in told.getvalue()


def test_a_case_is_shown_on_one_screen() -> None:
    """An inline building of 40 storeys, a mapping as controller and a rig that varies another fit as well."""
    storeys = {"masses_kg": [7.0] * 20, "stiffness_n_per_m": [7000.0] * 20}
    shown = repr(
        rths_cli.resolve(
            {
                "structure": {"numerical": storeys, "experimental": {**storeys, "damping_ratios": [0.04] * 20}},
                "damping": {"dashpots_n_s_per_m": [20.0] * 20},
                "record": "el_centro",
                "scaling": 0.3,
                "controller": {"kind": "FF+FB", "max_sensitivity": 1.3},
                "table": {"extends": "aps400_virtual", "physics": {"coulomb_n": 0.9}},
            },
            settings={"accept": {"exp_rths.rms_error_m_s2[3]": 0.002}},
        )
    ).splitlines()
    assert len(shown) <= 12 and max(map(len, shown)) <= 100
    assert "40 storeys, the lowest 20 computed" in shown[1] and "FF+FB, method best" in "\n".join(shown)
    assert not {"{", "[7"} & set("\n".join(shown).split())
