"""Write what the program prints into README, docs and tests/golden: `python tests/helpers/rewrite_docs.py [PAGE ...]`.

Without a page: the generated reference, the printed blocks of every page that is run as it is written, and the golden
files. A block keeps its choice of lines. Where only numbers differ, they are replaced; where a line has other words,
the whole paragraph is taken from what was printed, and its place is told, because its lines may have become others.
Sentences beside the blocks that quote a replaced number are listed, to be rewritten by hand. Read the difference before
it is committed.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import chdir
from difflib import SequenceMatcher
from pathlib import Path

from docs_running import NUMBER, Block, run_page, stories, worded

ROOT = Path(__file__).parents[2]
GOLDEN = (  # tests of all that is in tests/golden
    "cli/test_golden_pages.py",
    "cli/test_wrong_inputs.py",
    "cli/test_list.py",
    "experiment/test_structure_command.py",
)
ALIKE = 0.6  # ratio of difflib from which two lines are the same line in other words


def rewritten(text: str, printed: str) -> tuple[str, str]:
    """Return a shown text as it is printed now, and what a person has to look at ("": nothing)."""
    lines = [line for line in printed.splitlines() if line.strip()]
    made, told, at = [], "", 0
    for paragraph in _paragraphs(text):
        if paragraph[0].strip() in ("", "..."):
            made += paragraph
            continue
        new, at, found = _paragraph(paragraph, lines, at)
        made += new
        told = told or found
    return "".join(f"{line}\n" for line in made), told


def _paragraphs(text: str) -> Iterator[list[str]]:
    """Yield lines that were printed one after the other, and alone each line that is empty or stands for others."""
    lines: list[str] = []
    for line in text.splitlines():
        if line.strip() in ("", "..."):
            if lines:
                yield lines
            yield [line]
            lines = []
        else:
            lines.append(line)
    if lines:
        yield lines


def _paragraph(shown: Sequence[str], printed: Sequence[str], first: int) -> tuple[list[str], int, str]:
    """Return a paragraph by the lines printed from `first` on, the place behind them, and what to look at."""
    places = _same_words(shown, printed, first)
    if places is not None:
        return [_part(line, printed[at]) for line, at in zip(shown, places, strict=True)], places[-1] + 1, ""
    start = _most_alike(shown[0], printed, first)
    end = None if start is None else _most_alike(shown[-1], printed, start)
    if start is None or end is None:
        return list(shown), first, f"is not printed, rewrite it: {shown[0]!r}"
    column = max(printed[start].find(shown[0].split()[0]), 0) if shown[0][0] != " " else 0  # behind a label
    lines = printed[start : end + 1]
    taken = [line[column:] if line[:column].endswith("  ") else line for line in lines]
    return [line.rstrip() for line in taken], end + 1, f"other words, look at its lines: {shown[0]!r}"


def _same_words(shown: Sequence[str], printed: Sequence[str], first: int) -> list[int] | None:
    """Return the printed lines, in order, that have the words of those shown and the closest numbers; None without."""
    best: list[tuple[float, list[int]]] = [(0.0, [])] + [(float("inf"), [])] * len(shown)
    for at in range(first, len(printed)):
        for i in range(len(shown) - 1, -1, -1):
            cost = best[i][0] + _distance(shown[i], printed[at])
            if cost < best[i + 1][0]:
                best[i + 1] = (cost, [*best[i][1], at])
    return best[-1][1] if best[-1][0] < float("inf") else None


def _distance(shown: str, printed: str) -> float:
    """Return how far the numbers of two lines are apart, infinite where the words differ."""
    if worded(shown) not in worded(printed):
        return float("inf")
    pairs = zip(map(float, NUMBER.findall(shown)), map(float, NUMBER.findall(_part(shown, printed))), strict=True)
    apart = sum(min(abs(one - two) / max(abs(one), abs(two), 1e-300), 1.0) for one, two in pairs)
    return apart + (0.0 if worded(shown) == worded(printed) else 0.01)


def _part(shown: str, printed: str) -> str:
    """Return the part of a printed line that has the words of the one shown: the last of several."""
    words = worded(printed)
    if words == worded(shown) and shown[:1] == printed[:1]:
        return printed.rstrip()
    where = [place for found in re.finditer(rf"{NUMBER.pattern}|\S", printed) for place in [found.span()]]
    at = words.rindex(worded(shown))
    indent = shown[: len(shown) - len(shown.lstrip())]
    return indent + printed[where[at][0] : where[at + len(worded(shown)) - 1][1]]


def _most_alike(line: str, printed: Sequence[str], first: int) -> int | None:
    """Return the printed line from `first` on that resembles one most, None if none does."""
    ratios = [(SequenceMatcher(None, worded(line), worded(other)).ratio(), -i) for i, other in enumerate(printed)]
    ratio, place = max(ratios[first:], default=(0.0, 0))
    return -place if ratio >= ALIKE else None


def rewrite_page(page: Path) -> list[str]:
    """Run a page in an empty folder and write what it prints into it; return what a person has to look at."""
    text, name = page.read_text(encoding="utf-8"), page.relative_to(ROOT).as_posix()
    shown: list[tuple[Block, str]] = []
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        run_page(page, lambda block, printed, place: shown.append((block, printed)))
    told, changed, new = [], [], text
    for block, printed in reversed(shown):
        made, look = rewritten(block.text, printed)
        told += [f"{name}:{block.line}: {look}"] if look else []
        changed += _replaced(block.text, made)
        new = new[: block.start] + made + new[block.start + len(block.text) :]
    if new != text:
        page.write_text(new, encoding="utf-8")
        told.append(f"{name}: rewritten")
    return [*reversed(told), *(f"{name}:{line}" for line in quotes(new, changed))]


def _replaced(old: str, new: str) -> list[tuple[str, str]]:
    """Return the numbers that were replaced, in pairs, where no words were."""
    pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True) if worded(old) == worded(new) else ()
    return [(one, two) for one, two in pairs if one != two]


def quotes(page: str, changed: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield line and advice for each number between the blocks of a page that rounds a replaced one, and no more does.

    Numbers of one digit are left out.
    """
    prose = re.sub(r"^```.*?^```$", lambda found: "\n" * found[0].count("\n"), page, flags=re.DOTALL | re.MULTILINE)
    for i, line in enumerate(prose.splitlines(), 1):
        for number in NUMBER.findall(line):
            decimals = len(number.partition(".")[2]) if "e" not in number else -1
            if decimals < 0 or len(number.strip("+-").replace(".", "").lstrip("0")) < 2:
                continue
            for old, new in changed:
                if round(float(old), decimals) == float(number) != round(float(new), decimals):
                    yield f"{i}: quotes {number}? {old} is now {new}: {line.strip()[:80]}"


def main(pages: Sequence[Path]) -> int:
    """Rewrite the pages named, or all that is printed; return 0."""
    os.environ["COLUMNS"] = "100"  # as in a pipe, and as in the tests
    if not pages:
        subprocess.run([sys.executable, str(Path(__file__).with_name("docs_reference.py"))], check=True)
    for page in pages or [page for page in (ROOT / "README.md", *stories()) if "```text" in page.read_text("utf-8")]:
        for line in rewrite_page(page):
            print(line, flush=True)
    if not pages:
        words = [sys.executable, "-m", "pytest", "-q", *(str(ROOT / "tests" / name) for name in GOLDEN)]
        subprocess.run(words, env=os.environ | {"RTHS_GOLDEN": "write"}, check=True, cwd=ROOT)
    return 0


if __name__ == "__main__":
    sys.exit(main([Path(name).resolve() for name in sys.argv[1:]]))
