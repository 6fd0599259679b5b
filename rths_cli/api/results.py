"""Objects that the Python interface returns: results read from their files when asked, verdicts, models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.files.result_listing import Outline
    from rths_cli.files.result_reader import Dataset, Result
    from rths_cli.files.result_writer import Attribute
    from rths_cli.numerics.lti import Array, ComplexArray, Model
    from rths_cli.quantities import Interval

SMALL_BYTES = 100_000  # larger than a controller block's matrices, for which a loop over frequencies asks each time


class MissingError(InputError, AttributeError):
    """A result holds no such group or array."""


class Figures(dict[str, "float | Array"]):
    """Figures by their paths; a path that is not there raises a KeyError that names those like it."""

    def __missing__(self, path: str) -> float | Array:
        from difflib import get_close_matches

        near = get_close_matches(str(path), list(self), 3, 0.6)
        advice = f"did you mean {' or '.join(near)}?" if near else "list(result.metrics) names all"
        raise KeyError(f"{path!r} is no figure of this result; {advice}")


@dataclass(frozen=True)
class StructuralResponse:
    """The response of a building by storey, from the lowest up, n samples: what a structural engineer designs for.

    `run`: whose it is. The first of `storey_shear_n` is the base shear of the building.
    """

    run: str
    time_s: Array  # (n,)
    rel_disp_m: Array  # (n_storeys, n) relative to the ground
    abs_accel_m_s2: Array  # (n_storeys, n)
    inter_storey_drift_m: Array  # (n_storeys, n)
    storey_shear_n: Array  # (n_storeys, n)

    def __repr__(self) -> str:
        storeys, samples = self.rel_disp_m.shape
        return f"<response of {storeys} storeys in {self.run}, {samples} samples>"


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

        from rths_cli.files.result_reader import left_out, read_dataset

        if name not in (*self._outline.datasets, *self._outline.scales):
            why = left_out(f"{self._path}/{name}", self._result.contents.series)
            there = why or f"there is no {name} in {self._path}; it holds {', '.join(self)}"
            raise MissingError(f"{self._result.path}: {there}.")
        self._result.check_unchanged()
        small, path = self._result.small, f"{self._path}/{name}"
        found = small[path] if path in small else read_dataset(self._result.path, path)
        if isinstance(found.data, np.ndarray | np.generic) and found.data.nbytes <= SMALL_BYTES:
            small[path] = found
            return replace(found, data=found.data.copy())
        return found

    def to_xarray(self) -> Any:
        """Return the arrays as an xarray.Dataset with units and meanings; needs xarray."""
        xarray = _library("xarray")

        def told(name: str, axes: tuple[str, ...]) -> tuple[tuple[str, ...], Any, dict[str, str]]:
            one = self.about(name)
            return axes, one.data, {"units": one.units, "long_name": one.long_name}

        arrays = {name: told(name, self.about(name).dims) for name in self._outline.datasets}
        scales = {name: told(name, (name,)) for name in self._outline.scales}
        return xarray.Dataset(arrays, scales, dict(self.attributes))

    def to_dataframe(self) -> Any:
        """Return the series over time as a pandas.DataFrame, a column for each storey or floor; needs pandas."""
        pandas = _library("pandas")
        columns: dict[str, Any] = {}
        for name in self._outline.datasets:
            one = self.about(name)
            if one.dims == ("time_s",):
                columns[name] = one.data
            elif one.dims[1:] == ("time_s",):
                rows: Any = one.data
                columns |= {f"{name}_{place:g}": row for place, row in zip(self[one.dims[0]], rows, strict=True)}
        return pandas.DataFrame(columns, index=pandas.Index(self["time_s"], name="time_s"))

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
        return ["about", "attributes", "to_dataframe", "to_xarray", *self]

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
    def verdict(self) -> str:
        """Return the sentences that say whether the test can be trusted, as `rths run` ends with them."""
        from rths_cli.report.answer import verdict

        return verdict(self.contents)

    @property
    def metrics(self) -> Mapping[str, float | Array]:
        """Return the figures by their paths."""
        return Figures(self.contents.metrics)

    @property
    def scale_factors(self) -> Mapping[str, float] | None:
        """Return the factors by quantity (`length`, `time`, `force`, ...), prototype over model; None without a scale.

        Figures and arrays of a result are in model scale.
        """
        from rths_cli.report.result_scale import scale_of

        scale = scale_of(self.contents)
        return None if scale is None else scale.factors

    @property
    def response(self) -> StructuralResponse:
        """Return the building's response in EXP-RTHS or, without one, in SIM; raises MissingError without both."""
        return self.response_in("exp_rths" if "rel_disp_m" in self._arrays("exp_rths") else "sim")

    def response_in(self, run: str) -> StructuralResponse:
        """Return the building's response in `sim`, `sim_delay` or `exp_rths`; raises MissingError where it has none.

        Drifts and shears that the file does not hold follow from displacements and accelerations.
        """
        from rths_cli.analysis.structural_response import inter_storey_drift_m, storey_shear_n
        from rths_cli.files.stored_case import floor_masses_kg

        group, held = self[run], self._arrays(run)
        disp, accel = group["rel_disp_m"], group["abs_accel_m_s2"]
        drift = group["inter_storey_drift_m"] if "inter_storey_drift_m" in held else inter_storey_drift_m(disp)
        if "storey_shear_n" in held:
            shear = group["storey_shear_n"]
        else:
            shear = storey_shear_n(floor_masses_kg(self.contents), accel)
        return StructuralResponse(run, group["time_s"], disp, accel, drift, shear)

    def to_xarray(self, group: str = "exp_rths") -> Any:
        """Return the arrays of a group as an xarray.Dataset; needs xarray."""
        return self[group].to_xarray()

    def to_dataframe(self, group: str = "exp_rths") -> Any:
        """Return the series of a group as a pandas.DataFrame; needs pandas."""
        return self[group].to_dataframe()

    def _arrays(self, group: str) -> tuple[str, ...]:
        return tuple(self.outlines[group].datasets) if group in self.outlines else ()

    @property
    def intervals(self) -> Mapping[str, Interval]:
        """Return the intervals of the figures that carry one, each with `low`, `high` and `probability`."""
        return self.contents.intervals

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

    def export(self, folder: str | Path, to: str = "mat", replace: bool = True) -> list[Path]:
        """Write the result as `csv` or `mat` and return the files; raises InputError, without `replace` also
        where one exists."""
        from rths_cli.report.export_files import FORMATS, NETCDF_REMOVED, ExportRequest, export

        if to == "netcdf":
            raise InputError(f"to: {NETCDF_REMOVED}")
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
            there = f"holds no group {name} (status {self.status}); its groups are {known}"
            if name == "record" and self.contents.series != "all":
                there = f"keeps no {name}, the case was run with --series {self.contents.series}"
            raise MissingError(f"{self.path}: {there}.")
        return Group(self, name)

    def __getattr__(self, name: str) -> Group:
        if name.startswith("_") or name == "outlines":
            raise AttributeError(name)
        if isinstance(own := getattr(type(self), name, None), property):  # it raised MissingError, which says more
            return own.__get__(self)
        return self[name]

    def __contains__(self, name: object) -> bool:
        return name in self.outlines

    def __reduce__(self) -> tuple[type[RunResult], tuple[Path]]:
        return RunResult, (self.path,)  # a copy, also in another process, opens the file anew

    def __dir__(self) -> list[str]:
        return [*(name for name in super().__dir__() if not name.startswith("_")), *self.groups]

    def __repr__(self) -> str:
        return f"<{self.path.name}: {self.status}; {', '.join(self.groups)}>"

    def _repr_html_(self) -> str:
        from rths_cli.report.answer import answer
        from rths_cli.report.result_scale import reported

        return _as_html(answer(reported([self.contents])[0]))


