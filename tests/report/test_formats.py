"""Every format shows what the text shows: numbers, words of runs that ended otherwise, and names that mean harm."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from made_up import paper_cases, result
from made_up_files import write

from rths_cli.findings import Finding, as_data, as_json
from rths_cli.quantities import Interval
from rths_cli.report.document import Line, Table, labelled, spread
from rths_cli.report.formats.csv_table import tidy
from rths_cli.report.formats.json_document import document
from rths_cli.report.input_files import Inputs, Unread, read_inputs
from rths_cli.report.report_contents import Contents, contents
from rths_cli.report.result_tables import document as tables
from rths_cli.report.to_files import in_markdown, latex, markdown, number

SCHEMA = Path(__file__).parents[2] / "configs" / "report.schema.json"
NASTY = r"a|b_c$d%e&f#g{h}i\j~k^l<script>m*n`o"


def made(results, unread=()) -> Contents:
    return contents(Inputs(tuple(results), (), tuple(unread)), (), None, keep_going=True)


def troubled():
    """Return the paper's cases with one aborted and one in which a name means harm to every format."""
    cases = paper_cases()
    cases[5].attributes.update(status="aborted", status_reason="force 460 N is above 445 N at 2.1 s")
    del cases[5].metrics["exp_rths.tracking_max_m_s2"]
    cases[6].attributes["record_name"] = NASTY
    return cases


