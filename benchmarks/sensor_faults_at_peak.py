"""Does a sensor that dies, sticks or flips at the peak of motion leave the table where it may be, and is it named?

python benchmarks/sensor_faults_at_peak.py [--seed 7000] [--count 6] [--healthy] [--case FILE ...] [--set KEY=VALUE ...]

Random tests of benchmarks/random_cases.py, or cases by file or name, are played healthy and then with each channel dead
(0 V), stuck or flipped from the peak of its motion on, as shake-table test and EXP-RTHS. The oracle is the healthy run:
the true table may go 1.5 times as far, or 1 mm farther, must rest within 2 s of the guard's stop, and a healthy run
must not be stopped. With `--healthy` no channel fails.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.random_case_draw import make_records
from campaigns.random_case_runs import about, legitimate
from campaigns.sensor_faults import BOTH, faulty_runs, healthy, planned
from options import arguments, parsed

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import make_setup

SHORT = ("--count", "1")


def main() -> None:
    """Print a line for each run and the counts of all."""
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=7000, help="of the first random test")
    parser.add_argument("--count", type=int, default=6, help="of random tests")
    parser.add_argument("--healthy", action="store_true", help="play healthy runs alone")
    parser.add_argument("--case", nargs="*", default=[], help="case files or names, instead of random tests")
    parser.add_argument("--set", nargs="*", default=[], help="as of rths run")
    asked = parsed(parser, SHORT)
    memory, counts = Memory(Cache()), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        make_records(Path(name))
        for case in asked.case or range(asked.seed, asked.seed + asked.count):
            try:
                setup = make_setup(load_cases([case], asked.set)[0]) if asked.case else legitimate(case, Path(name))
                known = memory.known(setup, lambda _: None)
                checked = verdict_on(setup, known)
            except RthsError as error:
                print(f"{case} is refused: {str(error)[:100]}", flush=True)
                continue
            if checked.refused or checked.design is None:
                print(f"{case} is refused: {'; '.join(checked.reasons)[:100]}", flush=True)
                continue
            print(f"{case}: {about(setup)}", flush=True)
            for kind in BOTH:
                plan = planned(setup, known.found, checked.design, kind)
                stopped, samples_v, place_m = healthy(plan)
                counts["healthy stopped" if stopped else "healthy"] += 1
                if stopped:
                    print(f"  {kind.name} HEALTHY BUT STOPPED: {stopped}", flush=True)
                if stopped or asked.healthy:
                    continue
                for one in faulty_runs(plan, samples_v, place_m):
                    counts["fault"] += 1
                    counts["beyond" if not one.stays else "stays"] += 1
                    counts["rests" if one.rests else "restless"] += 1
                    counts[f"named {one.named}"] += 1
                    print(
                        f"  {one.run} {one.channel} {one.kind}: {1e3 * one.reached_m:.2f} of {1e3 * one.healthy_m:.2f}"
                        f" mm{'' if one.stays else ' BEYOND'}{'' if one.rests else ' RESTLESS'}, {one.seconds:.3f} s, "
                        f"{one.named}: {one.sentence[:150]}",
                        flush=True,
                    )
    print(", ".join(f"{name} {count}" for name, count in sorted(counts.items())))


if __name__ == "__main__":
    main()
