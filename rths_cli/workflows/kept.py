"""What was made last, by what it was made from: many cases share a record, a building, a design."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

T = TypeVar("T")


class Kept:
    """The last values made of each kind, at most `size` of a kind."""

    def __init__(self, size: int = 8) -> None:
        self._size = size
        self._kinds: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, kind: str, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a kind that was made from `key`, or make it; what `make` raises is not kept."""
        values = self._kinds.setdefault(kind, OrderedDict())
        if key not in values:
            values[key] = make()
            if len(values) > self._size:
                values.popitem(last=False)
        values.move_to_end(key)
        found: T = values[key]
        return found
