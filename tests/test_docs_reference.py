"""The reference is what the code says, and says all of it: commands, options, keys, attributes, datasets, figures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any, get_args

import click
import h5py
import pytest
from declared_contents import declaration_faults, model_faults
from docs_modules import with_map
from docs_reference import FOLDER, PAGES, SOURCE_MAP
from docs_running import run_words, shortened
from pydantic import BaseModel

from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.rig_schema import KINDS, PluginRigSpec
from rths_cli.case.storey_law_schema import KINDS as LAWS
from rths_cli.case.virtual_imperfections_schema import Values
from rths_cli.cli import cli
from rths_cli.loop.run_log import Sizes, column_names, column_units
from rths_cli.quantities import ATTRIBUTES, AXES, BLOCKS
from rths_cli.quantities.attributes import OF_BLOCK, OF_FILE, OF_RUN
from rths_cli.quantities.datasets import BEST, STORED, declared_datasets
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, declared_model_datasets, model_dataset
from rths_cli.quantities.raw_log_columns import RAW_LOG_COLUMNS
from rths_cli.quantities.sweep_datasets import SWEEP_ATTRIBUTES, SWEEP_DATASETS

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"


def sections(page: Path) -> dict[str, str]:
    """Return the text below each heading of the second level."""
    parts = re.split(r"^## (.*)\n", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows(text: str) -> list[list[str]]:
    """Return the cells of every row whose first one is code."""
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def first_cells(text: str) -> list[str]:
    return [cells[0].strip("`") for cells in rows(text)]


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_the_generated_one(name: str) -> None:
    same = (FOLDER / name).read_text(encoding="utf-8") == PAGES[name]()
    assert same, f"docs/reference/{name} is stale; write it anew: python tests/helpers/docs_reference.py"


def test_the_source_map_is_the_generated_one() -> None:
    text = SOURCE_MAP.read_text(encoding="utf-8")
    assert text == with_map(text), "the source map is stale; write it anew: python tests/helpers/docs_reference.py"


def test_every_command_and_option_is_told_with_its_help() -> None:
    told = sections(FOLDER / "commands.md")
    assert {head.strip("`").split()[1] for head in told if " " in head} == set(cli.commands)
    for head, text in told.items():
        words = head.strip("`").split()
        command: click.Command = cli.commands[words[1]] if len(words) > 1 else cli
        options = [p for p in command.params if isinstance(p, click.Option)]
        listed = {cells[0].strip("`"): cells[1] for cells in rows(text)}
        for option in options:
            (about,) = [about for shown, about in listed.items() if shown.split()[0].rstrip(",") == option.opts[0]]
            assert option.help and option.help.partition("  ")[0] in about, (head, option.opts)
        assert len(listed) == len(options) + 1  # --help
        assert "Example:" in (command.help or "") and "```sh\nrths" in text, head


def models_in(annotation: Any) -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield the models in an annotation, each with what stands between its key and theirs."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield ".", annotation
    mark = {dict: ".NAME", tuple: "[]"}.get(getattr(annotation, "__origin__", None), "")
    for part in get_args(annotation):
        for inner, model in models_in(part):
            yield mark + inner, model


def keys_of(model: type[BaseModel], prefix: str = "") -> set[str]:
    """Return every key below a model as a path."""
    found = {prefix + key for key in model.model_fields}
    for key, field in model.model_fields.items():
        for mark, inner in models_in(field.annotation):
            if inner is not Values:  # one value, a list or a distribution: the key's own row tells how to state it
                found |= keys_of(inner, f"{prefix}{key}{mark}")
    return found


def test_every_key_of_a_case_is_told_once_with_its_meaning() -> None:
    page = (FOLDER / "case.md").read_text(encoding="utf-8")
    told = first_cells(page)
    assert len(told) == len(set(told))
    wanted = {key for key in keys_of(CaseKeys) if not key.startswith(("table.", "structure.numerical.law["))}
    assert len(wanted) > 60 and set(told) == wanted
    assert [cells[0] for cells in rows(page) if not cells[5]] == []


def test_every_key_of_every_law_is_told_with_its_meaning() -> None:
    page = (FOLDER / "storey_laws.md").read_text(encoding="utf-8")
    wanted = {
        f"Kind `{kind}`": {field.alias or key for key, field in model.model_fields.items()}
        for kind, model in LAWS.items()
    }
    assert {head: set(first_cells(text)) for head, text in sections(FOLDER / "storey_laws.md").items()} == wanted
    assert [cells[0] for cells in rows(page) if not cells[5]] == []


def test_every_key_of_every_rig_is_told() -> None:
    page = sections(FOLDER / "rig.md")  # entries of a list that state their kind stand apart: `channels[kind].`
    told = {head: [cell.replace("[kind]", "[]") for cell in first_cells(text)] for head, text in page.items()}
    real = {"Kind `udp`": KINDS["udp"], "Kind `ni`": KINDS["ni"], "Kind of a package": PluginRigSpec}
    virtual = {
        key.removesuffix(".mean").removesuffix(".std") if key.startswith("imperfections.") else key
        for key in keys_of(KINDS["virtual"])
        if not key.startswith("physics.specimen_laws[")
    }
    assert set(told["Kind `virtual`"]) == virtual  # the keys of laws have a page of their own
    for head, model in real.items():
        assert set(told[head]) | set(told["Every other kind"]) == keys_of(model), head
    assert [cells[0] for cells in rows((FOLDER / "rig.md").read_text(encoding="utf-8")) if not cells[5]] == []


def test_defaults_and_limits_are_those_that_are_checked() -> None:
    told = {cells[0].strip("`"): cells for cells in rows((FOLDER / "case.md").read_text(encoding="utf-8"))}
    assert told["delay_s"][1:5] == ["number", "s", "`0.005`", ">= 0 and <= 0.1"]
    assert told["scaling"][2:5] == ["-", "**required**", "> 0 and <= 100"]
    assert told["structure.experimental.dashpots_n_s_per_m"][2] == "N*s/m"
    assert told["controller.disturbance_hz"][1:5] == [
        "list of number", "Hz", "-", ">= 0.05 and <= 500; 2 entries",
    ]  # fmt: skip
    from rths_cli.case.load import load_cases

    for value, code in (("0.1", 0), ("0.11", 2)):
        assert run_words(["check", CASE, "--resolved", "--set", f"delay_s={value}"])[0] == code
    assert load_cases([CASE])[0].delay_s == float(told["delay_s"][3].strip("`"))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Return the open results of both methods on a record of 6 s, and a model file."""
    with chdir(tmp_path_factory.mktemp("files")):
        shortened(ROOT / "records" / "el_centro.csv", Path("short.csv"), 300)
        made = ["run", CASE, "--method", "best", "--method", "paper", "--set", "record.file=short.csv", "--quiet"]
        assert run_words(made)[0] == 0
        assert run_words(["identify", CASE, "--output", "model.h5", "--no-figure"])[0] == 0
        opened = [h5py.File(name) for name in (f"results/{CASE}-best.h5", f"results/{CASE}-paper.h5", "model.h5")]
        yield dict(zip(("best", "paper", "model"), opened, strict=True))
        for file in opened:
            file.close()