def markdown_rows(text: str, title: str) -> list[list[str]]:
    """Return the cells of the table under a heading."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"## {title}"))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").replace(r"\|", "\0").split("|")])
    return rows


def test_markdown_holds_table_5_1() -> None:
    rows = markdown_rows(markdown(tables(paper_cases())), "Table 5.1 Tracking error")
    assert rows[0][:4] == [
        "control",
        "(1) Shake table test published max",
        "(1) Shake table test published RMS",
        "(1) Shake table test paper max",
    ]
    ours = ["FF+FB", "0.0086", "0.0004", "0.0100", "0.0012", "0.0050", "0.0006", "0.1922", "0.0027"]
    assert ours in [row[:9] for row in rows]
    assert {len(row) for row in rows} == {13}


def test_every_cell_of_every_table_stands_in_markdown_and_latex() -> None:
    shown = tables(troubled())
    pages = {markdown: in_markdown, latex: number}
    for page, spelt in pages.items():
        text = page(shown)
        for table in (block for section in shown for block in section if isinstance(block, Table)):
            for row in table.rows:
                for cell in spread(row.cells):
                    assert spelt(cell) in text
    assert any(isinstance(block, Line) for section in shown for block in section)


def test_an_aborted_run_is_shown_in_every_format() -> None:
    found = made(troubled(), [Unread(Path("x.h5"), "x.h5: is truncated.")])
    shown = tables(found.inputs.results)
    for text in (markdown(shown), latex(shown), tidy(found), json.dumps(document(found))):
        assert "aborted" in text and "force 460 N is above 445 N at 2.1 s" in text
    for text in (tidy(found), json.dumps(document(found))):
        assert "x.h5: is truncated." in text


def test_names_that_mean_harm_mean_nothing() -> None:
    assert in_markdown(NASTY) == r"a\|b\_c\$d%e&amp;f\#g{h}i\\j\~k^l\<script\>m\*n\`o"
    text = markdown(tables(troubled()))
    assert "<script" not in text.replace(r"\<script", "")
    for rows in (markdown_rows(text, "Table 5.1 Tracking error"), markdown_rows(text, "Figures of merit")):
        assert len({len(row) for row in rows}) == 1


def test_numbers_are_typeset() -> None:
    assert number("1.2e-6") == r"$1.2\times10^{-6}$"
    assert number("1.2e-6*") == r"$1.2\times10^{-6}$\textsuperscript{*}"
    assert (number("-"), number("-0.5"), number("0.0012")) == ("--", "$-$0.5", "0.0012")


def test_a_labelled_line_keeps_its_label() -> None:
    made = [[labelled("rule", "a { b"), Line("")]]
    assert "rule a { b  " in markdown(made) and r"\noindent rule a \{ b\par" in latex(made)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
def test_latex_compiles(tmp_path: Path) -> None:
    (tmp_path / "tables.tex").write_text(latex([*tables(troubled()), [Line("a { b ~ c")]]))
    head = r"\documentclass{article}\usepackage[margin=1cm]{geometry}\usepackage{booktabs,longtable,array}"
    (tmp_path / "a.tex").write_text(head + r"\begin{document}\input{tables}\end{document}")
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "a.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout[-2000:]


def test_csv_holds_every_figure_to_the_last_bit() -> None:
    cases = troubled()
    cases.append(result({}, "best", case_name="nothing", status="failed", status_reason="the link, it broke"))
    rows = list(csv.DictReader(io.StringIO(tidy(made(cases)))))
    assert len({len(row) for row in rows}) == 1
    for index, case in enumerate(cases[:-1]):
        mine = [
            r
            for r in rows
            if (r["case_name"], r["method"]) == (case.attributes["case_name"], case.attributes["method"])
        ]
        told = {(r["figure"], r["number"]): float(r["value"]) for r in mine}
        expected = {}
        for path, value in case.metrics.items():
            if np.ndim(value):
                expected |= {(path, str(k)): item for k, item in enumerate(value, 1)}
            else:
                expected[path, ""] = value
        assert told == expected, index
        assert {r["unit"] for r in mine} == {"m/s^2"}
    (none,) = [r for r in rows if r["case_name"] == "nothing"]
    assert (none["status"], none["status_reason"], none["figure"]) == ("failed", "the link, it broke", "")
    theirs = [r for r in rows if r["figure"] == "exp_rths.rms_error_m_s2" and r["published"]]
    assert {(r["number"], r["published"]) for r in theirs} >= {("1", "0.0158"), ("3", "0.0615"), ("2", "0.0428")}


def test_json_fits_the_published_schema_and_says_all(tmp_path: Path) -> None:
    paths = [
        write(
            tmp_path / f"{seed}.h5",
            seed=seed,
            accept='{"exp_rths.rms_error_m_s2[3]": 0.02}',
            created_utc=f"2026-0{seed}",
        )
        for seed in (1, 2)
    ]
    paths.append(write(tmp_path / "c.h5", {}, "aborted", "too far", case_name="c"))
    before = read_inputs([paths[0]], lambda _: None)
    found = contents(read_inputs(paths, lambda _: None), ("seed",), ("old", before, 1.0), keep_going=False)
    made_document = document(found)
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(json.loads(json.dumps(made_document, allow_nan=False)))
    first = made_document["results"][0]
    assert first["metrics"]["exp_rths.rms_error_m_s2"] == [0.01, 0.02, 0.03]
    assert first["accept"] == [{"path": "exp_rths.rms_error_m_s2[3]", "limit": 0.02, "value": 0.03, "met": False}]
    assert made_document["figures"]["exp_rths.fei_delay_s"]["unit"] == "s"
    assert made_document["repeats"][0]["figures"]["exp_rths.rms_error_m_s2[2]"]["mean"] == 0.02
    assert made_document["baseline"]["cases"][0]["changes"][0]["verdict"] in ("same", "not judged")
    assert [one["status"] for one in made_document["results"]] == ["complete", "complete", "aborted"]
    del made_document["results"][0]["units"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(made_document, schema)


def test_json_gives_the_findings_of_a_result_with_code_and_values(tmp_path: Path) -> None:
    jump = Finding("sensor.jump", {"channel": "floor_2", "jump_v": 0.02, "at_s": 3.1}).at("at.run", run="EXP-RTHS")
    paths = [
        write(tmp_path / "new.h5", warnings=str(jump), findings=as_json([jump])),
        write(tmp_path / "old.h5", warnings=str(jump), case_name="old"),
    ]
    made_document = document(contents(read_inputs(paths, lambda _: None), (), None, keep_going=False))
    jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text())).validate(made_document)
    assert [one["findings"] for one in made_document["results"]] == [[as_data(jump)], []]


def test_an_interval_stands_in_every_format() -> None:
    plain = result({"check.tracking_rms_m_s2": 0.5, "exp_rths.rms_error_m_s2": [0.1, 0.2, 0.3]})
    ends = {"exp_rths.rms_error_m_s2": Interval([0.1, 0.2, 0.3], [0.05, 0.06, 0.07], [0.4, np.inf, 0.6], 0.75)}
    with_ends = replace(plain, intervals=ends)
    for made_document, expected in ((document(made([plain])), None), (document(made([with_ends])), ends)):
        jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text())).validate(made_document)
        (one,) = made_document["results"]
        assert ("intervals" in one) == (expected is not None)
    stated = {"low": [0.05, 0.06, 0.07], "high": [0.4, None, 0.6], "probability": 0.75}
    assert one["intervals"] == {"exp_rths.rms_error_m_s2": stated}
    assert "low" not in next(csv.reader(io.StringIO(tidy(made([plain])))))
    rows = list(csv.DictReader(io.StringIO(tidy(made([with_ends])))))
    assert [(row["low"], row["high"], row["probability"]) for row in rows] == [
        ("", "", ""), ("0.05", "0.4", "0.75"), ("0.06", "", "0.75"), ("0.07", "0.6", "0.75"),
    ]  # fmt: skip
    assert r"0.3 [0.07, 0.6] (75 %)" in markdown(tables([with_ends])).replace("\\", "")


def test_the_same_results_give_the_same_bytes() -> None:
    for page in (markdown, latex):
        assert page(tables(troubled())) == page(tables(troubled()))
    assert tidy(made(troubled())) == tidy(made(troubled()))
