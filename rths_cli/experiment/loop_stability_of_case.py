"""Evaluate the stability of one case's loop (identified rig, building, blocks) by analysis/stability_check.py."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.identified_rig_block import identified_rig, with_another_specimen
from rths_cli.control.continued_table import ContinuedTable, continued_table
from rths_cli.control.feedback import none
from rths_cli.control.interface import Interface, force_of_one
from rths_cli.control.numerical_substructure import INPUTS, INTERFACE, all_storeys
from rths_cli.control.reaction import compliance
from rths_cli.control.state_space import static
from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification, LevelBand
    from rths_cli.numerics.bands import ComparedBand
    from rths_cli.numerics.lti import Block
    from rths_cli.structure import Specimen


def loop_parts(
    setup: Setup, identified: Identification, there: Specimen | None = None, counters_reaction: bool = False
) -> tuple[IdentifiedRig, Block]:
    """Return the parts of a case's loop that are not designed: the identified rig, and all numerical storeys.

    `there`: the specimen that stands on the table instead of the identified one. If the feedforward `counters_reaction`
    the table moves as the other reaction makes it; otherwise its response stays as identified.
    """
    assert identified.specimen is not None  # every case has experimental storeys
    setup = setup.calibrated(identified)
    specimen, model, compared = identified.specimen.specimen, identified.best, setup.compared
    judged = specimen if there is None or counters_reaction else there
    rig = identified_rig(model, judged, setup.rig, setup.removes_sensors, compared)
    if there is not None and judged is specimen:
        table = compliance(model, specimen)
        rig = with_another_specimen(rig, model, specimen, there, table, setup.rig, setup.removes_sensors)
    return rig, all_storeys(setup.building.numerical, setup.rig.dt_s, setup.case.integration)


def continued_of(setup: Setup, identified: Identification, there: Specimen | None = None) -> ContinuedTable:
    """Return the identified table of a case continued beyond its band by masses, specimen and drive.

    `there`: the specimen that stands on it instead of the identified one.
    """
    fit, model, measured = identified.specimen, identified.best, identified.frfs[0]
    assert fit is not None  # every case has experimental storeys
    end_hz = max(min(model.band_hz[1], float(measured.frequency_hz[-1])), setup.compared.high_hz)
    of_modes = float(np.max(fit.frequency_error_hz / fit.natural_frequency_hz))
    shift = preflight.SIGMA * float(np.hypot(0.5 * setup.rig.uncertainty.specimen, of_modes))
    moved_kg = setup.rig.moving_mass_kg + setup.building.interface_experimental_mass_kg
    found = continued_table(model, measured, fit.specimen, moved_kg, end_hz, shift)
    return found if there is None else found.with_specimen(there)


def table_alone(blocks: Blocks) -> tuple[Blocks, Block]:
    """Return linear blocks of a shake-table test, which desires the ground's motion, and its one "storey", the table.

    Feedforward and feedback are around the table; there is no numerical substructure and no base shear.
    """
    blocks = blocks.linearised()
    dt_s, c = blocks.correction.dt_s, len(blocks.correction.C)
    ground = static(np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]), dt_s, "ground", INPUTS, INTERFACE)
    storey = static(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), dt_s, "table", INPUTS, INTERFACE)
    no_shear = force_of_one(np.zeros(len(blocks.estimator.C)), np.zeros(blocks.lead_samples), np.zeros(c), 0.0)
    return replace(blocks, numerical=ground, interface=Interface(no_shear)), storey


def loop_stability(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    shared: SharedValues | None = None,
    there: Specimen | None = None,
    alone: bool = False,
) -> preflight.Stability:
    """Return the stability of a case's loop with these blocks; with `shared`, equal loops are evaluated once.

    `there` as in `loop_parts`; `alone`: the loop of the shake-table test (`table_alone`). A friction compensation among
    the blocks adds nothing to the linear loop, but makes the table differ less with the level.
    """
    rig, storeys = loop_parts(setup, identified, there, blocks.counters_reaction)
    identified = replace(identified, levels=_levels_left(identified.levels, blocks))
    blocks, samples = blocks.linearised(), len(setup.motion.time_s)
    if alone:
        blocks, storeys = table_alone(blocks)
    gain, continued = setup.rig.uncertainty.table_gain, continued_of(setup, identified, there)
    data = identified.best, identified.frfs[0], identified.levels
    found = (shared or SharedValues()).get(
        "stability",
        content_key(rig, blocks, storeys, *data, setup.compared, gain, continued),
        lambda: _stability(rig, blocks, storeys, identified, samples, setup.compared, gain, continued),
    )
    return replace(found, growth=preflight.growth(found.radius, samples))


def loop_faults(
    setup: Setup,
    identified: Identification,
    blocks: Blocks,
    shared: SharedValues | None = None,
    there: Specimen | None = None,
    alone: bool = False,
) -> list[preflight.Fault]:
    """Return the reasons why a case's loop with these blocks is not safe with any record; empty if it is safe.

    `there` and `alone` as in `loop_stability`.
    """
    found = loop_stability(setup, identified, blocks, shared, there, alone)
    feedback = setup.case.controller.kind == "FF+FB"
    return preflight.faults_of_loop(found, feedback, required_delay_s(setup, identified, blocks), alone)


def required_delay_s(setup: Setup, identified: Identification, blocks: Blocks) -> float:
    """Return the further delay in s that a case's loop must tolerate."""
    bridged = setup.rig.can.bridges_lost_samples and blocks.lead_samples > 0
    error_s = identified.latency.error_s if identified.latency else None
    return preflight.required_delay_s(setup.rig.dt_s, bridged, error_s, bool(identified.levels), setup.compared)


def _levels_left(levels: tuple[LevelBand, ...], blocks: Blocks) -> tuple[LevelBand, ...]:
    """Return the table's response at low level over that at full level with the blocks' friction compensation, which
    leaves the share of the difference that the low-level record has shown."""
    counters = blocks.friction_compensation
    left = 1.0 if counters is None else counters.left
    return tuple(replace(band, ratio=1.0 + left * (band.ratio - 1.0)) for band in levels)


def _stability(
    rig: IdentifiedRig,
    blocks: Blocks,
    storeys: Block,
    identified: Identification,
    samples: int,
    compared: ComparedBand,
    gain: float,
    continued: ContinuedTable,
) -> preflight.Stability:
    """Return the stability of the loop; `gain`: relative standard uncertainty of the table's gain.

    For a feedback with a limit it is the worse of the loops with and without feedback, because a feedback at its limit
    has no effect.
    """
    best, measured, levels = identified.best, identified.frfs[0], identified.levels
    found = preflight.stability(rig, blocks, storeys, best, measured, samples, levels, compared, gain, continued)
    if not math.isfinite(blocks.feedback_limit_v):
        return found
    alone = replace(blocks, feedback=none(rig.plant.dt_s))
    without = preflight.stability(rig, alone, storeys, best, measured, samples, levels, compared, gain, continued)
    worse = min(found, without, key=lambda each: (each.radius < 1.0, each.tolerates / each.required))
    late = min(found.measured, without.measured, key=lambda each: each.delay_margin_s)
    apart, same_side = max(found.apart, without.apart), found.same_side and without.same_side
    return replace(worse, apart=apart, measured=late, feedback=found.feedback, same_side=same_side)
