"""The answer of a run: how good the test was, the building's response by storey, errors, warnings, where the result
is and what to do next."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from rths_cli.analysis.grade import GOOD, Grade, GradeLimits, grade_of
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.files.stored_case import stored_case
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.report.error_budget_table import CAUSES
from rths_cli.report.judged_limits import judge
from rths_cli.report.result_scale import scale_lines
from rths_cli.report.results_by_case import TABLE_RUNS

MOST_STOREYS = 5  # of which all are shown; of taller buildings the three that drift most, and the roof
WIDEST, NARROW = 100, 60  # columns
LABEL, COLUMN, WIDE_COLUMN = 13, 11, 12
NAMES = {"exp_rths": "(EXP-RTHS)", "sim": "(SIM)"}  # whose response is shown: the first that there is
RESPONSES = tuple(NAMES)
USUAL = asdict(GradeLimits())
IF_DECLARED = "if sensors and masses are as declared"


def answer(result: Result, width: int = WIDEST) -> str:
    """Return the answer of one result as text, some ten lines of at most `width` columns."""
    width = min(max(width, NARROW), WIDEST)
    head = f"{result.attributes.get('case_name') or result.path.stem}: {about(result)}"
    lines = [*_wrapped(head, width), *_wrapped(verdict(result), width)]
    lines += [line for told in scale_lines([result]) for line in _wrapped(told, width)]
    tables = list(_tables(result, width))
    if tables and result.attributes.get("exp_rths_status") not in (None, "complete"):
        lines += _wrapped("Storeys and base shear below are computed (SIM): no hybrid test was completed.", width)
    for table in tables:
        lines += ["", *table]
    told = [sentence for sentence in (base_shear(result), fidelity(result)) if sentence]
    lines += ["", *(line for sentence in told for line in _wrapped(sentence, width))] if told else []
    lines += [line for note in notes([result]) for line in _wrapped(f"note: {note}", width)]
    return "\n".join([*lines, *_wrapped(_next(result), width)]) + "\n"


def answers(results: Sequence[Result], width: int = WIDEST) -> str:
    """Return the answer of one result, or the comparison of several: a row for each."""
    if len(results) == 1:
        return answer(results[0], width)
    return "\n".join(_comparison(results, min(max(width, NARROW), WIDEST))) + "\n" if results else ""


def notes(results: Sequence[Result]) -> list[str]:
    """Return the notes of results, each once, with the cases that it is of unless it is of all; none that a verdict
    has said already."""
    cases: dict[str, list[str]] = {}
    for result in results:
        said = verdict(result)
        for note in dict.fromkeys(str(result.attributes.get("warnings") or "").splitlines()):
            if note not in said:
                cases.setdefault(note, []).append(result.path.stem)
    return [note if len(of) == len(results) else f"{', '.join(of)}: {note}" for note, of in cases.items()]


def one_line(result: Result) -> str:
    """Return a result in one line: its case, how it ended, and its file."""
    name, found = result.path.stem, grade(result)
    if found is None or result.attributes.get("status_reason"):
        return f"{name}: {verdict(result)}; {result.path}"
    ratio = "" if found.ratio is None else f", ratio {three(found.ratio)} to SIM-DELAY's"
    return f"{name}: {found.grade}, error {three(found.percent)} % of SIM{ratio}; {result.path}"


def _comparison(results: Sequence[Result], width: int) -> Iterator[str]:
    """Yield the lines of the comparison of several results, and a sentence for each that has no grade."""
    names, grades = [result.path.stem for result in results], [grade(result) for result in results]
    columns: list[Column] = [
        ("grade", "", [_end(one, found) for one, found in zip(results, grades, strict=True)]),
        ("worst error", "% of SIM", [three(found.percent) if found else "-" for found in grades]),
        ("ratio to", "SIM-DELAY", [_over_sim_delay(found) for found in grades]),
        ("roof accel", "m/s^2", [_of_roof(one) for one in results]),
        ("base shear", "N", [_of_base(one) for one in results]),
    ]
    label = min(max(len(name) for name in names), width - 4 * WIDE_COLUMN) + 1
    fit = max((width - label) // WIDE_COLUMN, 1)
    yield from _laid_out(columns[:fit], [name[: label - 1] for name in names], ("case", ""), label, WIDE_COLUMN)
    for result, found in zip(results, grades, strict=True):
        if found is None or result.attributes.get("status_reason"):
            yield from _wrapped(f"{result.path.stem}: {verdict(result)}", width)
    for told in [*scale_lines(results), *(f"note: {note}" for note in notes(results))]:
        yield from _wrapped(told, width)
    yield from _wrapped(f"Grades hold {IF_DECLARED}; more by: rths report {results[0].path.parent}", width)


def _end(result: Result, found: Grade | None) -> str:
    """Return the grade in a word, else how the result ended."""
    status = _ended(result, "exp_rths") or str(result.attributes.get("status", COMPLETE))
    if found:
        return "not accept." if not_accepted(result) else found.grade
    return "-" if status == COMPLETE else status


def _over_sim_delay(found: Grade | None) -> str:
    return "-" if found is None or found.ratio is None else three(found.ratio)


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
    """Return the sentence that says whether the test can be trusted."""
    status = str(result.attributes.get("status", COMPLETE))
    found = grade(result)
    if found is None:
        return _without_grade(result, status)
    band = float(result.attributes.get("test_band_hz", TEST_BAND_HZ))
    up_to = "" if band == TEST_BAND_HZ else f" up to {band:g} Hz"
    parts = [f"error {three(found.percent)} % of SIM{up_to} in the worst storey ({found.storey})"]
    if found.ratio is not None:
        parts.append(f"ratio {three(found.ratio)} to SIM-DELAY's")
    if diverged := _diverged(result):
        parts.append(diverged)
    said = f"{found.grade.upper()}: {', '.join(parts)}"
    if found.grade != GOOD:
        said += f"; {_limiting(found, result)}"
    reason = str(result.attributes.get("status_reason") or "")
    if status != COMPLETE:
        said += f"; {status}: {reason or 'no reason stored'}"
    elif reason:
        said = f"{'NOT ACCEPTED' if not_accepted(result) else 'BUT'}: {reason}. {said}"
    checked = str(result.attributes.get("check_verdict") or "")
    if checked and checked != "safe":
        said = f"BUT: the check called the test {checked} and was overridden. {said}"
    return f"{said}, {IF_DECLARED}."


def not_accepted(result: Result) -> bool:
    """Return whether a limit on a metric that the case states is not met."""
    return any(not one.met for one in judge(result))


def _diverged(result: Result) -> str:
    """Return words on a SIM-DELAY that has no errors to compare with, "" where it has."""
    at_s = result.metrics.get("sim_delay.diverged_at_s")
    return "" if at_s is None else f"SIM-DELAY diverged at {three(float(np.asarray(at_s)))} s and is not compared"


def _without_grade(result: Result, status: str) -> str:
    """Return the sentence of a result without errors of an EXP-RTHS."""
    end = _ended(result, "exp_rths")
    if end == COMPLETE and not _has_reference(result):
        return "NOT GRADED: the caller's own numerical substructure declares no building, so SIM is not its reference."
    if end == COMPLETE and status == COMPLETE:
        version = result.attributes.get("rths_version") or "an unknown version"
        return f"NOT GRADED: the file, written by rths {version}, states no errors in percent of SIM."
    names = ("exp_rths_status_reason", "status_reason")
    reason = next((str(text) for name in names if (text := result.attributes.get(name))), "no reason stored")
    if end is not None or status != COMPLETE:
        word = status if end is None or end == COMPLETE else end
        table = str(result.attributes.get("shake_table_status_reason") or "")
        before = f"; before it {table}" if _ended(result, "shake_table") == "aborted" and table not in reason else ""
        return f"{word.upper()}: {reason.removeprefix('EXP-RTHS refused, ')}{before}"
    labels = {"sim": "SIM", "sim_delay": "SIM-DELAY", "shake_table": "the shake-table test"}
    done = [label for group, label in labels.items() if group in result.groups]
    return f"NO HYBRID TEST: the case asks for {' and '.join(done) or 'nothing'} alone."


def _limiting(found: Grade, result: Result) -> str:
    """Return what keeps a test from a better grade."""
    limits = grade_limits(result)
    bounds = {
        "percent": f"{limits.good_percent:g} % of SIM",
        "ratio": f"a ratio of {limits.good_ratio:g} to SIM-DELAY's",
    }
    bound = bounds[found.missed]
    cause = f", most of it by {CAUSES.get(found.cause, found.cause)}" if found.cause else ""
    return f"good is at most {bound}{cause}"


def _ended(result: Result, run: str) -> str | None:
    """Return the status of a run on the table, None where the case has none."""
    status = result.attributes.get(f"{run}_status")
    if status is not None:
        return str(status)
    return COMPLETE if run in result.groups else None


def about(result: Result) -> str:
    """Return record, damping, controller and rig in words."""
    a = result.attributes
    ratio = a.get("damping_first_mode_ratio")
    first = f" ({100.0 * float(ratio):.2g} % in mode 1)" if isinstance(ratio, float) else ""
    scaling = f"{100.0 * float(a['scaling']):g} % " if a.get("scaling") not in (None, "") else ""
    words = f"{scaling}{a.get('record_name') or '-'}, damping {a.get('damping_name') or '-'}{first}"
    if not any(f"{run}_status" in a or run in result.groups for run in TABLE_RUNS):
        return words
    kind = "virtual rig" if a.get("rig_kind") == "virtual" else "rig"
    controller = "no controller" if a.get("controller") == "none" else a.get("controller")
    return f"{words}, {controller} by method {a.get('method')}, {kind} {a.get('rig')}"


def _tables(result: Result, width: int) -> Iterator[list[str]]:
    """Yield the response by storey and the errors by storey, beside each other where they fit."""
    run = next((one for one in RESPONSES if f"{one}.peak_abs_accel_m_s2" in result.metrics), "")
    storeys = shown_storeys(result, run)
    columns = [*_response(result, run, storeys), *_errors(result, storeys)]
    room = max((width - LABEL) // COLUMN, 1)
    for first in range(0, len(columns), room):
        yield _laid_out(columns[first : first + room], _labels(result, storeys), ("storey", NAMES.get(run, "")))


def storey_columns(result: Result) -> tuple[str, list[str], list[Column]]:
    """Return whose response it is, the storeys, the roof first, and the columns of response and errors of all."""
    run = next((one for one in RESPONSES if f"{one}.peak_abs_accel_m_s2" in result.metrics), "")
    path = f"{run}.peak_abs_accel_m_s2" if run else "exp_rths.rms_error_m_s2"
    storeys = list(range(np.size(result.metrics.get(path, ()))))[::-1]
    columns = [*_response(result, run, storeys), *_errors(result, storeys)]
    return NAMES.get(run, ""), _labels(result, storeys), columns if storeys else []


Column = tuple[str, str, list[str]]
"""Two lines of heading and a cell for each storey."""


def _response(result: Result, run: str, storeys: Sequence[int]) -> Iterator[Column]:
    for path, name, unit, factor in (
        ("peak_abs_accel_m_s2", "peak accel", "m/s^2", 1.0),
        ("peak_rel_disp_m", "peak displ", "mm", 1e3),
        ("peak_inter_storey_drift_m", "peak drift", "mm", 1e3),
        ("peak_drift_ratio", "peak drift", "% height", 1e2),
    ):
        if f"{run}.{path}" in result.metrics:
            yield name, unit, _cells(result.metrics[f"{run}.{path}"], storeys, factor)


def _errors(result: Result, storeys: Sequence[int]) -> Iterator[Column]:
    for path, name, unit, factor in (
        ("exp_rths.rms_error_m_s2", "RMS error", "mm/s^2", 1e3),
        ("exp_rths.nrmse_percent", "of SIM", "%", 1.0),
        ("sim_delay.rms_error_m_s2", "SIM-DELAY", "mm/s^2", 1e3),
    ):
        if path in result.metrics:
            yield name, unit, _cells(result.metrics[path], storeys, factor)


def shown_storeys(result: Result, run: str) -> list[int]:
    """Return the storeys to show, from 0, the roof first: up to five all, else the three that drift most and the roof.

    Without drifts the storeys with the largest errors are shown.
    """
    paths = (f"{run}.peak_inter_storey_drift_m", "exp_rths.rms_error_m_s2", "sim_delay.rms_error_m_s2")
    known = [np.atleast_1d(np.asarray(result.metrics[path], dtype=float)) for path in paths if path in result.metrics]
    sizes = known[0] if known else np.zeros(0)
    if sizes.size <= MOST_STOREYS:
        return list(range(sizes.size))[::-1]
    largest = np.argsort(-sizes, kind="stable")[:3].tolist()
    return sorted({*largest, sizes.size - 1}, reverse=True)


def _labels(result: Result, storeys: Sequence[int]) -> list[str]:
    """Return a label for each storey: its number, the roof, and the interface, above which the table's specimen is."""
    structure = stored_case(result).get("structure", {})
    interface = len(structure.get("numerical", {}).get("masses_kg", ()))
    roof = interface + len(structure.get("experimental", {}).get("masses_kg", ())) - 1
    names = {roof: " roof", interface - 1: " interface"}
    return [f"{storey + 1}{names.get(storey, '')}" for storey in storeys]


