"""What do the tests miss? Edit one expression of the package at a time, in a copy of the tree, and run the tests there.

    python benchmarks/mutants.py FILE [--seed 1] [--count 20] [--package NAME ...] [--workers 2] [--campaign FOLDER ...]
    python benchmarks/mutants.py FILE --summary

In each package COUNT expressions are drawn by the seed: a comparison, a sign, an operator, a constant, a term that is
dropped, two arguments that change places; never a docstring, an annotation, a default of a class or the text of an
error. The tests of `make test` in the package's own folder run first, then all others, until one fails; then, for
what no test noticed, those that are marked `campaign` in the folders of --campaign. FILE gets a line of JSON for each
mutant and is gone on with. What ends no test in LONGEST_S is noticed, too.
"""

from __future__ import annotations

import ast
import copy
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from options import arguments, parsed

TREE = Path(__file__).parents[1]
PACKAGES = ("loop", "control", "identification", "analysis", "structure", "numerics", "rigs", "experiment")
LEFT_OUT = (".git", ".venv", "build", "dist", "results", "sweeps", ".*_cache", "__pycache__")
LONGEST_S = 1800.0
OTHER: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
SHORT = ("mutants.jsonl", "--package", "structure", "--count", "1", "--only-own")
PRINTS = "^structure +1 mutants"


@dataclass(frozen=True)
class Mutant:
    """One expression, and what stands there instead: `start` and `end` are characters of the file."""

    file: str
    line: int
    kind: str
    before: str
    after: str
    start: int
    end: int


