"""What commands import before they answer: the imports of what they do not need are most of their start-up."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from docs_running import shortened
from portfolio import parametrize_first

HEAVY = ("numpy", "scipy", "numba", "llvmlite", "pydantic", "h5py", "matplotlib", "rich", "yaml", "control")
NUMERICAL = ("scipy", "numba", "llvmlite", "matplotlib", "rich", "control", "yaml", "pydantic")
TREE = Path(__file__).parents[2]


def imported(code: str, *words: str, cwd: Path | None = None) -> set[str]:
    """Return the modules that a process holds after it ran `code`, and then the command of `words`."""
    text = (
        f"import sys; sys.argv = {['rths', *words]!r}\n{code}\n"
        + ("import rths_cli.cli as c\ntry: c.main()\nexcept SystemExit: pass\n" if words else "")
        + "print(*sys.modules, file=sys.stderr)"
    )
    path = os.pathsep.join(filter(None, [str(TREE), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, cwd=cwd, env=environment, timeout=60, check=True
    )
    return set(done.stderr.split())


def heavy(modules: set[str], names: tuple[str, ...]) -> list[str]:
    return [name for name in names if name in modules]


def test_help_and_bad_usage_import_nothing_heavy() -> None:
    """One process asks for all of them: what any of them imports stays imported."""
    asked = [["--help"], ["run", "--help"], ["--version"], ["run", "--frobnicate"]]
    code = f"""
import rths_cli.cli as c
for words in {asked!r}:
    sys.argv = ["rths", *words]
    try: c.main()
    except SystemExit: continue
    raise AssertionError(words)
"""
    modules = imported(code)
    assert "rths_cli.cli" in modules and not heavy(modules, HEAVY)


@pytest.mark.campaign
@pytest.mark.parametrize("words", [("run", "no_such_case"), ("check", "el_centro_low_ff", "--set", "scaling=-1")])
def test_faults_of_cases_are_told_without_numerical_libraries(words: tuple[str, ...]) -> None:
    modules = imported("", *words)
    assert "pydantic" in modules and not heavy(modules, ("numpy", "scipy", "numba", "h5py", "matplotlib", "rich"))


def test_a_case_is_read_without_numerical_libraries() -> None:
    modules = imported("from rths_cli.case.load import load_cases; load_cases(['el_centro_low_ff_fb'])")
    assert "pydantic" in modules and not heavy(modules, ("numpy", "scipy", "numba", "h5py", "matplotlib", "rich"))


@pytest.mark.campaign
def test_a_record_is_prepared_without_numba() -> None:
    code = """
import numpy as np
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.experiment.ground_motion import prepare, response_spectrum
made = Accelerogram(0.01, np.sin(np.arange(600.0)), "made", "made", "m/s^2", "one column", "")
response_spectrum(prepare(made, 1.0, 200.0), [1.0])
"""
    modules = imported(code)
    assert "rths_cli.numerics.lti" in modules and not heavy(modules, ("numba", "matplotlib", "rich"))


@pytest.mark.campaign
def test_a_building_with_stated_dashpots_is_made_without_scipy() -> None:
    code = """
from rths_cli.case.load import load_cases
from rths_cli.structure import build
case = load_cases(["el_centro_low_ff_fb"], ("damping={dashpots_n_s_per_m: [50]}",))[0]
build(case.structure, case.damping)
"""
    modules = imported(code)
    assert "rths_cli.structure.building" in modules and not heavy(modules, ("scipy", "numba", "matplotlib"))


def test_results_are_written_and_reported_with_numpy_and_h5py_alone(tmp_path: Path) -> None:
    code = """
from pathlib import Path
from rths_cli.files.result_reader import ResultWriter
with ResultWriter(Path("a.h5"), {"rig_kind": "virtual", "case_name": "a"}) as writer:
    writer.metrics({"exp_rths.rms_error_m_s2": [0.1, 0.2]})
    writer.finish("complete")
"""
    modules = imported(code, "report", "a.h5", cwd=tmp_path)
    assert {"h5py", "rths_cli.report.result_tables"} <= modules
    assert set(heavy(modules, NUMERICAL)) <= {"yaml"}  # the limits of the grade stand in the case


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted where Linux lists them")
def test_linear_algebra_runs_in_one_thread_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    code = """
import sys; sys.argv = ['rths', '--help']
import rths_cli.cli as c
try: c.main()
except SystemExit: pass
import os, numpy as np
a = np.ones((600, 600)); a @ a
print(len(os.listdir('/proc/self/task')), os.environ['OPENBLAS_NUM_THREADS'], file=sys.stderr)
"""
    for stated, expected in (("", "1 1"), ("3", None)):
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        if stated:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", stated)
        environment = {**os.environ, "PYTHONPATH": str(TREE)}
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
        assert done.stderr.split()[1] == (stated or "1")
        assert expected is None or done.stderr.strip() == expected


@pytest.mark.campaign
def test_python_does_not_search_the_libraries_of_a_command_for_unreachable_objects() -> None:
    """It costs a tenth of a run: while they are imported, and once more at the end of the process."""
    code = """
import sys; sys.argv = ['rths', '--help']
import gc, rths_cli.cli as c
try: c.main()
except SystemExit: pass
left_out, before = gc.get_freeze_count(), gc.get_stats()
import scipy.signal
assert left_out > 1000, left_out
assert gc.get_stats() == before, gc.get_stats()
"""
    assert "scipy.signal" in imported(code)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the default case has run once, on 6 s: its model is kept, its step compiled."""
    folder = tmp_path_factory.mktemp("warm")
    shortened(TREE / "records" / "el_centro.csv", folder / "short.csv", 300)
    imported("", "run", "el_centro_low_ff_fb", "--set", "record.file=short.csv", "--quiet", cwd=folder)
    return folder


@pytest.mark.campaign
@parametrize_first(1, "words", [("check", "el_centro_low_ff_fb"), ("run", "el_centro_low_ff_fb", "--quiet")])
def test_a_second_run_imports_nothing_that_it_does_not_use(words: tuple[str, ...], warm: Path) -> None:
    modules = imported("", *words, "--set", "session_record=never", cwd=warm)
    unused = ("matplotlib", "rich", "control", "pandas", "asyncio")
    unused += (
        "rths_cli.identification.identify",
        "rths_cli.files.foreign_models",
        "rths_cli.experiment.identify_on_rig",
    )
    assert "rths_cli.experiment.model_choice" in modules and not heavy(modules, unused)


@pytest.mark.campaign
@parametrize_first(
    1, "words", [("report", "results", "--junit", "limits.xml"), ("export", "results", "--to", "csv"), ("records",)]
)
def test_what_exists_is_shown_without_numba(words: tuple[str, ...], warm: Path) -> None:
    modules = imported("", *words, cwd=warm)
    shown = {"report": "rths_cli.report.result_tables", "export": "rths_cli.report.export_files"}
    assert shown.get(words[0], "rths_cli.laboratory.listing") in modules
    assert not heavy(modules, ("numba", "llvmlite", "rths_cli.numerics.compiled"))
