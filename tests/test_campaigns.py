"""Every script of benchmarks/ runs: the parts of the benchmark and the campaigns in their shortest form; what has none
is imported, so that what it takes from package and tests is still there. Each runs in a process of its own, as a person
starts it."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from campaigns import step_in_c
from forked_programs import Program

SCRIPTS = Path(__file__).parents[1] / "benchmarks"
LONGEST_S = 600.0  # of a process, on a machine that does much else meanwhile
PARTS = ("step", "rivals", "sim", "commands", "growth", "sweep", "channels", "laws")
SHORT = {  # words behind the script, and what it prints when it came to its end
    "critical_delay.py": (("0", "1"), "of 1 buildings"),
    "faults.py": (("1", "--only", "runs", "--kind", "stuck"), r"\d+ s$"),
    "fault_reasons.py": (("1", "--kind", "stuck"), "^all "),
    "freezes.py": (("--instants", "1", "--rates", "500", "--ms", "5", "--targets", "holds"), "500 Hz holds"),
    "nonlinear_cases.py": (("bilinear",), "^bilinear .*el_centro"),
    "preflight.py": (("3000", "1"), "1 tests drawn"),
    "processors.py": (("--only", "generic", "--version"), "passed on each"),
    "random_cases.py": (("--case", "2001"), "^structure:|^# --set scaling"),
    "stated_uncertainties.py": (("lines.jsonl", "--kind", "virtual", "--count", "1"), "^virtual"),
    "step_mutants.py": (
        ("--only", "c", "--count", "2", "--case", "el_centro_low_ff_fb"),
        "2 of 2 missing terms noticed",
    ),
    "udp_fuzz.py": (("20",), "runner"),
    "unit_slips.py": (("--bases", "none", "--right", "5"), "^right files doubted: 0 of 5"),  # slips: tests/experiment
}
IMPORTED = {  # why a script is imported here and not run
    "accuracy.py": "its smallest section plays twenty runs",
    "budget_causes.py": "tests/experiment/test_error_attribution.py plays its causes",
    "check_laws.py": "judges by what preflight.py runs here",
    "check_specimens.py": "designs and plays one test in eight ways",
    "diagnosis.py": "tests/identification/test_storeys.py judges its chains",
    "disturbed_runs.py": "plays whole laboratories for minutes; tests/loop/test_freezes.py plays gaps",
    "drifting_sensors.py": "its runs are whole records; tests of drift play them",
    "few_bits.py": "tests/experiment/test_few_bits.py plays its first laboratory",
    "full_disk.py": "mounts a file system, which needs root",
    "hostile_options.py": "tests/cli/test_hostile_options.py runs a sample",
    "identification.py": "identifies four times by long records",
    "imperfections.py": "plays four cases for each imperfection",
    "integration_schemes.py": "solves one building by ten schemes at many steps",
    "jitter.py": "measures this machine in real time",
    "judged_runs.py": "tests/experiment/test_table_test_check.py plays some of its tests",
    "kill.py": "tests/experiment/test_kill.py runs it",
    "laboratories.py": "its smallest size identifies, checks and plays a laboratory; tests/experiment does",
    "library_change.py": "compares two states of the source tree",
    "loopback.py": "plays a whole record in real time",
    "mutated_files.py": "tests/files/test_mutated_files.py reads a sample",
    "opensees_laws.py": "needs openseespy",
    "page.py": "needs a browser",
    "random_tables.py": "thirty identifications",
    "random_tests.py": "has no main: preflight.py draws by it",
    "range_ends.py": "tests/experiment/test_range_ends.py runs a sample",
    "report.py": "needs results",
    "sensor_faults_at_peak.py": "tests/experiment/test_planned_motion.py plays its faults",
    "stalls.py": "plays ten laboratories; tests/loop/test_run_stalls.py plays one",
    "stuck_floors.py": "plays random tests many times; tests/loop plays stuck floors",
    "studies.py": "estimates indices by many samples",
    "study_interruptions.py": "tests/studies/test_interruptions.py runs it",
    "study_workers.py": "measures throughput of this machine",
    "try_wheel.py": "needs a wheel and an index of packages",
    "udp_fault_reasons.py": "tests/loop/test_own_target.py plays its kinds in counted time",
    "udp_replay.py": "tests/rigs/test_udp_replay.py sends a sample",
    "unchanged.py": "compares two states of the source tree",
    "versions.py": "makes environments, which needs an index of packages",
}


def run(script: str, words: tuple[str, ...], folder: Path, name: str = "__main__") -> str:
    """Run a script in a folder; return what it printed. `name`: another than `__main__` only imports it."""
    path = str(SCRIPTS / script)
    code = f"import os, sys, runpy; os.chdir({str(folder)!r}); sys.argv = {[path, *words]!r}\n"
    code += "from pathlib import Path; sys.path[0] = str(Path(sys.argv[0]).parent)\n"
    program = Program(code + f"try:\n    runpy.run_path({path!r}, run_name={name!r})\n" + ENDING, dict(os.environ))
    try:
        out, errors = program.communicate(timeout=LONGEST_S)
    finally:
        program.kill()
    assert program.returncode == 0, f"{out[-2000:]}\n{errors[-4000:]}"
    return out


ENDING = "except SystemExit as ended:\n    assert not ended.code, ended.code\n"


def test_every_script_is_here() -> None:
    scripts = {path.name for path in SCRIPTS.glob("*.py")}
    assert scripts == {*SHORT, *IMPORTED, "run.py"} and not set(SHORT) & set(IMPORTED)


@pytest.mark.parametrize("script", SHORT)
def test_a_campaign_runs_in_its_short_form(script: str, tmp_path: Path) -> None:
    if script == "step_mutants.py" and step_in_c.compiler() is None:
        pytest.skip("no C compiler here")
    words, printed = SHORT[script]
    assert re.search(printed, run(script, words, tmp_path), re.MULTILINE)


@pytest.mark.parametrize("script", IMPORTED)
def test_a_campaign_that_is_not_run_is_imported(script: str, tmp_path: Path) -> None:
    """What it takes from the package and from the tests is still there."""
    run(script, (), tmp_path, name="imported")


@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_the_benchmark_runs_in_its_short_form(part: str, tmp_path: Path) -> None:
    table = run("run.py", ("--short", part), tmp_path)
    assert re.search(r"^what +figure +demand", table, re.MULTILINE)
    same = [line for line in table.splitlines() if line.startswith("EXP-RTHS step less C")]
    assert all("holds" in line for line in same) and (bool(same) == (part == "step") or not step_in_c.compiler())
