"""Objects that the Python interface returns: results read from their files when asked, verdicts, models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.files.result_listing import Outline
    from rths_cli.files.result_reader import Dataset, Result
    from rths_cli.files.result_writer import Attribute
    from rths_cli.numerics.lti import Array, ComplexArray, Model

SMALL_BYTES = 100_000  # larger than a controller block's matrices, for which a loop over frequencies asks each time


class MissingError(InputError, AttributeError):
    """A result holds no such group or array."""


class Group:
    """A group of a result: its arrays by name, as `result.exp_rths.command_v` or `result["exp_rths"]["command_v"]`.

    Time is the last axis: `abs_accel_m_s2` is (n_storeys, n). An array is yours to change: it is read from the file
    each time it is asked for, or copied if it is small. What is no array: groups in it (`result.exp_rths.truth`),
    texts, `attributes` (a controller block's `dt_s`, `inputs`, `outputs`).
    """

    def __init__(self, result: RunResult, path: str) -> None:
        self._result, self._path = result, path

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Return the attributes of the group."""
        return self._outline.attributes

    def about(self, name: str) -> Dataset:
        """Return an array with its `units`, `long_name`, `source` and `dims`; raises MissingError."""
        import numpy as np

        from rths_cli.files.result_reader import read_dataset

        if name not in (*self._outline.datasets, *self._outline.scales):
            raise MissingError(f"{self._result.path}: there is no {name} in {self._path}; it holds {', '.join(self)}.")
        self._result.check_unchanged()
        small, path = self._result.small, f"{self._path}/{name}"
        found = small[path] if path in small else read_dataset(self._result.path, path)
        if isinstance(found.data, np.ndarray | np.generic) and found.data.nbytes <= SMALL_BYTES:
            small[path] = found
            return replace(found, data=found.data.copy())
        return found

    @property
    def _outline(self) -> Outline:
        return self._result.outlines[self._path]

    def __getitem__(self, name: str) -> Any:
        return Group(self._result, f"{self._path}/{name}") if name in self._outline.groups else self.about(name).data

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return self[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._outline.scales, *self._outline.datasets, *self._outline.groups))

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def __dir__(self) -> list[str]:
        return ["about", "attributes", *self]

    def __repr__(self) -> str:
        return f"<{self._path} of {self._result.path}: {', '.join(self)}>"


class RunResult:
    """A result file: what it says about its run, its figures, and its groups, read when asked for.

    `result.exp_rths`, `result.sim`, ... are its groups (`groups` names them), `result.metrics` its figures: numbers, or
    arrays with one value per storey, by the path that names them everywhere (`exp_rths.rms_error_m_s2`).
    """

    def __init__(self, path: Path) -> None:
        from rths_cli.files.result_listing import read_outlines
        from rths_cli.files.result_reader import read_checked

        self.path = Path(path).absolute()
        self.contents: Result = read_checked(Path(path))
        self.outlines: dict[str, Outline] = read_outlines(Path(path))
        self.small: dict[str, Dataset] = {}  # the arrays of up to SMALL_BYTES that were read, by their paths
        self._stamp = _stamp(self.path)

    @property
    def status(self) -> str:
        """Return how the run ended: complete, aborted, interrupted, failed or refused."""
        return str(self.attributes["status"])

    @property
    def status_reason(self) -> str:
        """Return why it ended so, empty for a run that is complete and accepted."""
        return str(self.attributes.get("status_reason", ""))

    @property
    def attributes(self) -> Mapping[str, Attribute]:
        """Return what the file says about case, rig, seed, versions and origin."""
        return self.contents.attributes

    @property
    def metrics(self) -> Mapping[str, float | Array]:
        """Return the figures by their paths."""
        return self.contents.metrics

    @property
    def units(self) -> Mapping[str, str]:
        """Return the units of the figures."""
        return self.contents.units

    @property
    def definitions(self) -> Mapping[str, str]:
        """Return the definitions of the figures."""
        return self.contents.definitions

    @property
    def case_yaml(self) -> str:
        """Return the case file as it was written."""
        return self.contents.case_yaml

    @property
    def resolved_yaml(self) -> str:
        """Return the case with every default filled in."""
        return self.contents.resolved_yaml

    @property
    def groups(self) -> tuple[str, ...]:
        """Return the names of the groups."""
        return self.contents.groups

    def export(self, folder: str | Path, to: str = "mat", replace: bool = False) -> list[Path]:
        """Write the result as `csv`, `mat` or `netcdf` and return the files; raises InputError."""
        from rths_cli.report.export.export_command import FORMATS, ExportRequest, export

        if to not in FORMATS:
            raise InputError(f"to: {to!r} is no format; give one of {', '.join(FORMATS)}")
        self.check_unchanged()
        return list(export(ExportRequest((self.path,), to, Path(folder), (), replace))[0].files)

    def check_unchanged(self) -> None:
        """Raise InputError when another run took the file's place: its arrays would not belong to these figures."""
        if _stamp(self.path) != self._stamp:
            raise InputError(f"{self.path}: was replaced or removed since it was loaded; load it again")

    def __getitem__(self, name: str) -> Group:
        if name not in self.outlines:
            known = ", ".join(self.groups) or "none"
            raise MissingError(f"{self.path}: holds no group {name} (status {self.status}); its groups are {known}.")
        return Group(self, name)

    def __getattr__(self, name: str) -> Group:
        if name.startswith("_") or name == "outlines":
            raise AttributeError(name)
        return self[name]

    def __contains__(self, name: object) -> bool:
        return name in self.outlines

    def __reduce__(self) -> tuple[type[RunResult], tuple[Path]]:
        return RunResult, (self.path,)  # a copy, also in another process, opens the file anew

    def __dir__(self) -> list[str]:
        return [*(name for name in super().__dir__() if not name.startswith("_")), *self.groups]

    def __repr__(self) -> str:
        return f"<{self.path.name}: {self.status}; {', '.join(self.groups)}>"


@dataclass(frozen=True)
class CheckResult:
    """What is known of a case before anything moves: `verdict` safe, unsafe or unstable, why not safe, what else to
    know; the predicted figures, their units and definitions by path (`check.critical_delay_s`)."""

    verdict: str
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]
    metrics: Mapping[str, float | Array]
    units: Mapping[str, str]
    definitions: Mapping[str, str]

    @property
    def safe(self) -> bool:
        """Tell whether EXP-RTHS would be run."""
        return self.verdict == "safe"


@dataclass(frozen=True)
class ModelResult:
    """An identified rig: its model file, whether it may drive the table and why not, and what was found.

    `zeros`, `poles` in rad/s, `gain` and `delay_s` from command in V to table acceleration in m/s^2; of the specimen on
    a fixed base `natural_frequency_hz` and `damping_ratio` (n_exp,), None where the data did not tell. `table` is the
    whole model of the table: `table.response(frequency_hz)`.
    """

    path: Path
    accepted: bool
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]
    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    delay_s: float
    natural_frequency_hz: Array | None
    damping_ratio: Array | None
    table: Model


def _stamp(path: Path) -> tuple[int, ...]:
    """Return what changes when a file is replaced; nothing when it is gone."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns
