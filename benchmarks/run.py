"""Print how long the step, the reference solutions and whole commands take on this machine (make bench)."""

from __future__ import annotations

import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np

CASE = "el_centro_low_ff_fb"


def median_s(work: Callable[[], object], repetitions: int) -> float:
    """Return the median duration of `work` after one warm-up."""
    work()
    durations = []
    for _ in range(repetitions):
        start = time.perf_counter()
        work()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations)


def command(*words: str) -> Callable[[], object]:
    """Return a function that runs rths with these words in a process of its own."""
    return lambda: subprocess.run([sys.executable, "-m", "rths_cli", *words], capture_output=True, check=True)


def main() -> None:
    """Print the table."""
    from rths_cli.analysis.sim import simulate
    from rths_cli.analysis.sim_delay import simulate_delayed
    from rths_cli.case.load import load_cases
    from rths_cli.loop.blocks import NUMERICAL
    from rths_cli.workflows.controllers import design_blocks
    from rths_cli.workflows.identify import identify
    from rths_cli.workflows.rigs import EXP_RTHS
    from rths_cli.workflows.run import play_run
    from rths_cli.workflows.setup import make_setup

    print(f"{platform.machine()}, {platform.platform()}, Python {platform.python_version()}")
    setup = make_setup(load_cases([CASE])[0])
    ground, dt = setup.motion.accel_m_s2, setup.rig.dt_s
    identified = identify(setup, lambda _: None)
    design = design_blocks(setup, identified)
    outcome = play_run(setup, design, NUMERICAL, EXP_RTHS)
    with tempfile.TemporaryDirectory() as folder:
        rows = {
            "rths --help, whole process": (median_s(command("--help"), 7), "s"),
            f"rths run {CASE}, whole process": (
                median_s(command("run", CASE, "--quiet", "--output", folder), 5),
                "s",
            ),
            "identification, excitation included": (median_s(lambda: identify(setup, lambda _: None), 3), "s"),
            "design of the controllers": (median_s(lambda: design_blocks(setup, identified), 3), "s"),
            f"EXP-RTHS loop, {outcome.steps} steps": (
                median_s(lambda: play_run(setup, design, NUMERICAL, EXP_RTHS), 5),
                "s",
            ),
            "step and guard alone, per step": (1e-9 * float(np.nanmedian(outcome.log.compute_ns)), "s"),
            "SIM": (median_s(lambda: simulate(setup.building, dt, ground), 5), "s"),
            "SIM-DELAY": (median_s(lambda: simulate_delayed(setup.building, dt, ground, 0.005), 5), "s"),
        }
    for name, (value, unit) in rows.items():
        print(f"{name:<45}{value:>12.3g} {unit}")


if __name__ == "__main__":
    main()
