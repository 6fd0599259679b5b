"""Matrices and vectors of a structure from files of other programs: text, Matrix Market, MATLAB, numpy."""

from __future__ import annotations

import hashlib
import re
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.matlab_files import variables_read_here
from rths_cli.files.sandboxed_reading import read_in_copy
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MOST_BYTES = 500_000_000
APART = re.compile(r"[,;\s]\s*")
SPARSE_V73 = {"data", "ir", "jc"}


class FileSpec(Protocol):
    """Where a matrix stands."""

    @property
    def file(self) -> Path: ...
    @property
    def variable(self) -> str | None: ...
    @property
    def sha256(self) -> str | None: ...


def read_matrix(field: str, spec: FileSpec, usual: str) -> csr_array:
    """Return the matrix of a file, sparse; `usual` is the name of its variable where the file holds several.

    A vector of n numbers is a row or a column. Raises InputError, with file and place, for what cannot be read, is not
    real or not finite, and for a file that is no longer the one of its checksum.
    """
    path = spec.file
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"it is larger than {MOST_BYTES / 1e6:g} MB")
        if spec.sha256 is not None and hashlib.sha256(path.read_bytes()).hexdigest() != spec.sha256:
            raise InputError(f"{field}.file: {path} has changed since the case was read; start again")
        wanted, reader = spec.variable, READERS.get(path.suffix.lower())
        if reader is None:
            raise ValueError(f"its name must end with {', '.join(READERS)}")
        return _checked(read_in_copy(lambda: reader(path, wanted, usual)))
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{field}: {path.name} cannot be read as a matrix: {str(error)[:300]}") from error


def _checked(found: Any) -> csr_array:
    """Return a matrix of real, finite numbers in canonical form; raises ValueError for another one."""
    from scipy.sparse import csr_array, issparse

    if not issparse(found):
        found = np.atleast_2d(np.asarray(found))
        if found.dtype.kind not in "biuf" or found.ndim != 2:
            raise ValueError("it holds no real numbers in rows and columns")
    if found.dtype.kind not in "biuf":
        raise ValueError("its numbers are not real")
    matrix = csr_array(found, dtype=float)
    matrix.sum_duplicates()
    wrong = np.flatnonzero(~np.isfinite(matrix.data))
    if wrong.size:
        row = int(np.searchsorted(matrix.indptr, wrong[0], side="right")) - 1
        column = int(matrix.indices[wrong[0]])
        raise ValueError(f"row {row + 1}, column {column + 1}: {matrix.data[wrong[0]]} is not finite; repair it")
    matrix.eliminate_zeros()
    return matrix


def _of_text(path: Path, wanted: str | None, usual: str) -> Array:
    """Return the numbers of a text file, apart by commas, semicolons or spaces; lines with # or % are remarks."""
    _no_variable(wanted)
    rows: list[list[float]] = []
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, 1):
            text = line.strip()
            if not text or text[0] in "#%":
                continue
            cells = APART.split(text.strip(",;"))
            try:
                rows.append([float(cell) for cell in cells])
            except ValueError:
                place = next(i for i, cell in enumerate(cells, 1) if not _is_number(cell))
                told = f"line {number}, column {place}: {cells[place - 1][:40]!r} is no number"
                raise InputError(f"{path.name}: {told}; write numbers alone, lines with # are remarks") from None
            if len(rows[-1]) != len(rows[0]):
                told = f"line {number} has {len(rows[-1])} numbers, the first row has {len(rows[0])}"
                raise InputError(f"{path.name}: {told}; write each row of the matrix on a line of its own")
    if not rows:
        raise ValueError("it holds no numbers")
    return np.array(rows)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _of_market(path: Path, wanted: str | None, usual: str) -> Any:
    from scipy.io import mmread

    _no_variable(wanted)
    return mmread(path)


def _of_matlab(path: Path, wanted: str | None, usual: str) -> Any:
    """Return a variable of a MATLAB file, full or sparse."""
    from scipy.sparse import issparse

    values: dict[str, Any] = dict(variables_read_here(path))
    for name, value in values.items():
        if isinstance(value, Mapping) and set(value) <= SPARSE_V73 and "jc" in value:
            values[name] = _of_columns(value)
    if any(value is None for value in values.values()):
        from scipy.io import loadmat

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            values |= {name: raw for name, raw in loadmat(path).items() if issparse(raw)}
    return _chosen({name: value for name, value in values.items() if _is_matrix(value)}, wanted, usual)


def _of_columns(parts: Mapping[str, Any]) -> Any:
    """Return a square sparse matrix of MATLAB 7.3 by its columns; one without entries has neither data nor rows."""
    from scipy.sparse import csc_array

    starts = np.asarray(parts["jc"]).ravel().astype(np.int64)
    data, rows = (np.asarray(parts.get(name, ())).ravel() for name in ("data", "ir"))
    size = len(starts) - 1
    return csc_array((data, rows.astype(np.int64), starts), shape=(size, size))


def _of_npz(path: Path, wanted: str | None, usual: str) -> Any:
    """Return an array of a .npz file, or the matrix that scipy.sparse.save_npz wrote."""
    with zipfile.ZipFile(path) as archive:
        if sum(one.file_size for one in archive.infolist()) > MOST_BYTES:
            raise ValueError(f"it holds more than {MOST_BYTES / 1e6:g} MB")
    with np.load(path, allow_pickle=False) as content:
        if "format" in content.files:
            from scipy.sparse import load_npz

            _no_variable(wanted)
            return load_npz(path)
        values = {name: content[name] for name in content.files}
    return _chosen({name: value for name, value in values.items() if _is_matrix(value)}, wanted, usual)


def _of_npy(path: Path, wanted: str | None, usual: str) -> Any:
    _no_variable(wanted)
    return np.load(path, allow_pickle=False)


def _is_matrix(value: object) -> bool:
    from scipy.sparse import issparse

    return issparse(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and value.ndim <= 2)


def _no_variable(wanted: str | None) -> None:
    if wanted is not None:
        raise ValueError(f"it holds one matrix without a name; remove variable: {wanted}")


def _chosen(values: dict[str, Any], wanted: str | None, usual: str) -> Any:
    """Return the wanted variable, the one of the usual name, or the only one; raises ValueError."""
    name = wanted or (next(iter(values)) if len(values) == 1 else usual)
    if name not in values:
        raise ValueError(
            f"it has no matrix {name}, only {', '.join(values) or 'none'}; name it: {{file: FILE, variable: NAME}}"
        )
    return values[name]


READERS: dict[str, Callable[[Path, str | None, str], Any]] = {
    ".csv": _of_text, ".txt": _of_text, ".out": _of_text, ".dat": _of_text, ".mtx": _of_market, ".mat": _of_matlab,
    ".npz": _of_npz, ".npy": _of_npy,
}  # fmt: skip
"""How a matrix is read, by the end of the file's name."""
