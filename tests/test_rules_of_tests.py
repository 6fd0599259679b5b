"""Tests take the package by its public names, and share code with the campaigns in tests/helpers/campaigns alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SCRIPTS = TESTS.parent / "benchmarks"
NAMEDTUPLE = ("_replace", "_fields", "_asdict", "_make")  # public, in spite of their names
OTHERS = ("_exit", "_fields_", "_lib")  # of os, ctypes and nidaqmx
OWN = ("self", "cls")


def private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in (*NAMEDTUPLE, *OTHERS)


def private_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of what a module imports, reads of another object, or replaces, by a private name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names = [*(node.module or "").split("."), *(one.name for one in node.names)]
        elif isinstance(node, ast.Import):
            names = [part for one in node.names for part in one.name.split(".")]
        elif isinstance(node, ast.Attribute):
            names = [] if isinstance(node.value, ast.Name) and node.value.id in OWN else [node.attr]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "setattr":
            texts = [one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
            names = [part for text in texts for part in text.split(".")]
        else:
            continue
        yield from ((node.lineno, name) for name in names if private(name))


def modules(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of every module that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, one.name) for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.AST]:
    """Return the module of every test, by its path below tests."""
    paths = sorted(TESTS.rglob("*.py"))
    return {path.relative_to(TESTS): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def test_no_test_takes_a_private_name(trees: dict[Path, ast.AST]) -> None:
    """Test the public function that uses it, or make it public in its module, with a docstring."""
    found = [f"{path}:{line}: {name}" for path, tree in trees.items() for line, name in private_names(tree)]
    assert found == []


@pytest.mark.campaign
def test_no_test_imports_a_script_of_the_campaigns(trees: dict[Path, ast.AST]) -> None:
    """What both need stands in tests/helpers/campaigns."""
    scripts = {path.stem for path in SCRIPTS.glob("*.py")} | {path.name for path in SCRIPTS.iterdir() if path.is_dir()}
    helpers = {path.stem for path in (TESTS / "helpers").glob("*.py")}
    found = [
        f"{path}:{line}: {name}"
        for path, tree in trees.items()
        for line, name in modules(tree)
        if name.split(".")[0] in scripts - helpers | {SCRIPTS.name}
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("from rths_cli.a import b, _c", ["_c"]), ("import rths_cli._a.b", ["_a"]), ("x.y._z()", ["_z"]),
        ("self._mine = self.server._theirs", ["_theirs"]), ("patch.setattr(module, '_name', 1)", ["_name"]),
        ("patch.setattr('rths_cli.a._b', 1)", ["_b"]), ("self._mine; a._replace(b=1); c.__file__", []),
        ("of['x_true'] + f'{a}_m_s2'", []),
    ],
)  # fmt: skip
def test_what_counts_as_private(text: str, names: list[str]) -> None:
    assert [name for _, name in private_names(ast.parse(text))] == names
