"""The map of the package in docs/reference/source_map.md, from the docstrings of its packages and modules."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "rths_cli"
BEGIN, END = "<!-- modules: made by python tests/helpers/docs_reference.py -->\n", "<!-- end of modules -->\n"
ORDER = (
    "cli", "api", "report", "studies", "experiment", "loop", "analysis", "identification", "control", "rigs",
    "structure", "files", "case", "numerics", "quantities",
)  # fmt: skip
SUBORDINATE = ("After", "From", "If", "When", "Where")  # a comma in such a sentence is no end of a clause
LEAST = 12  # characters that say what a module is for
LONG = 4  # characters of a word that says something
WHOLE = 40  # characters of a sentence that is not cut


def module_map() -> str:
    """Return the packages from the highest layer to the lowest, each with its modules and what they hold."""
    folders = [PACKAGE / name for name in ORDER if (PACKAGE / name).is_dir()]
    parts = [part for folder in folders for part in _package(folder)]
    parts += ["**rths_cli/**: what every layer may use", "\n".join(_modules(PACKAGE))]
    return "\n\n".join(parts) + "\n"


def with_map(page: str) -> str:
    """Return a page with its map made anew between the two marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{module_map()}\n{END}{after}"


def _package(folder: Path) -> Iterator[str]:
    yield f"**{folder.relative_to(ROOT).as_posix()}/**: {_first_sentence(folder / '__init__.py')}"
    if lines := list(_modules(folder)):
        yield "\n".join(lines)
    for child in sorted(path for path in folder.iterdir() if (path / "__init__.py").exists()):
        yield from _package(child)


def _modules(folder: Path) -> Iterator[str]:
    for path in sorted(folder.glob("*.py")):
        if path.name != "__init__.py":
            clause = _clause(_first_sentence(path))
            yield f"- `{path.stem}`" if _says_no_more(path.stem, clause) else f"- `{path.stem}`: {clause}"


def _says_no_more(name: str, clause: str) -> bool:
    """Tell whether a clause has hardly a word that its module's name does not have."""
    words = [word for word in re.findall(r"[a-z0-9]+", clause.lower()) if len(word) >= LONG]
    stems = [part[:LONG] for part in name.split("_")]
    return sum(not word.startswith(tuple(stems)) for word in words) <= 2


def _clause(sentence: str) -> str:
    """Return the beginning of a sentence, up to the first mark that ends a clause."""
    if len(sentence) <= WHOLE:
        return sentence
    marks = r"[;:] | \(" if sentence.startswith(SUBORDINATE) else r"[,;:] | \("
    ends = (found.start() for found in re.finditer(marks, sentence) if found.start() >= LEAST)
    return sentence[: next((end for end in ends if sentence.count("`", 0, end) % 2 == 0), len(sentence))]


def _first_sentence(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = " ".join(doc.split("\n\n")[0].split())
    return re.split(r"(?<=\w)\. (?=[A-Z])|\.$", first)[0]
