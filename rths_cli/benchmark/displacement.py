"""A benchmark whose actuator tracks displacement: what its file states, ready for the compiled loop; a row per run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from scipy.linalg import expm

from rths_cli.analysis.adaptive_loop import AdaptiveVerdict, judged, spectral_radius
from rths_cli.analysis.metrics import frequency_evaluation, peak, response_criteria, tracking_criteria, tracking_ratios
from rths_cli.benchmark.ran import Ran
from rths_cli.case.benchmark_schema import BenchmarkCase, BenchmarkCompensator, BenchmarkSpec, PlantChange
from rths_cli.case.compensator_schema import OWN
from rths_cli.control.compensator import (
    FIELD,
    Plant,
    adapted_of,
    compiled_function,
    definition_of,
    designed_law,
    without_sent,
)
from rths_cli.control.interface import Adapted
from rths_cli.control.law_block import declared_block, derived_block
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.loop.adapted_states import held
from rths_cli.loop.displacement_loop import (
    INTO,
    REMEMBERED,
    SENT,
    Converters,
    Law,
    Series,
    State,
    Storeys,
    play,
)
from rths_cli.numerics.lti import Array, Block, Model, driven_modes
from rths_cli.numerics.user_functions import UserFunction
from rths_cli.rigs.virtual.servo_hydraulic import ServoHydraulic, sampled_actuator
from rths_cli.structure import Specimen

NONE = "none"
CRITERIA = ("j1_ms", *(f"j{i}_percent" for i in range(2, 10)))
TRUE = ("true_j2_percent", "true_j4_percent", "error_percent")
FIGURES = (*CRITERIA, "fei_amplitude", "fei_delay_ms", *TRUE, "peak_force_n")
ROW = (*FIGURES, "radius", "ended_s")
"""The numbers of a run: criteria of the measured displacement and frequency evaluation index; of the displacement
itself J2, J4, and J4 against the structure with this plant's own specimen (the error of the test); spectral radius of
the linear loop (NaN: not judged), and when it ended, early if it diverged."""
PLANTS, NOISE = 1, 2  # streams of random numbers
SETTLED_S = 1.0  # after a change of the plant, before errors count
SMALL = 1e-6  # a state by which the loop is excited, far from every limit
SAFE = 1.0 - 1e-9  # the largest spectral radius of a loop that is safe
FINEST_HZ, MOST_HZ, POINTS = 1e-3, 500.0, 400_000  # of the search for a critical delay


@dataclass(frozen=True)
class Designed:
    """A compensator, designed: a block (`function` None), or compiled code with the block by which it is judged."""

    label: str
    parameters: Array
    states: int
    judged: Block | None
    function: UserFunction | None
    predict_force: bool
    adapted: Adapted | None = None
    at: Callable[[Array], Block] | None = None
    """The block at other values of the parameters that move."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the parameters that move."""
        return () if self.adapted is None else self.adapted.names

    @property
    def adapts(self) -> bool:
        """Return whether it is no linear block."""
        return self.function is not None

    def law(self, state: Array, block: Block | None = None) -> Law:
        """Return it for the loop, with its `state` (n,) at rest, or a block by which it is judged."""
        code, n = None if block is not None else self.function, len(state)
        block = self.judged if block is None else block
        whole = np.zeros((n + 1, n + INTO))
        if code is None and block is not None:
            width = n + block.B.shape[1]
            whole[:, :width] = np.block([[block.A, block.B], [block.C, block.D]])
        rows, columns = np.nonzero(whole)
        return Law(
            0 if code is None else code.address, self.parameters.copy(), rows, columns, whole[rows, columns],
            np.zeros(n + INTO), np.zeros(n + 1), np.zeros(3), np.zeros(2),
            held(None if code is None else self.adapted, state, np.zeros(len(self.names)), 1),
        )  # fmt: skip


@dataclass(frozen=True)
class CaseMatrices:
    """A case: M, C, K of the whole structure (n, n), and of the numerical storeys, without the specimen."""

    M: Array
    C: Array
    K: Array
    numerical: tuple[Array, Array, Array]


