"""The output of each command in tests/golden: words as they are, computed numbers as `#`, which makes of their layout
lines and order alone.

A computed number is another one on another processor, in its third digit for an error of a test; a case's own figures
and those of a building or a record are compared in full.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from golden import golden
from test_recover import killed
from wrong_inputs import COMMON, Wrong, printed

EXACT = ("new", "records", "structure", "list", "calibrate")
COMMANDS = {
    "run": "run pulse --quiet",
    "run_answer": "run pulse",
    "check": "check pulse",
    "identify": "identify pulse --no-figure --output m.h5",
    "report": "report results/pulse.h5",
    "sweep": "sweep pulse --vary scaling=0.5,1 --seeds 2",
    "export": "export results/pulse.h5 --to csv --group sim --quiet",
    "records": "records pulse.csv",
    "structure": "structure tower",
    "new": "new my_case.yaml",
    "list": "list structures",
    "doctor": "doctor --rate 100 --seconds 0.2",
    "calibrate": "calibrate pulse --set table=aps400_laboratory --sensitivity table=1012mV/g+-0.2% "
    "--mass floor_3=5.01+-0.005 --by Z.Sun --output lab.yaml",
    "serve": "serve --seconds 0.2 --port 0",
    "recover": "recover results/killed.exp_rths.rthslog",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a case of one's own, its result and the log of a run that was killed."""
    folder = tmp_path_factory.mktemp("lab").resolve()
    (folder / "results").mkdir()
    killed(folder / "results", "killed")
    printed(Wrong("", "run pulse --quiet"), folder)
    return folder


NUMBER = r"(?<![\w.])[-+]?(?:\d+\.\d+|\d{2,}|\d(?=e))(?:e[-+]?\d+)?(?!\w)"
AGREEING = {  # what has the same two digits on every processor
    "run_answer": r"(?m)^\d(?: roof| interface)? +[\d.]+ +[\d.]+ +[\d.]+",
    "check": r"(?m)^  \d +[\d.]+",
}
LABELS_ALONE = ("doctor", "identify")
JOINED = ("check", "sweep")  # sentences alone, that break where their numbers' widths make them break


def masked(name: str, text: str) -> str:
    """Return what is printed without what differs between machines: times, paths of the user's, computed numbers."""
    text = re.sub(r"first run of this version .*\n|compiling real-time code .*\n", "", text)
    text = re.sub(r"(?m)^.* \(after \d+ s\)\n", "", text)  # progress, on a slow machine
    text = re.sub(r"(model +)(cache|identified).*", r"\1(where it is from)", text)
    text = re.sub(r"\d{4}-\d\d-\d\d[ T][\d:]+(\.\d+)?( UTC|Z)?", "(time)", text)
    text = re.sub(r"\d{4}-\d\d-\d\d", "(day)", text)
    text = re.sub(r"(key file |RTHS_KEY_FILE=)\S+?(?=;|$)", r"\1(key)", text, flags=re.MULTILINE)
    text = re.sub(r"127\.0\.0\.1:\d+", "localhost:(port)", text)
    if name in EXACT:
        return text
    if name in LABELS_ALONE:  # further lines of a text, and advice that another machine does not need, are left out
        text = re.sub(r"(?m)^ {22}.*\n|^to do better .*\n", "", text)
        text = re.sub(r"(?m)^(.{24})\S.*$", _label_alone, text)
        text = re.sub(r"(?m)^( +\S+) .*$", r"\1 ...", text) if name == "doctor" else text  # rows differ by machine
    if name == "report":
        text = re.sub(r"(?m)^ {20,}\S.*\n", "", re.sub(r"(?m)^(  \w+\.\w+) .*$", r"\1", text))
    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(re.sub(r"[\d.]+$| [\d.]+", _two_digits, found[0]))
        return f"<{len(kept) - 1}>"

    text = re.sub(AGREEING.get(name, "(?!)"), keep, text)
    text = re.sub(rf"(?<= )({NUMBER}|-)(?=\s|\||$)", "#", text)
    text = re.sub(r"<(\d)>", lambda m: kept[int(m[1])], re.sub(NUMBER, "#", text))
    text = re.sub(r"-{5,}", "-----", re.sub(r" {2,}", "  ", text))  # columns are as wide as their numbers
    return re.sub(r"(?<= )\d(?= %)", "#", re.sub(r"\n {2}(?=\S)", " ", text)) if name in JOINED else text


def _label_alone(found: re.Match[str]) -> str:
    """Return a label without its text, and a row of a table as it is."""
    return found[0] if "  " in found[1].strip() else f"{found[1]}..."


def _two_digits(found: re.Match[str]) -> str:
    return f"{float(found[0]):.2g}".rjust(len(found[0]))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_output_is_that_in_the_golden_file(name: str, lab: Path) -> None:
    assert set(COMMON) <= {path.name for path in lab.iterdir()}
    _, text = printed(Wrong("", COMMANDS[name]), lab)
    shown = masked(name, text)
    assert shown == golden(f"command_{name}.txt", shown)
