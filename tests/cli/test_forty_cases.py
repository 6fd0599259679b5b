"""A nightly batch: forty cases, three of them broken in different ways, every one accounted for."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from test_batch import rths

CASE = "structure: three_storey\ndamping: low\nrecord: pulse.csv\nscaling: 0.3\ncontroller: FF\nruns: [sim]\n"
BROKEN = {
    "c07": CASE.replace("damping: low", "damping: [low"),  # no YAML
    "c19": CASE.replace("scaling: 0.3", "scaling: -0.3"),  # a value out of its limits
    "c33": CASE.replace("pulse.csv", "missing.csv"),  # a file that is not there
}


@pytest.mark.campaign
def test_thirty_seven_of_forty_run_and_the_three_others_are_entries_with_their_reasons(tmp_path: Path) -> None:
    pulse = (0.0, 0.1, 0.5, 1.0, 0.5, -0.5, -1.0, -0.5, -0.1, 0.0, *[0.0] * 290)
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases/pulse.csv").write_text("# dt: 0.02 s\n# units: m/s^2\n" + "".join(f"{a}\n" for a in pulse))
    names = [f"c{k:02d}" for k in range(40)]
    for name in names:
        (tmp_path / f"cases/{name}.yaml").write_text(BROKEN.get(name, CASE))
    done = rths("run", "cases", "--keep-going", "--junit", "batch.xml", "--json", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    good = [name for name in names if name not in BROKEN]
    assert sorted(path.stem for path in (tmp_path / "results").glob("*.h5")) == good
    told = {case["name"]: case for case in json.loads(done.stdout)["cases"]}
    assert sorted(told) == names and {name for name in told if told[name]["status"] != "complete"} == set(BROKEN)
    entries = ElementTree.parse(tmp_path / "batch.xml").getroot().findall(".//testcase")
    of_case = {name: [one for one in entries if name in f"{one.get('classname')} {one.get('name')}"] for name in names}
    assert all(of_case.values())
    for name, found in of_case.items():
        assert all(float(one.get("time", "nan")) >= 0.0 for one in found), name
        failed = any(one.find("failure") is not None or one.find("error") is not None for one in found)
        assert failed == (name in BROKEN), name
    for name, word in {"c07": "c07.yaml", "c19": "scaling", "c33": "missing.csv"}.items():
        text = "".join("".join(one.itertext()) + str([child.attrib for child in one]) for one in of_case[name])
        assert word in text, text
