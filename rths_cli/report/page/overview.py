"""The first screen of the page: status, limits and origin of results, verdict, sketch of the building, its response."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from rths_cli.analysis.grade import GOOD as GOOD_TEST
from rths_cli.analysis.grade import USABLE, Judged
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.files.stored_case import stored_case, storey_heights_m
from rths_cli.numerics.lti import Array
from rths_cli.report.answer import about, base_shear, grade, not_accepted, storey_table, storeys_with_laws, verdict
from rths_cli.report.document import grid
from rths_cli.report.results_by_case import RUN_NAMES, judge, status
from rths_cli.report.to_html import Html, classed, details, element, framed, join, table
from rths_cli.rigs.description import capabilities_of

MET, NOT_MET, NOT_JUDGED = "met", "not met", "not judged"

GOOD, BAD, OPEN = "good", "bad", "open"
JUDGED = {MET: GOOD, NOT_MET: BAD, NOT_JUDGED: OPEN}
CHECKED = {"safe": GOOD, "unsafe": BAD, "unstable": BAD}
HEADS = ("result", "table", "status", "check before", "accept limits")
SAID = "verdict"  # of several results, whose first screen shows one
ABOUT = {
    "rths_version": "version of rths",
    "git_commit": "commit",
    "package_versions": "packages",
    "platform": "platform",
    "rig": "rig",
    "rig_kind": "kind of rig",
    "calibration": "calibration of the rig",
    "driver_verified": "driver verified on",
    "seed": "seed",
    "sample_rate_hz": "sample rate (Hz)",
    "record_name": "record",
    "record_sha256": "record, SHA-256",
    "record_baseline": "removed from the record",
    "model_sha256": "table model, SHA-256",
    "model_source": "table model from",
    "overrides": "overrides",
}
MOST_RESULTS_UNFOLDED = 1
WIDE, HIGH, GROUND = 264.0, 330.0, 314.0  # of the sketch, and where its ground is, in px
LEFT, RIGHT = 20.0, 105.0  # its columns
ROOM = 12.0  # between two labels of floors, at least
LETTER = 6.2  # width of one


def missing(result: Result) -> list[str]:
    """Return the runs that the case asks for and the result does not hold."""
    runs = stored_case(result).get("runs") or ()
    return [RUN_NAMES.get(str(run), str(run)) for run in runs if run not in result.groups]


def limits(result: Result) -> list[tuple[str, Judged]]:
    """Return the accept limits of a case, each with its verdict: MET, NOT_MET or NOT_JUDGED."""
    whole = status(result) == COMPLETE
    return [(NOT_JUDGED if not whole else MET if one.met else NOT_MET, one) for one in judge(result)]


def is_virtual(result: Result) -> bool:
    """Return whether the rig of a result is virtual."""
    return not capabilities_of(str(result.attributes.get("rig_kind", ""))).moves_hardware


def name_of(result: Result) -> str:
    """Return case and method of a result; on a real rig also the time of the run, as there may be several."""
    a = result.attributes
    when = "" if is_virtual(result) else f", {a.get('created_utc') or '-'}"
    return f"{a.get('case_name') or '-'} ({a.get('method') or '-'}{when})"


def verdict_table(results: Sequence[Result]) -> Html:
    """Return a table with a row for every result, whatever its status, followed by the warnings."""
    heads = (*HEADS, SAID) if len(results) > 1 else HEADS
    head = element("tr", *(element("th", text) for text in heads))
    rows = join(element("tr", *_cells(result, heads)) for result in results)
    return join([framed(classed("table", "words", element("thead", head), element("tbody", rows))), *_notes(results)])


def summary(results: Sequence[Result]) -> str:
    """Return in words the number of results by status, and the number of accept limits by verdict."""
    ends = [status(result) for result in results]
    told = [f"{ends.count(end)} {end}" for end in dict.fromkeys(ends)]
    words = [word for result in results for word, _ in limits(result)]
    judged = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    return f"{', '.join(told)}; {f'accept limits: {judged}' if words else 'no accept limits set'}"


def pill(kind: str, text: str) -> Html:
    """Return a verdict as a coloured word; `kind` selects the colour."""
    return classed("span", f"pill {kind}", text)


def _cells(result: Result, heads: Sequence[str]) -> Iterator[Html]:
    a = result.attributes
    kind = "virtual" if is_virtual(result) else f"{a.get('rig_kind', '-')} {a.get('driver_verified', '')}".strip()
    checked = str(a.get("check_verdict") or "-")
    contents: tuple[Iterable[str], ...] = (
        [f"{a.get('rig', '-')}, {kind}"],
        _ending(result),
        [pill(CHECKED.get(checked, OPEN), checked), *_overrides(result)],
        _limits(limits(result)),
        [verdict(result)],
    )
    yield element("th", name_of(result), attributes={"scope": "row"})
    for head, content in zip(heads[1:], contents, strict=False):
        yield element("td", *content, attributes={"data-head": head})


def _ending(result: Result) -> Iterator[Html]:
    """Yield status, reason, and requested runs that are missing."""
    end, reason = status(result), str(result.attributes.get("status_reason") or "")
    yield pill(GOOD if end == COMPLETE else BAD, end)
    told = [reason] if reason else ["no reason stored"] if end != COMPLETE else []
    absent = missing(result)
    told += [f"missing: {', '.join(absent)}"] if absent else []
    yield from (classed("div", "reason", text) for text in [*told, *_divergences(result)])


def _notes(results: Sequence[Result]) -> Iterator[Html]:
    """Yield each warning once, with the results to which it applies."""
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


def _limits(judged: Sequence[tuple[str, Judged]]) -> Iterator[Html]:
    if not judged:
        yield Html("none")
    for word, one in judged:
        value = "not computed" if one.value is None else f"{one.value:.4g}"
        yield element("div", pill(JUDGED[word], word), f" {one.path}: {value}, limit {one.limit:g}")


def provenance(results: Sequence[Result]) -> Html:
    """Return the origin of the results, each value once with its results, and the files of the results."""
    rows = (row for key, label in ABOUT.items() for row in _rows(results, key, label))
    made = ([name_of(r), r.path.name, str(r.attributes.get("created_utc") or "-")] for r in results)
    head = ["", "value", "results"] if len(results) > 1 else ["", "value"]
    told = (row[: len(head)] for row in rows)
    files = grid([["result", "file", "created (UTC)"], *made], words=True)
    return join([table(grid([head, *told], words=True)), table(files)])


def commands(results: Sequence[Result], command_line: str) -> Html:
    """Return the commands that made the results and the page, each with a button to copy it."""
    made = dict.fromkeys(str(result.attributes.get("command_line") or "") for result in results)
    lines = {
        **{line: "made results" for line in made if line},
        **({command_line: "made this page"} if command_line else {}),
    }
    return join(_command(place, line, about) for place, (line, about) in enumerate(lines.items()))


def case_files(result: Result) -> Html:
    """Return the notes of a result's case, and folded its text as written and with all defaults."""
    notes = str(stored_case(result).get("notes") or "")
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
    """Yield a row for each value of an attribute: the value, and the results that have it."""
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
    """Yield name and version of each package of a JSON mapping; another text is yielded unchanged."""
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if isinstance(found, dict):
        yield from (f"{name} {version}" for name, version in found.items())
    elif text:
        yield text


