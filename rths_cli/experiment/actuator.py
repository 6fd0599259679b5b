"""What differs in a test whose actuator follows a displacement: identification, design, loop, check and metrics.

The sequence of a test is the same (docs/decisions/pipeline.md); where it asks for one of these, the interface of the
rig decides. Everything between, the step, its guard, the play, SIM, files and reports, is shared.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.closed_loop import closed_loop_matrix, critical_delay, loop_roots, modes_in_loop
from rths_cli.analysis.identified_rig_block import identified_actuator
from rths_cli.analysis.metrics import figures_of_pairs
from rths_cli.analysis.references import reference_of
from rths_cli.control import feedback, feedforward, sensor_correction
from rths_cli.control.compensator import Plant
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.displacement_interface import (
    FELT,
    in_metres,
    in_volts,
    lead_of_inverse,
    measured_force,
    storeys_of_actuator,
)
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.control.state_space import static
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import run_metrics
from rths_cli.experiment.identify_on_rig import listening_blocks
from rths_cli.experiment.real_rig_readiness import IDENTIFICATION, guard_limits, open_rig
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.setup import placed
from rths_cli.identification.actuator import Multisine, identify_actuator, multisine
from rths_cli.interrupts import interruptible
from rths_cli.loop.guard import without_limits
from rths_cli.loop.identified_rig_run import Disturbed, play_identified
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.rigs.description import BRAKE_SHARE
from rths_cli.structure import Building, Specimen, assemble, modes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.analysis.sim import Response
    from rths_cli.control.interface import PartDesign
    from rths_cli.experiment.run_signals import BuildingMotion, Series
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Array, Block, Model
    from rths_cli.quantities import Values

SEED = 31  # of the noise in the simulated test
RARE = 0.05  # exceedances of a predicted peak in a test


def is_of_actuator(setup: Setup) -> bool:
    """Return whether a case's rig follows a displacement."""
    return setup.rig.interface == "displacement"


def specimen_of(identified: Identification) -> Specimen:
    """Return the identified specimen."""
    assert identified.specimen is not None
    return identified.specimen.specimen


def planned_excitation(setup: Setup) -> Multisine:
    """Return the multisine that identifies a case's actuator; raises InputError where its settings leave none."""
    options = setup.case.identification
    band = options.low_hz, options.high_hz
    return multisine(setup.rig, setup.building.specimen, band, options.duration_s, options.seed, setup.compared)


def identify(setup: Setup, progress: Progress) -> tuple[Identification, Multisine, Array]:
    """Excite a case's actuator and identify it with its specimen; return also what was played, and the channels (2, n).

    Raises LimitError where the guard stopped it, RigError where the channels cannot be used.
    """
    played = planned_excitation(setup)
    seconds = played.command_v.size * setup.rig.dt_s
    progress(f"identification, {seconds:.0f} s on the virtual actuator")
    drive = np.column_stack([played.command_v, np.zeros((played.command_v.size, 2))])
    rig = open_rig(setup, (IDENTIFICATION,), setup.case.identification.seed)
    blocks, limits = listening_blocks(setup), guard_limits(setup)
    outcome = interruptible(lambda: play(rig, setup.rig, blocks, EXCITATION, drive, limits))
    where = f"identification of rig {setup.rig.name}"
    if outcome.rig_fault:
        raise RigError(f"{where}: {outcome.rig_fault}")
    if outcome.stopped_by_limit:
        raise LimitError(
            f"{where}: {outcome.stopped_by_limit}; it takes a quarter of each limit by the declared specimen"
        )
    options = setup.case.identification
    band = max(options.low_hz, 0.3 * setup.compared.low_hz), options.high_hz
    try:
        found = identify_actuator(setup.rig, played, outcome.log.corrected, band, setup.compared)
    except InputError as error:
        raise RigError(f"{where}: {'; '.join(error.faults)}") from error
    return found, played, outcome.log.corrected


def data_sha256(played: Multisine, measured: Array) -> str:
    """Return the hash of command and channels."""
    return hashlib.sha256(played.command_v.tobytes() + np.ascontiguousarray(measured).tobytes()).hexdigest()


def rig_of(setup: Setup, identified: Identification) -> tuple[IdentifiedRig, Block]:
    """Return the identified rig of a case, and all numerical storeys."""
    rig = identified_actuator(identified.best, specimen_of(identified), setup.rig)
    return rig, all_storeys(setup.building.numerical, setup.rig.dt_s, setup.case.integration)


