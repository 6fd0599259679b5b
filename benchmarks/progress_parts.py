"""Measure what the parts of a first run take, of which rths tells how long a command still takes.

    python benchmarks/progress_parts.py [--write]

Runs `rths run`, `check` and `identify` of a shipped case, each with an empty cache, and prints the durations that they
learned; with --write they become rths_cli/cli/progress_parts.json. On an idle machine; each takes a minute or less.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from options import arguments, parsed

from rths_cli.cli.progress import SHIPPED

CASE = "el_centro_low_ff_fb"
COMMANDS = {"run": ["run", CASE], "check": ["check", CASE], "identify": ["identify", CASE, "--no-figure"]}


def measured(command: str) -> dict[str, float]:
    """Return the durations in s of the parts of a command that finds nothing in its cache."""
    with tempfile.TemporaryDirectory() as folder:
        place = {"XDG_CACHE_HOME": folder, "LOCALAPPDATA": folder}
        words = [sys.executable, "-m", "rths_cli", *COMMANDS[command]]
        subprocess.run(words, cwd=folder, env={**os.environ, **place}, capture_output=True, check=True)
        found: dict[str, float] = json.loads((Path(folder) / "rths" / "progress.json").read_text())[command]
    return found


def main() -> int:
    """Measure all commands and print or write what they took."""
    parser = arguments(__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {SHIPPED.name}")
    asked = parsed(parser)
    kept = SHIPPED.read_text(encoding="utf-8")
    SHIPPED.write_text("{}\n", encoding="utf-8")  # what a command learns is a mean with what it knew
    try:
        text = json.dumps({command: measured(command) for command in COMMANDS}, indent=1) + "\n"
        kept = text if asked.write else kept
    finally:
        SHIPPED.write_text(kept, encoding="utf-8")
    if not asked.write:
        print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
