"""A program in its own process: every way in which it fails is one sentence with its name, and nothing is left."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from rths_cli.laboratory.describe import inspect_structure
from rths_cli.programs import Described, Description, Program, ProgramFault, described, step_times

BODY = """
import os, sys, time
class Storey:
    def __init__(self, masses_kg, parameters):
        self.k = parameters["k"]
    def force(self, u):
        if abs(u[0]) > 0.5:
            {fault}
        return self.k * u
"""
FAULTS = {
    "raise ValueError('too far')": "failed: ValueError: too far",
    "sys.exit(3)": "called exit(3)",
    "os._exit(4)": "ended by itself, exit code 4",
    "os.kill(os.getpid(), 9)": "ended by itself, killed by signal 9",
    "print('stuck here', flush=True); time.sleep(60)": "did not answer within 0.3 s and was ended; it printed last",
    "return u * float('nan')": "gave a force that is not finite",
    "return [1.0, 2.0]": "failed: ValueError: force gave an array of shape (2,), (1,) is needed",
}


def written(folder: Path, fault: str, **values: float) -> Description:
    file = folder / "storey.py"
    file.write_text(BODY.format(fault=fault), encoding="utf-8")
    numbers = tuple(sorted({"k": 1000.0, **values}.items()))
    return Description("python", str(file), "", "Storey", masses_kg=(2.0,), parameters=numbers, silent_after_s=0.3)


def gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_has_its_name_and_leaves_no_process(tmp_path: Path, fault: str) -> None:
    with Program(written(tmp_path, fault)) as program:
        process = program.process_id
        assert program.force_at(np.array([0.1])) == pytest.approx(100.0)
        with pytest.raises(ProgramFault, match="python program storey") as refused:
            program.force_at(np.array([1.0]))
    assert FAULTS[fault] in str(refused.value)
    assert gone(process)


def test_the_tangent_at_rest_is_that_of_the_program(tmp_path: Path) -> None:
    found = described(written(tmp_path, "pass", k=3210.0))
    assert isinstance(found, Described)
    assert found.stiffness == pytest.approx(np.array([[3210.0]]), rel=1e-9)
    assert found.masses_kg.tolist() == [2.0]


def test_a_program_that_lost_its_parent_ends(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:  # a run that is killed
        program = Program(written(tmp_path, "pass"))
        os.write(writing, str(program.process_id).encode())
        time.sleep(60.0)
        os._exit(0)
    process = int(os.read(reading, 20))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(writing)
    limit = time.monotonic() + 20.0
    while not gone(process) and time.monotonic() < limit:
        time.sleep(0.05)
    assert gone(process)


def test_a_changed_file_is_not_run(tmp_path: Path) -> None:
    stated = written(tmp_path, "pass")
    other = Description("python", stated.file, "0" * 64, "Storey", masses_kg=(2.0,), parameters=stated.parameters)
    with pytest.raises(ProgramFault, match="has changed since the case was read"):
        Program(other)


def test_times_are_those_of_each_call(tmp_path: Path) -> None:
    taken = step_times(written(tmp_path, "pass"), np.array([0.01]), calls=20)
    assert taken.shape == (20,)
    assert taken.min() > 0.0


def test_the_structure_of_a_program_has_both_masses_and_its_step_time(tmp_path: Path) -> None:
    written(tmp_path, "pass", k=3210.0)
    (tmp_path / "own.yaml").write_text(
        "extends: three_storey\nnumerical: {kind: python, file: storey.py, function: Storey, masses_kg: [2.0], "
        "parameters: {k: 3210.0}, rate_hz: 200}\ninterface_experimental_mass_kg: 0.5\n",
        encoding="utf-8",
    )
    found = inspect_structure(str(tmp_path / "own.yaml")).program
    assert found is not None
    assert found.interface_kg == (2.0, 0.5, 2.5)
    assert found.natural_frequency_hz == pytest.approx(np.array([np.sqrt(3210.0 / 2.0) / (2.0 * np.pi)]), rel=1e-6)
    half, most, longest = found.step_time_s
    assert 0.0 < half <= most <= longest
