"""Tests simulated before they are played: the compiled step on the identified model (loop/identified_rig_run.py).

A building with laws is played several times: on a perfect table, on the identified one, then with one cause of errors
after the other added. The reference is SIM of the computed storeys with the identified specimen. After a run the same
is done with what was measured (`Replayed`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import (
    Errors,
    FewBits,
    PredictionInputs,
    friction_samples,
    model_error_samples,
    white_noise_m_s2,
)
from rths_cli.analysis.stability_check import Reach, Strays, reach_of_series
from rths_cli.experiment import run_metrics
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import on_record_clock, whole_building
from rths_cli.findings import Finding
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.guard import without_limits
from rths_cli.loop.identified_rig_run import Disturbed, on_perfect_table, perfect_table, play_identified, seen_by_model
from rths_cli.structure import Building

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.identified_rig_block import IdentifiedRig
    from rths_cli.analysis.predicted_error import Prediction
    from rths_cli.analysis.sim import Response
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.loop.simulated_time_run import Outcome
    from rths_cli.numerics.lti import Array, Block, ComplexArray

MOST_ERROR = 0.5  # times SIM's RMS: a storey that is farther off does not do the test
SEED = 19  # of the simulated noise
SMALL = 1e-3  # rms of a small disturbance over that of the motion
DRAWS, SEED_OF_ZEROS = 3, 23  # of zeros and noise, where rounding is simulated
ZERO_CHANGES = 0.1  # bits by which a zero that was seen changes until the test


@dataclass(frozen=True)
class Simulated:
    """The simulated test of a building with laws; empty values where the guard stopped it."""

    faults: tuple[Finding, ...]  # why it is not safe, beside its reach
    reach: tuple[Reach, ...]  # peaks of the test without noise
    causes: dict[str, Errors] = field(default_factory=dict)  # RMS errors by cause, as in a Prediction
    total: Errors | None = None
    response: dict[str, ArrayLike] = field(default_factory=dict)  # metrics `check.*` of the building's response


@dataclass(frozen=True)
class _Played:
    """One simulated test on the record's clock."""

    outcome: Outcome
    tracking: Array  # (n,) desired minus measured table acceleration
    accel: Array  # (n_storeys, n)
    rel_disp_m: Array  # (n_storeys, n)
    law_force_n: Array | None  # (s, n); None for a linear building


@dataclass(frozen=True)
class SimulatedTest:
    """What all simulated tests of a case share."""

    setup: Setup
    building: Building  # with the identified specimen and its laws
    blocks: Blocks
    drive: Array

    def play(self, plant: Block, blocks: Blocks, disturbed: Disturbed, limits: GuardLimits) -> _Played:
        outcome = play_identified(plant, self.setup.rig, blocks, self.drive, limits, disturbed)
        dt_s, motion = self.setup.rig.dt_s, self.setup.motion
        series = on_record_clock(outcome, blocks.lead_samples, dt_s, len(motion.time_s))
        whole = whole_building(self.building, series, motion.accel_m_s2, dt_s)
        tracking = series.desired[0] - series.measured[0]
        return _Played(outcome, tracking, whole.abs_accel_m_s2, whole.rel_disp_m, series.law_force_n)

    def errors(self, storeys: Array, tracking: Array) -> Errors:
        """Return the RMS errors as a run reports them, of series (n_storeys, n) and (n,) in m/s^2."""
        found = run_metrics.errors(
            "check", (np.zeros_like(tracking), tracking, None), (np.zeros_like(storeys), storeys, None),
            self.setup.rig.dt_s, lowest_reliable_hz(self.setup), None, self.setup.case.test_band_hz,
        )  # fmt: skip
        return Errors(np.asarray(found["check.rms_error_m_s2"]), float(np.asarray(found["check.tracking_rms_m_s2"])))


