"""The answer of a run: how good the test was, the building's response by storey, errors, warnings, where the result
is and what to do next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from rths_cli.analysis.grade import (
    CALIBRATION,
    GOOD,
    LEAST_SHARE,
    Deviation,
    Grade,
    GradeLimits,
    changes_of,
    compensation_of,
    deviations_of,
    grade_of,
    physical_part_of,
)
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.files.stored_case import stored_case
from rths_cli.findings import OF_INPUT
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.report.case_metric_tables import CAUSES
from rths_cli.report.document import Block, Column, Document, Line, Table, Verdict, by_columns, verdict_line
from rths_cli.report.numbers import three
from rths_cli.report.result_scale import scale_lines
from rths_cli.report.results_by_case import RUN_NAMES, TABLE_RUNS, judge
from rths_cli.report.results_by_case import status as result_status
from rths_cli.report.stored_findings import stored_findings, without_run
from rths_cli.report.to_text import WIDTH, in_room, laid_out_in, text

MOST_STOREYS = 5  # of which all are shown; of taller buildings the three that drift most, and the roof
NARROW = 60  # columns
MOST_LINES = 16  # of an answer, before its notes are shortened
MOST_LINES_OF_SEVERAL = 40
LEAST_LINES_OF_NOTES = 2
MOST_NAMES = 3  # of cases before a note
OFF_PEAK = 0.10  # of SIM's: a peak of EXP-RTHS that is farther off is told
MOST_DEVIATIONS = 4  # of the specimen from what it is compared with, before the others are counted
RESPONSES = ("exp_rths", "sim")  # the first that there is is shown
USUAL = asdict(GradeLimits())
OF_DECLARATION = "specimen other than declared"  # begins the cause by which the declaration is off
IF_DECLARED = "if sensors and masses are as declared"


def answer(result: Result, columns: int = WIDTH, whole: bool = False) -> str:
    """Return the answer of one result as text, some fifteen lines of at most `columns` columns.

    `whole`: every note as it is stored, however long the answer becomes.
    """
    return answers([result], columns, whole)


def answers(results: Sequence[Result], columns: int = WIDTH, whole: bool = False) -> str:
    """Return the answer of one result, or the comparison of several: a row for each. `whole` as for one."""
    if not results:
        return ""
    with laid_out_in(min(max(columns, NARROW), WIDTH)):
        return text(answer_document(results, whole))


def answer_document(results: Sequence[Result], whole: bool = False) -> Document:
    """Return the answer of one result, or the comparison of several, for lines as wide as those of the page."""
    return _answer(results[0], whole) if len(results) == 1 else [_comparison(results, whole)]


def _answer(result: Result, whole: bool) -> Document:
    """Return the sections of one answer: test and verdict, storeys, what else is to be said."""
    first, *more = verdict_lines(result)
    head = [verdict_line(first), *map(Line, more)]
    head += [Line(f"{result.attributes.get('case_name') or result.path.stem}: {about(result)}")]
    head += map(Line, scale_lines([result]))
    table = _table(result)
    if table and result.attributes.get("exp_rths_status") not in (None, "complete"):
        head.append(Line("Storeys and base shear below are computed (SIM): no hybrid test was completed."))
    diverged = (
        f"{_diverged(result)}." if grade(result) is None and _diverged(result) else ""
    )  # else the verdict says it
    of_building = base_shear(result), storeys_with_laws(result)
    told = [Line(sentence) for sentence in (*of_building, fidelity(result), diverged) if sentence]
    above, last = [head, [table]] if table else [head], Line(_next(result))
    room = MOST_LINES - text([*above, [*told, last]]).count("\n")
    return [*above, [*told, *_told_notes([result], room, whole), last]]


class Note(NamedTuple):
    """A note with the cases that it is of, none if of all."""

    text: str
    cases: tuple[str, ...] = ()
    alike: object = None  # the same where notes differ in numbers alone; None: not known

    def __str__(self) -> str:
        return f"{', '.join(self.cases)}: {self.text}" if self.cases else self.text


def notes(results: Sequence[Result]) -> list[Note]:
    """Return the notes of results, each once, those that each case has first before those that it has second, doubts
    of units and record before all; none that a verdict has said already."""
    cases: dict[str, list[str]] = {}
    place: dict[str, int] = {}
    alike: dict[str, object] = {}
    for result in results:
        said = verdict(result)
        alike |= {str(found): found.alike for found in stored_findings(result) if found.code != "stated"}
        warned = str(result.attributes.get("warnings") or "").splitlines()
        doubts = [str(found) for found in stored_findings(result) if found.code.startswith(OF_INPUT)]
        stored = dict.fromkeys([*(one for one in doubts if one in warned), *_peaks_off(result), *warned])
        for number, note in enumerate(note for note in stored if note not in said):
            cases.setdefault(note, []).append(result.path.stem)
            place[note] = min(number, place.get(note, number))
    ranked = sorted(cases, key=place.__getitem__)
    return [
        Note(note, () if len(cases[note]) == len(results) else tuple(cases[note]), alike.get(note)) for note in ranked
    ]


def _alike(all_of: Sequence[Note], count: int) -> list[str]:
    """Return notes that differ in nothing but figures as one, with the figures of its first case; `count` cases."""
    grouped: dict[object, list[Note]] = {}
    for note in all_of:
        grouped.setdefault(note.alike or note.text, []).append(note)
    return [_of_cases(group, count) for group in grouped.values()]


def _of_cases(group: Sequence[Note], count: int) -> str:
    first, names = group[0], list(dict.fromkeys(name for note in group for name in note.cases))
    if not names:
        return first.text
    of = "all" if len(names) == count else ", ".join(names[:MOST_NAMES])
    if of != "all" and len(names) > MOST_NAMES:
        of += f" and {len(names) - MOST_NAMES} more"
    return f"{of}: {first.text}" if len(group) == 1 else f"{of} (figures of {first.cases[0]}): {first.text}"


def _told_notes(results: Sequence[Result], room: int, whole: bool) -> list[Block]:
    """Return the notes: alike ones of several cases as one; where they need more than `room` lines, the last ones are
    cut first, and what has no room at all is left out, which is said. `whole`: each note as it is."""
    found = notes(results)
    told = [str(note) for note in found] if whole else _alike(found, len(results))
    if whole:
        return [Line(f"note: {note}") for note in told]
    return in_room([f"note: {note}" for note in told], max(room, LEAST_LINES_OF_NOTES), "rths run --full")


def _peaks_off(result: Result) -> list[str]:
    """Return a sentence if peaks of EXP-RTHS are far from SIM's although its error is small: they hold what the test
    band leaves out, as the noise of the sensors."""
    found = grade(result)
    if found is None or found.percent > grade_limits(result).usable_percent:
        return []
    off = []
    for name, (what, unit, factor) in PEAKS.items():
        pair = [result.metrics.get(f"{run}.{name}") for run in ("exp_rths", "sim")]
        if pair[0] is None or pair[1] is None:
            continue
        tested, exact = (np.atleast_1d(np.asarray(values, dtype=float)) for values in pair)
        if tested.shape != exact.shape:
            continue
        share = np.abs(tested / np.where(exact > 0.0, exact, np.nan) - 1.0)
        if np.isfinite(share).any() and float(np.nanmax(share)) > OFF_PEAK:
            worst = int(np.nanargmax(share))
            where = f" of storey {worst + 1}" if share.size > 1 else ""
            has, should = (f"{three(factor * float(values[worst]))} {unit}" for values in (tested, exact))
            off.append(f"{what}{where} {has}, in SIM {should}")
    if not off:
        return []
    return [
        f"peaks of EXP-RTHS are more than {100.0 * OFF_PEAK:g} % off: {', '.join(off)}; errors are judged in the test "
        "band and peaks are not, so noise of sensors and converters is in them: use SIM's, or finer converters"
    ]


PEAKS = {
    "peak_abs_accel_m_s2": ("acceleration", "m/s^2", 1.0),
    "peak_rel_disp_m": ("displacement", "mm", 1e3),
    "peak_inter_storey_drift_m": ("drift", "mm", 1e3),
    "peak_building_base_shear_n": ("base shear", "N", 1.0),
}


def one_line(result: Result) -> str:
    """Return a result in one line: its case, how it ended, and its file."""
    name, found = result.path.stem, grade(result)
    if found is None or result.attributes.get("status_reason"):
        return f"{name}: {verdict(result).removesuffix('.')}; {result.path}"
    where = " on a virtual rig" if _virtual(result) else ""
    reserved = "".join(f", {one}" for one in reservations(result))
    return f"{name}: {found.grade}{reserved}{where}, {_bound(found)}; {result.path}"


def _comparison(results: Sequence[Result], whole: bool) -> list[Block]:
    """Return the comparison of several results, and a sentence for each that has no grade."""
    names, grades = [result.path.stem for result in results], [grade(result) for result in results]
    runs = dict.fromkeys(run for result in results if (run := _shown_run(result)))
    true, peaks = ("true error",), (f"peaks in {' or '.join(RUN_NAMES[run] for run in runs)}",)
    columns: list[tuple[Column, Sequence[str]]] = [
        (Column("grade"), [Verdict(_end(one, found)) for one, found in zip(results, grades, strict=True)]),
        (Column("95 % bound", true, "% of SIM"), [three(found.percent) if found else "-" for found in grades]),
        (Column("median over", true, "SIM-DELAY"), [_over_sim_delay(one) for one in results]),
        (Column("roof accel", peaks, "m/s^2"), [_of_roof(one) for one in results]),
        (Column("base shear", peaks, "N"), [_of_base(one) for one in results]),
    ]
    told = [
        Line(f"{result.path.stem}: {verdict(result)}")
        for result, found in zip(results, grades, strict=True)
        if found is None or result.attributes.get("status_reason")
    ]
    above: list[Block] = [by_columns("case", names, columns), *told, *map(Line, scale_lines(results))]
    last = [Line(_said_of_all(results, grades)), Line(_next_of(results))]
    room = min(14 + 2 * len(results), MOST_LINES_OF_SEVERAL) - text([[*above, *last]]).count("\n")
    return [*above, *_told_notes(results, room, whole), *last]


def _said_of_all(results: Sequence[Result], grades: Sequence[Grade | None]) -> str:
    """Return the sentence on all grades: the limits, where cases share them, and on which rigs the tests were."""
    graded = [result for result, found in zip(results, grades, strict=True) if found]
    limits = dict.fromkeys(_limits(result) for result in graded)
    virtual = [result.path.stem for result in graded if _virtual(result)]
    some = f" ({', '.join(virtual)}: virtual)" if virtual else ""
    on = " on virtual rigs" if virtual and len(virtual) == len(graded) else some
    said = f" {next(iter(limits))}" if len(limits) == 1 else ""
    return f"Grades of tests{on} follow from the 95 % bound of the true error.{said}"


def _next_of(results: Sequence[Result]) -> str:
    """Return what to do next with several results."""
    published = ", or --paper" if any(_has_published(one) for one in results) else ""
    return f"more: rths report {results[0].path.parent} with --full{published}"


def _has_published(result: Result) -> bool:
    return bool(result.attributes.get("reference_title"))


def _end(result: Result, found: Grade | None) -> str:
    """Return the grade in a word, else how the result ended."""
    status = _ended(result, "exp_rths") or result_status(result)
    if found:
        reserved = reservations(result)
        first = reserved[0].split()[1] if reserved else found.grade  # overridden, doubtful
        return "not accept." if not_accepted(result) else first
    return "-" if status == COMPLETE else status


def _over_sim_delay(result: Result) -> str:
    found = compensation_of(result.metrics) if grade(result) else None
    return "-" if found is None else three(found.ratio)


def _of_roof(result: Result) -> str:
    values = next((v for run in RESPONSES if (v := result.metrics.get(f"{run}.peak_abs_accel_m_s2")) is not None), None)
    return "-" if values is None else three(float(np.atleast_1d(np.asarray(values))[-1]))


def _of_base(result: Result) -> str:
    value = next(
        (v for run in RESPONSES if (v := result.metrics.get(f"{run}.peak_building_base_shear_n")) is not None), None
    )
    return "-" if value is None else three(float(np.asarray(value)))


def grade(result: Result) -> Grade | None:
    """Return the grade of a result's EXP-RTHS by the limits of its case; None where it has none."""
    if _ended(result, "exp_rths") != COMPLETE or not _has_reference(result):
        return None
    return grade_of(result.metrics, grade_limits(result))


