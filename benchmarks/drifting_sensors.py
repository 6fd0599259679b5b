"""Runs on drifting sensors: are the errors in the file those of the true floors, and are the channels named?

    python benchmarks/drifting_sensors.py [--count N] [--seed N]

Each run draws a record, a corner of the AC coupling, a sample rate, a channel, and an offset of 5 mV, a drift of 0.5 to
5 mV/min or jumps of 5 mV at random instants of that channel, sometimes of another one too; every fourth run is healthy.
The truth is known from `tests/helpers/campaigns/drifting_rig.py`, which adds them behind the coupling of the virtual
rig. The run fails where a floor's RMS error differs from the true one by more than 5 % and 0.1 mm/s^2, a drifting
channel is not named, a jump is dated wrongly by more than 50 ms, a jump or a drift is found that is not there, or its
size is wrong by more than 10 %.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.drifting_sensor_runs import Added, faults, in_mm_s2, nothing, played

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.setup import make_setup

SHORT = ("--count", "1")
PRINTS = "of 1 runs failed"  # the short form at its end

RECORDS, CORNERS_HZ, RATES_HZ = ("el_centro", "hachinohe"), (0.024, 0.05, 0.1, 0.3), (500, 1000, 2000)
JUMP_V, OFFSET_V, DRIFTS_V_PER_MIN = 5e-3, 5e-3, (0.5e-3, 5e-3)


def draw(random: np.random.Generator, channels: int, record_s: float) -> Added:
    """Draw offset, drift and jumps."""
    offset, drift = np.zeros(channels), np.zeros(channels)
    jumps: list[tuple[int, float, float]] = []
    for channel in random.permutation(channels)[: int(random.integers(1, 3))]:
        offset[channel] = OFFSET_V * random.choice([-1.0, 1.0])
        if random.random() < 0.6:
            drift[channel] = random.uniform(*DRIFTS_V_PER_MIN) / 60.0 * random.choice([-1.0, 1.0])
        if random.random() < 0.6:
            jumps.append((int(channel), random.uniform(2.0, record_s - 2.0), JUMP_V * random.choice([-1.0, 1.0])))
    return Added(offset, drift, tuple(jumps))


def main() -> int:
    """Play the runs and print one line for each, then how many failed."""
    asked = parsed(arguments(__doc__, seed=1, count=48), SHORT)
    runs, first = asked.count, asked.seed
    memory, failed = Memory(), 0
    for seed in range(first, first + runs):
        random = np.random.default_rng(seed)
        record, corner, rate = (random.choice(each) for each in (RECORDS, CORNERS_HZ, RATES_HZ))
        name = f"{record}_{random.choice(['low', 'high'])}_{random.choice(['ff', 'ff_fb'])}"
        settings = (f"table.sensors.high_pass_hz={corner}", f"sample_rate_hz={rate}")
        setup = make_setup(load_cases([name], settings)[0])
        memory.prepare(setup)
        channels, record_s = len(setup.rig.channels), len(setup.motion.time_s) * setup.rig.dt_s
        added = nothing(channels) if seed % 4 == 0 else draw(random, channels, record_s)
        try:
            run = played(setup, memory, added, seed)
        except RuntimeError as error:
            failed += 1
            print(f"{seed:4} {name:22} {corner:5} Hz {rate:4} Hz FAILED {error}", flush=True)
            continue
        wrong = faults(setup, added, run)
        failed += bool(wrong)
        words = "; ".join(wrong) or f"right{', stopped: ' * bool(run.stopped_by)}{run.stopped_by}"
        print(
            f"{seed:4} {name:22} {corner:5} Hz {rate:4} Hz  raw {in_mm_s2(run.raw)}  file {in_mm_s2(run.reported)}  "
            f"true {in_mm_s2(run.true)}  {words}",
            flush=True,
        )
    print(f"{failed} of {runs} runs failed")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
