"""Print size, time to make and time to open of the report page of result files, and what a browser says to it.

python benchmarks/page.py RESULT...    needs pip install playwright, and chromium (playwright install chromium)
"""

from __future__ import annotations

import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the sources this file belongs to

from options import arguments, parsed

from rths_cli.report.page import write_page
from rths_cli.report.results_by_case import load

WIDTHS = (1280, 390)
OPENED = 5
LOADED_MS = "performance.getEntriesByType('navigation')[0].loadEventEnd"
DRAWN = "document.querySelectorAll('.plot canvas').length"


def main() -> None:
    """Make the page of the results named and open it at two widths."""
    parser = arguments(__doc__)
    parser.add_argument("results", nargs="+", help="result files or folders of them")
    paths = parsed(parser).results
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        started, worked = time.perf_counter(), time.process_time()
        results = load([Path(path) for path in paths])
        write_page(results, page, " ".join(["rths", "report", *paths, "--format", "html"]))
        took, work = time.perf_counter() - started, time.process_time() - worked
        size = page.stat().st_size / 1e6
        print(f"{len(results)} results: {size:.2f} MB (demand 5), made in {took:.1f} s, {work:.1f} s of processor time")
        _open(page)


def _open(page: Path) -> None:
    """Open a page in fresh tabs of a browser without a window; print its times and what it said."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = shutil.which("chromium") or shutil.which("google-chrome")
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        print(f"browser {browser.version}")
        for width in WIDTHS:
            said: list[str] = []
            times = []
            for _ in range(OPENED):
                tab = browser.new_page(viewport={"width": width, "height": 900})
                tab.on("console", lambda message, to=said: to.append(message.text))
                tab.on("pageerror", lambda error, to=said: to.append(str(error)))
                tab.goto(page.as_uri())
                times.append(1e-3 * tab.evaluate(LOADED_MS))
                plots, wide = tab.evaluate(DRAWN), tab.evaluate("document.documentElement.scrollWidth")
                tab.close()
            told = f"median {statistics.median(times):.2f} s, longest {max(times):.2f} s (demand 2)"
            print(f"{width} px: open in {told}; {plots} plots, page {wide} px wide; console: {said or 'silent'}")
        browser.close()


if __name__ == "__main__":
    main()
