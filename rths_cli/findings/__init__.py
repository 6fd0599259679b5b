"""Findings: what a computation found that somebody must know, as data, and the one place where their sentences stand.

A bottom package, because result and model files store the sentences and `experiment` writes these files; `report` takes
findings and sentences as everybody else.
"""

from rths_cli.findings.catalogue import ADVICE, SENTENCES, WORDS
from rths_cli.findings.finding import (
    OF_INPUT,
    Finding,
    as_data,
    as_json,
    from_data,
    from_json,
    input_first,
    sentences,
    stated,
    without_repeats,
)

__all__ = [
    "ADVICE",
    "OF_INPUT",
    "SENTENCES",
    "WORDS",
    "Finding",
    "as_data",
    "as_json",
    "from_data",
    "from_json",
    "input_first",
    "sentences",
    "stated",
    "without_repeats",
]
