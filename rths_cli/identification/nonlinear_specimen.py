"""The specimen's storeys as springs that bend and joints that rub, from the records at low and at full level.

One chain with the same storeys makes both records. The force of a storey, which carries the inertia of the floors above
it, is the sum of a spring, dashpots, joints that stick like a spring over a drift before they slide, and springs of
either sign that are touched beyond a drift of either side:

    sum over j >= i of m_j a_j + k_i u_i + sum over all storeys of c_ij v_j
        + sum of joints of u_i + sum of b g(u_i) = 0,    g(u) = u - min(max(u, -h), h), u_i = x_i - x_(i-1).

Joints in parallel make any hysteresis that does not depend on the rate (W. D. Iwan, J. Appl. Mech. 33, 1966, 893), the
others any elastic spring that is the same to both sides. No law is assumed: drifts over which joints stick and beyond
which springs are touched are fixed multiples of the drift in the record at low level, and the sizes follow by least
squares from the Fourier lines of whole records: each line weighted by what white noise of all channels makes of the
equation (a drift is an acceleration over s^2), each record by what it leaves. A joint cannot push.

A linear equivalent of such a specimen holds at one level only. The chain itself holds at all levels that the records
contain, and is used to say what a test at another level will show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.identification.least_squares import linear, parts
from rths_cli.identification.results import NonlinearSpecimen
from rths_cli.identification.specimen_fit import Motion
from rths_cli.numerics.hysteresis import slid
from rths_cli.numerics.lti import Array, ComplexArray

STICKS = (0.03, 0.1, 0.3, 1.0)  # drifts over which joints stick, over the rms drift at low level
BENDS = (0.5, 1.0, 2.0, 4.0, 8.0)  # drifts beyond which springs are touched, over the same
RATE = 24.0  # sample rate of the forces of joints and bends, over the highest frequency
ENDS = 4  # number of powers of 1 / s that represent the ends of a record
ROUNDS = 4  # iterations of the records' weights
WORTH = 0.8  # laws are believed if they reduce what a linear storey leaves to this share, geometric mean of the records
REAL = 1e-6  # least residual, over the inertia
LOST = 1e-7  # what is smaller, relative to the whole, is what rounding makes of zero


@dataclass(frozen=True)
class _Equations:
    """Weighted lines of one record, (n, ...) by storey: the inertia it carries and what may balance it."""

    inertia: ComplexArray  # (n, m)
    drift: ComplexArray  # (n, m)
    velocity: ComplexArray  # (n, n, m): of all storeys, in each equation
    joints: ComplexArray  # (n, j, m) of 1 N
    bends: ComplexArray  # (n, b, m) of 1 N/m
    ends: ComplexArray  # (n, e, m)


@dataclass(frozen=True)
class _Storey:
    """What was found of a storey, and what it leaves of its equation's lines in each record."""

    spring: float
    dashpots: Array  # (n,)
    joints: Array  # (j,) N
    bends: Array  # (b,) N/m
    left: Array  # (records,)


def identify_nonlinear(
    loud: Sequence[Motion], quiet: Motion, dt_s: float, masses_kg: Array, stiffness_n_per_m: Array,
    band_hz: tuple[float, float],
) -> NonlinearSpecimen | None:  # fmt: skip
    """Return the specimen with the laws of its storeys, from the accelerations of records at full and at low level.

    `stiffness_n_per_m` (n,): of its linear equivalent, for the weights of lines.
    None where the storeys are linear as far as the records show, or where what explains them is no specimen: a storey
    without stiffness, dashpots that add energy.
    """
    masses, seen = np.asarray(masses_kg, dtype=float), (*loud, quiet)
    lines = [_Lines.of(motion, dt_s, band_hz) for motion in seen]
    rms_m = lines[-1].series().std(axis=1)
    sticks, bends = np.outer(rms_m, STICKS), np.outer(rms_m, BENDS)
    records = [_equations(each, masses, stiffness_n_per_m, sticks, bends) for each in lines]
    found = []
    for i in range(len(masses)):
        straight, bent = (_fitted(records, i, laws) for laws in (False, True))
        better = float(np.exp(np.mean(np.log(bent.left / straight.left))))
        found.append(bent if better <= WORTH else straight)
    if not any(each.joints.any() or each.bends.any() for each in found):
        return None
    dashpots = np.array([each.dashpots for each in found])
    laws = NonlinearSpecimen(
        stiffness_n_per_m=np.array([each.spring for each in found]),
        dashpots_n_s_per_m=0.5 * (dashpots + dashpots.T),
        joint_n=np.array([each.joints for each in found]),
        joint_m=sticks,
        bend_n_per_m=np.array([each.bends for each in found]),
        bend_m=bends,
    )
    return laws if laws.possible else None


