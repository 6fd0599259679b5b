"""How every result ended: its status and reason, what is missing, the check before it, the limits set for it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from rths_cli.files.results import Result
from rths_cli.report.page.facts import MET, NOT_MET, Limit, facts, is_virtual, name_of, status
from rths_cli.report.page.html import Html, classed, element, framed, join

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
