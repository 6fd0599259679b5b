"""Numbers in six characters, and documents as text: tables whose bars stand under each other, labels, verdicts."""

from hypothesis import given
from hypothesis import strategies as st

from rths_cli.report.document import RULE, Column, Line, Row, Table, across, grid, labelled
from rths_cli.report.numbers import six_wide
from rths_cli.report.to_text import laid_out_in, table_lines, text


@given(st.floats(0.0, 1e98))
def test_a_number_takes_six_characters_and_says_what_it_is(value):
    text = six_wide(value)
    assert len(text) <= 6
    if 0 < value < 1e-9:
        assert text == "<1e-9"
        return
    two_digits = value < 5e-5 or value >= 99999.5
    tolerance = 0.051 * value if two_digits else max(5.001e-5, 5.001e-5 * value)
    assert abs(float(text) - value) <= tolerance


def test_numbers_as_the_paper_prints_them():
    values = (0.0, 0.0004, 0.1922, 9.99994, 9.99996, 123.456, 99999.4, 1234567.0, 3.14e-5, 1e-30, 1e200)
    texts = ["0.0000", "0.0004", "0.1922", "9.9999", "10.000", "123.46", "99999", "1.2e6", "3.1e-5", "<1e-9", ">1e99"]
    assert [six_wide(value) for value in values] == texts


def test_a_number_stays_with_its_unit_where_a_sentence_wraps():
    for columns in range(20, 60):
        with laid_out_in(columns):
            made = text([[Line("true error below 0.185 % of SIM, at 12.5 m/s^2 and 2000 Hz, in the 3 storeys of 2 m")]])
        assert " ".join(made.split()).endswith("0.185 % of SIM, at 12.5 m/s^2 and 2000 Hz, in the 3 storeys of 2 m")
        assert not any(line.strip().startswith(("%", "m/s", "Hz")) or line.strip() == "m" for line in made.splitlines())


COLUMNS = tuple(Column(name, (group,)) for name, group in zip("abcd", ("left", "left", "right", "right"), strict=True))


def test_a_table_has_its_bars_below_each_other_and_wraps_long_labels():
    rows = (
        Row("a heading that goes across"),
        Row("x" * 90, ("1", "2", *across("aborted", 2))),
        RULE,
        Row("y", across("aborted", 4)),
    )
    lines = table_lines(Table(COLUMNS, rows, "Title", "corner"))
    assert {len(line) for line in lines} == {100}
    bars = {tuple(i for i, letter in enumerate(line) if letter == "|") for line in lines}
    label, between, end = max(bars, key=len)
    assert bars == {(), (end,), (label, end), (label, between, end)} and end == 99
    assert "".join(lines).count("x") == 90


def test_shared_headings_stand_once_and_units_below_the_names():
    columns = (Column("accel", ("peaks",), "m/s^2"), Column("drift", ("peaks",), "mm"), Column("grade", words=True))
    made = Table(columns, (Row("roof", ("1.0", "22.5", "good")), Row("1", ("0.5*", "3", "poor"))), corner="storey")
    assert text([[made]]) == (
        "               peaks\n"
        "storey  accel  drift  grade\n"
        "        m/s^2     mm\n"
        "roof     1.0    22.5  good\n"
        "1        0.5*      3  poor\n"
    )


def test_a_wide_table_without_a_title_goes_on_below_and_leaves_out_what_is_empty_there():
    rows = [["", *(f"a long heading {k}" for k in range(6))], ["row", *"123456"], ["half", "1", *[""] * 5]]
    with laid_out_in(60):
        lines = text([[grid(rows)]]).splitlines()
    assert max(map(len, lines)) <= 60 and [line for line in lines if line.split()[:1] == ["half"]] == [lines[2]]
    assert "".join("".join(line.split()[1:]) for line in lines if line.startswith("  row")) == "123456"


def test_a_cell_without_room_is_not_cut():
    with laid_out_in(60):
        lines = text([[grid([["a label", "said"], ["and its text", "word " * 14 + "end"], ["", "x"]])]]).splitlines()
    assert any("word word end" in line for line in lines)


def test_sections_are_apart_and_a_path_is_whole():
    path = "/" + "folder/" * 20
    made = [[Line("a title"), labelled("file", path), labelled("", "below")], [], [Line("word " * 30)]]
    lines = text(made).splitlines()
    assert lines[:3] == ["a title", f"{'file':<24}".rstrip(), f"{'':<24}{path}"] and lines[3] == f"{'':<24}below"
    assert lines[4] == "" and lines[5].startswith("word") and lines[6].startswith("  word")


def test_verdicts_are_marked_where_that_is_asked_for():
    made = [[labelled("verdict", "unsafe: no room", "unsafe"), Line("GOOD: well", verdict="GOOD")]]
    assert "\x0e" not in text(made)
    with laid_out_in(80, marked=True):
        assert text(made) == f"{'verdict':<24}\x0eunsafe\x0f: no room\n\x0eGOOD\x0f: well\n"
