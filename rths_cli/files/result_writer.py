"""Write the result file of one case (HDF5, format version 1), group by group.

A file is written under a temporary name in its own folder and renamed when it is finished, so a file with the
final name is never half a file. It takes the place only of what stood there when it was begun: where another process
has taken the name meanwhile, both are kept, and `path` says which name the file got. Until then its status says
`interrupted`, and every group is flushed: what a killed process leaves behind (`.NAME.h5.HOST-PID.part`) opens and says
how it ended. A file that will be added to once the table is at rest is finished as `interrupted`, and a writer that
`continues` it works on a copy. One that was parked while a table moved and fails after that keeps what it holds, and
says why.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rths_cli.errors import InputError
from rths_cli.files.durable_files import Stamp, make_folder, part_of, publish, remove_leftovers, stamp, sync
from rths_cli.files.hdf5 import Dataset, add_text, as_declared, scales_of, write_group
from rths_cli.files.staged_file import StagedFile, signals_held
from rths_cli.numerics.lti import Array
from rths_cli.quantities import AXES, Interval, Values, attribute_fault, dataset, metric
from rths_cli.quantities.datasets import KEPT_SERIES, keeps, of_a_run
from rths_cli.quantities.declaration import SAMPLED

FORMAT = "rths-result"
FORMAT_VERSION = 1
HEADER: dict[str, str | int] = {
    "format": FORMAT,
    "format_version": FORMAT_VERSION,
    "status": "interrupted",
    "status_reason": "the writing process ended before the run did",
}
Status = Literal["complete", "aborted", "interrupted", "failed", "refused"]
Attribute = str | int | float


class ResultWriter:
    """Write one result file; use as a context manager and call `finish` before leaving it.

    Attributes and values are those that `rths_cli.quantities` declares: another name or path is a ValueError. With the
    attribute `series` other than all, only the series that it keeps are written, in single precision.
    When the body raises, the file is removed unless `finish` gave a status other than complete; a `lasting` one, whose
    samples cannot be measured again, is always kept and never replaced. With `continues`, groups are added to the
    finished file of that name, which is replaced by the whole at the end and stays as it was when the body raises.
    Every fault of the disk is an InputError naming path and cause.
    """

    def __init__(
        self, path: Path, attributes: Mapping[str, Attribute], continues: bool = False, lasting: bool = False
    ) -> None:
        _check_attributes(attributes)
        self.path = Path(path)
        self.part = part_of(self.path)
        self._attributes = dict(attributes)
        self._continues = continues
        self._expendable = continues or not lasting  # the part, when its writing fails
        self._lasting = continues or lasting
        self._status: str | None = None
        self._broken = False
        self._parked = False
        self._resumed = False
        self._file: Any = None  # h5py.File while open
        self._staged: StagedFile | None = None  # what it writes through
        self._scales: dict[str, NDArray[Any]] = {}  # those written, by path
        self._seen: Stamp = None  # of the file that is replaced

    def __enter__(self) -> ResultWriter:
        """Open the temporary file; raise InputError where the disk refuses or hardware data have the name."""
        import h5py

        self._seen = stamp(self.path)
        if not self._expendable and self._seen is not None:
            raise InputError(f"{self.path}: exists and holds a hardware run; choose another name or --output folder.")
        if self._expendable and not self._resumed:  # a run on hardware may have left its samples in one
            remove_leftovers(self.path)
        try:
            with self._reporting():
                make_folder(self.path.parent)
                if self._continues:
                    shutil.copyfile(self.path, self.part)
                self._staged = StagedFile(self.part, keep=self._continues)
                self._file = h5py.File(self._staged, "r+" if self._continues else "w")
                self._scales = scales_of(self._file)
                if self._continues:
                    self._file.attrs.update({**self._attributes, **HEADER})
                else:
                    _add_attributes(self._file, {**self._attributes, **HEADER})
                self._flush()
        except BaseException:  # a signal too must leave no half file
            self._abandon()
            raise
        return self

    def group(
        self,
        name: str,
        values: Values,
        time_s: ArrayLike | None = None,
        storey: ArrayLike | None = None,
        scales: Values | None = None,
        remarks: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        """Write values of a group by the names of its datasets, with its scales: `time_s` (n,), `storey` (n_storeys,)
        and any other (`frequency_hz`); one that counts from 1 need not be given.

        `remarks` add to the meaning of a dataset what is declared that a file may say. Raises InputError when the disk
        refuses, ValueError for a path or scale that is not declared in `rths_cli.quantities` and for a value that is
        not what is declared.
        """
        kept = {key: item for key, item in values.items() if self._keeps(f"{name}/{key}")}
        given = {"time_s": time_s, "storey": storey}
        axes = {key: value for key, value in given.items() if value is not None} | dict(scales or {})
        if values and not kept:  # the group of a run still says that there was one
            axes = {key: value for key, value in axes.items() if key not in SAMPLED and "/" not in name}
            if not axes:
                return
        about = remarks or {}
        datasets = {key: self._dataset(f"{name}/{key}", item, axes, about.get(key, ())) for key, item in kept.items()}
        self._write(name, datasets, {key: _scale(key, item) for key, item in axes.items()}, {})

    def case(self, yaml: str, resolved: str) -> None:
        """Write the case file as it was given and with everything filled in."""
        self.group("case", {"yaml": yaml, "resolved": resolved})

    def block(
        self,
        name: str,
        A: Array,
        B: Array,
        C: Array,
        D: Array,
        dt_s: float,
        inputs: Sequence[str],
        outputs: Sequence[str],
    ) -> None:
        """Write a block x[k+1] = A x + B u, y = C x + D u of step `dt_s` under /controller/NAME."""
        matrices = dict(zip("ABCD", (A, B, C, D), strict=True))
        datasets = {k: self._dataset(f"controller/{name}/{k}", matrix, {}, ()) for k, matrix in matrices.items()}
        about = {"name": name, "dt_s": dt_s, "inputs": list(inputs), "outputs": list(outputs)}
        self._write(f"controller/{name}", datasets, {}, about)

    def metrics(self, values: Values, remarks: Mapping[str, str] | None = None) -> None:
        """Write metrics: the path `exp_rths.rms_error_m_s2` becomes /metrics/exp_rths/rms_error_m_s2.

        A value that is an `Interval` has its ends and probability as attributes of its dataset. `remarks` add what this
        run has to say of a metric to its definition. Raises ValueError for a path that is not
        declared in `rths_cli.quantities`, and for a value with other axes than declared.
        """
        groups: dict[str, dict[str, Dataset]] = {}
        for path, value in values.items():
            parent, _, leaf = f"metrics.{path}".replace(".", "/").rpartition("/")
            item = as_dataset(path, value, (remarks or {}).get(path, ""))
            groups.setdefault(parent, {})[leaf] = item
        with self._reporting():
            for parent, items in groups.items():
                write_group(self._file.require_group(parent), items, {}, self._scales)
            self._flush()

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Return the attributes of the root that the writer was given so far."""
        return dict(self._attributes)

    def about(self, attributes: Mapping[str, Attribute]) -> None:
        """Add attributes to the root, in place of those given before; raises ValueError for one not declared."""
        _check_attributes(attributes)
        self._attributes.update(attributes)
        with self._reporting():
            self._file.attrs.update(dict(attributes))

    def finish(self, status: Status, reason: str = "") -> None:
        """State how the run ended; the file gets its name when the context is left."""
        self._status = status
        with self._reporting():
            self._file.attrs.update({"status": status, "status_reason": reason})

    def park(self, reason: str) -> None:
        """Publish the file as interrupted and close it: whatever happens until `resume`, it can be read."""
        self.finish("interrupted", reason)
        self._publish()
        self._file, self._staged, self._status, self._parked = None, None, None, True

    def resume(self) -> None:
        """Go on writing to a parked file, on a copy that takes its place at the end."""
        if self._parked:
            self._continues, self._expendable, self._parked, self._resumed = True, True, False, True
            self.__enter__()

    def drop(self, name: str) -> None:
        """Remove a group, which may be half written."""
        with self._reporting():
            del self._file[name]
            self._scales = scales_of(self._file)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close and rename the file, or remove it."""
        if self._parked:
            self.resume()
        if self._broken:
            self._abandon()
            return
        kept = self._resumed or not self._expendable
        if kept and (self._status is None or (error and self._status == "complete")):
            self.finish(*_ending(error))
        if self._status is None or (error is not None and self._status == "complete"):
            self._abandon()
            if error is None:
                raise RuntimeError(f"{self.path}: finish() was not called.")
            return
        self._publish()

    @property
    def _series(self) -> str:
        """Return which series the file holds, one of KEPT_SERIES."""
        return str(self._attributes.get("series", KEPT_SERIES[0]))

    def _keeps(self, path: str) -> bool:
        """Return whether the dataset of a path belongs into the file; `_dataset` refuses one that is not declared."""
        declared = dataset(path)
        return declared is None or keeps(self._series, declared)

    def _dataset(self, path: str, value: ArrayLike, axes: Values, remarks: tuple[str, ...]) -> Dataset:
        """Return the value of a path with what is declared of it; raises ValueError where that does not fit."""
        declared = dataset(path)
        if declared is None:
            raise ValueError(f"{path} is declared nowhere; declare it in rths_cli/quantities/datasets.py.")
        known = {dim for dim in declared.axes if dim in axes or f"/{declared.group}/{dim}" in self._scales}
        if missing := [dim for dim in declared.axes if dim not in known and not AXES[dim].counted]:
            raise ValueError(f"{path} needs the scale {missing[0]}.")
        return as_declared(declared, value, remarks, single=self._series == "essential" and of_a_run(path))

    def _write(
        self,
        name: str,
        datasets: Mapping[str, Dataset],
        scales: Mapping[str, Dataset],
        about: Mapping[str, Any],
    ) -> None:
        with self._reporting():
            group = self._file.require_group(name)
            write_group(group, datasets, scales, self._scales)
            _add_attributes(group, about)
            self._flush()

    def _flush(self) -> None:
        """Put everything that was written on the disk; raises OSError."""
        assert self._staged is not None
        self._file.flush()
        self._staged.commit()

    def _publish(self) -> None:
        assert self._staged is not None
        try:
            with self._reporting():
                self._file.close()
                self._staged.commit()
                self._staged.close()
                if self._lasting:
                    sync(self.part)
                self.path = publish(self.part, self.path, self._seen)
                if self._lasting:
                    sync(self.path.parent)
        except BaseException:  # a signal too must leave no half file
            self._abandon()
            raise

    def _abandon(self) -> None:
        """Close and remove the temporary file; what hardware produced stays under its temporary name."""
        if self._file is not None:
            with signals_held(), suppress(OSError, RuntimeError):
                self._file.close()
        if self._staged is not None:
            with suppress(OSError):  # the fault that ended the writing is told already
                self._staged.close()
        if self._expendable:
            with suppress(OSError):
                self.part.unlink()

    @contextmanager
    def _reporting(self) -> Iterator[None]:
        """Turn a fault of disk or HDF5 library into one sentence naming path and cause; no signal comes between."""
        try:
            with signals_held():
                yield
        except (OSError, RuntimeError) as error:
            self._broken = True
            left = "" if self._expendable else f" What was written is in {self.part}."
            raise InputError(refusal(self.path, "cannot write the result file", error) + left) from error


def _ending(error: BaseException | None) -> tuple[Status, str]:
    """Return status and reason of a run that an error or a signal ended."""
    if error is None:
        return "failed", "the run ended without a status"
    if isinstance(error, Exception):
        return "failed", str(error) or type(error).__name__
    signal = "interrupted" if isinstance(error, KeyboardInterrupt) else "terminated"
    return "interrupted", f"{signal} before the run had ended"


def check_writable(folder: Path, needed_bytes: int = 0) -> None:
    """Compare the free space, create the folder and write in it; raise InputError where that fails.

    A folder with too little room is not created.
    """
    try:
        there = next((place for place in (folder, *folder.absolute().parents) if place.exists()), folder)
        free = shutil.disk_usage(there).free
        if free >= needed_bytes:
            make_folder(folder)
            with tempfile.TemporaryFile(dir=folder) as probe:
                probe.write(b"x")
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"{folder}: is a file, or below one, not a folder; choose another --output folder.") from error
    except OSError as error:
        raise InputError(refusal(folder, "cannot write result files here", error)) from error
    if free < needed_bytes:
        raise InputError(
            f"{folder}: {free / 1e6:.0f} MB free, {needed_bytes / 1e6:.0f} MB needed; "
            "free space or choose another --output folder."
        )


def refusal(path: Path, what: str, error: Exception, advice: bool = True) -> str:
    """Return one sentence: path, what failed, the system's reason, what to do."""
    number = getattr(error, "errno", None)
    told = re.search(r"error message = '([^']*)'", str(error))
    cause = os.strerror(number) if number else told[1] if told else str(error).partition("\n")[0]
    remedy = "free space or choose" if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else "choose"
    return f"{path}: {what}: {cause}" + (f"; {remedy} another --output folder." if advice else ".")


