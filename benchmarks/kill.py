"""Kill a run with SIGKILL at random instants, and see what is left.

The run does to the disk what a real-time run does: space for the log, the result as far as it is known, a thread that
streams what a 1 kHz loop notes, then the whole result, and the log removed. Its samples are made up, so that what comes
back can be compared bit by bit; how far it was is read from memory that it shares. Each recovery is killed once, too.
"""

from __future__ import annotations

import json
import mmap
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from options import arguments, parsed

from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.experiment import result_contents
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.raw_log import SUFFIX, RawHeader, RawLogWriter, raw_log_path, still_in
from rths_cli.files.result_reader import ResultWriter, read_result, read_series
from rths_cli.laboratory.recover import recover
from rths_cli.loop.run_log import LogStream

SHORT = ("--count", "2")
PRINTS = "^2 runs killed"  # the short form at its end

CASE = "el_centro_low_ff_fb"
DESIRED = ("desired_accel_m_s2", "desired_velocity_m_s", "desired_displacement_m")
NAMES = ("command_v", *DESIRED, *(f"corrected_{i}" for i in range(3)), *(f"estimated_{i}" for i in range(7)))
NAMES += ("base_shear_n", *(f"sample_v_{i}" for i in range(3)), "wake_ns", "exchange_ns", "compute_ns")
DT_S, STEPS, LEAD = 0.001, 2000, 1
LONGEST_S = 2.5  # a whole run of 2 s with all its files takes less
RECOVERY_S = 0.2
MOST_LOST_S = 1.0
TOGETHER = 5


@dataclass(frozen=True)
class Trial:
    """What one kill left: how many steps the run had done, how many came back, and the fault (empty: none)."""

    after_s: float
    done: int
    back: int
    status: str
    fault: str

    @property
    def lost_s(self) -> float:
        """Return how long a stretch of the run did not come back."""
        return DT_S * max(self.done - self.back, 0)


def main() -> int:
    """Run the trials and print what came of them; return 1 when one left a fault."""
    parser = arguments(__doc__, seed=0, count=100)
    parser.add_argument("--json", action="store_true")
    asked = parsed(parser, SHORT)
    count = asked.count
    setup = make_setup(load_cases([CASE], [f"sample_rate_hz={1 / DT_S:g}"])[0])
    noise = np.random.default_rng(asked.seed)
    trials = [
        trial for first in range(0, count, TOGETHER) for trial in _trials(setup, noise, min(TOGETHER, count - first))
    ]
    _show(trials, asked.json)
    return int(any(trial.fault or trial.lost_s > MOST_LOST_S for trial in trials))


def _trials(setup: Setup, noise: np.random.Generator, count: int) -> list[Trial]:
    """Kill some runs that go on at the same time, recover what is left, and judge."""
    with tempfile.TemporaryDirectory() as root:
        results = [Path(root, str(i), "a-20260101T000000Z.h5") for i in range(count)]
        shared = [_shared(result.parent) for result in results]
        after_s = noise.uniform(0.0, LONGEST_S, count)
        _kill([partial(_run, result, setup, done) for result, done in zip(results, shared, strict=True)], after_s)
        each = zip(results, shared, after_s, noise.uniform(0.0, RECOVERY_S, count), strict=True)
        return [_trial(result, int(done[0]), float(run_s), recovery_s) for result, done, run_s, recovery_s in each]


def _trial(result: Path, done: int, run_s: float, recovery_s: float) -> Trial:
    """Kill a recovery of a run, recover what is left, and judge."""
    try:
        logs = list(result.parent.glob(f"*{SUFFIX}"))
        if _status(result, done) != "complete" and logs:
            _kill([partial(recover, logs)], [recovery_s])
            _status(result, done)
            recover(logs)
        return Trial(run_s, done, _came_back(result), _status(result, done), "")
    except Exception as error:
        return Trial(run_s, done, 0, "", f"{type(error).__name__}: {error}")


def _shared(folder: Path) -> NDArray[np.int64]:
    """Return a counter that outlives the process that counts."""
    folder.mkdir()
    with open(folder / "shared", "w+b") as file:
        file.truncate(8)
        return np.frombuffer(mmap.mmap(file.fileno(), 8), dtype=np.int64)


