"""`rths check` as text and JSON: the test, its stability, latency, reach, expected error, verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.findings import as_data, sentences
from rths_cli.numerics.lti import Array
from rths_cli.quantities import METRICS, Interval, intervals_of
from rths_cli.report.case_metric_tables import budget, latency
from rths_cli.report.document import Block, Document, Line, grid, labelled
from rths_cli.report.numbers import DASH, intervals_json, json_value, rounded, significant, whole_percent
from rths_cli.report.to_text import LABEL, in_room, text
from rths_cli.structure.similitude import factors_text

if TYPE_CHECKING:
    from rths_cli.experiment.check_command import Checked, Tested
    from rths_cli.findings import Finding

MARGINS = (
    ("gain up, factor", "gain_margin", 1.0),
    ("gain down, factor", "gain_reduction_margin", 1.0),
    ("phase, degrees", "phase_margin_deg", 1.0),
    ("delay, ms", "delay_margin_s", 1e3),
    ("peak of |S|, whole loop", "sensitivity_peak", 1.0),
    ("  at, Hz", "sensitivity_peak_hz", 1.0),
)
REACH = (
    ("displacement, mm", "displacement_m", 1e3),
    ("velocity, m/s", "velocity_m_s", 1.0),
    ("acceleration, m/s^2", "acceleration_m_s2", 1.0),
    ("sensor range, m/s^2", "sensor_m_s2", 1.0),
    ("actuator force, N", "force_n", 1.0),
    ("command, V", "command_v", 1.0),
)
RUNS = (("shake_table", "shake-table test"), ("exp_rths", "EXP-RTHS"))
GUARDED = (
    ("displacement, mm", "displacement_m", 1e3),
    ("off the desired one, mm", "deviation_m", 1e3),
    ("tracking error, m/s^2", "tracking_m_s2", 1.0),
    ("table acceleration, m/s^2", "acceleration_m_s2", 1.0),
)
OVER_SAMPLES = (
    ("critical delay, ms", "check.critical_delay_s", 1e3),
    ("tolerated table error, %", "check.tolerated_table_error", 100.0),
    ("delay margin, ms", "check.delay_margin_s", 1e3),
    ("peak displacement, mm", "check.peak_displacement_m", 1e3),
    ("peak acceleration, m/s^2", "check.peak_acceleration_m_s2", 1.0),
    ("peak command, V", "check.peak_command_v", 1.0),
    ("tracking error, mm/s^2", "check.tracking_rms_m_s2", 1e3),
    ("error of storey {}, mm/s^2", "check.rms_error_m_s2", 1e3),
)
"""Figures of which the page shows the range over samples: label, path, factor."""
SIMULATED = (
    ("peak drift, mm", "peak_inter_storey_drift_m", 1e3),
    ("ductility", "ductility", 1.0),
    ("residual drift, mm", "residual_drift_m", 1e3),
    ("work of spring and laws, J", "restoring_work_j", 1.0),
)
TRUE_ERRORS = (
    ("true error over SIM-DELAY, median", "check.true_error_m_s2"),
    ("the same, not exceeded with 95 %", "check.true_error_bound_m_s2"),
)
TANGENT_SCALES = (
    ("tolerated_table_error", 100.0),
    ("required_table_error", 100.0),
    ("delay_margin_s", 1e3),
    ("critical_delay_s", 1e3),
)
TANGENT_COLUMNS = ("spectral_radius", "faults", *(name for name, _ in TANGENT_SCALES))
OVER_SIM_DELAY = (
    ("predicted ", "check.rms_error_m_s2"),
    ("true error below ", "check.true_error_bound_m_s2"),
)
ERROR_OF_ACTUATOR = "check.interface_disp_error_percent"
FULL = "rths check --full"
MOST_LINES, LEAST_LINES_OF_NOTES = 14, 2
LEAST_GROWTH = 1e-9
MOST_MODES = 10  # on the page
Values = Mapping[str, Array]


def pages(checked: Sequence[Checked], full: bool = False) -> str:
    """Return the verdict on a case with its reasons and the numbers that decide, or a line for each of several cases;
    `full`: every number of each case, too."""
    sections = [section for one in checked for section in _sections(one)] if full else []
    if len(checked) < 2:
        return text(sections or [section for one in checked for section in _brief(one)])
    rows = [[_name(one.about), one.verdict, _why(one)] for one in checked]
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    lines = [f"{name:<{widths[0]}}  {verdict:<{widths[1]}}  {why}".rstrip() for name, verdict, why in rows]
    more = [] if full else [Line(f"more: {FULL}, or one case alone")]
    return text([[*(Line(line, indent=LABEL) for line in lines), *more], *sections])


def page(checked: Checked) -> str:
    """Return the page of one case."""
    return text(_sections(checked))


def _sections(checked: Checked) -> Document:
    values = _numbers(checked)
    title, *about = _about(checked.about, _counters(values))
    sections = [[title, *_verdict(checked, full=True), *about]]
    if "check.spectral_radius" in values:
        sections += [
            _stability(values),
            _margins(values, checked.about.compared_hz[1]),
            _tangents(values, checked.tangents),
            latency(values),
        ]
        sections += [_reach(values), _simulated(values)]
        sections += [budget(values), _compared(values, checked.about)]
    sections.append(_guard(values, checked.of_guard))
    if intervals := intervals_of(checked.metrics):
        sections.append(_over_samples(intervals))
    notes: list[Block] = [labelled("note", one) for one in checked.warnings if one not in checked.reasons]
    sections.append(notes)
    return sections


def one_line(checked: Checked) -> str:
    """Return the verdict on a case with its reasons in one line."""
    return ": ".join(filter(None, (_name(checked.about), checked.verdict, _why(checked))))


def _brief(checked: Checked) -> Document:
    """Return verdict, reasons, the test and the numbers that decide, in MOST_LINES lines."""
    values, about = _numbers(checked), checked.about
    title, *_ = _about(about, "")
    motion = f"{about.record} x {about.scaling:g}, {about.sample_rate_hz:g} Hz"
    test = f"{about.structure}, damping {about.damping}; {motion}"
    lines = [
        *_verdict(checked, full=False),
        title,
        labelled("test", f"{test}; {about.controller}, method {about.method}{_counters(values)}"),
        labelled("model", about.model),
        *([labelled("overridden", ", ".join(about.overrides))] if about.overrides else []),
        *_decisive(values),
    ]
    notes = [f"note: {one}" for one in checked.warnings if one not in checked.reasons]
    room = max(MOST_LINES - 1 - text([lines]).count("\n"), LEAST_LINES_OF_NOTES)
    return [[*lines, *in_room(notes, room, FULL), Line(f"more: {FULL}, --json")]]


def _decisive(values: Values) -> list[Block]:
    """Return a line each on stability, table limits and expected error, as far as they are predicted."""
    if "check.spectral_radius" not in values:
        return []
    radius = f"spectral radius {_one(values, 'spectral_radius'):.6f}"
    if _one(values, "spectral_radius") >= 1.0:
        return [labelled("stability", f"{radius}: the loop is unstable")]
    stands, must = (100.0 * _one(values, f"{name}_table_error") for name in ("tolerated", "required"))
    margin = f"delay margin {significant(1e3 * _one(values, 'delay_margin_s'))} ms"
    error = f"table error tolerated {stands:.3g} %, required {must:.3g} %"
    return [labelled("stability", f"{radius}; {margin}; {error}"), *_nearest_limit(values), *_expected(values)]


def _nearest_limit(values: Values) -> list[Block]:
    if "check.peak_command_v" not in values:
        return []
    shares = {
        label: _one(values, f"peak_{leaf}") / _one(values, f"limit_{leaf}")
        for label, leaf, _ in REACH
        if f"check.peak_{leaf}" in values  # of an actuator there are no accelerations
    }
    nearest = max(shares, key=shares.__getitem__)
    largest = _one(values, "largest_scaling")
    scaling = f"{largest:g}" if largest > 0.0 else "none, the test is not safe with any"
    at = f"{nearest.partition(',')[0]} at {100.0 * shares[nearest]:.1f} % of its limit"
    return [labelled("table limits", f"{at}; largest safe scaling {scaling}")]


def _expected(values: Values) -> list[Block]:
    if ERROR_OF_ACTUATOR in values:
        return [labelled("expected error", _of_actuator(values))]
    if "check.rms_error_m_s2" not in values:
        return []
    error = values["check.rms_error_m_s2"]
    worst = int(np.argmax(error))
    said = f"{significant(1e3 * error[worst])} mm/s^2 RMS (storey {worst + 1})"
    if "check.sim_delay_rms_error_m_s2" in values:
        delayed = values["check.sim_delay_rms_error_m_s2"]
        over = [(label, values[path] / delayed) for label, path in OVER_SIM_DELAY if path in values]
        parts = [f"{label}{significant(100.0 * float(np.max(share)))} %" for label, share in over]
        said += f"; of SIM-DELAY's error {', '.join(parts)}" if parts and np.all(delayed > 0.0) else ""
    return [labelled("expected error", said)]


def _of_actuator(values: Values) -> str:
    """Return the predicted error of a test with an actuator."""
    return f"{significant(values[ERROR_OF_ACTUATOR][0])} % of SIM's displacement at the interface (RMS, as identified)"


def _numbers(checked: Checked) -> Values:
    return {path: np.atleast_1d(np.asarray(value, dtype=float)) for path, value in checked.metrics.items()}


def _name(about: Tested) -> str:
    return f"{about.case} ({about.method})"


def _why(one: Checked) -> str:
    """Return the summary of a case: its reasons, or the largest safe scaling of its record."""
    if one.reasons:
        return "; ".join(one.reasons)
    largest = one.metrics.get("check.largest_scaling")
    up_to = f"up to scaling {float(np.asarray(largest)):g}" if largest is not None else ""
    return "; ".join(filter(None, (_if_right(one), up_to)))


def _if_right(one: Checked) -> str:
    """Return the numbers that a verdict takes for right although they are doubted, "" where none is."""
    return f"if {', '.join(one.doubted)} {'are' if len(one.doubted) > 1 else 'is'} right" if one.doubted else ""


def _counters(values: Values) -> str:
    """Return what the command counters beside its delay, "" where nothing."""
    parts = {"reaction_feedforward": "a changed specimen's reaction", "friction_compensation": "friction"}
    off = np.zeros(1)
    found = [text for name, text in parts.items() if values.get(f"controller.{name}", off)[0] > 0.0]
    return f"; counters {' and '.join(found)}" if found else ""


def _about(about: Tested, counters: str) -> list[Block]:
    kind = "" if not about.rig_kind else f"{about.rig_kind} "
    scale = [] if about.scale is None else [labelled("scale", _scale(about.scale, about.record_s))]
    overrides = [labelled("overridden", ", ".join(about.overrides))] if about.overrides else []
    return [
        Line(f"Check of {about.case} on the {kind}table {about.rig}, before anything moves"),
        labelled("building", f"{about.structure}, damping {about.damping}"),
        labelled("record", f"{about.record} x {about.scaling:g}, {about.sample_rate_hz:g} Hz"),
        *scale,
        labelled("controller", f"{about.controller}, method {about.method}{counters}"),
        *([labelled("calibration", about.calibration)] if about.calibration else []),
        labelled("model", about.model),
        *overrides,
    ]


def _scale(factors: Mapping[str, float], record_s: float) -> str:
    """Return the factors, and what they make of the record."""
    return (
        f"prototype over model: {factors_text(factors)}; {factors['time'] * record_s:.4g} s of record are compressed "
        f"to {record_s:.4g} s; everything below is in model scale"
    )


def _stability(values: Values) -> list[Block]:
    """Return the lines on spectral radius, modes, critical delay and gain at infinity."""
    growth = _one(values, "growth")
    over = "die out" if growth < LEAST_GROWTH else f"change by a factor {rounded(growth)}"
    rows = [["mode", "building (Hz)", "damping (%)", "in the loop (Hz)", "damping (%)"]]
    columns = [
        values[f"check.{of}_{what}"] for of in ("building", "loop") for what in ("frequency_hz", "damping_ratio")
    ]
    modes = list(enumerate(zip(*columns, strict=True), 1))
    for mode, (own_hz, own, loop_hz, loop) in modes[:MOST_MODES]:
        rows.append([str(mode), f"{own_hz:.4f}", f"{100 * own:.3f}", f"{loop_hz:.4f}", f"{100 * loop:.3f}"])
    more = [Line(f"  {len(modes) - MOST_MODES} more modes in --json")] if len(modes) > MOST_MODES else []
    return [
        labelled("stability", "of the sampled closed loop: every block of the step on the identified rig"),
        labelled("  spectral radius", f"{_one(values, 'spectral_radius'):.6f}; motions {over} over the record"),
        grid(rows),
        *more,
        labelled("  critical delay", _critical(values)),
        labelled(
            "  mass ratio",
            f"{_one(values, 'gain_at_infinity'):.3f} of the interface floor, physical over computed; from 1 on any "
            "delay makes the loop unstable",
        ),
    ]


def _critical(values: Values) -> str:
    delay, hz = _one(values, "critical_delay_s"), _one(values, "critical_delay_hz")
    if not np.isfinite(delay):
        return "none, on an ideal table no pure delay makes this building unstable"
    if delay == 0.0:
        return (
            "0 ms: on an ideal table of unlimited bandwidth any pure delay makes this building unstable; the verdict "
            "rests on the table as identified"
        )
    return f"{rounded(1e3 * delay)} ms on an ideal table; the {rounded(hz)} Hz mode becomes unstable first"


def _margins(values: Values, compared_to_hz: float) -> list[Block]:
    """Return the lines on the margins, with measured response and with model, and on the tolerated table error."""
    if _one(values, "spectral_radius") >= 1.0:
        return [labelled("margins", "none: the loop is unstable")]
    rows = [["", "measured", "model"]]
    for label, leaf, scale in MARGINS:
        rows.append([label, *(significant(scale * _one(values, f"{leaf}{kind}")) for kind in ("", "_model"))])
    stands, must = (100.0 * _one(values, f"{name}_table_error") for name in ("tolerated", "required"))
    where = rounded(_one(values, "table_error_hz"))
    least, there = (_one(values, name) for name in ("tolerated_table_error_in_band", "table_error_in_band_hz"))
    known = "check.table_gain_change" in values  # not in files of earlier versions
    gain = f", gain up to {100.0 * _one(values, 'table_gain_change'):.3g} % off" if known else ""
    alone = [labelled("  feedback alone", _feedback(values))] if "feedback.sensitivity_peak" in values else []
    return [
        labelled("margins", "of the loop broken at the command; with the measured response, and with the model alone"),
        grid(rows),
        *alone,
        labelled(
            "  table error",
            f"tolerated {stands:.3g} %, required {must:.3g} %: tightest at {where} Hz{gain}",
        ),
        labelled(
            f"    up to {rounded(compared_to_hz)} Hz",
            f"tolerated {100.0 * least:.3g} % or more, the least at {rounded(there)} Hz",
        ),
        *_beyond_the_band(values),
    ]


def _beyond_the_band(values: Values) -> list[Block]:
    """Return the line on the error that the feedback tolerates beyond the identified band; none without feedback."""
    if "check.feedback_error_hz" not in values:  # nor in files of earlier versions
        return []
    stands, must = (100.0 * _one(values, f"feedback_{name}_error") for name in ("tolerated", "required"))
    at = rounded(_one(values, "feedback_error_hz"))
    said = f"tolerated {stands:.3g} %, required {must:.3g} %: tightest at {at} Hz, above the band"
    return [labelled("    feedback alone", said)]


def _tangents(values: Values, names: Sequence[str]) -> list[Block]:
    """Return the lines on the verdicts at the tangents of laws; none for a linear building."""
    if not names:
        return []
    rows = [["", "spectral radius", "tolerated %", "required %", "delay, ms", "critical, ms", "verdict"]]
    for i, name in enumerate(names):
        of = {key: float(values[f"check.tangent_{key}"][i]) for key in TANGENT_COLUMNS}
        numbers = [significant(of[key] * scale) for key, scale in TANGENT_SCALES]
        rows.append([name, f"{of['spectral_radius']:.6f}", *numbers, "not safe" if of["faults"] else "safe"])
    ends = [1e3 * _one(values, f"critical_delay_{end}_s") for end in ("least", "most")]
    told = [rounded(end) if np.isfinite(end) else "any" for end in ends]
    return [
        labelled("tangents", "the linear loop frozen at each; indications, the evidence is the simulated test"),
        grid(rows),
        labelled("  critical delay", f"{told[0]} to {told[1]} ms on an ideal table"),
    ]


def _simulated(values: Values) -> list[Block]:
    """Return the lines on the simulated test of a building with laws; none for a linear building."""
    if "check.ductility" not in values:
        return []
    rows = [["", *(f"storey {i}" for i in range(1, len(values["check.ductility"]) + 1))]]
    for label, leaf, scale in SIMULATED:
        row = scale * values[f"check.{leaf}"]
        rows.append([label, *map(significant, row)])
    return [
        labelled(
            "simulated test", "with the laws, on the identified rig; the peaks above and the errors below are its"
        ),
        grid(rows),
    ]


def _feedback(values: Values) -> str:
    peak, hz, wide = (
        float(values[f"feedback.{name}"][0]) for name in ("sensitivity_peak", "sensitivity_peak_hz", "bandwidth_hz")
    )
    return (
        f"peak of |S| {significant(peak)} at {rounded(hz)} Hz, bandwidth {rounded(wide)} Hz, with the measured response"
    )


def _reach(values: Values) -> list[Block]:
    """Return the lines on predicted peaks with their limits, and on the largest safe scaling."""
    if "check.peak_command_v" not in values:
        return [labelled("table limits", "not predicted: the loop is unstable")]
    rows = [["", "peak", "limit", "share (%)"]]
    for label, leaf, scale in REACH:
        if f"check.peak_{leaf}" not in values:
            continue
        peak, limit = _one(values, f"peak_{leaf}"), _one(values, f"limit_{leaf}")
        rows.append([label, significant(scale * peak), significant(scale * limit), f"{100 * peak / limit:.1f}"])
    largest = _one(values, "largest_scaling")
    scaling = f"{largest:g}" if largest > 0.0 else "none, the test is not safe with any"
    return [
        labelled("table limits", "predicted peaks, at most 90 % of each limit; displacement with the room to brake"),
        grid(rows),
        labelled("  largest safe scaling", scaling),
    ]


def _guard(values: Values, said: Sequence[Finding]) -> list[Block]:
    """Return the lines on the guard's limits in each run, and the sentences on them; none where no run is planned."""
    rows = [["", "needs", "limit"]]
    for run, label in RUNS:
        for words, leaf, scale in GUARDED:
            if f"check.{run}_guard_{leaf}" in values:
                needs, limit = (scale * _one(values, f"{run}_{what}_{leaf}") for what in ("planned", "guard"))
                rows.append([f"{label}, {words}", significant(needs), significant(limit)])
    if len(rows) == 1:
        return [labelled("guard", str(one)) for one in said]
    first = "stops a run at these limits, set to the motion that the run needs and never above the rig file's"
    return [labelled("guard", first), grid(rows), *(labelled("", str(one)) for one in said)]


