"""Which identified model a run uses: a named model file, the cache of virtual rigs, or an identification now."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any

from rths_cli.errors import InputError
from rths_cli.experiment.model_files import Cache, Stored, key, load
from rths_cli.experiment.setup import Progress, Setup, shown
from rths_cli.findings import Finding, stated
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Model

if TYPE_CHECKING:
    from rths_cli.files.foreign_models import ForeignModel
    from rths_cli.identification.results import SessionChange

NOW, AT_REST = "identified in this run", "identified just now (simulated, no hardware)"


@dataclass(frozen=True)
class IdentifiedModel:
    """An identification and its source."""

    found: Identification
    source: str  # in words
    reasons: tuple[Finding, ...] = ()  # why a model that was accepted earlier must not be used now

    def faults(self, overrides: tuple[str, ...]) -> tuple[Finding, ...]:
        """Return why the model must not drive a table; () if it may, or if --override model was given."""
        reasons = (*(() if self.found.accepted else self.found.verdict.refusals), *self.reasons)
        if not reasons or "model" in overrides:
            return ()
        return (Finding("model.rejected", {"reasons": reasons}, ("improve_or_override",)),)


class Memory:
    """Identifications of this process: cases on the same rig and specimen share one.

    With a `cache`, models of virtual rigs outlive the process; `known` holds models that are there already, by the
    `key` of their setup. Threads identify one after another.
    """

    def __init__(self, cache: Cache | None = None, known: Mapping[str, IdentifiedModel] | None = None) -> None:
        self._cache = cache
        self._plans: dict[str, Any] = {}
        self._files: dict[str, Stored | ForeignModel] = {}
        self._known: dict[str, IdentifiedModel] = dict(known or {})
        self._sessions: dict[str, SessionChange | str] = {}
        self._lock = RLock()

    def prepare(self, setup: Setup) -> None:
        """Read the model file that a case names and those of samples, and plan the excitation of its rig.

        Raises InputError if a file is no model of this rig and specimen, or if the excitation is impossible.
        """
        if not callable(setup.samples):
            for sample in setup.samples:
                _sample(sample, setup)
        path = setup.case.identification.model
        if setup.rig.can.moves_hardware:
            _check_real(setup, path)
        if path is not None or not self._kept(setup):
            self.plan(setup)
        if path is not None and key(setup) not in self._files:
            from rths_cli.files.foreign_models import is_foreign, read_foreign

            self._files[key(setup)] = read_foreign(path) if is_foreign(path) else load(path, setup)

    def _kept(self, setup: Setup) -> bool:
        """Return whether the cache has a model for the setup; then its excitation has been planned before."""
        return self._cache is not None and not setup.rig.can.moves_hardware and self._cache.has(setup)

    def plan(self, setup: Setup) -> Any:
        """Return the excitation of the setup's rig; raises InputError when its settings cannot be met."""
        if key(setup) not in self._plans:
            from rths_cli.experiment.actuator import is_of_actuator, planned_excitation
            from rths_cli.experiment.excitation_plan import plan

            self._plans[key(setup)] = planned_excitation(setup) if is_of_actuator(setup) else plan(setup)
        return self._plans[key(setup)]

    def identify(self, setup: Setup, progress: Progress) -> Identification:
        """Return the identification of the setup's rig and specimen, as it was found."""
        return with_samples(setup, self._nominal(setup, progress)).found

    def known(self, setup: Setup, progress: Progress) -> IdentifiedModel:
        """Return the identification of the setup's rig and specimen as it stands in the session of the case's table
        runs, with its source and whether it is still valid."""
        return with_samples(setup, self._in_session(setup, self._nominal(setup, progress), progress))

    def _in_session(self, setup: Setup, known: IdentifiedModel, progress: Progress) -> IdentifiedModel:
        """Return an identification with what its record at low level shows in the session of the case's table runs.

        The record that verified a model file is that of the session.
        """
        from rths_cli.experiment.session import wants_session_record

        if not wants_session_record(setup) or known.reasons:
            return known
        from rths_cli.experiment.identify_on_rig import noted
        from rths_cli.experiment.model_verification import low_level_record
        from rths_cli.experiment.session import change_shown, not_compared, session_key, with_session

        if known.found.low_level_lines is None:
            asked = setup.case.session_record == "always" or known.found.specimen is not None
            return replace(known, found=noted(known.found, not_compared())) if asked else known
        name = session_key(setup)
        with self._lock:
            if name not in self._sessions:
                record = low_level_record(setup, known.found, progress)
                self._sessions[name] = change_shown(setup, known.found, record)
        found, changes = with_session(setup, known.found, self._sessions[name])
        return replace(known, found=noted(found, changes))

    def _nominal(self, setup: Setup, progress: Progress) -> IdentifiedModel:
        """Return the identification of the setup's rig and specimen without the caller's samples."""
        name = key(setup)
        with self._lock:
            if name not in self._known:
                self.prepare(setup)
                file = self._files.get(name)
                self._known[name] = self._from_file(setup, file, progress) if file else self._now(setup, progress)
            return self._known[name]

    def at_rest(self, setup: Setup, progress: Progress) -> IdentifiedModel:
        """Return the identification without moving a real table.

        A model file made by rths is used as it is, without the record that verifies it. A virtual rig is identified if
        necessary. Raises InputError as `prepare` does.
        """
        self.prepare(setup)
        file = self._files.get(key(setup))
        if isinstance(file, Stored):
            known = IdentifiedModel(file.found, f"{_named(file)}; a run verifies it by a short record first")
        else:
            known = self._in_session(setup, self._nominal(setup, progress), progress)
            known = replace(known, source=AT_REST) if known.source == NOW else known
        return with_samples(setup, known)

    def _from_file(self, setup: Setup, file: Stored | ForeignModel, progress: Progress) -> IdentifiedModel:
        """Return a named model: one of ours verified by a short record, one from elsewhere judged by a full one."""
        from rths_cli.experiment.identify_on_rig import evaluated, measure, noted
        from rths_cli.experiment.model_verification import compared, low_level_record, read_with
        from rths_cli.experiment.session import change_shown, no_drift, session_key, wants_session_record, with_session

        if setup.rig.can.steps_itself and isinstance(file, Stored):
            return IdentifiedModel(file.found, f"{_named(file)}; its rig takes no command of an excitation")
        if setup.rig.interface == "displacement":
            if not isinstance(file, Stored):
                raise InputError(
                    f"identification.model: {shown(file.path)} is of another program, and models of an actuator are "
                    "taken from rths identify only; remove the key, or identify the actuator"
                )
            return IdentifiedModel(file.found, f"{_named(file)}; not verified by a record before the test")
        if not isinstance(file, Stored):
            measured = measure(setup, progress, self.plan(setup))
            found = evaluated(setup, measured, as_model(file, setup))
            where = f"zeros, poles and gain of {shown(file.path)}, judged by a record made now"
            return IdentifiedModel(noted(found, notes_on(file)), where)
        record, there, refused = low_level_record(setup, file.found, progress), file.found, tuple[Finding, ...]()
        if wants_session_record(setup):
            change = self._sessions[session_key(setup)] = change_shown(setup, file.found, record)
            there = with_session(setup, file.found, change)[0]
            record = read_with(setup, file.found, there, record)
            refused = () if isinstance(change, str) or not change.believed else no_drift(setup, file.found, change)
        changes, agrees = compared(setup, there, record)
        changes = (*changes, *refused)
        where = _named(file)
        reasons = (Finding("verification.changed", {"model": where, "reasons": changes}),) if changes else ()
        verified = Finding("verification.verified", {"model": where, "comparison": agrees})
        return IdentifiedModel(noted(file.found, reasons or (verified,)), where, reasons)

    def _now(self, setup: Setup, progress: Progress) -> IdentifiedModel:
        """Return the model from the cache, or identify the rig now."""
        stored = self._cache.find(setup) if self._cache and not setup.rig.can.moves_hardware else None
        if stored is not None:
            return IdentifiedModel(stored.found, f"cache, identified {stored.age}")
        from rths_cli.experiment import actuator
        from rths_cli.experiment.identify_on_rig import evaluated, measure

        if actuator.is_of_actuator(setup):
            found, played, samples = actuator.identify(setup, progress)
            sha256 = actuator.data_sha256(played, samples)
        else:
            measured = measure(setup, progress, self.plan(setup))
            found, sha256 = evaluated(setup, measured), measured.sha256
        if self._cache and not setup.rig.can.moves_hardware:
            self._cache.keep(setup, found, sha256)
        return IdentifiedModel(found, NOW)


