"""Root attributes of a result file: versions, commit, machine, hash of the model, settings."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import TYPE_CHECKING

from rths_cli.structure import first_mode_ratio
from rths_cli.version import __version__

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Model

PACKAGES = ("numpy", "scipy", "numba", "h5py", "pydantic")


def attributes(setup: Setup, model: Model | None, command_line: str) -> dict[str, str | int | float]:
    """Return the root attributes of a result file except format, status and reason."""
    case, building = setup.case, setup.building
    published = case.published()
    return {
        "case_name": case.name,
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "rths_version": __version__,
        "seed": case.seed,
        "sample_rate_hz": case.sample_rate_hz,
        "test_band_hz": case.test_band_hz,
        "compared_low_hz": setup.compared.low_hz,
        "compared_high_hz": setup.compared.high_hz,
        "method": case.method,
        "rig": case.table.name,
        "rig_kind": case.table.kind,
        **({} if case.table.calibration is None else {"calibration": case.table.calibration.told}),
        "driver_verified": "",  # known only after the rig was opened; its stage then states it
        "overrides": " ".join(setup.overrides),
        "own_parts": " ".join(setup.parts),
        "own_building": "declared" if setup.declared else "",
        "command_line": command_line,
        "platform": _platform(),
        "package_versions": versions(),
        "git_commit": git_commit(),
        "record_sha256": setup.record_sha256,
        "model_sha256": model_sha256(model) if model else "",
        "record_name": case.record.name,
        **({} if case.record.baseline is None else {"record_baseline": case.record.baseline.remove}),
        **({} if case.record.component is None else {"record_component": case.record.component}),
        **({"record_treatment": "; ".join(setup.record_treatment)} if setup.record_treatment else {}),
        "damping_name": case.damping.name,
        "damping_first_mode_ratio": first_mode_ratio(building.M, building.C, building.K),
        "controller": case.controller.kind,
        "scaling": case.scaling,
        **_scale(setup),
        "reference_title": case.reference.title if case.reference else "",
        "reference_json": json.dumps(published) if published else "",
    }


def _scale(setup: Setup) -> dict[str, str | int | float]:
    """Return the independent scale factors of a model and the scale of its reports, nothing where none is stated."""
    scale = setup.similitude
    if scale is None:
        return {}
    factors = {"scale_length": scale.length, "scale_acceleration": scale.acceleration, "scale_mass": scale.mass}
    return {**factors, "report_in": setup.case.report_in}


def model_sha256(model: Model) -> str:
    """Return the SHA-256 of a table model's numbers."""
    digest = hashlib.sha256()
    for part in (model.zeros, model.poles):
        digest.update(part.tobytes())
    digest.update(repr((model.gain, model.delay_s, model.ripple_m_s2_per_v, model.coupling_hz)).encode())
    return digest.hexdigest()


@cache
def _platform() -> str:
    return platform.platform()


@cache
def versions() -> str:
    """Return the versions of Python and of the PACKAGES as JSON."""
    return json.dumps({"python": platform.python_version(), **{name: package_version(name) for name in PACKAGES}})


def package_version(name: str) -> str:
    """Return the version of an installed package, "unknown" if it is not installed or states none.

    Only the version's line of the metadata is read; importlib parses the whole text, which takes ten times as long.
    """
    try:
        told = distribution(name).read_text("METADATA") or ""
    except PackageNotFoundError:
        return "unknown"
    return next((line[9:].strip() for line in told.splitlines() if line.startswith("Version: ")), "unknown")


@cache
def git_commit() -> str:
    """Return the commit of the source tree that rths runs from, "" if it runs from an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, timeout=5, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()
