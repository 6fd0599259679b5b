"""The file of sample rates measured on this machine: `rths doctor` writes it, `rths run` reads it."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.clock import IntArray
from rths_cli.user_cache import user_cache

LATE_SHARE = 5e-3  # of the steps, that may be late by a whole interval or lost
P99_SHARE = 0.5  # of an interval, within which 99 % of the steps have their samples


@dataclass(frozen=True)
class RateMeasured:
    """How late the steps of one rate were ready.

    On the machine alone: the wake-up delay. On a rig: wake-up and exchange, until its samples are there.
    `late`: steps ready a whole interval after their deadline or later, or whose samples were lost; `missed`: whole
    intervals that passed in them. `share`: of an interval, within which 99 % of the steps must be ready.
    """

    rate_hz: float
    steps: int
    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float
    late: int
    missed: int
    measured_utc: str
    share: float = P99_SHARE

    @property
    def held(self) -> bool:
        """Tell whether the rate was held."""
        return self.late <= LATE_SHARE * self.steps and self.p99_us <= self.share * 1e6 / self.rate_hz


def keep_rates(rates: Iterable[RateMeasured], rig: str = "") -> None:
    """Keep measured rates of this machine, or of a rig on it; each replaces what was kept of the same rate.

    A cache that cannot be written is no fault.
    """
    everything = _read()
    kept = everything.setdefault(_place(rig), {})
    kept.update({f"{rate.rate_hz:g}": asdict(rate) for rate in rates})
    path = _path()
    part = path.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(everything, indent=1), encoding="utf-8")
        os.replace(part, path)


def held_rate(rate_hz: float, rig: str = "") -> RateMeasured | None:
    """Return what was last measured here at a rate, or at the next higher rate that was held; None: nothing was.

    `rig`: the name of a rig, empty for the machine alone. Measurements under another kernel do not count.
    """
    rates = {}
    for entry in _read().get(_place(rig), {}).values():
        with suppress(TypeError):  # another version's
            rate = RateMeasured(**entry)
            rates[rate.rate_hz] = rate
    higher = [rates[hz] for hz in sorted(rates) if hz > rate_hz and rates[hz].held]
    return rates.get(rate_hz) or next(iter(higher), None)


def _path() -> Path:
    return user_cache() / "held_rates.json"


def _place(rig: str) -> str:
    return f"{platform.node()} {platform.release()} {rig}".rstrip()


def _read() -> dict[str, dict[str, Any]]:
    """Return everything kept, nothing where the file is missing or damaged."""
    try:
        data = json.loads(_path().read_text(encoding="utf-8"))
    except (OSError, ValueError, InputError):
        return {}
    sound = isinstance(data, dict) and all(isinstance(rates, dict) for rates in data.values())
    return data if sound else {}


def delay_summary(rate_hz: float, late_ns: IntArray, share: float) -> RateMeasured:
    """Return the statistics of a measurement of delays (n,) in ns; a lost answer counts as late.

    `share`: fraction of an interval within which 99 % of the steps must be ready for the rate to be held.
    """
    interval_ns = round(1e9 / rate_hz)
    p50, p99, p99_9, most = (float(q) / 1e3 for q in np.percentile(late_ns, [50, 99, 99.9, 100]))
    whole = late_ns // interval_ns
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return RateMeasured(
        rate_hz, late_ns.size, p50, p99, p99_9, most, int(np.count_nonzero(whole)), int(whole.sum()), now, share
    )
