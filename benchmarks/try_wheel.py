"""Install a wheel into an empty environment and run a shipped case there: no compiler, no source tree, no settings.

python benchmarks/try_wheel.py WHEEL [PYTHON]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from options import arguments, parsed

CASE = "el_centro_low_ff_fb"
COMMANDS = (["list", "cases"], ["structure", "three_storey"], ["run", CASE], ["report", "results", "--format", "json"])


def main() -> int:
    """Install and run; return 0, or the exit code of the first command that failed."""
    parser = arguments(__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("python", nargs="?", default=sys.executable)
    asked = parsed(parser)
    wheel, python = asked.wheel.resolve(), asked.python
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
        programs, work = folder / "venv" / "bin", folder / "work"
        pip = [programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "--only-binary", ":all:", wheel], check=True)
        work.mkdir()
        empty = {"PATH": str(programs), "HOME": name, "CC": "/bin/false", "CXX": "/bin/false", "LANG": "C.UTF-8"}
        where = subprocess.run(
            [programs / "python", "-c", "import rths_cli; print(rths_cli.__file__)"],
            cwd=work, env=empty, capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip
        if not where.startswith(name):
            raise SystemExit(f"the package of {where} was imported, not that of the wheel")
        for words in COMMANDS:
            done = subprocess.run(
                [programs / "rths", *words], cwd=work, env=empty, capture_output=True, text=True, check=False
            )
            print(f"rths {' '.join(words)}: exit code {done.returncode}, {len(done.stdout.splitlines())} lines")
            if done.returncode != 0:
                print(done.stdout + done.stderr)
                return done.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
