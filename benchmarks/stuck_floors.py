"""How soon a floor's sensor that is stuck ends a test, and whether a healthy one ever does.

python benchmarks/stuck_floors.py [--seed 5000] [--count 10] [--instants 3] [--case FILE ...]

Random tests of benchmarks/random_cases.py (soft and stiff specimens, 12-18 bits), or cases by file or name, are played
healthy and then with one floor's sensor stuck at random instants. The oracle is the healthy run: a sensor is due from
the instant on at which the floor has moved by ten bits for a sensor that works, half a second after it stuck at the
earliest. Printed: how long after that the guard called it stuck, or what else ended the test.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from bare_rig import BareRig
from campaigns.random_case_draw import make_records
from campaigns.random_case_runs import about, legitimate

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_rig
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.loop.guard import NONE, STUCK, STUCK_BITS, STUCK_S
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import Rig

SHORT = ("--count", "1", "--instants", "1")


class Sticking(BareRig):
    """A rig one of whose channels keeps its sample from a step on."""

    def __init__(self, rig: Rig, channel: int, at: int) -> None:
        super().__init__(rig)
        self._channel, self._at = channel, at

    def shown(self, samples: Array) -> Array:
        if len(self.samples) > self._at:
            samples[self._channel] = self.samples[-1][self._channel]
        return samples


def played(setup: Setup, design: Design, channel: int = 0, at: int = 10**9) -> tuple[Outcome, Array]:
    """Play EXP-RTHS with a channel stuck from a step on; return how it went and the samples (c, n) in V."""
    rig = Sticking(open_rig(setup, (EXP_RTHS,), setup.case.seed), channel, at)
    outcome = play(rig, setup.rig, design.blocks, NUMERICAL, drive_of(setup, design), guard_limits(setup))
    return outcome, np.array(rig.samples).T


def due(setup: Setup, healthy_v: Array, at: int) -> int | None:
    """Return the step from which on a sensor that is stuck since `at` is to be found; None where its floor rests."""
    step_v, dt_s = setup.rig.converters.step_v, setup.rig.dt_s
    moved = np.flatnonzero(np.abs(healthy_v[at:] - healthy_v[at]) > STUCK_BITS * step_v)
    return at + max(int(moved[0]), round(STUCK_S / dt_s)) if moved.size else None


def rows(setup: Setup, design: Design, instants: int) -> Iterator[str]:
    """Yield a line for the healthy run and one for each run with a stuck sensor."""
    healthy, shown = played(setup, design)
    yield f"  healthy: {healthy.stopped_by_limit or 'completes'}{' FALSE STOP' if healthy.reason == STUCK else ''}"
    if healthy.reason != NONE:
        return
    random = np.random.default_rng(setup.case.seed)
    for _ in range(instants):
        channel, at = int(random.integers(1, len(shown))), int(random.uniform(0.05, 0.8) * shown.shape[1])
        wanted = due(setup, shown[channel], at)
        outcome, _ = played(setup, design, channel, at)
        told = f"  {setup.rig.channels[channel].name} stuck at {at * setup.rig.dt_s:.2f} s: "
        since = f"{outcome.stopped_at_s - at * setup.rig.dt_s:.2f} s later"
        after = "its floor rests" if wanted is None else f"due {(wanted - at) * setup.rig.dt_s:.2f} s later"
        ended = "never found" if outcome.reason == NONE else f"{since}, {outcome.stopped_by_limit.partition(' (')[0]}"
        yield f"{told}{ended}; {after}"


def main() -> None:
    """Print the runs of every case."""
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=5000, help="of the first random test")
    parser.add_argument("--count", type=int, default=10, help="of random tests")
    parser.add_argument("--instants", type=int, default=3)
    parser.add_argument("--case", nargs="*", default=[], help="case files or names, instead of random tests")
    asked = parsed(parser, SHORT)
    memory = Memory()
    with tempfile.TemporaryDirectory() as name:
        make_records(Path(name))
        for case in asked.case or range(asked.seed, asked.seed + asked.count):
            try:
                setup = make_setup(load_cases([case])[0]) if asked.case else legitimate(case, Path(name))
                print(f"{case}: {about(setup)}", flush=True)
                design = design_blocks(setup, memory.known(setup, lambda _: None).found)
            except RthsError as error:
                print(f"{case} is refused: {str(error)[:100]}", flush=True)
                continue
            for line in rows(setup, design, asked.instants):
                print(line, flush=True)


if __name__ == "__main__":
    main()
