"""Are channels accused rightly? Random chains with a fault put in, and without one, through the judgement of channels.

    python benchmarks/diagnosis.py [--seed 1] [--count 200] [--output rows.jsonl]

Chains of 1-8 floors, 0.3-60 Hz, 0.2-20 % damping, on a table with friction, of a plant of its own
(tests/helpers/campaigns/own_plant.py); 12-18 bits, 500 Hz-2 kHz, latency 0-8. Every chain is judged without a fault and
with one: a reversed channel, a sensitivity off by 5-50 %, two channels exchanged, floors in reverse order, a dead
channel, a mass off by 10-50 %. Printed: how many faults are named (alone, or in a group that holds them), how many are
said but not refused, and who was accused wrongly.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.own_chains import Chain, Fault, drawn_fault, drawn_plant, injected, made_chain

from rths_cli.findings import sentences
from rths_cli.identification import channel_responses
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.inputs import IdentificationSettings, evidence

SHORT = ("--count", "3")

RATES_HZ, BITS = (500.0, 1000.0, 2000.0), (12, 14, 16, 18)
NOISE_M_S2 = (1e-4, 2e-3)
NAMED, GROUPED, UNEXPLAINED, MISSED, WRONG = "named", "in a group", "said, cause open", "missed", "wrongly accused"


@dataclass(frozen=True)
class Row:
    """What became of one chain: its fault ("" for none), what was said, and whether that is right."""

    seed: int
    about: str
    fault: str
    said: tuple[str, ...]
    outcome: str


def said_of(chain: Chain) -> tuple[str, ...]:
    """Return every sentence on the channels of a chain's record."""
    info = chain.info
    high_hz = min(60.0, 0.2 / info.dt_s)
    settings = IdentificationSettings(band_hz=(0.5, high_hz))
    try:
        data = evidence([chain.record], None, info, chain.masses_kg, settings)
    except UnfitRecord as unfit:
        return tuple(unfit.faults)
    frfs = estimate([chain.record], info.dt_s, settings.band_hz, data.settings.segment_s)
    found = channel_responses.judge(data, frfs)
    return sentences((*found.faults, *found.warnings))


def expected(fault: Fault, chain: Chain) -> str:
    """Return the words by which a sentence names a fault."""
    names = [chain.info.channels[index].name for index in fault.channels]
    if fault.kind == "swap" or (fault.kind == "reversed" and len(names) in (2, 3)):
        return f"channels {names[0]} and {names[-1]}: they look swapped"
    return {
        "sign": f"channel {names[0]}: wrong sign",
        "gain": f"channel {names[0]}: reads",
        "reversed": "reverse order",
        "mass": f"mass of {names[0]}",
        "dead": f"channel {names[0]}: ",
    }[fault.kind]


def outcome(fault: Fault | None, chain: Chain, said: tuple[str, ...]) -> str:
    """Judge what was said of a chain with a fault, or without one."""
    if fault is None:
        return WRONG if said else "clean"
    if not said:
        return MISSED
    if any(expected(fault, chain) in sentence for sentence in said):
        return GROUPED if any("do not tell" in sentence for sentence in said) else NAMED
    return UNEXPLAINED if all(sentence.startswith("floors: no chain") for sentence in said) else WRONG


def rows_of(seed: int) -> list[Row]:
    """Draw a chain of a seed and judge it without a fault and with one."""
    random = np.random.default_rng(seed)
    plant = drawn_plant(random)
    rate, bits, latency = random.choice(RATES_HZ), int(random.choice(BITS)), int(random.integers(0, 9))
    noise = float(np.exp(random.uniform(*np.log(NOISE_M_S2))))
    chain = made_chain(plant, rate, bits, latency, seed, noise)
    hz = ", ".join(f"{value:.3g}" for value in plant.natural_hz())
    about = f"{rate:.0f} Hz, {bits} bits, latency {latency}, {plant.coulomb_n:.2g} N, modes {hz} Hz"
    rows = []
    for fault in (None, drawn_fault(random, len(chain.info.channels))):
        tried = chain if fault is None else injected(chain, fault)
        said = said_of(tried)
        named = "" if fault is None else f"{fault.kind} {fault.channels} {fault.factor:.3f}"
        rows.append(Row(seed, about, named, said, outcome(fault, tried, said)))
    return rows


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--output", type=Path)
    options = parsed(parser, SHORT)
    tally: dict[str, Counter[str]] = {}
    for seed in range(options.seed, options.seed + options.count):
        for row in rows_of(seed):
            tally.setdefault(row.fault.split(" ")[0] or "no fault", Counter())[row.outcome] += 1
            if options.output:
                with options.output.open("a") as file:
                    file.write(json.dumps(asdict(row)) + "\n")
            if row.outcome in (WRONG, MISSED):
                print(f"{row.seed}: {row.outcome}: {row.fault or 'no fault'}; {row.about}; {row.said}", flush=True)
    for kind, counts in sorted(tally.items()):
        print(f"{kind:<9}", ", ".join(f"{name} {count}" for name, count in counts.most_common()))


if __name__ == "__main__":
    main()
