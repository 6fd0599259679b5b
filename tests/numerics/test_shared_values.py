"""What is kept: made once, the least recently used goes first, failures are not kept."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Event
from time import sleep

import pytest

from rths_cli.numerics.shared_values import SharedValues


def test_a_value_is_made_once_and_the_one_not_used_longest_is_made_anew() -> None:
    shared, made = SharedValues(size=2), []

    def get(key: str, kind: str = "a") -> str:
        return shared.get(kind, key, lambda: made.append(key) or key.upper())  # type: ignore[func-returns-value]

    assert [get(key) for key in ("x", "y", "x", "z", "x")] == ["X", "Y", "X", "Z", "X"]
    assert made == ["x", "y", "z"]
    get("y")
    assert made == ["x", "y", "z", "y"]
    get("x", kind="b")
    assert made[-1] == "x" and len(made) == 5


def test_what_fails_is_tried_again() -> None:
    shared = SharedValues()
    with pytest.raises(ZeroDivisionError):
        shared.get("a", 1, lambda: 1 / 0)
    assert shared.get("a", 1, lambda: 2.0) == 2.0


def test_threads_that_ask_for_the_same_wait_for_the_first() -> None:
    shared, made, begun = SharedValues(), [], Event()

    def make() -> int:
        made.append(1)
        begun.set()
        sleep(0.05)  # the others ask meanwhile
        return len(made)

    with ThreadPoolExecutor(4) as pool:
        first = pool.submit(shared.get, "a", "x", make)
        assert begun.wait(10)
        others = [pool.submit(shared.get, "a", "x", make) for _ in range(3)]
        assert [each.result() for each in (first, *others)] == [1, 1, 1, 1]
