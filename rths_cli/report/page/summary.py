"""The head of the page: how every result ended, its limits, where it comes from, commands to repeat it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.case.yaml_reader import parse
from rths_cli.case.yaml_tree import Source, plain
from rths_cli.files.result_reader import Result
from rths_cli.report.page.html import Html, classed, details, element, framed, join, table
from rths_cli.rigs.description import capabilities_of

MET, NOT_MET, NOT_JUDGED = "met", "not met", "not judged"
RUNS = {"sim": "SIM", "sim_delay": "SIM-DELAY", "shake_table": "shake table test", "exp_rths": "EXP-RTHS"}


@dataclass(frozen=True)
class Limit:
    """Hold an `accept` limit of a case: the figure's path, the limit, the figure (None: not there) and the verdict."""

    path: str
    limit: float
    value: float | None
    verdict: str


@dataclass(frozen=True)
class Facts:
    """Hold what a case asked for: `missing` are the runs that are not in its result."""

    missing: tuple[str, ...]
    limits: tuple[Limit, ...]
    latency_samples: int
    notes: str


def facts(result: Result) -> Facts:
    """Return what the resolved case of a result says; a result without one asked for nothing."""
    node, _ = parse(result.resolved_yaml, Source("case/resolved", Path()))
    found = plain(node) if node is not None else {}
    case: Mapping[str, Any] = found if isinstance(found, dict) else {}
    accept = _mapping(case.get("accept"))
    limits = tuple(_limit(result, str(path), limit) for path, limit in accept.items() if isinstance(limit, int | float))
    latency = _mapping(_mapping(case.get("table")).get("converters")).get("latency_samples", 1)
    missing = tuple(RUNS.get(str(run), str(run)) for run in case.get("runs") or () if run not in result.groups)
    return Facts(missing, limits, latency if isinstance(latency, int) else 1, str(case.get("notes") or ""))


def is_virtual(result: Result) -> bool:
    """Tell whether a result is of a virtual rig."""
    return not capabilities_of(str(result.attributes.get("rig_kind", ""))).moves_hardware


def status(result: Result) -> str:
    """Return how a run ended."""
    return str(result.attributes.get("status", "complete"))


def name_of(result: Result) -> str:
    """Return case and method of a result, and the instant of a run on a real rig, which may be one of several."""
    a = result.attributes
    when = "" if is_virtual(result) else f", {a.get('created_utc') or '-'}"
    return f"{a.get('case_name') or '-'} ({a.get('method') or '-'}{when})"


def _limit(result: Result, path: str, limit: float) -> Limit:
    value = _figure(result, path)
    if status(result) != "complete":
        return Limit(path, limit, value, NOT_JUDGED)
    return Limit(path, limit, value, MET if value is not None and abs(value) <= limit else NOT_MET)


def _figure(result: Result, path: str) -> float | None:
    """Return the figure of a path: of its storey, counted from 1, or the largest, as `rths run` judges it."""
    name, _, index = path.partition("[")
    if name not in result.metrics:
        return None
    values = np.atleast_1d(np.asarray(result.metrics[name], dtype=float))
    place = int(index.rstrip("]")) - 1 if index else int(np.abs(values).argmax())
    return float(values[place]) if place < values.size else None


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


GOOD, BAD, OPEN = "good", "bad", "open"
CHECKED = {"safe": GOOD, "unsafe": BAD, "unstable": BAD}
HEADS = ("result", "table", "status", "check before", "accept limits")


def verdicts(results: Sequence[Result]) -> Html:
    """Return a row per result; none is left out, whatever became of it."""
    head = element("tr", *(element("th", text) for text in HEADS))
    rows = join(element("tr", *_cells(result)) for result in results)
    return join([framed(classed("table", "words", element("thead", head), element("tbody", rows))), *_notes(results)])


def summary(results: Sequence[Result]) -> str:
    """Return how many results ended how, and how many limits were met, or not."""
    ends = [status(result) for result in results]
    told = [f"{ends.count(end)} {end}" for end in dict.fromkeys(ends)]
    limits = [limit.verdict for result in results for limit in facts(result).limits]
    judged = ", ".join(f"{limits.count(word)} {word}" for word in dict.fromkeys(limits))
    return f"{', '.join(told)}; {f'accept limits: {judged}' if limits else 'no accept limits set'}"


def pill(kind: str, text: str) -> Html:
    """Return a word of judgement: its colour repeats what the word says."""
    return classed("span", f"pill {kind}", text)


def _cells(result: Result) -> Iterator[Html]:
    a = result.attributes
    kind = "virtual" if is_virtual(result) else f"{a.get('rig_kind', '-')} {a.get('driver_verified', '')}".strip()
    checked = str(a.get("check_verdict") or "-")
    contents: tuple[Iterable[str], ...] = (
        [f"{a.get('rig', '-')}, {kind}"],
        _ending(result),
        [pill(CHECKED.get(checked, OPEN), checked), *_overrides(result)],
        _limits(facts(result).limits),
    )
    yield element("th", name_of(result), attributes={"scope": "row"})
    for head, content in zip(HEADS[1:], contents, strict=True):
        yield element("td", *content, attributes={"data-head": head})


def _ending(result: Result) -> Iterator[Html]:
    """Yield status, reason, and runs that were asked for and are not there."""
    end, reason = status(result), str(result.attributes.get("status_reason") or "")
    yield pill(GOOD if end == "complete" else BAD, end)
    told = [reason] if reason else ["no reason stored"] if end != "complete" else []
    missing = facts(result).missing
    told += [f"missing: {', '.join(missing)}"] if missing else []
    yield from (classed("div", "reason", text) for text in [*told, *_divergences(result)])


def _notes(results: Sequence[Result]) -> Iterator[Html]:
    """Yield what a reader should know before trusting a result, once, with the results that it is about."""
    said: dict[str, list[str]] = {}
    for result in results:
        for text in str(result.attributes.get("warnings") or "").splitlines():
            said.setdefault(text, []).append(name_of(result))
    for text, names in said.items():
        about = "all results" if len(names) == len(results) else ", ".join(names)
        yield classed("p", "note", f"Note on {about}: {text}")


def _divergences(result: Result) -> Iterator[str]:
    for path, value in result.metrics.items():
        if path.endswith(".diverged_at_s"):
            yield f"{path.partition('.')[0]} diverged at {float(value):.2f} s"


def _overrides(result: Result) -> Iterator[Html]:
    if result.attributes.get("overrides"):
        yield classed("div", "reason", f"overridden: {result.attributes['overrides']}")


def _limits(limits: Sequence[Limit]) -> Iterator[Html]:
    if not limits:
        yield Html("none")
    for one in limits:
        value = "not computed" if one.value is None else f"{one.value:.4g}"
        kind = GOOD if one.verdict == MET else BAD if one.verdict == NOT_MET else OPEN
        text = f" {one.path}: {value}, limit {one.limit:g}"
        yield element("div", pill(kind, one.verdict), text)


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
