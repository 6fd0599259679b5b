"""Oracle: the packages themselves, and importlib's own reading of their metadata."""

import json
import platform
from importlib.metadata import version

import numpy as np

from rths_cli.experiment import provenance


def test_versions_are_those_of_the_packages() -> None:
    found = json.loads(provenance.versions())
    assert found == {"python": platform.python_version(), **{name: version(name) for name in provenance.PACKAGES}}
    assert found["numpy"] == np.__version__
    assert provenance.package_version("pytest") == version("pytest")
    assert provenance.package_version("no-such-package") == "unknown"
