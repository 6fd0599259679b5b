"""The session of a case's table runs: the identification's record at low level, played again before them, shows what
sensors and converters have changed by since."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.experiment.model_files import key
from rths_cli.experiment.setup import Setup
from rths_cli.findings import Finding
from rths_cli.identification.results import NO_LINES

if TYPE_CHECKING:
    from rths_cli.identification.record_parts import Record
    from rths_cli.identification.results import Identification, SessionChange

TOLD = 3.0  # standard uncertainties of the drift from which a change of a sensor is told
MOST_RATIO = 0.03  # of two sensors' gains: no drift of a sensor that is sound and well mounted
MOST_LAG = 1.0  # sample intervals
MOST_ALIAS = 3.0  # times as much as any instant of sampling makes it


def wants_session_record(setup: Setup) -> bool:
    """Return whether a case's table runs begin with the record at low level; a rig that steps itself plays none."""
    asked = setup.case.session_record
    if setup.rig.interface == "displacement" or setup.rig.can.steps_itself:
        return False
    return asked == "always" or (asked == "automatic" and setup.rig.calibrates)


def session_key(setup: Setup) -> str:
    """Return a hash of everything that the record of a session on a virtual rig depends on; on a real rig all cases
    with one model are in one session."""
    if setup.rig.can.moves_hardware:
        return key(setup)
    return f"{key(setup)} {setup.session} {setup.case.table.model_dump_json(include={'after_identification'})}"


def change_shown(setup: Setup, known: Identification, record: Record) -> SessionChange | str:
    """Return what a session's record shows, a reason where it cannot be compared with that of the identification."""
    from rths_cli.identification.session_record import session_change

    setup = setup.calibrated(known)
    return session_change(known, record, setup.rig, setup.rig.uncertainty.drift)


def with_session(
    setup: Setup, known: Identification, change: SessionChange | str
) -> tuple[Identification, tuple[Finding, ...]]:
    """Return an identification as it stands in a session, and findings on what has changed; as it is where the
    records differ by more than sensors and a slightly changed specimen explain, or by what is no drift."""
    if isinstance(change, str):
        return known, not_compared(change)
    if not change.believed:
        return known, (Finding("session.unexplained", {"ratio": change.unexplained}),)
    if refused := no_drift(setup, known, change):
        return known, refused
    from rths_cli.identification.sensor_calibration import as_stated, priors_of
    from rths_cli.identification.session_record import in_session

    if known.calibration is None and setup.rig.calibrates:  # identified as certain: only the priors are known
        known = replace(known, calibration=as_stated(priors_of(setup.rig, setup.removes_sensors, known.best)))
    return in_session(known, change), tuple(_changes(setup, change))


def not_compared(reason: str = NO_LINES) -> tuple[Finding, ...]:
    """Return why a session's record is not compared with that of the identification."""
    return (Finding("session.not_compared", {"reason": reason}),)


def no_drift(setup: Setup, known: Identification, change: SessionChange) -> tuple[Finding, ...]:
    """Return what has changed by more than sound sensors and converters do; then nothing is taken up."""
    from rths_cli.identification.sensor_calibration import ripple_prior

    dt_s, floors, found = setup.rig.dt_s, setup.rig.channels[1:], list[Finding]()
    for floor, ratio, late_s in zip(floors, change.ratio, change.late_s[1:], strict=False):
        if abs(ratio) > MOST_RATIO:
            found.append(Finding("session.no_gain_drift", {"channel": floor.name, "change": ratio}))
        if abs(late_s) > MOST_LAG * dt_s:
            found.append(Finding("session.no_lag_drift", {"channel": floor.name, "late_s": late_s}))
    ripple = change.ripple_m_s2_per_v
    if abs(ripple) > MOST_ALIAS * ripple_prior(known.best, dt_s):
        found.append(Finding("session.no_alias_drift", {"change_m_s2_per_v": ripple}))
    return tuple(found)


def _changes(setup: Setup, change: SessionChange) -> list[Finding]:
    """Return a finding for each change that is more than the rig declares."""
    floors, found = setup.rig.channels[1:], []
    allowed = TOLD * np.sqrt(2.0) * setup.rig.uncertainty.drift
    for floor, ratio, error in zip(floors, change.ratio, change.ratio_error, strict=True):
        if abs(ratio) > allowed + TOLD * error:
            values = {"channel": floor.name, "change": ratio, "error": error}
            found.append(Finding("session.gain", values))
    for floor, late_s, error_s in zip(floors, change.late_s[1:], change.late_error_s, strict=True):
        if abs(late_s) > TOLD * error_s > 0.0:
            found.append(Finding("session.lag", {"channel": floor.name, "late_s": late_s, "error_s": error_s}))
    ripple, error = change.ripple_m_s2_per_v, change.ripple_error_m_s2_per_v
    if abs(ripple) > TOLD * error > 0.0:
        found.append(Finding("session.alias", {"change_m_s2_per_v": ripple, "error_m_s2_per_v": error}))
    if change.delay_s != 0.0:
        found.append(Finding("session.delay", {"late_s": change.delay_s, "error_s": change.delay_error_s}))
    return found


def as_stored(change: SessionChange) -> dict[str, np.ndarray | float]:
    """Return the datasets of a session by name."""
    c = len(change.gain)
    errors = np.sqrt(np.diag(change.covariance))
    return {
        "gain_change": change.gain,
        "gain_change_error": errors[:c],
        "gain_over_table_change": np.concatenate([[0.0], change.ratio]),
        "gain_over_table_change_error": np.concatenate([[0.0], change.ratio_error]),
        "late_change_s": change.late_s,
        "late_change_error_s": errors[c : 2 * c],
        "ripple_change_m_s2_per_v": change.ripple_m_s2_per_v,
        "ripple_change_error_m_s2_per_v": change.ripple_error_m_s2_per_v,
        "delay_change_s": change.delay_s,
        "delay_change_error_s": change.delay_error_s,
        "unexplained": change.unexplained,
    }
