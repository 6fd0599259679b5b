"""Which values of a parametrised test belong to `make test`, and which to the campaigns alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def keep_first(count: int, values: Iterable[Any]) -> list[Any]:
    """Return values of `pytest.mark.parametrize`, all behind the first `count` marked `campaign`."""
    marked = list(values)
    for place, value in list(enumerate(marked))[count:]:
        if hasattr(value, "marks"):  # what `pytest.param` has made
            marked[place] = value._replace(marks=[*value.marks, pytest.mark.campaign])
        else:
            several = value if isinstance(value, tuple | list) else (value,)
            marked[place] = pytest.param(*several, marks=pytest.mark.campaign)
    return marked
