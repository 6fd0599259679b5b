"""What a result, model or sweep file holds against what is declared of it: every difference as a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py

from rths_cli.quantities import ATTRIBUTES, AXES, BLOCKS, DATASETS, DatasetDeclaration, metric, stored_dataset
from rths_cli.quantities.attributes import OF_BLOCK
from rths_cli.quantities.declaration import unit_of_name
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, model_dataset
from rths_cli.quantities.sweep_datasets import OF_SWEEP, SWEEP_ATTRIBUTES, SWEEP_DATASETS


def declaration_faults(path: Path, texts: bool = True) -> list[str]:
    """Return what a result holds and is declared otherwise or nowhere, and what is declared and not there.

    Without `texts`, meanings are not compared: those of an earlier version may be worded otherwise.
    """
    with h5py.File(path) as file:
        return [*_attributes(file), *_datasets(file, texts), *_missing(file)]


def _attributes(file: Any) -> Iterator[str]:
    for name, value in file.attrs.items():
        declared = ATTRIBUTES.get(name)
        if declared is None or (declared.kind == "text") != isinstance(value, str):
            yield f"attribute {name} = {value!r}: {declared}"
    for name in sorted({one.name for one in ATTRIBUTES.values() if not one.present and "_status" not in one.name}):
        if name not in file.attrs:
            yield f"attribute {name} is missing"


def _datasets(file: Any, texts: bool) -> Iterator[str]:
    for node in _nodes(file):
        path = node.name.strip("/")
        held = tuple(str(node.attrs[key]) for key in ("units", "source", "long_name"))
        wanted = _declared(path, node)
        if wanted is None:
            yield f"{path} is declared nowhere"
        elif held[:2] != wanted[:2] or (texts and not held[2].startswith(wanted[2])):
            yield f"{path} states {held}, declared is {wanted}"
        axes = tuple(axis[0].name.rpartition("/")[2] for axis in node.dims if len(axis))
        declared = stored_dataset(path)
        if declared is not None and axes != declared.axes:
            yield f"{path} has the axes {axes}, declared are {declared.axes}"


def _declared(path: str, node: Any) -> tuple[str, str, str] | None:
    """Return unit, source and meaning that are declared of a dataset, None where none are."""
    group, _, name = path.rpartition("/")
    if (one := stored_dataset(path)) is not None:
        return one.units, one.source, one.text
    if node.is_scale:
        return (AXES[name].units, "computed", AXES[name].text) if name in AXES else None
    found = metric(path.removeprefix("metrics/").replace("/", ".")) if group.startswith("metrics") else None
    return None if found is None else (found.units, "computed", found.definition)


def _missing(file: Any) -> Iterator[str]:
    """Yield what every file with a group has in it and this one has not."""
    for one in DATASETS.values():
        if one.group in file and not one.present:
            yield from (f"{path} is missing" for path in one.stored_paths if path not in file)
    for name in file.get("controller", ()):
        about = file[f"controller/{name}"].attrs
        if name not in BLOCKS or set(about) != {one.name for one in OF_BLOCK}:
            yield f"controller/{name} is no declared block with {sorted(about)}"


def model_faults(path: Path) -> list[str]:
    """Return what a model file holds and is declared otherwise or nowhere."""
    with h5py.File(path) as file:
        faults = [f"attribute {name}" for name in file.attrs if name not in MODEL_ATTRIBUTES]
        faults += [
            f"attribute {name} is missing"
            for name, one in MODEL_ATTRIBUTES.items()
            if name not in file.attrs and not one.present
        ]
        for node in _nodes(file):
            group, _, name = node.name.strip("/").rpartition("/")
            if node.is_scale and name in AXES:
                continue
            plain = name.removesuffix("_real").removesuffix("_imag")
            declared = model_dataset(group, name) or model_dataset(group, plain)
            faults += _unlike(node, declared)
        return faults


def sweep_faults(path: Path, varied: tuple[str, ...]) -> list[str]:
    """Return what a sweep's file holds and is declared otherwise or nowhere, and what is declared and not there."""
    with h5py.File(path) as file:
        faults = [f"attribute {name}" for name in file.attrs if name not in SWEEP_ATTRIBUTES]
        faults += [
            f"attribute {one.name} is missing" for one in OF_SWEEP if one.name not in file.attrs and not one.present
        ]
        faults += [f"{name} is missing" for name, one in SWEEP_DATASETS.items() if name not in file and not one.present]
        for node in _nodes(file):
            name = node.name.strip("/")
            if node.is_scale:
                wanted: tuple[str, str] | None = (AXES[name].units, AXES[name].text) if name in AXES else None
            elif (found := metric(name)) is not None:
                wanted = found.units, found.definition
            elif name in varied:
                wanted = unit_of_name(name), f"varied key {name}"
            else:
                faults += _unlike(node, SWEEP_DATASETS.get(name))
                continue
            held = str(node.attrs["units"]), str(node.attrs["long_name"])
            faults += [] if held == wanted else [f"{name} states {held}, declared is {wanted}"]
        return faults


def _nodes(file: Any) -> list[Any]:
    found: list[Any] = []
    file.visititems(lambda _, node: found.append(node) if isinstance(node, h5py.Dataset) else None)
    return found


def _unlike(node: Any, declared: DatasetDeclaration | None) -> list[str]:
    """Return how a dataset differs from its declaration."""
    if declared is None:
        return [f"{node.name} is declared nowhere"]
    axes = tuple(axis[0].name.rpartition("/")[2] for axis in node.dims if len(axis))
    held = (*(str(node.attrs[key]) for key in ("units", "source")), axes)
    same = held == (declared.units, declared.source, declared.axes)
    same = same and str(node.attrs["long_name"]).startswith(declared.text)
    return [] if same else [f"{node.name} states {held}, declared is {declared}"]
