"""Import this first, and the compiled functions of the package are interpreted: slow, but without minutes of compiling
for a change of one line. The arithmetic is the same but for products and sums that are joined in one instruction."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rths_cli.numerics import compiled


class Interpreted:
    """A function in place of compiled.Entry."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __call__(self, *arguments: object) -> Any:
        """Run the function."""
        return self.function(*arguments)

    def bind(self, *arguments: object) -> Callable[[], Any]:
        """Return the function without arguments, as compiled.Entry.bind."""
        return partial(self.function, *arguments)


def as_it_is(made: Any) -> Any:
    """Take the place of a decorator."""
    return made


for name in ("part", "fused_part", "kept_part", "shared_part", "part_class", "borrowed"):
    setattr(compiled, name, as_it_is)
compiled.entry = Interpreted
compiled.external = lambda *_: lambda *_: 0  # clocks
