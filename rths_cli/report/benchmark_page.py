"""The output of `rths benchmark`: the order of the compensators first, then a table of criteria for each case."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.analysis.grade import GOOD, POOR, USABLE, GradeLimits
from rths_cli.benchmark.campaign import AnyBenchmark, Benchmarked, BenchmarkRow
from rths_cli.benchmark.displacement import SETTLED_S, DisplacementBenchmark, critical_delay_s
from rths_cli.benchmark.ranking import Standing, contradicted, half_interval, has_failed, standings
from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.report.document import Block, Column, Document, Line, Row, Table, by_columns, verdict_line
from rths_cli.report.numbers import json_value
from rths_cli.report.to_text import text
from rths_cli.safe_text import visible

COLUMNS = (  # name, unit, figure, decimals
    ("J1", "ms", "j1_ms", 2),
    *((f"J{i}", "%", f"j{i}_percent", 2) for i in range(2, 10)),
    ("FEI", "", "fei_amplitude", 3),
    ("FEI delay", "ms", "fei_delay_ms", 2),
    ("J2 true", "%", "true_j2_percent", 2),
    ("J4 true", "%", "true_j4_percent", 2),
    ("error", "%", "error_percent", 2),
)
LEGEND = (
    "J1: lag of the actuator, 0 to 12 ms; leads are not seen. Tracking: J2 deviation, J3 peak. Against the reference: "
    "J4 deviation and J5 peak of floor 1 as measured, J6 and J7 deviation of floors 2 and 3, J8 and J9 their peaks.",
    "FEI: frequency evaluation index, amplitude and delay. J1 to J5 and FEI have the sensor's noise, the true J2 and "
    "J4 are of the displacement itself.",
)
ORDER = (
    "error: deviation of the displacement itself from the reference with this plant's own specimen, over that of the "
    "reference; mean over cases and plants, with its 95 % interval over the plants. Equal ranks: no significant "
    "difference from the first of that rank on the same plants and noise (95 %). Compensators with an unstable run "
    "come last.",
)
TABLE_COLUMNS = (
    ("error", "%", "error_percent", 2),
    ("peak", "%", "peak_percent", 2),
    ("tracking", "%", "tracking_percent", 2),
    ("as measured", "%", "sim_percent", 2),
)
TABLE_LEGEND = (
    "Of the worst storey, in the test band. error, peak: true motion against SIM with the specimen as it is, RMS and "
    "peak of the difference in % of those of SIM. tracking: the table's true error, in % of the desired motion. as "
    "measured: what the laboratory sees, against SIM as declared. grade: by the error of the worst plant.",
)
TABLE_ORDER = (
    "error: mean over cases and plants, with its 95 % interval over the plants. Equal ranks: no significant difference "
    "from the first of that rank on the same laboratories and noise (95 %). Compensators of which a run is refused or "
    "stopped come last.",
)
NUMBER = re.compile(r"-?\d[\d.]*(?:e[-+]?\d+)?")
MOST_NAMED = 4  # runs that share a reason, the rest counted
FORMATS = (".tex", ".md", ".html", ".txt")


def document(made: Benchmarked) -> Document:
    """Return the whole output as a document."""
    order = standings(made)
    return [
        [verdict_line(verdict(made, order)), *notes(made)],
        [_ranking(made, order), *map(Line, adapting(made))],
        *([_case_table(made, case.name, order)] for case in made.bench.spec.cases),
        *_behind(made.bench),
        [Line(f"rows in {made.path}")],
    ]


def _behind(bench: AnyBenchmark) -> Document:
    """Return what stands behind the tables of the cases."""
    if isinstance(bench, DisplacementBenchmark):
        return [[Line(one) for one in LEGEND], [_delays(bench)]]
    return [[Line(one) for one in TABLE_LEGEND]]


def page(made: Benchmarked) -> str:
    """Return the whole output as text."""
    return text(document(made))


def verdict(made: Benchmarked, order: Sequence[Standing]) -> str:
    """Return in one sentence which compensator is best."""
    best = [one for one in order if one.rank == 1]
    first = best[0]
    if first.failed:
        return f"none: of every compensator a run is {_failing(made)}"
    beside = "" if len(best) == 1 else f" (no significant difference: {', '.join(one.compensator for one in best[1:])})"
    return (
        f"{first.compensator}: best of {len(order)}, error {_percent(first.error_percent, first.half_percent)} over "
        f"{_counted(len(made.bench.spec.cases), 'case')} and {_counted(made.bench.spec.plants, 'plant')}{beside}"
    )


def notes(made: Benchmarked) -> list[Block]:
    """Return what must be known beside the table: record, noise, plants, and what is unusual in any run."""
    bench, seed = made.bench, int(made.plan["seed"])
    if not isinstance(bench, DisplacementBenchmark):
        changed = f"; {', '.join(bench.settings)}" if bench.settings else ""
        told = [f"{bench.spec.heading}; seeds {seed} to {seed + bench.spec.plants - 1}{changed}"]
        return [Line(one) for one in (*told, *_outcomes(made))]
    spec = bench.spec
    negative = sum(bench.plant(i, seed).oil_column_rad_s < 0.0 for i in range(spec.plants))
    clipped = sum(row.figures["peak_force_n"] >= spec.actuator.force_limit_n - 50.0 for row in made.rows)
    noise = "sensors without noise" if bench.noise_free else "one draw for both sensors"
    told = [
        f"{spec.heading}; {spec.ground_motion_factor:g} x {spec.ground_motion}, seed {seed}, {noise}, force clipped at "
        f"{spec.actuator.force_limit_n:g} N"
    ]
    if bench.change is not None:
        stated = bench.change.model_dump(exclude_defaults=True).items()
        changed = ", ".join(f"{key} {value:g}" for key, value in stated)
        told.append(f"the plant changes ({changed}); every figure is that from {SETTLED_S:g} s after it")
    if negative:
        told.append(f"a_3 < 0 in {negative} of {spec.plants} plants: kept as drawn, the feedback stabilises the plant")
    if clipped:
        told.append(f"the force came to its limit in {clipped} of {len(made.rows)} runs")
    if wrong := contradicted(made.rows, made.adapting):
        told.append(f"{len(wrong)} runs diverged although their linear loop is stable: see the rows")
    return [Line(one) for one in told]


def _outcomes(made: Benchmarked) -> Iterator[str]:
    """Yield a sentence on what was refused or stopped, one for all compensators and runs that share the reason but for
    its numbers, which are those of the first."""
    same: dict[str, tuple[str, dict[str, list[str]]]] = {}
    for row in made.rows:
        if row.outcome:
            reason = row.outcome.replace(f"controller: {row.compensator} ", "the law ")
            _, of = same.setdefault(NUMBER.sub("", reason), (reason, {}))
            of.setdefault(row.compensator, []).append(f"{row.case} {row.plant}")
    for reason, of in same.values():
        yield f"{', '.join(_where(made, *one) for one in of.items())}: {reason}"


def _where(made: Benchmarked, compensator: str, runs: Sequence[str]) -> str:
    """Return a compensator, and where not all of its runs are meant, which ones."""
    if len(runs) == len(made.bench.spec.cases) * made.bench.spec.plants:
        return compensator
    listed = ", ".join(runs[:MOST_NAMED]) + (", ..." if len(runs) > MOST_NAMED else "")
    return f"{compensator} ({_counted(len(runs), 'run')}, case and plant {listed})"


def _failing(made: Benchmarked) -> str:
    return "unstable" if isinstance(made.bench, DisplacementBenchmark) else "refused or stopped"


def adapting(made: Benchmarked) -> list[str]:
    """Return what is known of each law that adapts, a sentence for all cases of which the same is known."""
    told = []
    for label, cases in made.adaptive.items():
        same: dict[str, list[str]] = {}
        for case, verdict in cases.items():
            same.setdefault(verdict.told, []).append(case)
        told += [f"{label}, case {', '.join(where)}, nominal plant: {what}" for what, where in same.items()]
    return told


def _ranking(made: Benchmarked, order: Sequence[Standing]) -> Table:
    of_actuator = isinstance(made.bench, DisplacementBenchmark)
    columns = [
        (Column("rank"), ["-" if math.isnan(one.error_percent) else str(one.rank) for one in order]),
        (Column("error", unit="%"), [_number(one.error_percent) for one in order]),
        (Column("+-95 %", unit="%"), [_number(one.half_percent) for one in order]),
        (Column("worst", unit="%"), [_number(one.worst_percent) for one in order]),
        (Column("true J2" if of_actuator else "tracking", unit="%"), [_number(one.tracking_percent) for one in order]),
        (Column(_failing(made)), [f"{one.failed} of {one.runs}" for one in order]),
        (Column("linear loop", words=True), [one.verdict for one in order]),
    ]
    table = by_columns("compensator", [one.compensator for one in order], columns)
    return Table(table.columns, table.rows, "Order, by the error", "compensator", ORDER if of_actuator else TABLE_ORDER)


def _case_table(made: Benchmarked, case: str, order: Sequence[Standing]) -> Table:
    of_actuator = isinstance(made.bench, DisplacementBenchmark)
    shown, rows = COLUMNS if of_actuator else TABLE_COLUMNS, []
    for one in order:
        found = [row for row in made.rows if row.case == case and row.compensator == one.compensator]
        means = {name: float(np.mean([row.figures[name] for row in found])) for name in made.bench.figures}
        cells = [_number(means[name], digits) for _, _, name, digits in shown]
        rows.append(Row(one.compensator, (*cells, *(() if of_actuator else (_graded(found),)))))
    columns = [Column(name, unit=unit) for name, unit, _, _ in shown]
    columns += [] if of_actuator else [Column("grade", words=True)]
    return Table(tuple(columns), tuple(rows), f"Case {case}, means over the plants", "compensator")


def _graded(rows: Sequence[BenchmarkRow]) -> str:
    """Return the grade of the worst run by its true error, or how many were refused and stopped."""
    if any(row.outcome for row in rows):
        words = [row.outcome.partition(":")[0] for row in rows if row.outcome]
        return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    worst, limits = max(row.figures["error_percent"] for row in rows), GradeLimits()
    return GOOD if worst <= limits.good_percent else USABLE if worst <= limits.usable_percent else POOR


def delays_page(bench: DisplacementBenchmark) -> str:
    """Return the critical delays alone."""
    return text([[_delays(bench)]])


def delays(bench: DisplacementBenchmark) -> dict[str, float]:
    """Return the critical delay of each case in ms."""
    return {case.name: 1e3 * critical_delay_s(bench, case) for case in bench.spec.cases}


def _delays(bench: DisplacementBenchmark) -> Table:
    found = delays(bench)
    less = 1.5e3 * bench.dt_s
    columns = [
        (Column("critical delay", unit="ms"), [f"{one:.3f}" for one in found.values()]),
        (Column("of it left", unit="ms"), [f"{one - less:.3f}" for one in found.values()]),
    ]
    table = by_columns("case", list(found), columns)
    note = (
        "critical delay: pure delay of the actuator at which the continuous loop is on the border of stability, its "
        f"force without a delay of its own; of it left: without {less:.3f} ms, the force's sample of delay and its hold"
    )
    return Table(table.columns, table.rows, "Critical delays", "case", (note,))


def as_json(made: Benchmarked) -> dict[str, Any]:
    """Return the same as a document for JSON."""
    order = standings(made)
    return {
        "benchmark": made.bench.spec.name,
        "verdict": verdict(made, order),
        "seed": made.plan["seed"],
        **_stated(made.bench),
        "plants": made.bench.spec.plants,
        "critical_delays_ms": {name: json_value(1e3 * one) for name, one in made.critical_delays_s.items()},
        "ranking": [
            {
                "compensator": one.compensator,
                "rank": one.rank,
                "error_percent": json_value(one.error_percent),
                "error_half_interval_percent": json_value(one.half_percent),
                "worst_error_percent": json_value(one.worst_percent),
                made.bench.tracked: json_value(one.tracking_percent),
                _failing(made).replace(" ", "_"): one.failed,
                "runs": one.runs,
                "linear_loop": one.verdict,
            }
            for one in order
        ],
        "adapting": adapting(made),
        "cases": {case.name: list(_means(made, case.name, order)) for case in made.bench.spec.cases},
        "rows": [_row(row) for row in made.rows],
        "file": str(made.path),
    }


def _stated(bench: AnyBenchmark) -> dict[str, Any]:
    """Return what a benchmark plays."""
    if not isinstance(bench, DisplacementBenchmark):
        return {"settings": list(bench.settings)}
    spec = bench.spec
    return {"noise_free": bench.noise_free, "record": spec.ground_motion, "scaling": spec.ground_motion_factor}


def _means(made: Benchmarked, case: str, order: Sequence[Standing]) -> Iterator[dict[str, Any]]:
    for one in order:
        found = [row for row in made.rows if row.case == case and row.compensator == one.compensator]
        values = {name: np.array([row.figures[name] for row in found]) for name in made.bench.figures}
        half = half_interval(values["error_percent"])
        yield {
            "compensator": one.compensator,
            **{name: json_value(np.mean(each)) for name, each in values.items()},
            "error_half_interval_percent": json_value(half),
            _failing(made).replace(" ", "_"): sum(map(has_failed, found)),
        }


def _row(row: BenchmarkRow) -> dict[str, Any]:
    figures = {name: json_value(value) for name, value in row.figures.items()}
    told = {"case": row.case, "compensator": row.compensator, "plant": row.plant, **figures}
    return told | ({"outcome": row.outcome} if row.outcome else {})


def check_table(path: Path) -> None:
    """Raise InputError for a table's file whose ending names no format."""
    if path.suffix not in FORMATS:
        raise InputError(f"--table {path}: must end with {', '.join(FORMATS)}")


def write_table(path: Path, made: Benchmarked) -> None:
    """Write the output in the format that the file's ending names: LaTeX, Markdown, HTML or text."""
    from rths_cli.report.to_files import latex, markdown
    from rths_cli.report.to_html import Html, blocks, element, join

    found = document(made)
    if path.suffix == ".html":
        body = element("body", element("h1", made.bench.spec.heading), join(map(blocks, found)))
        head = element("head", Html('<meta charset="utf-8">'), element("title", made.bench.spec.heading))
        written = f"<!DOCTYPE html>\n{element('html', head, body, attributes={'lang': 'en'})}\n"
    else:
        written = {".tex": latex, ".md": markdown, ".txt": text}[path.suffix](found)
    with written_whole(path) as part:
        part.write_bytes(visible(written).encode())


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _number(value: float, digits: int = 2) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _percent(value: float, half: float) -> str:
    return f"{value:.2f} %" if math.isnan(half) else f"{value:.2f} +- {half:.2f} %"
