"""Install rths into fresh environments, with the oldest and the newest libraries that pyproject.toml permits; run the
paper's cases there, compare their tables with those of docs/reference/paper_tables.md, and run the tests.

python benchmarks/versions.py [--only NAME] [--folder DIR] [--no-tests] [PYTEST ARGUMENT...]

`oldest` and `newest` install the checkout editable, with the test tools; `wheel` and `sdist` install what `python -m
build` makes of it, without them. python3.11, python3.12 and python3.13 must be on the PATH, or pyenv's.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from options import arguments, words

ROOT = Path(__file__).parents[1]
CASES = [
    f"{record}_{damping}_{control}"
    for record in ("el_centro", "hachinohe")
    for damping in ("low", "high")
    for control in ("ff", "ff_fb")
]
SHOWN = ("numba", "numpy", "scipy", "h5py", "pydantic", "matplotlib")
FIGURE = re.compile(r"\d\.\d{4}")
LAST_PLACE, RELATIVE = 1e-4, 0.2  # the last bits differ between libraries: another noise of rounding, as by a seed
READ_THE_CODE = ("ruff", "types-", "import-linter")
WORKERS = (os.cpu_count() or 1) + 1


@dataclass(frozen=True)
class Environment:
    """What is installed into a fresh environment: a wheel, an sdist or the checkout, with floors or without."""

    python: str
    source: str
    floors: bool = False
    tested: bool = False


ENVIRONMENTS = {
    "oldest": Environment("3.11", "editable", floors=True, tested=True),
    "newest": Environment("3.13", "editable", tested=True),
    "wheel": Environment("3.12", "wheel"),
    "sdist": Environment("3.12", "sdist"),
}


@dataclass(frozen=True)
class Outcome:
    """What an environment held and did."""

    versions: dict[str, str]
    cases_s: float
    differing: list[
        tuple[float, str]
    ]  # lines of the stated tables that the command did not print; difference over permitted
    tests: str  # pytest's last line


def interpreter(version: str) -> str:
    """Return the path of a Python; raises SystemExit if there is none."""
    kept = Path.home() / ".pyenv" / "versions"
    found = shutil.which(f"python{version}") or next(map(str, sorted(kept.glob(f"{version}.*/bin/python"))), None)
    if found is None:
        raise SystemExit(f"python{version} is neither on the PATH nor among pyenv's versions")
    return found


def floors() -> list[str]:
    """Return the oldest versions that pyproject.toml permits, as pip's constraints."""
    return [re.sub(r">=([^,]+).*", r"==\1", one) for one in project()["dependencies"]]


def test_tools() -> list[str]:
    """Return what the tests need beside the libraries: pyproject.toml's `dev` without what reads the code only."""
    return [one for one in project()["optional-dependencies"]["dev"] if not one.startswith(READ_THE_CODE)]


def project() -> dict[str, Any]:
    """Return the table `project` of pyproject.toml."""
    stated: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return stated


def built(folder: Path, source: str) -> Path:
    """Return a wheel or source distribution of the checkout."""
    out = folder / "dist"
    subprocess.run(
        [sys.executable, "-m", "build", f"--{source}", "--outdir", out, ROOT], check=True, capture_output=True
    )
    return next(iter(sorted(out.glob("*.whl" if source == "wheel" else "*.tar.gz"))))


