"""Generate docs/reference/findings.md from the catalogue of findings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import groupby

from rths_cli.findings import ADVICE, SENTENCES
from rths_cli.findings.of_stop import FACTS, TOLD
from rths_cli.findings.wording import SCALES

HEAD = """# Every finding and what it says

What a check, an identification or a run finds is a code with values and advice, made to a sentence by
`rths_cli/findings/`. `--json` of `rths check`, `rths identify` and `rths report` gives both, in `findings`: `code`,
`severity`, `values`, `advice`, `text`, and `within` where the finding holds in a part only (codes beginning with `at`).

A finding `refuses` a run or a model, `warns` of what may make a result wrong, or `notes` what else is worth knowing;
one that `explains` is a value of another. Below stands the usual severity, in JSON that of the case at hand.

A name in code stands for the value of that name, in SI units, whatever unit the sentence prints: the name ends in the
unit; without one it is a text, a ratio, a count, or in the `units` beside it. A text may be a code, for which the
sentence has words. A number that is not finite is `null`. A part in brackets is left out where it does not apply;
behind a bar stands what is said instead. What follows, and what to do, which a sentence says behind a semicolon, is
left out here; `also` names values that stand there alone. Codes and names of values stay; sentences may change.
"""
GROUPS = {
    "assumption": "What the check assumes",
    "at": "Where a finding holds",
    "calibration": "Calibration",
    "case": "The case",
    "cause": "Causes, told in another finding",
    "channel": "One channel",
    "channels": "Several channels",
    "command": "The command",
    "delay": "The delay",
    "design": "What the design chose",
    "excitation": "The excitation",
    "free_vibration": "The free vibration",
    "friction": "Friction of the table",
    "guard": "The guard's limits in a run",
    "stop": "Why the guard stopped a run; each has `cause`, `details`, `channel`, `seen`, `limit`, `units` and `key`",
    "level": "The level of the motion",
    "loop": "The loop",
    "model": "The identified model",
    "parts": "Parts of the caller's own",
    "reaction": "The specimen's reaction",
    "record": "The record",
    "remedy": "Remedies, told in another finding",
    "root": "Poles and zeros, told in another finding",
    "run": "A run",
    "scale": "The scale",
    "sensor": "Sensors in a run",
    "session": "What changed since the identification",
    "specimen": "The specimen",
    "stated": "Sentences without a code",
    "suspect": "A single fault that would explain the channels",
    "table": "The table",
    "true_error": "The true error",
    "units": "Numbers that seem to be in another unit",
    "verification": "A model file against the rig as it is",
}
FIELD = re.compile(r"\{(\w+)(?:!\w)?(?::([^}]*))?\}")


def findings_page() -> str:
    """Return the page as Markdown: a list per group of codes, then the advice."""
    parts = [HEAD.rstrip()]
    for group, codes in groupby(sorted(SENTENCES), key=lambda code: code.partition(".")[0]):
        parts += ["", f"## {GROUPS[group]}", "", *(_line(code) for code in codes)]
    parts += ["", "## Advice", "", _told(ADVICE)]
    return "\n".join(parts) + "\n"


def _told(words: Mapping[str, str]) -> str:
    """Return codes with what they say, in one paragraph; a code that says itself stands alone."""
    return "; ".join(
        f"`{one}`" if one.replace("_", " ") == text else f"`{one}`: {text}" for one, text in sorted(words.items())
    )


def _line(code: str) -> str:
    sentence = SENTENCES[code]
    severity = "" if sentence.severity == "at" else f" ({sentence.severity})"
    text = sentence.text.removeprefix(TOLD).removesuffix(FACTS)
    said = _before_advice(text)
    also = sorted(_fields(text) - _fields(said))
    rest = f" (also {', '.join(f'`{name}`' for name in also)})" if also else ""
    return f"- `{code}`{severity}: {FIELD.sub(_shown, said)}{rest}"


def _before_advice(text: str) -> str:
    """Return a sentence up to its first semicolon outside of brackets, behind which it says what to do."""
    for end in (found.start() for found in re.finditer("; ", text)):
        if all(text.count(opening, 0, end) == text.count(closing, 0, end) for opening, closing in ("[]", "()", "{}")):
            return text[:end]
    return text


def _fields(text: str) -> set[str]:
    return {found[1] for found in FIELD.finditer(text)}


def _shown(field: re.Match[str]) -> str:
    """Return a value as the page names it, with the unit in which the sentence prints it."""
    _, _, unit = (field[2] or "").partition(" ")
    return f"`{field[1]}` {unit}" if unit in SCALES else f"`{field[1]}`"
