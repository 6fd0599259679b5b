"""Generate docs/reference/metrics.md from the declarations of the metrics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from rths_cli.quantities import KINDS, Quantity, declared
from rths_cli.quantities.metrics import CAUSES, GUARDED, LATENCIES, MEASURED, PREDICTED, REACH
from rths_cli.quantities.metrics import GROUPS as METRIC_GROUPS

HEAD = """# Every metric and its definition

This page is made from `rths_cli/quantities/metrics.py`; [how a test is judged](../background/metrics.md) has formulas
and sources. A metric stands in the result file under `/metrics/` with `/` for `.`, in `rths report --format json`, in
CSV, and in a case's `accept` under the path given here; one of several storeys as `exp_rths.rms_error_m_s2[3]`, counted
from 1.

Behind the path stand the suffixes that it may have, its unit (none: a pure number) and what it has one value for. A
unit with a star is converted to [prototype scale](../background/similitude.md); a metric without one belongs to the rig
or the loop, or is a ratio, and stays as it is. Where one is better when smaller, larger or near a value, the line says
so; only those that are better when smaller are judged against a baseline.

A metric may carry [an interval](../decisions/result_layout.md): `intervals` in JSON and in Python, three more columns
in CSV, and `[low, high]` behind the number in texts.

One value per tangent is one at rest, then one at each tangent of the laws or end of the specimen's range, an
indication. The identified building has the declared computed storeys below the specimen as identified, or as found in
the run.

Suffixes: {kinds}. Without one: measured, in the test band.

Words in capitals stand for one of several names:

{families}
"""
SHORTER = {  # what the head tells once
    ", at rest and at each tangent of the laws or end of the specimen's range, an indication": "",
    "SIM of the declared computed storeys below the specimen as identified, or as found in the run": (
        "SIM of the identified building"
    ),
}
RUNS = {"shake_table": "shake-table test", "exp_rths": "EXP-RTHS"}
LOOPS = {"check": "hybrid loop broken at the command", "feedback": "feedback on the table"}
RESPONSES = {"sim_delay": "SIM-DELAY", "exp_rths": "EXP-RTHS", "sim": "SIM"}
BOTH = [cause for cause in CAUSES if cause not in PREDICTED]
GROUPS = ["RUN", "RESPONSE", "LOOP", *METRIC_GROUPS]
PERCENT = ", in percent of "
UNSURE = ("its standard uncertainty: ", "standard uncertainty of the ")


def reference_page() -> str:
    """Return the page as Markdown: a list per group of metrics, a line per family of them."""
    kinds = "; ".join(f"`{suffix}` {words}" for suffix, words in KINDS.items())
    parts = [HEAD.format(kinds=kinds, families="\n".join(_told_families())).rstrip()]
    group, found = "", _families()
    beside = _told_beside(found)
    for one in sorted((one for one in found if one.path not in beside), key=lambda one: GROUPS.index(one.group)):
        if one.group != group:
            group = one.group
            parts += ["", f"## {group}", ""]
        parts.append("; ".join([_line(one), *(words for base, words in beside.values() if base == one.path)]))
    page = "\n".join(parts) + "\n"
    for long, short in SHORTER.items():
        page = page.replace(long, short)
    return page


def _told_families() -> Iterator[str]:
    yield f"- `RUN`: {_names(RUNS)}"
    yield f"- `RESPONSE`: {_names(RESPONSES)}"
    yield f"- `LOOP`: {_names(LOOPS)}"
    yield f"- `CAUSE` of check and budget ([meanings](../background/error_budget.md#causes)): {_listed(BOTH)}"
    yield f"- `CAUSE` of check alone: {_listed(PREDICTED)}"
    yield f"- `CAUSE` of budget alone: {_listed(['model', *MEASURED])}"
    yield f"- `PEAK`: {_names({name: text for name, (_, text) in REACH.items()})}"
    yield f"- `GUARDED`: {_names({name: text for name, (_, text) in GUARDED.items()})}"
    yield f"- `ITEM`: {_names(LATENCIES)}"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _names(names: Mapping[str, str]) -> str:
    return ", ".join(f"`{name}` ({text})" for name, text in names.items())


def _families() -> list[Quantity]:
    """Return every metric; those that differ in one name and its meaning alone as one."""
    members: dict[Quantity, list[Quantity]] = {}
    for one in declared():
        members.setdefault(_general(one), []).append(one)
    return [general if len(like) > 1 else like[0] for general, like in members.items()]


def _told_beside(found: list[Quantity]) -> dict[str, tuple[str, str]]:
    """Return the metrics that are the standard uncertainty of another one, or the same in percent of something.

    By path: the path of the other one, and what its line adds.
    """
    beside: dict[str, tuple[str, str]] = {}
    for base in found:
        for one in found:
            if any(one.text == f"{prefix}{base.text}" for prefix in UNSURE):
                beside[one.path] = base.path, f"standard uncertainty: `{one.path}`"
            elif one.group == base.group and one.kinds == base.kinds and one.text.startswith(f"{base.text}{PERCENT}"):
                beside[one.path] = base.path, f"{one.text.removeprefix(f'{base.text}, ')}: `{one.path}`"
    return beside


def _general(one: Quantity) -> Quantity:
    """Return a metric with words in capitals for the names that it shares with others."""
    causes = {**CAUSES, **(PREDICTED if one.group == "check" else MEASURED)}
    families: tuple[tuple[str, Mapping[str, str]], ...] = (
        ("CAUSE", causes),
        ("GUARDED", {name: text for name, (_, text) in GUARDED.items()}),
        ("PEAK", {name: text for name, (_, text) in REACH.items()}),
        ("ITEM", LATENCIES),
    )
    for word, names in families:
        for name, text in names.items():
            if f"_{name}" in one.path.replace(".", "._") and text in one.text:
                path = f"{one.group}.{one.path.partition('.')[2].replace(name, word, 1)}"
                units = "" if word in ("PEAK", "GUARDED") else one.units
                return _of_any_run(replace(one, path=path, text=one.text.replace(text, word), units=units))
    return _of_any_run(one)


def _of_any_run(one: Quantity) -> Quantity:
    group, _, leaf = one.path.partition(".")
    for run, label in RUNS.items():
        if one.path.startswith(f"check.{run}_") and "GUARDED" in leaf:
            return replace(one, path=one.path.replace(run, "RUN"), text=one.text.replace(label, "RUN"))
    if group in RUNS and not any(label in one.text for label in ("SIM", *RUNS.values())):
        return replace(one, path=f"RUN.{leaf}")
    if group in LOOPS and LOOPS[group] in one.text:
        return replace(one, path=f"LOOP.{leaf}", text=one.text.replace(LOOPS[group], "LOOP"))
    if group in RESPONSES and RESPONSES[group] in one.text:
        return replace(one, path=f"RESPONSE.{leaf}", text=one.text.replace(RESPONSES[group], "RESPONSE"))
    return one


def _line(one: Quantity) -> str:
    kinds = f" ({', '.join(f'`{kind}`' for kind in one.kinds)})" if one.kinds else ""
    star = "*" if one.scales_as not in ("", "1") else ""
    unit = f"{one.units}{star}" if one.units != "1" else f"as {one.scales_as}{star}" if star else ""
    marks = "".join(f", {mark}" for mark in (unit, f"per {one.over}" if one.over else "") if mark)
    better = "" if one.better == "none" else f"; {one.better}"
    return f"- `{one.path}`{kinds}{marks}: {one.text}{better}"
