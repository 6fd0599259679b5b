"""What a figure is drawn from: a result with its series, each read once, and whether they reach the record's end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.results import Result, read_series
from rths_cli.lti import Array
from rths_cli.rig_info import capabilities_of

TABLE_RUNS = ("shake_table", "exp_rths")
COMPUTED_RUNS = ("sim", "sim_delay")
ACCEL = "abs_accel_m_s2"
DESIRED = "interface_accel_desired_m_s2"
MEASURED = "interface_accel_measured_m_s2"
MOST_STOREYS = 4


class NotDrawn(InputError):
    """A figure that a result holds no data for, with the reason."""


@dataclass(frozen=True)
class Source:
    """A result whose series are read when first asked for and then kept."""

    result: Result
    _kept: dict[str, Array] = field(default_factory=dict)

    def read(self, name: str) -> Array:
        """Return the values of a dataset (`exp_rths/command_v`); raise InputError where there is none."""
        if name not in self._kept:
            self._kept[name] = read_series(self.result.path, name)
        return self._kept[name]

    def runs(self, names: tuple[str, ...]) -> list[str]:
        """Return those of the runs that the file holds samples of; raise NotDrawn when it holds none."""
        found = [run for run in names if run in self.result.groups and self.read(f"{run}/time_s").size > 1]
        if not found:
            raise NotDrawn(f"no {' and no '.join(names)} in the result")
        return found

    def metric(self, path: str) -> Array | None:
        """Return a figure as an array (n,), None where the result has none."""
        value = self.result.metrics.get(path)
        return None if value is None else np.atleast_1d(np.asarray(value, dtype=float))

    @property
    def virtual(self) -> bool:
        """Tell whether the table was a virtual one."""
        return not capabilities_of(str(self.result.attributes.get("rig_kind", ""))).moves_hardware

    @property
    def rate_hz(self) -> float:
        """Return the sample rate in Hz."""
        return float(self.result.attributes["sample_rate_hz"])

    @property
    def complete(self) -> bool:
        """Tell whether all runs reached the end of the record."""
        return self.result.attributes.get("status") == "complete"


def interface_storey(source: Source) -> int:
    """Return the storey (from 1) that the table moves, 0 where no run on a table tells."""
    for run in TABLE_RUNS:
        if run in source.result.groups:
            return int(source.read(f"{run}/floor")[0]) - 1
    return 0


def chosen_storeys(storeys: int, interface: int) -> list[int]:
    """Return the storeys (from 1) that figures show: all up to four, else first, interface, the middle above, top.

    `interface`: the highest storey of the numerical part, 0 where it is not known.
    """
    if storeys <= MOST_STOREYS:
        return list(range(1, storeys + 1))
    cut = interface or storeys // 2
    middle = (cut + storeys) // 2 if storeys - cut > 2 else cut // 2
    return sorted({1, cut, max(middle, 1), storeys})