@dataclass(frozen=True)
class CheckResult:
    """What is known of a case before anything moves: `verdict` safe, unsafe or unstable, why not safe, what else to
    know; the predicted figures, their units and definitions by path (`check.critical_delay_s`), and the intervals of
    those that carry one. `findings`: reasons and warnings as data, as in `rths check --json`."""

    verdict: str
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]
    metrics: Mapping[str, float | Array]
    units: Mapping[str, str]
    definitions: Mapping[str, str]
    intervals: Mapping[str, Interval] = field(default_factory=dict)
    findings: tuple[Mapping[str, Any], ...] = ()

    @property
    def safe(self) -> bool:
        """Tell whether EXP-RTHS would be run."""
        return self.verdict == "safe"

    def __repr__(self) -> str:
        counted = ((len(self.reasons), "reason"), (len(self.warnings), "warning"), (len(self.metrics), "figure"))
        told = ", ".join(f"{count} {name}{'s' * (count != 1)}" for count, name in counted if count)
        return f"<check: {self.verdict}{f'; {told}' if told else ''}>"

    def _repr_html_(self) -> str:
        return _as_html("\n".join([f"{self.verdict}", *self.reasons, *(f"note: {said}" for said in self.warnings)]))


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

    def __repr__(self) -> str:
        frequencies = () if self.natural_frequency_hz is None else self.natural_frequency_hz
        modes = ", ".join(f"{hz:.4g}" for hz in frequencies)
        said = "accepted" if self.accepted else "rejected"
        return (
            f"<model {self.path.name}: {said}; {len(self.poles)} poles, {len(self.zeros)} zeros; specimen {modes} Hz>"
        )

    def _repr_html_(self) -> str:
        return _as_html("\n".join([repr(self), *self.reasons, *(f"note: {said}" for said in self.warnings)]))


def _as_html(text: str) -> str:
    """Return plain text as HTML that keeps its columns."""
    return f"<pre>{escape(text)}</pre>"


def _library(name: str) -> Any:
    """Return a library that is no dependency of rths; raises InputError where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"{name} is not installed; pip install {name}") from error


def _stamp(path: Path) -> tuple[int, ...]:
    """Return what changes when a file is replaced; nothing when it is gone."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns
