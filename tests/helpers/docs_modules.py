"""The map of the package in docs/reference/source_map.md, down to the file, from the modules' own first sentences."""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "rths_cli"
BEGIN, END = "<!-- modules: made by python tests/helpers/docs_reference.py -->\n", "<!-- end of modules -->\n"
ORDER = (
    "cli", "api", "report", "studies", "experiment", "loop", "analysis", "identification", "control", "rigs",
    "structure", "files", "case", "numerics", "quantities",
)  # fmt: skip
WIDTH = 120


def module_map() -> str:
    """Return the packages from the highest layer to the lowest, each with its files and what they hold."""
    parts: list[str] = []
    for name in ORDER:
        parts += [f"**rths_cli/{name}/** {_first_sentence(PACKAGE / name / '__init__.py')}", "", "```"]
        parts += [*_tree(PACKAGE / name, ""), "```", ""]
    parts += ["**rths_cli/** itself holds what every layer may use", "", "```", *_folder(PACKAGE, ""), "```"]
    return "\n".join(parts) + "\n"


def with_map(page: str) -> str:
    """Return a page with its map made anew between the two marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{module_map()}\n{END}{after}"


def _tree(folder: Path, indent: str) -> list[str]:
    lines = _folder(folder, indent)
    for child in sorted(path for path in folder.iterdir() if (path / "__init__.py").exists()):
        about = _first_sentence(child / "__init__.py")
        lines += _entry(f"{indent}{child.name}/", about)
        lines += _tree(child, indent + "  ")
    return lines


def _folder(folder: Path, indent: str) -> list[str]:
    lines = _entry(f"{indent}__init__.py", about) if (about := _about_init(folder / "__init__.py")) else []
    files = sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")
    return lines + [line for path in files for line in _entry(f"{indent}{path.name}", _first_sentence(path))]


def _about_init(path: Path) -> str:
    """Return what a package's `__init__.py` holds, "" where it is a docstring."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    written = [
        f"`{node.name}`"
        for node in body
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
    ]
    if written:
        return f"{', '.join(written)}: the package's own functions, written here"
    return "The package's public names, imported from the modules that define them" if len(body) > 1 else ""


def _entry(name: str, about: str) -> list[str]:
    head = f"{name:<30} "
    return textwrap.wrap(about, WIDTH, initial_indent=head, subsequent_indent=" " * 32) or [head.rstrip()]


def _first_sentence(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = " ".join(doc.split("\n\n")[0].split())
    return re.split(r"(?<=\w)\. (?=[A-Z])|\.$", first)[0]