def edits(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield what may stand instead of an expression, by the kind of the change."""
    other: ast.expr
    if isinstance(node, ast.Compare) and type(node.ops[0]) in OTHER:
        other = copy.deepcopy(node)
        other.ops[0] = OTHER[type(node.ops[0])]()
        yield "comparison", other
    elif isinstance(node, ast.BoolOp):
        yield "condition", ast.BoolOp(OTHER[type(node.op)](), node.values)
    elif isinstance(node, ast.BinOp):
        if type(node.op) in OTHER:
            yield "operator", ast.BinOp(node.left, OTHER[type(node.op)](), node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            yield "dropped term", node.left
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield "sign", node.operand
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "constant", ast.Constant(node.value + 1 if isinstance(node.value, int) else 1.5 * node.value + 0.1)
    elif isinstance(node, ast.Call) and len(node.args) > 1 and not isinstance(node.args[0], ast.Starred):
        one, two, *rest = node.args
        if not isinstance(two, ast.Starred) and ast.dump(one) != ast.dump(two):
            yield "swapped argument", ast.Call(node.func, [two, one, *rest], node.keywords)


def expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield every node of the code of functions and of constants of a module: no text, type, decorator or error."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "msg"):
            continue
        for child in value if isinstance(value, list) else [value]:
            inner = isinstance(child, ast.AnnAssign) and isinstance(node, ast.ClassDef)
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr | ast.Raise) and not inner:
                yield child
                yield from expressions(child)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file."""
    text = path.read_text(encoding="utf-8")
    rows = text.encode().splitlines(keepends=True)
    begins = [sum(map(len, rows[:number])) for number in range(len(rows))]  # bytes, as positions of ast are
    for node in expressions(ast.parse(text)):
        for kind, other in edits(node):
            start, end = begins[node.lineno - 1] + node.col_offset, begins[node.end_lineno - 1] + node.end_col_offset
            before, after = text.encode()[start:end].decode(), ast.unparse(ast.fix_missing_locations(other))
            if not isinstance(node, ast.Constant):
                after = f"({after})"
            yield Mutant(str(path.relative_to(TREE)), node.lineno, kind, before, after, start, end)


def drawn(package: str, seed: int, count: int) -> list[Mutant]:
    """Return mutants of a package: each kind as often as the others, each line once."""
    by_kind: dict[str, list[Mutant]] = {}
    for path in sorted((TREE / "rths_cli" / package).rglob("*.py")):
        for one in mutants_of(path):
            by_kind.setdefault(one.kind, []).append(one)
    rng, chosen = random.Random(f"{seed} {package}"), dict[tuple[str, int], Mutant]()
    while len(chosen) < count:
        one = rng.choice(by_kind[rng.choice(sorted(by_kind))])
        chosen.setdefault((one.file, one.line), one)
    return list(chosen.values())


def ended(copied: Path, words: Sequence[str]) -> tuple[int | None, str]:
    """Run tests in the copy until one fails; return the exit code, None where they do not end, and the test."""
    environment = os.environ | {"PYTHONPATH": str(copied), "XDG_CACHE_HOME": str(copied.parent / "cache")}
    line = [sys.executable, "-m", "pytest", "-x", "-rfE", "-p", "no:cacheprovider", *words]
    process = subprocess.Popen(
        line, cwd=copied, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        told, _ = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None, "does not end"
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", told, re.MULTILINE)
    return process.returncode, failed[1] if failed else told.strip().rpartition("\n")[2]


def judged(copied: Path, package: str, one: Mutant | None, workers: int, campaign: Sequence[str], own: bool) -> str:
    """Run the tests on a mutant, and put the file back; return which test noticed it, or ""."""
    parallel = ["-n", str(workers), "--dist", "worksteal"] if workers > 1 else []
    usual = [*parallel, "-m", "not campaign"]
    parts = [[*usual, f"tests/{package}"]]
    if not own:
        parts.append([*usual, "tests", f"--ignore=tests/{package}"])
    parts += [[*parallel, "-m", "campaign", f"tests/{folder}"] for folder in campaign]
    path = copied / (one.file if one else "pyproject.toml")
    right = path.read_bytes()
    try:
        if one:
            path.write_bytes(right[: one.start] + one.after.encode() + right[one.end :])
        for words in parts:
            code, test = ended(copied, words)
            if code not in (0, 5):  # 5: no test there
                return test
    finally:
        path.write_bytes(right)
        for folder in (copied.parent / "cache").glob("rths/compiled-*"):
            if one and folder.name not in kept(copied):
                shutil.rmtree(folder, ignore_errors=True)
    return ""


def kept(copied: Path) -> set[str]:
    """Return the folders of compiled code of the tree as it is."""
    path = copied.parent / "compiled"
    return set(path.read_text().split()) if path.exists() else set()


def main() -> int:
    """Judge the mutants that FILE lacks; print what it holds."""
    parser = arguments(__doc__, seed=1, count=20)
    parser.add_argument("file", type=Path)
    parser.add_argument("--package", nargs="+", choices=PACKAGES, default=PACKAGES, metavar="NAME")
    parser.add_argument("--workers", type=int, default=1, help="processes of pytest")
    parser.add_argument("--campaign", nargs="+", default=[], metavar="FOLDER")
    parser.add_argument("--only-own", action="store_true", help="tests in the package's own folder alone")
    parser.add_argument("--summary", action="store_true", help="print what FILE holds, and judge none")
    asked = parsed(parser, SHORT)
    known = [json.loads(text) for text in asked.file.read_text().splitlines()] if asked.file.exists() else []
    if not asked.summary:
        done = {(row["file"], row["start"], row["after"]) for row in known}
        with tempfile.TemporaryDirectory(prefix="rths-mutants-") as name:
            copied = Path(name) / "tree"
            shutil.copytree(TREE, copied, ignore=shutil.ignore_patterns(*LEFT_OUT))
            for package in asked.package:
                chosen = drawn(package, asked.seed, asked.count)
                if all((one.file, one.start, one.after) in done for one in chosen):
                    continue
                if test := judged(copied, package, None, asked.workers, [], asked.only_own):
                    print(f"{package}: the tests fail on the tree as it is: {test}", file=sys.stderr)
                    return 2
                compiled = (copied.parent / "cache").glob("rths/compiled-*")
                (copied.parent / "compiled").write_text("\n".join(one.name for one in compiled))
                for one in chosen:
                    if (one.file, one.start, one.after) in done:
                        continue
                    begun = time.monotonic()
                    test = judged(copied, package, one, asked.workers, asked.campaign, asked.only_own)
                    row = {"package": package, **asdict(one), "test": test, "s": round(time.monotonic() - begun)}
                    known.append(row)
                    with asked.file.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                    print(shown(row), flush=True)
    print("\n".join(summary(known)))
    return 0


def shown(row: dict[str, object]) -> str:
    """Return a mutant in a line."""
    return f"{row['file']}:{row['line']} {row['before']} -> {row['after']}: {row['test'] or 'NOT NOTICED'}"


def summary(rows: Sequence[dict[str, object]]) -> Iterator[str]:
    """Yield what became of the mutants of each package, and those that no test noticed."""
    noticed = Counter(row["package"] for row in rows if row["test"])
    for package, count in Counter(row["package"] for row in rows).items():
        yield f"{package:<16}{count:>4} mutants, {noticed[package]} noticed"
    for row in rows:
        if not row["test"]:
            yield shown(row)


if __name__ == "__main__":
    sys.exit(main())
