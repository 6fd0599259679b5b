"""The output of `rths doctor`, as text and with `--json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rths_cli.report.document import Block, Line, Table, Verdict, grid, labelled, labelled_lines, verdict_line
from rths_cli.report.numbers import DASH
from rths_cli.report.to_text import text

if TYPE_CHECKING:
    from rths_cli.files.machine_rates import RateMeasured
    from rths_cli.laboratory.doctor import Examined, Machine
    from rths_cli.laboratory.doctor_rig import ChannelsExamined
    from rths_cli.laboratory.watchdog_proof import WatchdogTrial
    from rths_cli.loop.scheduling import Granted

HEADINGS = ("rate, Hz", "p50", "p99", "p99.9", "max", "late", "missed", "held")


def verdict(found: Examined) -> str:
    """Return in one sentence whether the rates that have to be held are held, and the highest one that is."""
    if found.counted:
        return f"HELD: {found.counted} counts its steps: it was listened to at rest, and no rate has to be held"
    best = found.recommended_hz
    up_to = f"at most {best:g} Hz is held here" if best else "no rate is held here"
    if found.not_held_hz:
        return f"NOT HELD: {_listed(found.not_held_hz)}; {up_to}"
    return f"HELD: {_listed(found.wanted_hz)}; {up_to}" if found.wanted_hz else f"{'' if best else 'NOT '}HELD: {up_to}"


def page(found: Examined) -> str:
    """Return the result of `rths doctor` as text: verdict and rule, rates, what would help, the machine."""
    if found.counted:
        return text([[verdict_line(verdict(found))]])
    sections: list[list[Block]] = [[verdict_line(verdict(found)), labelled("rule", found.rule)]]
    sections.append([Line(f"Wake-up delay in us, {_duration(found.rates)}"), table(found.rates)])
    if found.rig:
        title = f"Until samples of {found.rig.rig} are there, in us after the deadline, {_duration(found.rig.rates)}"
        sections.append([Line(title), table(found.rig.rates)])
    machine = [*_machine(found.machine, found.granted), _granted(found.granted)]
    return text([*sections, labelled_lines("to do better", found.advice), machine])


def _listed(rates_hz: Sequence[float]) -> str:
    return ", ".join(f"{hz:g} Hz" for hz in rates_hz)


def document(found: Examined) -> dict[str, Any]:
    """Return the result of `rths doctor` as a document for JSON."""
    rig = found.rig
    return {
        "machine": asdict(found.machine),
        "granted": asdict(found.granted),
        "rates": [_entry(rate) for rate in found.rates],
        "rig": {"name": rig.rig, "rates": [_entry(rate) for rate in rig.rates]} if rig else None,
        "rule": found.rule,
        "wanted_hz": list(found.wanted_hz),
        "not_held_hz": list(found.not_held_hz),
        "recommended_hz": found.recommended_hz,
        "counted_rig": found.counted,
        "advice": list(found.advice),
        "verdict": verdict(found),
        "exit_code": found.exit_code,
    }


OF_CHANNEL = ("channel", "kind", "unit", "use", "zero, V", "zero", "noise rms", "range")
COMPARED = ("channel", "against", "ratio", "phase, deg", "permitted", "")
SIGNS = {1: "+", -1: "-", 0: "none"}


def channels_verdict(found: ChannelsExamined) -> str:
    """Return in one sentence how many channels are at rest and agree."""
    told = f"{len(found.rows)} channels of {found.rig}, {found.seconds:g} s at rest"
    if wrong := _wrong(found):
        return f"NOT AS DECLARED: {len(wrong)} fault{'s' if len(wrong) > 1 else ''}; {told}"
    agree = f"; {len(found.comparisons)} comparisons agree" if found.comparisons else ""
    return f"AS DECLARED: {told}{agree}"


def _wrong(found: ChannelsExamined) -> list[str]:
    disagree = [f"{one.channel}: {one.told} ({one.against})" for one in found.comparisons if not one.agrees]
    return [*found.faults, *disagree]


def channels_page(found: ChannelsExamined) -> str:
    """Return the result of `rths doctor --channels` as text: verdict and faults, then the channels."""
    pushed = any(row.pushed is not None for row in found.rows)
    rows = [
        (row.name, row.kind, row.unit, row.uses, f"{row.zero_v:.4g}", f"{row.zero:.4g}", f"{row.noise:.3g}",
         f"{row.range:.4g}", *((SIGNS[row.pushed or 0],) if pushed else ()))
        for row in found.rows
    ]  # fmt: skip
    heads = (*OF_CHANNEL, *(("push",) if pushed else ()))
    sections: list[list[Block]] = [
        [verdict_line(channels_verdict(found)), *labelled_lines("faults", _wrong(found))],
        [Line("Channels at rest"), grid([heads, *rows])],
    ]
    if found.comparisons:
        lines = [
            (one.channel, one.against, f"{one.ratio:.4f}", f"{one.phase_deg:.1f}" if one.has_phase else DASH,
             f"{one.permitted:.3f}", one.told)
            for one in found.comparisons
        ]  # fmt: skip
        title = "Shown over what it must show, in a slow motion of the table"
        sections.append([Line(title), grid([COMPARED, *lines])])
    if pushed:
        told = "after a push in the positive direction: + of accelerations, displacements and strains, - of a load cell"
        sections.append([labelled("push", told)])
    return text(sections)


def channels_document(found: ChannelsExamined) -> dict[str, Any]:
    """Return the result of `rths doctor --channels` as a document for JSON."""
    compared = [{**asdict(one), "agrees": one.agrees, "told": one.told} for one in found.comparisons]
    ends = {"verdict": channels_verdict(found), "exit_code": found.exit_code}
    return {**asdict(found), "comparisons": compared, **ends}


def watchdog_verdict(found: WatchdogTrial) -> str:
    """Return in one sentence whether a target's watchdog is proven."""
    if found.faults:
        return f"NOT PROVEN: the watchdog of {found.rig}: {found.faults[0]}"
    return f"PROVEN: the watchdog of {found.rig} leads its table to rest; kept for this rig file"


