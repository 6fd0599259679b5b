"""`--format junit`: JUnit XML for continuous integration, one test suite per run, one test per accept limit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from rths_cli.analysis.grade import Judged
from rths_cli.files.result_reader import COMPLETE, Result
from rths_cli.report.answer import verdict
from rths_cli.report.group_comparison import WORSE, CaseChanges, told
from rths_cli.report.input_files import Unread
from rths_cli.report.results_by_case import judge, status

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
INSTANT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d")
PROPERTIES = ("method", "rig", "rig_kind", "seed", "rths_version", "git_commit", "status", "status_reason")


@dataclass(frozen=True)
class Test:
    """One test of a suite."""

    name: str
    # "": passed; "failure": limit not met, metric not computed, or worse than the baseline; "error": the run did not
    # end as planned, or cannot be read
    kind: str = ""
    message: str = ""  # what is wrong


@dataclass(frozen=True)
class Suite:
    """The tests of one run."""

    name: str
    timestamp: str  # of the result; of what has none, now; UTC
    properties: tuple[tuple[str, str], ...]  # (name, value) of the result's attributes
    tests: tuple[Test, ...]
    seconds: float = 0.0  # that the run took; 0: not known


def junit(
    results: Sequence[Result],
    unread: Sequence[Unread] = (),
    failed: Sequence[tuple[str, str, float]] = (),
    changes: Sequence[CaseChanges] = (),
    seconds: Mapping[Path, float] | None = None,
) -> str:
    """Return JUnit XML of results, of files that cannot be read, of runs without a file (name, reason, seconds), and of
    judged `changes` against a baseline. `seconds`: what the run of each result took, where that is known.

    Raises InputError if the limits stored in a result cannot be read.
    """
    suites = [_suite(result, (seconds or {}).get(result.path, 0.0)) for result in results]
    suites += [_broken(one.path.stem, one.sentence) for one in unread]
    suites += [_broken(name, reason, "run is complete", took) for name, reason, took in failed]
    suites += [Suite(f"baseline.{one.case}", _now(), (), (_compared(one),)) for one in changes]
    root = Element("testsuites")
    for number, suite in enumerate(suites):
        _add(root, suite, number)
    indent(root)
    return HEAD + tostring(root, encoding="unicode") + "\n"


def _suite(result: Result, seconds: float) -> Suite:
    a = result.attributes
    known = [(key, str(a[key])) for key in PROPERTIES if a.get(key) not in (None, "")]
    known.append(("verdict", verdict(result)))
    stamp = str(a.get("created_utc", "")).removesuffix("Z")
    stamp = stamp if INSTANT.fullmatch(stamp) else _now()
    return Suite(_name(result), stamp, (("file", str(result.path)), *known), tuple(_tests(result)), seconds)


def _name(result: Result) -> str:
    a = result.attributes
    return f"{a.get('case_name') or result.path.stem}.{a.get('method') or '-'}"


def _tests(result: Result) -> Iterator[Test]:
    """Yield a test for each limit, an error if the run did not end as planned; without limits, one for the run."""
    end = status(result)
    reason = str(result.attributes.get("status_reason") or "no reason stored")
    whole, limits = end == COMPLETE, judge(result)
    if not limits:
        yield Test("run is complete") if whole else Test("run is complete", "error", f"{end}: {reason}")
    for one in limits:
        yield _test(one) if whole else Test(_limit(one), "error", f"{end}: {reason}")


def _test(one: Judged) -> Test:
    if one.met:
        return Test(_limit(one))
    if one.value is None:
        return Test(_limit(one), "failure", f"{one.path} was not computed, its accept limit is {one.limit:g}")
    return Test(_limit(one), "failure", f"{one.path} = {one.value:.6g} is beyond its accept limit {one.limit:g}")


def _compared(one: CaseChanges) -> Test:
    """Return the test whether a case is worse than in the baseline."""
    worse = [told(change) for change in one.changes if change.verdict == WORSE]
    reasons = [*([one.state] if one.failed else []), *worse]
    return Test("no worse than the baseline", "failure" if reasons else "", "; ".join(reasons))


def _limit(one: Judged) -> str:
    return f"|{one.path}| <= {one.limit:g}"


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S}"


def _broken(name: str, sentence: str, test: str = "result can be read", seconds: float = 0.0) -> Suite:
    return Suite(name, _now(), (), (Test(test, "error", sentence),), seconds)


def _add(root: Element, suite: Suite, number: int) -> None:
    """Add a suite with its tests to the document."""
    kinds = [test.kind for test in suite.tests]
    counts: dict[str, object] = {"tests": len(kinds)}
    counts |= {"failures": kinds.count("failure"), "errors": kinds.count("error"), "time": f"{suite.seconds:.4g}"}
    head = {"package": "rths", "id": number, "hostname": "localhost", "timestamp": suite.timestamp, **counts}
    node = _element(root, "testsuite", name=suite.name, **head)
    properties = SubElement(node, "properties")
    for name, value in suite.properties:
        _element(properties, "property", name=name, value=value)
    for test in suite.tests:
        share = f"{suite.seconds / len(suite.tests):.4g}"  # readers add the times of tests up
        case = _element(node, "testcase", name=test.name, classname=f"rths.{suite.name}", time=share)
        if test.kind:
            _element(case, test.kind, message=test.message, type=test.kind).text = _clean(test.message)
    SubElement(node, "system-out")
    SubElement(node, "system-err")


def _element(parent: Element, tag: str, **attributes: object) -> Element:
    return SubElement(parent, tag, {name: _clean(str(value)) for name, value in attributes.items()})


def _clean(text: str) -> str:
    """Return a text without the characters that XML does not permit."""
    return NOT_IN_XML.sub("?", text)
