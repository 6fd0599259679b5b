"""SIM and SIM-DELAY of a building whose computed floors are a program.

SIM of an OpenSees model is monolithic: OpenSees integrates the whole building, experimental floors as masses and
zero-length elements. Any other program is asked at explicit steps, as every one is in SIM-DELAY
(programs/integration.py). Steps are halved and the responses extrapolated, as for a method of second order
(Richardson), until the response converges. One process solves a response once, whoever asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from rths_cli.analysis.sim import LawHistory, Response, base_shear_n, check_size, checked_record
from rths_cli.analysis.sim_delay import DelayedResponse
from rths_cli.errors import InputError
from rths_cli.numerics.content_key import content_key
from rths_cli.numerics.lti import Array
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.programs import Program
from rths_cli.structure import Building
from rths_cli.structure.programs import storey_forces
from rths_cli.structure.storey_laws import PROGRAM

RESPONSE_S = 3600.0  # for one response
ACCURATE = 1e-3  # of the peaks, to which steps are refined; by as much as the last halving, the error is far less
MOST_STEPS = 4  # to a sample
UNUSABLE = 1e-2
RUNAWAY = 1000.0  # times SIM's largest acceleration, which cuts SIM-DELAY
LEAST_DRIFT = 0.02  # of a storey's largest drift, over which its tangent is taken
HIGHEST_RAD = 0.4  # per step, of the highest mode of the tangent at rest: explicit steps are not larger
SMOOTH_RAD = 0.15  # the same, up to which SIM-DELAY takes several samples at a step
MOST_AT_A_STEP = 8  # samples
_SOLVED = SharedValues(6)  # responses of this process


def simulate_with_program(building: Building, dt_s: float, ground_accel_m_s2: Array) -> Response:
    """Solve the whole building from rest for a record (n,) in m/s^2 linear between samples.

    `error_estimate`: a third of the largest change, relative to the peak of each quantity, of the extrapolated response
    when steps were last halved. Raises InputError where the program fails or steps do not converge.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    check_size(len(building.M), len(record), dt_s)
    _check_specimen(building)
    relative, error = _SOLVED.get("sim", _asked(building, dt_s, record), lambda: _solved(building, dt_s, record))
    accel = relative[2] + record
    return Response(
        relative[0], relative[1], accel, base_shear_n(building, accel), error, laws=_laws(building, relative, accel)
    )


def _asked(building: Building, dt_s: float, record: Array, *further: object) -> bytes:
    """Return the key of a response: the content of the program's file, the building's matrices, the record."""
    assert building.program is not None
    stated, numerical = building.program.description, building.numerical
    own = (numerical.masses_kg, numerical.C, numerical.K)
    return content_key(stated, stated.content(), own, building.M, building.C, building.K, dt_s, record, *further)