def _laid_out(
    columns: Sequence[Column], labels: Sequence[str], heads: tuple[str, str] = ("storey", ""), label: int = LABEL,
    column: int = COLUMN,
) -> list[str]:  # fmt: skip
    """Return the lines of a table: two of headings, one for each label."""
    lines = [f"{head:<{label}}" + "".join(f"{c[i]:>{column}}" for c in columns) for i, head in enumerate(heads)]
    for row, name in enumerate(labels):
        lines.append(f"{name:<{label}}" + "".join(f"{c[2][row]:>{column}}" for c in columns))
    return [line.rstrip() for line in lines]


def _cells(values: object, storeys: Sequence[int], factor: float) -> list[str]:
    numbers = np.atleast_1d(np.asarray(values, dtype=float))
    return [three(factor * float(numbers[i])) if i < numbers.size else "-" for i in storeys]


def three(value: float) -> str:
    """Return a number with three significant digits, without an exponent where it is of ordinary size."""
    if not math.isfinite(value):
        return "-"
    rounded = float(f"{value:.3g}")  # which may carry into another power of ten
    if rounded == 0.0 or 1e-4 <= abs(rounded) < 1e5:
        return f"{rounded:.{max(2 - math.floor(math.log10(abs(rounded))), 0) if rounded else 0}f}"
    return f"{rounded:.2e}"


