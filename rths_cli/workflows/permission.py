"""A real table moves only when somebody said that it may."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from rths_cli.errors import InputError
from rths_cli.rig_info import RigInfo
from rths_cli.workflows.setup import Setup

BEFORE_MOVING = (
    "The emergency stop works without this computer, and somebody stands beside it.",
    "Nobody is within reach of table and specimen; the specimen is bolted down and its guards are in place.",
    "The table stands at mid-stroke and its own controller is switched on.",
    "Every sensor is connected, in the order of the rig file.",
)


def ask_to_move(setups: Sequence[Setup], yes: bool, confirm: Callable[[Sequence[str]], bool]) -> None:
    """Have a person confirm that the real rigs of these cases may move; raises InputError when they may not.

    `yes` answers for rigs whose own file says `unattended: true`, and for no other.
    """
    real = [setup for setup in setups if setup.rig.kind != "virtual"]
    if not real:
        return
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
    names = ", ".join(setup.case.name for setup in real)
    rigs = dict.fromkeys(_about(setup.rig) for setup in real)
    if not confirm([f"{names}:", *rigs, *BEFORE_MOVING]):
        raise InputError("not confirmed; nothing was moved")


def _about(rig: RigInfo) -> str:
    """Return what a rig may do, in one line."""
    limits = rig.limits
    return (
        f"rig {rig.name} ({rig.kind}, {rig.driver_verified}) at {1.0 / rig.dt_s:g} Hz, within "
        f"{1e3 * limits.stroke_m:g} mm, {limits.velocity_m_s:g} m/s, {limits.acceleration_m_s2:g} m/s^2, "
        f"{limits.force_n:g} N"
    )
