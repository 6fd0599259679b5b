"""The list of figures by name; draw them and write their files, equal for equal data."""

from __future__ import annotations

import io
import logging
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rths_cli.errors import InputError
from rths_cli.files.durable_files import make_folder, part_of
from rths_cli.files.existing_files import Kind, check_existing, replaced_sentence
from rths_cli.files.result_reader import Result
from rths_cli.files.sweep_file import Sweep
from rths_cli.interrupts import interruptible
from rths_cli.report.figures import frequency, histories, limit_bars, structural_figures
from rths_cli.report.figures.figure_data import NotDrawn, Source
from rths_cli.report.figures.ida_figures import fragility, ida_curves
from rths_cli.report.figures.limit_bars import limits, timing
from rths_cli.report.figures.panels import heading
from rths_cli.report.figures.study_figures import has_boundary, parallel, sobol, stability, sweep_figure, tornado
from rths_cli.report.figures.style import DPI, FORMS, METADATA, WIDTHS_MM, in_house_style
from rths_cli.report.result_scale import in_model_scale
from rths_cli.report.sweep_page import indexed_keys
from rths_cli.studies.ida_curves import ABOUT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Planned = tuple[Path, str, str, Callable[[], Figure], str]
    """Source file, stem and name of the figure's file, what draws it, its title in the file's metadata."""

Tell = Callable[[str], None]
CASE_HEADER = "case"
HEADERS = (CASE_HEADER, "none")
SWEEP, PART_VALUES = "sweep", "part_values"
LONG_VERTEX = re.compile(rb"^L (-?\d+\.\d+) (-?\d+\.\d+) $", re.MULTILINE)
FIGURES: dict[str, Callable[[Source, str], Figure]] = {
    "table_response": frequency.table_response,
    "tracking": histories.tracking,
    "kalman": histories.kalman,
    "responses": histories.responses,
    "errors": histories.errors,
    "against_sim": structural_figures.against_sim,
    "profiles": structural_figures.profiles,
    "hysteresis": structural_figures.hysteresis,
    "spectra": frequency.spectra,
    "delay_and_gain": frequency.delay_and_gain,
    "error_budget": limit_bars.error_budget,
    "limits": limits,
    "timing": timing,
    "ground_motion": histories.ground_motion,
    PART_VALUES: histories.part_values,
}


SWEEP_FIGURES: dict[str, Callable[[Sweep, str, str, bool], Figure]] = {
    SWEEP: sweep_figure, "tornado": tornado, "parallel": parallel, "sobol": sobol, "stability": stability,
    "ida": ida_curves, "fragility": fragility,
}  # fmt: skip
"""Figures of sweeps by name."""
IN_MODEL_SCALE = ("table_response", "spectra", "delay_and_gain", "limits", "timing")
"""Figures of the rig and of the loop, which have no prototype."""


def figure_names() -> tuple[str, ...]:
    """Return the names of all figures, in the order in which they are written."""
    return tuple(FIGURES)


def draw(name: str, result: Result, width: str = "two", header: str = CASE_HEADER) -> Figure:
    """Return one figure of a result as a matplotlib Figure, 84 mm ("one" column) or 174 mm ("two") wide.

    `header`: "case" states case, table and end of the run above the panels, "none" leaves that to the caption. Raises
    InputError for an unknown name, width or header, and (NotDrawn) with the reason where the result lacks the data.
    """
    _check(name, FIGURES, "figure")
    _check(width, WIDTHS_MM, "width")
    _check(header, HEADERS, "header")
    shown = in_model_scale(result) if name in IN_MODEL_SCALE else result
    return _drawn(name, Source(shown, header == CASE_HEADER), width)


def write_figures(
    results: Sequence[Result], folder: Path, form: str = "pdf", width: str = "one", tell: Tell | None = None,
    header: str = CASE_HEADER, replace: bool = True,
) -> list[Path]:  # fmt: skip
    """Write every figure of every result into `folder` as NAME-FIGURE.pdf (svg, png), and return the files written.

    NAME is the result file's; the same name from another folder becomes NAME-2. Files that exist are replaced, when all
    are drawn: where a result cannot be read or the disk refuses, none is written. `tell` is given a sentence for each
    figure that a result has no data for (default: a warning of the log `rths_cli`), and one on the files that were
    replaced. Raises InputError for an unknown form, width or header, where a file cannot be written, and, without
    `replace`, where one exists.
    """
    _check(header, HEADERS, "header")
    stems = tuple(_stems([result.path for result in results]))
    headed = header == CASE_HEADER
    pairs = ((Source(result, headed), Source(in_model_scale(result), headed)) for result in results)
    planned = (
        (source.result.path, stem, name, partial(FIGURES[name], source, width), _title(name, source))
        for stem, (shown, stored) in zip(stems, pairs, strict=True)
        for name in FIGURES
        for source in (stored if name in IN_MODEL_SCALE else shown,)
        if name != PART_VALUES or histories.own_values(source)  # most results have none, which is no news
    )
    named = (f"{stem}-{name}" for stem in stems for name in FIGURES)
    return _write(planned, named, folder, form, width, tell, replace)


