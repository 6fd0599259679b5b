"""Is everything that moves the table judged before it moves? Random tests against what the table truly did.

    python benchmarks/judged_runs.py [--seed 1] [--count 40] [--jobs 1] [--output rows.jsonl]

For each run that was not refused (identification, shake-table test, EXP-RTHS) the true peak acceleration of the table
must not exceed 3 times the planned one or 1 m/s^2, nor its displacement 1.5 times the planned one or that and 1 mm.
Refused runs are played as well: at most a tenth of those that would run may be refused.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.judged_run_trials import Moved, Trial, tried
from options import arguments, parsed

SHORT = ("--count", "1")


def line(trial: Trial) -> str:
    """Return one test's lines."""
    head = f"{trial.seed:>6} {trial.about}  {trial.seconds:.0f} s{f'  {trial.fault}' if trial.fault else ''}"
    return "\n".join([head, *(f"{'':>9}{_told(each)}" for each in trial.runs)])


def _told(each: Moved) -> str:
    word = "kept" if each.kept else "BROKEN"
    ends = "".join(f"; {what}: {why}" for what, why in (("refused", each.refused), ("stopped", each.stopped)) if why)
    return (
        f"{each.run:<15}{word:<7} {each.true_m_s2:7.3f} of {each.planned_m_s2:7.3f} m/s^2, {1e3 * each.true_m:7.2f} of "
        f"{1e3 * each.planned_m:7.2f} mm{ends}"
    )


def summary(trials: Sequence[Trial]) -> Iterator[str]:
    """Yield the shares that are asked for."""
    every = [(trial, each) for trial in trials for each in trial.runs]
    for run in ("identification", "shake_table", "exp_rths"):
        mine = [each for _, each in every if each.run == run]
        let = [each for each in mine if not each.refused]
        good = [each for each in mine if each.would_run]
        lost = sum(bool(each.refused) for each in good)
        more = sum(not each.kept for each in let)
        yield (
            f"{run}: {len(let)} of {len(mine)} not refused, of which {more} moved more than planned; "
            f"{lost} of {len(good)} that would run are refused"
        )
    reasons = Counter(each.refused.split(";")[0][:60] for _, each in every if each.refused and each.would_run)
    yield from (f"  {count:>3} {reason}" for reason, count in reasons.most_common())
    yield f"no model or no design: {sum(bool(trial.fault) for trial in trials)} of {len(trials)}"


def main() -> None:
    """Print every test and the summary."""
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the first test")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--output", type=Path, help="a line of JSON for each test")
    asked = parsed(parser, SHORT)
    trials = []
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(asked.jobs) as pool:
        for trial in pool.map(partial(tried, folder=Path(name)), range(asked.seed, asked.seed + asked.count)):
            trials.append(trial)
            print(line(trial), flush=True)
            if asked.output:
                with asked.output.open("a") as file:
                    file.write(json.dumps(asdict(trial)) + "\n")
    print("\n".join(summary(trials)))


if __name__ == "__main__":
    main()
