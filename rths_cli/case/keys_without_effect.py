"""Keys of a case that nothing reads in what is asked for: which runs, controllers and methods use a key."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from rths_cli.case.case_schema import RUNS, Case
from rths_cli.findings import Finding

TABLE_RUNS = ("shake_table", "exp_rths")
LABELS = {"sim": "SIM", "sim_delay": "SIM-DELAY", "shake_table": "the shake-table test", "exp_rths": "EXP-RTHS"}


@dataclass(frozen=True)
class Use:
    """What reads a key: one of `runs`, and only with some values of other keys, which `only` names unless `when`."""

    runs: tuple[str, ...]
    when: Callable[[Case], bool] = lambda case: True
    only: str = ""


def _has_feedback(case: Case) -> bool:
    return case.controller.kind == "FF+FB"


OF_FEEDBACK = ("feedback_bandwidth_hz", "max_sensitivity", "disturbance_hz", "command_weight", "feedback_limit_v")
FEEDBACK = Use(TABLE_RUNS, _has_feedback, "the controller FF+FB reads it")
USES = {
    "delay_s": Use(("sim_delay",)),
    "integration": Use(("exp_rths",)),
    "check": Use(("exp_rths",)),
    "grade_limits": Use(("exp_rths",)),
    "base_shear_uncertainty": Use(
        ("exp_rths",),
        lambda case: any(case.structure.numerical.law or ()),
        "a building whose storeys have laws reads it",
    ),
    "report_in": Use(RUNS, lambda case: case.scale is not None, "a case with a scale reads it"),
    "method": Use(TABLE_RUNS),
    "table": Use(("sim_delay", *TABLE_RUNS)),  # the sensors decide from which frequency on errors are judged
    "limits": Use(TABLE_RUNS),
    "identification": Use(TABLE_RUNS),
    "kalman": Use(TABLE_RUNS),
    "seed": Use(TABLE_RUNS, lambda case: case.table.kind == "virtual", "a virtual rig reads it"),
} | {
    ".".join(("kalman", "residual_hz")): Use(TABLE_RUNS, lambda case: case.method == "best", "method best reads it"),
    **{".".join(("controller", key)): FEEDBACK for key in OF_FEEDBACK},
    ".".join(("controller", "reaction_feedforward")): Use(
        TABLE_RUNS,
        lambda case: case.method == "best" and case.controller.inverts,
        "a feedforward of method best reads it",
    ),
    ".".join(("controller", "friction_compensation")): Use(
        TABLE_RUNS,
        lambda case: case.method == "best" and case.controller.inverts,
        "a feedforward of method best reads it",
    ),
}
"""The keys that not everything reads; of a key below another one the longest path counts."""


def without_effect(case: Case, keys: Iterable[str], runs: Collection[str]) -> dict[str, str]:
    """Return why nothing reads some of a case's `keys` (`controller.command_weight`) when `runs` are played."""
    found = {}
    for key in keys:
        parts = key.split(".")
        above = [".".join(parts[: count + 1]) for count in range(len(parts))]
        for use in (USES[path] for path in above if path in USES):
            if not set(use.runs) & set(runs):
                found[key] = f"only {' and '.join(LABELS[run] for run in use.runs)} would read it"
            elif not use.when(case):
                found[key] = f"only {use.only}"
    return found


def _automatic(case: Case, key: str) -> bool:
    """Return whether a key leaves its choice to the program, which asks for nothing."""
    value: object = case
    for part in key.split("."):
        value = getattr(value, part, None)
    return value == "automatic"


def unread_keys(case: Case) -> Finding | None:
    """Return a warning that names the keys which the case states and its runs do not read, None if all are read.

    SIM-DELAY of the identified building is a part of the check of EXP-RTHS.
    """
    runs = {*case.runs, *(("sim_delay",) if "exp_rths" in case.runs else ())}
    asked = (key for key in case.stated if not key.endswith(".extends") and not _automatic(case, key))
    found = without_effect(case, asked, runs)
    reasons: dict[str, list[str]] = {}
    for key, why in found.items():
        reasons.setdefault(why, []).append(key)
    told = tuple(f"{', '.join(keys)} ({why})" for why, keys in reasons.items())
    return Finding("case.without_effect", {"keys": told}) if told else None
