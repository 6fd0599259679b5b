"""A memo in memory, shared by threads: the last values computed (SIM, designs, ...), each by what it was made from."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock, RLock
from typing import Any, TypeVar

T = TypeVar("T")


class _Value:
    """A value that is made once; `made` is empty until then."""

    def __init__(self) -> None:
        self.lock = RLock()
        self.made: tuple[Any, ...] = ()


class SharedValues:
    """The last values made of each kind, at most `size` of a kind. Threads that ask for the same wait for the first."""

    def __init__(self, size: int = 20) -> None:  # the choice of a feedback asks for 17 designs in turn
        self.size = size
        self._kinds: dict[str, OrderedDict[Hashable, _Value]] = {}
        self._lock = Lock()

    def get(self, kind: str, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a kind that was made from `key`, or make it; what `make` raises is not kept."""
        value = self._place(kind, key)
        with value.lock:
            if not value.made:
                value.made = (make(),)
            found: T = value.made[0]
        return found

    def _place(self, kind: str, key: Hashable) -> _Value:
        """Return where the value of a key stands or will stand; the place not asked for longest goes."""
        with self._lock:
            values = self._kinds.setdefault(kind, OrderedDict())
            value = values.setdefault(key, _Value())
            values.move_to_end(key)
            if len(values) > self.size:
                values.popitem(last=False)
            return value
