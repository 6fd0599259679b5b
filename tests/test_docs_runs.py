"""Every command and snippet of the documentation is run: the pages work as they are written."""

from __future__ import annotations

import re
import shlex
import shutil
from contextlib import chdir
from pathlib import Path

import matplotlib
import pytest
from docs_running import (
    BY_THE_HELP,
    DOCS,
    RUN_ELSEWHERE,
    WITH_SNIPPETS,
    at,
    blocks_of,
    pages,
    run_page,
    run_words,
    shortened,
    stories,
)
from test_docs import commands

from rths_cli.report.figures import write

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
LEFT_OUT = {
    "reference/paper_tables.md": ["benchmarks/versions.py runs the eight cases and compares these tables"],
    "tutorial/first_run.md": ["a line for the shell's own start file"],
    "tutorial/base_isolated_building.md": ["a part of the shipped file, which tests/case checks"],
    "howto/reading_results.md": ["needs MATLAB"],
    "howto/channels.md": ["a part of a rig file", "needs the rig"],
    "howto/recordings.md": ["needs a recording of a whole specimen; tests/cli/test_identify.py makes one"],
    "howto/own_law.md": ["a part of a package's pyproject.toml"],
    "howto/opensees.md": ["needs the package opensees", "waits for OpenSees", "a part of a script"],
    "tutorial/yielding_frame.md": ["needs the package opensees"] * 3,
    "howto/structure_as_matrices.md": ["needs OpenSees", "needs files of SAP2000"],
}
NEEDS_A_RIG = "moves a rig behind UDP, or measures the machine, in real time; tests/rigs and tests/experiment do"
PACKAGE = "needs an installed package; tests/cli/test_plugin.py installs the one that the page shows"
OTHERS_LEFT_OUT = {
    "howto/realtime.md": ("rths", NEEDS_A_RIG),
    "howto/rehearse.md": ("rths", NEEDS_A_RIG),
    "background/imperfections.md": ("imperfections", "a study of the source tree that takes hours"),
    "howto/recovery.md": ("rths recover", "needs the log of a killed process; tests/experiment/test_kill.py makes one"),
    "howto/identify.md": (
        "--data",
        "needs a measured file; tests/files/measured and tests/cli/test_identify.py make some",
    ),
    "howto/cluster.md": ("robustness", "needs a cluster; tests/studies/test_engines.py starts a scheduler and workers"),
    "howto/rig_package.md": ("rths plugin", PACKAGE),
    "reference/udp.md": ("cc", "is compiled and run by tests/rigs/test_udp_target_c.py"),
}
EVENLY_SPACED = re.compile(r"(=[-\d.]+:[-\d.]+):\d+$")  # values of a sweep: from, to, how many
STORIES = stories()
LISTS = [page for page in pages() if page not in STORIES and at(page) not in (*RUN_ELSEWHERE, *BY_THE_HELP)]
EXAMPLES_LEFT_OUT = {
    "doctor": "measures the machine in real time",
    "serve": "runs until it is stopped",
    "bridge": "waits for a client; tests/rigs/test_bridge.py has some",
    "evaluate": "needs a recording; howto/judge_a_recorded_test.md makes one",
    "recover": "needs the log of a killed process",
    "merge": "needs the parts that howto/cluster.md makes",
    "plugin": PACKAGE,
}


