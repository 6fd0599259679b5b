"""The planned excitation of a case's rig, and its check before it is played.

An excitation's command on the declared table is judged: no loop is closed in an excitation. The nominal gain gives
displacement, with the room to brake, velocity and command. Acceleration and force depend on the table's response: the
probe is limited by their nominal values and shows what the full level makes of them
(identification/low_level_probe.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from rths_cli.analysis.stability_check import faults_of_reach, reach_of_series
from rths_cli.identification import excitation
from rths_cli.identification.excitation import ExcitationSettings
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import ComparedBand

if TYPE_CHECKING:
    from rths_cli.analysis.stability_check import Reach
    from rths_cli.case.case_schema import IdentificationSpec
    from rths_cli.experiment.setup import Setup
    from rths_cli.findings import Finding
    from rths_cli.identification.excitation import Excitation
    from rths_cli.numerics.lti import Array

PERIOD_S = {"multisine": 20.0, "sweep": 40.0}  # longer where the compared band begins below the usual 0.7 Hz

BY_COMMAND = "displacement_m", "velocity_m_s", "command_v"
SMOOTH = 1.2  # times the highest excited frequency, above which a command holds nothing but its rounding


def excitation_settings(options: IdentificationSpec) -> ExcitationSettings:
    """Return the settings of the excitation that a case requests."""
    o, compared = options, ComparedBand(*options.compared_hz)
    usual_s = PERIOD_S.get(options.excitation, 20.0) / min(compared.with_low(1.0), 1.0)
    return ExcitationSettings(
        o.duration_s, o.accel_rms_m_s2, o.low_hz, o.high_hz, o.excitation, options.period_s or usual_s, compared
    )


def plan(setup: Setup) -> Excitation:
    """Return the planned excitation of the case's rig; raises InputError if its settings cannot be met."""
    options = setup.case.identification
    return interruptible(lambda: excitation.plan(setup.rig, excitation_settings(options), options.seed))


def excitation_reach(setup: Setup, command_v: Array) -> tuple[Reach, ...]:
    """Return the peaks that a command (n,) in V makes on the declared table, with their limits."""
    rig, samples = setup.rig, len(command_v)
    frequency = rfftfreq(samples, rig.dt_s)
    lines = rfft(command_v) * (frequency <= SMOOTH * setup.case.identification.high_hz)
    rate = irfft(2j * np.pi * frequency * lines, samples)
    still = np.zeros((len(rig.channels), samples))
    rows = reach_of_series(command_v, rate, still, 0.0, rig, np.zeros(len(rig.channels)), False)
    return tuple(row for row in rows if row.name in BY_COMMAND)


def excitation_faults(setup: Setup, command_v: Array) -> tuple[Finding, ...]:
    """Return why an excitation with this command (n,) in V must not be played."""
    return faults_of_reach(excitation_reach(setup, command_v))