def design_blocks(setup: Setup, identified: Identification) -> Blocks:
    """Return the blocks of a test with an actuator; raises InputError where the case's controller cannot be made."""
    case, rig, model, dt_s = setup.case, setup.rig, identified.best, setup.rig.dt_s
    specimen = specimen_of(identified)
    lead = lead_of_inverse(model, dt_s) if case.controller.inverts else 0
    lead = lead if setup.compensator is None else setup.compensator.lead_samples
    # the mass is the declared one: it is what numerical.masses_kg lacks
    declared = setup.building.specimen.masses_kg
    known = Specimen(declared, specimen.K, specimen.C, attached=True)
    return Blocks(
        correction=sensor_correction.correction(rig.channels, dt_s, corners=False),
        estimator=static(np.zeros((1, 2)), dt_s, "kalman", (), ()),
        numerical=storeys_of_actuator(setup.building.numerical, known, dt_s, lead, case.integration),
        feedforward=_feedforward(setup, identified, model, lead),
        feedback=feedback.none(dt_s),
        interface=measured_force(lead),
        latency_samples=rig.latency_samples,
        command_limit_v=rig.converters.range_v,
    )


def _feedforward(setup: Setup, identified: Identification, model: Model, lead: int) -> PartDesign:
    """Return what makes the command: the case's compensator, in metres as all of them, or the inverse of the model."""
    dt_s, gain = setup.rig.dt_s, setup.rig.gain_m_per_v
    if setup.compensator is not None:
        plant = Plant(in_metres(model, gain), specimen_of(identified), dt_s, setup.compared.hz, lead, 2, "displacement")
        try:
            return in_volts(setup.compensator.designed(plant), gain)
        except InputError as error:
            raise InputError(*(placed(setup.case, fault) for fault in error.faults)) from error
    if setup.case.controller.kind == "none":
        return feedforward.direct(model.low_frequency_gain_m_per_v, dt_s)
    return feedforward.lagged_inverse(model, dt_s, lead)


def building_as_identified(setup: Setup, identified: Identification) -> Building:
    """Return the declared numerical storeys with the identified spring and dashpot, and the declared mass."""
    declared, found = setup.building, specimen_of(identified)
    specimen = Specimen(declared.specimen.masses_kg, found.K, found.C, attached=True)
    M, C, K = assemble(declared.numerical, specimen, declared.interface_experimental_mass_kg)
    return replace(declared, specimen=specimen, M=M, C=C, K=K)


def simulated_run(setup: Setup, identified: Identification, blocks: Blocks, drive: Array, noisy: bool) -> Outcome:
    """Return the test on the identified rig, without limits; `noisy`: with the noise and rounding of its channels."""
    rig, shape = rig_of(setup, identified)[0], (len(drive), 2)
    added, step_v = np.zeros(shape), 0.0
    if noisy:
        rest = np.zeros(2) if identified.at_rest is None else identified.at_rest
        sizes = np.array([one.sensitivity_v_per_unit for one in setup.rig.channels])
        added = np.random.default_rng(SEED).standard_normal(shape) * rest * sizes
        step_v = setup.rig.converters.step_v
    disturbed = Disturbed(np.ascontiguousarray(added), step_v, step_v)
    return play_identified(rig.plant, setup.rig, blocks, drive, without_limits(guard_limits(setup)), disturbed)


def reach(setup: Setup, quiet: Outcome, noisy: Outcome) -> tuple[preflight.Reach, ...]:
    """Return the peaks of a simulated test with the limits that the guard keeps: what the test without noise, with
    noise and rounding of their rms beside it, exceeds with a probability of `RARE` (the peak of one simulated noise
    would be that of another test)."""
    rig, limits, gain = setup.rig, setup.rig.limits, setup.rig.gain_m_per_v

    def series(outcome: Outcome) -> Array:
        place = gain * outcome.log.command_v
        speed = np.diff(place, prepend=0.0) / rig.dt_s
        braked = place + speed * np.abs(speed) / (2.0 * BRAKE_SHARE * limits.acceleration_m_s2)
        return np.array([place, braked, outcome.log.corrected[0], speed, outcome.log.corrected[1], place / gain])

    calm = series(quiet)
    noise = series(noisy) - calm
    sizes, rms = np.abs(calm), noise.std(axis=1)
    peak = np.array([rarely_exceeded(one, float(by)) for one, by in zip(sizes, rms, strict=True)])
    fixed = peak - sizes.max(axis=1)
    of_place = int(np.argmax(peak[:3]))
    fastest, cell = limits.fastest_m_s(gain), min(limits.force_n, rig.channels[1].range)
    rows = (
        ("displacement_m", of_place, min(limits.stroke_m, rig.channels[0].range), "m", "limits.stroke_m"),
        ("velocity_m_s", 3, fastest, "m/s", limits.of_fastest(gain)),
        ("force_n", 4, cell, "N", "limits.force_n"),
        ("command_v", 5, rig.converters.range_v, "V", "converters.range_v"),
    )
    return tuple(
        preflight.Reach(name, float(peak[row]), limit, units, float(fixed[row]), key, "rounding", ("finer_converters",))
        for name, row, limit, units, key in rows
    )


