"""What a key is made of: everything that is declared, bit by bit, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest

from rths_cli.numerics.content_key import content_key


@dataclass(frozen=True)
class Plate:
    """A record with every kind of field."""

    name: str
    masses: np.ndarray
    inner: tuple[object, ...] = ()
    note: str | None = None


class Pair(NamedTuple):
    """Two values with names."""

    a: object
    b: object


def plate() -> Plate:
    return Plate("a", np.array([1.0, 2.0, 3.0, 4.0]), (1, 2.5, True, Pair(1j, "x")))


def test_equal_contents_have_equal_keys_whatever_objects_hold_them() -> None:
    one = np.arange(6.0).reshape(2, 3)
    assert content_key(plate()) == content_key(plate())
    assert content_key(one, one) == content_key(one, one.copy())  # a shared object is no other content
    assert content_key(np.asfortranarray(one)) == content_key(one)
    assert content_key(np.float64(0.1), np.int64(3)) == content_key(0.1, 3)


def test_what_differs_anywhere_has_another_key() -> None:
    base = plate()
    variants = [
        base,
        replace(base, name="b"),
        replace(base, masses=np.array([1.0, 2.0, 3.0, np.nextafter(4.0, 5.0)])),
        replace(base, masses=base.masses.reshape(2, 2)),
        replace(base, masses=base.masses.astype(np.float32)),
        replace(base, masses=base.masses.astype(complex)),
        replace(base, inner=(1, 2.5, 1, Pair(1j, "x"))),
        replace(base, inner=(1, 2.5, True, (1j, "x"))),
        replace(base, inner=(1, (2.5, True, Pair(1j, "x")))),
        replace(base, note=""),
        replace(base, note="None"),
    ]
    for one, other in combinations(variants, 2):
        assert content_key(one) != content_key(other)
    assert content_key("ab", "c") != content_key("a", "bc")
    assert content_key("a", "b") not in (content_key("astrb"), content_key("astr 1:b"))
    assert content_key(0.0) != content_key(-0.0)
    assert content_key(1) != content_key(1.0) != content_key("1")


def test_a_nan_equals_itself() -> None:
    assert content_key(float("nan")) == content_key(float("nan"))


@pytest.mark.parametrize("value", [{}, [1.0], object(), {1}, np.array([object()]), Plate, (1, {})])
def test_what_has_no_declared_content_has_no_key(value: object) -> None:
    with pytest.raises(TypeError, match="a key is made of plain values"):
        content_key(value)


def test_another_process_makes_the_same_key() -> None:
    code = "from rths_cli.numerics.content_key import content_key as k; print(k('a', 1.5, (2, None)).hex())"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == content_key("a", 1.5, (2, None)).hex()
