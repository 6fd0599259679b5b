"""Does the pre-flight check tell the truth? Check and play random rigs and buildings, whatever the verdict.

    python benchmarks/preflight.py [--seed N] [--count N]

Printed: verdict against outcome, every contradiction, and how far the predicted errors are from the measured ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from options import arguments, parsed
from random_tests import Row, judged

from rths_cli.numerics.lti import Array

SHORT = ("--count", "1")
PRINTS = "1 tests drawn"  # the short form at its end

FIRST_SEED, COUNT, PROCESSES = 3000, 200, 2
FACTOR = 1.5
VERDICTS = ("safe", "unsafe", "unstable")
QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def line(row: Row) -> str:
    """Return one test's line."""
    d = row.drawn
    head = (
        f"{row.seed:>6} {d.rate_hz / 1e3:>4g} {d.latency_samples:>3} {d.controller:<5} {d.method:<5} "
        f"{d.floors[0]:>3} {d.floors[1]:>3} {d.mass_share:5.2f} {100 * d.ratio:5.2f} {d.coulomb_n:5.2f}"
    )
    if row.refused:
        return f"{head}  not run: {row.refused}"
    end = "diverged" if row.diverged else "stable"
    return f"{head} {row.scaling:7.3g} {row.radius:9.6f}  {row.verdict:<8} {end:<8} {figures(row)}  {row.stopped}"


def figures(row: Row) -> str:
    """Return predicted over measured, least and greatest of the storeys and of tracking, and the dominating cause."""
    if not row.causes or row.stopped:
        return f"{'-':>6}{'-':>6}{'-':>7}  {'-':<12}"
    storeys = row.ratios[:-1]
    return f"{storeys.min():6.2f}{storeys.max():6.2f}{row.ratios[-1]:7.2f}  {dominating(row):<12}"


def dominating(row: Row) -> str:
    """Return the cause with the largest share of the storeys' predicted error."""
    return max(row.causes, key=lambda name: float(np.sum(row.causes[name][:-1] ** 2)))


def confusion(rows: list[Row]) -> Iterator[str]:
    """Yield verdict against outcome, then every test that contradicts its verdict."""
    yield "verdict    tests  stable  stopped or diverged"
    for verdict in VERDICTS:
        judged_so = [row for row in rows if row.verdict == verdict]
        bad = sum(row.diverged for row in judged_so)
        yield f"{verdict:<9}{len(judged_so):>7}{len(judged_so) - bad:>8}{bad:>21}"
    wrong = [row for row in rows if row.diverged != (row.verdict == "unstable") and row.verdict != "unsafe"]
    yield f"contradictions (safe but diverged, unstable but stable): {len(wrong)}"
    for row in wrong:
        yield f"  seed {row.seed}: {row.verdict}, {row.stopped or 'reached its end'}; {'; '.join(row.reasons)}"


def agreement(rows: list[Row]) -> Iterator[str]:
    """Yield how many predictions of the safe tests lie within the factor of what was measured."""
    safe = [row for row in rows if row.verdict == "safe" and not row.diverged]
    yield f"safe tests: predicted error within a factor {FACTOR:g} of the measured, share of"
    yield f"{'':<26}tests  storeys  every storey  worst storey  tracking"
    yield shares("all", safe)
    groups: tuple[tuple[str, Callable[[Row], object]], ...] = (
        ("Hz", lambda row: row.drawn.rate_hz),
        ("latency samples", lambda row: row.drawn.latency_samples),
        ("controller", lambda row: row.drawn.controller),
        ("method", lambda row: row.drawn.method),
        ("dominated by", dominating),
    )
    for name, key in groups:
        for value in sorted({key(row) for row in safe}, key=str):
            yield shares(f"{name} {value}", [row for row in safe if key(row) == value])
    if safe:
        yield "predicted / measured      " + "".join(f"{f'{100 * q:g} %':>8}" for q in QUANTILES)
        yield quantiles("storeys", np.concatenate([row.ratios[:-1] for row in safe]))
        yield quantiles("tracking", np.array([row.ratios[-1] for row in safe]))


def shares(name: str, rows: list[Row]) -> str:
    """Return one line of shares: storeys, tests with every storey, tests' worst storey (largest error), tracking."""
    if not rows:
        return f"{name:<26}{0:>5}"
    storeys = [within(row.ratios[:-1]) for row in rows]
    worst = [within(row.ratios[:-1])[np.argmax(row.measured[:-1])] for row in rows]
    cells = (
        np.mean(np.concatenate(storeys)),
        np.mean([inside.all() for inside in storeys]),
        np.mean(worst),
        np.mean([within(row.ratios[-1:]) for row in rows]),
    )
    widths = (9, 14, 14, 10)
    return f"{name:<26}{len(rows):>5}" + "".join(f"{value:>{w}.0%}" for value, w in zip(cells, widths, strict=True))


def within(ratio: Array) -> Array:
    """Tell of each ratio whether it lies between 1 / FACTOR and FACTOR."""
    return np.asarray(np.abs(np.log(ratio)) <= np.log(FACTOR))


def quantiles(name: str, ratio: Array) -> str:
    """Return one line of quantiles."""
    return f"{name:<26}" + "".join(f"{value:>8.2f}" for value in np.quantile(ratio, QUANTILES))


def outside(rows: list[Row]) -> Iterator[str]:
    """Yield the safe tests with a storey or the tracking outside the factor."""
    for row in rows:
        if row.verdict == "safe" and not row.diverged and not within(row.ratios).all():
            ratios = " ".join(f"{value:.2f}" for value in row.ratios)
            yield f"  seed {row.seed}: {ratios}; {dominating(row)}"


def main() -> None:
    """Print the table and its summary."""
    asked, start = parsed(arguments(__doc__, FIRST_SEED, COUNT), SHORT), time.monotonic()
    first, count = asked.seed, asked.count
    print(
        "storeys computed and on the table, share of the interface floor's mass on the table, damping ratio of mode 1"
    )
    print(
        "  seed  kHz lat contr method n_n n_e share   z %     N scaling    radius  verdict  outcome    storeys  track  "
        "cause"
    )
    rows = []
    with ProcessPoolExecutor(PROCESSES) as pool:
        for row in pool.map(judged, range(first, first + count)):
            rows.append(row)
            print(line(row), flush=True)
    run = [row for row in rows if not row.refused]
    print(f"\n{len(rows)} tests drawn, {len(rows) - len(run)} not run (model or controller refused)")
    print("\n".join([*confusion(run), "", *agreement(run), "outside the factor:", *outside(run)]))
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
