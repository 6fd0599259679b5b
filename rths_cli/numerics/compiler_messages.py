"""Who is told that code is compiled, and what is wrong with the compiler."""

from __future__ import annotations

from collections.abc import Callable

_LISTENERS: list[Callable[[str], object]] = []
_TOLD: set[str] = set()


def announce(listener: Callable[[str], object]) -> None:
    """Have each message told once from now on."""
    _LISTENERS[:] = [listener]
    _TOLD.clear()


def tell(message: str) -> None:
    """Tell the listener a message, unless it has heard it."""
    if message not in _TOLD:
        _TOLD.add(message)
        for listener in _LISTENERS:
            listener(message)