@dataclass(frozen=True)
class DisplacementBenchmark:
    """A benchmark with its ground motion, as a file states it; `noise_free`: sensors without noise."""

    spec: BenchmarkSpec
    record: Accelerogram
    noise_free: bool = False

    figures = ROW
    tracked = "true_j2_percent"

    def facts(self) -> dict[str, Any]:
        """Return what decides the rows beside the benchmark's file."""
        return {
            "noise_free": self.noise_free,
            "record_sha256": sha256(self.record.accel_m_s2.tobytes()).hexdigest(),
            "record_dt_s": self.record.dt_s,
        }

    def tasks(self, designed: Sequence[Designed]) -> Iterator[tuple[Designed, str, int]]:
        """Yield the runs in their order."""
        for one in designed:
            for case in self.spec.cases:
                yield from ((one, case.name, index) for index in range(self.spec.plants))

    def played(self, designed: Designed, case: str, index: int, seed: int) -> Ran:
        """Return how the run of a plant of a seed went."""
        return Ran(CaseRuns(self, *self._of_case[case], designed).row(index, seed))

    @cached_property
    def _of_case(self) -> dict[str, tuple[BenchmarkCase, Storeys, Array]]:
        return {case.name: (case, self.storeys(case), self.reference(case)) for case in self.spec.cases}

    @property
    def change(self) -> PlantChange | None:
        """Return what changes during the test; figures are then those from `SETTLED_S` after it."""
        return self.spec.change

    @property
    def dt_s(self) -> float:
        """Return the interval of the loop."""
        return 1.0 / self.spec.sample_rate_hz

    @cached_property
    def ground(self) -> tuple[Array, Array]:
        """Return the ground acceleration at the samples and in the middle between them, (samples,), linear between the
        record's own samples."""
        own = self.record.dt_s * np.arange(len(self.record.accel_m_s2))
        at = self.dt_s * np.arange(int(own[-1] * self.spec.sample_rate_hz))
        scaled = self.spec.ground_motion_factor * self.record.accel_m_s2
        return np.interp(at, own, scaled), np.interp(at + 0.5 * self.dt_s, own, scaled)

    @cached_property
    def specimen(self) -> tuple[float, float, float]:
        """Return mass, damping and stiffness of the nominal specimen."""
        return _specimen(self.spec, self.spec.specimen.stiffness_n_per_m)

    def matrices(self, case: BenchmarkCase) -> CaseMatrices:
        """Return the matrices of a case; its damping is modal."""
        K = np.array(self.spec.stiffness_n_per_m)
        first = np.zeros_like(K)
        first[0, 0] = 1.0
        M = case.floor_mass_kg * np.eye(len(K))
        squares, shapes = np.linalg.eigh(K / case.floor_mass_kg)
        C = case.floor_mass_kg * (shapes * (2.0 * case.damping_ratio * np.sqrt(squares))) @ shapes.T
        mass, damping, stiffness = self.specimen
        return CaseMatrices(M, C, K, (M - mass * first, C - damping * first, K - stiffness * first))

    def storeys(self, case: BenchmarkCase) -> Storeys:
        """Return the numerical storeys; the ground acts on the masses of the whole structure."""
        whole = self.matrices(case)
        a, b = _first_order(*whole.numerical, whole.M)
        sampled, driven = _held(a, b, self.dt_s)
        n = len(whole.M)
        return Storeys(sampled, driven, np.concatenate([a[n], b[n]]))

    def reference(self, case: BenchmarkCase, plant: ServoHydraulic | None = None) -> Array:
        """Return the displacements (storeys, samples) of the whole structure, mode by mode, exact for a ground
        acceleration that is held; with a plant those with its specimen in place of the nominal one."""
        whole, more = self.matrices(case), np.zeros(3)
        if plant is not None:
            more += np.array([plant.mass_kg, plant.damping_n_s_per_m, plant.stiffness_n_per_m]) - self.specimen
        M, C, K = (matrix.copy() for matrix in (whole.M, whole.C, whole.K))
        for matrix, one in zip((M, C, K), more, strict=True):
            matrix[0, 0] += one
        n, ground, change = len(M), self.ground[1], self.change
        if change is None or change.specimen_stiffness_factor == 1.0:
            return self._response(M, C, K, whole.M, ground, np.zeros(2 * n))[:n]
        at = round(change.at_s / self.dt_s)
        before = self._response(M, C, K, whole.M, ground[: at + 1], np.zeros(2 * n))
        stiffness = self.spec.specimen.stiffness_n_per_m if plant is None else plant.stiffness_n_per_m
        K = K.copy()
        K[0, 0] += (change.specimen_stiffness_factor - 1.0) * stiffness
        after = self._response(M, C, K, whole.M, ground[at:], before[:, -1])
        return np.hstack([before[:n, :at], after[:n]])

    def _response(self, M: Array, C: Array, K: Array, load: Array, ground: Array, first: Array) -> Array:
        """Return displacements and velocities (2 n, samples) mode by mode from the state `first` (2 n,)."""
        a, b = _first_order(M, C, K, load)
        values, shapes = np.linalg.eig(a)
        weights = np.linalg.solve(shapes, b[:, :1].astype(complex))[:, 0] * np.expm1(values * self.dt_s) / values
        parts = driven_modes(np.exp(values * self.dt_s), 0.0 * weights, weights, ground)
        found = parts[0] + 1j * parts[1]
        if first.any():
            decaying = np.exp(np.outer(values * self.dt_s, np.arange(len(ground))))
            found = found + np.linalg.solve(shapes, first.astype(complex))[:, None] * decaying
        return np.asarray((shapes @ found).real)

    def plants_of_run(self, plant: ServoHydraulic) -> list[tuple[ServoHydraulic, int]]:
        """Return the plants of a run, one after the other, each with the samples by which commands are later."""
        change = self.change
        if change is None:
            return [(plant, 0)]
        changed = replace(
            plant, command_gain=plant.command_gain * change.command_gain_factor,
            stiffness_n_per_m=plant.stiffness_n_per_m * change.specimen_stiffness_factor,
        )  # fmt: skip
        return [(plant, 0), (changed, change.latency_samples)]

    def plant(self, index: int, seed: int) -> ServoHydraulic:
        """Return plant `index` of a seed, the nominal one for 0: the same for every case and compensator."""
        drawn = np.random.default_rng((seed, PLANTS, index)).standard_normal(4) if index else np.zeros(4)
        scatter = self.spec.scatter
        steps = [deviation * one for deviation, one in zip(
            (scatter.oil_column_rad_s, scatter.valve_damping_rad_s, scatter.valve_stiffness_rad2_s2,
             scatter.stiffness_n_per_m), drawn, strict=True)]  # fmt: skip
        given = self.spec.actuator
        mass, damping, stiffness = _specimen(self.spec, self.spec.specimen.stiffness_n_per_m + steps[3])
        return ServoHydraulic(
            given.valve_gain, given.velocity_feedback, given.oil_column_rad_s + steps[0],
            given.valve_damping_rad_s + steps[1], given.valve_stiffness_rad2_s2 + steps[2], given.command_gain,
            mass, damping, stiffness, given.force_limit_n,
        )  # fmt: skip

    def noise(self, index: int, seed: int) -> Array:
        """Return the standard normal numbers (samples,) of a plant's run, those of both sensors."""
        return np.random.default_rng((seed, NOISE, index)).standard_normal(len(self.ground[0]))

    @cached_property
    def identified(self) -> Plant:
        """Return what the design of a compensator may know: the nominal plant without its limits, the specimen, the
        rate."""
        nominal, dt_s = self.plant(0, 0), self.dt_s
        model = Model(np.zeros(2, complex), nominal.poles, nominal.high_frequency_gain, 0.5 * dt_s,
                      self.spec.identified_band_hz, dt_s=dt_s)  # fmt: skip
        mass, damping, stiffness = self.specimen
        specimen = Specimen(np.array([mass]), np.array([[stiffness]]), np.array([[damping]]))
        return Plant(model, specimen, dt_s, self.spec.identified_band_hz, channels=2, interface="displacement")

    def designed(self, stated: BenchmarkCompensator) -> Designed:
        """Return a compensator designed for the nominal plant; raises InputError for one that cannot be played."""
        if stated.lead_samples:
            raise InputError("lead_samples: belongs to the loop table; remove it")
        plant, predicts = self.identified, stated.predict_force
        if stated.kind == NONE:
            direct = np.array([[0.0, 0.0, 1.0 / plant.gain_m_per_v]])
            without = Block(NONE, np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), direct, plant.dt_s)
            return Designed(stated.label, np.zeros(0), 0, without, None, predicts)
        definition = definition_of(stated.kind, stated.file if stated.kind == OWN else None, stated.sha256)
        law = designed_law(definition, definition.values(stated.options), plant)
        if isinstance(law, Block):
            return Designed(stated.label, np.zeros(0), len(law.A), law, None, predicts)
        block = derived_block(law, plant.dt_s)
        if block is not None and not block.B[:, -1].any() and not block.D[:, -1].any():
            linear = without_sent(block)
            return Designed(stated.label, np.zeros(0), len(linear.A), linear, None, predicts)
        adapted, at_values = adapted_of(definition, law, plant.dt_s), definition.linear
        at = None if at_values is None else (
            lambda values: declared_block(at_values, law, plant.dt_s, values, plant.interface)
        )  # fmt: skip
        declared = None if at is None else at(None if adapted is None else adapted.start)
        made = compiled_function(definition, law)
        if isinstance(made, str):
            raise InputError(f"{FIELD}: {definition.who}: {made}; a benchmark plays compiled compensators only")
        if adapted is not None and stated.frozen:
            adapted = replace(adapted, rate=np.zeros(len(adapted.start)))
        return Designed(stated.label, law.parameters, law.states, declared, made, predicts, adapted, at)


