"""The work of `rths doctor`: the sample rates that this machine and a rig on it hold."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.files.machine_rates import LATE_SHARE, P99_SHARE, RateMeasured, delay_summary, keep_rates
from rths_cli.loop.scheduling import PUNCTUAL, Granted, isolated_cpus, real_time, wait_periodically, wake_up_delays
from rths_cli.numerics.clock import IntArray, require_real_time

SYS, PROC = Path("/sys"), Path("/proc")
UNLIMITED = -1

RATES_HZ = (500.0, 1000.0, 2000.0, 4000.0)  # tried where no case states its rate
RULE = (
    f"a rate is held when 99 % of the steps wake up within {PUNCTUAL:g} of a sample interval ({P99_SHARE:g} for rigs "
    f"that catch no steps up), have a rig's samples within {P99_SHARE:g}, and at most {100.0 * LATE_SHARE:.1f} % are "
    "late by a whole one"
)
Progress = Callable[[str], object]
ExchangeDelays = Callable[[float, float], IntArray]


@dataclass(frozen=True)
class Machine:
    """Properties of the system; an empty text: not known."""

    kernel: str  # release
    preemption: str  # preemption model of the kernel
    virtual: bool  # whether it is a virtual machine
    cpus: int  # number of processors that this process may use
    isolated_cpus: tuple[int, ...]  # their numbers
    governor: str  # frequency governors of the processors
    clock_source: str
    rtprio_limit: int  # of this user, -1: unlimited
    memlock_limit_bytes: int  # of this user, -1: unlimited
    rt_runtime_us: int  # time that SCHED_FIFO threads may use in every `rt_period_us`, -1: all of it
    rt_period_us: int


def this_machine() -> Machine:
    """Return the properties of this machine (Linux)."""
    import resource

    return Machine(
        kernel=platform.release(),
        preemption=preemption(),
        virtual=" hypervisor" in _text(PROC / "cpuinfo"),
        cpus=len(os.sched_getaffinity(0)),
        isolated_cpus=tuple(sorted(isolated_cpus())),
        governor=governor(),
        clock_source=_text(SYS / "devices/system/clocksource/clocksource0/current_clocksource"),
        rtprio_limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0],
        memlock_limit_bytes=resource.getrlimit(resource.RLIMIT_MEMLOCK)[0],
        rt_runtime_us=int(_text(PROC / "sys/kernel/sched_rt_runtime_us") or UNLIMITED),
        rt_period_us=int(_text(PROC / "sys/kernel/sched_rt_period_us") or UNLIMITED),
    )


def preemption() -> str:
    """Return the preemption model of the kernel."""
    if _text(SYS / "kernel/realtime") == "1" or "PREEMPT_RT" in platform.version():
        return "PREEMPT_RT"
    modes = _text(SYS / "kernel/debug/sched/preempt")  # for instance: none voluntary (full) lazy
    chosen = modes.partition("(")[2].partition(")")[0] or _start_option("preempt")
    model = next((word for word in platform.version().split() if word.startswith("PREEMPT")), "none stated")
    return f"{model}, {chosen}" if chosen else model


def governor() -> str:
    """Return the frequency governors of all processors; most virtual machines have none."""
    paths = (SYS / "devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return ", ".join(sorted({_text(path) for path in paths}))


def _start_option(name: str) -> str:
    words = [word.partition("=") for word in _text(PROC / "cmdline").split()]
    return next((value for key, _, value in words if key == name), "")


def _text(path: Path) -> str:
    """Return the text of a system file, "" if it does not exist."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""


@dataclass(frozen=True)
class RigRates:
    """Measurements of a rig's exchange, from wake-up to samples."""

    rig: str
    rates: tuple[RateMeasured, ...]


@dataclass(frozen=True)
class Examined:
    """The complete result of `rths doctor`; `wanted_hz` are the rates that decide its exit code."""

    machine: Machine
    granted: Granted
    rates: tuple[RateMeasured, ...]
    rig: RigRates | None
    wanted_hz: tuple[float, ...]
    advice: tuple[str, ...]
    rule: str = RULE
    counted: str = ""  # the rig whose clock is counted: no rate has to be held

    @property
    def recommended_hz(self) -> float | None:
        """Return the highest rate that was held, also by the rig if one was measured."""
        return max((rate.rate_hz for rate in self._deciding() if rate.held), default=None)

    @property
    def not_held_hz(self) -> tuple[float, ...]:
        """Return the requested rates that were not held."""
        bad = [rate.rate_hz for rate in (*self.rates, *self._deciding()) if not rate.held]
        return tuple(hz for hz in self.wanted_hz if hz in bad)

    @property
    def exit_code(self) -> int:
        """Return 1 if a requested rate, or without one every rate, was not held."""
        if self.counted:
            return 0
        return 1 if self.not_held_hz or self.recommended_hz is None else 0

    def _deciding(self) -> tuple[RateMeasured, ...]:
        """Return the rates of the rig that the machine alone held; without a rig, those of the machine."""
        if self.rig is None:
            return self.rates
        held = [rate.rate_hz for rate in self.rates if rate.held]
        return tuple(rate for rate in self.rig.rates if rate.rate_hz in held)


