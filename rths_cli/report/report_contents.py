"""All parts of one report in their order: result_tables.py, then comparisons, repeats, baseline, sweeps, faults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.report.answer import answer_document, one_line
from rths_cli.report.document import Document, Section
from rths_cli.report.group_comparison import (
    CaseChanges,
    Compared,
    Repeats,
    against,
    baseline_sections,
    check_keys,
    compare,
    group_name,
    group_tables,
    repeats,
    repeats_tables,
)
from rths_cli.report.input_files import Inputs, Unread, doubled, other_units
from rths_cli.report.result_tables import document, listed
from rths_cli.report.study_pages import sections, verdict


@dataclass(frozen=True)
class Baseline:
    """The comparison of the results with a baseline."""

    source: str  # name of the baseline
    percent: float  # tolerance
    changes: tuple[CaseChanges, ...]


@dataclass(frozen=True)
class Contents:
    """The contents of a report."""

    inputs: Inputs  # results and sweeps in the tables
    unread: tuple[Unread, ...]  # files that are in no table
    clashes: tuple[Unread, ...]  # results that are in the tables although they clash with others
    keys: tuple[str, ...]  # of --group-by
    groups: tuple[Compared, ...]  # comparison by these keys
    repeats: tuple[Repeats, ...]  # statistics over repeats
    baseline: Baseline | None  # None: no comparison with a baseline

    @property
    def faults(self) -> tuple[str, ...]:
        """Return a sentence for each unused file and each clash."""
        return tuple(one.sentence for one in (*self.unread, *self.clashes))


def contents(
    inputs: Inputs, keys: Sequence[str], baseline: tuple[str, Inputs, float] | None, keep_going: bool
) -> Contents:
    """Return the contents of a report.

    `keys`: of --group-by; `baseline`: its name, its results, and the tolerance in percent. Raises InputError with all
    faults of the files, unless `keep_going` is set and a result or sweep remains; also if there is no result or sweep,
    the baseline is empty, or no result states a key.
    """
    odd = other_units(inputs.results)
    left = {one.path for one in odd}
    results = tuple(result for result in inputs.results if result.path not in left)
    clashes = doubled(results, lambda result: (group_name(result, keys),))
    if baseline:  # metrics in other units cannot be compared
        source, read, percent = baseline
        other = other_units(read.results)
        kept = tuple(result for result in read.results if result.path not in {one.path for one in other})
        baseline = source, Inputs(kept, read.sweeps, (*read.unread, *other)), percent
    unread = (*inputs.unread, *odd)
    faults = [one.sentence for one in (*unread, *clashes)]
    compared = _compared(baseline, results)
    faults += [one.sentence for one in (baseline[1].unread if baseline else ())]
    if faults and not (keep_going and (results or inputs.sweeps)):
        more = "the others are reported with --keep-going" if results or inputs.sweeps else ""
        raise InputError(*dict.fromkeys(faults), *([more] if more and not keep_going else []))
    if not results and not inputs.sweeps:
        raise InputError("There are no results to report; give result files or run a case first.")
    check_keys(keys, results)
    groups = tuple(compare(results, keys)) if keys and results else ()
    used = Inputs(results, inputs.sweeps, inputs.unread)
    told = (*unread, *(baseline[1].unread if baseline else ()))
    return Contents(used, told, tuple(clashes), tuple(keys), groups, tuple(repeats(results, keys)), compared)


def _compared(baseline: tuple[str, Inputs, float] | None, results: Sequence[Result]) -> Baseline | None:
    if baseline is None:
        return None
    source, read, percent = baseline
    if not read.results and not read.unread:
        raise InputError(f"--baseline {source}: holds no result; name a result file or a folder of them.")
    return Baseline(source, percent, tuple(against(results, read.results, percent)))


def comparison(found: Contents) -> Document:
    """Return groups, repeats, baseline and faults of the files; sweeps have sections of their own in a page."""
    return [*_comparisons(found), *_faulty(found)]


def all_sections(found: Contents, paper: bool = False) -> Document:
    """Return all sections of a report; `paper`: claims in any case (see `document`)."""
    results = found.inputs.results
    shown = document(results, paper=paper) if results else []
    return [*shown, *_comparisons(found), *_swept(found), *_faulty(found)]


def page_sections(found: Contents, full: bool, paper: bool) -> Document:
    """Return what a terminal shows: comparisons that are asked for, the answer, sweeps and faults of the files.

    `full`: every figure of the results below; `paper`: their errors beside published ones, and the paper's claims.
    """
    results = found.inputs.results
    told = answer_document(results, whole=full) if results else []
    tables = document(results, laid_out=True, paper=paper, brief=not full) if results and (full or paper) else []
    return [*_comparisons(found), *told, *_swept(found), *_faulty(found), *tables]


def verdicts(found: Contents) -> list[str]:
    """Return a line for each result and each sweep."""
    swept = (verdict(sweep, path) for path, sweep in found.inputs.sweeps)
    return [*map(one_line, found.inputs.results), *swept]


def _swept(found: Contents) -> Iterator[Section]:
    return (section for path, sweep in found.inputs.sweeps for section in sections(sweep, path))


def _comparisons(found: Contents) -> Iterator[Section]:
    if found.groups:
        yield from ([table] for table in group_tables(found.groups, found.keys))
    yield from ([table] for table in repeats_tables(found.repeats))
    if found.baseline:
        yield from baseline_sections(found.baseline.changes, found.baseline.source, found.baseline.percent)


def _faulty(found: Contents) -> Iterator[Section]:
    for title, files in (("Not in the tables", found.unread), ("Clashing results", found.clashes)):
        if files:
            yield listed(title, (one.sentence for one in files))