def _compared(values: Values, about: Tested) -> list[Block]:
    """Return the lines on the predicted error in comparison with SIM-DELAY, and on the friction that it includes."""
    if ERROR_OF_ACTUATOR in values:
        return [labelled("error", _of_actuator(values))]
    if "check.rms_error_m_s2" not in values:
        return [labelled("error", "not predicted: the loop is unstable")]
    friction = _one(values, "friction_v")
    countered = values.get("controller.friction_compensation", np.zeros(1))[0] > 0.0
    what = "countered, the rest is included" if countered else "included"
    lines = [labelled("friction", f"{what}; as identified, equivalent to {1e3 * friction:.3g} mV of command")]
    late = f"SIM-DELAY, {1e3 * about.delay_s:g} ms"
    if "check.sim_delay_rms_error_m_s2" not in values:
        return [*lines, labelled(late, "not stated: near its critical delay, or beyond it")]
    delayed, error = values["check.sim_delay_rms_error_m_s2"], values["check.rms_error_m_s2"]
    storeys = range(1, len(error) + 1)
    rows = [["", *(f"storey {storey}" for storey in storeys)]]
    rows.append([f"{late}, mm/s^2", *(significant(1e3 * value) for value in delayed)])
    shares = [significant(one / late) if late > 0.0 else DASH for one, late in zip(error, delayed, strict=True)]
    rows.append(["predicted over SIM-DELAY", *shares])
    for label, path in TRUE_ERRORS:
        if path in values:
            rows.append([label, *(significant(one / late) for one, late in zip(values[path], delayed, strict=True))])
    return [*lines, grid(rows)]


