"""Declarations of the axes of datasets and metrics."""

from __future__ import annotations

from rths_cli.quantities.declaration import Axis

AXES: dict[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("time_s", "s", "time since the start of the record"),
        Axis("rest_time_s", "s", "time since the start of the record, the rest before it and after it"),
        Axis("frequency_hz", "Hz", "frequency"),
        Axis("storey", "1", "storey, counted from 1 at the ground", counted=True),
        Axis("floor", "1", "experimental storey, counted as in the building; in a model file from 1 at the table"),
        Axis(
            "channel",
            "1",
            "channel: 1 the table, then the experimental floors from the lowest, then further channels",
            counted=True,
        ),
        Axis("further_channel", "1", "channel beside the accelerometers, counted from 1", counted=True),
        Axis("tangent", "1", "verdict of the check: 1 at rest, then the tangents of laws", counted=True),
        Axis("mode", "1", "mode, counted from 1", counted=True),
        Axis("frequency", "1", "frequency of the latency budget, counted from 1", counted=True),
        Axis("zero", "1", "zero, counted from 1", counted=True),
        Axis("pole", "1", "pole, counted from 1", counted=True),
        Axis("of_floor", "1", "floor that a force or motion is of, counted from 1", counted=True),
        Axis("joint", "1", "joint of a storey, counted from 1", counted=True),
        Axis("bend", "1", "change of a storey's stiffness, counted from 1", counted=True),
        Axis("parameter", "1", "parameter of a covariance, counted from 1", counted=True),
        Axis("of_parameter", "1", "the other parameter of a covariance, counted from 1", counted=True),
        Axis("row", "1", "row of a table, counted from 1", counted=True),
        Axis("band_hz_entry", "1", "end of the band: 1 lower, 2 upper", counted=True),
        Axis("feedforward_hz_entry", "1", "end of the band: 1 lower, 2 upper", counted=True),
        Axis("reasons_entry", "1", "reason, counted from 1", counted=True),
        Axis("warnings_entry", "1", "warning, counted from 1", counted=True),
        Axis("table_entry", "1", "cause, counted from 1", counted=True),
        Axis("storeys_entry", "1", "entry, counted from 1", counted=True),
        Axis("variant", "1", "run of the sweep, counted from 1", counted=True),
        Axis("state", "1", "state of a block, counted from 1", counted=True),
        Axis("next_state", "1", "state of a block a step later, counted from 1", counted=True),
        Axis("value", "1", "value that a part of the step logs, counted from 1", counted=True),
        Axis("input", "1", "input of a block, counted from 1", counted=True),
        Axis("output", "1", "output of a block, counted from 1", counted=True),
    )
}
"""Every axis by its name. Scales are computed, none is measured."""
RISING = ("time_s", "rest_time_s", "frequency_hz")
"""Axes along which values rise."""
SAMPLED = ("time_s", "rest_time_s")
"""Axes of samples: a run that was stopped holds fewer, and a sample that is not known is NaN."""