def datasets(file: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    file.visititems(lambda name, node: found.update({f"/{name}": node}) if isinstance(node, h5py.Dataset) else None)
    return found


def test_every_dataset_and_attribute_of_a_result_is_what_is_declared(files: dict[str, Any]) -> None:
    for method in ("best", "paper"):
        assert declaration_faults(Path(files[method].filename)) == []
    held = {path.strip("/") for path in datasets(files["best"])}
    virtual = {path for path, one in STORED.items() if one.present in ("", BEST)}
    assert virtual - held == set()
    assert [path for path in datasets(files["paper"]) if path.endswith("base_shear_unexplained_n")] == []
    absent = {one.name for one in ATTRIBUTES.values() if not one.present} - set(files["best"].attrs)
    assert absent == {"shake_table_status_reason", "exp_rths_status_reason"}


def test_every_declared_dataset_attribute_block_and_axis_is_told_once() -> None:
    told = {head: rows(text) for head, text in sections(FOLDER / "hdf5.md").items()}
    shown = {cells[0].strip("`/"): cells for head, found in told.items() for cells in found if head.startswith("`/")}
    declared = {path: one for one in declared_datasets() for path in one.stored_paths}
    assert set(shown) - set(BLOCKS) - {one.name for one in OF_BLOCK} == set(declared)
    for path, one in declared.items():
        assert shown[path][1:4] == [f"({', '.join(one.axes)})" if one.axes else "one value", one.units, one.source]
        assert shown[path][4].startswith(one.text) and one.present in shown[path][4], path
        assert all(remark in shown[path][4] for remark in one.remarks)
    attributes = {cells[0].strip("`"): cells[1] for cells in told["Attributes of a result"]}
    assert attributes.keys() == {one.name for one in (*OF_FILE, *OF_RUN)}
    assert all(attributes[one.name].startswith(one.text) for one in (*OF_FILE, *OF_RUN))
    page = (FOLDER / "hdf5.md").read_text(encoding="utf-8")
    for name, axis in AXES.items():
        assert f"| `{name}` | {axis.units} | {axis.text} |" in page
    assert {cells[0].strip("`") for cells in told["`/controller/BLOCK`"]} >= set(BLOCKS)


def test_a_model_holds_what_is_declared_and_the_page_tells_all_of_it(files: dict[str, Any]) -> None:
    assert model_faults(Path(files["model"].filename)) == []
    groups = {path.strip("/").rpartition("/")[0] for path in datasets(files["model"])}
    held = {model_dataset(group, name) for group in groups for name in files["model"][group]}
    held |= {model_dataset(group, name.removesuffix("_real")) for group in groups for name in files["model"][group]}
    left_out = {one.path for one in declared_model_datasets()} - {one.path for one in held if one}
    of_others = "calibration/", "pitch/", "nonlinear_specimen/"  # a rig as declared has none of these
    left_out = {path for path in left_out if not path.startswith(of_others)}
    assert left_out <= {"verdict/reasons", "verdict/warnings", "level_causes/table", "level_causes/storeys"}
    told = {cells[0].strip("`/"): cells for cells in rows((FOLDER / "hdf5.md").read_text(encoding="utf-8"))}
    for one in (*declared_model_datasets(), *SWEEP_DATASETS.values()):
        for path in one.stored_paths:
            if one.name not in SWEEP_ATTRIBUTES:  # of the same name: seed, status, model_sha256
                assert told[path][2:4] == [one.units, one.source] and told[path][4].startswith(one.text)
    assert set(told) >= {*MODEL_ATTRIBUTES, *SWEEP_ATTRIBUTES}


def test_every_figure_of_a_result_is_told_with_its_unit(files: dict[str, Any]) -> None:
    told = {cells[0].strip("`"): cells for cells in rows((FOLDER / "metrics.md").read_text(encoding="utf-8"))}
    shown = {path + kind: cells for path, cells in told.items() for kind in ["", *re.findall(r"`(_\w+)`", cells[1])]}
    for method in ("best", "paper"):
        figures = {path: node for path, node in datasets(files[method]).items() if path.startswith("/metrics/")}
        assert len(figures) > 150
        for path, node in figures.items():
            if not node.is_scale:
                assert shown[path.removeprefix("/metrics/").replace("/", ".")][2] == node.attrs["units"], path


def test_every_column_of_a_raw_log_is_told_once() -> None:
    told = rows(sections(FOLDER / "raw_log.md")["Columns"])
    assert [cells[0].strip("`").removesuffix("_I") for cells in told] == list(RAW_LOG_COLUMNS)
    assert [cells[1:] for cells in told] == [[one.units, one.source, one.text] for one in RAW_LOG_COLUMNS.values()]
    written = {
        name if name in RAW_LOG_COLUMNS else name.rpartition("_")[0] for name in column_names(Sizes(3, 7, 1, further=2))
    }
    assert written == set(RAW_LOG_COLUMNS) and len(column_units(column_names(Sizes(3, 7, 1, further=2)))) == 28
