"""Results that must not be combined in one report: other units, two cases of one name, one run twice."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from rths_cli.files.result_reader import Result
from rths_cli.quantities import metric
from rths_cli.report.input_files import Unread

APART = ("name", "seed", "method", "runs", "accept", "notes", "reference")  # keys that do not distinguish cases
SEED = re.compile(r"^  seed: .*\n", re.MULTILINE)
KEY = re.compile(r"^(?=[^\s-])", re.MULTILINE)
Key = Callable[[Result], tuple[str, ...]]


def other_units(results: Sequence[Result]) -> list[Unread]:
    """Return a sentence for each result with metrics in another unit than declared or than in other results."""
    first: dict[str, tuple[str, Result]] = {}
    found: list[Unread] = []
    for result in results:
        odd = []
        for path, unit in result.units.items():
            known = metric(path)
            if path not in first and (known is None or known.units == unit):
                first[path] = unit, result
            expected = known.units if known else first[path][0]
            if unit != expected:
                odd.append(f"{path} is in {unit}, not {expected}")
        if odd:
            more = f", and {len(odd) - 1} more figures in other units" if len(odd) > 1 else ""
            found.append(Unread(result.path, f"{result.path}: {odd[0]}{more}; convert them, or report it apart."))
    return found


def doubled(results: Sequence[Result], group: Key) -> list[Unread]:
    """Return a sentence for each result that is a copy of another one, or a different case of the same name.

    Cases of the same name may differ if `group` returns different values, or if method, rig or software differ.
    """
    seen: dict[tuple[str, ...], list[Result]] = {}
    found: list[Unread] = []
    for result in results:
        same = seen.setdefault((*_place(result), *group(result)), [])
        found += list(_clash(result, same))[:1]
        same.append(result)
    return found


def _clash(result: Result, others: Sequence[Result]) -> Iterator[Unread]:
    path, name = result.path, result.attributes.get("case_name")
    moment = _moment(result)
    for other in others:
        if moment == _moment(other) and _same_figures(result, other):
            yield Unread(path, f"{path}: is the same run as {other.path}; leave one of them out.")
            return
    keys = differing(result, others[0]) if others else []
    if keys:
        yield Unread(
            path,
            f"{path}: case {name} is another one than in {others[0].path} (they differ in {', '.join(keys)}); "
            "give one another name, or tell them apart with --group-by.",
        )


def _place(result: Result) -> tuple[str, ...]:
    keys = ("case_name", "method", "rig", "rig_kind", "rths_version", "git_commit")
    return tuple(str(result.attributes.get(key, "")) for key in keys)


def _moment(result: Result) -> tuple[object, ...]:
    return tuple(result.attributes.get(key) for key in ("created_utc", "seed", "status"))


def _same_figures(one: Result, other: Result) -> bool:
    return one.metrics.keys() == other.metrics.keys() and all(
        np.array_equal(value, other.metrics[path], equal_nan=True) for path, value in one.metrics.items()
    )


def differing(one: Result, other: Result) -> list[str]:
    """Return the keys in which the cases of two results differ; empty if a case is not stored."""
    if not one.resolved_yaml or not other.resolved_yaml or one.resolved_yaml == other.resolved_yaml:
        return []
    mine, theirs = _keys(one.resolved_yaml), _keys(other.resolved_yaml)
    return sorted(key for key in mine.keys() | theirs.keys() if mine.get(key) != theirs.get(key))


def _keys(text: str) -> dict[str, str]:
    """Return the text of each key of a resolved case, without the keys that do not distinguish cases."""
    parts = [part for part in KEY.split(text) if part.strip()]
    keys = {part.partition(":")[0]: SEED.sub("", part) for part in parts}
    return {key: part for key, part in keys.items() if key not in APART}