def _has_reference(result: Result) -> bool:
    """Return whether SIM is that of the tested building; storeys of one's own have to declare theirs."""
    own = "numerical" in str(result.attributes.get("own_parts", "")).split()
    return not own or bool(result.attributes.get("own_building", ""))


def grade_limits(result: Result) -> GradeLimits:
    """Return the limits of good and usable tests in the case of a result, the usual ones where it has none."""
    stated = stored_case(result).get("grade_limits")
    known = stated if isinstance(stated, dict) else {}
    limits = {name: float(one) for name, one in known.items() if name in USUAL and isinstance(one, int | float)}
    return GradeLimits(**(USUAL | limits))


def verdict(result: Result) -> str:
    """Return the sentences that say whether the test can be trusted, and by which limits."""
    return " ".join(verdict_lines(result))


def verdict_lines(result: Result) -> list[str]:
    """Return the verdict: a word in capitals with the bound of the true error, or with why there is none; what was
    measured, with the limits of the grade; then a sentence for each finding."""
    status = str(result.attributes.get("status", COMPLETE))
    found = grade(result)
    if found is None:
        return _without_grade(result, status)
    band = float(result.attributes.get("test_band_hz", TEST_BAND_HZ))
    up_to = "" if band == TEST_BAND_HZ else f" up to {band:g} Hz"
    told = [f"{_bound(found, up_to)}, storey {found.storey}{', virtual rig' if _virtual(result) else ''}"]
    cause = _cause_in_words(result, found)
    told += [f"most of it by {cause}"] if found.grade != GOOD and cause else []
    told += [IF_DECLARED] if "exp_rths.mass_over_declared" not in result.metrics else []
    told += [said for said in (_beyond_bound(result), _diverged(result)) if said]
    reason = str(result.attributes.get("status_reason") or "")
    told += [f"{status}: {reason or 'no reason stored'}"] if status != COMPLETE else []
    first = f"{found.grade.upper()}: {'; '.join(told)}."
    if status == COMPLETE and reason:
        first = f"{'NOT ACCEPTED' if not_accepted(result) else 'BUT'}: {reason}. {first}"
    if stands_against := reservations(result):
        first = f"{'; '.join(stands_against).upper()}. {'. '.join(_reserved(result))}. Its accuracy alone: {first}"
    return [first, _measured(result), *findings(result)]


