"""Options of `rths doctor`: the case whose rate is asked for, and the rig to measure."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rths_cli.errors import InputError
from rths_cli.laboratory.doctor import RATES_HZ, Examined, Progress, examine, of_counted_rig
from rths_cli.loop.scheduling import wake_share
from rths_cli.rigs.description import capabilities_of

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup
    from rths_cli.laboratory.doctor_rig import ChannelsExamined
    from rths_cli.laboratory.watchdog_proof import WatchdogTrial

DEFAULT_CASE = "el_centro_low_ff_fb"  # lends its structure where only a rig was named


@dataclass(frozen=True)
class DoctorRequest:
    """Arguments of `rths doctor`."""

    case: str | None  # case whose sample rate and rig are measured; None: no case
    rig: str | None  # rig to measure; None: that of the case, if any
    rates_hz: tuple[float, ...]  # (): the rate of the case, or RATES_HZ without a case
    seconds: float  # duration of the measurement of each rate
    settings: tuple[str, ...]  # KEY=VALUE each


def examine_request(
    request: DoctorRequest, say: Progress, permit: Callable[[Setup], None] = lambda _: None
) -> Examined:
    """Measure the machine, and the real rig if a rig or case with one is named; raises InputError or RigError.

    `permit` is called before a rig is armed and refuses by raising InputError.
    """
    wanted = request.rates_hz
    if request.case is None and request.rig is None:
        if request.settings:
            raise InputError("--set changes a case: name one, or leave it out")
        return examine(() if wanted else RATES_HZ, wanted, request.seconds, say)
    from rths_cli.case.load import load_cases

    table = (f"table={json.dumps(request.rig)}",) if request.rig else ()
    typed = dict.fromkeys(table, f"--rig {request.rig}")
    case = load_cases([request.case or DEFAULT_CASE], (*table, *request.settings), typed)[0]
    if request.case and not wanted:
        wanted = (case.sample_rate_hz,)
    others = () if wanted else RATES_HZ
    if capabilities_of(case.table.kind).counts_steps:
        if request.rig:
            raise InputError(
                f"--rig {request.rig}: a virtual rig has no clock of its own to hold; start it with "
                f"'rths serve {request.rig}' and name a rig of kind udp"
            )
        return examine(others, wanted, request.seconds, say)
    from rths_cli.experiment.real_rig_readiness import EXP_RTHS, listened, open_rig
    from rths_cli.experiment.setup import make_setup
    from rths_cli.laboratory.doctor_rig import exchange_delays
    from rths_cli.rigs.interface import counts_time

    setup = make_setup(case)
    permit(setup)
    rig = open_rig(setup, (EXP_RTHS,), 0)
    if counts_time(rig):
        listened(setup, rig)
        return of_counted_rig(case.table.name)
    delays, share = exchange_delays(case), wake_share(setup.rig)
    return examine(others, wanted, request.seconds, say, case.table.name, delays, share)


def watchdog_request(
    request: DoctorRequest, say: Progress, permit: Callable[[Setup], None] = lambda _: None
) -> WatchdogTrial:
    """Prove the watchdog of the rig of a case, or of a rig with the structure of a shipped case; raises InputError or
    RigError. `permit` as in `examine_request`."""
    from rths_cli.laboratory.watchdog_proof import prove_watchdog

    setup = _of_rig(request, "--watchdog", "the watchdog is proven")
    permit(setup)
    return prove_watchdog(setup, say)


def _of_rig(request: DoctorRequest, option: str, done: str) -> Setup:
    """Return the setup of the rig that an option needs; raises InputError without one, and where a rate is stated."""
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.setup import make_setup

    if request.case is None and request.rig is None:
        raise InputError(f"{option}: name the rig by --rig FILE, or a case with one")
    if request.rates_hz:
        raise InputError(f"--rate: {done} at the rate of the case; leave it out")
    table = (f"table={json.dumps(request.rig)}",) if request.rig else ()
    typed = dict.fromkeys(table, f"--rig {request.rig}")
    return make_setup(load_cases([request.case or DEFAULT_CASE], (*table, *request.settings), typed)[0])


def channels_request(
    request: DoctorRequest,
    moves: bool,
    push: Callable[[], object] | None,
    say: Progress,
    permit: Callable[[Setup], None] = lambda _: None,
) -> ChannelsExamined:
    """Examine the channels of the rig of a case, or of a rig with the structure of a shipped case; raises InputError or
    RigError. `moves` and `push` as in `examine_channels`; `permit` as in `examine_request`."""
    from rths_cli.laboratory.doctor_rig import examine_channels

    setup = _of_rig(request, "--channels", "the channels are examined")
    permit(setup)
    return examine_channels(setup, request.seconds, moves, push, say)
