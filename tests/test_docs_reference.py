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
from rths_cli.quantities import ATTRIBUTES, AXES, BLOCKS, DatasetDeclaration
from rths_cli.quantities.attributes import OF_BLOCK, OF_FILE, OF_RUN
from rths_cli.quantities.datasets import BEST, RAW_LOG_COLUMNS, STORED, declared_datasets
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, declared_model_datasets, model_dataset
from rths_cli.quantities.sweep_datasets import SWEEP_ATTRIBUTES, SWEEP_DATASETS

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
SOURCES = ("computed", "measured", "estimated", "true")


def sections(page: Path) -> dict[str, str]:
    """Return the text below each heading of the second level."""
    parts = re.split(r"^## (.*)\n", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows(text: str) -> list[list[str]]:
    """Return the cells of every row whose first one is code."""
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def entries(text: str) -> dict[str, str]:
    """Return the lines of a text's lists that begin with a name in code, by it, without the mark of the list."""
    return {line.split("`")[1]: line.removeprefix("- ") for line in text.splitlines() if line.startswith("- `")}


def keys_told(text: str) -> list[str]:
    return re.findall("^- `([^`]+)`", text, re.MULTILINE)


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_the_generated_one(name: str) -> None:
    same = (FOLDER / name).read_text(encoding="utf-8") == PAGES[name]()
    assert same, f"docs/reference/{name} is stale; write it anew: python tests/helpers/docs_reference.py"


def test_the_source_map_is_the_generated_one() -> None:
    text = SOURCE_MAP.read_text(encoding="utf-8")
    assert text == with_map(text), "the source map is stale; write it anew: python tests/helpers/docs_reference.py"


def test_every_command_is_told_with_its_options() -> None:
    told = sections(FOLDER / "commands.md")
    shared = entries(told.pop("Options of several commands"))
    assert {head.strip("`").split()[1] for head in told if " " in head} == set(cli.commands)
    for head, text in told.items():
        words = head.strip("`").split()
        command: click.Command = cli.commands[words[1]] if len(words) > 1 else cli
        options = [p for p in command.params if isinstance(p, click.Option)]
        own = entries(text) or set(re.findall("`(-[^`]+)`", text.rpartition("\nOptions: ")[2].partition("\nAlso ")[0]))
        further = set(re.findall("`(--[a-z-]+)`", text.rpartition("\nAlso ")[2])) if "\nAlso " in text else set()
        assert further <= {option.opts[-1] for option in options}, head
        of_all = {"--json", "--log", "--verbose"} if len(words) > 1 else set()
        for option in options:
            named = further | of_all if option.opts[0] in ("-v", *further, *of_all) else set()
            listed = shared if option.opts[-1] in named else own
            (shown,) = [shown for shown in listed if shown.split()[0].rstrip(",") == option.opts[0]]
            assert option.help, (head, option.opts)
            assert listed is not shared or option.help.partition("  ")[0] in shared[shown], (head, option.opts)
        assert "Example:" in (command.help or "") and "```sh\nrths" in text, head
    assert {"--json", "--log FILE", "-v, --verbose", "-h, --help"} <= set(shared)


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
    told = keys_told(page)
    assert len(told) == len(set(told))
    wanted = {key for key in keys_of(CaseKeys) if not key.startswith(("table.", "structure.numerical.law["))}
    assert len(wanted) > 60 and set(told) == wanted
    assert [line for line in page.splitlines() if line.startswith("- ") and not re.search(": .", line)] == []


def test_every_key_of_every_law_is_told_with_its_meaning() -> None:
    page = (FOLDER / "storey_laws.md").read_text(encoding="utf-8")
    wanted = {
        f"Kind `{kind}`": {field.alias or key for key, field in model.model_fields.items()}
        for kind, model in LAWS.items()
    }
    assert {head: set(keys_told(text)) for head, text in sections(FOLDER / "storey_laws.md").items()} == wanted
    assert [line for line in page.splitlines() if line.startswith("- ") and not re.search(": .", line)] == []


def test_every_key_of_every_rig_is_told() -> None:
    page = sections(FOLDER / "rig.md")  # entries of a list that state their kind stand apart: `channels[kind].`
    told = {head: {cell.replace("[kind]", "[]") for cell in keys_told(text)} for head, text in page.items()}
    real = {"Kind `udp`": KINDS["udp"], "Kind `ni`": KINDS["ni"], "Kind of a package": PluginRigSpec}
    virtual = {
        key.removesuffix(".mean").removesuffix(".std") if key.startswith("imperfections.") else key
        for key in keys_of(KINDS["virtual"])
        if not key.startswith("physics.specimen_laws[")
    }
    assert told["Kind `virtual`"] | told["Every kind"] == virtual  # the keys of laws have a page of their own
    for head, model in real.items():
        assert told[head] | told["Every real rig"] | told["Every kind"] == keys_of(model), head
    for text in page.values():
        assert len(keys_told(text)) == len(set(keys_told(text)))
    lines = (FOLDER / "rig.md").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("- ") and not re.search(": .", line)] == []


