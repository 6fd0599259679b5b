"""Draw the pictures of docs/gallery.md anew: run each example by its command and draw one figure of what it wrote.

    python benchmarks/gallery.py                    all, into docs/images (some minutes)
    python benchmarks/gallery.py laboratory sweep   these

Cases and studies stand in configs/ and examples/gallery/, their seeds are fixed: equal software draws equal pictures.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from options import arguments, parsed

from rths_cli.files.result_reader import read_result
from rths_cli.files.sweep_file import read_sweep
from rths_cli.report.figures import write

SHORT = ("laboratory", "--folder", "pictures")
ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "gallery.md"
EXAMPLE = re.compile(
    r"^## .*?!\[[^]]*\]\(images/gallery_(\w+)-(\w+)\.svg\).*?^```sh\n(.*?)\n", re.DOTALL | re.MULTILINE
)


def examples() -> dict[str, tuple[str, str]]:
    """Return by name the figure and the command of every example of the page whose picture this script draws."""
    sections = re.split(r"^(?=## )", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    found = [match for section in sections if (match := EXAMPLE.match(section))]
    return {match[1]: (match[2], match[3]) for match in found}


def picture(command: str, figure: str, folder: Path) -> Path:
    """Run a command in a folder and draw a figure of the result or sweep that it writes there; return its file."""
    shutil.copytree(ROOT / "examples" / "gallery", folder / "examples" / "gallery")
    subprocess.run([sys.executable, "-m", *shlex.split(command.replace("rths", "rths_cli", 1))], cwd=folder, check=True)
    (written,) = [*folder.glob("results/*.h5"), *folder.glob("sweeps/*.h5")]
    drawn = folder / "drawn"
    if written.parent.name == "sweeps":
        write.write_sweep_figures([(written, read_sweep(written))], drawn, "svg", "one")
    else:
        write.FIGURES = {figure: write.FIGURES[figure]}
        write.write_figures([read_result(written)], drawn, "svg", "one")
    return drawn / f"{written.stem}-{figure}.svg"


def main() -> int:
    """Draw the pictures asked for, or all."""
    known = examples()
    parser = arguments(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of examples: {', '.join(known)} [all]")
    parser.add_argument("--folder", type=Path, default=PAGE.parent / "images", help="of the pictures [docs/images]")
    asked = parsed(parser, SHORT)
    if unknown := set(asked.names) - set(known):
        parser.error(f"no example {', '.join(sorted(unknown))}; known: {', '.join(known)}")
    all_figures = dict(write.FIGURES)
    for name in asked.names or known:
        figure, command = known[name]
        asked.folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            write.FIGURES = dict(all_figures)
            target = asked.folder / f"gallery_{name}-{figure}.svg"
            shutil.copy(picture(command, figure, Path(folder)), target)
        print(f"{target}: {target.stat().st_size // 1000} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
