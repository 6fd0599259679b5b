"""A finding as data: a code, numbers in SI units, advice, where it holds; its sentence by the catalogue."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rths_cli.findings.catalogue import ADVICE, SENTENCES, WORDS
from rths_cli.findings.wording import worded

OF_INPUT = ("units.", "record.")  # beginnings of codes


@dataclass(frozen=True)
class Finding:
    """What a computation found that somebody must know; `str` returns its sentence.

    `code` and the names of `values` are those of the catalogue. A value is a number, a text, a finding or a tuple of
    these; one that does not apply is left out, or None. Raises ValueError for what the catalogue does not declare.
    """

    code: str
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    advice: tuple[str, ...] = ()  # codes
    within: tuple[Finding, ...] = ()  # where it holds, the widest first: a run, samples of the model, a tangent
    severity: str = ""  # refuses, warns, notes; "": that of the catalogue
    # required over found, or found over permitted: the larger, the worse; NaN: not known
    beyond: float = field(default=math.nan, compare=False)

    def __post_init__(self) -> None:
        """Refuse what the catalogue does not declare; take its severity where none is given."""
        if self.code not in SENTENCES:
            raise ValueError(f"{self.code} is no code of a finding")
        unknown = [*(set(self.values) - SENTENCES[self.code].values), *(set(self.advice) - set(ADVICE))]
        if unknown:
            raise ValueError(f"finding {self.code}: {unknown[0]} is not in the catalogue")
        object.__setattr__(self, "severity", self.severity or SENTENCES[self.code].severity)

    @property
    def kind(self) -> tuple[object, ...]:
        """Return what is the same wherever the finding is the same with other numbers."""
        return (*(where.code for where in self.within), self.code, self.values.get("quantity"))

    @property
    def alike(self) -> tuple[object, ...]:
        """Return what is the same wherever the finding differs in numbers alone."""
        within, texts = (where.alike for where in self.within), (_texts(value) for value in self.values.values())
        return (*within, self.code, *filter(None, texts))

    def at(self, code: str, **values: Any) -> Finding:
        """Return the finding, told of a place: a finding of severity `at`."""
        return replace(self, within=(Finding(code, values), *self.within))

    def __str__(self) -> str:
        """Return the sentence."""
        *others, last = (ADVICE[one] for one in self.advice) if self.advice else ("",)
        values = {**self.values, "advice": ", or ".join(filter(None, (", ".join(others), last)))}
        return "".join(f"{where}: " for where in self.within) + worded(SENTENCES[self.code].text, values, WORDS)


def stated(text: str, severity: str = "") -> Finding:
    """Return a sentence that was composed elsewhere: of bad input, or in a file without codes."""
    return Finding("stated", {"text": text}, severity=severity)


def sentences(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the sentences of findings."""
    return tuple(str(one) for one in findings)


def without_repeats(findings: Iterable[Finding], said: Iterable[Finding] = ()) -> tuple[Finding, ...]:
    """Return findings each of which is told once, without those whose sentence is `said` already."""
    told: dict[str, Finding] = {}
    for one in findings:
        told.setdefault(str(one), one)
    before = set(sentences(said))
    return tuple(one for text, one in told.items() if text not in before)


def input_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings with doubts of units and record first: they are often the cause of what the others tell."""
    return sorted(findings, key=lambda one: not one.code.startswith(OF_INPUT))


def as_data(found: Finding) -> dict[str, Any]:
    """Return a finding as plain texts, numbers and lists, with its sentence as `text`."""
    data: dict[str, Any] = {"code": found.code, "severity": found.severity}
    data["values"] = {name: _plain(value) for name, value in found.values.items() if value is not None}
    data["advice"] = list(found.advice)
    if found.within:
        data["within"] = [as_data(where) for where in found.within]
    return {**data, "text": str(found)}


def from_data(data: Mapping[str, Any]) -> Finding:
    """Return the finding of which `as_data` made the data; one that this version does not know is its text."""
    try:
        within = tuple(from_data(where) for where in data.get("within", ()))
        values = {name: _valued(value) for name, value in data["values"].items()}
        found = Finding(data["code"], values, tuple(data["advice"]), within, data["severity"])
        str(found)  # a number that is not finite has no sentence
        return found
    except (ValueError, TypeError):
        return stated(data["text"], data["severity"])


def as_json(findings: Iterable[Finding]) -> str:
    """Return findings as one text."""
    return json.dumps([as_data(one) for one in findings])


def from_json(text: str) -> tuple[Finding, ...]:
    """Return the findings of which `as_json` made a text, () of anything else."""
    try:
        return tuple(from_data(one) for one in json.loads(text or "[]"))
    except (ValueError, TypeError, KeyError, AttributeError):
        return ()


def _texts(value: Any) -> tuple[object, ...]:
    """Return the texts in a value of a finding."""
    if isinstance(value, tuple):
        return tuple(text for one in value for text in _texts(one))
    return value.alike if isinstance(value, Finding) else (value,) if isinstance(value, str) else ()


def _plain(value: Any) -> Any:
    """Return a value for JSON; a number that is not finite is None."""
    if isinstance(value, Finding):
        return as_data(value)
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, str | bool | int):
        return value
    return float(value) if math.isfinite(value) else None


def _valued(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_valued(one) for one in value)
    return from_data(value) if isinstance(value, dict) else value
