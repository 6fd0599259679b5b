"""The output of `rths structure`, as text and with `--json`: storeys, mass split, modes, damping, mode shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.report.document import Block, Line, grid, labelled, labelled_lines
from rths_cli.report.numbers import significant
from rths_cli.report.to_text import WIDTH, laid_out_in, text
from rths_cli.structure.similitude import factors_text

if TYPE_CHECKING:
    from rths_cli.laboratory.describe import Inspected, InspectedFrame, InspectedProgram, Level
    from rths_cli.numerics.lti import Array

MOST_MODES = 10  # on the page
MOST_FLOORS = 12  # of the mode shapes on the page
PARTS = ("numerical", "experimental")


def page(found: Inspected, columns: int = WIDTH) -> str:
    """Return a building as text of at most `columns` columns."""
    sections = [
        _about(found),
        _storeys(found) if found.frame is None else _frame(found.frame),
        [] if found.program is None else _program(found.program),
        _stiffness_sets(found),
        _modes(found),
        _damping(found),
        _shapes(found),
        _prototype(found),
    ]
    with laid_out_in(columns):
        return text(sections)


def document(found: Inspected) -> dict[str, Any]:
    """Return a building as a document for JSON; storeys from the ground, modes in the order of ascending frequency."""
    return {
        "name": found.name,
        "file": found.file,
        "numerical_storeys": found.numerical_storeys,
        "floor_mass_kg": found.floor_mass_kg.tolist(),
        "stiffness_n_per_m": found.stiffness_n_per_m.tolist(),
        "heights_m": None if found.heights_m is None else found.heights_m.tolist(),
        "mass_kg": found.mass_kg,
        "experimental_mass_kg": found.experimental_mass_kg,
        "interface_experimental_mass_kg": found.interface_experimental_mass_kg,
        "natural_frequency_hz": found.natural_frequency_hz.tolist(),
        "period_s": (1.0 / found.natural_frequency_hz).tolist(),
        "effective_mass_ratio": found.effective_mass_ratio.tolist(),
        "mode_shapes": found.mode_shapes.T.tolist(),
        "specimen_frequency_hz": found.specimen_frequency_hz.tolist(),
        "specimen_damping_ratio": found.specimen_damping_ratio.tolist(),
        "damping_levels": [_level(level) for level in found.levels],
        "stiffness_sets": [
            {
                "stiffness_n_per_m": one.stiffness_n_per_m.tolist(),
                "natural_frequency_hz": one.natural_frequency_hz.tolist(),
            }
            for one in found.stiffness_sets
        ],
        "warnings": list(found.warnings),
        **({} if found.frame is None else {"frame": _values_document(found.frame)}),
        **({} if found.program is None else {"program": _values_document(found.program)}),
        "scale": None if found.scale is None else found.scale.factors,
        "prototype": _prototype_document(found.prototype),
        "exit_code": found.exit_code,
    }


def _prototype_document(whole: Inspected | None) -> dict[str, Any] | None:
    """Return storeys and modes of the prototype for JSON."""
    if whole is None:
        return None
    return {
        "floor_mass_kg": whole.floor_mass_kg.tolist(),
        "stiffness_n_per_m": whole.stiffness_n_per_m.tolist(),
        "heights_m": None if whole.heights_m is None else whole.heights_m.tolist(),
        "mass_kg": float(whole.floor_mass_kg.sum()),
        "natural_frequency_hz": whole.natural_frequency_hz.tolist(),
        "period_s": (1.0 / whole.natural_frequency_hz).tolist(),
    }


def _values_document(part: InspectedFrame | InspectedProgram) -> dict[str, Any]:
    """Return a frame or a program for JSON; frequencies are those of this part by itself."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in values.items()}