def test_defaults_and_limits_are_those_that_are_checked() -> None:
    told = entries((FOLDER / "case.md").read_text(encoding="utf-8"))
    assert told["delay_s"].startswith("`delay_s` [0, 0.1], default `0.005`: ")
    assert told["scaling"].startswith("`scaling` (0, 100], **required**: ")
    assert told["controller.disturbance_hz"].startswith("`controller.disturbance_hz` list of [0.05, 500], 2 entries: ")
    from rths_cli.case.load import load_cases

    for value, code in (("0.1", 0), ("0.11", 2)):
        assert run_words(["check", CASE, "--resolved", "--set", f"delay_s={value}"])[0] == code
    assert load_cases([CASE])[0].delay_s == 0.005


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


@pytest.mark.campaign
def test_every_dataset_and_attribute_of_a_result_is_what_is_declared(files: dict[str, Any]) -> None:
    for method in ("best", "paper"):
        assert declaration_faults(Path(files[method].filename)) == []
    held = {path.strip("/") for path in datasets(files["best"])}
    virtual = {path for path, one in STORED.items() if one.present in ("", BEST)}
    assert virtual - held == set()
    assert [path for path in datasets(files["paper"]) if path.endswith("base_shear_unexplained_n")] == []
    absent = {one.name for one in ATTRIBUTES.values() if not one.present} - set(files["best"].attrs)
    assert absent == {"shake_table_status_reason", "exp_rths_status_reason"}


def head_of(name: str, units: str, axes: tuple[str, ...], parts: bool = False) -> str:
    """Return how the page begins the entry of a dataset: its name, unit and axes."""
    unit, shape = f", {units}" if units != "1" else "", f" ({', '.join(axes)})" if axes else ""
    return f"`{name}`{' (`_real`, `_imag`)' if parts else ''}{unit}{shape}: "


def same(line: str, one: DatasetDeclaration, place: str) -> bool:
    """Tell whether an entry has name, unit, axes and meaning of a dataset; its source is there or that of the place."""
    begins = head_of(f"/{one.path}", one.units, one.axes, one.kind == "complex") + one.text
    marks = line.removeprefix(begins)
    told = [word for text in (marks, place) for word in re.findall(rf"\b(?:{'|'.join(SOURCES)})\b", text)]
    return line.startswith(begins) and told[:1] == [one.source] and one.present in marks + place


def test_every_declared_dataset_attribute_block_and_axis_is_told_once() -> None:
    told = sections(FOLDER / "hdf5.md")
    shown = {
        name: (line, text) for text in told.values() for name, line in entries(text.partition("\n### ")[0]).items()
    }
    declared = {f"/{one.path}": one for one in declared_datasets()}
    of_a_sweep = {f"/{path}" for path in SWEEP_DATASETS}
    assert {name for name in shown if name.startswith("/")} == set(declared) | of_a_sweep
    for path, one in declared.items():
        line, text = shown[path]
        assert same(line, one, text.partition("Unless stated: ")[2].partition(".\n")[0]), path
    page = (FOLDER / "hdf5.md").read_text(encoding="utf-8")
    assert all(remark in " ".join(page.split()) for one in declared.values() for remark in one.remarks)
    attributes = entries(told["Attributes of a result"])
    assert attributes.keys() == {one.name for one in (*OF_FILE, *OF_RUN)}
    assert all(attributes[one.name].startswith(f"`{one.name}`: {one.text}") for one in (*OF_FILE, *OF_RUN))
    for name, axis in AXES.items():
        counted = f"`{name}` ({axis.text.removesuffix(', counted from 1')})"
        assert f"- {head_of(name, axis.units, ())}{axis.text}\n" in page or counted in page
    assert set(entries(told["`/controller/BLOCK`"])) >= {*BLOCKS, *(one.name for one in OF_BLOCK)}


