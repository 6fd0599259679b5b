"""The strict reader against JSON, which is YAML 1.2, and against what plain PyYAML gets wrong."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.case.load import load_cases
from rths_cli.case.yaml_reader import MAX_BYTES, Fault, Source, dump, dump_in_python, parse, plain, read_file
from rths_cli.errors import InputError

HERE = Source("a.yaml", Path("."))

NO_CHARACTERS = "\ufffe\uffff"  # YAML has none of them (specification 1.2, 5.1), and parse says so
TEXT = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters=NO_CHARACTERS), max_size=20
)
NUMBERS = st.integers(-(10**15), 10**15) | st.floats(allow_nan=False, allow_infinity=False)
DATA = st.recursive(
    st.none() | st.booleans() | NUMBERS | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)


def value(text: str) -> object:
    """Return what a faultless text holds."""
    node, faults = parse(text, HERE)
    assert node is not None and faults == []
    return plain(node)


def faults_in(text: str) -> list[str]:
    return [str(fault) for fault in parse(text, HERE)[1]]


def listed(data: object) -> object:
    """Return JSON-like data with lists for tuples."""
    if isinstance(data, dict):
        return {key: listed(entry) for key, entry in data.items()}
    return [listed(entry) for entry in data] if isinstance(data, tuple) else data


def same(one: object, other: object) -> bool:
    """Return whether data are equal including the types of numbers."""
    return repr(one) == repr(other)


@pytest.mark.campaign
@settings(max_examples=150, deadline=None)
@given(DATA)
def test_reads_json_as_json_does(data: object) -> None:
    text = json.dumps(data, ensure_ascii=False)
    assert same(listed(value(text)), json.loads(text))


@settings(max_examples=150, deadline=None)
@given(
    DATA
    | st.sampled_from(["1e-3", "yes", "on", "~", "null", "true", "0x1F", "1_000", "12:30", "2020-01-01", "=", "<<"])
)
def test_dump_and_parse_are_inverse(data: object) -> None:
    assert same(listed(value(dump(data))), data)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3", 0.001), ("1E3", 1000.0), (".5", 0.5), ("5.", 5.0), ("-2.5e+1", -25.0), ("+7", 7), ("010", 10),
        ("yes", "yes"), ("off", "off"), ("True", "True"), ("true", True), ("12:30", "12:30"), ("1_000", "1_000"),
        ("0x1F", "0x1F"), ("2020-01-01", "2020-01-01"), ("~", None), ("", None), ("'1e-3'", "1e-3"), ("!!str 5", "5"),
    ],
)  # fmt: skip
def test_scalars_of_yaml_1_2(text: str, expected: object) -> None:
    assert same(value(text), expected)


@pytest.mark.parametrize("text", [".nan", ".inf", "-.INF", "1e999", "9" * 400])
def test_refuses_numbers_that_are_not_finite(text: str) -> None:
    (fault,) = faults_in(f"a:\n  b: {text}")
    assert fault.startswith("a.yaml:2:6: a.b: must be a")


def test_a_number_near_the_largest_is_finite() -> None:
    assert math.isclose(value("1.7e308"), 1.7e308)  # type: ignore[arg-type]


def test_every_repeated_key_is_named_with_its_first_place() -> None:
    text = "a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\na: 4\n"
    assert faults_in(text) == [
        "a.yaml:5:3: b.c: repeated key, first at line 3; keep one",
        "a.yaml:6:1: a: repeated key, first at line 1; keep one",
    ]


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("a: [1, 2", "1:9", "not valid YAML"),
        ("a: 1\n\tb: 2", "2:1", "not valid YAML"),
        ("a: 1\n---\nb: 2", "2:1", "second document"),
        ("a: *x", "1:4", "undefined alias"),
        ("a: !!python/object:os.system x", "1:4", "tag"),
        ("a: !mine [1]", "1:4", "tag"),
        ("a: !!float abc", "1:4", "tag"),
        ("1: x", "1:1", "a key must be text"),
        ("[a]: x", "1:1", "a key must be text"),
        ("a: 1\nb: \x07", "2:4", "control character"),
        ('a: "\\ud800"', "1:4", "Unicode"),
        ('a: "\\UFFFFFFFF"', "1:1", "not valid YAML"),
    ],
)
def test_a_fault_has_its_place(text: str, place: str, words: str) -> None:
    (fault,) = faults_in(text)
    assert fault.startswith(f"a.yaml:{place}: ") and words in fault and "\n" not in fault


def test_aliases_are_expanded_but_not_without_end() -> None:
    assert value("a: &x [1, 2]\nb: *x") == {"a": (1, 2), "b": (1, 2)}
    bomb = "a: &a [x,x,x,x,x,x,x,x,x,x]\n"
    for last, key in zip("abcdefg", "bcdefgh", strict=True):
        bomb += f"{key}: &{key} [{','.join([f'*{last}'] * 10)}]\n"
    assert "values, aliases expanded" in faults_in(bomb)[0]
    assert "nested at most" in faults_in("a: &a [*a]")[0]


@pytest.mark.parametrize("text", ["[" * 100_000, "- " * 5000, "{a: " * 3000, "? " * 3000])
def test_deep_nesting_is_refused_before_it_costs(text: str) -> None:
    (fault,) = faults_in(text)
    assert "nested at most 50 deep" in fault


def test_refuses_what_is_no_readable_text_file(tmp_path: Path) -> None:
    def message(path: Path) -> str:
        text, node, faults = read_file(path)
        assert text == "" and node is None
        return str(faults[0])

    (tmp_path / "latin.yaml").write_bytes(b"a: 1\nb: caf\xe9\n")
    (tmp_path / "large.yaml").write_bytes(b"#" * (MAX_BYTES + 1))
    os.mkfifo(tmp_path / "pipe.yaml")
    assert "latin.yaml:2:7: is not UTF-8 text" in message(tmp_path / "latin.yaml")
    assert f"must be <= {MAX_BYTES} bytes" in message(tmp_path / "large.yaml")
    assert "not a regular file" in message(tmp_path / "pipe.yaml")
    assert "is a folder" in message(tmp_path)
    assert "No such file" in message(tmp_path / "none.yaml")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n")
    text, node, faults = read_file(tmp_path / "a.yaml")
    assert (text, faults) == ("a: 1\n", []) and node is not None and plain(node) == {"a": 1}


def test_a_fault_without_key_is_a_sentence_of_its_file() -> None:
    node, faults = parse("a: 1", HERE)
    assert node is not None and faults == []
    assert str(Fault(node.children["a"].mark, "", "is wrong")) == "a.yaml:1:4: is wrong"


def test_a_text_read_twice_gives_faults_of_its_own_each_time() -> None:
    _, faults = parse("a: 1\na: 2\n", HERE)
    faults.clear()
    assert [fault.key for fault in parse("a: 1\na: 2\n", HERE)[1]] == ["a"]
    assert [str(fault.mark) for fault in parse("a: 1\na: 2\n", Source("b.yaml", Path(".")))[1]] == ["b.yaml:2:1"]


CHARACTERS = " :#'\"-1.e?{],%\\\t\n\x07\u00e9\U0001f600"
PIECES = st.lists(st.sampled_from([*CHARACTERS, "word ", "long_word_", "true"]), max_size=60)


@pytest.mark.campaign
@given(st.dictionaries(TEXT, DATA | PIECES.map("".join), min_size=1, max_size=3))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_the_dumper_in_c_writes_what_the_one_in_python_writes(data: dict[str, object]) -> None:
    assert dump(data) == dump_in_python(data)


@pytest.mark.parametrize("space", ["\u00a0", "\u202f", "\u3000"])
@pytest.mark.parametrize(("text", "place"), [("a: 1\nb:{}2\nc: 3\n", "2:3"), ("a: 1\nb: 2\nc:{}3", "3:3")])
def test_a_space_of_another_kind_is_told_where_it_stands(text: str, place: str, space: str) -> None:
    (fault,) = parse(text.replace("{}", space), HERE)[1]
    assert f":{place}: " in str(fault) and f"U+{ord(space):04X}" in str(fault)


@pytest.mark.parametrize(("text", "place"), [("damping{}: low", "1:8"), ("{}damping: low", "1:1")])
def test_a_space_of_another_kind_in_a_key_is_told_where_it_stands(tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text.replace("{}", "\u00a0") + "\nrecord: el_centro\nstructure: three_storey\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_cases([path])
    assert any(f"a.yaml:{place}: " in fault and "no-break space (U+00A0)" in fault for fault in caught.value.faults)


def test_a_space_of_another_kind_within_a_text_is_left_alone() -> None:
    node, faults = parse('notes: "a\u00a0b"  # c\u00a0d\nplain: e\u00a0f\n', HERE)
    assert not faults and node is not None and plain(node) == {"notes": "a\u00a0b", "plain": "e\u00a0f"}
