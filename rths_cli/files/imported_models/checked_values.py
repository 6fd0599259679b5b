"""Take the values of an imported model out of its document one by one, collecting the faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.case.yaml_tree import Fault, printable
from rths_cli.files.imported_models.file_formats import Document
from rths_cli.numerics.lti import Array, ComplexArray


@dataclass(frozen=True)
class Reader:
    """Take values out of a document and collect what is wrong with them."""

    document: Document

    @property
    def faults(self) -> list[Fault]:
        """Return the faults found so far, those of the document's form included."""
        return self.document.faults

    def say(self, key: str, sentence: str) -> None:
        """Add a fault at the place of a key, or of the document where it is not stated."""
        entry = self.document.entries.get(key)
        name, mark = (entry.name, entry.mark) if entry else (key, self.document.mark)
        self.faults.append(Fault(mark, name, sentence))

    def numbers(self, key: str) -> ComplexArray | None:
        """Return finite numbers (n,); None when the key is missing or unusable."""
        value = self._value(key)
        if isinstance(value, str):
            self.say(key, f"must be numbers, got {value[:40]!r}")
        if value is None or isinstance(value, str):
            return None
        numbers = np.atleast_1d(value)
        wrong = numbers[~np.isfinite(numbers)]
        if wrong.size:
            self.say(key, f"must be finite, got {wrong[0]:g}")
            return None
        return numbers

    def reals(self, key: str) -> Array | None:
        """Return finite real numbers (n,); None when the key is missing or unusable."""
        values = self.numbers(key)
        if values is not None and np.any(values.imag != 0.0):
            self.say(key, "must be real, got a complex number")
            return None
        return None if values is None else values.real

    def number(self, key: str) -> float | None:
        """Return one finite real number; None when the key is missing or unusable."""
        values = self.reals(key)
        if values is not None and values.size != 1:
            self.say(key, f"must be one number, got {values.size}")
            return None
        return None if values is None else float(values[0])

    def word(self, key: str, choices: tuple[str, ...]) -> str:
        """Return one of the choices, the first when the key is missing or unusable."""
        value = self._value(key)
        if value is None or (isinstance(value, str) and value in choices):
            return choices[0] if value is None else str(value)
        got = repr(value[:40]) if isinstance(value, str) else "numbers"
        self.say(key, f"must be {', '.join(choices[:-1])} or {choices[-1]}, got {got}")
        return choices[0]

    def text(self, key: str) -> str:
        """Return text, empty when the key is missing or unusable."""
        value = self._value(key)
        return printable(" ".join(value.split())) if isinstance(value, str) else ""

    def stated(self, *keys: str) -> list[str]:
        """Return those of the keys that the document states, usable or not."""
        return [key for key in keys if key in self.document.entries]

    def _value(self, key: str) -> ComplexArray | str | None:
        entry = self.document.entries.get(key)
        return entry.value if entry else None
