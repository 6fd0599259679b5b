"""All of a result that is no series, as a JSON document: attributes, figures, blocks, poles, the case."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rths_cli.export.source import Source
from rths_cli.files.result_outline import Outline

SERIES = ("time_s", "frequency_hz")


def notes(source: Source) -> dict[str, Any]:
    """Return the attributes of a result and, by group, each dataset that is no series; what is not finite is null."""
    about = {key: _plain(value) for key, value in source.result.attributes.items()}
    held = {path: _group(source, outline) for path, outline in source.groups.items()}
    return {"attributes": about, "groups": {path: group for path, group in held.items() if group}}


def _group(source: Source, outline: Outline) -> dict[str, Any]:
    found: dict[str, Any] = {key: _plain(value) for key, value in outline.attributes.items()}
    for name, item in source.read(outline.path).items():
        if name in outline.datasets and item.dims[-1:] not in [(axis,) for axis in SERIES]:
            told = {"units": item.units, "long_name": item.long_name, "source": item.source}
            found[name] = {"value": _plain(np.asarray(item.data).tolist()), **told, "dims": list(item.dims)}
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
