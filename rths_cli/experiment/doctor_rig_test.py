"""The part of `rths doctor` with a rig: time its exchange at rest, the command held at zero."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import RigError
from rths_cli.experiment.rig_access import EXP_RTHS, open_rig
from rths_cli.experiment.setup import make_setup
from rths_cli.files.rig_lock import locked_rig
from rths_cli.rigs.interface import LinkedRig, as_commands, linked, name_session
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.packets import COMMAND

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.doctor_command import ExchangeDelays
    from rths_cli.numerics.clock import IntArray
    from rths_cli.rigs.interface import Rig

HURRY = 0.5  # time that exchanges take over that of their sample instants, below which they wait for none


def exchange_delays(case: Case) -> ExchangeDelays:
    """Return a function that measures when the samples of each step arrive, for a rate in Hz and a duration in s.

    Its result (n,) is in ns after the step's deadline; for a rig with its own clock, relative to the earliest step.
    Raises InputError, RigError.
    """

    def measure(rate_hz: float, seconds: float) -> IntArray:
        rig = open_rig(make_setup(case.model_copy(update={"sample_rate_hz": rate_hz})), (EXP_RTHS,), 0)
        steps = max(round(seconds * rate_hz), 1)
        name_session(rig, "doctor")
        with locked_rig(rig.info.name):
            rig.open()
            try:
                rig.arm()
                there = linked(rig)
                return udp_delays(there, steps) if there is not None else paced_delays(rig, steps)
            finally:
                rig.rest()
                rig.close()

    return measure


def udp_delays(rig: LinkedRig, steps: int) -> IntArray:
    """Return the arrival (n,) of each step's answer in ns after its deadline; a lost one counts as an interval."""
    link, interval_ns = rig.link, round(1e9 * rig.info.dt_s)
    number = int(link.status[links.LAST] - link.status[links.BASE]) + 1
    late_ns = np.zeros(steps, dtype=np.int64)
    deadline = time.monotonic_ns() + interval_ns
    for k in range(steps):
        outcome = links.converse_at(link, COMMAND, number, 0.0, deadline, interval_ns)
        if outcome == links.FAULT:
            why = fault_names(int(link.status[links.FAULTS])) or "it obeys no commands"
            raise RigError(f"rig {rig.info.name}: the target {rig.peer} stopped: {why}")
        late_ns[k] = link.status[links.RECEIVED_NS] - deadline if outcome == links.OK else interval_ns
        passed = 1 + int(late_ns[k]) // interval_ns
        number, deadline = number + passed, deadline + interval_ns * passed
    return late_ns


def paced_delays(rig: Rig, steps: int) -> IntArray:
    """Return the delay (n,) of each exchange in ns against an even pace, relative to the earliest one.

    Raises RigError for a rig whose exchanges do not wait for their sample instants.
    """
    returned, resting = np.zeros(steps, dtype=np.int64), as_commands(np.zeros(rig.info.actuators))
    for k in range(steps):
        rig.exchange(resting)
        returned[k] = time.monotonic_ns()
    took_s, wanted_s = 1e-9 * float(returned[-1] - returned[0]), (steps - 1) * rig.info.dt_s
    if took_s < HURRY * wanted_s:
        raise RigError(
            f"rig {rig.info.name}: {steps - 1} exchanges took {took_s:.3g} s, not the {wanted_s:.3g} s of their sample "
            "instants: exchange does not wait for the next one. Have it wait for the rig's clock; the class of a "
            "simulated rig, which counts its steps, says so by COUNTED_CLOCK among its offers"
        )
    late = returned - np.round(np.arange(steps) * (1e9 * rig.info.dt_s)).astype(np.int64)
    return np.asarray(late - late.min())