def _made(given: object) -> tuple[Identification, ...]:
    """Return what a function of the caller made as samples; raises InputError for what is no list."""
    if not isinstance(given, Sequence):
        raise InputError(f"samples: the function must return a list of identifications, got {type(given).__name__}")
    return tuple(given)


def with_samples(setup: Setup, known: IdentifiedModel) -> IdentifiedModel:
    """Return an identification with the samples that the caller gives; the source tells how many.

    Raises InputError for a file that is no accepted model of this rig and specimen, and for what is no sample.
    """
    given = setup.samples
    samples = _made(given(known.found)) if callable(given) else tuple(_sample(path, setup) for path in given)
    if not samples:
        return known
    if known.found.session is not None:
        samples = tuple(_in_the_same_session(one, known.found.session) for one in samples)
    try:
        found = replace(known.found, samples=samples)
    except ValueError as error:
        raise InputError(f"samples: {error}") from error
    count = f"{len(samples)} sample{'s' if len(samples) > 1 else ''}"
    return replace(known, found=found, source=f"{known.source}; with {count} of it")


def _in_the_same_session(sample: Any, change: SessionChange) -> Any:
    """Return a sample as it stands in a session; what is no sample is refused later."""
    from rths_cli.identification.session_record import in_session

    if not isinstance(sample, Identification) or sample.session is not None:
        return sample
    return in_session(sample, change)