def _measured(result: Result) -> str:
    """Return the sentence on the measured error, the true one beside SIM-DELAY's, and the limits of the grades."""
    limits, compensation = grade_limits(result), compensation_of(result.metrics)
    own = np.atleast_1d(np.asarray(result.metrics.get("exp_rths.nrmse_percent", np.nan), dtype=float))
    said = [f"measured {three(own.max())} % of SIM as declared"] if np.isfinite(own).all() else []
    said += [f"likely {three(compensation.ratio)} of SIM-DELAY"] if compensation is not None else []
    known = "".join(f"{one}; " for one in said)
    worth = f", {compensation.limit(limits):g}" if compensation is not None else ""
    sentence = f"{known}limits good {limits.good_percent:g} %, usable {limits.usable_percent:g} %{worth}."
    return sentence[0].upper() + sentence[1:]


def _cause_in_words(result: Result, found: Grade) -> str:
    """Return the main cause of a true error, as the run named it where it is the budget's and known more closely."""
    if found.cause == CALIBRATION:
        return "what the identification leaves open of sensors and masses"
    named = str(result.attributes.get("main_error_cause", ""))
    return named if found.cause and named and not named.startswith(OF_DECLARATION) else CAUSES.get(found.cause, "")


def _bound(found: Grade, up_to: str = "") -> str:
    bound, median = three(found.percent), three(found.median)
    return f"true error{up_to} below {bound} % of SIM (95 %), likely {median} %"