def _solved(building: Building, dt_s: float, record: Array) -> tuple[Array, float]:
    """Return the response (3, q, n) relative to the ground, and its error."""
    assert building.program is not None
    of_program = _by_opensees if building.program.description.kind == "opensees" else _explicit

    def solve(every: int, steps: int) -> Array:
        """Return the response at each `every`-th sample with absolute accelerations, some steps to such a sample."""
        ground = _coarser(record, every)
        found = of_program(building, every * dt_s, steps, ground)
        found[2] += ground
        return found

    most = MOST_STEPS * _first(building, dt_s)
    found, error = refined(solve, 1 if of_program is _by_opensees else most // MOST_STEPS, most)
    found[2] -= record
    return found, error


def _coarser(record: Array, every: int) -> Array:
    """Return the record at each `every`-th sample, a power of two, whose straight lines are nearest to those of the
    record in the mean square: what lies between the samples has its effect."""
    while every > 1:
        n = len(record)
        whole = np.append(record, record[-1:]) if n % 2 == 0 else record
        sums = 4.0 * whole
        sums[1:] += whole[:-1]
        sums[:-1] += whole[1:]
        sums[[0, -1]] -= 2.0 * whole[[0, -1]]  # half an element at the ends
        load = sums[::2].copy()
        load[1:] += 0.5 * sums[1::2]
        load[:-1] += 0.5 * sums[1::2]
        bands = np.vstack([np.full(len(load), 8.0), np.full(len(load), 2.0)])
        bands[0, [0, -1]] = 4.0
        record = solveh_banded(bands, load, lower=True)
        every //= 2
        record = record[: (n + 1) // 2]
    return record


def _check_specimen(building: Building) -> None:
    """Raise InputError for experimental storeys with laws, which no reference here computes."""
    if (building.laws.code != PROGRAM).any():
        raise InputError(
            "structure.numerical: a program stands below a linear specimen only; this one has laws (specimen_laws of a "
            "virtual rig, or as identified)"
        )


def _highest(building: Building) -> float:
    """Return the highest angular frequency in rad/s of the tangent at rest."""
    root = 1.0 / np.sqrt(np.diag(building.M))
    return float(np.sqrt(np.linalg.eigvalsh(root[:, None] * building.K * root)[-1]))


def _first(building: Building, dt_s: float) -> int:
    """Return the least number of steps to a sample with which an explicit integration is stable and has some
    accuracy."""
    return max(1, int(np.ceil(_highest(building) * dt_s / HIGHEST_RAD)))


def refined(solve: Callable[[int, int], Array], first: int, most: int) -> tuple[Array, float]:
    """Return a response (., ., n), and its error relative to the peaks, from steps that were halved until what is
    extrapolated from the last two is accurate, or a sample has `most` or more; the first ones are `first` at every
    fourth and every second sample. An implicit method is stable with one, an explicit one needs what `_first` gives."""
    coarse, fine, steps = solve(2, first), solve(1, first), first
    before, found = extrapolated(solve(4, first), coarse), extrapolated(coarse, fine)
    error = _change(found[..., ::2], before)
    while error > ACCURATE and steps < most:
        steps, before, coarse = 2 * steps, found, fine
        fine = solve(1, steps)
        found = extrapolated(coarse, fine)
        error = _change(found, before)
    if not error <= UNUSABLE:
        raise InputError(
            f"SIM: the response of the whole building is known to {error:.1g} of its peak only with {steps} steps to a "
            f"sample (at most {UNUSABLE:g}); raise sample_rate_hz"
        )
    return found, error


def extrapolated(coarse: Array, fine: Array) -> Array:
    """Return the response (., ., n) to which two of second order converge, the first with steps twice as long; it may
    be known at every second sample alone, between which their difference is a straight line."""
    if coarse.shape == fine.shape:
        return fine + (fine - coarse) / 3.0
    added = np.zeros_like(fine)
    added[..., ::2] = (fine[..., ::2] - coarse) / 3.0
    between = added[..., 1::2]
    following = added[..., 2::2]
    between[...] = 0.5 * added[..., 0 : 2 * between.shape[-1] : 2]
    between[..., : following.shape[-1]] += 0.5 * following
    if following.shape[-1] < between.shape[-1]:  # the last sample has no following one
        between[..., -1] *= 2.0
    return fine + added


def _change(fine: Array, coarse: Array) -> float:
    """Return a third of the largest difference of two responses (., ., n), over the peaks of each quantity."""
    peaks = np.maximum(np.abs(fine).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    return float((np.abs(fine - coarse) / peaks).max()) / 3.0


def _by_opensees(building: Building, dt_s: float, steps: int, record: Array) -> Array:
    """Return displacement, velocity and acceleration (3, q, n) relative to the ground, by OpenSees alone."""
    assert building.program is not None
    p, masses = len(building.numerical.masses_kg), np.diag(building.M).copy()
    masses[:p] -= building.numerical.masses_kg  # those are in the model
    springs = building.K.copy()
    springs[:p, :p] -= building.numerical.K
    with Program(building.program.description) as program:
        return np.asarray(
            program.asked("response", RESPONSE_S, masses, springs, building.C, dt_s, steps, record), dtype=float
        )


def _explicit(building: Building, dt_s: float, steps: int, record: Array) -> Array:
    """Return the same by explicit steps, at each of which the program is asked."""
    assert building.program is not None
    p, springs = len(building.numerical.masses_kg), building.K.copy()
    springs[:p, :p] -= building.numerical.K
    with Program(building.program.description) as program:
        asked = (p, np.diag(building.M).copy(), building.C, springs, dt_s, steps, record)
        return np.asarray(program.asked("whole", RESPONSE_S, *asked), dtype=float)


def _laws(building: Building, relative: Array, abs_accel: Array) -> LawHistory:
    """Return what the program's forces are beside its linear part, as forces of storeys, and their work: what the
    equation of motion lacks without them."""
    p = len(building.numerical.masses_kg)
    lacking = -(building.M @ abs_accel + building.C @ relative[1] + building.K @ relative[0])
    return _history(lacking[:p], relative[0])


def _history(floor_forces_n: Array, disp_m: Array) -> LawHistory:
    """Return storey forces and work (n_storeys, n) of forces (p, n) on the lowest floors."""
    p, forces, work = len(floor_forces_n), np.zeros_like(disp_m), np.zeros_like(disp_m)
    forces[:p] = storey_forces(floor_forces_n)
    drift = np.diff(disp_m[:p], axis=0, prepend=np.zeros((1, disp_m.shape[1])))
    mean = 0.5 * (forces[:p, 1:] + forces[:p, :-1])
    work[:p, 1:] = np.cumsum(mean * np.diff(drift, axis=1), axis=1)
    return LawHistory(forces, work)


def met_tangents(building: Building, sim: Response) -> Array:
    """Return the least and the greatest stiffness (p, 2) in N/m that the program's forces added to each storey's in
    SIM: slopes of the storey's force over drifts of a stated share of its largest one."""
    p = len(building.numerical.masses_kg)
    assert sim.laws is not None
    disp, found = sim.rel_disp_m[:p], np.zeros((p, 2))
    drift = np.diff(disp, axis=0, prepend=np.zeros((1, disp.shape[1])))
    for i in range(p):
        chord = LEAST_DRIFT * float(np.abs(drift[i]).max())
        slopes = _slopes(drift[i], sim.laws.force_n[i], chord)
        found[i] = min(0.0, *slopes), max(0.0, *slopes)
    return found


def _slopes(drift_m: Array, force_n: Array, chord_m: float) -> list[float]:
    """Return the slopes of a force over a drift, each over the next way of at least `chord_m` in one direction."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(drift_m))) != 0) + 1
    found = [0.0]
    for start, end in zip([0, *turns.tolist()], [*turns.tolist(), len(drift_m) - 1], strict=True):
        at = start
        while at < end:
            ways = np.abs(drift_m[at + 1 : end + 1] - drift_m[at])
            far = np.flatnonzero(ways >= chord_m)
            if chord_m <= 0.0 or far.size == 0:
                break
            to = at + 1 + int(far[0])
            found.append(float((force_n[to] - force_n[at]) / (drift_m[to] - drift_m[at])))
            at = to
    return found


def simulate_delayed_with_program(
    building: Building, dt_s: float, ground_accel_m_s2: Array, delay_s: float, sim: Response
) -> DelayedResponse:
    """Solve the divided building, whose program gets the base shear `delay_s` late, by explicit steps.

    An absolute acceleration beyond 1000 times SIM's peak cuts the response. Raises InputError as
    `simulate_with_program`.
    """
    record = checked_record(dt_s, ground_accel_m_s2)
    if delay_s == 0:
        same = {field.name: getattr(sim, field.name) for field in fields(sim)}
        return DelayedResponse(**same, substep_s=dt_s, diverged_at_s=None)
    return _SOLVED.get(
        "sim_delay", _asked(building, dt_s, record, delay_s), lambda: _delayed(building, dt_s, record, delay_s, sim)
    )


def _delayed(building: Building, dt_s: float, record: Array, delay_s: float, sim: Response) -> DelayedResponse:
    largest = RUNAWAY * max(float(np.abs(sim.abs_accel_m_s2).max()), 1e-3)
    first, n = _first(building, dt_s), len(record)
    every = 1 if first > 1 else _samples_at_a_step(building, dt_s, delay_s)
    coarse, coarse_shear, end = _divided(
        building, 2 * every * dt_s, first, _coarser(record, 2 * every), delay_s, largest
    )
    fine, fine_shear, known = _divided(building, every * dt_s, first, _coarser(record, every), delay_s, largest)
    both = min(end, (known + 1) // 2)
    error = _change(fine[..., : 2 * both : 2], coarse[..., :both])
    if known == fine.shape[-1] and end == coarse.shape[-1]:
        fine, fine_shear = extrapolated(coarse, fine), extrapolated(coarse_shear, fine_shear)
    found, shear = _between(fine, every, known, n), _between(fine_shear, every, known, n)
    known = min(known * every, n)
    p, numerical = len(building.numerical.masses_kg), building.numerical
    late = np.interp(dt_s * np.arange(n) - delay_s, dt_s * np.arange(n), shear, left=0.0)
    forces = -(numerical.masses_kg[:, None] * found[2, :p] + numerical.C @ found[1, :p] + numerical.K @ found[0, :p])
    forces[-1] += late
    history = _history(forces, found[0])
    for series in (found, shear[None], history.force_n, history.work_j):
        series[..., known:] = np.nan
    at_s = None if known == n else known * dt_s
    return DelayedResponse(
        found[0], found[1], found[2], shear, error, laws=history, substep_s=every * dt_s / first, diverged_at_s=at_s
    )


def _samples_at_a_step(building: Building, dt_s: float, delay_s: float) -> int:
    """Return how many samples a step may take: every mode moves little in it, and the delay is two of them or more."""
    found, highest = 1, _highest(building)
    while found < MOST_AT_A_STEP and 2 * found * dt_s * max(highest / SMOOTH_RAD, 2.0 / delay_s) <= 1.0:
        found *= 2
    return found


def _between(series: Array, every: int, known: int, n: int) -> Array:
    """Return a series of each `every`-th sample (., m), smooth and known so far, at every sample (., n)."""
    if every == 1:
        return series
    found = np.zeros((*series.shape[:-1], n))
    if known > 1:
        spline = CubicSpline(every * np.arange(known), series[..., :known], axis=-1)
        last = min(n, every * known)
        found[..., :last] = spline(np.arange(last))
    return found


def _divided(
    building: Building, dt_s: float, steps: int, record: Array, delay_s: float, largest: float
) -> tuple[Array, Array, int]:
    assert building.program is not None
    numerical, specimen = building.numerical, building.specimen
    parts = (specimen.masses_kg, specimen.C, specimen.K)
    with Program(building.program.description) as program:
        found, shear, known = program.asked(
            "divided", RESPONSE_S, numerical.masses_kg, numerical.C, parts, building.interface_experimental_mass_kg,
            delay_s, dt_s, steps, record, largest,
        )  # fmt: skip
    return found, shear, int(known)