def _level(level: Level) -> dict[str, Any]:
    return {
        "name": level.name,
        "first_mode_ratio": level.first_mode_ratio,
        "dashpots_n_s_per_m": level.dashpots_n_s_per_m.tolist(),
        "natural_frequency_hz": level.natural_frequency_hz.tolist(),
        "damping_ratio": level.damping_ratio.tolist(),
        "fault": level.fault or None,
    }


def headline(found: Inspected) -> str:
    """Return a building in one sentence: its storeys, mass and lowest modes, and whether a damping level is faulty."""
    lowest = ", ".join(significant(hz, 4) for hz in found.natural_frequency_hz[:3])
    faulty = [level.name for level in found.levels if level.fault]
    ends = f"; it cannot have damping {' and '.join(faulty)}" if faulty else ""
    what = "storeys"
    if found.frame is not None:
        what = f"coordinates, {found.numerical_storeys} of a frame by its matrices"
    return (
        f"Structure {found.name} ({found.file or 'shipped'}): {len(found.floor_mass_kg)} {what}, "
        f"{significant(found.mass_kg)} kg, modes at {lowest} Hz{ends}"
    )


def _about(found: Inspected) -> list[Block]:
    """Return the headline, the doubts, and the lines on storeys and masses."""
    n, p, mass = len(found.floor_mass_kg), found.numerical_storeys, found.mass_kg
    on_table = found.experimental_mass_kg
    computed, table = (f"{significant(part)} kg ({100.0 * part / mass:.1f} %)" for part in (mass - on_table, on_table))
    interface = found.interface_experimental_mass_kg
    floor = f"floor {p}" if found.frame is None else "the interface"
    split = f"; of {floor}, {significant(interface)} kg stand on the table" if interface else ""
    return [
        Line(headline(found)),
        *(labelled("warning", doubt) for doubt in found.warnings),
        labelled(
            "storeys", f"{n}: {_range(1, p)} numerical (computed), {_range(p + 1, n)} experimental (on the table)"
        ),
        labelled("mass", f"{significant(mass)} kg: {computed} computed, {table} on the table{split}"),
    ]


def _frame(frame: InspectedFrame) -> list[Block]:
    """Return the lines on a frame: its matrices, its reduction, and its modes before and after."""
    n, p, dofs = len(frame.natural_frequency_hz), len(frame.dofs), frame.dofs.tolist()
    condensed = f"; {frame.massless} have no mass and are condensed, without an error" if frame.massless else ""
    places = ", ".join(f"{i} is {dof}" for i, dof in enumerate(dofs[:MOST_MODES], 1))
    more = f", ..., {p} is {dofs[-1]}" if p > MOST_MODES else ""
    lines: list[Block] = [
        labelled(
            "matrices", f"{frame.degrees_of_freedom} degrees of freedom ({frame.mass_file}), interface "
            f"{frame.interface}, {significant(frame.mass_kg)} kg follow the ground{condensed}",
        ),
        labelled("storeys of results", f"degrees of freedom of the matrices: {places}{more}"),
    ]  # fmt: skip
    if frame.reduction == "none":
        return [*lines, labelled("reduction", "none"), *_by_mode(["frame (Hz)"], [frame.natural_frequency_hz])]
    of = f"{frame.fixed_modes} modes with the interface held" if frame.fixed_modes else "static shapes"
    ground = ", and one shape with which all mass follows the ground" if frame.ground_shape else ""
    kept = (
        f"{frame.reduction}, {p} of {n} coordinates: {of}{ground}. The first {frame.modes_kept} modes of the frame are "
        "kept to 0.1 % in frequency. SIM has all degrees of freedom"
    )
    both = [frame.natural_frequency_hz[:p], frame.reduced_frequency_hz]
    columns = [*both, 100.0 * (both[1] / both[0] - 1.0)]
    heads = ["frame (Hz)", "reduced (Hz)", "error (%)"]
    return [*lines, labelled("reduction", kept), *_by_mode(heads, columns)]


