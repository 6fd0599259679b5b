"""The page of studies: figures embedded, the study and its case escaped, nothing loaded from elsewhere."""

import base64
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Figure, Sweep, write_sweep
from rths_cli.report.page import page, write_page

ABOUT = {
    "case_name": "quake", "rig": "bench", "rig_kind": "virtual", "seeds": "0", "status": "complete", "plan_sha256": "p",
    "software_sha256": "s", "exit_code": 0, "command_line": "rths sweep s.yaml",
}  # fmt: skip


@pytest.fixture
def sweep() -> Sweep:
    gain, errors = np.linspace(1.0, 2.0, 6), np.linspace(1e-3, 2e-3, 6)
    figures = {
        "exp_rths.tracking_rms_m_s2": Figure(errors, "m/s^2", "t"),
        "exp_rths.rms_error_m_s2": Figure(np.outer(errors, [1.0, 0.5]), "m/s^2", "s"),
    }
    statuses = ("complete",) * 5 + ("refused",)
    texts = {"status": statuses, "reason": ("",) * 5 + ("unsafe: <delay>",), "verdict": ("safe",) * 6}
    texts |= {"model_sha256": ("",) * 6, "processor": ("AMD 12",) * 6}
    varied = {"gain": tuple(gain)}
    return Sweep(dict(ABOUT), "notes: <script>x</script>", "", 1, varied, np.zeros(6, int), texts, figures, "axes: {}")


def test_a_page_of_a_study_holds_its_figure_its_table_and_its_origin(sweep: Sweep) -> None:
    text = page((), "rths report s.h5", "", [(Path("s.h5"), sweep)])
    (image,) = re.findall(r'<img src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert b"<svg" in base64.b64decode(image)
    assert "The metric over the varied keys. A cross or an empty cell" in text  # a figure on the page has no heading
    order = ("NOT COMPLETE: quake, 5 of 6 complete, 1 refused", "smallest error", "Summary</h3>", "Grid points</h3>")
    assert [*map(text.index, order)] == sorted(map(text.index, order))
    assert "<h1>Hybrid simulation: study s</h1>" in text and "6 runs of EXP-RTHS" in text
    assert "notes: &lt;script&gt;x&lt;/script&gt;" in text and "unsafe: &lt;delay&gt;" in text
    assert "AMD 12" in text and "rths report s.h5" in text
    assert not re.findall(r'(?:src|href)="(?!data:|#)', text)
    assert page((), "rths report s.h5", "", [(Path("s.h5"), sweep)]) == text


def test_a_page_needs_results_or_sweeps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no results to show"):
        write_page((), tmp_path / "p.html", "rths report")
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_page_of_a_sweep(sweep: Sweep, tmp_path: Path) -> None:
    write_sweep(tmp_path / "s.h5", sweep)
    words = ["report", str(tmp_path / "s.h5"), "--format", "html", "--output", str(tmp_path / "p.html"), "--quiet"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert "Hybrid simulation: study s" in (tmp_path / "p.html").read_text(encoding="utf-8")
