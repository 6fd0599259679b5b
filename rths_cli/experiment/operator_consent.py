"""Ask a person before a real table moves: the checklist, `--yes`, `unattended: true`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.experiment.setup import Setup, placed
from rths_cli.experiment.unit_plausibility import doubts
from rths_cli.quantities import Interval
from rths_cli.rigs.description import RigInfo

if TYPE_CHECKING:
    from rths_cli.quantities import Values

PEAKS = {
    "displacement_m": (1e3, "mm"), "velocity_m_s": (1.0, "m/s"), "acceleration_m_s2": (1.0, "m/s^2"),
    "force_n": (1.0, "N"),
}  # fmt: skip
BEFORE_MOVING = (
    "The emergency stop works without this computer, and somebody stands beside it.",
    "Nobody is within reach of table and specimen; the specimen is bolted down and its guards are in place.",
    "The table stands at mid-stroke and its own controller is switched on.",
    "Every sensor is connected, in the order of the rig file.",
)


Predicted = Callable[["Setup"], "Values"]


def _nothing_predicted(setup: Setup) -> Values:
    """Return no metrics."""
    return {}


def ask_to_move(
    setups: Sequence[Setup],
    yes: bool,
    confirm: Callable[[Sequence[str]], bool],
    predicted: Predicted = _nothing_predicted,
    played: tuple[str, ...] = ("",),
) -> None:
    """Ask a person to confirm that the real rigs of these cases may move; raises InputError if they may not.

    Cases on virtual rigs need no confirmation. `confirm` shows the lines of the checklist and returns the answer.
    `played`: beginnings of the keys that the motion follows from; doubts on others are of no concern.
    `predicted` returns the metrics `check.*` of a case, {} without a check; the checklist states their peaks. `yes`
    confirms without a question, but only for rigs whose own file states `unattended: true`. Nobody is asked where the
    system has no real time, or where a number is doubted that the case does not call plausible: that one is refused.
    """
    real = [setup for setup in setups if setup.rig.can.moves_hardware]
    if not real:
        return
    _refuse_doubts(real, played)
    from rths_cli.numerics.clock import require_real_time

    require_real_time()
    attended = [setup.rig.name for setup in real if not setup.rig.unattended]
    if yes:
        if attended:
            raise InputError(
                f"--yes: rig {attended[0]} does not say `unattended: true` in a file of its own; "
                "a person has to confirm here"
            )
        return
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError("nobody can be asked here; --yes moves rigs whose file says `unattended: true`")
    motions = [f"{setup.case.name}: {_motion(setup)}{_peaks(predicted(setup))}" for setup in real]
    rigs = dict.fromkeys(_about(setup.rig) for setup in real)
    if not confirm(["This moves a table:", *motions, *rigs, *BEFORE_MOVING]):
        raise InputError("not confirmed; nothing was moved")


def _refuse_doubts(real: Sequence[Setup], played: tuple[str, ...]) -> None:
    """Raise InputError with every number of cases on real rigs that is doubted, and what consents to it."""
    found = [(setup, one) for setup in real for one in doubts(setup) if one.key.startswith(played)]
    if found:
        keys = ", ".join(dict.fromkeys(one.key for _, one in found))
        raise InputError(
            *dict.fromkeys(placed(setup.case, one.sentence) for setup, one in found),
            f"rig {real[0].rig.name} is real and moves once these are corrected; where they are right, state "
            f"plausible: [{keys}] in the case",
        )


def _motion(setup: Setup) -> str:
    """Return the line on the record of a case: name, scaling, length and peak."""
    time_s, accel = setup.motion.time_s, setup.motion.accel_m_s2
    return (
        f"record {setup.case.record.name} times {setup.case.scaling:g}, {time_s[-1]:.0f} s, "
        f"ground {np.abs(accel).max():.3g} m/s^2"
    )


def _peaks(figures: Values) -> str:
    """Return the peaks of the table's motion that a check predicts, the largest over samples; "" without a check."""
    known = [(path, figures[f"check.peak_{path}"]) for path in PEAKS if f"check.peak_{path}" in figures]
    known = [(path, peak.high if isinstance(peak, Interval) else peak) for path, peak in known]
    told = ", ".join(f"{float(np.max(peak)) * PEAKS[path][0]:.3g} {PEAKS[path][1]}" for path, peak in known)
    return f"; predicted peaks of the table {told}" if told else ""


def _about(rig: RigInfo) -> str:
    """Return the line on a rig: driver, sample rate and limits."""
    limits, fastest = rig.limits, rig.limits.fastest_m_s(rig.gain_m_per_v)
    return (
        f"rig {rig.name} ({', '.join(filter(None, (rig.kind, rig.driver_verified)))}) at {1.0 / rig.dt_s:g} Hz, within "
        f"{1e3 * limits.stroke_m:g} mm, {fastest:.4g} m/s, {limits.acceleration_m_s2:g} m/s^2, "
        f"{limits.force_n:g} N"
    )
