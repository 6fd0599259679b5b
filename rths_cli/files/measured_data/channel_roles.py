"""Which channel of a recording is what, and in which unit: of what identifies a table, and of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.measured_data.recording import Recording, listed
from rths_cli.files.measured_data.units import FACTORS, OF_A_RUN, canonical_unit, role_of, split_name
from rths_cli.numerics.lti import Array

LARGEST = 1e30  # of a sample, in whatever unit: its eighth power is a number, too


@dataclass(frozen=True)
class Chosen:
    """What evaluation takes of a recording.

    `command_v` (n,) in V; `accel` (c, n), each channel in its `units` (c,), "V" (sensor voltage) or "m/s^2"; `names`
    (c,) and `command_name` as in the file; `notes` say what was taken for what. NaN where samples are missing.
    """

    command_v: Array
    accel: Array
    units: tuple[str, ...]
    names: tuple[str, ...]
    command_name: str
    notes: tuple[str, ...]


def choose(recording: Recording, roles: Sequence[str], choices: Mapping[str, tuple[str, str]]) -> Chosen:
    """Return the channels for the roles (`command`, `table`, `floor_2`, ...: the command and c accelerations).

    `choices` gives for a role the channel's name in the file and its unit, or "". Other roles are matched to names.
    Raises InputError, one sentence per role, where a channel is missing or ambiguous, or its unit is missing, unknown,
    contradicted, or no voltage for the command.
    """
    faults = [
        f"{recording.path}: --channel {role}=...: there is no such role; roles are {', '.join(roles)}"
        for role in choices
        if role not in roles
    ]
    found: dict[str, tuple[int, str]] = {}
    for role in roles:
        try:
            found[role] = _channel(recording, role, *choices.get(role, ("", "")))
        except InputError as fault:
            faults += fault.faults
    faults += _shared(recording, found)
    if faults:
        raise InputError(*faults)
    command = next(role for role in roles if role == "command")
    series = {role: _usable(recording.samples[k]) * FACTORS[unit][0] for role, (k, unit) in found.items()}
    others = [role for role in roles if role != command]
    return Chosen(
        command_v=series[command],
        accel=np.array([series[role] for role in others]),
        units=tuple(FACTORS[found[role][1]][1] for role in others),
        names=tuple(recording.names[found[role][0]] for role in others),
        command_name=recording.names[found[command][0]],
        notes=tuple(f"{role}: channel {recording.names[k]!r}, read in {unit}" for role, (k, unit) in found.items()),
    )


def _usable(samples: Array) -> Array:
    """Return the samples (n,) of a channel with NaN, which is missing, for numbers that no channel shows."""
    return np.where(np.abs(samples) <= LARGEST, samples, np.nan)


@dataclass(frozen=True)
class RunChannels:
    """What evaluation takes of the recording of a run, by role: `series` (n,) in the SI `units` V, m/s^2, N or m, NaN
    where samples are missing; `names` as in the file."""

    series: Mapping[str, Array]
    units: Mapping[str, str]
    names: Mapping[str, str]


def choose_of_run(
    recording: Recording,
    wanted: Mapping[str, tuple[str, ...]],
    needed: Sequence[str],
    choices: Mapping[str, tuple[str, str]],
) -> RunChannels:
    """Return the channels of a run for those of the roles that the recording has.

    `wanted`: the SI units in which each role may come; `needed`: roles without which there is no run. `choices` as for
    `choose`; a minus before a unit turns the sign of the channel. A channel that has the name of a role it does not fit
    is left out unless it is chosen. Raises InputError, one sentence per role, as `choose` does.
    """
    faults = [
        f"{recording.path}: {role}: there is no such role; roles of this run are {', '.join(wanted)}"
        for role in choices
        if role not in wanted
    ]
    found: dict[str, tuple[int, str]] = {}
    signs: dict[str, float] = {}
    for role, units in wanted.items():
        name, unit = choices.get(role, ("", ""))
        signs[role] = -1.0 if unit.startswith("-") else 1.0
        if not name and role not in needed and not _speaks_of(recording, role, units):
            continue
        try:
            found[role] = _channel(recording, role, name, unit.removeprefix("-"), units)
        except InputError as fault:
            faults += fault.faults
    faults += _shared(recording, found)
    if faults:
        raise InputError(*faults)
    series = {
        role: _usable(recording.samples[k]) * (signs[role] * OF_A_RUN[unit][0]) for role, (k, unit) in found.items()
    }
    of_each = {role: OF_A_RUN[unit][1] for role, (_, unit) in found.items()}
    return RunChannels(series, of_each, {role: recording.names[k] for role, (k, _) in found.items()})


def _speaks_of(recording: Recording, role: str, units: tuple[str, ...]) -> bool:
    """Return whether a channel has the name of a role and no unit that does not fit it."""
    named = [unit for name, unit in zip(recording.names, recording.units, strict=True) if role_of(name) == role]
    return any(not unit or OF_A_RUN[unit][1] in units for unit in named)


def _channel(
    recording: Recording, role: str, name: str, unit: str, wanted: tuple[str, ...] = ("V", "m/s^2")
) -> tuple[int, str]:
    """Return a role's channel and its unit (a key of OF_A_RUN), whose SI unit is one of `wanted`."""
    index = _named(recording, role, name) if name else _matched(recording, role)
    channel, stated = recording.names[index], recording.units[index]
    where = f"{recording.path}: {role}: channel {channel!r}"
    given, fitting = canonical_unit(unit), [one for one in OF_A_RUN if OF_A_RUN[one][1] in wanted]
    if unit and (not given or given not in fitting):
        raise InputError(
            f"{where}: {unit!r} is not one of the units {', '.join(fitting)}; correct --channel {role}=..."
        )
    if given and stated and OF_A_RUN[given] != OF_A_RUN[stated]:
        raise InputError(
            f"{where}: the file states the unit {stated}, --channel {given}; correct or remove one of them"
        )
    taken = given or stated
    if not taken:
        example = fitting[0] if role == "command" else "g" if "g" in fitting else fitting[0]
        raise InputError(
            f"{where}: its unit is missing or unknown; give --channel '{role}={channel}:{example}' with one of "
            f"{', '.join(fitting)}"
        )
    if role == "command" and OF_A_RUN[taken][1] != "V":
        raise InputError(
            f"{where}: a command is in V or mV, not {taken}; give the drive voltage as --channel command=NAME:V"
        )
    if taken not in fitting:
        raise InputError(f"{where}: is in {taken}; {role} needs {', '.join(fitting)}; name another channel")
    return index, taken


