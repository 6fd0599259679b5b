"""References of a module's buildings, replaced: each call of SIM and SIM-DELAY is told before it is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import pytest

from rths_cli.analysis.references import Reference
from rths_cli.structure import Building


def watch_references(monkeypatch: pytest.MonkeyPatch, module: ModuleType, tell: Callable[[str], object]) -> None:
    """Let a module that chooses references tell of every `simulate` and `simulate_delayed`."""
    chosen = module.reference_of

    def watched(building: Building) -> Reference:
        usual: Reference = chosen(building)
        return replace(
            usual,
            sim=lambda *given: (tell("simulate"), usual.sim(*given))[1],
            sim_delay=lambda *given: (tell("simulate_delayed"), usual.sim_delay(*given))[1],
        )

    monkeypatch.setattr(module, "reference_of", watched)
