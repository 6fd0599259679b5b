"""The machine and the versions behind the figures."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from campaigns.exported_step import EQUAL, FAST, compiler

PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "control", "openseespy")


def machine() -> str:
    """Return processor, cores, kernel, Python, packages and C compiler, one line each."""
    return "\n".join(
        [
            f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
            f"Python {platform.python_version()}; " + ", ".join(f"{name} {_version(name)}" for name in PACKAGES),
            _compiler(),
        ]
    )


def _processor() -> str:
    """Return the processor's name, or its kind where the system does not tell."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _compiler() -> str:
    path = compiler()
    if path is None:
        return "no C compiler"
    said = subprocess.run([path, "--version"], capture_output=True, text=True).stdout.splitlines()
    return f"{said[0] if said else path}; rths_step.c with {' '.join(FAST)} and {EQUAL[0]}"
