"""The first screen of the page: verdict, sketch of the building with its cut, and the table of its response."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rths_cli.analysis.grade import GOOD as GOOD_TEST
from rths_cli.analysis.grade import USABLE
from rths_cli.files.result_reader import Result
from rths_cli.files.stored_case import stored_case, storey_heights_m
from rths_cli.numerics.lti import Array
from rths_cli.quantities.units import typeset
from rths_cli.report.answer import (
    about,
    base_shear,
    grade,
    not_accepted,
    storey_columns,
    storeys_with_laws,
    verdict,
)
from rths_cli.report.page.html import Html, classed, details, element, join, table
from rths_cli.report.page.summary import BAD, GOOD, OPEN, name_of

MOST_RESULTS_UNFOLDED = 1
WIDE, HIGH, GROUND = 264.0, 330.0, 314.0  # of the sketch, and where its ground is, in px
LEFT, RIGHT = 20.0, 105.0  # its columns
ROOM = 12.0  # between two labels of floors, at least
LETTER = 6.2  # width of one


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
        return OPEN if result.attributes.get("status", "complete") == "complete" else BAD
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
    labels, columns = storey_columns(result)
    if not columns:
        return Html("")
    heads = [["storey", *(one.name for one in columns)], ["", *(typeset(one.unit) for one in columns)]]
    rows = ([label, *(one.cells[place] for one in columns)] for place, label in enumerate(labels))
    shear = base_shear(result)
    shown = table(heads, rows, "figures", ["", *(one.group for one in columns)])
    notes = (note for note in (shear, storeys_with_laws(result)) if note)
    return join([shown, *(classed("p", "note", note) for note in notes)])
