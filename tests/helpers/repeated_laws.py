"""Laws of the user's own that repeat built-in ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import several_laws

from rths_cli.structure.own_laws import Own, own_law
from rths_cli.structure.storey_laws import Bilinear, Cubic, Law, ViscousPower

SPRING = 7000.0


def own(which: int, a: float, b: float, c: float) -> Own:
    numbers = {"which": float(which), "a": a, "b": b, "c": c}
    file = Path(several_laws.__file__)
    return own_law(SimpleNamespace(file=file, sha256=None, installed=None, parameters=numbers, largest_drift_m=0.02))


REPEATED: dict[str, tuple[Callable[[], Own], Law]] = {
    "bilinear": (lambda: own(0, SPRING, 0.002, 0.05), Bilinear(SPRING, 0.002, 0.05)),
    "cubic": (lambda: own(1, 4e8, 0.02, 0.0), Cubic(4e8, 0.02)),
    "viscous_power": (lambda: own(3, 8.0, 0.4, 1e-3), ViscousPower(8.0, 0.4, 1e-3)),
    "strong damper": (lambda: own(3, 400.0, 0.5, 1e-3), ViscousPower(400.0, 0.5, 1e-3)),
}
