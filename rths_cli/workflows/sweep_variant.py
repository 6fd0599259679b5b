"""One run of a sweep: played with its seed, its errors taken, its series dropped."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from rths_cli.errors import RthsError, crash_note
from rths_cli.loop.blocks import NUMERICAL
from rths_cli.loop.drive import play
from rths_cli.loop.log import Log, empty_log
from rths_cli.metrics import room_for_pairs
from rths_cli.rigs.virtual.rig import VirtualRig
from rths_cli.workflows.lowest_frequency import lowest_reliable_hz
from rths_cli.workflows.provenance import model_sha256
from rths_cli.workflows.rigs import EXP_RTHS
from rths_cli.workflows.run import acceptance
from rths_cli.workflows.series import on_record_clock, whole_building
from rths_cli.workflows.sweep_rows import Column, Row, error_values, flat
from rths_cli.workflows.table_runs import Stop, true_accel, why_ended

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.lti import Array
    from rths_cli.workflows.series import Series
    from rths_cli.workflows.sweep_shared import Ready

_THREAD = threading.local()


def play_variant(ready: Ready, variant: int, seed: int, of: Sequence[Column], storeys: int) -> Row:
    """Return the row of one run of a grid point; its figures depend on the point and the seed alone.

    `storeys`: how many a row has room for. What fails is a row of status failed.
    """
    checked = ready.checked
    foretold: dict[str, ArrayLike] = dict(checked.figures)
    model = model_sha256(checked.design.model) if checked.design else ""
    row = Row(variant, "refused", ready.refused, 1, checked.verdict, model, flat(of, storeys, foretold))
    if ready.refused:
        return row
    try:
        stop, errors = _played(ready, seed, of, foretold)
    except Exception as error:
        return failed(row, error)
    figures = flat(of, storeys, foretold | errors)
    return replace(row, status=stop.status, reason=stop.reason, exit_code=stop.exit_code, figures=figures)


def failed(row: Row, error: Exception) -> Row:
    """Return the row of a run that an error ended."""
    if isinstance(error, RthsError):
        return replace(row, status="failed", reason=str(error), exit_code=error.exit_code)
    reason = f"internal error ({type(error).__name__}), {crash_note()}"
    return replace(row, status="failed", reason=reason, exit_code=5)


def _played(
    ready: Ready, seed: int, of: Sequence[Column], foretold: Mapping[str, ArrayLike]
) -> tuple[Stop, dict[str, Array]]:
    """Return how a run ended and, where it reached the end of the record, its errors by path."""
    setup, design = ready.setup, ready.checked.design
    assert design is not None and ready.drive is not None  # what is not refused is ready
    assert ready.plant is not None and ready.limits is not None
    rig = VirtualRig(setup.rig, ready.plant, (seed, EXP_RTHS))
    outcome = play(rig, setup.rig, design.blocks, NUMERICAL, ready.drive, ready.limits, _log(ready))
    stop = why_ended("EXP-RTHS", outcome, setup.rig.dt_s)
    if stop is not None:
        return stop, {}
    series = on_record_clock(outcome, design.blocks.lead_samples, setup.rig.dt_s, len(setup.motion.time_s))
    errors = _errors(ready, series)
    return _accepted(ready, of, {**foretold, **errors}), errors


def _errors(ready: Ready, series: Series) -> dict[str, Array]:
    """Return the errors of a run that reached the end of the record."""
    setup = ready.setup
    accel, dt = series.measured, setup.rig.dt_s
    if len(setup.building.numerical.masses_kg) > 1:  # else every storey is measured
        scheme = setup.case.integration
        accel = whole_building(setup.building, series, setup.motion.accel_m_s2, dt, scheme)[2]
    desired, true = series.desired[0], true_accel(accel, series)
    table = [(desired, series.measured[0]), (desired, series.true_accel[0])]
    sim = ready.sim_accel
    storeys, true_storeys = list(zip(sim, accel, strict=True)), list(zip(sim, true, strict=True))
    room, lowest_hz = _room(2 + 2 * len(sim), sim.shape[1], dt), lowest_reliable_hz(setup)
    return error_values(table, storeys, true_storeys, dt, room, lowest_hz)


def _room(pairs: int, samples: int, dt_s: float) -> Array:
    """Return this thread's memory for the errors of a run: the next run of the same size uses it again."""
    asked = (pairs, samples, dt_s)
    if getattr(_THREAD, "asked", None) != asked:
        _THREAD.asked, _THREAD.room = asked, room_for_pairs(*asked)
    room: Array = _THREAD.room
    return room


def _log(ready: Ready) -> Log:
    """Return this thread's log, lean where every storey is measured: the next run of the same size uses it again."""
    assert ready.drive is not None and ready.checked.design is not None
    channels, estimates = len(ready.setup.rig.channels), len(ready.checked.design.blocks.estimator.C)
    asked = (len(ready.drive), channels, estimates, len(ready.setup.building.numerical.masses_kg) == 1, channels)
    if getattr(_THREAD, "logged", None) != asked:
        _THREAD.logged, _THREAD.log = asked, empty_log(*asked)
    log: Log = _THREAD.log
    return log


def _accepted(ready: Ready, of: Sequence[Column], values: Mapping[str, ArrayLike]) -> Stop:
    """Return how a whole run ends, by the accept limits on figures that a sweep computes."""
    known = {column.path for column in of}
    limits = {path: limit for path, limit in ready.setup.case.accept.items() if path.partition("[")[0] in known}
    return acceptance(limits, {path: value for path, value in values.items() if path in known})