def _program(program: InspectedProgram) -> list[Block]:
    """Return the lines on a program: its masses, condensed matrices, modes, and what an answer takes here."""
    own, on_table, both = (significant(kg) for kg in program.interface_kg)
    half, most, longest = (f"{1e3 * taken:.3g} ms" for taken in program.step_time_s)
    far = ", ".join(significant(1e3 * each) for each in program.amplitude_m[:MOST_MODES])
    taken = f"{half} half of the answers, {most} 99 of 100, {longest} the longest; up to {far} mm"
    p = min(len(program.floors), MOST_MODES)
    matrices = (program.mass_kg, program.damping_n_s_per_m, program.stiffness_n_per_m)
    rows = [
        [program.floors[i], *(", ".join(f"{value:.5g}" for value in matrix[i, :p]) for matrix in matrices)]
        for i in reversed(range(p))
    ]
    hz = ", ".join(significant(each, 4) for each in program.natural_frequency_hz[:MOST_MODES])
    return [
        labelled("program", f"{program.name}, {program.version}; by itself {hz} Hz"),
        labelled("interface mass", f"{both} kg: {own} kg in the program, {on_table} kg on the table"),
        labelled(
            "condensed", "M in kg, K in N/m at rest, C in N s/m: damping belongs to the linear part, by the stiffness "
            "at rest (initial, not committed)",
        ),
        grid([["floor", "M", "C", "K"], *rows]),
        labelled("step time here", taken),
    ]  # fmt: skip


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"


def _storeys(found: Inspected) -> list[Block]:
    """Return a line for each storey, roof first; storeys that are alike share one."""
    p, heights = found.numerical_storeys, found.heights_m
    columns = [found.floor_mass_kg, found.stiffness_n_per_m, *(() if heights is None else (heights,))]
    rows: list[tuple[int, int, list[str]]] = []
    for storey, values in enumerate(zip(*columns, strict=True), 1):
        cells = [PARTS[storey > p], *(f"{value:.6g}" for value in values)]
        if rows and rows[-1][2] == cells:
            rows[-1] = (rows[-1][0], storey, cells)
        else:
            rows.append((storey, storey, cells))
    high = [] if heights is None else ["height (m)"]
    heads = ["storey", "substructure", "mass (kg)", "stiffness (N/m)", *high]
    return [grid([heads, *([_range(first, last), *cells] for first, last, cells in reversed(rows))])]


def _stiffness_sets(found: Inspected) -> list[Block]:
    """Return a line for each set of storey stiffnesses that has the specimen's natural frequencies."""
    sets = found.stiffness_sets
    own = ", ".join(significant(hz, 4) for hz in found.specimen_frequency_hz[:MOST_MODES])
    ratios = ", ".join(significant(100.0 * ratio) for ratio in found.specimen_damping_ratio[:MOST_MODES])
    specimen: list[Block] = [labelled("specimen, fixed base", f"{own} Hz; damping {ratios} %")]
    if len(sets) < 2:
        return specimen
    several = (
        f"{len(sets)} sets of storey stiffnesses have these frequencies; the one with the most equal stiffnesses is "
        "used. State experimental.stiffness_n_per_m to choose; the modes of the whole building tell them apart"
    )
    p = found.numerical_storeys
    heads = ["", *(f"k {p + 1 + i} (N/m)" for i in range(len(sets[0].stiffness_n_per_m)))]
    heads += [f"mode {i + 1} (Hz)" for i in range(min(3, len(found.natural_frequency_hz)))]
    rows = []
    for i, one in enumerate(sets):
        label = f"set {i + 1}{', used' if i == 0 else ''}"
        stiffness = (significant(k, 5) for k in one.stiffness_n_per_m)
        rows.append([label, *stiffness, *(significant(hz, 4) for hz in one.natural_frequency_hz[:3])])
    return [*specimen, labelled("stiffness", several), grid([heads, *rows])]


def _modes(found: Inspected) -> list[Block]:
    """Return a line for each mode: frequency, period, effective mass."""
    columns = [found.natural_frequency_hz, 1.0 / found.natural_frequency_hz, 100.0 * found.effective_mass_ratio]
    about = "whole building, undamped; mass: effective modal mass over the total"
    return [labelled("modes", about), *_by_mode(["frequency (Hz)", "period (s)", "mass (%)"], columns)]


def _damping(found: Inspected) -> list[Block]:
    """Return the damping levels: what is stated, the dashpots, and a line for each mode with its damping ratios."""
    levels = [level for level in found.levels if not level.fault]
    lines = labelled_lines("damping", map(_told, found.levels))
    if not levels:
        return lines
    columns = [values for one in levels for values in (one.natural_frequency_hz, 100.0 * one.damping_ratio)]
    heads = [f"{level.name} ({unit})" for level in levels for unit in ("Hz", "%")]
    about = "modes of each level, damped, by their frequency |s| / 2 pi"
    if any(np.any(level.damping_ratio >= 1.0) for level in levels):
        about += "; from 100 % on a mode does not oscillate"
    return [*lines, labelled("", about), *_by_mode(heads, columns)]


def _by_mode(heads: Sequence[str], columns: Sequence[Array]) -> list[Block]:
    """Return a line for each mode with the values (n,) of each column."""
    rows = [
        [str(mode), *(significant(value, 4) for value in values)]
        for mode, values in enumerate(zip(*columns, strict=True), 1)
    ]
    more = [Line(f"  {len(rows) - MOST_MODES} more modes in --json")] if len(rows) > MOST_MODES else []
    return [grid([["mode", *heads], *rows[:MOST_MODES]]), *more]


def _told(level: Level) -> str:
    if level.fault:
        return f"{level.name}: {level.fault}"
    values = level.dashpots_n_s_per_m
    if not values.size:
        return f"{level.name}: of the frame's matrices"
    same = bool(np.all(values == values[0]))
    size = significant(values[0], 4) if same else ", ".join(significant(value, 4) for value in values)
    each = " in each numerical storey" if same else " in the numerical storeys"
    if level.first_mode_ratio is None:
        return f"{level.name}: {size} N s/m{each}"
    return f"{level.name}: first mode {significant(100.0 * level.first_mode_ratio)} %, by {size} N s/m{each}"


def _shapes(found: Inspected) -> list[Block]:
    """Return the mode shapes, roof first: a row for each floor, a column for each mode."""
    n = len(found.floor_mass_kg)
    floors = shown_floors(n, found.numerical_storeys)
    heads = ["floor", *(f"mode {mode + 1}" for mode in range(min(n, MOST_MODES)))]
    rows = [[str(floor), *_row(found.mode_shapes[floor - 1, :MOST_MODES])] for floor in floors]
    more = [Line(f"  {n - len(floors)} more floors in --json")] if len(floors) < n else []
    return [labelled("mode shapes", "largest floor 1, roof first"), grid([heads, *rows]), *more]


def _prototype(found: Inspected) -> list[Block]:
    """Return the lines on the prototype of a model: the factors, its storeys and modes."""
    scale, whole = found.scale, found.prototype
    if scale is None or whole is None:
        return []
    told = f"the building above is its model; prototype over model: {factors_text(scale.factors)}"
    return [labelled("prototype", told), *_storeys(whole), *_modes(whole)]


def _row(values: Array) -> list[str]:
    return [f"{value:.4f}" for value in values]


def shown_floors(count: int, interface: int) -> list[int]:
    """Return the floors whose mode shapes the page shows, from the roof down: all, or some with the interface."""
    if count <= MOST_FLOORS:
        return list(range(count, 0, -1))
    evenly = np.linspace(1, count, MOST_FLOORS - 1).round().astype(int).tolist()
    return sorted({*evenly, interface}, reverse=True)