def findings(result: Result) -> list[str]:
    """Return a sentence on each finding beside the grade: what changed, what the specimen is beside its declaration,
    and where compensation or specimen are hardly worth it, with figures and limits."""
    return [*_changed(result), *_beside_declaration(result), *_hardly_worth(result)]


def _changed(result: Result) -> Iterator[str]:
    if found := changes_of(result.metrics):
        yield (
            f"THE SPECIMEN CHANGED since its identification: {_listed(found)}; SIM is that of the specimen in the run; "
            "look at it and identify again."
        )


def _beside_declaration(result: Result) -> Iterator[str]:
    """Yield the sentence on what the specimen differs from its declaration by, and what that makes of the error."""
    found = deviations_of(result.metrics)
    if not found:
        return
    declared = np.atleast_1d(np.asarray(result.metrics.get("exp_rths.nrmse_percent", np.nan), dtype=float))
    makes = ""
    if np.isfinite(declared).all():
        makes = f" (against SIM as declared the test is {three(declared.max())} % off)"
    yield f"The specimen is not the declared one: {_listed(found)}; declare it so{makes}."


def _listed(found: Sequence[Deviation]) -> str:
    """Return deviations in words, the largest over its uncertainty first."""
    ranked = sorted(found, key=lambda one: -abs(one.percent / one.error))
    told = [f"{one.what} {one.place} {_plus_minus(one)} %" for one in ranked[:MOST_DEVIATIONS]]
    more = len(ranked) - MOST_DEVIATIONS
    return ", ".join(told) + (f" and {more} more" if more > 0 else "")


