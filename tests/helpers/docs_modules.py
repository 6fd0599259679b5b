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
    "cli", "api", "report", "benchmark", "studies", "laboratory", "experiment", "loop", "analysis", "identification",
    "control", "rigs", "structure", "files", "case", "programs", "numerics", "quantities", "findings",
)  # fmt: skip
LONGEST = 110  # characters of what is said of a module; a longer sentence ends at its last mark before that


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
            yield f"- `{path.stem}`: {_shortened(_first_sentence(path))}"


def _shortened(sentence: str) -> str:
    """Return a sentence, or what of it comes before its last mark within LONGEST characters."""
    if len(sentence) <= LONGEST:
        return sentence
    marks = [found.start() for found in re.finditer(r"[,;:] ", sentence[:LONGEST])]
    ends = [
        end
        for end in marks
        if sentence.count("`", 0, end) % 2 == 0 and sentence.count("(", 0, end) == sentence.count(")", 0, end)
    ]
    return sentence[: ends[-1]] if ends else sentence


def _first_sentence(path: Path) -> str:
    doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = " ".join(doc.split("\n\n")[0].split())
    return re.split(r"(?<=\w)\. (?=[A-Z])|\.$", first)[0]
