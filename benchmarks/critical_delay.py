"""Critical delay of 20 random buildings: by the eigenvalues of the loop, and by bisection of SIM-DELAY in time.

python benchmarks/critical_delay.py [--seed N] [--count N]
"""

from __future__ import annotations

import math
import time

import numpy as np
from options import arguments, parsed

from rths_cli.analysis.closed_loop import critical_delay
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.structure import Building, Numerical, Specimen, assemble, modal_damping_matrix, storey_matrix

SHORT = ("--count", "1")
PRINTS = "of 1 buildings"  # the short form at its end

SAMPLES, EARLY, LATE = 60_000, slice(20_000, 30_000), slice(50_000, 60_000)
BRACKET, BISECTIONS = 0.02, 6


def building(seed: int) -> Building:
    """Return a random shear building of one to three numerical and one to three experimental storeys."""
    random = np.random.default_rng(seed)
    p, n = int(random.integers(1, 4)), int(random.integers(1, 4))
    masses, stiffness = random.uniform(4.0, 12.0, p + n), random.uniform(3e3, 2e4, p + n)
    interface = float(random.choice([0.0, random.uniform(0.0, 0.4)]) * masses[p - 1])
    K = storey_matrix(stiffness[p:])
    specimen = Specimen(masses[p:], K, modal_damping_matrix(masses[p:], K, random.uniform(0.005, 0.05, n)))
    own = masses[:p].copy()
    own[-1] -= interface
    numerical = Numerical(own, storey_matrix(stiffness[:p]), storey_matrix(random.uniform(10.0, 60.0, p)))
    return Building(numerical, specimen, interface, *assemble(numerical, specimen, interface), ())


def grows(made: Building, delay_s: float, frequency_hz: float) -> bool:
    """Tell whether the response to an impulse grows from an early to a late stretch."""
    record = np.zeros(SAMPLES)
    record[1] = 1.0
    accel = np.abs(simulate_delayed(made, 1.0 / (30.0 * frequency_hz), record, delay_s, 1e-4).abs_accel_m_s2)
    return not np.isfinite(accel).all() or float(accel[:, LATE].max()) > float(accel[:, EARLY].max())


def in_time(made: Building, near_s: float, frequency_hz: float) -> float:
    """Return the critical delay by bisection in time within 2 % of a first value; NaN when it is not there."""
    low, high = (1.0 - BRACKET) * near_s, (1.0 + BRACKET) * near_s
    if grows(made, low, frequency_hz) or not grows(made, high, frequency_hz):
        return math.nan
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(made, middle, frequency_hz) else (middle, high)
    return 0.5 * (low + high)


def main() -> None:
    asked = parsed(arguments(__doc__, 0, 20), SHORT)
    first, count = asked.seed, asked.count
    print("seed  storeys  interface mass  lost at (Hz)  eigenvalues (ms)  in time (ms)  difference (%)")
    worst, start = 0.0, time.time()
    for seed in range(first, first + count):
        made = building(seed)
        found = critical_delay(made)
        searched = in_time(made, found.delay_s, found.frequency_hz)
        differs = 100.0 * abs(searched / found.delay_s - 1.0)
        worst = max(worst, differs) if differs == differs else math.nan
        storeys = f"{len(made.numerical.masses_kg)}+{len(made.specimen.masses_kg)}"
        print(
            f"{seed:4d} {storeys:>8}  {found.gain_at_infinity:14.3f} {found.frequency_hz:13.3f} "
            f"{1e3 * found.delay_s:17.4f} {1e3 * searched:13.4f} {differs:15.3f}",
            flush=True,
        )
    print(f"largest difference {worst:.3f} % of {count} buildings ({time.time() - start:.0f} s)")


if __name__ == "__main__":
    main()