def _plus_minus(one: Deviation) -> str:
    """Return a deviation with two significant digits of its uncertainty."""
    digits = max(1 - int(np.floor(np.log10(one.error))), 0)
    return f"{one.percent:+.{digits}f} +- {one.error:.{digits}f}"


def _hardly_worth(result: Result) -> Iterator[str]:
    limits, compensation, part = (
        grade_limits(result), compensation_of(result.metrics), physical_part_of(result.metrics)
    )  # fmt: skip
    if compensation is not None and compensation.ratio > (limit := compensation.limit(limits)):
        worse = ", worse than no compensation" if compensation.ratio > 1.0 else ""
        where = f"limit {limit:g}, storey {compensation.storey}"
        ratio = three(compensation.ratio)
        yield f"The compensation is hardly worth it: true error {ratio} of SIM-DELAY's{worse} ({where})."
    if part is not None and not part.matters(limits):
        change = f"without it computed storeys move within {three(part.without_percent)} % of SIM"
        known = f", {change} (at least {limits.good_percent:g} %)" if np.isfinite(part.without_percent) else ""
        yield (
            f"The specimen hardly matters: its base shear is {three(part.share)} of the interface floor's inertia "
            f"force (at least {LEAST_SHARE:g}){known}; the test says little about it."
        )


def reservations(result: Result) -> tuple[str, ...]:
    """Return what stands against a test whatever its accuracy is, in two words each."""
    overridden, doubtful = _overridden(result), result.attributes.get("units_in_doubt")
    return (*(("check overridden",) if overridden else ()), *(("units doubtful",) if doubtful else ()))


def _reserved(result: Result) -> Iterator[str]:
    """Yield a sentence for each of the reservations."""
    if checked := _overridden(result):
        yield f"The check called the test {checked}"
    if doubted := result.attributes.get("units_in_doubt"):
        yield f"A wrong unit is likely in {doubted}, so this may be another test than you mean"


def _overridden(result: Result) -> str:
    """Return the verdict of a check that was overridden, "" if none was."""
    checked = str(result.attributes.get("check_verdict") or "")
    return "" if checked == "safe" else checked


