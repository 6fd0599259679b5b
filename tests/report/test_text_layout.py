"""Numbers in six characters, and tables whose bars stand under each other."""

from hypothesis import given
from hypothesis import strategies as st

from rths_cli.report.numbers import six_wide
from rths_cli.report.text_layout import Cell, Row, Table, render, table_lines


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


def test_a_table_is_aligned_and_wraps_long_labels():
    rows = (
        Row("a heading that goes across"),
        Row("x" * 90, (Cell("1"), Cell("2"), Cell("aborted", 2))),
        Row("y", (Cell("aborted", 4),)),
    )
    heads = ((Cell("left", 2), Cell("right", 2)), tuple(Cell(name) for name in "abcd"))
    table = Table("Title", "corner", (2, 2), 7, heads, rows)
    lines = table_lines(table)
    assert {len(line) for line in lines} == {100}
    bars = {tuple(i for i, letter in enumerate(line) if letter == "|") for line in lines}
    assert bars == {(), (99,), (69, 84, 99), (69, 99)}
    assert "".join(lines).count("x") == 90
    assert render(table).splitlines()[0] == "Title"
