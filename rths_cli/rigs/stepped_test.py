"""A test that a rig's own computer steps: what it must hold, and what it tells while it runs."""

from __future__ import annotations

from dataclasses import dataclass

from rths_cli.numerics.lti import Array


@dataclass(frozen=True)
class Designed:
    """What a target must hold: first 48 bits of the checksums of case and model, width of its log."""

    case_number: float
    model_number: float
    columns: int


@dataclass(frozen=True)
class Answer:
    """A frame of the target: where its test stands, and rows (m, w) of its log from `first` on."""

    session: int
    first: int
    held: int  # rows of the record that it has, from the first one on
    state: int
    faults: int
    time_s: float
    command_v: float
    case_number: float
    model_number: float
    dt_s: float
    columns: int
    made: int  # rows of its log, of which it may keep the newest only
    reason: int
    channel: int
    seen: float
    rows: Array
