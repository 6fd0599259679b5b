"""How one run of a benchmark went."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Ran:
    """The numbers of a run by name, and why it was refused or stopped, "" for one that reached its end."""

    figures: dict[str, float]
    outcome: str = ""
