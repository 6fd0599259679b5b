"""Options of `rths report`, checked before anything is read; render in a text format, write the output file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_reader import Result
from rths_cli.files.result_writer import check_writable, refusal
from rths_cli.files.sweep_parquet import check_parquet
from rths_cli.report.group_comparison import DEFAULT_PERCENT
from rths_cli.report.input_files import read_inputs
from rths_cli.report.report_contents import Contents, all_sections, contents, page_sections
from rths_cli.report.result_scale import in_model_scale, reported, scale_words
from rths_cli.safe_text import visible

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Asked:
    """Options of `rths report`."""

    paths: tuple[Path, ...]  # result files, sweeps and folders of them
    table: str  # format of the tables; "": text
    output: Path | None  # file for the tables; None: they are printed
    figures: Path | None  # folder for figures; None: no figures
    drawn: str  # format of the figures; "": the default
    width: str  # of the figures
    header: str  # of the figures
    metric: str  # of the figures of sweeps; "": the default
    keys: tuple[str, ...]  # of --group-by
    baseline: Path | None  # file or folder to compare with; None: no comparison
    percent: float | None  # by how much an error may exceed the baseline; None: a worse error is no failure
    keep_going: bool  # whether files that cannot be used are skipped
    junit: Path | None  # JUnit file; None: none is written
    replace: bool = True  # whether files that exist may be replaced
    full: bool = False  # whether a text has every figure
    paper: bool = False  # whether it has published errors, and the paper's claims in any case
    report_in: str | None = None  # model or prototype; None: as the cases state it
    parquet: Path | None = None  # file for the table of a sweep; None: none is written


def check_asked(asked: Asked) -> tuple[Path, ...]:
    """Return the output files that will be replaced; raises InputError if options contradict each other, or an output
    file cannot be written."""
    faults = []
    if asked.drawn and not asked.figures:
        faults.append(f"--format {asked.drawn} is a format of figures; add --figures DIR.")
    if asked.metric and not asked.figures:
        faults.append("--metric chooses what the figure of a sweep shows; add --figures DIR.")
    if asked.percent is not None and not asked.baseline:
        faults.append("--fail-worse compares with a baseline; add --baseline FILE_OR_DIR.")
    if asked.table == "html" and not asked.output:
        faults.append("--format html is one file; add --output FILE, for instance --output report.html.")
    if asked.output and asked.junit and asked.output.resolve() == asked.junit.resolve():
        faults.append(f"--output and --junit are both {asked.output}; give two names.")
    if asked.parquet and asked.parquet.resolve() in {path.resolve() for path in (asked.output, asked.junit) if path}:
        faults.append(f"--parquet {asked.parquet}: is another output too; give two names.")
    if asked.figures and asked.figures.exists() and not asked.figures.is_dir():
        faults.append(f"--figures {asked.figures}: is a file; name a folder.")
    if faults:
        raise InputError(*faults)
    if asked.parquet:
        check_parquet()
    read = [*asked.paths, *((asked.baseline,) if asked.baseline else ())]
    replaced: list[Path] = []
    for option, path in (("--output", asked.output), ("--junit", asked.junit), ("--parquet", asked.parquet)):
        if path:
            replaced += check_output(option, path, read, asked.replace)
            check_writable(path.parent)
    return tuple(replaced)


def read_asked(asked: Asked, tell: Tell) -> Contents:
    """Read the files of a report and return its contents; raises InputError as `contents` does."""
    inputs = read_inputs(asked.paths, tell)
    other = read_inputs((asked.baseline,), tell) if asked.baseline else None
    # both in one scale, so that they can be compared
    scaled = reported((*inputs.results, *(other.results if other else ())), asked.report_in)
    inputs, rest = replace(inputs, results=tuple(scaled[: len(inputs.results)])), scaled[len(inputs.results) :]
    if any(in_model_scale(one) is not one for one in inputs.results):
        _check_scales(str(asked.baseline), rest)
    before = None
    if other:
        percent = DEFAULT_PERCENT if asked.percent is None else asked.percent
        before = str(asked.baseline), replace(other, results=tuple(rest)), percent
    return contents(inputs, asked.keys, before, asked.keep_going)


def _check_scales(baseline: str, results: Sequence[Result]) -> None:
    """Raise InputError if a result of the baseline has no prototype to be compared in."""
    without = [str(one.path) for one in results if not scale_words(one)]
    if without:
        raise InputError(
            f"--baseline {baseline}: {without[0]} states no scale, so there is nothing to compare in prototype scale; "
            "give --report-in model."
        )


def rendered(asked: Asked, found: Contents) -> str:
    """Return the tables of a report in the requested format; raises InputError if a stored text is not valid JSON."""
    if asked.table == "json":
        from rths_cli.report.formats.json_document import document

        return json.dumps(document(found), indent=2, allow_nan=False) + "\n"
    if asked.table == "csv":
        from rths_cli.report.formats.csv_table import tidy

        return tidy(found)
    if asked.table == "markdown":
        from rths_cli.report.to_files import markdown

        return markdown(all_sections(found, paper=asked.paper))
    if asked.table == "latex":
        from rths_cli.report.to_files import latex

        return latex(all_sections(found, paper=asked.paper))
    from rths_cli.report.to_text import text

    return text(page_sections(found, asked.full, asked.paper))


def check_output(option: str, path: Path, inputs: Iterable[Path], replace: bool = True) -> tuple[Path, ...]:
    """Return the output path if a file there will be replaced, else ().

    Raises InputError if it is a folder, an input, a result or a case, its folder does not exist, or what is there may
    not be replaced.
    """
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; give the name of a file in it.")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}; make it first.")
    if path.resolve() in {one.resolve() for one in inputs}:
        raise InputError(f"{option} {path}: is read for this report; choose another name.")
    if path.suffix in (".h5", ".rthslog", ".yaml", ".yml"):
        raise InputError(f"{option} {path}: has the name or the content of a result or case; choose another name.")
    return check_existing([(path, Kind.DOCUMENT)], replace, streams=True)


def write_text(path: Path, text: str) -> None:
    """Write a text to a file that appears only when complete; control characters are made visible.

    Raises InputError if it cannot be written.
    """
    try:
        with written_whole(path) as part:
            part.write_bytes(visible(text).encode())
    except OSError as error:
        raise InputError(refusal(path, "cannot write", error, advice=False)) from error
