"""The reference page of result, model and sweep files, from the declarations of what they hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import groupby

from rths_cli.quantities import AXES, BLOCKS, AttributeDeclaration, DatasetDeclaration
from rths_cli.quantities.attributes import OF_BLOCK, OF_FILE, OF_RUN
from rths_cli.quantities.datasets import GROUPS, declared_datasets
from rths_cli.quantities.declaration import ROUNDED_BITS
from rths_cli.quantities.model_datasets import GROUPS as MODEL_GROUPS
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, declared_model_datasets
from rths_cli.quantities.sweep_datasets import OF_SWEEP, SWEEP_DATASETS

HEAD = """# Result, model and sweep files (HDF5)

This page is made by `python tests/helpers/docs_reference.py` from the declarations in `rths_cli/quantities`.
Format version 1. [Read a result](../howto/reading_results.md) shows how to read the files from Python and MATLAB.

Every dataset has the attributes `units`, `long_name` (its meaning below) and `source` (computed, measured, estimated,
true). Below, its unit and axes follow its name: `/a/b`, m (storey, time_s). Without a unit it is a pure number or a
text, without axes a single value. Time or frequency is the last axis. A complex value is two datasets, whose names end
in `_real` and `_imag`. Every group holds its own scales, so that a run that was stopped is shorter than the record.
Runs that a case does not name are not there.

Numbers are double precision. Series marked "{bits} binary digits" follow from others of their group and are rounded to
that many of each row's largest value (an error of at most 2.3e-10 of it). `rths run --series essential` keeps, of all
runs and the record, the datasets marked as essential, in single precision; `--series none` keeps none of these. A file
may add to `long_name` what a series is: {remarks}.

In a path, `RUN` is `shake_table` or `exp_rths`, `SOLUTION` is `sim` or `sim_delay`. The axes and their scales:
"""
COUNTED = ", counted from 1"


def hdf5_page() -> str:
    """Return the page as Markdown: attributes and a list per group of a result, of a model, of a sweep."""
    return "\n\n".join([*_result(), *_model(), *_sweep()]) + "\n"


def _result() -> Iterator[str]:
    remarks = dict.fromkeys(remark for one in declared_datasets() for remark in one.remarks)
    yield HEAD.rstrip().format(bits=ROUNDED_BITS, remarks="; ".join(remarks))
    yield _list(_entry(one.name, one.units, (), one.text) for one in AXES.values() if not one.text.endswith(COUNTED))
    counts = {one.name: one.text.removesuffix(COUNTED) for one in AXES.values() if one.text.endswith(COUNTED)}
    yield f"These count from 1: {', '.join(f'`{name}` ({text})' for name, text in counts.items())}."
    yield "## Attributes of a result"
    yield _attributes(OF_FILE)
    yield "For each run RUN on the table (`shake_table`, `exp_rths`):"
    yield _attributes(OF_RUN)
    declared: dict[str, list[DatasetDeclaration]] = {}
    for one in declared_datasets():
        declared.setdefault(one.group, []).append(one)
    for group, about in GROUPS.items():
        source = _most_common(one.source for one in declared[group])
        conditions = [one.present for one in declared[group]]
        present = _most_common(conditions) if all(conditions) else ""
        yield f"## `/{group}`"
        yield f"{about} Unless stated: {', '.join(filter(None, (source, present)))}."
        if group == "controller/BLOCK":
            yield "Its attributes:"
            yield _attributes(OF_BLOCK)
            yield "The blocks are:"
            yield _list(f"`{name}`: {about}" for name, about in BLOCKS.items())
            yield "Each has:"
        yield _datasets(declared[group], source, present)
    yield "## `/metrics`"
    yield (
        "One dataset per metric: [metrics](metrics.md) lists them all. `/metrics/exp_rths/rms_error_m_s2` is "
        "`exp_rths.rms_error_m_s2`. Beside the attributes above each has its `definition`, and one with an "
        "interval has `low`, `high` (of its shape) and `probability`."
    )


def _model() -> Iterator[str]:
    declared = list(declared_model_datasets())
    source = _most_common(one.source for one in declared)
    yield "## Model files"
    yield (
        "What `rths identify` writes; what was not found is left out. True and false are 1 and 0. "
        f"Unless stated, datasets are {source}."
    )
    yield _attributes(MODEL_ATTRIBUTES.values())
    yield "`METHOD` is best or paper, `RECORD` excitation, free_vibration or low_level, `CHANNEL` a channel's name."
    for group, members in groupby(declared, key=lambda one: one.group):
        yield f"### `/{group}`"
        yield MODEL_GROUPS[group]
        yield _datasets(members, source, "")


def _sweep() -> Iterator[str]:
    yield "## Sweep files"
    yield (
        "What `rths sweep` writes, without groups: a row per run, computed. Beside what is below it holds each varied "
        "key under its dotted name, and each metric of the runs under its path, (variant) or (variant, storey)."
    )
    yield _datasets(SWEEP_DATASETS.values(), "computed", "")
    yield "Its attributes, beside those of a result:"
    yield _attributes(OF_SWEEP)


def _most_common(words: Iterable[str]) -> str:
    return Counter(words).most_common(1)[0][0]


def _attributes(declared: Iterable[AttributeDeclaration]) -> str:
    return _list(f"`{one.name}`: {one.text}{_condition(one.present)}" for one in declared)


def _datasets(members: Iterable[DatasetDeclaration], source: str, present: str) -> str:
    """Return the list of a group's datasets, each with source and condition where they are not those of the group."""
    return _list(_dataset(one, source, present) for one in members)


def _dataset(one: DatasetDeclaration, source: str, present: str) -> str:
    own = (text for text, common in ((one.source, source), (one.present, present)) if text != common)
    rounded = f"{ROUNDED_BITS} binary digits" if one.follows else ""
    marks = "; ".join(filter(None, (*own, "essential" if one.essential else "", rounded)))
    return _entry(f"/{one.path}", one.units, one.axes, one.text + _condition(marks), one.kind == "complex")


def _entry(name: str, units: str, axes: tuple[str, ...], text: str, parts: bool = False) -> str:
    unit, shape = "" if units == "1" else f", {units}", f" ({', '.join(axes)})" if axes else ""
    return f"`{name}`{' (`_real`, `_imag`)' if parts else ''}{unit}{shape}: {text}"


def _condition(present: str) -> str:
    return f" ({present})" if present else ""


def _list(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