def simulated_test(
    setup: Setup, building: Building, design: Design, rig: IdentifiedRig, known: PredictionInputs, at_rest: Prediction,
    sim: Response, strays: Strays,
) -> Simulated:  # fmt: skip
    """Return the simulated test of a building with laws on the identified rig.

    `building` consists of the computed storeys with their laws and the identified specimen, and `sim` is its SIM;
    `known` and `at_rest` are inputs and result of the prediction of the storeys at rest, `strays` theirs.
    """
    info, blocks = setup.rig, design.blocks
    test = SimulatedTest(setup, building, blocks, drive_of(setup, design))
    limits = guard_limits(setup)
    limits = limits._replace(stuck=np.full(limits.stuck.shape, np.inf))  # a model's channels are never stuck
    quiet = replace(seen_by_model(rig, blocks, info, setup.removes_sensors), shaping_step_v=0.0)
    rows, still = len(test.drive), np.zeros((len(test.drive), len(info.channels)))
    never = without_limits(limits)
    nominal = test.play(rig.plant, quiet, Disturbed(still), never)
    reach = _reach(setup, nominal, sim, blocks.shaping_step_v > 0.0, strays)
    if not nominal.outcome.played:
        return Simulated((_stopped(nominal.outcome),), tuple(replace(row, peak=np.inf) for row in reach))
    command = known.lines.of(nominal.outcome.log.command_v[: known.lines.samples])
    moved = replace(known, velocity_m_s=nominal.outcome.log.desired[1, : known.lines.samples])
    added = {"model": model_error_samples(known, command), "friction": friction_samples(moved)}
    wanted = {name: _samples_v(known, rig, samples, rows) for name, samples in added.items()}
    noise = np.random.default_rng(SEED).standard_normal(still.shape) * (white_noise_m_s2(known) * _sizes(setup))
    step_v, shaping_v = info.converters.step_v, blocks.shaping_step_v
    with_friction = wanted["model"] + wanted["friction"]
    with_noise = with_friction + noise
    full = replace(quiet, shaping_step_v=shaping_v)
    sent_step_v = 0.0 if shaping_v > 0.0 else step_v  # the rig rounds what the step does not
    last = test.play(rig.plant, full, Disturbed(with_noise, step_v, sent_step_v), limits)
    if not last.outcome.played:
        return Simulated((_stopped(last.outcome),), reach)
    none = np.zeros_like(nominal.tracking)
    total = test.errors(last.accel - sim.abs_accel_m_s2, last.tracking)
    assert last.law_force_n is not None  # a building with laws
    response = run_metrics.of_laws("check", building, last.rel_disp_m, last.law_force_n)
    drifts = np.abs(np.diff(last.rel_disp_m, axis=0, prepend=0.0)).max(axis=1)
    response["check.peak_inter_storey_drift_m"] = drifts
    size = test.errors(sim.abs_accel_m_s2, none).storeys
    faults = tuple(_far_off(total.storeys, size))
    if building.has_program:  # asked once for each cause, it would take minutes: causes are those of its linear part
        return Simulated(faults, reach, dict(at_rest.causes), total, response)
    model = test.play(rig.plant, quiet, Disturbed(wanted["model"]), never)
    friction = test.play(rig.plant, quiet, Disturbed(with_friction), never)
    noisy = test.play(rig.plant, quiet, Disturbed(with_noise), never) if noise.any() else friction
    steps = {  # the run with a cause and the run without it
        "model": (model, nominal),
        "friction": (friction, model),
        "noise": (noisy, friction),
        "quantisation": (test.play(rig.plant, quiet, Disturbed(with_noise, step_v), never), noisy),
        "rounding": (test.play(rig.plant, full, Disturbed(with_noise, 0.0, sent_step_v), never), noisy),
    }
    ideal, coupling = _on_perfect_table(test, never), at_rest.causes["coupling"]
    reached = sim.abs_accel_m_s2
    if ideal is not None:
        coupling, reached = test.errors(ideal.accel - reached, none), ideal.accel
    causes = {"coupling": coupling, "latency": test.errors(nominal.accel - reached, nominal.tracking)}
    for cause, (run, before) in steps.items():
        causes[cause] = test.errors(run.accel - before.accel, run.tracking - before.tracking)
    return Simulated(faults, reach, causes, total, response)


