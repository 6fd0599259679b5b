"""The lowest frequency at which AC-coupled accelerometers are reliable; errors are evaluated above it
(`high_pass_hz`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup

RECORD_SHARE = 0.4  # fraction of the record filter's corner, at which a 2-pole filter leaves 16 % of the ground motion
USUAL_HZ = 0.1  # upper limit of that term: buildings also move below a higher corner of the record filter
COUPLING_SHARE = 1.0 / 3.0  # fraction of an AC coupling's corner, at which its correction amplifies 3 times
HIGHEST_SHARE = 0.1  # largest fraction of the sample rate


def lowest_reliable_hz(setup: Setup) -> float:
    """Return the corner in Hz of the zero-phase high pass with which the errors of a case are evaluated.

    It is the largest of 0.4 times the corner of the record's filter, at most 0.1 Hz (the ground hardly moves below), a
    third of the highest corner of the accelerometers' AC coupling, and one period in the record.
    """
    ground = min(RECORD_SHARE * setup.case.record_filter.corner_hz, USUAL_HZ)
    coupling = COUPLING_SHARE * max(channel.high_pass_hz for channel in setup.rig.channels)
    length = 1.0 / (len(setup.motion.time_s) * setup.rig.dt_s)
    return min(max(ground, coupling, length), HIGHEST_SHARE / setup.rig.dt_s)
