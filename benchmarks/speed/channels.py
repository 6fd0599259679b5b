"""A step with five channels beside the accelerometers over that with accelerometers alone."""

from __future__ import annotations

import statistics

from campaigns import step_run

from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from speed.rows import RATIO, Row, alternating_s, seconds_of

PAIRS, DEMAND = 25, 1.3
CHANNELS = """[
  {kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95, use: guard},
  {kind: force, position: table, unit: N, sensitivity_v_per_unit: 0.02, range: 450, use: [guard, shear],
   plate_mass_kg: 1.5},
  {kind: strain, position: storey_3, unit: um/m, sensitivity_v_per_unit: 0.001, range: 9000},
  {kind: acceleration, position: floor_3, unit: m/s^2, sensitivity_v_per_unit: 0.1, range: 50},
  {kind: displacement, position: floor_2, unit: mm, sensitivity_v_per_unit: 0.1, range: 95}]"""
USES = {"shear_from=both": "a cell for the base shear, too", "shear_from=accelerations": "the cell watched and stored"}


def channels_rows(three: step_run.Inputs) -> list[Row]:
    """Compare, by turns, steps with eight channels and with three; simulating and storing them is part of both."""
    rows = []
    for setting, what in USES.items():
        table = f"table={{extends: aps400_virtual, channels: {CHANNELS}}}"
        eight = step_run.inputs(*step_run.prepared(Memory(Cache()), settings=(table, setting)))
        for one in (three, eight):
            if step_run.bound(one, step_run.fresh(one))() != len(one.drive):
                raise RuntimeError("channels: the run stopped before its end")
        more, less = alternating_s(
            lambda one=eight: seconds_of(one, step_run.bound),  # type: ignore[misc]
            lambda: seconds_of(three, step_run.bound),
            PAIRS,
        )
        steps, ratio = len(three.drive), statistics.median(one / two for one, two in zip(more, less, strict=True))
        behind = f"{what}; shortest {1e9 * min(more) / steps:.0f} against {1e9 * min(less) / steps:.0f} ns"
        rows.append(Row(f"a step with 8 channels / 3, median of {PAIRS} pairs", ratio, RATIO, DEMAND, behind))
        rows.append(Row("a step with 8 channels / 3, shortest of each", min(more) / min(less), RATIO, DEMAND, what))
    return rows
