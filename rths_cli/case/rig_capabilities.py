"""What each kind of rig can do (counted clock, truth, watchdog, preview, ...): all other code asks this, not the
kind."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Capabilities:
    """What a rig does: the rest of the program asks for this, never for the rig's kind.

    `moves_hardware`: a table moves; a person says that it may, and what it measured cannot be measured again.
    `counts_steps`: time is counted in steps and not kept by a clock: the same seed is the same run, and runs go on
    beside each other. `records_truth`: true motions stand beside the measured ones. `carries_declared_specimen`: the
    specimen on the table is the one the case declares. `bridges_lost_samples`: the loop goes on by its model where a
    sample is lost. `takes_trajectories`: a command comes with those that follow, for the case that they do not arrive.
    `has_watchdog`: it leads its table to rest by itself when commands stop coming. `has_unproven_watchdog`: nothing but
    a trial shows that it does (`rths doctor --watchdog`). `steps_itself`: its own computer has the designed step and
    takes no command from here.
    """

    moves_hardware: bool = True
    counts_steps: bool = False
    records_truth: bool = False
    carries_declared_specimen: bool = False
    bridges_lost_samples: bool = False
    takes_trajectories: bool = False
    has_watchdog: bool = True
    has_unproven_watchdog: bool = False
    steps_itself: bool = False


DEFAULT_KIND = "virtual"  # of a rig file that states none
CAPABILITIES = {
    DEFAULT_KIND: Capabilities(False, True, True, True, True, False, has_watchdog=False),
    "ni": Capabilities(has_watchdog=False),
    "udp": Capabilities(bridges_lost_samples=True, takes_trajectories=True),
    "udp_plain": Capabilities(bridges_lost_samples=True, has_unproven_watchdog=True),
    "target": Capabilities(bridges_lost_samples=True, steps_itself=True),
}
"""Capabilities by the kind that a rig file or a result states; every other kind has those of a plain driver."""


def capabilities_of(kind: object) -> Capabilities:
    """Return what rigs of a kind can do; a kind that is no text, as a faulty file may state, is of no known one."""
    return CAPABILITIES.get(kind, Capabilities()) if isinstance(kind, str) else Capabilities()
