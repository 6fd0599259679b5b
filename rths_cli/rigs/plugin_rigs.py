"""Rigs of other packages: load the factory of an entry point, check that its rig keeps to the interface.

An entry point of the group `rths.rigs` names a factory `make(info: RigInfo, options: Mapping[str, object]) -> Rig`;
the entry point's own name is the `kind` of the rig file, `options` is what stands under that key there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import Any, cast

import numpy as np

from rths_cli.case.plugin_interface import (
    GROUP,
    missing_name,
    not_loaded,
    old_version_sentence,
    plugin_kinds,
    stated_interface,
    tell_old_names,
    tell_once,
)
from rths_cli.case.storey_law_schema import StoreyLaws, checked_laws
from rths_cli.errors import InputError, RigError, RthsError
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import (
    MISSED_EDGES,
    OF_PLUGINS,
    SESSIONS,
    SPECIMEN,
    TRUTH,
    Commands,
    CountingRig,
    Rig,
    RigInfo,
    SessionRig,
    SpecimenRig,
    TruthfulRig,
)
from rths_cli.structure import Specimen

METHODS = ("open", "arm", "exchange", "rest", "close")
NEEDED = {MISSED_EDGES: "missed", TRUTH: "truth", SPECIMEN: "specimen", SESSIONS: "session"}  # what an offer needs
OF_SPECIMEN, LAWS = ("masses_kg", "stiffness_n_per_m", "damping_n_s_per_m"), "laws"
DRIVERS = ("hardware", "loopback", "fake")  # what may be behind a driver


def open_plugin(info: RigInfo, options: Mapping[str, object]) -> PluginRig:
    """Return the rig that the plug-in of this kind makes, held to the interface.

    Raises InputError when there is no such plug-in, when it cannot be imported or refuses its options; RigError when
    its factory fails or makes something that is no rig.
    """
    point = _entry_point(info.kind)
    who = f"rig {info.name}: plug-in {info.kind} ({point.value})"
    try:
        factory = point.load()
    except Exception as error:
        if moved := not_loaded(error):
            raise InputError(f"{who} was written for an older rths: {moved}; update its package") from error
        raise InputError(f"{who} cannot be loaded: {_told(error)}; repair or reinstall its package") from error
    tell_once(old_version_sentence(point, who, stated_interface(point, who)))
    if not callable(factory):
        raise InputError(f"{who} names no function that makes a rig; its package needs one in the group {GROUP}")
    try:
        rig = factory(info, dict(options))
    except InputError as error:
        raise InputError(*(f"{who}: {fault}" for fault in error.faults)) from error
    except RthsError:
        raise
    except Exception as error:
        raise RigError(f"{who} could not make its rig: {missing_name(error) or _told(error)}") from error
    return PluginRig(_checked(rig, info, who), info.kind, who)


class PluginRig:
    """The rig of a plug-in: whatever goes wrong in it comes out as one sentence, and samples have their shape."""

    def __init__(self, rig: Rig, kind: str, who: str) -> None:
        self.info = rig.info
        self._rig = rig
        self._kind = kind
        self._who = who
        self._samples = np.zeros(len(rig.info.all_channels))
        self.offers = _offers(rig, who)

    def open(self) -> None:
        """Take hold of the rig, which may learn by that what is behind its driver; raises RigError."""
        self._call("open", self._rig.open)
        own = _checked(self._rig, self.info, self._who).info
        if set(_offers(self._rig, self._who)) != set(self.offers):
            raise RigError(f"{self._who} offers something else once it is open; state offers before make returns")
        self.info = replace(own, driver_verified=own.driver_verified or "hardware")

    def arm(self) -> Array:
        """Enable motion and return the first samples in V, (n_channels,); raises RigError."""
        return self._kept("arm", self._call("arm", self._rig.arm))

    def exchange(self, command_v: Commands) -> Array:
        """Send the commands, return the samples of the next instant in V, (n_channels,); raises RigError."""
        return self._kept("exchange", self._call("exchange", self._rig.exchange, command_v))

    def rest(self) -> None:
        """Bring the table to rest and disable motion; raises RigError."""
        self._call("rest", self._rig.rest)

    def close(self) -> None:
        """Let go of the rig; raises RigError."""
        self._call("close", self._rig.close)
        tell_old_names(self._who)

    @property
    def missed(self) -> int:
        """Return how many edges of the rig's own clock passed unseen."""
        return int(cast("CountingRig", self._rig).missed)

    def session(self, name: str) -> None:
        """Tell the rig what its next session is for; raises RigError."""
        self._call("session", cast("SessionRig", self._rig).session, name)

    def truth(self) -> tuple[Array, float]:
        """Return true velocities (1 + n_floors,) in m/s and the table's displacement in m; raises RigError."""
        told = self._call("truth", cast("TruthfulRig", self._rig).truth)
        try:
            velocity, place = np.asarray(told[0], dtype=float), float(told[1])
        except (TypeError, ValueError, IndexError) as error:
            raise self._fault("truth", "must return velocities in m/s and a displacement in m") from error
        if velocity.shape != (len(self.info.channels),):
            wanted = f"{len(self.info.channels)} velocities, of table and floors"
            raise self._fault("truth", f"must return {wanted}, got {velocity.size}")
        return velocity, place

    def specimen(self) -> tuple[Specimen, StoreyLaws]:
        """Return the specimen as it is and the laws of its storeys; raises RigError."""
        told = self._call("specimen", cast("SpecimenRig", self._rig).specimen)
        unknown = sorted(set(told) - {*OF_SPECIMEN, LAWS}) if isinstance(told, Mapping) else ["no mapping"]
        if unknown or not all(key in told for key in OF_SPECIMEN):
            wanted = f"a mapping of {', '.join(OF_SPECIMEN)} and, where there are any, {LAWS}"
            raise self._fault("specimen", f"must return {wanted}")
        floors = len(self.info.channels) - 1
        shapes = ((floors,), (floors, floors), (floors, floors))
        masses, stiffness, damping = (
            self._array(told[key], key, shape) for key, shape in zip(OF_SPECIMEN, shapes, strict=True)
        )
        if not (masses > 0.0).all():
            raise self._fault("specimen", f"must return masses_kg > 0, got {masses.tolist()}")
        try:
            laws = checked_laws(told.get(LAWS) or ())
        except InputError as error:
            raise self._fault("specimen", f"returned {LAWS}.{error.faults[0]}") from error
        return Specimen(masses, stiffness, damping), laws

    def _array(self, value: Any, key: str, shape: tuple[int, ...]) -> Array:
        try:
            given = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != shape or not np.isfinite(given).all():
            raise self._fault("specimen", f"must return finite {key} of shape {shape}, got shape {given.shape}")
        return given

    def _call(self, what: str, method: Callable[..., Any], *values: Commands | str) -> Any:
        try:
            return method(*values)
        except RthsError:
            raise
        except Exception as error:
            raise self._fault(what, missing_name(error) or f"failed: {_told(error)}") from error

    def _kept(self, what: str, samples: Any) -> Array:
        try:
            given = np.asarray(samples, dtype=float)
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != self._samples.shape:
            wanted = f"{self._samples.size} samples in V, one per channel"
            raise self._fault(what, f"must return {wanted}, got {type(samples).__name__} of shape {given.shape}")
        self._samples[:] = given
        return self._samples

    def _fault(self, what: str, fault: str) -> RigError:
        return RigError(f"rig {self.info.name}: {what} of plug-in {self._kind} {fault}")