def verdicts(results: Sequence[Result]) -> Html:
    """Return the sentence on each result; the script shows that of the chosen one."""
    return join(_of_result("div", place, _verdict(result)) for place, result in enumerate(results))


def sketches(results: Sequence[Result]) -> Html:
    """Return the sketch of each result's building; the script shows that of the chosen one."""
    return join(_of_result("div", place, sketch(result)) for place, result in enumerate(results))


def _of_result(name: str, place: int, content: Html) -> Html:
    hidden = {"hidden": ""} if place else {}
    return element(name, content, attributes={"data-result": str(place), **hidden})


def _verdict(result: Result) -> Html:
    return join([classed("p", f"verdict {kind(result)}", verdict(result)), classed("p", "note", about(result))])


def kind(result: Result) -> str:
    """Return whether a result is good, bad, or neither: the colour of its verdict."""
    found = grade(result)
    if found is None:
        return OPEN if status(result) == COMPLETE else BAD
    if not_accepted(result) or result.attributes.get("status_reason"):
        return BAD
    return GOOD if found.grade == GOOD_TEST else OPEN if found.grade == USABLE else BAD


def sketch(result: Result) -> Html:
    """Return a drawing of the building: the computed storeys, the cut, the storeys on the table; "" if its case is
    lost."""
    structure = stored_case(result).get("structure")
    masses = [_masses(structure, part) for part in ("numerical", "experimental")]
    computed, floors = len(masses[0]), [mass for part in masses for mass in part]
    if not floors:
        return Html("")
    heights = storey_heights_m(result)
    known = heights is not None and len(heights) == len(floors)
    rise = np.concatenate([[0.0], np.cumsum(heights if known and heights is not None else np.ones(len(floors)))])
    level = GROUND - (GROUND - 24.0) * rise / rise[-1]
    words = f"Building of {len(floors)} storeys: 1 to {computed} computed, {computed + 1} to {len(floors)} on the table"
    parts = [*_storeys(level, computed), *_cut(level, computed), *_labels(level, computed, floors)]
    if known:
        parts.append(_text(LEFT - 4.0, 12.0, f"{rise[-1]:.4g} m high", "faint", "start"))
    frame = {"viewBox": f"0 0 {WIDE:g} {HIGH:g}", "role": "img", "aria-label": words, "class": "sketch"}
    return element("svg", *parts, attributes=frame)