@dataclass(frozen=True)
class CaseRuns:
    """One case with one compensator, of which plants are run."""

    bench: DisplacementBenchmark
    case: BenchmarkCase
    storeys: Storeys
    reference: Array  # (storeys, samples)
    designed: Designed

    def row(self, index: int, seed: int) -> dict[str, float]:
        """Play plant `index` of a seed over the record and return the numbers of `ROW`."""
        bench, plant = self.bench, self.bench.plant(index, seed)
        series, end = self.played(index, seed)
        radius = max(self.radius(each, late) for each, late in bench.plants_of_run(plant))
        figures = dict.fromkeys(ROW, math.nan) | {"ended_s": end * bench.dt_s, "radius": radius}
        if end < len(series.noise):
            return figures
        own = bench.reference(self.case, plant)[0] if index or bench.change else self.reference[0]
        first = 0 if bench.change is None else round((bench.change.at_s + SETTLED_S) / bench.dt_s)
        return figures | _figures(bench, self.reference[:, first:], own[first:], _from(series, first))

    def played(self, index: int, seed: int) -> tuple[Series, int]:
        """Return the series of a plant's run, and in which sample it ended."""
        bench, samples = self.bench, len(self.bench.ground[0])
        noise = np.zeros(samples) if bench.noise_free else bench.noise(index, seed)
        series = _series(bench.ground, noise, len(self.reference), len(self.designed.names))
        made = self._converters(bench.spec.quantisation.quantum, bench.spec.quantisation.range)
        state, begun = self._at_rest(), 0
        law = self.designed.law(state.law)
        for plant, late in bench.plants_of_run(bench.plant(index, seed)):
            first = begun == 0 and bench.change is not None
            end = round(bench.change.at_s / bench.dt_s) if first and bench.change else samples
            if late > len(state.late):
                state = state._replace(late=np.full(late, state.before[SENT]))
            begun = play(self.storeys, sampled_actuator(plant, bench.dt_s), law, made, state, series, begun, end)
            if begun < end:
                break
        return series, begun

    def radius(self, plant: ServoHydraulic, late: int = 0) -> float:
        """Return the spectral radius of the loop from sample to sample, as its block is, with a plant within its limit
        and commands later by `late` samples. NaN where the compensator declares no block."""
        block = self.designed.judged
        return math.nan if block is None else spectral_radius(self.matrix(plant, block, late))

    def adaptive(self) -> AdaptiveVerdict | None:
        """Return what is known of the nominal loop while its parameters move, None where none do."""
        adapted, at = self.designed.adapted, self.designed.at
        if adapted is None or at is None:
            return None
        nominal = self.bench.plant(0, 0)
        return judged(lambda values: self.matrix(nominal, at(values)), adapted, self.bench.dt_s)

    def matrix(self, plant: ServoHydraulic, block: Block, late: int = 0) -> Array:
        """Return the matrix of the loop from sample to sample, the compensator a block: the loop itself is excited,
        state by state."""
        still, state = np.zeros(1), self._at_rest(len(block.A), late)
        law = self.designed.law(state.law, block)
        parts = (state.storeys, state.actuator, state.law, state.before, state.late)
        bound = play.bind(
            self.storeys, sampled_actuator(replace(plant, force_limit_n=math.inf), self.bench.dt_s), law,
            self._converters(0.0, math.inf), state, _series((still, still), still, len(self.reference)), 0, 1,
        )  # fmt: skip
        sizes = [len(one) for one in parts]
        columns = []
        for unit in SMALL * np.eye(sum(sizes)):
            for one, given in zip(parts, np.split(unit, np.cumsum(sizes)[:-1]), strict=True):
                one[:] = given
            bound()
            columns.append(np.concatenate(parts) / SMALL)
        return np.array(columns).T

    def _at_rest(self, states: int | None = None, late: int = 0) -> State:
        n = len(self.storeys.sampled)
        size = self.designed.states if states is None else states
        return State(np.zeros(n), np.zeros(5), np.zeros(size), np.zeros(REMEMBERED), np.zeros(n), np.zeros(late))

    def _converters(self, quantum: float, largest: float) -> Converters:
        spec, rate = self.bench.spec, self.bench.spec.sample_rate_hz
        of_disp, of_force = (math.sqrt(one * rate) for one in (spec.noise.displacement_psd, spec.noise.force_psd))
        mass, damping, stiffness = self.bench.specimen if self.designed.predict_force else (0.0, 0.0, 0.0)
        return Converters(self.bench.dt_s, quantum, largest, of_disp, of_force, mass, damping, stiffness)