def test_a_model_holds_what_is_declared_and_the_page_tells_all_of_it(files: dict[str, Any]) -> None:
    assert model_faults(Path(files["model"].filename)) == []
    groups = {path.strip("/").rpartition("/")[0] for path in datasets(files["model"])}
    held = {model_dataset(group, name) for group in groups for name in files["model"][group]}
    held |= {model_dataset(group, name.removesuffix("_real")) for group in groups for name in files["model"][group]}
    left_out = {one.path for one in declared_model_datasets()} - {one.path for one in held if one}
    of_others = "calibration/", "pitch/", "nonlinear_specimen/", "actuator/"  # a table as declared has none of these
    left_out = {path for path in left_out if not path.startswith(of_others)}
    said = {f"verdict/{name}" for name in ("reasons", "warnings", "findings")}  # of a model that was accepted
    assert left_out <= {*said, "level_causes/table", "level_causes/storeys"}
    model, sweep = (sections(FOLDER / "hdf5.md")[head] for head in ("Model files", "Sweep files"))
    for declared, text in ((declared_model_datasets(), model), (SWEEP_DATASETS.values(), sweep)):
        told = entries(text)
        for one in declared:
            assert same(told[f"/{one.path}"], one, text.partition("\n\n- ")[0]), one.path
    of_a_result = sections(FOLDER / "hdf5.md")["Attributes of a result"]
    assert set(entries(model)) >= set(MODEL_ATTRIBUTES) and {*entries(sweep), *entries(of_a_result)} >= {
        *SWEEP_ATTRIBUTES
    }


def test_every_metric_of_a_result_is_told_with_its_unit(files: dict[str, Any]) -> None:
    told = entries((FOLDER / "metrics.md").read_text(encoding="utf-8"))
    paths = {path: line for path, line in told.items() if "." in path}
    names = {word: set(re.findall("`([a-z_0-9]+)` \\(", line)) for word, line in told.items() if word.isupper()}
    causes = [line for line in (FOLDER / "metrics.md").read_text().splitlines() if line.startswith("- `CAUSE`")]
    names["CAUSE"] = set(re.findall("`([a-z_0-9]+)`", " ".join(causes)))
    pattern = {path: re.sub("[A-Z]+", lambda word: f"({'|'.join(names[word[0]])})", path) for path in paths}
    for method in ("best", "paper"):
        figures = {path: node for path, node in datasets(files[method]).items() if path.startswith("/metrics/")}
        assert len(figures) > 150
        for path, node in figures.items():
            if not node.is_scale:
                metric = path.removeprefix("/metrics/").replace("/", ".")
                base = re.sub("_(true_full|true|full|model)$", "", metric)
                line = next(
                    line for told, line in paths.items()
                    if re.fullmatch(pattern[told], base) or f": `{base}`" in line
                )  # fmt: skip
                assert base == metric or f"`{metric.removeprefix(base)}`" in line, metric
                units = str(node.attrs["units"])
                marks = line.split(": ")[0].replace("*", "")
                assert (
                    units == "1"
                    or units in re.split("[ ,]+", marks)
                    or re.search("PEAK|GUARDED", marks)
                    or (units == "%" and re.search(f"in percent of [^;]*: `{base}`", line))
                ), metric


def test_every_column_of_a_raw_log_is_told_once() -> None:
    told = rows(sections(FOLDER / "raw_log.md")["Columns"])
    assert [cells[0].strip("`").removesuffix("_I") for cells in told] == list(RAW_LOG_COLUMNS)
    assert [cells[1:] for cells in told] == [[one.units, one.source, one.text] for one in RAW_LOG_COLUMNS.values()]
    written = {
        name if name in RAW_LOG_COLUMNS else name.rpartition("_")[0] for name in column_names(Sizes(3, 7, 1, further=2))
    }
    assert written == set(RAW_LOG_COLUMNS) and len(column_units(column_names(Sizes(3, 7, 1, further=2)))) == 28
