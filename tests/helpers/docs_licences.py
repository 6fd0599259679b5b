"""The page of licences: what the package needs, directly and through others, and what its extras add.

The licences are stated here, without versions, so that the page is the same with every permitted version. A test holds
them against the metadata of what is installed.
"""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
LICENCES = {  # SPDX identifiers; of several, those of the Python code
    "annotated-types": "MIT", "build": "MIT", "click": "BSD-3-Clause", "colorama": "BSD-3-Clause",
    "commonmark": "BSD-3-Clause", "contourpy": "BSD-3-Clause", "control": "BSD-3-Clause", "cycler": "BSD-3-Clause",
    "dask": "BSD-3-Clause", "distributed": "BSD-3-Clause",
    "fonttools": "MIT",
    "h5netcdf": "BSD-3-Clause", "h5py": "BSD-3-Clause", "hatchling": "MIT", "hypothesis": "MPL-2.0",
    "import-linter": "BSD-2-Clause", "jsonschema": "MIT", "kiwisolver": "BSD-3-Clause",
    "llvmlite": "BSD-2-Clause AND Apache-2.0", "markdown-it-py": "MIT", "matplotlib": "PSF-2.0",
    "mdurl": "MIT", "mkdocs": "BSD-2-Clause", "mkdocs-material": "MIT", "mypy": "MIT",
    "nidaqmx": "MIT", "nptdms": "LGPL-3.0-only",
    "obspy": "LGPL-3.0-only", "opensees": "BSD-2-Clause", "numba": "BSD-2-Clause",
    "numpy": "BSD-3-Clause", "packaging": "Apache-2.0 OR BSD-2-Clause", "pillow": "MIT-CMU", "playwright": "Apache-2.0",
    "pyarrow": "Apache-2.0", "pydantic": "MIT", "pydantic-core": "MIT",
    "pygments": "BSD-2-Clause", "pyparsing": "MIT", "pytest": "MIT",
    "pytest-xdist": "MIT", "python-dateutil": "BSD-3-Clause OR Apache-2.0", "pyyaml": "MIT", "rich": "MIT",
    "ruff": "MIT", "salib": "MIT", "scipy": "BSD-3-Clause", "six": "MIT",
    "types-pyyaml": "Apache-2.0", "typing-extensions": "PSF-2.0",
    "typing-inspection": "MIT", "tzdata": "Apache-2.0", "xarray": "Apache-2.0",
}  # fmt: skip
# on Windows, or with some versions of what needs them
SOMETIMES = ("colorama", "commonmark", "markdown-it-py", "mdurl", "six", "tzdata")
FAMILIES = {  # as licences are named in metadata: expressions, classifiers, or the text itself
    "AGPL": r"AGPL|Affero General Public", "LGPL": r"LGPL|Lesser General Public", "GPL": r"\bGPL|GNU General Public",
    "MPL": r"MPL|Mozilla Public", "Apache": r"Apache", "BSD": r"BSD|Kiwi licen[sc]e", "MIT": r"\bMIT\b|HPND",
    "PSF": r"PSF|Python Software Foundation",
}  # fmt: skip


PAGE = """# Licences

The licences of what `rths` installs or contains. `rths` itself is under BSD-3-Clause (the file `LICENSE`). This page
is made by `python tests/helpers/docs_reference.py`; a test compares it with the metadata of the installed packages.

## Required

Every user gets these. None of them is under the GPL or AGPL, and a test keeps it so.

{required}

`colorama` comes on Windows alone, `commonmark`, `six` and `tzdata` with some versions of `rich` and
`python-dateutil`. The wheels of numpy and scipy contain the runtime libraries of GCC's Fortran: libgfortran is under
the GPL with the runtime exception, which lets programs of any licence use it, libquadmath under the LGPL. Both lie
beside the Python code and may be exchanged. The wheels of h5py contain HDF5 (BSD-3-Clause).

## Optional

An extra (in brackets) is asked for by name: `pip install 'rths-cli[tdms]'`. `dev` is for the tests, `docs` for the site
of these pages.

{optional}

`nptdms` and `obspy` are under the LGPL. `rths` imports them where a user has installed them, contains nothing of them
and works without them, which the LGPL permits to programs of any licence. Nothing under the GPL or AGPL is imported.

## In the package

`rths_cli/report/page/assets/` contains uPlot (MIT, its licence beside it), which draws the plots of the HTML page.
The ground motions have a position of their own: `records/README.md`.
"""


def normal(name: str) -> str:
    """Return the name of a distribution as registries compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def declared() -> dict[str, list[str]]:
    """Return the names that pyproject.toml asks for: "" for every user, and each extra."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    asked = {"": project["dependencies"], **project["optional-dependencies"]}
    return {extra: [normal(Requirement(line).name) for line in lines] for extra, lines in asked.items()}


def installed_requirements() -> set[str]:
    """Return what the required packages need in turn, as installed here, themselves included."""
    found: set[str] = set()
    waiting = list(declared()[""])
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            needed = [Requirement(line) for line in metadata.requires(name) or ()]
            waiting += [normal(one.name) for one in needed if not one.marker or one.marker.evaluate({"extra": ""})]
    return found


def families(text: str) -> set[str]:
    """Return the families of licences that a text names."""
    return {family for family, pattern in FAMILIES.items() if re.search(pattern, text)}


def stated_by_itself(name: str) -> str:
    """Return how an installed package states its licence: in its metadata, else in the head of its licence's file."""
    about = metadata.metadata(name)
    classifiers = [line for line in about.get_all("Classifier") or () if line.startswith("License ::")]
    stated = [about.get("License-Expression") or "", (about.get("License") or "")[:200], *classifiers]
    if not any(stated):
        files = [file for file in metadata.files(name) or () if file.name in about.get_all("License-File", [])]
        stated = [file.read_text()[:200] for file in files]
    return "\n".join(stated)


def licences_page() -> str:
    """Return the page."""
    asked = declared()
    through = sorted(set(LICENCES) - {name for names in asked.values() for name in names})
    extras = {name: [extra for extra in asked if extra and name in asked[extra]] for name in sorted(LICENCES)}
    optional = {name: f"`{name}` ({', '.join(found)})" for name, found in extras.items() if found}
    required = {name: f"`{name}`" for name in (*sorted(asked[""]), *through)}
    return PAGE.format(required=_by_licence(required), optional=_by_licence(optional))


def _by_licence(names: dict[str, str]) -> str:
    """Return a line per licence with the packages that are under it."""
    under: dict[str, list[str]] = {}
    for name, shown in names.items():
        under.setdefault(LICENCES[name], []).append(shown)
    return "\n".join(f"- {licence}: {', '.join(under[licence])}" for licence in sorted(under))