def _named(recording: Recording, role: str, name: str) -> int:
    """Return the channel the user names: exactly, else whatever the case, else without its unit."""
    names = recording.names
    for same in (
        lambda n: n == name,
        lambda n: n.casefold() == name.casefold(),
        lambda n: split_name(n)[0].casefold() == split_name(name)[0].casefold(),
    ):
        found = [k for k, other in enumerate(names) if same(other)]
        if found:
            return _only(recording, role, found, f"{name!r} names")
    raise InputError(
        f"{recording.path}: {role}: there is no channel {name!r}; the file has {listed(names)}; correct "
        f"--channel {role}=..."
    )


def _matched(recording: Recording, role: str) -> int:
    """Return the channel whose name speaks of the role."""
    found = [k for k, name in enumerate(recording.names) if role_of(name) == role]
    if not found:
        raise InputError(
            f"{recording.path}: {role}: no channel has such a name; the file has {listed(recording.names)}; give "
            f"--channel {role}=NAME"
        )
    return _only(recording, role, found, "the names of")


def _only(recording: Recording, role: str, found: list[int], what: str) -> int:
    """Return the only channel found; raise InputError where there are several."""
    if len(found) > 1:
        raise InputError(
            f"{recording.path}: {role}: {what} {len(found)} channels fit: {listed(recording.names[k] for k in found)}; "
            f"give --channel {role}=NAME with a name that only one has"
        )
    return found[0]


def _shared(recording: Recording, found: Mapping[str, tuple[int, str]]) -> list[str]:
    """Return a sentence for every channel that two roles would take."""
    taken: dict[int, list[str]] = {}
    for role, (index, _) in found.items():
        taken.setdefault(index, []).append(role)
    return [
        f"{recording.path}: channel {recording.names[index]!r} is taken for {' and '.join(roles)}; give each its own"
        for index, roles in taken.items()
        if len(roles) > 1
    ]
