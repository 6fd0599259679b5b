"""JUnit XML by the schema that its readers share, one test per limit, judged as the run itself judges."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from made_up_files import FIGURES, write

from rths_cli.errors import InputError
from rths_cli.experiment.run_case import acceptance
from rths_cli.files.result_reader import Result, read_result
from rths_cli.report.formats.junit import junit
from rths_cli.report.input_files import Unread

SUITE = {"name", "package", "id", "hostname", "timestamp", "tests", "failures", "errors", "time"}
LIMITS = '{"exp_rths.rms_error_m_s2[3]": 0.06, "exp_rths.rms_error_m_s2": 0.025, "exp_rths.fei_delay_s": 0.0002}'


def checked(text: str) -> ET.Element:
    """Return the root of JUnit XML that fits the schema of Ant's and Jenkins' JUnit reports; check every element."""
    root = ET.fromstring(text)
    assert root.tag == "testsuites" and root.attrib == {}  # Ant's schema has none there
    for suite in root:
        assert suite.tag == "testsuite" and set(suite.attrib) == SUITE
        assert [child.tag for child in suite if child.tag != "testcase"] == ["properties", "system-out", "system-err"]
        assert suite[0].tag == "properties" and suite[-2].tag == "system-out"
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", suite.attrib["timestamp"])
        assert suite.attrib["timestamp"] > "2020"  # also of what has no result
        cases = suite.findall("testcase")
        assert cases and all(set(case.attrib) == {"name", "classname", "time"} for case in cases)
        for found in (element for case in cases for element in case):
            assert found.tag in ("failure", "error") and set(found.attrib) == {"message", "type"}
        for kind in ("failure", "error"):
            assert int(suite.attrib[f"{kind}s"]) == sum(case.find(kind) is not None for case in cases)
        assert int(suite.attrib["tests"]) == len(cases)
    assert [suite.attrib["id"] for suite in root] == [str(number) for number in range(len(root))]
    return root


def ends(root: ET.Element) -> list[str]:
    """Return how each test ended, in order."""
    return [case[0].tag if len(case) else "passed" for case in root.iter("testcase")]


def made(path: Path, **about) -> Result:
    return read_result(write(path, **about))


def test_one_test_per_limit_with_value_and_limit(tmp_path: Path) -> None:
    root = checked(junit([made(tmp_path / "a.h5", accept=LIMITS)]))
    assert ends(root) == ["passed", "failure", "failure"]
    messages = [case[0].attrib["message"] for case in root.iter("testcase") if len(case)]
    assert messages == [
        "exp_rths.rms_error_m_s2 = 0.03 is beyond its accept limit 0.025",
        "exp_rths.fei_delay_s = -0.0003 is beyond its accept limit 0.0002",
    ]


@pytest.mark.parametrize("limit", ["0.0299", "0.03", "0.031"])
@pytest.mark.parametrize("path", ["exp_rths.rms_error_m_s2[3]", "exp_rths.rms_error_m_s2", "exp_rths.fei_delay_s"])
def test_a_limit_is_judged_as_the_run_judges_it(tmp_path: Path, path: str, limit: str) -> None:
    values = {name: value for name, (value, unit) in FIGURES.items()}
    by_run = acceptance({path: float(limit)}, values)
    (end,) = ends(checked(junit([made(tmp_path / "a.h5", accept=f'{{"{path}": {limit}}}')])))
    assert (end == "failure") == (by_run.exit_code == 1)


@pytest.mark.parametrize("path", ["exp_rths.nothing", "exp_rths.rms_error_m_s2[4]"])
def test_a_figure_that_is_not_there_fails_its_limit(tmp_path: Path, path: str) -> None:
    root = checked(junit([made(tmp_path / "a.h5", accept=f'{{"{path}": 1.0}}')]))
    assert ends(root) == ["failure"] and "was not computed" in root[0][1][0].attrib["message"]


def test_a_run_that_did_not_finish_is_an_error_and_one_without_limits_a_test(tmp_path: Path) -> None:
    aborted = made(tmp_path / "b.h5", status="aborted", reason='too <far> & "wide"\x07', accept='{"exp_rths.j2": 1}')
    refused = made(tmp_path / "c.h5", status="refused", reason="unsafe")
    unread = [Unread(Path("x/d.h5"), "x/d.h5: is truncated.")]
    root = checked(junit([made(tmp_path / "a.h5"), aborted, refused], unread, [("e", "the link failed", 12.5)]))
    assert ends(root) == ["passed", "error", "error", "error", "error"]
    messages = [case[0].attrib["message"] for case in root.iter("testcase") if len(case)]
    assert messages == ['aborted: too <far> & "wide"?', "refused: unsafe", "x/d.h5: is truncated.", "the link failed"]
    assert [suite.attrib["name"] for suite in root] == ["demo.best", "demo.best", "demo.best", "d", "e"]
    assert root[0].attrib["timestamp"] == "2026-01-02T03:04:05"
    assert [float(suite.attrib["time"]) for suite in root] == [0.0, 0.0, 0.0, 0.0, 12.5]


def test_limits_that_cannot_be_read_are_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.h5: the accept limits stored in it cannot be read"):
        junit([made(tmp_path / "a.h5", accept="[1, 2]")])


def test_the_same_results_give_the_same_bytes(tmp_path: Path) -> None:
    results = [made(tmp_path / "a.h5", accept=LIMITS)]
    assert junit(results) == junit(results)
