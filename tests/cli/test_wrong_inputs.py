"""What a stranger reads after a wrong input: the list in tests/golden/wrong_inputs.txt, and what each message has."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from golden import golden
from wrong_inputs import WRONG, Wrong, listed

LONGEST_LINE = 300  # characters of a fault


@pytest.fixture(scope="module")
def outcomes() -> Iterator[list[tuple[Wrong, int, str]]]:
    """Return every wrong input with its exit code and text."""
    yield list(listed(whole=False))


def test_the_messages_are_those_of_the_kept_list(outcomes: list[tuple[Wrong, int, str]]) -> None:
    assert len(WRONG) >= 60
    text = "\n".join(text for _, _, text in outcomes)
    assert text == golden("wrong_inputs.txt", text)


def test_no_wrong_input_is_taken_for_a_right_one_or_for_our_own_fault(outcomes: list[tuple[Wrong, int, str]]) -> None:
    assert [(one.did, code) for one, code, _ in outcomes] == [(one.did, one.code) for one in WRONG]


def test_each_message_is_short_and_names_no_cause_twice(outcomes: list[tuple[Wrong, int, str]]) -> None:
    for one, _, text in outcomes:
        lines = [line for line in text.splitlines()[2:-1] if line]
        assert lines and len(set(lines)) == len(lines), one.did
        assert max(map(len, lines)) <= LONGEST_LINE, one.did
        assert not any("Traceback" in line or "/tmp/" in line for line in lines), one.did