def _beyond_bound(result: Result) -> str:
    """Return words on true errors beyond the stated bound, which a simulated rig knows, "" where there are none."""
    true, bound = (
        np.atleast_1d(np.asarray(result.metrics.get(name, ()), dtype=float))
        for name in ("exp_rths.true_reference_rms_error_m_s2", "exp_rths.true_error_bound_m_s2")
    )
    if not true.size or true.shape != bound.shape or not np.any(true > bound):
        return ""
    worst = int(np.argmax(true / bound))
    return f"the simulated truth is {three(true[worst] / bound[worst])} times the stated bound of storey {worst + 1}"


def _virtual(result: Result) -> bool:
    return result.attributes.get("rig_kind") == "virtual"


def _limits(result: Result) -> str:
    """Return the sentence on the limits of the grades."""
    limits = grade_limits(result)
    return f"Limits: good {limits.good_percent:g} %, usable {limits.usable_percent:g} %."


def not_accepted(result: Result) -> bool:
    """Return whether a limit on a metric that the case states is not met."""
    return any(not one.met for one in judge(result))


def _diverged(result: Result) -> str:
    """Return words on a SIM-DELAY that has no errors to compare with, "" where it has."""
    at_s = result.metrics.get("sim_delay.diverged_at_s")
    return "" if at_s is None else f"SIM-DELAY diverged at {three(float(np.asarray(at_s)))} s and is not compared"


def _without_grade(result: Result, status: str) -> list[str]:
    """Return the sentences on a result without errors of an EXP-RTHS."""
    end = _ended(result, "exp_rths")
    if end == COMPLETE and not _has_reference(result):
        return [
            "NOT GRADED: the caller's own numerical substructure declares no building, so SIM is not its reference."
        ]
    if end == COMPLETE and (why := result.attributes.get("no_true_error_bound")):
        more = f" The run {status}: {result.attributes.get('status_reason')}." if status != COMPLETE else ""
        return [f"NOT GRADED: no bound of the true error is stated, {why}.{more}", *findings(result)]
    if end == COMPLETE and status == COMPLETE:
        version = result.attributes.get("rths_version") or "an unknown version"
        return [f"NOT GRADED: the file, written by rths {version}, states no bound of the true error after the run."]
    names = ("exp_rths_status_reason", "status_reason")
    reason = next((str(text) for name in names if (text := result.attributes.get(name))), "no reason stored")
    if end is not None or status != COMPLETE:
        word = status if end is None or end == COMPLETE else end
        table = str(result.attributes.get("shake_table_status_reason") or "")
        before = f"; before it {table}" if _ended(result, "shake_table") == "aborted" and table not in reason else ""
        return [f"{word.upper()}: {without_run(result, reason)}{before}"]
    labels = RUN_NAMES | {"shake_table": "the shake-table test"}
    done = [label for group, label in labels.items() if group in result.groups]
    return [f"NO HYBRID TEST: the case asks for {' and '.join(done) or 'nothing'} alone."]


def _ended(result: Result, run: str) -> str | None:
    """Return the status of a run on the table, None where the case has none."""
    status = result.attributes.get(f"{run}_status")
    if status is not None:
        return str(status)
    return COMPLETE if run in result.groups else None


def about(result: Result) -> str:
    """Return record, damping (of the first mode), controller and rig in words."""
    a = result.attributes
    ratio = a.get("damping_first_mode_ratio")
    first = f" ({100.0 * float(ratio):.2g} %)" if isinstance(ratio, float) else ""
    scaling = f"{100.0 * float(a['scaling']):g} % " if a.get("scaling") not in (None, "") else ""
    words = f"{scaling}{a.get('record_name') or '-'}, damping {a.get('damping_name') or '-'}{first}"
    if not any(f"{run}_status" in a or run in result.groups for run in TABLE_RUNS):
        return words
    kind = "virtual rig" if a.get("rig_kind") == "virtual" else "rig"
    controller = "no controller" if a.get("controller") == "none" else a.get("controller")
    method = "" if a.get("method") == "best" else f" by method {a.get('method')}"
    return f"{words}, {controller}{method}, {kind} {a.get('rig')}"


