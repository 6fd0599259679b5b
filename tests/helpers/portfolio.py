"""Which values of a parametrised test belong to `make test`, and which to the campaigns alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest


def keep_first(count: int, values: Iterable[Any], several: bool = False) -> list[Any]:
    """Return parameters, all behind the first `count` marked `campaign`; `several`: each is one for several names."""
    marked = list(values)
    for place, value in list(enumerate(marked))[count:]:
        if hasattr(value, "marks"):  # what `pytest.param` has made
            marked[place] = value._replace(marks=[*value.marks, pytest.mark.campaign])
        else:
            marked[place] = pytest.param(*(value if several else [value]), marks=pytest.mark.campaign)
    return marked


def parametrize_first(
    count: int, names: str | Sequence[str], values: Iterable[Any], ids: Any = None
) -> pytest.MarkDecorator:
    """Return `pytest.mark.parametrize` with all values behind the first `count` marked `campaign`."""
    several = not isinstance(names, str) or "," in names
    return pytest.mark.parametrize(names, keep_first(count, values, several), ids=ids)