def watchdog_page(found: WatchdogTrial) -> str:
    """Return the result of `rths doctor --watchdog` as text: verdict and faults, then what the target's frames told."""
    times = ((found.left_s, "obeyed no longer"), (found.rested_s, "at rest, output 0"))
    told = [
        labelled("moved", f"to an output of {found.moved_v:.4g} V, then silent; watchdog_s is {found.watchdog_s:g}"),
        *(labelled(what, DASH if s is None else f"{s:.3g} s after the last command") for s, what in times),
        labelled("latency", f"{found.latency_samples:.3g} intervals, as the frames echo it"),
        *([labelled("proven", found.proof.proven_utc)] if found.proof else []),
    ]
    faults = labelled_lines("faults", found.faults[1:]) if len(found.faults) > 1 else []
    return text([[verdict_line(watchdog_verdict(found)), *faults], told])


def watchdog_document(found: WatchdogTrial) -> dict[str, Any]:
    """Return the result of `rths doctor --watchdog` as a document for JSON."""
    latency = found.latency_samples if math.isfinite(found.latency_samples) else None
    ends = {"verdict": watchdog_verdict(found), "exit_code": found.exit_code}
    return {**asdict(found), "latency_samples": latency, **ends}


def table(rates: Sequence[RateMeasured]) -> Table:
    """Return a row for each rate."""
    rows = []
    for r in rates:
        delays = (f"{us:.1f}" for us in (r.p50_us, r.p99_us, r.p99_9_us, r.max_us))
        rows.append((f"{r.rate_hz:g}", *delays, str(r.late), str(r.missed), Verdict("yes" if r.held else "no")))
    return grid([HEADINGS, *rows])


def _entry(rate: RateMeasured) -> dict[str, Any]:
    return {**asdict(rate), "held": rate.held}


def _duration(rates: Sequence[RateMeasured]) -> str:
    return f"{rates[0].steps / rates[0].rate_hz:g} s each"


def _machine(machine: Machine, granted: Granted) -> list[Block]:
    kind = ", virtual machine" if machine.virtual else ""
    isolated = ", ".join(map(str, machine.isolated_cpus)) or "none"
    return [
        labelled("kernel", f"{machine.kernel}, {machine.preemption}{kind}"),
        labelled("processors", f"{machine.cpus}, isolated: {isolated}; governor: {machine.governor or 'none visible'}"),
        labelled("clock", machine.clock_source or "not stated"),
        labelled(
            "limits",
            f"rtprio {_rtprio(machine, granted)}, memlock {_limit(machine.memlock_limit_bytes, ' bytes')}, "
            f"real-time threads {_throttle(machine)}",
        ),
    ]


def _rtprio(machine: Machine, granted: Granted) -> str:
    """Return the limit of real-time priorities in words; a privileged user is not bound by it."""
    limit = _limit(machine.rtprio_limit, "")
    return f"{limit} (does not bind this user)" if 0 <= machine.rtprio_limit < granted.fifo_priority else limit


def _limit(value: int, unit: str) -> str:
    return "unlimited" if value < 0 else f"{value}{unit}"


def _throttle(machine: Machine) -> str:
    if machine.rt_runtime_us < 0:
        return "may use all of a core"
    return (
        f"may use {100.0 * machine.rt_runtime_us / machine.rt_period_us:.3g} % of a core (kernel.sched_rt_runtime_us)"
    )


def _granted(granted: Granted) -> Line:
    given = [
        f"SCHED_FIFO {granted.fifo_priority}" if granted.fifo_priority else "",
        f"processor {granted.cpu}" if granted.cpu >= 0 else "",
        "memory locked" if granted.memory_locked else "",
        "processors kept awake" if granted.cpu_latency_held else "",
    ]
    return labelled("granted", ", ".join(filter(None, given)) or "nothing")
