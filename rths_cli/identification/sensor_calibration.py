"""Calibrate sensors and weighed masses by what the record of an identification shows of them.

Table and floors are measured by different sensors, and a chain of storeys ties them together: far below its first mode
all floors move with the table, the shapes of its modes belong to its masses, and its phases leave no room for a sensor
that lags. A fit of the chain with free sensors therefore finds the ratios of the sensors' gains, of their AC corners
and of the masses, and the differences of their lags. What it cannot find, above all the gain that all sensors share and
the total mass, stays as declared, with the declared uncertainty, or a larger one where sensors or masses differ more
than declared: the result is the most probable one under independent normal priors, and its covariance that of the
posterior (A. Tarantola, Inverse Problem Theory, 2005, chapter 3).

A sensor is `gain (s + w) / (s + coupling w) exp(-late s)` times the declared one, whose AC corner is w. Residuals are
those of the samples and not of the corrected motions, which a greater gain would make smaller.

The alias of the held command in the table's samples is free as well: far below the table's resonance, where its
response grows with the square of frequency, a greater alias and a greater AC corner of the table look the same, and the
model of the table has taken one for the other. What it took is known: a table of displacement gain G whose sensor has
the corner k w instead of w answers (1 - (k - 1) w / s) G s^2, and the model's alias is too small by (k - 1) w G / dt.
The floors' samples hold no alias. So they show the alias, the alias shows the table's corner, and with the ratios of
the corners that of all sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.identification.least_squares import Solution, covariance, least_squares
from rths_cli.identification.results import Calibration
from rths_cli.identification.specimen_fit import (
    ABOVE_HIGHEST,
    Lines,
    Motion,
    Start,
    evaluated,
    least_samples,
    modal,
    modes_with,
    reach_of,
    residual_change,
    residual_of,
    stretches_of,
    transform,
    without_time,
)
from rths_cli.numerics.lti import Array, ComplexArray, Integers, Model
from rths_cli.rigs.description import Channel, RigInfo

STEP = 1e-5  # of a prior's standard uncertainty, over which slopes by masses are taken
DOUBTED = 5.0  # standard uncertainties of its prior from which a corner is doubted
FAR = 10.0  # standard uncertainties of its prior by which a parameter may differ from what is declared
ROUNDS = 4  # fits, each with the sizes of the residual that the one before left
CHAIN_STEP = 1e-7  # of the chain's parameters, for the slopes of what damping that couples modes adds
TOLERANCE = 1e-8
LINES = 17  # of which the size of a residual is the rms
SETTLED = 0.005  # half of the square of the standard uncertainties that a fit is off its minimum
SHARES = (1.0, 0.3, 0.1, 0.01)  # of a Gauss-Newton step, by which it is tried whether a fit has settled
SHOWN = 10.0  # information of a stretch, in units of the prior's, from which it shows a parameter better
# standard uncertainties of damping and stiffness that couple two modes of the chain, over the root of their own
COUPLED_DAMPING, COUPLED_STIFFNESS = 0.3, 0.01
ORDER = 4  # of the series for damping that couples modes
AT_ONCE = 16  # slopes that are projected together
ACROSS = 2e-4  # of a sensor's gain: 2 % of transverse sensitivity, and 1 % of the motion is across
BENT = 5e-4  # of a mass: joints that rub bend the shapes of modes, other than stiffness that couples them does
DECLARED = 8.0  # degrees of freedom of a declared standard uncertainty, reliable to a quarter (GUM, eq. G.3)
LEAST_SIZE = 1e-9  # of a residual, relative to the floors' motion


@dataclass(frozen=True)
class Priors:
    """Standard uncertainties of what is declared: gains (c,) and AC corners (c,) relative, lags (c,) in s, masses (n,)
    relative, and that of the table model's ripple in m/s^2 per V. 0: exactly as declared.

    `ripple_by_corner`: by how much that ripple is too small for a corner of the table that is greater by its own size,
    `ripple_error` its standard uncertainty beside that; both in m/s^2 per V.
    """

    gain: Array
    coupling: Array
    late_s: Array
    mass: Array
    ripple_m_s2_per_v: float = 0.0
    ripple_by_corner: float = 0.0
    ripple_error: float = np.inf

    @property
    def sizes(self) -> Array:
        """Return all of them and those of the couplings of modes (2 k,), (3 c + n + 1 + 2 k,)."""
        pairs = len(self.mass) * (len(self.mass) - 1) // 2
        couplings = np.repeat([COUPLED_DAMPING, COUPLED_STIFFNESS], pairs)
        return np.concatenate([self.gain, self.coupling, self.late_s, self.mass, [self.ripple_m_s2_per_v], couplings])

    @property
    def none_exact(self) -> bool:
        """Return whether no sensor and no mass is taken as exactly what it is declared to be."""
        return all(bool(sizes.all()) for sizes in (self.gain, self.coupling, self.late_s, self.mass))


def as_stated(priors: Priors) -> Calibration:
    """Return what is known of sensors and masses without a record: that they are as declared, and how uncertain."""
    c, n = len(priors.gain), len(priors.mass)
    spread = np.concatenate([priors.gain, priors.coupling, priors.late_s, priors.mass])
    return Calibration(
        np.ones(c), np.ones(c), np.zeros(c), np.ones(n), np.diag(spread**2),
        gain_widening=np.ones(c), mass_widening=np.ones(n),
    )  # fmt: skip


def priors_of(info: RigInfo, sensors_removed: bool, table: Model, ripple_error: float = np.inf) -> Priors:
    """Return the priors of a rig as declared; corners and lags only where the step corrects them.

    `ripple_error` is the standard uncertainty of the ripple of the table's model, fitted with the declared corner.
    """
    count, declared, dynamics = len(info.channels), info.uncertainty, float(sensors_removed)
    return Priors(
        np.array([channel.uncertainty for channel in info.channels]),
        np.full(count, declared.corner * dynamics),
        np.full(count, declared.skew_s * dynamics),
        np.array(declared.of_masses(count - 1)),
        ripple_prior(table, info.dt_s) * dynamics,
        2.0 * np.pi * info.channels[0].high_pass_hz * table.low_frequency_gain_m_per_v / info.dt_s,
        ripple_error,
    )


def ripple_prior(table: Model, dt_s: float) -> float:
    """Return a standard uncertainty of the alias's coefficient in m/s^2 per V, as large as any instant of sampling can
    make it: a command's change by 1 V makes the table's jerk jump by the gain of a model with one pole more than zeros,
    and within the interval the sample is off by up to a twelfth of that times the interval."""
    return abs(table.gain) * dt_s / 12.0


def calibrate(
    motions: Sequence[Motion], dt_s: float, masses_kg: Array, channels: Sequence[Channel], low_hz: float, start: Start,
    priors: Priors, high_hz: float = np.inf,
) -> Calibration:  # fmt: skip
    """Return the calibration of `fitted`."""
    return fitted(motions, dt_s, masses_kg, channels, low_hz, start, priors, high_hz).calibration


def fitted(
    motions: Sequence[Motion], dt_s: float, masses_kg: Array, channels: Sequence[Channel], low_hz: float, start: Start,
    priors: Priors, high_hz: float = np.inf,
) -> Fitted:  # fmt: skip
    """Return the chain with its sensors that motions of table and floors show, in declared units, without the
    staircase's alias.

    `masses_kg` (n,) are the weighed masses, lines from `low_hz` to the end of the excited band `high_hz`, or to
    ABOVE_HIGHEST times the highest natural frequency, are used. The random error is widened by the Birge ratio of
    stretches, as that of the specimen.
    """
    highest = ABOVE_HIGHEST * float(modal(masses_kg, start.stiffness_n_per_m)[0][-1]) / (2.0 * np.pi)
    highest = min(highest, high_hz)
    corners = 2.0 * np.pi * np.array([channel.high_pass_hz for channel in channels])
    problem = Problem(
        tuple(transform(motion, dt_s, (low_hz, highest)) for motion in motions), np.asarray(masses_kg, dtype=float),
        corners, priors, coupling_modes(np.asarray(masses_kg, dtype=float), start.stiffness_n_per_m),
    )  # fmt: skip
    chain = np.log(np.concatenate([start.stiffness_n_per_m, start.damping_ratio]))
    problem, at = replace(problem, start=chain), np.concatenate([chain, np.zeros(problem.free.size)])
    problem, found = _solved(problem, at)
    doubted = problem.doubted(found.parameters)
    if len(doubted):
        certain = replace(priors, coupling=np.zeros(len(channels)))
        problem = replace(problem, priors=certain)
        problem, found = _solved(problem, np.concatenate([chain, np.zeros(problem.free.size)]))
    at = found.parameters
    gain, mass = _spread(problem, found, problem.gains), _spread(problem, found, problem.masses)
    problem, at = problem.with_spreads(at, gain.factor, mass.factor)
    found = least_squares(problem.posterior, at, TOLERANCE, reach=problem.reach)
    spread = covariance(found.slopes, 1.0)
    to_go = _to_go(problem, found, spread)
    widened = _scatter(problem, motions, dt_s, (low_hz, highest), found.parameters)
    spread = spread @ problem.spread_of_pull(found, widened) @ spread
    left = priors.coupling if len(doubted) else np.zeros(len(channels))
    return Fitted(problem, found.parameters, spread, to_go, gain, mass, doubted, left)


def _solved(problem: Problem, at: Array) -> tuple[Problem, Solution]:
    """Return the problem with the sizes of its residuals, and its solution from a start (p,)."""
    for _ in range(ROUNDS):
        problem = replace(problem, sizes=problem.sizes_at(at))
        found = least_squares(problem.posterior, at, TOLERANCE, reach=problem.reach)
        at = found.parameters
    return problem, found


def _to_go(problem: Problem, found: Solution, spread: Array) -> float:
    """Return by how much half of the sum of squares falls still, by Gauss-Newton steps of several lengths.

    What a step is expected to bring is enough where it is little. Along a storey that is not seen a long step is
    expected to bring much, and brings nothing.
    """
    steepest = found.slopes @ found.residual
    expected = 0.5 * float(steepest @ spread @ steepest)
    if expected <= SETTLED:
        return expected
    step = -spread @ steepest
    step *= min(1.0, float(np.min(problem.reach / np.maximum(np.abs(step), problem.reach))))
    ends = [problem.posterior(found.parameters + share * step)[0] for share in SHARES]
    return max(0.0, *(0.5 * (float(found.residual @ found.residual) - float(end @ end)) for end in ends))


def calibrated(channels: Sequence[Channel], found: Calibration) -> tuple[Channel, ...]:
    """Return the channels (c,) as a calibration found them.

    What a sensor lags beyond its declared dynamics is given to its low pass, which far below its corner is a lag. Only
    differences of lags are known; where a channel would have to lead, all lag by so much more.
    """
    lags_s = [1.0 / (2.0 * np.pi * channel.low_pass_hz) if channel.low_pass_hz > 0.0 else 0.0 for channel in channels]
    lags = np.array(lags_s) + found.late_s - found.late_s.mean()
    lags -= min(float(lags.min()), 0.0) if found.late_s.any() else 0.0
    return tuple(
        replace(
            channel,
            sensitivity_v_per_unit=channel.sensitivity_v_per_unit * float(gain),
            high_pass_hz=channel.high_pass_hz * float(coupling),
            low_pass_hz=1.0 / (2.0 * np.pi * float(lag)) if lag > 0.0 else 0.0,
        )
        for channel, gain, coupling, lag in zip(channels, found.gain, found.coupling, lags, strict=True)
    )


@dataclass(frozen=True)
class Problem:
    """The fit of a chain with free sensors and masses.

    Parameters: logarithms of stiffnesses and damping ratios (2 n,), then what is free of gains (c,), corners (c,), lags
    (c,), masses (n,), ripple and couplings of modes (2 k,), each in units of its prior.
    """

    lines: tuple[Lines, ...]
    masses_kg: Array
    corners: Array  # (c,) rad/s
    priors: Priors
    beside: Array  # (k, n, n) N/m, of `coupling_modes`
    sizes: tuple[Array, ...] = ()  # (n, m) of residuals for each set of lines; (): 1
    start: Array | None = None  # (2 n,) of the chain's parameters, which they leave by no more than their reach

    @property
    def free(self) -> Integers:
        """Return the places of the priors that are not zero."""
        return np.flatnonzero(self.priors.sizes)

    @property
    def gains(self) -> Integers:
        """Return the places of the gains that are free among the parameters."""
        return self._places(0, len(self.corners))

    @property
    def masses(self) -> Integers:
        """Return the places of the masses that are free among the parameters."""
        first = 3 * len(self.corners)
        return self._places(first, first + len(self.masses_kg))

    def doubted(self, at: Array) -> Integers:
        """Return the channels whose AC corner is DOUBTED standard uncertainties off or more, on a rig that declares a
        gain or a mass exact: what is wrong of those is taken for a corner, far below the first mode."""
        c = len(self.corners)
        if self.priors.gain.all() and self.priors.mass.all():
            return np.zeros(0, dtype=int)
        corners = self._places(c, 2 * c)
        channels = self.free[corners - 2 * len(self.masses_kg)] - c
        return np.asarray(channels[np.abs(at[corners]) > DOUBTED])

    def _places(self, first: int, last: int) -> Integers:
        return 2 * len(self.masses_kg) + np.flatnonzero((self.free >= first) & (self.free < last))

    def with_spreads(self, at: Array, gain: Array, mass: Array) -> tuple[Problem, Array]:
        """Return the problem with larger priors of the free gains and masses, by factors, and its parameters."""
        scaled, gains, masses = at.copy(), self.priors.gain.copy(), self.priors.mass.copy()
        scaled[self.gains] /= gain
        scaled[self.masses] /= mass
        gains[gains > 0.0] *= gain
        masses[masses > 0.0] *= mass
        return replace(self, priors=replace(self.priors, gain=gains, mass=masses)), scaled

    @property
    def systematic(self) -> Array:
        """Return the standard uncertainties (3 c + n,) of gains, corners, lags and masses that no residual shows."""
        c = len(self.corners)
        return np.concatenate([np.full(c, ACROSS), np.zeros(2 * c), np.full(len(self.masses_kg), BENT)])

    @property
    def reach(self) -> Array:
        """Return the largest change of each parameter."""
        return np.concatenate([reach_of(len(self.masses_kg)), np.full(self.free.size, FAR)])

    def values(self, at: Array) -> tuple[Array, Array, Array, Array, float, Array, Array]:
        """Return logarithms of gains and of corners (c,), lags (c,) in s, logarithms of masses (n,), the change of the
        ripple in m/s^2 per V, damping (k,) and stiffness (k,) that couple modes."""
        priors, c = self.priors.sizes, len(self.corners)
        sizes = np.zeros(priors.size)
        sizes[self.free] = priors[self.free] * at[2 * len(self.masses_kg) :]
        ends = 3 * c + len(self.masses_kg)
        damping, stiffness = np.split(sizes[ends + 1 :], 2)
        return (
            sizes[:c],
            sizes[c : 2 * c],
            sizes[2 * c : 3 * c],
            sizes[3 * c : ends],
            float(sizes[ends]),
            damping,
            stiffness,
        )

    def residual(self, at: Array) -> Array:
        """Return the residual (m,) of the samples in its sizes."""
        masses_kg, theta = self._masses_kg(at), self._chain(at)
        return np.concatenate(
            [residual_of(moved, masses_kg, theta, self.beside) for moved, _ in self.without_sensors(at)]
        )

    def evaluated(self, at: Array) -> tuple[Array, Array]:
        """Return the residual (m,) of the samples in its sizes and its slopes (2 n + k, m) by stiffnesses, damping
        ratios and the stiffness that couples modes."""
        masses_kg, theta, coupled, each = self._masses_kg(at), self._chain(at), self.values(at)[5], []
        for moved, _ in self.without_sensors(at):
            left, slopes = without_time(evaluated([moved], masses_kg, theta, self.beside))
            if coupled.any():
                slopes += self._by_damping_of_another_chain(moved, masses_kg, theta, coupled)
            each.append(np.vstack([left, slopes]))
        both = np.hstack(each)
        return both[0], both[1:]

    def _chain(self, at: Array) -> Array:
        """Return the parameters (2 n + k,) of the chain and of the stiffness that couples its modes."""
        return np.concatenate([at[: 2 * len(self.masses_kg)], self.values(at)[6]])

    def _masses_kg(self, at: Array) -> Array:
        """Return the masses (n,)."""
        return np.asarray(self.masses_kg * np.exp(self.values(at)[3]))

    def without_sensors(self, at: Array) -> Iterator[tuple[Lines, ComplexArray]]:
        """Yield the lines as the table and the floors moved, without what damping that couples modes adds; a residual
        is judged in the signals of the floors' sensors, in its sizes. The second is the floors (n, m) with it."""
        gain, coupling, late_s, _, ripple, coupled, _ = self.values(at)
        for place, part in enumerate(self.lines):
            sensors = _responses(part.s, self.corners, gain, coupling, late_s - late_s[0])  # a common lag is unseen
            table = part.table if part.staircase is None else part.table - ripple * part.staircase
            weight = sensors[1:] / self.sizes[place] if self.sizes else sensors[1:]
            shown = part.floors / sensors[1:]
            moved = Lines(part.s, table / sensors[0], shown, weight=weight)
            if coupled.any():
                further = self._by_damping(moved, self._masses_kg(at), self._chain(at), coupled)
                moved = replace(moved, floors=shown - further)
            yield moved, shown

    def sizes_at(self, at: Array) -> tuple[Array, ...]:
        """Return the sizes (n, m) of the residuals of each set of lines: of each floor, the rms of LINES lines about
        each, without its own, which would weigh what the fit has come close to."""
        left, n, found, start = replace(self, sizes=()).residual(at), len(self.masses_kg), [], 0
        for part in self.lines:
            end = start + 2 * n * len(part.s)
            squares = np.sum(left[start:end].reshape(n, -1, 2) ** 2, axis=2) / 2.0
            free = 2.0 * squares.size / max(2.0 * squares.size - 3.0 * n - len(at), 1.0)
            around = free * _mean_around(squares, LINES)
            found.append(np.sqrt(np.maximum(around, (LEAST_SIZE / np.sqrt(left.size)) ** 2)))
            start = end
        return tuple(found)

    def spread_of_pull(self, found: Solution, widened: float = 1.0) -> Array:
        """Return the covariance (p, p) of the pull of residuals, `widened` times as large, and priors on the
        parameters.

        The pulls of different lines are independent, those of the floors at a line are not (H. White, Econometrica 48,
        1980, 817: no assumption on the sizes of residuals).
        """
        pulls, start, n = [], 0, len(self.masses_kg)
        for part in self.lines:
            end = start + 2 * n * len(part.s)
            each = found.slopes[:, start:end] * found.residual[start:end]
            pulls.append(each.reshape(len(each), n, -1, 2).sum(axis=(1, 3)))
            start = end
        pull, priors = widened * np.hstack(pulls), found.slopes[:, start:]
        return np.asarray(pull @ pull.T + priors @ priors.T)

    def posterior(self, at: Array) -> tuple[Array, Array]:
        """Return residuals in their sizes and deviations from the priors, with their slopes.

        The chain has priors as wide as its reach, so that a storey too stiff to be seen stays where it starts.
        """
        n, free, all_of = 2 * len(self.masses_kg), self.free.size, self.priors.sizes.size
        left, slopes = self.evaluated(at)
        rows = np.empty((n + free, left.size))
        rows[:n] = slopes[:n]
        stiffer = n + np.flatnonzero(self.free >= all_of - len(self.beside))
        rows[stiffer] = COUPLED_STIFFNESS * slopes[n:]
        masses = self.masses
        others = np.setdiff1d(np.arange(n, n + free), np.concatenate([masses, stiffer]))
        for place in masses:
            step = np.zeros(n + free)
            step[place] = STEP
            rows[place] = (self.residual(at + step) - self.residual(at - step)) / (2.0 * STEP)
        rows[masses] = self._without_linear_terms(at, rows[masses])
        self._by_lines(at, self.free[others - n], others, rows)
        size = np.concatenate([reach_of(len(self.masses_kg)), np.ones(free)])
        middle = np.concatenate([at[:n] if self.start is None else self.start, np.zeros(free)])
        taken, by_taken = self.taken(at)
        return (
            np.concatenate([left, (at - middle) / size, [taken]]),
            np.hstack([rows, np.diag(1.0 / size), by_taken[:, None]]),
        )

    def _without_linear_terms(self, at: Array, values: Array) -> Array:
        """Return changes (k, m) of the residual without what the linear terms can make of them."""
        masses_kg, theta, n, start, each = self._masses_kg(at), self._chain(at), len(self.masses_kg), 0, []
        for moved, _ in self.without_sensors(at):
            end = start + 2 * n * len(moved.s)
            floors = values[:, start:end].view(complex).reshape(len(values), n, len(moved.s)) / moved.weight
            still = np.zeros((len(values), len(moved.s)), dtype=complex)
            each.append(residual_change(moved, masses_kg, theta, self.beside, still, floors))
            start = end
        return np.hstack(each)

    def _by_lines(self, at: Array, parameters: Integers, places: Integers, rows: Array) -> None:
        """Write the residual's slopes (k, m) by parameters (k,) other than chain, masses and stiffness that couples
        modes to places of `rows`.

        The residual is linear in the lines, so that it changes as theirs do by what the sensors change in them.
        """
        masses_kg, theta, n, start = self._masses_kg(at), self._chain(at), len(self.masses_kg), 0
        for part, (moved, shown) in zip(self.lines, self.without_sensors(at), strict=True):
            end = start + 2 * n * len(part.s)
            left = residual_of(moved, masses_kg, theta, self.beside).view(complex).reshape(n, -1) / moved.weight
            for first in range(0, len(parameters), AT_ONCE):
                some = slice(first, first + AT_ONCE)
                changes = [self._change(at, part, moved, int(parameter)) for parameter in parameters[some]]
                tables, added, logs = (np.array(each) for each in zip(*changes, strict=True))
                of_floors = added + logs * (left - shown)
                rows[places[some], start:end] = residual_change(moved, masses_kg, theta, self.beside, tables, of_floors)
            start = end

    def _change(
        self, at: Array, part: Lines, moved: Lines, parameter: int
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return the slopes by a parameter, which counts as the priors, of the table's lines (m,), of what damping that
        couples modes takes off the floors' (n, m), and of the logarithms of the floors' sensors (n, m)."""
        masses_kg, theta, size = self._masses_kg(at), self._chain(at), self.priors.sizes[parameter]
        gain, coupling, _late_s, _, _ripple, coupled, _ = self.values(at)
        c, n, s = len(self.corners), len(self.masses_kg), part.s
        table, taken, logs = (np.zeros(shape, dtype=complex) for shape in (len(s), (n, len(s)), (n, len(s))))
        kind, channel = divmod(parameter, c)
        if parameter < 3 * c:
            w = self.corners[channel] * np.exp(coupling[channel])
            slope = size * (np.ones_like(s), -w / (s + w), -s)[kind]
            if channel > 0:
                logs[channel - 1] = slope
            elif kind == 2:
                logs -= slope  # lags of floors are those after the table's
            else:
                table = -slope * moved.table
        elif parameter == 3 * c + n and part.staircase is not None:
            sensor = _responses(s, self.corners[:1], gain[:1], coupling[:1], np.zeros(1))[0]
            table = -size * part.staircase / sensor
        elif parameter > 3 * c + n:
            one = np.zeros(len(coupled))
            one[parameter - 3 * c - n - 1] = size
            taken = -self._by_damping(moved, masses_kg, theta, coupled, one)
        if coupled.any() and table.any():
            taken = -self._by_damping(replace(moved, table=table), masses_kg, theta, coupled)
        return table, taken, logs

    def _by_damping(
        self, lines: Lines, masses_kg: Array, theta: Array, coupled: Array, change: Array | None = None
    ) -> ComplexArray:
        """Return what damping that couples modes adds to the floors' lines (n, m); with a `change` (k,) of `coupled`
        the slope of that along the change.

        `coupled` (k,): of each pair of modes over the root of the product of their own. Friction in joints and guides
        does not respect modes: what it adds lags, and would be taken for the lag of a sensor. The motion of the coupled
        modes is a Neumann series of ORDER terms: a damping matrix that adds no energy couples by less than one, and
        only one mode of a pair is in resonance.
        """
        omega, shapes = modes_with(masses_kg, theta, self.beside)
        s, own = lines.s, (2.0 * np.exp(theta[len(omega) : 2 * len(omega)]) * omega)[:, None]
        under, root = 1.0 / (s**2 + own * s + (omega**2)[:, None]), np.sqrt(own * own.T)
        by_rate = -s * under
        alone = -(masses_kg @ shapes)[:, None] * under * lines.table  # modal displacements relative to the table
        damping = _symmetric(coupled, len(omega)) * root
        other = None if change is None else _symmetric(change, len(omega)) * root
        moved, slope = alone, np.zeros_like(alone)
        for _ in range(ORDER):
            if other is not None:
                slope = by_rate * (other @ moved + damping @ slope)
            moved = alone + by_rate * (damping @ moved)
        return np.asarray(shapes @ (s**2 * (moved - alone if other is None else slope)))

    def _by_damping_of_another_chain(self, lines: Lines, masses_kg: Array, theta: Array, coupled: Array) -> Array:
        """Return the slopes (2 n + k, 2 n m) of a residual by what `_by_damping` takes off the floors' lines.

        Without them the slopes by masses and by stiffnesses would not cancel where both grow alike, and the record
        would seem to show the total mass.
        """
        ends = [theta + sign * step for step in CHAIN_STEP * np.eye(len(theta)) for sign in (1.0, -1.0)]
        more, less = (
            np.array([self._by_damping(lines, masses_kg, end, coupled) for end in ends])
            .reshape(len(theta), 2, len(masses_kg), -1)
            .swapaxes(0, 1)
        )
        floors, still = (less - more) / (2.0 * CHAIN_STEP), np.zeros((len(theta), len(lines.s)), dtype=complex)
        return residual_change(lines, masses_kg, theta, self.beside, still, floors)

    def taken(self, at: Array) -> tuple[float, Array]:
        """Return the change of the ripple beyond what the table's corner explains, in its uncertainty, and its slopes
        (2 n + free,)."""
        _, coupling, _, _, ripple, _, _ = self.values(at)
        sizes, by_corner = np.zeros(self.priors.sizes.size), self.priors.ripple_by_corner
        sizes[len(self.corners)] = -by_corner * np.exp(coupling[0]) * self.priors.coupling[0]
        sizes[3 * len(self.corners) + len(self.masses_kg)] = self.priors.ripple_m_s2_per_v
        slopes = np.concatenate([np.zeros(2 * len(self.masses_kg)), sizes[self.free]]) / self.priors.ripple_error
        return float((ripple - by_corner * np.expm1(coupling[0])) / self.priors.ripple_error), slopes


def coupling_modes(masses_kg: Array, stiffness_n_per_m: Array) -> Array:
    """Return stiffness matrices (k, n, n) in N/m, each of which couples two modes of a chain, by the root of their own.

    A base that pitches and hysteresis bend the shapes of modes, which would be taken for another ratio of masses.
    """
    omega, shapes = modal(masses_kg, stiffness_n_per_m)
    carried = masses_kg[:, None] * shapes * omega  # columns M phi w
    first, second = np.triu_indices(len(omega), 1)
    one = np.einsum("ik,jk->kij", carried[:, first], carried[:, second])
    return np.asarray(one + one.transpose(0, 2, 1))


def _symmetric(above: Array, n: int) -> Array:
    """Return the symmetric matrix (n, n) with these entries above its diagonal of zeros."""
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n, 1)] = above
    return matrix + matrix.T


def _responses(s: ComplexArray, corners: Array, gain: Array, coupling: Array, late_s: Array) -> ComplexArray:
    """Return what sensors (c,) make of the declared ones' signals at lines (m,), (c, m)."""
    w = corners[:, None]
    made = np.exp(gain)[:, None] * (s + w) / (s + w * np.exp(coupling)[:, None]) * np.exp(-late_s[:, None] * s)
    return np.asarray(made, dtype=complex)


def _scatter(
    problem: Problem, motions: Sequence[Motion], dt_s: float, band_hz: tuple[float, float], at: Array
) -> float:
    """Return by what factor stretches scatter about the common solution more than their own errors predict, at least 1.

    It is the Birge ratio of all that a stretch shows better than the priors do: the pulls of the stretches' residuals
    along the eigenvectors of their information over what their lines predict of them.
    """
    omega = modal(problem.masses_kg, np.exp(at[: len(problem.masses_kg)]))[0]
    ends_hz = np.minimum(omega / (2.0 * np.pi), band_hz[1] / ABOVE_HIGHEST)
    least = least_samples(ends_hz, dt_s, band_hz[0])
    pieces = [motion.cut(part) for motion in motions for part in stretches_of(motion.floors, False, least)]
    pieces = [piece for piece in pieces if piece.shows_floors]
    if len(pieces) < 2:
        return 1.0
    each = []
    for piece in pieces:
        part = replace(problem, lines=(transform(piece, dt_s, band_hz),), sizes=())
        part = replace(part, sizes=part.sizes_at(at))
        residual, slopes = (of[..., : part.lines[0].floors.size * 2] for of in part.posterior(at))  # without priors
        information, directions = np.linalg.eigh(slopes @ slopes.T)
        shown = directions[:, information > SHOWN]
        predicted = np.sum(shown * (part.spread_of_pull(Solution(at, residual, slopes)) @ shown), axis=0)
        each.append((shown.T @ (slopes @ residual)) ** 2 / predicted)
    squares = np.concatenate(each)
    return float(np.sqrt(max(np.mean(squares) / (1.0 - 1.0 / len(pieces)), 1.0))) if len(squares) else 1.0


@dataclass(frozen=True)
class Spread:
    """How far sensors (or masses) differ from each other, measured by what is declared of them.

    `factor` (k,): by which the declared uncertainty of each is multiplied, at least 1. `chance`: probability that those
    as declared differ as much or more.
    """

    factor: Array
    chance: float


def _spread(problem: Problem, found: Solution, places: Integers) -> Spread:
    """Return the spread of the parameters at `places`, which count in standard uncertainties of their priors.

    What the record shows of them, all but their common part, tells how far the declared uncertainty can be relied on;
    it is itself uncertain, as one from DECLARED degrees of freedom. The most probable factor by the evidence (D.J.C.
    MacKay, Neural Computation 4, 1992, 415, with a prior for the factor), one for all that are declared alike. Small
    differences are no evidence of a small common error: sensors that were compared with one standard agree.
    """
    from scipy.stats import chi2

    kinds = problem.free[places - 2 * len(problem.masses_kg)]
    declared, chance = problem.priors.sizes[kinds], 1.0
    share = declared / np.hypot(declared, problem.systematic[kinds])
    spread = covariance(found.slopes, 1.0)[places, places] if len(places) else np.zeros(0)
    factor = np.ones(len(places))
    for one in np.unique(declared):
        alike = declared == one
        squares = float(np.sum((share * found.parameters[places])[alike] ** 2))
        shown = float(np.sum(1.0 - spread[alike]))
        if shown > 0.5:
            factor[alike] = max(1.0, float(np.sqrt((DECLARED + squares) / (DECLARED + shown))))
            chance = min(chance, float(chi2.sf(squares, shown)))
    return Spread(factor, chance)


def _mean_around(values: Array, count: int) -> Array:
    """Return the means of up to `count` values (..., m) about each but its own, fewer at the ends."""
    m, half = values.shape[-1], count // 2
    sums = np.cumsum(np.concatenate([np.zeros((*values.shape[:-1], 1)), values], axis=-1), axis=-1)
    first, last = np.maximum(np.arange(m) - half, 0), np.minimum(np.arange(m) + half + 1, m)
    return np.asarray((sums[..., last] - sums[..., first] - values) / np.maximum(last - first - 1, 1))


@dataclass(frozen=True)
class Fitted:
    """A chain with its sensors as fitted: the most probable parameters (p,) and their covariance (p, p).

    `to_go`: by how much half of the sum of squares falls still by a Gauss-Newton step, 0 at its minimum; 0.5 is a step
    of one standard uncertainty.
    """

    problem: Problem
    at: Array
    spread: Array
    to_go: float
    gain_spread: Spread
    mass_spread: Spread
    doubted: Integers  # channels whose AC corner the record contradicts; all corners are as declared then
    corner_error: Array  # (c,) relative, of corners that were left as declared and not fitted

    @property
    def settled(self) -> bool:
        """Return whether no more than a tenth of a standard uncertainty is left to go."""
        return self.to_go <= SETTLED

    @property
    def calibration(self) -> Calibration:
        """Return gains, corners, lags and masses with their covariance, also of those that are as declared."""
        gain, coupling, late_s, mass, *_ = self.problem.values(self.at)
        shown, priors = 3 * len(self.problem.corners) + len(self.problem.masses_kg), self.problem.priors
        spread, c = self._covariance[:shown, :shown], len(gain)
        spread[range(c, 2 * c), range(c, 2 * c)] += self.corner_error**2
        left = np.clip(priors.sizes[:shown] ** 2 - spread.diagonal(), 0.0, self.problem.systematic**2)
        for kind in (slice(0, c), slice(3 * c, shown)):  # of differences: a common error is in the prior
            apart = np.eye(kind.stop - kind.start) - 1.0 / (kind.stop - kind.start)
            spread[kind, kind] += apart @ np.diag(left[kind]) @ apart
        of_gains, of_masses = np.ones(c), np.ones(len(mass))
        of_gains[priors.gain > 0.0], of_masses[priors.mass > 0.0] = self.gain_spread.factor, self.mass_spread.factor
        return Calibration(
            np.exp(gain), np.exp(coupling), late_s, np.exp(mass), spread,
            gain_widening=of_gains, mass_widening=of_masses,
        )  # fmt: skip

    @property
    def masses_kg(self) -> Array:
        """Return the masses (n,) of the floors."""
        return np.asarray(self.problem.masses_kg * self.calibration.mass)

    @property
    def stiffness_n_per_m(self) -> Array:
        """Return the storeys' stiffnesses (n,)."""
        return np.asarray(np.exp(self.at[: len(self.problem.masses_kg)]))

    @property
    def coupled_stiffness(self) -> tuple[Array, Array]:
        """Return the stiffness (k,) that couples each pair of modes, over the root of their own, and its covariance
        (k, k)."""
        first = len(self._covariance) - len(self.problem.beside)
        return self.problem.values(self.at)[6], self._covariance[first:, first:]

    @property
    def _covariance(self) -> Array:
        """Return the covariance of all parameters but those of the chain, also of those that are as declared."""
        n, priors, free = 2 * len(self.problem.masses_kg), self.problem.priors.sizes, self.problem.free
        full = np.zeros((priors.size, priors.size))
        full[np.ix_(free, free)] = self.spread[n:, n:] * np.outer(priors[free], priors[free])
        return full
