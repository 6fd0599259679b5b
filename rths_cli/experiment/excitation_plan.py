"""The planned excitation of a case's rig; a check judges it without the code that measures and evaluates it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.identification import excitation
from rths_cli.identification.excitation import ExcitationSettings
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import ComparedBand

if TYPE_CHECKING:
    from rths_cli.case.case_schema import IdentificationSpec
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.excitation import Excitation

PERIOD_S = {"multisine": 20.0, "sweep": 40.0}  # longer where the compared band begins below the usual 0.7 Hz


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