@pytest.fixture(autouse=True)
def drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw two figures where all are asked for: tests/report/figures draws the others."""
    matplotlib.use("Agg")
    monkeypatch.setattr(write, "FIGURES", {name: write.FIGURES[name] for name in ("tracking", "errors")})


def test_the_pages_that_are_run_as_written_are_these() -> None:
    """A block that lost its language would take its page out of them."""
    howto = {
        f"howto/{name}.md"
        for name in (
            "benchmark",
            "calibrate",
            "channels",
            "ci",
            "fragility",
            "hardware",
            "judge_a_recorded_test",
            "opensees",
            "read_the_pages",
            "reading_results",
            "recordings",
            "structure_as_matrices",
            "write_a_case",
        )
    }
    own = {f"howto/own_{name}.md" for name in ("controller", "law", "record", "table")}
    background = {f"background/{name}.md" for name in ("similitude", "substructures")}
    names = ("first_run", "yielding_storey", "yielding_frame", "base_isolated_building")
    tutorials = {f"tutorial/{name}.md" for name in names}
    others = {*tutorials, "reference/paper_tables.md"}
    assert {at(page) for page in STORIES} == others | howto | own | background


@pytest.mark.campaign
@pytest.mark.parametrize("page", STORIES, ids=at)
def test_the_page_works_as_it_is_written(page: Path, tmp_path: Path) -> None:
    with chdir(tmp_path):
        assert run_page(page) == LEFT_OUT.get(at(page), [])


def test_the_readme_works_as_it_is_written(tmp_path: Path) -> None:
    with chdir(tmp_path):
        assert run_page(ROOT / "README.md") == ["the tests run in what it installs"]
    assert (tmp_path / "results" / "pulse.h5").exists()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the other pages name: cases on a record of 6 s, folders of results, a sweep."""
    folder = tmp_path_factory.mktemp("pages")
    shortened(ROOT / "records" / "el_centro.csv", folder / "short.csv", 300)
    case = (
        (ROOT / "configs" / f"{CASE}.yaml")
        .read_text(encoding="utf-8")
        .replace("record: el_centro", "record: short.csv")
    )
    for name in ("my_case", "a", "b"):
        (folder / f"{name}.yaml").write_text(case, encoding="utf-8")
    with chdir(folder):
        for method, results in (("best", "results"), ("paper", "paper_run")):
            words = ["run", CASE, "--set", "record.file=short.csv", "--method", method, "--output", results, "--quiet"]
            assert run_words(words)[0] == 0
        for copy in ("best_run", "last_release", "baseline"):
            shutil.copytree("results", copy)
        assert (
            run_words(["sweep", "my_case.yaml", "--vary", "scaling=0.2,0.3", "--output", f"sweeps/{CASE}.h5"])[0] == 0
        )
    return folder


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Path:
    """Return a copy of that folder, for one page."""
    return Path(shutil.copytree(made, tmp_path / "place"))


def quick(words: list[str]) -> list[str]:
    """Return a command on the short record, a sweep with one seed and both ends of its ranges."""
    short = (
        ["--set", "record.file=short.csv"]
        if CASE in words and words[0] in ("run", "check", "sweep", "identify")
        else []
    )
    varied = [word for word in words if word.startswith("record=")]
    ends = [EVENLY_SPACED.sub(r"\1:2", word) if words[0] == "sweep" else word for word in words]
    return [
        *ends,
        *([] if varied else short),
        *(["--seeds", "1"] if words[0] == "sweep" and "--seeds" in words else []),
    ]


def left_out(page: str, words: list[str]) -> bool:
    return page in OTHERS_LEFT_OUT and OTHERS_LEFT_OUT[page][0] in " ".join(words)


def run_here(page: Path) -> list[list[str]]:
    """Return the commands of a page that are run one by one."""
    return [words for words in commands(page) if not left_out(at(page), words)]


@pytest.mark.campaign
@pytest.mark.parametrize("page", [page for page in LISTS if run_here(page)], ids=at)
def test_the_commands_of_other_pages_run(page: Path, place: Path) -> None:
    with chdir(place):
        for words in run_here(page):
            if words[1] == "sweep" and "--part" not in words:
                shutil.rmtree("sweeps", ignore_errors=True)  # a file there holds one sweep
            if words[1] == "merge":
                Path(words[words.index("--output") + 1]).unlink(missing_ok=True)
            code, printed = run_words(quick(words[1:]))
            assert code == 0 or (code == 1 and "refused" in printed and words[1] == "sweep"), (words, printed)


@pytest.mark.campaign
@pytest.mark.parametrize("name", WITH_SNIPPETS)
def test_the_snippets_of_other_pages_run(name: str, place: Path) -> None:
    with chdir(place):
        names: dict[str, object] = {}
        for block in blocks_of((DOCS / name).read_text(encoding="utf-8")):
            if block.kind == "python":
                exec(compile(block.text, f"{name}:{block.line}", "exec"), names)
    assert len(names) > 2


@pytest.mark.campaign
def test_every_example_of_the_help_runs(place: Path, tmp_path: Path) -> None:
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    examples = [shlex.split(block.text.partition(">")[0])[1:] for block in blocks_of(text) if block.kind == "sh"]
    run = [words for words in examples if words[0] not in EXAMPLES_LEFT_OUT]
    assert len(run) == len(examples) - len(EXAMPLES_LEFT_OUT)
    shutil.copy(place / "short.csv", tmp_path)
    with chdir(tmp_path):
        for words in sorted(run, key=lambda words: words[0] in ("report", "export")):
            code, printed = run_words(quick(words))
            assert code == 0, (words, printed)