@dataclass(frozen=True)
class _Lines:
    """Fourier lines of one record in a band."""

    s: ComplexArray  # (m,) rad/s
    accel: ComplexArray  # (c, m)
    first: int  # number of the first line
    count: int  # samples of the series

    @classmethod
    def of(cls, motion: Motion, dt_s: float, band_hz: tuple[float, float]) -> _Lines:
        """Return the lines of a record; its series are sampled RATE times as fast as the band ends."""
        samples = np.vstack([motion.table, motion.floors])
        n = samples.shape[1]
        frequency = np.arange(n // 2 + 1) / (n * dt_s)
        inside = np.flatnonzero((frequency >= band_hz[0]) & (frequency <= band_hz[1]))
        lines = np.fft.rfft(samples - samples.mean(axis=1, keepdims=True))[:, inside] / n
        return cls(2j * np.pi * frequency[inside], lines, int(inside[0]), min(n, int(RATE * band_hz[1] * n * dt_s)))

    @property
    def drift(self) -> ComplexArray:
        """Return the lines (n, m) of the storeys' drifts."""
        return np.asarray(np.diff(self.accel, axis=0) / self.s**2)

    def series(self) -> Array:
        """Return the storeys' drifts (n, count) in m."""
        whole = np.zeros((len(self.accel) - 1, self.count // 2 + 1), dtype=complex)
        whole[:, self.first : self.first + len(self.s)] = self.drift
        return np.asarray(np.fft.irfft(whole, self.count) * self.count)

    def of_series(self, forces: Array) -> ComplexArray:
        """Return the lines (..., m) of series (..., count)."""
        return np.asarray(np.fft.rfft(forces)[..., self.first : self.first + len(self.s)] / self.count)


def _equations(lines: _Lines, masses: Array, stiffness: Array, sticks: Array, bends: Array) -> _Equations:
    """Return the weighted lines of one record's equations; `sticks` (n, j) and `bends` (n, b) are drifts in m."""
    drifts, n = lines.series(), len(masses)
    above = np.array([masses[i + 1 :] @ masses[i + 1 :] for i in range(n)])
    weights = 1.0 / np.array([_noise(lines, *each) for each in zip(masses, above, stiffness, strict=True)])
    rubbed = [[slid(drift, reach) for reach in own] for drift, own in zip(drifts, sticks.tolist(), strict=True)]
    touched = drifts[:, None] - np.clip(drifts[:, None], -bends[..., None], bends[..., None])
    return _Equations(
        inertia=weights * np.array([masses[i:] @ lines.accel[1 + i :] for i in range(n)]),
        drift=weights * lines.drift,
        velocity=weights[:, None] * lines.drift * lines.s,
        joints=weights[:, None] * lines.of_series(np.array(rubbed)),
        bends=weights[:, None] * lines.of_series(touched),
        ends=weights[:, None] * np.array([lines.s**-power for power in range(ENDS)]),
    )


def _noise(lines: _Lines, mass: float, above: float, stiffness: float) -> Array:
    """Return what noise of 1 m/s^2 in all channels makes of a storey's equation (m,) in N; `above`: sum of the squared
    masses of the floors above that of the storey."""
    per_accel = stiffness / np.abs(lines.s) ** 2
    return np.asarray(np.sqrt((mass - per_accel) ** 2 + per_accel**2 + above))


def _span(rows: Array) -> Array:
    """Return an orthonormal basis (r, m) of what rows (n, m) span; r < n where some are zero or depend on others."""
    size = np.linalg.norm(rows, axis=1)
    kept = rows[size > 0.0] / size[size > 0.0, None]  # a bend that no drift reaches has a row of zeros
    _, values, basis = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(basis[values > LOST * values[0]])


def _fitted(records: Sequence[_Equations], i: int, laws: bool) -> _Storey:
    """Return storey i, with or without joints and bends, from all records at once."""
    from scipy.optimize import nnls

    n, (j, b) = len(records[0].drift), (each.shape[1] for each in (records[0].joints, records[0].bends))
    wanted = [parts(-record.inertia[i]) for record in records]
    storey = [parts(np.vstack([r.drift[i : i + 1], r.velocity[i], *([r.bends[i]] if laws else [])])) for r in records]
    joints = [parts(record.joints[i]) for record in records]
    ends = [parts(record.ends[i]) for record in records]
    sizes = np.array([np.linalg.norm(each) for each in wanted])
    left = sizes
    for _ in range(ROUNDS):
        weight = [np.sqrt(each.size) / max(by, REAL * of) for each, by, of in zip(wanted, left, sizes, strict=True)]
        apart = [np.hstack([w * rows * (rows is end) for w, rows in zip(weight, ends, strict=True)]) for end in ends]
        free = np.vstack([np.hstack([w * rows for w, rows in zip(weight, storey, strict=True)]), *apart])
        target = np.hstack([w * rows for w, rows in zip(weight, wanted, strict=True)])
        rubbing = np.hstack([w * rows for w, rows in zip(weight, joints, strict=True)])
        pushed = np.zeros(j)
        if laws:
            basis = _span(free)
            alone = rubbing - (rubbing @ basis.T) @ basis
            size = np.linalg.norm(alone, axis=1)
            seen = size > LOST * np.linalg.norm(rubbing, axis=1)  # others never slid, or are what a spring is
            if seen.any():
                shares = nnls((alone[seen] / size[seen, None]).T, target - (target @ basis.T) @ basis)[0]
                pushed[seen] = shares / size[seen]
        factors = linear(free, target - pushed @ rubbing)
        residual = target - pushed @ rubbing - factors @ free
        pieces = np.split(residual, np.cumsum([rows.size for rows in wanted])[:-1])
        left = np.array([np.linalg.norm(piece) / w for piece, w in zip(pieces, weight, strict=True)])
    bends = factors[1 + n : 1 + n + b] if laws else np.zeros(b)
    return _Storey(float(factors[0]), factors[1 : 1 + n], pushed, bends, left)
