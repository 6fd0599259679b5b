"""What decides how punctual this machine can be: kernel, processors, governor, limits."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

from rths_cli.loop.scheduling import isolated_cpus

SYS, PROC = Path("/sys"), Path("/proc")
UNLIMITED = -1


@dataclass(frozen=True)
class Machine:
    """What the system says of itself; an empty text: it does not say.

    `rtprio_limit` and `memlock_limit_bytes` are this user's, -1 for unlimited; `rt_runtime_us` of every `rt_period_us`
    may be taken by SCHED_FIFO threads, -1 for all.
    """

    kernel: str
    preemption: str
    virtual: bool
    cpus: int
    isolated_cpus: tuple[int, ...]
    governor: str
    clock_source: str
    rtprio_limit: int
    memlock_limit_bytes: int
    rt_runtime_us: int
    rt_period_us: int


def this_machine() -> Machine:
    """Return what this machine says of itself (Linux)."""
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
    """Return how the kernel lets go of what it does when a thread of higher priority wakes up."""
    if _text(SYS / "kernel/realtime") == "1" or "PREEMPT_RT" in platform.version():
        return "PREEMPT_RT"
    modes = _text(SYS / "kernel/debug/sched/preempt")  # for instance: none voluntary (full) lazy
    chosen = modes.partition("(")[2].partition(")")[0] or _start_option("preempt")
    model = next((word for word in platform.version().split() if word.startswith("PREEMPT")), "none stated")
    return f"{model}, {chosen}" if chosen else model


def governor() -> str:
    """Return the frequency governors of all processors, most processors of virtual machines have none."""
    paths = (SYS / "devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return ", ".join(sorted({_text(path) for path in paths}))


def _start_option(name: str) -> str:
    words = [word.partition("=") for word in _text(PROC / "cmdline").split()]
    return next((value for key, _, value in words if key == name), "")


def _text(path: Path) -> str:
    """Return what a file of the system says, nothing where it is not there."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""