def _kill(works: Sequence[Callable[[], object]], after_s: Sequence[float]) -> None:
    """Let other processes work, and kill each at its time."""
    start, processes = time.monotonic(), []
    for work in works:
        processes.append(os.fork())
        if processes[-1] == 0:
            try:
                work()
            finally:
                os._exit(0)
    for at_s, process in sorted(zip(after_s, processes, strict=True)):
        time.sleep(max(start + at_s - time.monotonic(), 0.0))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


def _run(result: Path, setup: Setup, done: NDArray[np.int64]) -> None:
    """Do what a run on hardware does to the disk."""
    case = setup.case
    attributes = {"case_name": case.name, "rig_kind": "udp", "record_sha256": setup.record_sha256}
    header = RawHeader(
        NAMES, ("1",) * len(NAMES), DT_S, STEPS, LEAD, "exp_rths", result.name, str(case.path),
        case.yaml_text, resolved_yaml(case), attributes,
    )  # fmt: skip
    columns = np.full((len(NAMES), STEPS), np.nan)
    with RawLogWriter(raw_log_path(result, "exp_rths"), header) as log:
        with ResultWriter(result, attributes, lasting=True) as writer:
            writer.case(case.yaml_text, resolved_yaml(case))
            result_contents.write_record(writer, setup)
            writer.park(still_in(log.path))
            with LogStream(log, columns, done, np.zeros(1, dtype=np.int64)):
                _loop(columns, done)
            writer.resume()
            writer.group("exp_rths", {"command_v": _made_up(STEPS)[0, LEAD:]}, DT_S * np.arange(STEPS - LEAD))
            writer.finish("complete")
        log.remove()


def _made_up(steps: int) -> NDArray[np.float64]:
    """Return what each signal is at each step, (w, steps)."""
    return np.sin(np.arange(steps) * 0.01 + np.arange(len(NAMES))[:, None])


def _loop(columns: NDArray[np.float64], done: NDArray[np.int64]) -> None:
    """Note one step per millisecond."""
    samples, start = _made_up(STEPS), time.monotonic()
    for k in range(STEPS):
        columns[:, k] = samples[:, k]
        done[0] = k + 1
        time.sleep(max(start + (k + 1) * DT_S - time.monotonic(), 0.0))


def _status(result: Path, done: int) -> str:
    """Return what a result says of its run; raise where there is none although the table had moved."""
    if not result.exists():
        assert done == 0, "no result although the table had moved"
        return "none"
    return str(read_result(result).attributes["status"])


def _came_back(result: Path) -> int:
    """Return the number of steps that came back; raise where a value is wrong."""
    if not result.exists():
        return 0
    found = read_result(result)
    command = read_series(result, "exp_rths/command_v") if "exp_rths" in found.groups else np.zeros(0)
    np.testing.assert_array_equal(command, _made_up(STEPS)[0, LEAD : LEAD + command.size])
    back = command.size + LEAD if command.size else 0
    assert found.attributes["status"] == "interrupted" or back == STEPS, f"complete with {back} steps"
    return back


def _show(trials: list[Trial], as_json: bool) -> None:
    """Print the trials as JSON, or what they say in sum."""
    if as_json:
        print(json.dumps([asdict(trial) for trial in trials]))
        return
    lost = np.array([1e3 * trial.lost_s for trial in trials if trial.done])
    kinds = {status: sum(trial.status == status for trial in trials) for status in ("none", "interrupted", "complete")}
    print(f"{len(trials)} runs killed, {lost.size} after the table had begun to move")
    print(
        f"  before there was a result {kinds['none']}, interrupted {kinds['interrupted']}, complete {kinds['complete']}"
    )
    quantiles = np.quantile(lost, (0.5, 0.95, 1.0)) if lost.size else np.zeros(3)
    print("  lost, ms: median {:.0f}, 95 % {:.0f}, most {:.0f} (limit {:.0f})".format(*quantiles, 1e3 * MOST_LOST_S))
    faults = [trial for trial in trials if trial.fault]
    print(f"  files that did not open, or wrong values: {len(faults)}")
    for trial in faults:
        print(f"    after {trial.after_s:.3f} s: {trial.fault}")


if __name__ == "__main__":
    sys.exit(main())
