"""What a sentence of the catalogue is, and what a finding of its code does."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from rths_cli.findings.wording import names_in


class Sentence(NamedTuple):
    """The sentence of a code, and what such a finding does."""

    severity: str
    text: str

    @property
    def values(self) -> frozenset[str]:
        """Return the names of the values."""
        return names_in(self.text)


refuses = partial(Sentence, "refuses")  # a run or a model
warns = partial(Sentence, "warns")  # of what may make a result wrong
notes = partial(Sentence, "notes")  # what the program did, or what else is worth knowing
explains = partial(Sentence, "explains")  # a value of another finding: its cause or remedy
at = partial(Sentence, "at")  # begins the sentence of another finding: where it holds
