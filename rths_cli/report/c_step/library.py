"""The files of `rths export step CASE --to c DIR`: sources, numbers, golden data, record, build file, and the page that
says what the target must do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path

from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.experiment.designed_step import DesignedStep
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import check_writable
from rths_cli.loop.guard import REASONS
from rths_cli.report.c_step.golden import Golden, golden_tests, golden_text
from rths_cli.report.c_step.numbers import data_text, numbers, refuse_other_parts, sizes, sizes_text
from rths_cli.report.c_step.operations import operations
from rths_cli.report.export_files import Target, write_all
from rths_cli.version import __version__

WRITTEN_ONCE = ("rths_step.h", "rths_step.c", "rths_sfunction.c", "udp_target.c", "CMakeLists.txt")
OF_TARGET = {
    100: "while armed: the mean of a channel at rest is too large",
    101: "while armed: the noise of a channel at rest is too large",
}
REASONS_OF_C = (*range(1, 13), 15, *range(20, 26))


def write_library(
    step: DesignedStep, folder: Path, replace: bool, progress: Callable[[str], None]
) -> tuple[list[Path], list[Path]]:
    """Write the library of a designed step into a folder; return its files, and those that were replaced.

    Raises InputError for a part that C cannot have, and before anything is written, where a file cannot be written.
    """
    refuse_other_parts(step)
    texts = library_texts(step, golden_tests(step))
    targets = [Target(folder / name, _writer(text)) for name, text in texts.items()]
    replaced = check_existing([(target.path, Kind.DOCUMENT) for target in targets], replace)
    check_writable(folder, sum(map(len, texts.values())))
    write_all(targets, progress)
    return [target.path for target in targets], list(replaced)


def _writer(text: str) -> Callable[[Path, Callable[[str], None]], None]:
    return lambda path, _: path.write_bytes(text.encode())  # type: ignore[return-value]


def library_texts(step: DesignedStep, tests: tuple[Golden, Golden]) -> dict[str, str]:
    """Return the text of each file by its name; raises InputError for a part that C cannot have."""
    source = files("rths_cli.report.c_step") / "source"
    return {
        **{name: (source / name).read_text(encoding="utf-8") for name in WRITTEN_ONCE},
        "rths_sizes.h": sizes_text(step),
        "rths_data.c": data_text(step),
        "golden.c": golden_text(step, tests),
        "record.csv": record_text(step),
        "README.md": readme(step),
    }


def record_text(step: DesignedStep) -> str:
    """Return the rows of `rths_inputs.ground` as a table."""
    rows = "\n".join(f"{k},{numbers(row).replace(' ', '')}" for k, row in enumerate(step.drive))
    return f"row,acceleration_m_s2,velocity_m_s,displacement_m\n{rows}\n"


def readme(step: DesignedStep) -> str:
    """Return the page of the library."""
    info, count = step.info, len(step.drive)
    wiring = [
        [str(c), one.name, one.position or one.kind, _short(one.sensitivity_v_per_unit), one.unit, _short(one.range_v)]
        for c, one in enumerate(info.all_channels)
    ]
    told = operations(sizes(step), isinstance(step.blocks.feedforward, FrictionFeedforward))
    work = [[name, *map(str, each)] for name, each in told.items()]
    reasons = {number: REASONS[number] for number in REASONS_OF_C} | OF_TARGET
    values = {
        "CASE": step.name,
        "VERSION": __version__,
        "CASE_SHA": step.case_sha256,
        "MODEL_SHA": step.model_sha256,
        "MODEL": step.model or "not stated",
        "RIG": f"{info.name} (kind {info.kind})",
        "VIRTUAL": "" if info.can.moves_hardware else VIRTUAL.replace("@RIG@", info.name),
        "RATE": f"{1.0 / info.dt_s:g}",
        "US": f"{1e6 * info.dt_s:g}",
        "COUNT": str(count),
        "SECONDS": f"{count * info.dt_s:.4g}",
        "ZERO_S": f"{step.zero_steps * info.dt_s:g}",
        "STILL_S": f"{step.still_steps * info.dt_s:g}",
        "RAMP_S": f"{step.ramp_steps * info.dt_s:g}",
        "LEAD": str(step.blocks.lead_samples),
        "LATENCY": str(step.blocks.latency_samples),
        "LOST": str(info.limits.lost_samples),
        "RANGE": _short(info.converters.range_v),
        "GAIN": _short(info.gain_m_per_v),
        "WIRING": _table(("samples_v[]", "channel", "measures", "V per unit", "unit", "range V"), wiring),
        "OPERATIONS": _table(("block", "products", "other sums", "functions"), work),
        "REASONS": _table(("reason", "why"), [[str(number), text] for number, text in reasons.items()]),
    }
    text = (files("rths_cli.report.c_step") / "source" / "README.md").read_text(encoding="utf-8")
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    return text


VIRTUAL = (
    "\n**This step was designed for the virtual rig @RIG@. It is for rehearsals; never let it move a real table.**\n"
)


def _short(value: float) -> str:
    return f"{value:.6g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in line) + " |" for line in lines)


def summary(step: DesignedStep) -> Mapping[str, object]:
    """Return what identifies a written step, for `--json`."""
    return {"case": step.name, "case_sha256": step.case_sha256, "model_sha256": step.model_sha256}