def critical_delay_s(bench: DisplacementBenchmark, case: BenchmarkCase) -> float:
    """Return the smallest pure delay tau of the actuator at which the continuous loop is on the border of stability.

    Z_e = m s^2 + c s + k of the specimen, and H = e_1' (M_N s^2 + C_N s + K_N)^-1 e_1: the loop 1 + H Z_e exp(-s tau)
    has a root j w where |H Z_e| = 1 and w tau = pi + arg(H Z_e), up to whole turns. The force comes without a delay of
    its own and nothing is sampled.
    """
    whole, (mass, damping, stiffness) = bench.matrices(case), bench.specimen

    def loop(angle: Array) -> Array:
        s = 1j * angle[:, None, None]
        dynamic = whole.numerical[0] * s**2 + whole.numerical[1] * s + whole.numerical[2]
        flexibility = np.linalg.inv(dynamic)[:, 0, 0]
        return np.asarray(flexibility * (stiffness + damping * s[:, 0, 0] + mass * s[:, 0, 0] ** 2))

    angle = 2.0 * np.pi * np.linspace(FINEST_HZ, MOST_HZ, POINTS)
    over = np.abs(loop(angle)) > 1.0
    places = np.flatnonzero(over[1:] != over[:-1])
    low, high = angle[places], angle[places + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        same = (np.abs(loop(middle)) > 1.0) == over[places]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    if not low.size:
        return math.inf
    phase = np.mod(np.pi + np.angle(loop(low)), 2.0 * np.pi)
    return float((phase / low).min())


def _specimen(spec: BenchmarkSpec, stiffness: float) -> tuple[float, float, float]:
    """Return mass, damping and stiffness of a specimen; its damping ratio stays."""
    mass = spec.specimen.mass_kg
    return mass, 2.0 * spec.specimen.damping_ratio * math.sqrt(mass * stiffness), stiffness


def _first_order(M: Array, C: Array, K: Array, load: Array) -> tuple[Array, Array]:
    """Return A, B of M x'' + C x' + K x = -load 1 a_g - e_1 f for the state (x, x') and inputs a_g, f."""
    n = len(M)
    into = np.column_stack([-load @ np.ones(n), -np.eye(n)[0]])
    lower = np.linalg.solve(M, np.hstack([-K, -C, into]))
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower[:, : 2 * n]])
    return a, np.vstack([np.zeros((n, 2)), lower[:, 2 * n :]])


