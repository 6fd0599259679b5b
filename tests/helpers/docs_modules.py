"""The map of the package in docs/reference/source_map.md, from the docstrings of its packages.

`python tests/helpers/docs_modules.py [PACKAGE ...]` prints it with what every module holds.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "rths_cli"
BEGIN, END = "<!-- modules: made by python tests/helpers/docs_reference.py -->\n", "<!-- end of modules -->\n"
ORDER = (
    "cli", "api", "report", "benchmark", "studies", "laboratory", "experiment", "loop", "analysis", "identification",
    "control", "rigs", "structure", "files", "case", "programs", "numerics", "quantities", "findings",
)  # fmt: skip


def module_map(told: bool = False, among: Sequence[str] = ORDER) -> str:
    """Return the packages from the highest layer to the lowest, `told` with what each of their modules holds."""
    folders = [PACKAGE / name for name in among if (PACKAGE / name).is_dir()]
    parts = [part for folder in folders for part in _package(folder, told)]
    if among == ORDER:
        parts += [f"**rths_cli/**: what every layer may use{_modules(PACKAGE, told)}"]
    return "\n\n".join(parts) + "\n"


def with_map(page: str) -> str:
    """Return a page with its map made anew between the two marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{module_map()}\n{END}{after}"


def _package(folder: Path, told: bool) -> Iterator[str]:
    about = _first_sentence(folder / "__init__.py")
    yield f"**{folder.relative_to(ROOT).as_posix()}/**: {about}{_modules(folder, told)}"
    for child in sorted(path for path in folder.iterdir() if (path / "__init__.py").exists()):
        yield from _package(child, told)


def _modules(folder: Path, told: bool) -> str:
    """Return what follows a package: nothing, or a line for each of its modules with its first sentence."""
    paths = [path for path in sorted(folder.glob("*.py")) if path.name != "__init__.py"]
    return "".join(f"\n- `{path.stem}`: {_first_sentence(path)}" for path in paths if told)


def _first_sentence(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = " ".join(doc.split("\n\n")[0].split())
    return re.split(r"(?<=\w)\. (?=[A-Z])|\.$", first)[0]


if __name__ == "__main__":
    print(module_map(told=True, among=sys.argv[1:] or ORDER), end="")