ERROR = ("RMS error of acceleration",)


def _shown_run(result: Result) -> str:
    """Return the run whose response is shown, "" if there is none."""
    return next((run for run in RESPONSES if f"{run}.peak_abs_accel_m_s2" in result.metrics), "")


def _table(result: Result) -> Table | None:
    """Return response and errors by storey, None where there are none."""
    run = _shown_run(result)
    return _storey_table(result, run, shown_storeys(result, run))


def storey_table(result: Result) -> Table | None:
    """Return response and errors of all storeys, the roof first, None where there are none."""
    run = _shown_run(result)
    path = f"{run}.peak_abs_accel_m_s2" if run else "exp_rths.rms_error_m_s2"
    return _storey_table(result, run, list(range(np.size(result.metrics.get(path, ()))))[::-1])


def _storey_table(result: Result, run: str, storeys: Sequence[int]) -> Table | None:
    columns = [*_response(result, run, storeys), *_errors(result, storeys)]
    return by_columns("storey", _labels(result, storeys), columns) if storeys and columns else None


def _response(result: Result, run: str, storeys: Sequence[int]) -> Iterator[tuple[Column, list[str]]]:
    for path, name, unit, factor in (
        ("peak_abs_accel_m_s2", "abs. accel", "m/s^2", 1.0),
        ("peak_rel_disp_m", "displ", "mm", 1e3),
        ("peak_inter_storey_drift_m", "drift", "mm", 1e3),
        ("peak_drift_ratio", "drift", "% height", 1e2),
    ):
        if f"{run}.{path}" in result.metrics:
            column = Column(name, (f"peaks in {RUN_NAMES[run]}",), unit)
            yield column, _cells(result.metrics[f"{run}.{path}"], storeys, factor)


def _errors(result: Result, storeys: Sequence[int]) -> Iterator[tuple[Column, list[str]]]:
    for path, name, unit, factor in (
        ("exp_rths.rms_error_m_s2", "EXP-RTHS", "mm/s^2", 1e3),
        ("exp_rths.nrmse_percent", "EXP-RTHS", "% of SIM", 1.0),
        ("sim_delay.rms_error_m_s2", "SIM-DELAY", "mm/s^2", 1e3),
    ):
        if path in result.metrics and np.isfinite(np.asarray(result.metrics[path], dtype=float)).any():
            yield Column(name, ERROR, unit), _cells(result.metrics[path], storeys, factor)


def shown_storeys(result: Result, run: str) -> list[int]:
    """Return the storeys to show, from 0, the roof first: up to five all, else the three that drift most, the roof and
    those that the answer names.

    Without drifts the storeys with the largest errors are shown.
    """
    paths = (f"{run}.peak_inter_storey_drift_m", "exp_rths.rms_error_m_s2", "sim_delay.rms_error_m_s2")
    known = [np.atleast_1d(np.asarray(result.metrics[path], dtype=float)) for path in paths if path in result.metrics]
    sizes = known[0] if known else np.zeros(0)
    if sizes.size <= MOST_STOREYS:
        return list(range(sizes.size))[::-1]
    largest = np.argsort(-sizes, kind="stable")[:3].tolist()
    return sorted({*largest, sizes.size - 1, *_named_storeys(result)}, reverse=True)


def _worst_peak(result: Result) -> tuple[int, float] | None:
    """Return the storey, from 0, with the largest peak error, and that error in % of SIM's peak; None without one."""
    peaks = np.atleast_1d(np.asarray(result.metrics.get("exp_rths.peak_error_percent", ()), dtype=float))
    if not (peaks.size and np.isfinite(peaks).any()):
        return None
    worst = int(np.nanargmax(peaks))
    return worst, float(peaks[worst])


def _named_storeys(result: Result) -> Iterator[int]:
    """Yield the storeys, from 0, that the verdict and the sentence on the largest peak error name."""
    if (worst := _worst_peak(result)) is not None:
        yield worst[0]
    if (found := grade(result)) is None:
        return
    yield found.storey - 1
    if (compensation := compensation_of(result.metrics)) is not None:
        yield compensation.storey - 1


