"""The small language of the catalogue's sentences: Python's format strings with units, words and optional parts.

| in a sentence | is |
|---|---|
| `{at_hz:.3g}` | the value `at_hz` in Python's format |
| `{delay_s:.3g ms}` | the value in another unit of `SCALES`, with the unit; `{delay_s:.3g (ms)}` without it |
| `{quantity!w}` | the value's words (`WORDS` of the catalogue) |
| `{names: and }` | a list with what stands between its entries; without it, "; " |
| `{count:?is/are}` | the first word for one, the second for more |
| `[, or {floor:-}a soft storey]` | `-` prints nothing: the value only decides whether its part is there |
| `[; {advice}]` | left out where a value in it is missing; `[[` and `]]` are brackets |
| `[to {needed_hz:g} Hz|farther]` | what stands behind the bar where a value before it is missing |
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from string import Formatter
from typing import Any

SCALES = {"%": 100.0, "ms": 1e3, "us": 1e6, "mm": 1e3, "mm/s^2": 1e3, "mV": 1e3}
_PARTS = re.compile(r"\[\[|\]\]|\[([^\[\]]*)\]")


class _Wording(Formatter):
    """Fills a sentence of the catalogue."""

    def __init__(self, words: Mapping[str, str]) -> None:
        self._words = words

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion != "w":
            return super().convert_field(value, conversion)  # type: ignore[arg-type]
        of = self._words.get
        return tuple(of(one, one) for one in value) if isinstance(value, tuple) else of(value, value)

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return (format_spec or "; ").join(str(one) for one in value)
        if format_spec == "-":
            return ""
        if format_spec.startswith("?"):
            return format_spec[1:].split("/")[value != 1]
        digits, _, unit = format_spec.partition(" ")
        if not unit:
            return format(value, digits)
        number = format(SCALES[unit.strip("()")] * value, digits)
        if unit == "%" and re.fullmatch(r"[\d.]+e\+0[1-5]", number):  # 180 %, not 1.8e+02 %
            number = f"{float(number):.0f}"
        return number if unit.startswith("(") else f"{number} {unit}"


@cache
def names_in(text: str) -> frozenset[str]:
    """Return the names of the values in a sentence, `advice` left out."""
    return frozenset(name for _, name, _, _ in Formatter().parse(text) if name and name != "advice")


def _there(value: Any) -> bool:
    return value is not None and value is not False and value not in ("", ())


def worded(text: str, values: Mapping[str, Any], words: Mapping[str, str]) -> str:
    """Return a sentence of the catalogue with its values; `words` for those that are told in words."""

    def part(found: re.Match[str]) -> str:
        if found[1] is None:
            return found[0][0]
        inside, _, otherwise = found[1].partition("|")
        names = (name for _, name, _, _ in Formatter().parse(inside) if name)
        return inside if all(_there(values.get(name)) for name in names) else otherwise

    return _Wording(words).vformat(_PARTS.sub(part, text), (), values)