def _entry_point(kind: str) -> EntryPoint:
    found = plugin_kinds().get(kind, ())
    if len(found) != 1:
        raise InputError(f"kind: {len(found)} installed packages bring rigs of kind {kind!r}, it must be one")
    return found[0]


def _checked(rig: Any, info: RigInfo, who: str) -> Rig:
    """Return a plug-in's rig; raises RigError when it lacks a method, or describes itself otherwise than its file."""
    lacking = [name for name in METHODS if not callable(getattr(rig, name, None))]
    if lacking:
        raise RigError(f"{who} made a {type(rig).__name__} without {', '.join(lacking)}; that is no rig")
    offers = _offers(rig, who)
    without = [what for one, what in NEEDED.items() if one in offers and not hasattr(rig, what)]
    if without:
        raise RigError(f"{who} made a {type(rig).__name__} without {without[0]}, which it offers")
    own = getattr(rig, "info", None)
    if not isinstance(own, RigInfo) or replace(own, driver_verified=info.driver_verified) != info:
        raise RigError(f"{who} must keep the info it was given; only driver_verified is its own to state")
    if own.driver_verified not in ("", *DRIVERS):
        raise RigError(f"{who} states driver_verified {str(own.driver_verified)[:40]!r}; known: {', '.join(DRIVERS)}")
    made: Rig = rig
    return made


def _offers(rig: Any, who: str) -> tuple[str, ...]:
    """Return what a rig offers, by its class or by itself; raises RigError for anything else than known names."""
    stated = getattr(rig, "offers", ())
    if isinstance(stated, str) or not isinstance(stated, Collection):
        raise RigError(f"{who} states offers {str(stated)[:40]!r}; it must be a tuple of {', '.join(OF_PLUGINS)}")
    unknown = [one for one in stated if one not in OF_PLUGINS]
    if unknown:
        raise RigError(f"{who} offers {str(unknown[0])[:40]!r}; a package's rig may offer {', '.join(OF_PLUGINS)}")
    return tuple(stated)


def _told(error: Exception) -> str:
    """Return an exception as part of a sentence, on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:300] if text else type(error).__name__