def examine(
    rates_hz: Sequence[float],
    wanted_hz: Sequence[float],
    seconds: float,
    say: Progress,
    rig: str = "",
    exchange: ExchangeDelays | None = None,
    share: float = PUNCTUAL,
) -> Examined:
    """Measure each rate for `seconds`, first on the machine alone, then with a rig's `exchange`, and store the results.

    `share`: fraction of an interval within which 99 % of the steps must wake up (`wake_share`).
    Raises InputError if real time is not possible, RigError if the rig fails.
    """
    require_real_time()
    wait_periodically(1000, 0, np.zeros(1, dtype=np.int64), np.zeros(2, dtype=np.int64))  # compiled before it counts
    every = sorted({*rates_hz, *wanted_hz})
    with real_time() as granted:
        rates = [_measured(hz, seconds, wake_up_delays, share, say, "waking up") for hz in every]
        keep_rates(rates)
        what, asked = f"exchanging with {rig}", [] if exchange is None else [(hz, exchange) for hz in every]
        of_rig = [_measured(hz, seconds, delays, P99_SHARE, say, what) for hz, delays in asked]
    keep_rates(of_rig, rig)
    machine = this_machine()
    found = RigRates(rig, tuple(of_rig)) if exchange else None
    return Examined(machine, granted, tuple(rates), found, tuple(wanted_hz), advice(machine, granted, rates, of_rig))


def of_counted_rig(rig: str) -> Examined:
    """Return the result for a rig whose clock is counted, which asks for nothing that only real time can give."""
    return Examined(this_machine(), Granted(False, 0, -1, False, ()), (), None, (), (), counted=rig)


def _measured(
    hz: float, seconds: float, delays: ExchangeDelays, share: float, say: Progress, what: str
) -> RateMeasured:
    say(f"{what} at {hz:g} Hz, {seconds:g} s")
    return delay_summary(hz, delays(hz, seconds), share)


def advice(
    machine: Machine, granted: Granted, rates: Sequence[RateMeasured], of_rig: Sequence[RateMeasured] = ()
) -> tuple[str, ...]:
    """Return one sentence for each setting that would reduce the delays of this machine, or that endangers a test."""
    told = list(granted.refused)
    if machine.preemption != "PREEMPT_RT":
        told.append(f"the kernel is not a real-time one ({machine.preemption}): install one built with PREEMPT_RT")
    if machine.virtual:
        told.append(_of_virtual_machine(rates, of_rig))
    if machine.governor not in ("", "performance"):
        told.append(f"the frequency governor is {machine.governor}: run 'cpupower frequency-set -g performance'")
    if granted.cpu >= 0 and granted.cpu not in machine.isolated_cpus:
        told.append(f"processor {granted.cpu} serves other threads too: start the kernel with isolcpus={granted.cpu}")
    longest = max(rates, key=lambda rate: rate.max_us)
    if longest.max_us * longest.rate_hz > 1e6:
        told.append(
            f"the longest stall was {longest.max_us / 1e3:.1f} ms: a table would hold its command for "
            f"{longest.max_us * longest.rate_hz / 1e6:.0f} samples at {longest.rate_hz:g} Hz"
        )
    return tuple(told)


def _of_virtual_machine(rates: Sequence[RateMeasured], of_rig: Sequence[RateMeasured]) -> str:
    """Return a sentence on the effect of a virtual machine's host on these rates, with a remedy."""
    late = sum(rate.late for rate in rates)
    seconds = sum(rate.steps / rate.rate_hz for rate in rates)
    missed = {rate.rate_hz for rate in of_rig if not rate.held}
    held = max((rate.rate_hz for rate in rates if rate.held and rate.rate_hz not in missed), default=None)
    steps = f"{late or 'no'} step{'s were' if late != 1 else ' was'}"
    seen = f"in {seconds:.3g} s {steps} late by an interval{'' if late else ', so nothing was seen of it'}"
    advice = f"use a real one, or stay at {held:g} Hz or below, which was held" if held else "use a real one"
    virtual = "this is a virtual machine, whose host may take the processor away at any time"
    return f"{virtual}; {seen}{f'; {advice}' if late else ''}"
