"""What a target that freezes costs, against an ideal table, in simulated time: no network, no clock.

python benchmarks/freezes.py [--instants 20] [--seed 0] [--rates 500 1000] [--ms 5 10 20 34 50 100 200 300]
    [--targets holds approaches "goes on"]

El Centro, FF+FB, one freeze in each run, at random instants of its strong part. A target holds its command while it
is frozen and then jumps to the newest or approaches it (docs/reference/udp.md), or it follows the preview. The ideal
table is where the numerical substructure wants it, holds for the freeze, and catches up at 0.9 of the velocity limit
(tests/helpers/ideal_table.py). The ratio is the RMS error to SIM of a run over that of the ideal table, both over all
storeys; the error of the calm run, which is not of the freeze, is added to the ideal one as a root of squares.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from options import arguments, parsed

TREE = Path(__file__).parents[1]
sys.path[:0] = [str(TREE), str(TREE / "tests" / "helpers")]

from freezing import APPROACHES, GOES_ON, HOLDS, Freezing, freezing_of, ideal_errors, told  # noqa: E402

from rths_cli.loop.guard import END  # noqa: E402
from rths_cli.numerics.lti import Array  # noqa: E402

SHORT = ("--instants", "1", "--rates", "500", "--ms", "5", "--targets", "holds")
PRINTS = "500 Hz holds"  # the short form at its end

RECORD_S, RAMP_S, FIRST_S, LAST_S = 8.0, 1.0, 1.5, 6.0
# the time by which the table follows its command: 2 z / w of its loop and the time constant of its force; its settings
TABLES = {
    "stiff table, 14 Hz": (14e-3, ()),
    "soft table, 6 Hz": (23e-3, ("table.physics.loop_frequency_hz=6", "table.physics.loop_damping_ratio=0.4")),
}
TARGETS = {"holds": HOLDS, "approaches": APPROACHES, "goes on": GOES_ON}


def ratios_of(laboratory: Freezing, at: int, ms: float, mode: int, calm: Array, lag_s: float) -> Array | str:
    """Return the ratios of all storeys together and of the worst one, or why the run stopped."""
    length = round(1e-3 * ms / laboratory.setup.rig.dt_s)
    run, _ = laboratory.run(np.array([at]), length, mode, lost_samples=400)
    if run.guard.flags[1] != END:
        return told(run).split(":")[0]
    ideal = ideal_errors(laboratory, np.array([at]), length, lag_s)
    found, ideal = laboratory.errors(run), np.hypot(ideal, calm)
    return np.array([np.linalg.norm(found) / np.linalg.norm(ideal), (found / ideal).max()])


def main() -> None:
    """Print a line for each table, rate, target and length."""
    parser = arguments(__doc__)
    parser.add_argument("--instants", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rates", type=int, nargs="+", default=[500, 1000])
    parser.add_argument("--ms", type=float, nargs="+", default=[5, 10, 20, 34, 50, 100, 200, 300])
    parser.add_argument("--targets", nargs="+", choices=[*TARGETS], default=[*TARGETS])
    options = parsed(parser, SHORT)
    print("ratio to the ideal table: all storeys (median, largest), worst storey (largest)")
    for name, (lag_s, settings) in TABLES.items():
        for rate in options.rates:
            laboratory = freezing_of(round(RECORD_S * rate), rate, "el_centro_low_ff_fb", *settings)
            instants = np.random.default_rng(options.seed).uniform(RAMP_S + FIRST_S, RAMP_S + LAST_S, options.instants)
            calm = laboratory.errors(laboratory.run(np.zeros(0, np.int64), 0, HOLDS)[0])
            for target in options.targets:
                mode = TARGETS[target]
                for ms in options.ms:
                    each = [ratios_of(laboratory, round(at * rate), ms, mode, calm, lag_s) for at in instants]
                    ended = np.array([one for one in each if not isinstance(one, str)]).reshape(-1, 2)
                    stopped = Counter(one for one in each if isinstance(one, str))
                    figures = (
                        f"{np.median(ended[:, 0]):6.2f}{ended[:, 0].max():6.2f}{ended[:, 1].max():7.2f}"
                        f"{(ended[:, 0] > 1.3).sum():4d} above 1.3" if len(ended) else " " * 32
                    )  # fmt: skip
                    reasons = "; ".join(f"{count} stopped: {reason}" for reason, count in stopped.items())
                    print(f"{name:19} {rate:4} Hz {target:10}{ms:5g} ms {figures}  {reasons}", flush=True)


if __name__ == "__main__":
    main()