def rarely_exceeded(sizes: Array, rms: float) -> float:
    """Return the level beyond which sizes (n,) with normal noise of this rms go `RARE` times in a test."""
    largest = float(sizes.max(initial=0.0))
    if not rms > 0.0:
        return largest

    def beyond(level: float) -> float:
        return float(ndtr((sizes - level) / rms).sum() + ndtr((-sizes - level) / rms).sum())

    return float(brentq(lambda level: beyond(level) - RARE, largest, largest + 10.0 * rms))


def metrics(setup: Setup, run: str, series: Series, sim: Response, hybrid: BuildingMotion) -> dict[str, ArrayLike]:
    """Return the metrics of a complete test by path: tracking and storeys in displacements, storeys in accelerations.

    The interface's displacement is the measured one; accelerations are those of the computed storeys, the interface's
    included, against SIM.
    """
    dt_s, lowest_hz, band_hz = setup.rig.dt_s, lowest_reliable_hz(setup), setup.case.test_band_hz
    p = len(setup.building.numerical.masses_kg)
    desired, measured = series.desired[2], series.measured[0]
    true = series.true_disp_m if np.isfinite(series.true_disp_m).any() else None
    values: dict[str, ArrayLike] = {f"{run}.high_pass_hz": lowest_hz}
    values |= run_metrics.delays(run, desired, measured, true, dt_s)
    values |= run_metrics.fidelity(run, desired, measured, true, dt_s, lowest_hz, band_hz)
    values.pop(f"{run}.tracking_indicator_m2_s4")  # an area of accelerations
    values |= run_metrics.of_building(run, setup.building, hybrid.rel_disp_m, hybrid.abs_accel_m_s2)
    values |= run_metrics.response(run, sim.rel_disp_m, hybrid.rel_disp_m, p, dt_s, band_hz)
    pairs = [(desired, measured), *zip(sim.rel_disp_m, hybrid.rel_disp_m, strict=True)]
    if true is not None:
        pairs += [(desired, true), (sim.rel_disp_m[-1], true)]
    found = figures_of_pairs(pairs, dt_s, None, lowest_hz, band_hz)
    sizes = figures_of_pairs([(0.0 * one, one) for one in sim.rel_disp_m], dt_s, None, lowest_hz, band_hz)
    storeys = slice(1, 1 + len(sim.rel_disp_m))
    values[f"{run}.tracking_rms_m"], values[f"{run}.tracking_max_m"] = found.rms[0], found.maximum[0]
    values[f"{run}.rms_disp_error_m"] = found.rms[storeys]
    values[f"{run}.disp_nrmse_percent"] = 100.0 * found.rms[storeys] / sizes.rms
    values[f"{run}.peak_measured_force_n"] = float(np.abs(series.measured[1]).max())
    if true is not None:
        values[f"{run}.tracking_rms_m_true"], values[f"{run}.tracking_max_m_true"] = found.rms[-2], found.maximum[-2]
        values[f"{run}.interface_disp_nrmse_percent_true"] = 100.0 * found.rms[-1] / sizes.rms[-1]
    return values


def with_felt_force(series: Series) -> Series:
    """Return signals whose base shear is the force that the numerical part felt, the specimen's share of the ground's
    motion and the prediction included, and without accelerations, of which an actuator tells none."""
    rows = [row for one, row in zip(series.logs, series.logged, strict=True) if one.name == FELT.name]
    return replace(series, base_shear_n=rows[0] if rows else series.base_shear_n, true_accel=np.zeros((0, 0)))


def modes_of(
    setup: Setup, identified: Identification, blocks: Blocks
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return frequencies in Hz and damping ratios of the building as identified, and of the loop near them."""
    building = building_as_identified(setup, identified)
    own = modes(building.M, building.C, building.K)
    roots = loop_roots(closed_loop_matrix(rig_of(setup, identified)[0], blocks.linearised()), setup.rig.dt_s)
    return own, modes_in_loop(roots, *own)


def predicted_storeys(setup: Setup, identified: Identification, outcome: Outcome, sim: Response, lead: int) -> Values:
    """Return the predicted error of the interface's displacement in a simulated test, in percent of SIM's, by path."""
    count = min(sim.rel_disp_m.shape[1], outcome.log.corrected.shape[1] - lead)
    reference = sim.rel_disp_m[-1, :count]
    measured = outcome.log.corrected[0, lead : lead + count]
    lowest, band = lowest_reliable_hz(setup), setup.case.test_band_hz
    pairs = [(reference, measured), (0.0 * reference, reference)]
    error, size = figures_of_pairs(pairs, setup.rig.dt_s, None, lowest, band).rms
    return {"check.interface_disp_error_percent": 100.0 * error / size}


def sim_as_identified(setup: Setup, identified: Identification) -> Response:
    """Return SIM of the building as identified."""
    building = building_as_identified(setup, identified)
    return interruptible(lambda: reference_of(building).sim(building, setup.rig.dt_s, setup.motion.accel_m_s2))


def critical(setup: Setup, identified: Identification) -> preflight.CriticalDelay:
    """Return the critical pure delay of the building as identified."""
    return critical_delay(building_as_identified(setup, identified))
