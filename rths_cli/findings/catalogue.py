"""Every finding's code, severity and sentence; the words of its values; the advice. Nowhere else are they written.

The language of the sentences is explained in wording.py. The names of numbers end in their unit; a number without one
is a ratio, a count, or in the `units` that stand beside it.
"""

from __future__ import annotations

from rths_cli.findings import of_case, of_check, of_identification, of_stop
from rths_cli.findings.sentence import Sentence, refuses

# a sentence of bad input, or of a file of an earlier version, as it was written
STATED = {"stated": refuses("{text}")}
SENTENCES: dict[str, Sentence] = {
    **of_case.SENTENCES,
    **of_check.SENTENCES,
    **of_identification.SENTENCES,
    **of_stop.SENTENCES,
    **STATED,
}
WORDS = {**of_case.WORDS, **of_check.WORDS, **of_identification.WORDS}
ADVICE = of_check.ADVICE