class Replayed:
    """A test of storeys with laws, played again on the identified rig with disturbances that a run has shown.

    Disturbances have lines up to those of `known`. That of a command is given as what the rig makes of it.
    """

    def __init__(
        self,
        setup: Setup,
        building: Building,
        design: Design,
        rig: IdentifiedRig,
        known: PredictionInputs,
        sim: Response,
    ) -> None:
        """`building`, `design`, `rig`, `known` and `sim` as of `simulated_test`."""
        self._known, self._rig, self._sim = known, rig, sim
        self._test = SimulatedTest(setup, building, design.blocks, drive_of(setup, design))
        self._never = without_limits(guard_limits(setup))
        self._blocks = replace(seen_by_model(rig, design.blocks, setup.rig, setup.removes_sensors), shaping_step_v=0.0)
        self._given = np.zeros_like(known.loop.rig)  # all disturbances so far
        self._last = self._nominal = self._play(self._given)

    @property
    def sim(self) -> ComplexArray:
        return self._known.lines.of(self._sim.abs_accel_m_s2)

    @property
    def perfect(self) -> ComplexArray:
        found = _on_perfect_table(self._test, self._never)
        return self.sim if found is None else self._known.lines.of(found.accel)

    @property
    def nominal(self) -> tuple[ComplexArray, ComplexArray]:
        return self._known.lines.of(self._nominal.accel), self._known.lines.of(self._nominal.tracking)

    def disturb(self, samples: ComplexArray, command: ComplexArray | None) -> tuple[ComplexArray, ComplexArray]:
        before, lines = self._last, self._known.lines
        through = 0.0 if command is None else self._known.loop.rig * command
        self._given = self._given + samples + through
        self._last = self._play(self._given)
        return lines.of(self._last.accel - before.accel), lines.of(self._last.tracking - before.tracking)

    def small(self, samples: ComplexArray) -> ComplexArray:
        lines = self._known.lines
        size = float(rms(lines.series(samples)).max())
        if size == 0.0:
            return np.zeros_like(self.sim)
        factor = SMALL * float(rms(self._nominal.accel).max()) / size
        return np.asarray(lines.of(self._play(self._given + factor * samples).accel - self._last.accel) / factor)

    def _play(self, samples: ComplexArray) -> _Played:
        added = Disturbed(_samples_v(self._known, self._rig, samples, len(self._test.drive)))
        return self._test.play(self._rig.plant, self._blocks, added, self._never)


def played_rounding(
    setup: Setup, building: Building, design: Design, rig: IdentifiedRig, known: PredictionInputs,
    as_noise: Prediction, weight: float,
) -> FewBits:  # fmt: skip
    """Return the errors by rounding of a motion of a few bits: tests on the identified rig with converters, less the
    same tests without.

    `building` and `design` are linear; `as_noise` is the prediction with rounding as noise. Each draw has its noise,
    and zeros that lie anywhere within a bit where the identification did not show them. Where commands are rounded with
    noise shaping, both tests are, each with rounding errors of its own, which are noise and taken off.
    """
    test = SimulatedTest(setup, building, design.blocks, drive_of(setup, design))
    never = without_limits(guard_limits(setup))
    quiet = seen_by_model(rig, design.blocks, setup.rig, setup.removes_sensors)
    rows, sizes, step_v, lines = len(test.drive), _sizes(setup), setup.rig.converters.step_v, known.lines
    nominal = test.play(rig.plant, quiet, Disturbed(np.zeros((rows, len(sizes)))), never)
    command = lines.of(nominal.outcome.log.command_v[: lines.samples])
    certain = _samples_v(known, rig, model_error_samples(known, command) + friction_samples(known), rows)
    random, dither = np.random.default_rng(SEED_OF_ZEROS), white_noise_m_s2(known) * sizes
    sent_step_v = 0.0 if known.shaped else step_v  # the rig rounds what the step does not
    by_both, apart = (step_v, sent_step_v), () if known.shaped else ((step_v, 0.0), (0.0, sent_step_v))

    def moved(added_v: Array, steps_v: tuple[float, float]) -> Array:
        """Return the motions (2 n_storeys + 1, n): of the storeys as reported, tracking, of the storeys in truth."""
        played = test.play(rig.plant, quiet, Disturbed(added_v, *steps_v), never)
        true = played.accel.copy()
        true[len(true) - len(sizes) :] = _true_motion(rig, quiet, played)
        return np.vstack([played.accel, played.tracking, true])

    found = []
    for _ in range(DRAWS):
        place_v = random.uniform(-0.5, 0.5, len(sizes)) * step_v
        if known.zero_m_s2 is not None:
            place_v = known.zero_m_s2 * sizes + 2.0 * ZERO_CHANGES * place_v
        added = certain + random.standard_normal((rows, len(sizes))) * dither
        fine = moved(added, (0.0, 0.0))
        made = (moved(added + place_v * (steps[0] > 0.0), steps) - fine for steps in (by_both, *apart))
        found.append([rms(lines.evaluated(lines.of(one))) ** 2 for one in made])
    shaken, n = as_noise.causes["rounding"], len(found[0][0]) // 2
    twice = 2.0 * np.concatenate([shaken.storeys, [shaken.tracking], shaken.storeys]) ** 2 if known.shaped else 0.0
    both, *parts = np.maximum(np.mean(found, axis=0) - twice, 0.0)
    samples, sent = parts or (both, np.zeros_like(both))
    share = both / np.maximum(samples + sent, np.finfo(float).tiny)
    return FewBits(weight, (share * samples)[: n + 1], (share * sent)[: n + 1], both[n + 1 :])


