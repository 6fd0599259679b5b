"""Where results come from, and the commands that make them and their page again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from rths_cli.files.results import Result
from rths_cli.report.page.facts import facts, name_of
from rths_cli.report.page.html import Html, classed, details, element, join, table

ABOUT = {
    "rths_version": "version of rths",
    "git_commit": "commit",
    "package_versions": "packages",
    "platform": "platform",
    "rig": "rig",
    "rig_kind": "kind of rig",
    "driver_verified": "driver verified on",
    "seed": "seed",
    "sample_rate_hz": "sample rate (Hz)",
    "record_name": "record",
    "record_sha256": "record, SHA-256",
    "model_sha256": "table model, SHA-256",
    "model_source": "table model from",
    "overrides": "overrides",
}


def provenance(results: Sequence[Result]) -> Html:
    """Return what the results say of their making, each value once with the results that say so, and their files."""
    rows = (row for key, label in ABOUT.items() for row in _rows(results, key, label))
    made = ([name_of(r), r.path.name, str(r.attributes.get("created_utc") or "-")] for r in results)
    head = ["", "value", "results"] if len(results) > 1 else ["", "value"]
    told = (row[: len(head)] for row in rows)
    return join([table([head], told), table([["result", "file", "created (UTC)"]], made)])


def commands(results: Sequence[Result], command_line: str) -> Html:
    """Return the commands that made the results, then the one that made the page, each with a button to copy it."""
    made = dict.fromkeys(str(result.attributes.get("command_line") or "") for result in results)
    lines = {
        **{line: "made results" for line in made if line},
        **({command_line: "made this page"} if command_line else {}),
    }
    return join(_command(place, line, about) for place, (line, about) in enumerate(lines.items()))


def case_files(result: Result) -> Html:
    """Return the case of a result as written and with every default filled in, folded, and its notes."""
    notes = facts(result).notes
    parts = [classed("p", "note", f"Notes of the case: {notes}")] if notes else []
    for title, text in (("Case file as written", result.case_yaml), ("Case with all defaults", result.resolved_yaml)):
        parts += [details(title, element("pre", text))] if text else []
    return join(parts)


def _command(place: int, line: str, about: str) -> Html:
    name = f"command-{place}"
    button = element("button", "copy", attributes={"type": "button", "class": "copy", "data-copy": name})
    code = element("code", line, attributes={"id": name})
    return classed("div", "command", element("span", about), element("pre", code), button)


def _rows(results: Sequence[Result], key: str, label: str) -> Iterator[list[str]]:
    """Yield a row per value of an attribute: the value, and which results have it."""
    said: dict[str, list[str]] = {}
    for result in results:
        said.setdefault(_value(result, key), []).append(name_of(result))
    for place, (value, names) in enumerate(said.items()):
        if value or len(said) > 1:
            yield ["" if place else label, value or "-", "all" if len(said) == 1 else ", ".join(names)]


def _value(result: Result, key: str) -> str:
    text = str(result.attributes.get(key, "") if result.attributes.get(key) is not None else "")
    return ", ".join(_packages(text)) if key == "package_versions" else text


def _packages(text: str) -> Iterator[str]:
    """Yield name and version of each package of a JSON mapping; another text as it is."""
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if isinstance(found, dict):
        yield from (f"{name} {version}" for name, version in found.items())
    elif text:
        yield text
