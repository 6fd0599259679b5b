"""A compensator that is a discrete linear block: read from a file, and put in the place of the feedforward."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.control.feedforward import INPUTS as DESIRED
from rths_cli.control.feedforward import OUTPUTS
from rths_cli.control.law_block import measured_names
from rths_cli.errors import InputError
from rths_cli.files.matlab_files import MatlabObject, matlab_variables
from rths_cli.numerics.lti import Array, Block

MOST_BYTES = 50_000_000
MOST_STATES = 500
NAMES = ("A", "B", "C", "D", "dt_s", "inputs", "outputs")
OUTPUT = "command_v"
SAME_INTERVAL = 1e-9  # relative
ON_THE_CIRCLE = 1e-9  # nearer than this to the unit circle a pole is on it


def placed_block(field: str, block: Block, dt_s: float, channels: int, interface: str = "acceleration") -> Block:
    """Return a block in the place of the feedforward: all of its signals known by name, in the step's order.

    Its inputs are of the desired motion (`desired_accel_m_s2`, `desired_vel_m_s`, `desired_disp_m`) and of the
    corrected samples of `channels` accelerometers (`table_accel_m_s2`, `floor_accel_1_m_s2`, ...), at an `interface` of
    displacement of `measured_disp_m` and `measured_force_n`, in any order; its one output is `command_v`. Raises
    InputError for other signals, another sample time, what is not finite, and a filter of the desired motion that is
    unstable.
    """
    known = (*DESIRED, *measured_names(channels, interface))
    faults = [f"the input {name!r} is none; known: {', '.join(known)}" for name in block.inputs if name not in known]
    count, stated = block.D.shape[1], ", ".join(block.inputs) or "none"
    if len(set(block.inputs)) != len(block.inputs) or len(block.inputs) != count:
        faults.append(f"{count} inputs need as many names, each once, got {stated}")
    if block.D.shape[0] != 1 or tuple(block.outputs) not in ((OUTPUT,), OUTPUTS):
        faults.append(f"needs one output, {OUTPUT}, got {', '.join(block.outputs) or 'none'}")
    if not abs(block.dt_s - dt_s) <= SAME_INTERVAL * dt_s:
        faults.append(
            f"its sample time is {block.dt_s:.9g} s, the loop's is {dt_s:.9g} s; convert it, or state sample_rate_hz: "
            f"{1.0 / block.dt_s if block.dt_s > 0.0 else 0.0:.9g}"
        )
    if not all(np.isfinite(one).all() for one in (block.A, block.B, block.C, block.D)):
        faults.append("its matrices must be finite")
    if faults:
        raise InputError(*(f"{field}: {fault}" for fault in faults))
    used = [known.index(name) for name in block.inputs if np.any(block.B[:, block.inputs.index(name)])
            or np.any(block.D[:, block.inputs.index(name)])]  # fmt: skip
    width = max([len(DESIRED), *(place + 1 for place in used)])
    b, d = np.zeros((len(block.A), width)), np.zeros((1, width))
    for i, name in enumerate(block.inputs):
        if known.index(name) < width:
            b[:, known.index(name)], d[:, known.index(name)] = block.B[:, i], block.D[:, i]
    radius = float(np.abs(np.linalg.eigvals(block.A)).max(initial=0.0))
    if width == len(DESIRED) and radius >= 1.0 - ON_THE_CIRCLE:
        raise InputError(
            f"{field}: the compensator is unstable by itself: its spectral radius is {radius:.6g}, which no feedback "
            "changes, since it uses the desired motion only; give it poles inside the unit circle (no integrator)"
        )
    return replace(block, name="feedforward", B=b, D=d, dt_s=dt_s, inputs=known[:width], outputs=OUTPUTS)


def read_block(field: str, path: Path, sha256: str | None) -> Block:
    """Return the block of a .mat, .npz or .json file with A, B, C, D, dt_s, inputs and outputs.

    Raises InputError for another checksum, and with every fault of what the file holds.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{field}.file: {path.name} is larger than {MOST_BYTES / 1e6:g} MB, which no block is")
        if sha256 is not None and hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            raise InputError(f"{field}.file: {path} has changed since the case was read; start again")
        found = _content(field, path)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, RecursionError) as error:
        raise InputError(f"{field}.file: {path.name} cannot be read as a block: {str(error)[:200]}") from error
    objects = [name for name, value in found.items() if isinstance(value, MatlabObject)]
    missing = [name for name in NAMES if found.get(name) is None]
    if missing:
        advice = "in MATLAB: [A,B,C,D] = ssdata(sys); dt_s = sys.Ts; inputs = sys.InputName; outputs = sys.OutputName"
        holds = f"; {', '.join(objects)} is an object, of which only MATLAB knows the numbers" if objects else ""
        raise InputError(f"{field}.file: {path.name} lacks {', '.join(missing)}{holds} ({advice})")
    return _block(field, path, found)


def _content(field: str, path: Path) -> Mapping[str, Any]:
    """Return the values of a file by name."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return matlab_variables(path, NAMES)
    if suffix == ".json":
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ValueError("it must hold a mapping")
        return content
    if suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            if sum(one.file_size for one in archive.infolist()) > MOST_BYTES:
                raise ValueError(f"it holds more than {MOST_BYTES / 1e6:g} MB")
        with np.load(path, allow_pickle=False) as content:
            return {name: content[name] for name in content.files}
    raise InputError(f"{field}.file: {path.name} must end with .mat, .npz or .json")


def _block(field: str, path: Path, found: Mapping[str, Any]) -> Block:
    """Return the block that values make; raises InputError for shapes that do not fit."""
    try:
        d, a = np.atleast_2d(_real("D", found["D"])), _real("A", found["A"])
        n = 0 if a.size == 0 else np.atleast_2d(a).shape[0]
        if n > MOST_STATES:
            raise ValueError(f"it has {n} states, at most {MOST_STATES}")
        a, b, c = (
            _shaped(name, found[name], shape)
            for name, shape in (("A", (n, n)), ("B", (n, d.shape[1])), ("C", (d.shape[0], n)))
        )
        dt_s = float(_real("dt_s", found["dt_s"]).reshape(()))
        signals = (_texts(found[name]) for name in ("inputs", "outputs"))
        if not dt_s > 0.0:
            raise ValueError(f"dt_s must be > 0, got {dt_s:g}: the block is discrete")
    except (TypeError, ValueError) as error:
        raise InputError(f"{field}.file: {path.name}: {str(error)[:300]}") from error
    return Block(path.name, a, b, c, d, dt_s, *signals)


def _shaped(name: str, value: Any, shape: tuple[int, int]) -> Array:
    found = _real(name, value)
    if found.size == 0 and 0 in shape:
        return np.zeros(shape)
    found = np.atleast_2d(found)
    if found.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, by A and D, got {found.shape}")
    return found


def _real(name: str, value: Any) -> Array:
    """Return a matrix of real numbers; raises ValueError for an imaginary part, which no filter of signals has."""
    found = np.asarray(value)
    if np.iscomplexobj(found):
        if found.imag.any():
            raise ValueError(f"{name} has an imaginary part (up to {np.abs(found.imag).max():g}), it must be real")
        found = found.real
    return np.asarray(found, dtype=float)


def _texts(value: Any) -> tuple[str, ...]:
    """Return names as a file of any kind holds them: one text, rows of text, or a cell array of texts."""
    if isinstance(value, str):
        return (value,)
    flat = value.ravel().tolist() if isinstance(value, np.ndarray) else list(value)
    return tuple(text.strip() for one in flat for text in _texts(one))