def _true_motion(rig: IdentifiedRig, blocks: Blocks, played: _Played) -> Array:
    """Return the accelerations (c, n) that the table and its floors truly had, by the commands alone."""
    command, lead, plant = played.outcome.log.command_v, blocks.lead_samples, rig.plant
    samples = run_block(replace(plant, D=np.zeros_like(plant.D)), command[None])
    samples[:, 1:] += plant.D * command[:-1]  # a direct path shows the command of the instant before
    return run_block(blocks.correction, samples)[:, lead : lead + played.tracking.size]


def _on_perfect_table(test: SimulatedTest, limits: GuardLimits) -> _Played | None:
    """Return the test on a table that follows the desired motion; None without a lead, by which it is known early."""
    info, blocks = test.setup.rig, test.blocks
    if blocks.lead_samples < 1:
        return None
    plant = perfect_table(test.building.specimen, info, blocks.lead_samples)
    still = np.zeros((len(test.drive), len(info.channels)))
    quiet = replace(on_perfect_table(blocks, info), shaping_step_v=0.0)
    return test.play(plant, quiet, Disturbed(still, of_desired=True), limits)


def _reach(setup: Setup, played: _Played, sim: Response, shaped: bool, strays: Strays) -> tuple[Reach, ...]:
    """Return the peaks of a simulated test, with the limits that the guard enforces."""
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    log, steps = played.outcome.log, max(played.outcome.steps, 2)
    command, accel = log.command_v[:steps], log.corrected[:, :steps]
    rate = np.diff(command, prepend=0.0) / setup.rig.dt_s
    interface = len(setup.building.numerical.masses_kg) - 1
    loudest = float(np.abs(sim.abs_accel_m_s2[interface:]).max())
    return reach_of_series(command, rate, accel, loudest, setup.rig, masses, shaped, strays)


def _samples_v(known: PredictionInputs, rig: IdentifiedRig, corrected: ComplexArray, rows: int) -> Array:
    """Return the disturbance (rows, c) of the raw samples in V whose lines (c, m), corrected, are given in m/s^2."""
    lines = known.lines
    correction = np.einsum("ccm->cm", rig.correction.response(lines.frequency_hz))
    whole = np.fft.irfft(corrected / correction, lines.padded)
    return np.ascontiguousarray(whole[:, :rows].T)


def _sizes(setup: Setup) -> Array:
    return np.array([channel.sensitivity_v_per_unit for channel in setup.rig.channels])


def _stopped(outcome: Outcome) -> Finding:
    return Finding("loop.simulated_stop", {"at_s": outcome.stopped_at_s, "stopped_by": outcome.stopped_by_limit})


def _far_off(errors: Array, sizes: Array) -> list[Finding]:
    """Return a reason if a storey of the simulated test is far from SIM."""
    ratios = errors / np.maximum(sizes, np.finfo(float).tiny)
    worst = int(np.argmax(ratios))
    if ratios[worst] <= MOST_ERROR:
        return []
    error = float(ratios[worst])
    values = {"storey": worst + 1, "error": error, "permitted": MOST_ERROR}
    return [Finding("loop.simulated_error", values, beyond=error)]
