"""A program that fails or stalls in a test, at many instants: the table at rest or the run within its stated error, the
true reason in a complete file, and no process left."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.control.program_storeys import LONGEST_HOLD, ProgramStoreys
from rths_cli.experiment import run_case as sequence
from rths_cli.experiment.check_command import Verdict
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.numerics.shared_values import SharedValues

pytestmark = pytest.mark.campaign
INSTANTS, RATE_HZ, RECORD_S = 20, 200, 5.0
STOREY = """
import json, os, pathlib, sys, time
HERE = pathlib.Path(__file__).parent
class Storey:
    def __init__(self, masses_kg, parameters):
        self.calls, order = 0, HERE / "order.json"
        self.at, self.what = json.loads(order.read_text()) if order.exists() else (-1, "")
        with open(HERE / "processes", "a") as file:
            file.write(str(os.getpid()) + " ")
    def force(self, u):
        self.calls += 1
        if self.calls == self.at:
            if self.what == "nan":
                return u * float("nan")
            print("the last word", flush=True)
            exec(self.what)
        return 7354.0 * u / (1.0 + abs(u) / 0.02)  # softens: by a quarter at 7 mm
"""
FAULTS = {
    "os.kill(os.getpid(), 9)": "storey.py ended by itself, killed by signal 9; it printed last: the last word",
    "os._exit(4)": "storey.py ended by itself, exit code 4; it printed last: the last word",
    "sys.exit(3)": "storey.py called exit(3); it printed last: the last word",
    "time.sleep(60)": "storey.py did not answer within 0.1 s and was ended; it printed last: the last word",
    "nan": "storey.py gave a force that is not finite: [nan] N",
    "raise ArithmeticError('does not converge')": "storey.py failed: ArithmeticError: does not converge",
}
SETTINGS = (
    "structure.numerical.silent_after_s=0.1", f"structure.numerical.rate_hz={RATE_HZ}", "sample_rate_hz=1000",
    "runs=[sim, exp_rths]",
)  # fmt: skip
Play = Callable[[Callable[[Verdict], Verdict]], tuple[Ended, Path]]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory, memory: Memory) -> tuple[Path, Play]:
    """Return the folder of a program, and what plays its case anew with a verdict that is judged once."""
    folder = tmp_path_factory.mktemp("faults")
    (folder / "storey.py").write_text(STOREY)
    values = (Path(__file__).parents[2] / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in values if not line.startswith("#")][: round(50 * RECORD_S)]
    (folder / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    (folder / "case.yaml").write_text(
        "structure: {extends: three_storey, numerical: {kind: python, file: storey.py, function: Storey, "
        "masses_kg: [6.93], rate_hz: 200}}\ndamping: low\nrecord: {file: short.csv}\nscaling: 0.3\ncontroller: FF+FB\n"
    )
    setup, shared, judged = make_setup(load_cases([folder / "case.yaml"], SETTINGS)[0]), SharedValues(), list[Verdict]()
    real = sequence.verdict_on

    def play(change: Callable[[Verdict], Verdict]) -> tuple[Ended, Path]:
        def verdict(of: Setup, *arguments: object, **named: object) -> Verdict:
            judged.extend([] if judged else [real(of, *arguments, **named)])  # type: ignore[arg-type]
            return change(judged[0])

        sequence.verdict_on = verdict  # type: ignore[assignment]
        try:
            path = folder / "result.h5"
            path.unlink(missing_ok=True)
            return run_case(setup, path, memory, "test", lambda _: None, shared), path
        finally:
            sequence.verdict_on = real

    assert play(lambda verdict: verdict)[0].exit_code == 0
    return folder, play


def at_rest(path: Path) -> None:
    """Assert that the file is whole as far as the test went, and that table and command ended at zero."""
    result = read_result(path)
    assert result.attributes["status"] in ("complete", "aborted")
    with h5py.File(path) as file:
        command, table = file["exp_rths/command_v"][()], file["exp_rths/truth/table_disp_m"][()]
        assert np.isfinite(command).all() and file.attrs["status"] == result.attributes["status"]
        if result.attributes["status"] == "aborted" and len(command) < round(1000 * RECORD_S) - 20:  # within the record
            assert command[-1] == 0.0 and abs(table[-1]) < 1e-4


def none_left(folder: Path) -> None:
    """Assert that no process of a program lives."""
    for process in (folder / "processes").read_text().split():
        status = Path("/proc") / process / "status"
        assert not status.exists() or "zombie" in status.read_text(), process


@pytest.mark.parametrize("fault", FAULTS)
def test_a_program_that_fails_brings_the_table_to_rest(played: tuple[Path, Play], fault: str) -> None:
    folder, play = played
    calls = np.random.default_rng(51).integers(3, round(RATE_HZ * RECORD_S), INSTANTS)
    for at in calls.tolist():
        (folder / "order.json").write_text(json.dumps([at, fault]))
        try:
            ended, path = play(lambda verdict: verdict)
        finally:
            (folder / "order.json").unlink()
        assert ended.exit_code == 3 and FAULTS[fault] in ended.reason, (at, ended.reason)
        told = float(ended.reason.split(" at ")[-1].split()[0])
        assert told == pytest.approx(at / RATE_HZ, abs=3.0 / RATE_HZ), ended.reason
        at_rest(path)
        none_left(folder)


@pytest.mark.parametrize("lasts_s", [0.005, 0.05, 0.5])
def test_a_stall_costs_accuracy_or_ends_the_test(played: tuple[Path, Play], lasts_s: float) -> None:
    folder, play = played
    for at in np.random.default_rng(52).integers(3, round(1000 * RECORD_S) - 100, INSTANTS).tolist():

        def stalled(verdict: Verdict, at: int = at) -> Verdict:
            assert verdict.design is not None
            storeys = verdict.design.blocks.numerical
            assert isinstance(storeys, ProgramStoreys) and storeys.plan is not None
            stalls = ((at, round(1000 * lasts_s)),)
            made = replace(storeys, plan=replace(storeys.plan, stalls=stalls)).knowing(storeys.plan.ground)
            return replace(
                verdict, design=replace(verdict.design, blocks=replace(verdict.design.blocks, numerical=made))
            )

        ended, path = play(stalled)
        none_left(folder)
        at_rest(path)
        values = read_result(path).metrics
        assert values["exp_rths.program_slow_downs"] <= max(lasts_s * RATE_HZ, 1.0)
        if lasts_s * RATE_HZ > LONGEST_HOLD:
            told = float(ended.reason.split(" at ")[-1].split()[0])
            assert ended.exit_code == 3 and "has not answered for 21 samples" in ended.reason
            assert told == pytest.approx(1e-3 * at + (LONGEST_HOLD + 1) / RATE_HZ, abs=2.0 / RATE_HZ), ended.reason
            continue
        assert ended.exit_code == 0 and values["exp_rths.program_latest_s"] == pytest.approx(lasts_s)
        assert np.max(values["exp_rths.true_error_rank"]) <= 0.95, (at, values["exp_rths.true_error_rank"])
        assert np.max(values["exp_rths.true_error_bound_percent"]) < 0.5
