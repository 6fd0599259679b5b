"""Who is told that code is compiled, and what is wrong with the compiler."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_LISTENERS: list[Callable[[str], object]] = []
_TOLD: set[str] = set()
_WATCHERS: list[Callable[[str, bool], object]] = []
_ENTRY: ContextVar[list[str]] = ContextVar("entry")


def announce(listener: Callable[[str], object]) -> None:
    """Have each message told once from now on."""
    _LISTENERS[:] = [listener]
    _TOLD.clear()


def watch(watcher: Callable[[str, bool], object]) -> None:
    """Have each function that is compiled told by its name, with True as it begins and with False as it ends."""
    _WATCHERS[:] = [watcher]


def tell(message: str) -> None:
    """Tell the listener a message, unless it has heard it."""
    if message not in _TOLD:
        _TOLD.add(message)
        for listener in _LISTENERS:
            listener(message)


@contextmanager
def compiles(name: str) -> Iterator[None]:
    """Tell the watcher that the function of this name is compiled, from `began` on, which loading from the cache does
    not call."""
    pending = [name]
    before = _ENTRY.set(pending)
    try:
        yield
    finally:
        _ENTRY.reset(before)
        if not pending:
            for watcher in _WATCHERS:
                watcher(name, False)


def began() -> None:
    """Tell the watcher, once, that the function of the surrounding `compiles` is being compiled."""
    if pending := _ENTRY.get([]):
        name = pending.pop()
        for watcher in _WATCHERS:
            watcher(name, True)