def _sample(path: Path, setup: Setup) -> Identification:
    """Return a sample from its model file; raises InputError if it is rejected and that is not overridden."""
    found = load(path, setup).found
    if not found.accepted and "model" not in setup.overrides:
        raise InputError(f"samples: {shown(path)} was rejected: {'; '.join(found.reasons)}; leave it out")
    return found


def _named(file: Stored) -> str:
    return f"model {shown(file.path)}, identified {file.age}"


def _check_real(setup: Setup, path: Path | None) -> None:
    """Raise InputError unless a case on a real rig names a model file made by rths; a run never excites such a rig."""
    from rths_cli.files.foreign_models import is_foreign

    advice = f"rths identify {shown(setup.case.path)}"
    if path is None:
        raise InputError(
            f"{shown(setup.case.path)}: identification.model: is missing; a real rig is identified before it is used: "
            f"{advice} writes a model file, which identification.model then names"
        )
    if is_foreign(path):
        raise InputError(f"identification.model: {shown(path)} has not been judged; run {advice} --model {shown(path)}")


def as_model(given: ForeignModel, setup: Setup) -> Model:
    """Return a model identified elsewhere as a model of this rig; a ripple that is not stated is NaN."""
    ripple = math.nan if given.ripple_m_s2_per_v is None else given.ripple_m_s2_per_v
    band = given.band_hz or (setup.case.identification.low_hz, setup.case.identification.high_hz)
    sampling = (setup.rig.latency_samples, setup.rig.dt_s)
    coupling_hz = setup.rig.channels[0].high_pass_hz if setup.removes_sensors else 0.0
    return Model(given.zeros, given.poles, given.gain, given.delay_s, band, ripple, *sampling, coupling_hz)


def notes_on(given: ForeignModel) -> tuple[Finding, ...]:
    """Return notes on a model identified elsewhere, also if it lacks the equal orders that method paper needs."""
    zeros, poles = len(given.zeros), len(given.poles)
    of_file = tuple(stated(note, "notes") for note in given.notes)
    if zeros == poles:
        return of_file
    return (*of_file, Finding("model.unequal_orders", {"file": shown(given.path), "zeros": zeros, "poles": poles}))
