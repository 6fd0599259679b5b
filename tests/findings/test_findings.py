"""A finding's sentence by the catalogue, its data and back, and a catalogue that holds what is used and no more."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from string import Formatter

import pytest

from rths_cli.findings import (
    ADVICE,
    SENTENCES,
    WORDS,
    Finding,
    as_data,
    from_data,
    sentences,
    stated,
    without_repeats,
)
from rths_cli.findings.wording import worded

PACKAGE = Path(__file__).parents[2] / "rths_cli"
SOURCE = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py") if path.parent.name != "findings"}
ERROR = Finding("loop.table_error", {"tolerated": 0.0312, "required": 0.06, "at_hz": 9.3}, ("cut_higher", "use_ff"))


@pytest.mark.parametrize(
    ("text", "values", "said"),
    [
        ("{delay_s:.3g ms} at {share:.2f %}", {"delay_s": 0.00123, "share": 0.5}, "1.23 ms at 50.00 %"),
        ("from {share:.0f (%)} to {most:.0f %}", {"share": 0.1, "most": 0.2}, "from 10 to 20 %"),
        ("below {a:.2g %}, {b:.2g %}", {"a": 1.84, "b": 0.0184}, "below 180 %, 1.8 %"),
        ("{names: and }; {others}", {"names": ("a", "b"), "others": ("c", "d")}, "a and b; c; d"),
        ("{what!w}, {all!w:, }", {"what": "x", "all": ("x", "y")}, "an X, an X, y"),
        ("{one:?is/are}, {two:?is/are}", {"one": 1, "two": 2}, "is, are"),
        ("a[{yes:-}, b][{no:-}, c]", {"yes": True, "no": False}, "a, b"),
        ("a[ {b}][ and {c}]", {"b": "", "c": 0.0}, "a and 0.0"),
        ("to [{hz:g} Hz|more], [[x]]", {}, "to more, [x]"),
        ("to [{hz:g} Hz|more]", {"hz": 3.0}, "to 3 Hz"),
        ("{text}", {"text": "[{no}]"}, "[{no}]"),
    ],
)
def test_the_language_of_the_sentences(text: str, values: dict[str, object], said: str) -> None:
    assert worded(text, values, {"x": "an X"}) == said


def test_a_finding_is_told_with_its_advice_and_where_it_holds() -> None:
    told = "the loop tolerates only 3.12 % error of the table at 9.3 Hz, 6.00 % is required; cut the building higher up"
    assert str(ERROR) == f"{told}, or use controller FF"
    there = ERROR.at("at.tangent", tangent="storey 1 stiffest").at("at.samples", count=2, of=9, quoted="worst")
    where = "in 2 of 9 samples of the identified model (the worst is told): with storey 1 stiffest: "
    assert str(there) == f"{where}{ERROR}"
    assert there.kind == ("at.samples", "at.tangent", "loop.table_error", None) != ERROR.kind
    assert there.severity == "refuses"


def test_what_the_catalogue_does_not_declare_is_refused() -> None:
    for given in (("loop.no_such",), ("loop.delay", {"delay": 1.0}), ("loop.delay", {}, ("no_such_advice",))):
        with pytest.raises(ValueError, match=r"is no code|not in the catalogue"):
            Finding(*given)


def test_findings_come_back_from_json() -> None:
    rejected = Finding("model.rejected", {"reasons": (ERROR, stated("made up"))}, ("improve_or_override",))
    for one in (ERROR, rejected, stated("a note", "notes").at("at.run", run="EXP-RTHS")):
        data = json.loads(json.dumps(as_data(one), allow_nan=False))
        assert from_data(data) == one and data["text"] == str(one)
    endless = as_data(Finding("loop.unstable", {"spectral_radius": 1.1, "growth": math.inf}))
    assert endless["values"] == {"spectral_radius": 1.1, "growth": None}
    unknown = {**as_data(ERROR), "code": "of.a_later_version"}
    assert str(from_data(unknown)) == str(ERROR)


def test_a_sentence_is_told_once() -> None:
    other = Finding("loop.measured_response", {}, ("identify_again",))
    assert without_repeats((ERROR, other, ERROR)) == (ERROR, other)
    assert without_repeats((ERROR, other), (stated(str(ERROR)),)) == (other,)
    assert sentences((other,)) == (str(other),)


def test_every_code_advice_and_word_is_used() -> None:
    every = "\n".join(SOURCE.values())
    used = set(re.findall(r'"([a-z_0-9]+(?:\.[a-z_]+)?)"', every))
    by_kind = {
        code for code in SENTENCES if code.startswith(("cause.", "stop.", "suspect."))
    }  # their codes are composed
    assert set(SENTENCES) - used - by_kind - {"stated"} == set()
    assert set(ADVICE) - used == set()
    assert set(WORDS) - used - {"pole_pair", "zero_pair"} == set()


def made_up(spec: str) -> object:
    """Return a value that suits the format of a field."""
    return 1.0 if re.match(r"\.?\d|g|\?|-", spec) else ("x", "y") if spec else "x"


def test_every_sentence_can_be_composed() -> None:
    for code, sentence in SENTENCES.items():
        fields = [(name, spec or "") for _, name, spec, _ in Formatter().parse(sentence.text) if name]
        values = {name: made_up(spec) for name, spec in fields if name != "advice"}
        assert str(Finding(code, values)).strip(), code