def _add_attributes(group: Any, about: Mapping[str, Any]) -> None:
    """Add new attributes to a group: numbers, texts and lists of texts."""
    for key, value in about.items():
        if isinstance(value, str):
            add_text(group.id, key, value)
        else:
            group.attrs[key] = _text_list(value) if isinstance(value, list) else value


def _text_list(value: list[str]) -> Any:
    import h5py

    return np.array(value, dtype=h5py.string_dtype())


def _scale(name: str, values: ArrayLike) -> Dataset:
    """Return the values of a scale with what is declared of it; raises ValueError where no axis has that name."""
    if name not in AXES:
        raise ValueError(f"the axis {name} is declared nowhere; declare it in rths_cli/quantities/declaration.py.")
    return Dataset(values, AXES[name].units, AXES[name].text, "computed")


def _check_attributes(given: Mapping[str, Attribute]) -> None:
    """Raise ValueError for an attribute of the root that is not declared, or of another kind."""
    if fault := attribute_fault(given):
        raise ValueError(f"{fault}; declare it in rths_cli/quantities/attributes.py.")


def as_dataset(path: str, value: ArrayLike, remark: str = "") -> Dataset:
    """Return the value of a metric with what is declared of it; raises ValueError where that does not fit."""
    declared = metric(path)
    if declared is None:
        raise ValueError(f"{path} is declared nowhere; declare it in rths_cli/quantities/metrics.py.")
    number = np.asarray(value, dtype=float)
    dims = (declared.over,) if declared.over else ()
    if number.ndim != len(dims):
        raise ValueError(f"{path} has {number.ndim} axes, declared are {len(dims)}.")
    interval = value if isinstance(value, Interval) else None
    if interval is not None and not np.shape(interval.low) == np.shape(interval.high) == number.shape:
        raise ValueError(f"{path} has an interval of another shape than its value.")
    about = f"{declared.definition}; {remark}" if remark else declared.definition
    return Dataset(number, declared.units, about, "computed", dims, about, interval)