def write_sweep_figures(
    sweeps: Sequence[tuple[Path, Sweep]], folder: Path, form: str = "pdf", width: str = "one",
    tell: Tell | None = None, header: str = CASE_HEADER, metric: str = "", replace: bool = True,
) -> list[Path]:  # fmt: skip
    """Write the figures of every sweep, each given with its file, into `folder` as NAME-FIGURE.pdf (svg, png).

    Which they are follows from what is varied (`sweep_figure_names`).

    `metric`: path of what is drawn over the varied keys, with the storey in brackets or the largest of all storeys;
    "": the RMS error of EXP-RTHS. Otherwise as `write_figures`; also raises InputError where no sweep has the metric.
    """
    _check(header, HEADERS, "header")
    stems = tuple(_stems([path for path, _ in sweeps]))
    planned = (
        (path, stem, name, partial(SWEEP_FIGURES[name], sweep, width, metric, header == CASE_HEADER), f"{name}: {stem}")
        for stem, (path, sweep) in zip(stems, sweeps, strict=True)
        for name in sweep_figure_names(sweep)
    )
    named = (
        f"{stem}-{name}" for stem, (_, sweep) in zip(stems, sweeps, strict=True) for name in sweep_figure_names(sweep)
    )
    return _write(planned, named, folder, form, width, tell, replace)


def sweep_images(sweep: Sweep, width: str = "two") -> Iterator[tuple[str, bytes]]:
    """Yield name and SVG file of each figure of a sweep that it has data for, without a heading."""
    for name in sweep_figure_names(sweep):
        with suppress(NotDrawn):
            yield name, _image(partial(SWEEP_FIGURES[name], sweep, width, "", False), name, "svg")


def sweep_figure_names(sweep: Sweep) -> tuple[str, ...]:
    """Return the figures that are drawn of a sweep, by the number of its varied keys and how they were sampled."""
    if ABOUT in sweep.attributes:
        return "ida", "fragility"
    keys = len(sweep.varied)
    wanted = {
        SWEEP: keys <= 2,
        "tornado": keys >= 2,
        "parallel": keys >= 3,
        "sobol": bool(indexed_keys(sweep)),
        "stability": has_boundary(sweep),
    }
    return tuple(name for name, asked in wanted.items() if asked)


def _write(
    planned: Iterable[Planned],
    named: Iterable[str],
    folder: Path,
    form: str,
    width: str,
    tell: Tell | None,
    replace: bool,
) -> list[Path]:
    """Draw and write figures; all appear when all are drawn. Returns the files written.

    `named`: STEM-NAME of every figure that may be written.
    """
    _check(form, FORMS, "form")
    _check(width, WIDTHS_MM, "width")
    report = logging.getLogger("rths_cli").warning if tell is None else tell
    present = check_existing([(folder / f"{name}.{form}", Kind.DOCUMENT) for name in named], replace)
    made = _make(folder)
    parts: dict[Path, Path] = {}
    try:
        for source, stem, name, make, title in planned:
            try:
                image = interruptible(partial(_image, make, title, form))
            except NotDrawn as reason:
                report(f"{source}: figure {name} is left out: {reason}")
                continue
            path = folder / f"{stem}-{name}.{form}"
            parts[path] = part_of(path)
            with _told(path):
                parts[path].write_bytes(image)
        for path, part in parts.items():
            with _told(path):
                os.replace(part, path)
    finally:
        _remove(parts.values(), made)
    if replaced := [path for path in present if path in parts]:
        report(replaced_sentence(replaced))
    return list(parts)


def _drawn(name: str, source: Source, width: str) -> Figure:
    with in_house_style():
        return FIGURES[name](source, width)


def _title(name: str, source: Source) -> str:
    return f"{name}: {' '.join(heading(source, 'two'))}"


def _image(make: Callable[[], Figure], title: str, form: str) -> bytes:
    """Return the file of a figure as bytes."""
    buffer = io.BytesIO()
    with in_house_style():
        make().savefig(buffer, format=form, dpi=DPI, metadata={**METADATA[form], "Title": title})
    return LONG_VERTEX.sub(_short_vertex, buffer.getvalue()) if form == "svg" else buffer.getvalue()


def _short_vertex(found: re.Match[bytes]) -> bytes:
    """Return a vertex of an SVG line with two decimals of a point (3.5 micrometres): a third of the file less."""
    return b"L %.2f %.2f" % (float(found[1]), float(found[2]))


def _make(folder: Path) -> list[Path]:
    """Create a folder and return the created folders, the innermost first; raises InputError if that fails."""
    with _told(folder):
        return make_folder(folder)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn an error of the disk into an InputError with path and cause."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot write the figure: {error.strerror}; choose another folder.") from error


def _remove(parts: Iterable[Path], folders: Iterable[Path]) -> None:
    """Remove temporary files that were not renamed, and created folders that are empty."""
    for part in parts:
        with suppress(OSError):
            part.unlink()
    for folder in folders:
        with suppress(OSError):  # it holds figures
            folder.rmdir()


def _stems(paths: Sequence[Path]) -> Iterator[str]:
    """Yield a file name for each result; from the second result of a name on, it ends with a number."""
    seen: Counter[str] = Counter()
    for path in paths:
        stem = path.stem
        seen[stem] += 1
        yield stem if seen[stem] == 1 else f"{stem}-{seen[stem]}"


def _check(value: str, known: Iterable[str], what: str) -> None:
    names = tuple(known)
    if value not in names:
        raise InputError(f"{what} is {value!r}; it must be one of {', '.join(names)}.")
