"""A program that is a Python class: `Class(masses_kg, parameters)` with a method `force(displacement_m)`."""

from __future__ import annotations

import runpy
from typing import Any

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.programs.process import Description


class PythonModel:
    """An object of a user's class."""

    def __init__(self, description: Description) -> None:
        names = runpy.run_path(str(description.file))
        if not callable(names.get(description.function)):
            raise LookupError(f"{description.file} has no class {description.function!r}; name it under function")
        self.masses_kg = np.array(description.masses_kg)
        self.floors = tuple(f"floor {i + 1}" for i in range(len(self.masses_kg)))
        self.version = "python"
        self._object: Any = names[description.function](self.masses_kg.copy(), dict(description.parameters))
        self._at_rest = np.asarray(self._object.force(np.zeros(len(self.masses_kg))), dtype=float)

    def force(self, displacement_m: Array) -> Array:
        """Return the restoring forces (p,) in N at displacements (p,) in m, less those at rest."""
        found = np.asarray(self._object.force(displacement_m), dtype=float)
        if found.shape != self._at_rest.shape:
            raise ValueError(f"force gave an array of shape {found.shape}, {self._at_rest.shape} is needed")
        return np.asarray(found - self._at_rest)

    def first_hz(self) -> float:
        """Return NaN: a class has no eigenvalue analysis of its own."""
        return float("nan")


def make(description: Description) -> PythonModel:
    """Return the model of a description, at rest."""
    return PythonModel(description)
