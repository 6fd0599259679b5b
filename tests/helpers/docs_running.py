"""Run what documentation shows: the blocks of a page, in order, in one folder."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from rths_cli.cli import cli
from rths_cli.cli.entry_point import BLAS_THREADS
from rths_cli.errors import RthsError

DOCS = Path(__file__).parents[2] / "docs"
RUN_ELSEWHERE = (  # tests/test_api.py, test_own_parts.py, benchmarks/gallery.py, loop/test_stepping_target.py
    "reference/python.md",
    "howto/export.md",
    "reference/parts.md",
    "gallery.md",
    "howto/own_computer.md",
    "reference/stepping_target.md",
)
BY_THE_HELP = ("reference/commands.md",)  # its examples are those of the help: test_every_example_of_the_help_runs
WITH_SNIPPETS = ("reference/figures.md", "howto/sweep.md")
MARK = "\0"  # of a number
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TOLERANCE = 0.02
"""Share by which a number may differ from the one shown: runs have their seeds, and processors only round differently
(benchmarks/processors.py). Numbers that depend on the machine or on the time that something takes are not shown in a
block that is run; a block of such numbers is marked as not run."""
os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))  # as the command does, before numpy is imported


def run_words(words: Sequence[str]) -> tuple[int, str]:
    """Run `rths WORDS` in this process; return exit code and what it printed, faults included."""
    done: Result = CliRunner().invoke(cli, list(words), standalone_mode=False)
    if isinstance(done.exception, RthsError):
        faults: Sequence[str] = getattr(done.exception, "faults", (str(done.exception),))
        return done.exception.exit_code, done.output + "\n".join(faults)
    if done.exception is not None:
        raise done.exception
    return int(done.return_value or 0), done.output


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: its language, text, line in the page and place of its text in it (characters), and why
    it is not run ("": it is)."""

    kind: str
    text: str
    line: int
    start: int
    not_run: str = ""


def blocks_of(page: str) -> Iterator[Block]:
    """Yield the fenced blocks of a page in order; `<!-- not run: REASON -->` stands on the line before one."""
    for found in re.finditer(r"^(?:<!-- not run: (.*?) -->\n)?```(\w*)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE):
        yield Block(found[2], found[3], page.count("\n", 0, found.start()) + 1, found.start(3), found[1] or "")


def at(page: Path) -> str:
    """Return the place of a page below docs/."""
    return page.relative_to(DOCS).as_posix()


def pages() -> list[Path]:
    """Return the pages below docs/."""
    return sorted(DOCS.rglob("*.md"))


def stories() -> list[Path]:
    """Return the pages whose blocks all have their language: they are run as they are written, from the beginning."""
    elsewhere = (*WITH_SNIPPETS, *RUN_ELSEWHERE, *BY_THE_HELP)
    blocks = {page: list(blocks_of(page.read_text(encoding="utf-8"))) for page in pages() if at(page) not in elsewhere}
    return [
        page
        for page, found in blocks.items()
        if found and all(block.kind in ("sh", "yaml", "python", "text") or block.not_run for block in found)
    ]


def check_shown(block: Block, printed: str, place: str) -> None:
    """Check that the lines shown were printed in their order, but for spaces, breaks of lines and the last digits."""
    wording, numbers, start = worded(printed), NUMBER.findall(printed), 0
    for line in block.text.splitlines():
        if line.strip() in ("", "..."):
            continue
        wanted, stated = worded(line), NUMBER.findall(line)
        places = (found.start() for found in re.finditer(f"(?={re.escape(wanted)})", wording[start:]))
        for at in (start + place for place in places):
            first = wording.count(MARK, 0, at)
            if all(map(_close, stated, numbers[first : first + len(stated)])):
                start = at + len(wanted)
                break
        else:
            raise AssertionError(f"{place}: not printed, or not in this order: {line!r}\n{printed}")


def run_page(page: Path, compare: Callable[[Block, str, str], None] = check_shown) -> list[str]:
    """Run the blocks of a page in the working directory; return why others were not run.

    `sh`: commands of rths, each with the exit code that its comment says (0). `yaml`: a file whose name is its first
    line, as a `python` block that begins with a name. `python`: executed, all of a page in one namespace. `text`: what
    the command or the python before it printed, shortened; the last digits may differ.
    """
    names: dict[str, Any] = {"__name__": "docs"}
    printed, left = "", []
    for block in blocks_of(page.read_text(encoding="utf-8")):
        place = f"{page.name}:{block.line}"
        if block.not_run:
            left.append(block.not_run)
        elif block.kind == "sh":
            printed = "".join(_run_line(line, place) for line in _lines(block.text))
        elif block.kind == "yaml" or re.match(r"# \w+\.py\n", block.text):
            write_file(block.text, place)
        elif block.kind == "python":
            with redirect_stdout(StringIO()) as told:
                exec(compile(block.text, place, "exec"), names)
            printed = told.getvalue() or printed
        elif block.kind == "text":
            compare(block, printed, place)
        else:
            raise AssertionError(f"{place}: a block is sh, yaml, python or text, or marked as not run")
    return left


def _lines(text: str) -> list[str]:
    """Return the commands of a block, continued lines joined, without lines of comment."""
    return [line for line in text.replace("\\\n", " ").splitlines() if line.strip() and not line.startswith("#")]


def _run_line(line: str, place: str) -> str:
    words = shlex.split(line, comments=True)
    assert words[0] == "rths", f"{place}: only commands of rths are run: {line}"
    wanted = re.search(r"# exit code (\d+)", line)
    code, printed = run_words(words[1:])
    assert code == (int(wanted[1]) if wanted else 0), f"{place}: {line}: exit code {code}\n{printed}"
    return printed


def write_file(text: str, place: str) -> None:
    """Write a block to the file that its first line names."""
    name = re.match(r"# ([\w./-]+\.(?:ya?ml|py))\b", text)
    assert name, f"{place}: the first line of a file is its name"
    Path(name[1]).parent.mkdir(parents=True, exist_ok=True)
    Path(name[1]).write_text(text, encoding="utf-8")


def worded(text: str) -> str:
    """Return a text with a mark for each number, without spaces and breaks of lines: terminals differ in width."""
    return re.sub(r"\s", "", NUMBER.sub(MARK, text))


def _close(shown: str, found: str) -> bool:
    """Tell whether a number is the one found, within TOLERANCE and one of the last digit shown."""
    return abs(float(shown) - float(found)) <= TOLERANCE * abs(float(found)) + 1.01 * _last_digit(shown)


def _last_digit(number: str) -> float:
    """Return the size of the last digit of a number as it is written."""
    mantissa, _, power = number.partition("e")
    return float(10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])))


def shortened(record: Path, target: Path, samples: int) -> None:
    """Write the first samples of a shipped record to a file."""
    lines = record.read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith(("# units", "# dt"))]
    values = [line for line in lines if not line.startswith("#")]
    target.write_text("\n".join([*head, *values[:samples]]) + "\n", encoding="utf-8")
