"""Cases at the ends of all documented ranges, drawn at random.

The ranges are those of docs/reference/case.md and rig.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[3]
NEAR_ZERO = (1e-300, 1e-9, 1e-3)  # ends of a range that excludes zero
STOREYS = (1, 2, 5, 200)
MOST_PAYLOAD_KG = 1e6  # that a table may carry
PLAIN = 0.75  # share of the keys that keep a usual value
RECORD_SAMPLES = (3, 500, 3000, 30_000)
RIG_KEYS = ("sensors.", "converters.", "limits.", "nominal.", "physics.", "after_identification.")
RANGE = re.compile(r"([\[(])([-+.e0-9]+),(?: ([-+.e0-9]+)([\])]))?")
Random = np.random.Generator


def documented(page: str, kind: str = "") -> dict[str, str]:
    """Return the range of each number a reference page documents, of one kind of rig where there are several."""
    text = (ROOT / "docs" / "reference" / page).read_text(encoding="utf-8")
    if kind:
        parts = re.split(r"^## ", text, flags=re.MULTILINE)
        text = "\n".join(part for part in parts if part.startswith(("Every kind", f"Kind `{kind}`")))
    rows = re.findall(r"^- `([^`]+)` (.*?): ", text, re.MULTILINE)
    return {key: found[0] for key, value in rows if (found := RANGE.search(value))}


def an_end(limits: str, random: Random, whole: bool = False) -> float:
    """Return one end of a documented range."""
    found = RANGE.search(limits)
    assert found is not None
    opening, low_end, high_end, closing = found.groups()
    low = float(low_end) if opening == "[" else float(random.choice(NEAR_ZERO))
    high = 1.0 - 1e-9 if high_end is None else float(high_end) * (1.0 if closing == "]" else 1.0 - 1e-9)
    value = low if random.random() < 0.5 else high
    return int(value) if whole else value


def drawn(random: Random, folder: Path) -> dict[str, Any]:
    """Draw a case; its record is written to the folder."""
    of_case = documented("case.md")

    def either(key: str, usual: float, whole: bool = False) -> float:
        return usual if random.random() < PLAIN else an_end(of_case[key], random, whole)

    def listed(key: str, usual: float, count: int) -> list[float]:
        if random.random() < 0.7:
            return [either(key, usual)] * count
        values = [usual] * count
        values[int(random.integers(count))] = an_end(of_case[key], random)
        return values

    p, n = (int(random.choice(STOREYS)) for _ in range(2))
    masses_kg = listed("structure.experimental.masses_kg", 0.1, n)
    if sum(masses_kg) > MOST_PAYLOAD_KG and random.random() < 0.9:  # that sentence is heard often enough
        masses_kg = [min(mass, 0.8 * MOST_PAYLOAD_KG / n) for mass in masses_kg]
    experimental: dict[str, Any] = {"masses_kg": masses_kg}
    if n <= 5 and random.random() < 0.3:
        ends = sorted({either("structure.experimental.natural_frequencies_hz", 3.0 * (i + 1)) for i in range(n)})
        experimental["natural_frequencies_hz"] = ends if len(ends) == n else [3.0 * (i + 1) for i in range(n)]
    else:
        experimental["stiffness_n_per_m"] = listed("structure.experimental.stiffness_n_per_m", 7e3, n)
    if random.random() < 0.5:
        experimental["damping_ratios"] = listed("structure.experimental.damping_ratios", 0.04, n)
    else:
        experimental["dashpots_n_s_per_m"] = listed("structure.experimental.dashpots_n_s_per_m", 8.0, n)
    masses = listed("structure.numerical.masses_kg", 7.0, p)
    structure: dict[str, Any] = {
        "numerical": {
            "masses_kg": masses,
            "stiffness_n_per_m": (
                "mean_of_experimental"
                if random.random() < 0.3
                else listed("structure.numerical.stiffness_n_per_m", 7e3, p)
            ),
        },
        "experimental": experimental,
        "interface_experimental_mass_kg": float(random.choice([0.0, 0.0, 0.5, 1.0 - 1e-9])) * masses[-1],
    }
    if random.random() < 0.3:
        damping: dict[str, Any] = {"first_mode_ratio": either("damping.first_mode_ratio", 0.03)}
    else:
        damping = {"dashpots_n_s_per_m": listed("damping.dashpots_n_s_per_m", 22.0, p)}
    rate = float(random.choice([either("sample_rate_hz", 2000.0), 2000.0, 20_000.0]))
    record = write_record(random, folder, float(random.choice([0.005, 0.02, 0.02, either("record.dt_s", 0.02)])))
    case: dict[str, Any] = {
        "structure": structure,
        "damping": damping,
        "record": record,
        "scaling": either("scaling", 0.3),
        "controller": str(random.choice(["FF", "FF+FB", "none"])),
        "integration": str(random.choice(["exact", "cr", "newmark"])),
        "method": str(random.choice(["best", "paper"])),
        "runs": ["sim", "sim_delay"],
        "sample_rate_hz": rate,
        "delay_s": either("delay_s", 0.005),
        "record_filter": {
            "corner_hz": 0.0 if random.random() < 0.5 else either("record_filter.corner_hz", 0.25),
            "order": either("record_filter.order", 2, whole=True),
        },
        "seed": either("seed", 0, whole=True),
        "identification": {"high_hz": min(60.0, 0.2 * rate)},
        "table": {"extends": "aps400_virtual", **drawn_rig(random)},
    }
    return case


def write_record(random: Random, folder: Path, dt_s: float) -> dict[str, Any]:
    """Write a record of random length, white and at rest at its start; return the mapping of a case that names it."""
    series = random.normal(size=int(random.choice(RECORD_SAMPLES)))
    series[0] = 0.0
    np.savetxt(folder / "record.txt", series, fmt="%.4f")
    return {"file": str(folder / "record.txt"), "unit": "m/s^2", "dt_s": dt_s}


def drawn_rig(random: Random) -> dict[str, Any]:
    """Draw the keys of a virtual rig; it carries any specimen, or most cases were refused for their weight."""
    rig: dict[str, Any] = {}
    for key, limits in documented("rig.md", "virtual").items():
        if key.startswith(RIG_KEYS) and random.random() > PLAIN:
            whole = key in ("converters.bits", "converters.latency_samples", "limits.lost_samples")
            part, name = key.split(".")
            rig.setdefault(part, {})[name] = an_end(limits, random, whole)
    rig.setdefault("nominal", {})["payload_kg"] = MOST_PAYLOAD_KG
    return rig