def _over_samples(intervals: Mapping[str, Interval]) -> list[Block]:
    """Return the lines on the figures that differ between the samples of the identified model."""
    rows = [["", "nominal", "least", "most"]]
    for label, path, scale in OVER_SAMPLES:
        if path not in intervals:
            continue
        one = intervals[path]
        numbers = [scale * np.atleast_1d(np.asarray(each, dtype=float)) for each in (one.value, one.low, one.high)]
        for storey, cells in enumerate(zip(*numbers, strict=True), 1):
            rows.append(
                [label.format(storey), *(significant(cell) if np.isfinite(cell) else f"{cell:g}" for cell in cells)]
            )
    held = whole_percent(min(one.probability for one in intervals.values()))
    about = f"a further sample of the identified model lies in each range with a probability of at least {held}"
    return [labelled("range over samples", about), grid(rows)]


def _verdict(checked: Checked, full: bool) -> list[Block]:
    """Return the lines on verdict and reasons; a warning that is a reason is told once, here."""
    first = " ".join(filter(None, (checked.verdict, _if_right(checked))))
    first = f"{checked.verdict}: {checked.reasons[0]}" if checked.reasons else first
    of_runs = ", ".join(f"{label} {verdict}" for label, verdict in checked.runs)
    differ = len({verdict for _, verdict in checked.runs}) > 1
    runs = [labelled("table runs", of_runs)] if differ or (full and len(checked.runs) > 1) else []
    return [labelled("verdict", first, checked.verdict), *(labelled("", one) for one in checked.reasons[1:]), *runs]


def _one(values: Values, name: str) -> float:
    return float(values[f"check.{name}"][0])


def as_document(checked: Sequence[Checked]) -> dict[str, Any]:
    """Return checked cases as plain numbers, texts and lists for JSON."""
    return {"cases": [_case(one) for one in checked]}


def _case(one: Checked) -> dict[str, Any]:
    about = {name: _plain_value(value) for name, value in vars(one.about).items()}
    return {
        **about,
        "verdict": one.verdict,
        "doubted": list(one.doubted),
        "reasons": list(one.reasons),
        "warnings": list(one.warnings),
        "findings": [as_data(found) for found in (*one.refusals, *one.notes, *one.of_guard)],
        "metrics": {path: json_value(value) for path, value in one.metrics.items()},
        "units": {path: METRICS[path].units for path in one.metrics},
        "definitions": {path: METRICS[path].definition for path in one.metrics},
        **({"tangents": list(one.tangents)} if one.tangents else {}),
        **({"guard": list(sentences(one.of_guard))} if one.of_guard else {}),
        **({"intervals": intervals_json(intervals)} if (intervals := intervals_of(one.metrics)) else {}),
    }


def _plain_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
