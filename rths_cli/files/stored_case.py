"""What readers of results need of the case that a result file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.numerics.lti import Array

CASES = 16  # the answer alone asks eight times for the case of one result


def stored_case(result: Result) -> dict[str, Any]:
    """Return the case of a result with all its defaults; {} where a damaged file has lost it.

    All callers share the dictionary: it is not to be changed.
    """
    return _read(result.resolved_yaml)


def with_keys(result: Result, keys: Sequence[str]) -> Result:
    """Return a result with only some keys of its resolved case: to read a whole case takes ten times as long."""
    kept, wanted = [], False
    for line in result.resolved_yaml.splitlines():
        wanted = line.partition(":")[0] in keys if line[:1].strip() else wanted
        kept += [line] if wanted else []
    return replace(result, resolved_yaml="\n".join(kept))


@lru_cache(maxsize=CASES)
def _read(text: str) -> dict[str, Any]:
    import yaml

    try:
        case = yaml.safe_load(text)  # the loader in C crashes on deeply nested text
    except yaml.YAMLError:
        return {}
    return case if isinstance(case, dict) else {}


def floor_masses_kg(result: Result) -> Array:
    """Return the masses (n_storeys,) of a result's building from the lowest floor up, the interface's whole mass
    included; raises InputError where a damaged file has lost them."""
    structure = stored_case(result).get("structure")
    try:
        parts = [structure[part]["masses_kg"] for part in ("numerical", "experimental")]  # type: ignore[index]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{result.path}: has lost the masses of its case; {result.made_anew}") from error


def storey_heights_m(result: Result) -> Array | None:
    """Return the heights (n_storeys,) of a result's storeys from the lowest up, None where its case states none."""
    structure = stored_case(result).get("structure")
    heights = structure.get("heights_m") if isinstance(structure, dict) else None
    try:
        found = np.asarray(heights, dtype=float)
    except (TypeError, ValueError):
        return None
    return found if found.ndim == 1 and found.size and np.all(found > 0.0) else None
