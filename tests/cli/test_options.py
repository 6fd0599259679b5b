"""Options with values that nothing can be made of: one sentence that is not longer than needed, code 2."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from rths_cli.case.resolve import read_settings
from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.files.accelerograms.peer import at2_header
from rths_cli.files.accelerograms.record import bracketed
from rths_cli.files.measured_data import read_recording
from rths_cli.files.measured_data.text_tables import interval_in_line
from rths_cli.safe_text import csv_cell
from rths_cli.studies.study_plan import Asked, read_plan

LONG = "a" * 300
DIGITS = "9" * 5000


@pytest.mark.parametrize(
    "line",
    [
        ["doctor", "--rate", "nan"],
        ["doctor", "--seconds", "nan"],
        ["serve", "--watchdog", "nan"],
        ["records", "el_centro", "--dt", "nan"],
        ["identify", "--output", ""],
        ["report", "x.h5", "--figures", ""],
        ["report", f"{LONG}.h5"],
        ["report", "x.h5", "--output", LONG],
        ["run", "el_centro_low_ff_fb", "--output", "a/" * 3000],
        ["identify", "--data", "loop/x.h5"],
        ["new", "a\0b"],
    ],
)
def test_a_value_that_means_nothing_is_one_short_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    done = CliRunner().invoke(cli, line, standalone_mode=False)
    refused = done.exception  # Python 3.13 opens what leads to a loop of links, and the file is refused
    assert isinstance(refused, click.BadParameter | InputError)
    assert len(str(refused) if isinstance(refused, InputError) else refused.format_message()) < 250
    assert [path.name for path in tmp_path.iterdir()] == ["loop"]


@pytest.mark.parametrize("key", ["\udcff", "scaling\x1b[2J", "a.\udcff.b"])
def test_a_key_that_is_no_text_is_refused_before_it_is_looked_for(key: str) -> None:
    """A byte that is no UTF-8 reaches Python as a surrogate, for which the schema has no place."""
    _, faults = read_settings([f"{key}=1"])
    assert len(faults) == 1 and "character that is no text" in str(faults[0])
    assert str(faults[0]).isprintable()


def test_a_path_of_very_many_keys_is_refused_before_it_is_followed() -> None:
    _, faults = read_settings([f"{'a.' * 1200}b=1"])
    assert len(faults) == 1 and "names 1201 keys inside each other" in str(faults[0])


@pytest.mark.campaign
@pytest.mark.parametrize("vary", [f"scaling=1:2:{DIGITS}", f"scaling={DIGITS}:2:3", f"scaling={DIGITS}"])
def test_numbers_of_thousands_of_digits_are_one_short_sentence(vary: str) -> None:
    with pytest.raises(InputError) as caught:
        read_plan(Asked("el_centro_low_ff_fb", (), (vary,), None))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        f"NPTS= {DIGITS}, DT= 0.01 SEC\n1\n2\n3\n",
        f"# samples: {DIGITS}\n# units: g\n# dt: 0.01\n1\n2\n3\n",
        f"time (s),{'(' * 40_000}\n0,1\n1,2\n2,3\n",
        f"NPTS= 3{' ' * 40_000}x\n1\n2\n3\n",
    ],
)
def test_hostile_headers_of_records_are_refused_at_once(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_accelerogram(path)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "header",
    [" " * 20_000 + "x", "dt" + " " * 20_000, "a " * 20_000 + "=", "x" * 140_000, "dt = " + " " * 20_000 + "x"],
)
def test_hostile_headers_of_recordings_are_read_at_once(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n" + "1,2\n" * 5)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("line", "interval"),
    [
        ("# dt: 0.0005 s", 0.0005),
        ("fs,2000", 0.0005),
        ('"Sample rate","500"', 0.002),
        ("\tsample rate\t2 kHz", 0.0005),
        ("% dt [s] = 5e-4", 0.0005),
        ("dt; 0,5 ms", 0.0005),
        ("fs: 2000 Hz, 3 channels", 0.0005),
        ("command, table", None),
        ("dt", None),
        ("remark: dt 5", None),
    ],
)
def test_the_linear_parser_reads_what_headers_state(line: str, interval: float | None) -> None:
    found = interval_in_line(Path("a.csv"), 1, line)
    assert (found and found[1]) == (interval and pytest.approx(interval, rel=1e-12))


def test_brackets_and_headers_of_records_are_found() -> None:
    assert bracketed("acceleration [m/s^2)") == "m/s^2" and bracketed("a (b") is None and bracketed("a) (b) (c)") == "b"
    found = at2_header(Path("a.AT2"), ["PEER", "TOWN", "IN  UNITS   OF  G", "NPTS =  5 ,  DT =  .0100 SEC"])
    assert found is not None and (found.samples, found.dt_s, found.unit) == (5, 0.01, "g")
    old = at2_header(Path("a.AT2"), ["x", "y", "z", "  5   .0200   NPTS, DT"])
    assert old is not None and (old.samples, old.dt_s) == (5, 0.02)


def test_no_text_becomes_a_formula_and_numbers_stay() -> None:
    texts = ["=1+1", "+cmd", "-2+3", "@SUM(A1)", "\tx", "\rx", "a=1", "", "-"]
    file = io.StringIO()
    csv.writer(file).writerow([csv_cell(text) for text in texts])
    (back,) = csv.reader(io.StringIO(file.getvalue(), newline=""))
    assert [cell[:1] for cell in back] == ["'", "'", "'", "'", "'", "'", "a", "", "'"]
    assert [cell.removeprefix("'") for cell in back] == texts


def test_a_setting_given_as_an_override_is_told_where_it_belongs() -> None:
    line = ["run", "el_centro_low_ff", "--override", "controller=FF"]
    refused = CliRunner().invoke(cli, line, standalone_mode=False).exception
    assert isinstance(refused, click.BadParameter) and "give it as --set controller=FF" in refused.format_message()