def _masses(structure: object, part: str) -> list[float]:
    """Return the masses of the floors of a substructure in kg, [] where a damaged case has none."""
    found = structure.get(part) if isinstance(structure, dict) else None
    masses = found.get("masses_kg") if isinstance(found, dict) else None
    return [float(mass) for mass in masses if isinstance(mass, int | float)] if isinstance(masses, list) else []


def _storeys(level: Array, computed: int) -> Iterator[Html]:
    """Yield ground, columns and floors."""
    yield _line(LEFT - 16.0, level[0], RIGHT + 16.0, level[0], "ground")
    thick = "floor" if len(level) <= 26 else "thin"
    for storey in range(1, len(level)):
        part = "computed" if storey <= computed else "tested"
        for x in (LEFT, RIGHT):
            yield _line(x, level[storey - 1], x, level[storey], f"column {part}")
        yield _line(LEFT, level[storey], RIGHT, level[storey], f"{thick} {part}")


def _cut(level: Array, computed: int) -> Iterator[Html]:
    """Yield the cut, and in the middle of each side of it which substructure that is."""
    yield _line(LEFT - 16.0, level[computed], RIGHT + 16.0, level[computed], "cut")
    sides = ((computed, len(level) - 1, "on the table", "tested"), (0, computed, "computed", "computed"))
    for first, last, words, part in sides:
        if last > first:
            storey = first + (last - first - 1) // 2
            x, y = 0.5 * (LEFT + RIGHT), 0.5 * (level[storey] + level[storey + 1])
            wide = LETTER * len(words)
            box = {"x": x - 0.5 * wide, "y": y - 6.0, "width": wide, "height": 12.0}
            yield element("rect", attributes={name: f"{value:.1f}" for name, value in box.items()})
            yield _text(x, y + 4.0, words, part, "middle")


def _labels(level: Array, computed: int, masses: Sequence[float]) -> Iterator[Html]:
    """Yield number and mass of the floors, the roof, the interface and the first before others where room is short."""
    roof, last = len(masses), list[float]()
    names = {roof: "roof", computed: "interface"}
    for floor in dict.fromkeys([roof, computed, 1, *range(roof, 0, -1)]):
        if floor and all(abs(level[floor] - y) >= ROOM for y in last):
            last.append(float(level[floor]))
            name = f"{floor} {names[floor]}" if floor in names else str(floor)
            yield _text(RIGHT + 20.0, level[floor] + 4.0, f"{name}, {masses[floor - 1]:.3g} kg", "faint", "start")


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Html:
    ends = {"x1": x1, "y1": y1, "x2": x2, "y2": y2}
    return element("line", attributes={**{name: f"{value:.1f}" for name, value in ends.items()}, "class": kind})


def _text(x: float, y: float, words: str, kind: str, anchor: str) -> Html:
    return element("text", words, attributes={"x": f"{x:.1f}", "y": f"{y:.1f}", "class": kind, "text-anchor": anchor})


def responses(results: Sequence[Result]) -> Html:
    """Return for each result the peaks of the building and its errors by storey, the roof first."""
    parts = [(result, _response(result)) for result in results]
    if len(results) <= MOST_RESULTS_UNFOLDED:
        return join(part for _, part in parts)
    return join(details(name_of(result), part) for result, part in parts if part)


def _response(result: Result) -> Html:
    if (shown := storey_table(result)) is None:
        return Html("")
    notes = (note for note in (base_shear(result), storeys_with_laws(result)) if note)
    return join([table(shown), *(classed("p", "note", note) for note in notes)])
