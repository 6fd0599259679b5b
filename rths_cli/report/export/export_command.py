"""The work of `rths export`: read and check all results first, then write each one completely or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_reader import result_files
from rths_cli.files.result_writer import check_writable
from rths_cli.report.export.csv_files import csv_targets
from rths_cli.report.export.matlab_file import mat_targets
from rths_cli.report.export.source_and_target import Source, Target, open_source, write_all

FORMATS: Mapping[str, Callable[[Source, Path], list[Target]]] = {
    "csv": csv_targets,
    "mat": mat_targets,
}
NETCDF_REMOVED = (
    "netcdf is no longer a format: a result file is netCDF-4 itself; "
    'xarray.open_dataset("RESULT.h5", group="exp_rths", engine="h5netcdf") reads it, ncread in MATLAB'
)
TEXT_FACTOR = 2.1  # bytes of a number in CSV over those of the number, at most


@dataclass(frozen=True)
class ExportRequest:
    """Arguments of `rths export`."""

    paths: tuple[Path, ...]  # result files or folders of them
    form: str  # format: csv or mat
    folder: Path  # for the exported files
    groups: tuple[str, ...] = ()  # groups to export, with the groups in them; (): all
    replace: bool = True  # whether existing files may be replaced


@dataclass(frozen=True)
class Exported:
    """A result that was exported."""

    result: Path
    status: str  # of the result
    reason: str  # of that status
    files: tuple[Path, ...]  # that were written
    replaced: tuple[Path, ...] = ()  # those of them that were there before


def export(request: ExportRequest, progress: Callable[[str], None] = lambda _: None) -> list[Exported]:
    """Write every result of a request; raises InputError with all faults before the first is written."""
    planned = plan(request)
    needed = sum(source.total_bytes for source, _ in planned)
    check_writable(request.folder, int(needed * (TEXT_FACTOR if request.form == "csv" else 1.0)))
    done = []
    for source, targets in planned:
        replaced = tuple(target.path for target in targets if target.path.exists())
        write_all(targets, progress)
        about = source.result.attributes
        files = tuple(target.path for target in targets)
        done.append(
            Exported(source.result.path, str(about["status"]), str(about.get("status_reason", "")), files, replaced)
        )
    return done


def plan(request: ExportRequest) -> list[tuple[Source, list[Target]]]:
    """Read every result and name its files; raises InputError with all faults, writes nothing."""
    found, empty = result_files(request.paths)
    faults = list(empty.values())
    planned: list[tuple[Source, list[Target]]] = []
    for path in found:
        try:
            source = open_source(path, request.groups)
            planned.append((source, FORMATS[request.form](source, request.folder)))
        except InputError as error:
            faults += error.faults
    faults += _shared(planned)
    if faults:
        raise InputError(*faults)
    check_existing([(target.path, Kind.DOCUMENT) for _, targets in planned for target in targets], request.replace)
    return planned


def _shared(planned: Sequence[tuple[Source, list[Target]]]) -> list[str]:
    """Return a sentence for each file name that two results share."""
    first: dict[Path, Path] = {}
    faults = []
    for source, targets in planned:
        for target in targets:
            other = first.setdefault(target.path, source.result.path)
            if other != source.result.path:
                advice = "export them to different folders"
                faults.append(f"{source.result.path}: would become {target.path}, as {other} does; {advice}")
    return faults
