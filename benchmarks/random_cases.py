"""Random legitimate tests through identify, check and run; every refusal and stop is judged against the true cause.

    python benchmarks/random_cases.py [--seed 1] [--count 40] [--jobs 1] [--output rows.jsonl] [--case SEED]

The acceptance of any building that a table can carry: 1-8 floors, modes 0.3-60 Hz, damping 0.2-20 %, 500 Hz-4 kHz,
12-18 bits, friction 0-6 N, latency 0-8, all controllers, integrations and methods, five kinds of records. Warnings of
libraries count as failures. A refused test is run again with both overrides, which tells what it would have done.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.random_case_draw import make_records
from campaigns.random_case_runs import CRASHED, RAN, REFUSED, STOPPED, WARNED, Row, about, judged, legitimate
from campaigns.random_case_truth import GOOD

SHORT = ("--case", "2001")
PRINTS = "^structure:|^# --set scaling"  # the short form at its end


def line(row: Row) -> str:
    """Return one test's lines."""
    error = f"{row.error:6.1%}" if np.isfinite(row.error) else f"{'stop' if row.stopped else '-':>6}"
    predicted = f"{row.predicted:6.1%}" if np.isfinite(row.predicted) else f"{'-':>6}"
    head = f"{row.seed:>6} {row.outcome:<8}{error} {predicted}  {row.about}  {row.seconds:.0f} s"
    ends = [f"{'':>9}{'true ' if true else 'FALSE'} {kind}: {reason}"
            for kind, true, reason in zip(row.kinds, row.true, row.reasons, strict=True)] if row.kinds else [
            f"{'':>9}{reason}" for reason in row.reasons]  # fmt: skip
    stop = [f"{'':>9}overridden: {row.stopped}"] if row.stopped and row.outcome == REFUSED else []
    return "\n".join([head, *ends, *stop, *([row.crash] if row.crash else [])])


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the shares that are asked for."""
    count = len(rows)
    of = Counter(row.outcome for row in rows)
    yield "; ".join(f"{name} {of[name]}" for name in (RAN, REFUSED, STOPPED, CRASHED, WARNED))
    false_stops = [row for row in rows if row.outcome == STOPPED and not row.honest]
    yield f"crashes {of[CRASHED]}, warnings {of[WARNED]}, false stops {len(false_stops)}: none of each is demanded"
    honest = sum(row.honest for row in rows)
    yield f"ran or refused for a true reason: {honest} of {count}, {honest / count:.1%} (at least 95 % are demanded)"
    good = [row for row in rows if row.would_do]
    run = sum(row.outcome == RAN for row in good)
    share = run / len(good) if good else float("nan")
    yield f"of {len(good)} that run or would run with an error below {GOOD:.0%}: {run} run, {share:.1%} (at least 85 %)"
    margins = ("margin", "delay margin")
    only = sum(row.outcome == REFUSED and all(kind in margins for kind in row.kinds) for row in good)
    share = run / max(len(good) - only, 1)
    yield f"  without the {only} that only a margin of the check refuses: {share:.1%}"
    blind = sum(row.outcome == REFUSED and not row.verdict for row in rows)
    yield f"  {blind} have no model at all, so that nobody knows what they would have done"
    kinds = Counter((kind, true) for row in rows for kind, true in zip(row.kinds, row.true, strict=True))
    for kind in sorted({kind for kind, _ in kinds}):
        yield f"  reason {kind:<13} true {kinds[kind, True]:>4}   false {kinds[kind, False]:>4}"
    ratio = np.array([row.predicted / row.error for row in rows if row.outcome == RAN])
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio):
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        yield f"predicted over true error of those that ran: {low:.2f} (5 %), {middle:.2f}, {high:.2f} (95 %)"


def main() -> None:
    """Print every test and the summary."""
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the first test")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--output", type=Path, help="a line of JSON for each test")
    parser.add_argument("--case", type=int, help="print the case file of a seed and nothing else")
    asked = parsed(parser, SHORT)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_records(folder)
        if asked.case is not None:
            setup = legitimate(asked.case, folder)
            print((folder / f"case_{asked.case}.yaml").read_text())
            print(f"# --set scaling={setup.case.scaling!r}; {about(setup)}")
            return
        rows = []
        with ProcessPoolExecutor(asked.jobs) as pool:
            for row in pool.map(partial(judged, folder=folder), range(asked.seed, asked.seed + asked.count)):
                rows.append(row)
                print(line(row), flush=True)
                if asked.output:
                    with asked.output.open("a") as file:
                        file.write(json.dumps(asdict(row)) + "\n")
    print("\n".join(summary(rows)))
    print(f"{time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