def _labels(result: Result, storeys: Sequence[int]) -> list[str]:
    """Return a label for each storey: its number, the roof, and the interface, above which the table's specimen is."""
    structure = stored_case(result).get("structure", {})
    interface = len(structure.get("numerical", {}).get("masses_kg", ()))
    roof = interface + len(structure.get("experimental", {}).get("masses_kg", ())) - 1
    names = {roof: " roof", interface - 1: " interface"}
    return [f"{storey + 1}{names.get(storey, '')}" for storey in storeys]


def _cells(values: object, storeys: Sequence[int], factor: float) -> list[str]:
    numbers = np.atleast_1d(np.asarray(values, dtype=float))
    return [three(factor * float(numbers[i])) if i < numbers.size else "-" for i in storeys]


def base_shear(result: Result) -> str:
    """Return the sentence on the building's base shear, "" where it is not known."""
    for run, label in (("exp_rths", "EXP-RTHS"), ("sim", "SIM")):
        value = result.metrics.get(f"{run}.peak_building_base_shear_n")
        ratio = result.metrics.get(f"{run}.building_base_shear_ratio")
        if value is not None and ratio is not None:
            shear, share = three(float(np.asarray(value))), three(float(np.asarray(ratio)))
            return f"Base shear of the building ({label}): {shear} N, {share} of its weight."
    return ""


def storeys_with_laws(result: Result) -> str:
    """Return the sentence on ductility, residual drift and work of the storeys with laws, "" for a linear building."""
    run = _shown_run(result)
    if f"{run}.ductility" not in result.metrics:
        return ""
    kinds = ("ductility", "residual_drift_m", "residual_drift_uncertainty_m", "restoring_work_j")
    ductility, residual, unsure, work = (
        np.atleast_1d(np.asarray(result.metrics.get(f"{run}.{kind}", np.nan), dtype=float)) for kind in kinds
    )
    said = []
    for storey in np.flatnonzero(np.isfinite(work)):
        figures = [f"ductility {three(ductility[storey])}"] if np.isfinite(ductility[storey]) else []
        known = unsure.size > 1 and np.isfinite(unsure[storey])
        end = f"{three(1e3 * residual[storey])} mm" + (f" +- {three(1e3 * unsure[storey])} mm" if known else "")
        said.append(", ".join([*figures, f"drift at the end {end}", f"work {three(work[storey])} J"]))
        said[-1] = f"storey {storey + 1}: {said[-1]}"
    more = f"; {len(said) - MOST_NAMES} more" if len(said) > MOST_NAMES else ""
    return f"Storeys with laws ({RUN_NAMES[run]}): {'; '.join(said[:MOST_NAMES])}{more}." if said else ""


def fidelity(result: Result) -> str:
    """Return the sentence on delay and gain of table or actuator and on the largest peak error, "" if not known."""
    said = []
    delay, gain = (result.metrics.get(f"exp_rths.fei_{name}") for name in ("delay_s", "amplitude"))
    if delay is not None and gain is not None:
        delay_ms, times = 1e3 * float(np.asarray(delay)), float(np.asarray(gain))
        late = f"{three(abs(delay_ms))} ms {'late' if delay_ms >= 0.0 else 'early'}"
        said.append(f"{'actuator' if _by_actuator(result) else 'table'} {late}, gain {times:.4f} (FEI)")
    if (worst := _worst_peak(result)) is not None:
        said.append(f"worst peak error {three(worst[1])} % (storey {worst[0] + 1})")
    sentence = "; ".join(said)
    return f"{sentence[0].upper()}{sentence[1:]}." if said else ""


def _by_actuator(result: Result) -> bool:
    return "exp_rths.tracking_rms_m" in result.metrics  # of a displacement


def _next(result: Result) -> str:
    more = "" if _by_actuator(result) else ", --figures DIR or --format html"
    return f"result {result.path}; more: rths report --full{more}"