def _held(a: Array, b: Array, dt_s: float) -> tuple[Array, Array]:
    """Return the exact matrices of a sample with held inputs."""
    n, m = b.shape
    whole = expm(dt_s * np.block([[a, b], [np.zeros((m, n + m))]]))
    return whole[:n, :n].copy(), whole[:n, n:].copy()


def _series(ground: tuple[Array, Array], noise: Array, storeys: int, adapted: int = 0) -> Series:
    n = len(noise)
    of_loop = np.zeros((storeys, n)), np.zeros(n), np.zeros(n), np.zeros(n)
    return Series(*ground, noise, *of_loop, np.zeros((adapted, n)))


def _from(series: Series, first: int) -> Series:
    return Series(*(one[..., first:] for one in series))


def _figures(bench: DisplacementBenchmark, reference: Array, own: Array, series: Series) -> dict[str, float]:
    """Return the criteria of a run that reached the end of the record; `own`: the interface with its own specimen."""
    target = series.disp[0]
    tracking = tracking_criteria(target, series.measured, bench.dt_s, leads=False)
    response = response_criteria(reference, np.vstack([series.measured, series.disp[1:]]))
    (j4, j6, j7, *_), (j5, j8, j9, *_) = response.deviation, response.peak
    index = frequency_evaluation(target, series.measured, bench.dt_s, bench.spec.identified_band_hz[1])
    percent = [tracking.j2, tracking.j3, j4, j5, j6, j7, j8, j9]
    itself = (tracking_ratios(one, series.moved)[0] for one in (target, reference[0], own))
    numbers = [1e3 * tracking.j1_s, *(100.0 * one for one in percent), index.amplitude, 1e3 * index.delay_s,
               *(100.0 * one for one in itself), float(peak(series.force))]  # fmt: skip
    return dict(zip(FIGURES, map(float, numbers), strict=True))
