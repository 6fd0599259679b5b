"""List the scripts of this folder, or run one: python benchmarks [NAME [ARGUMENT]...].

Each answers `--help`; most take `--seed`, and those marked * a form as short as can be, `--short`, which the tests run.
"""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path

FOLDER = Path(__file__).parent


def scripts() -> dict[str, tuple[str, bool]]:
    """Return by name what each script is for, and whether it has a short form."""
    found = {}
    for path in sorted(FOLDER.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {one.id for one in ast.walk(tree) if isinstance(one, ast.Name)}
        if "__name__" in names and path.name != "__main__.py":
            about = (ast.get_docstring(tree) or "").split("\n\n")[0].replace("\n", " ")
            found[path.stem] = about.split(": python benchmarks/")[0], "SHORT" in names
    return found


def main() -> int:
    """List the scripts, or become one."""
    known, words = scripts(), sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        print(__doc__)
        for name, (about, short) in known.items():
            print(f"{'*' if short else ' '} {name:<22}{about}")
        return 0
    name = words[0].removesuffix(".py")
    if name not in known:
        print(f"no script is called {name}; python benchmarks lists them", file=sys.stderr)
        return 2
    path = FOLDER / f"{name}.py"
    sys.argv = [str(path), *words[1:]]
    runpy.run_path(str(path), run_name="__main__")
    return 0


if __name__ == "__main__":
    sys.exit(main())