def installed(name: str, folder: Path) -> Path:
    """Return the folder of programs of a fresh environment with rths in it."""
    wanted, home = ENVIRONMENTS[name], folder / name
    subprocess.run([interpreter(wanted.python), "-m", "venv", "--clear", home], check=True)
    constraints = folder / f"{name}.txt"
    constraints.write_text("\n".join(floors() if wanted.floors else []))
    what = ["-e", str(ROOT), *test_tools()] if wanted.source == "editable" else [str(built(folder, wanted.source))]
    pip = [home / "bin" / "python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "-c", constraints]
    subprocess.run([*pip, *what], check=True)
    return home / "bin"


def versions_in(programs: Path) -> dict[str, str]:
    """Return the versions of Python and of the libraries of an environment."""
    code = "import platform as p, sys; from importlib.metadata import version as v\n"
    code += "print(p.python_version(), *(v(name) for name in sys.argv[1:]))"
    done = subprocess.run([programs / "python", "-c", code, *SHOWN], capture_output=True, text=True, check=True)
    return dict(zip(("Python", *SHOWN), done.stdout.split(), strict=True))


def differences(printed: str) -> list[tuple[float, str]]:
    """Return each line of the stated tables that is not printed, with its largest difference over the permitted."""
    page = (ROOT / "docs" / "reference" / "paper_tables.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\w*\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (block,) = (block for block in blocks if "Table 5.2" in block)
    stated, found = ([line.rstrip() for line in text.splitlines() if FIGURE.search(line)] for text in (block, printed))
    differing = []
    for line in stated:
        if line not in found:
            rows = [row for row in found if FIGURE.sub("0", row).split() == FIGURE.sub("0", line).split()]
            nearest = min((_difference(line, row) for row in rows), default=math.inf)
            differing.append((nearest, line))
    return differing


def _difference(line: str, row: str) -> float:
    pairs = [(float(a), float(b)) for a, b in zip(FIGURE.findall(line), FIGURE.findall(row), strict=True)]
    return max(abs(a - b) / (LAST_PLACE + RELATIVE * a) for a, b in pairs)


def examined(name: str, folder: Path, arguments: list[str], tested: bool) -> Outcome:
    """Install, run the cases and the tests."""
    programs, work = installed(name, folder), folder / f"{name}-work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= {"XDG_CACHE_HOME": str(work / "cache"), "PATH": f"{programs}:{environment['PATH']}"}
    words = ["run", "--paper", "--method", "paper", "--method", "best", *CASES]
    start = time.perf_counter()
    done = subprocess.run(
        [programs / "rths", *words], cwd=work, env=environment, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - start
    (work / "cases.txt").write_text(done.stdout + done.stderr)
    shutil.rmtree(work / "results", ignore_errors=True)  # 700 MB
    last = "not run"
    if tested:
        words = ["-q", "-n", str(WORKERS), "--dist", "worksteal", *(arguments or ["tests"])]
        with open(work / "tests.txt", "w", encoding="utf-8") as log:
            subprocess.run(
                [programs / "python", "-m", "pytest", *words], cwd=ROOT, env=environment, stdout=log, check=False
            )
        last = ((work / "tests.txt").read_text().splitlines() or ["no output"])[-1].strip("= ")
    return Outcome(versions_in(programs), seconds, differences(done.stdout), last)


def shown(name: str, outcome: Outcome) -> str:
    """Return what was found in one environment."""
    held = ", ".join(f"{library} {version}" for library, version in outcome.versions.items())
    far = max((difference for difference, _ in outcome.differing), default=0.0)
    lines = [
        f"{name} ({ENVIRONMENTS[name].source}): {held}",
        f"  eight cases, compiled first: {outcome.cases_s:.0f} s",
        f"  {len(outcome.differing)} lines of the stated tables differ, by {far:.0%} of what is permitted at most",
        *(f"    {line}" for difference, line in outcome.differing if difference > 1.0),
        f"  tests: {outcome.tests}",
    ]
    return "\n".join(lines)


def main() -> int:
    """Examine each environment; return whether one differs."""
    parser = arguments(__doc__)
    parser.add_argument("--only", choices=ENVIRONMENTS, action="append", help="one environment; repeatable")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "versions", help="where they are made")
    parser.add_argument("--no-tests", action="store_true", help="run the cases only")
    asked, of_pytest = parser.parse_known_args(words(parser))
    folder = asked.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    wrong = False
    for name in asked.only or ENVIRONMENTS:
        tested = ENVIRONMENTS[name].tested and not asked.no_tests
        outcome = examined(name, folder, of_pytest, tested)
        print(shown(name, outcome), flush=True)
        wrong |= any(difference > 1.0 for difference, _ in outcome.differing)
        wrong |= tested and bool(re.search("failed|error|no output", outcome.tests))
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
