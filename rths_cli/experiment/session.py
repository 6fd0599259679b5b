"""The session of a case's table runs: the identification's record at low level, played again before them, shows what
sensors and converters have changed by since."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.experiment.model_files import key
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import NO_LINES

if TYPE_CHECKING:
    from rths_cli.identification.record_parts import Record
    from rths_cli.identification.results import Identification, SessionChange

TOLD = 3.0  # standard uncertainties of the drift from which a change of a sensor is told
MOST_RATIO = 0.03  # of two sensors' gains: no drift of a sensor that is sound and well mounted
MOST_LAG = 1.0  # sample intervals
MOST_ALIAS = 3.0  # times as much as any instant of sampling makes it


def wants_session_record(setup: Setup) -> bool:
    """Return whether a case's table runs begin with the record at low level."""
    asked = setup.case.session_record
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
) -> tuple[Identification, tuple[str, ...]]:
    """Return an identification as it stands in a session, and sentences on what has changed; as it is where the
    records differ by more than sensors and a slightly changed specimen explain, or by what is no drift."""
    if isinstance(change, str):
        return known, not_compared(change)
    if not change.believed:
        return known, (
            "record of this session: table and floors move otherwise than at the identification, "
            f"{change.unexplained:.3g} times as much as noise is left unexplained; the drift of sensors is not "
            "corrected, identify again",
        )
    if refused := no_drift(setup, known, change):
        return known, refused
    from rths_cli.identification.sensor_calibration import as_stated, priors_of
    from rths_cli.identification.session_record import in_session

    if known.calibration is None and setup.rig.calibrates:  # identified as certain: only the priors are known
        known = replace(known, calibration=as_stated(priors_of(setup.rig, setup.removes_sensors, known.best)))
    return in_session(known, change), tuple(_sentences(setup, change))


def not_compared(reason: str = NO_LINES) -> tuple[str, ...]:
    """Return the sentence that tells why a session's record is not compared with that of the identification."""
    return (f"record of this session: not compared with that of the identification, {reason}; drift is not corrected",)


def no_drift(setup: Setup, known: Identification, change: SessionChange) -> tuple[str, ...]:
    """Return sentences on what has changed by more than sound sensors and converters do; then nothing is taken up."""
    dt_s, floors, told = setup.rig.dt_s, setup.rig.channels[1:], list[str]()
    for floor, ratio, late_s in zip(floors, change.ratio, change.late_s[1:], strict=False):
        if abs(ratio) > MOST_RATIO:
            told.append(
                f"record of this session: gain of {floor.name} against the table's sensor changed by "
                f"{100.0 * ratio:+.2g} %, which is no drift: look at sensor and mount, identify again"
            )
        if abs(late_s) > MOST_LAG * dt_s:
            told.append(
                f"record of this session: lag of {floor.name} after the table's channel changed by {1e6 * late_s:+.0f} "
                "us, more than a sample interval: look at filters and converters, identify again"
            )
    from rths_cli.identification.sensor_calibration import ripple_prior

    if abs(change.ripple_m_s2_per_v) > MOST_ALIAS * ripple_prior(known.best, dt_s):
        told.append(
            f"record of this session: the alias of the held command changed by {change.ripple_m_s2_per_v:+.2g} m/s^2 "
            "per V, more than any instant of sampling explains: look at the converters, identify again"
        )
    return tuple(told)


def _sentences(setup: Setup, change: SessionChange) -> list[str]:
    """Return a sentence for each change that is more than the rig declares."""
    floors, told = setup.rig.channels[1:], []
    allowed = TOLD * np.sqrt(2.0) * setup.rig.uncertainty.drift
    for floor, ratio, error in zip(floors, change.ratio, change.ratio_error, strict=True):
        if abs(ratio) > allowed + TOLD * error:
            told.append(
                f"record of this session: {floor.name} reads {100.0 * ratio:+.3f} +- {100.0 * error:.3f} % against the "
                "table's sensor since the identification, more than uncertainty.drift allows; it is corrected"
            )
    for floor, late_s, error_s in zip(floors, change.late_s[1:], change.late_error_s, strict=True):
        if abs(late_s) > TOLD * error_s > 0.0:
            told.append(
                f"record of this session: {floor.name} lags by {1e6 * late_s:+.1f} +- {1e6 * error_s:.1f} us against "
                "the table's channel since the identification; it is corrected"
            )
    if abs(change.ripple_m_s2_per_v) > TOLD * change.ripple_error_m_s2_per_v > 0.0:
        told.append(
            "record of this session: converters act at other instants than at the identification, the alias of the "
            f"held command has changed by {change.ripple_m_s2_per_v:+.3g} +- {change.ripple_error_m_s2_per_v:.2g} "
            "m/s^2 per V; it is corrected"
        )
    if change.delay_s != 0.0:
        told.append(
            f"record of this session: the table moves {1e6 * change.delay_s:+.0f} +- {1e6 * change.delay_error_s:.1f} "
            "us later after its command than at the identification; the feedback counters it, the check counts what "
            "is left; identify again to have it in the feedforward"
        )
    return told


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