def base_shear(result: Result) -> str:
    """Return the sentence on the building's base shear, "" where it is not known."""
    for run, label in (("exp_rths", "EXP-RTHS"), ("sim", "SIM")):
        value = result.metrics.get(f"{run}.peak_building_base_shear_n")
        ratio = result.metrics.get(f"{run}.building_base_shear_ratio")
        if value is not None and ratio is not None:
            shear, share = three(float(np.asarray(value))), three(float(np.asarray(ratio)))
            return f"Base shear of the building ({label}): {shear} N, {share} of its weight."
    return ""


def fidelity(result: Result) -> str:
    """Return the sentence on effective delay and gain of the table and on the largest peak error, "" if not known."""
    parts = []
    delay, gain = (result.metrics.get(f"exp_rths.fei_{name}") for name in ("delay_s", "amplitude"))
    if delay is not None and gain is not None:
        delay_ms, times = 1e3 * float(np.asarray(delay)), float(np.asarray(gain))
        parts.append(f"effective delay {three(delay_ms)} ms, gain {times:.4f} (FEI)")
    peaks = np.atleast_1d(np.asarray(result.metrics.get("exp_rths.peak_error_percent", ()), dtype=float))
    if peaks.size and np.isfinite(peaks).any():
        worst = int(np.nanargmax(peaks))
        parts.append(f"peak error {three(float(peaks[worst]))} % (storey {worst + 1})")
    said = "; ".join(parts)
    return f"{said[0].upper()}{said[1:]}." if said else ""


def _next(result: Result) -> str:
    more = f"rths report {result.path}, with --figures DIR or --format html --output FILE"
    return f"result {result.path}; more by: {more}"


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)
