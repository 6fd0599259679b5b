"""Which explicit scheme for storeys with laws: operator splitting on the exact linear part, CR, KR-alpha or Newmark?

    python benchmarks/integration_schemes.py [--seconds 20]

The paper's building (low damping, 30 % of El Centro) with a law in storey 1, by each scheme in plain numpy, against
SIM for the same samples. First table: largest error of a storey's displacement and of its acceleration, RMS over RMS,
by law and step. Second table: stiffest tangent at which an undamped storey stays stable, over its stiffness at rest.
Last: work per step. Nothing is random. Sources: Chen and Ricles, J. Eng. Mech. 134(8), 2008; Kolay and Ricles,
Earthquake Eng. Struct. Dyn. 43(9), 2014; Newmark, J. Eng. Mech. Div. 85(EM3), 1959.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from options import arguments, parsed
from scipy.linalg import expm

from rths_cli.analysis.references import reference_of
from rths_cli.case.load import load_cases
from rths_cli.experiment.setup import make_setup
from rths_cli.numerics.lti import Array

STIFFNESS, YIELD_M, HARDENING = 7353.98, 0.002, 0.05
GAP_M, CONTACT, CUBIC = 0.003, 7000.0, 2e8
STEPS_S = 0.0005, 0.001, 0.002, 0.004
LIMIT_STEPS_S = 0.0005, 0.002, 0.008
MASS_KG = 6.93
RHO = 1.0, 0.5, 0.0  # spectral radius of KR-alpha at infinite frequency
SCHEMES = ("splitting", "CR", *(f"KR {rho:g}" for rho in RHO), "Newmark")


@dataclass
class Law:
    """A law of storey 1: the force in N beside its spring for a drift in m, from rest, drift by drift."""

    stated: str
    force: Callable[[float, float], tuple[float, float]]  # drift's change, memory -> force without drift, memory
    memory: float = field(default=0.0)
    drift_m: float = field(default=0.0)

    def __call__(self, drift_m: float) -> float:
        """Return the force at the next drift and go on to it."""
        change, self.drift_m = drift_m - self.drift_m, drift_m
        value, self.memory = self.force(change, self.memory)
        return value if math.isfinite(value) else 0.0


def bilinear(change_m: float, z_m: float) -> tuple[float, float]:
    """Return (1 - a) k z for the elastic, perfectly plastic z; the spring beside it is a k u."""
    z_m = min(max(z_m + change_m, -YIELD_M), YIELD_M)
    return (1.0 - HARDENING) * STIFFNESS * z_m, z_m


def bouc_wen(change_m: float, z_m: float) -> tuple[float, float]:
    """Return the same for Bouc-Wen's z with n = 1 and beta = gamma, exact for a drift that goes one way."""
    if z_m * change_m < 0.0:  # back to zero with slope one
        back = math.copysign(min(abs(z_m), abs(change_m)), change_m)
        z_m, change_m = z_m + back, change_m - back
    if change_m != 0.0:
        end = math.copysign(YIELD_M, change_m)
        z_m = end - (end - z_m) * math.exp(-abs(change_m) / YIELD_M)
    return (1.0 - HARDENING) * STIFFNESS * z_m, z_m


def gap(change_m: float, drift_m: float) -> tuple[float, float]:
    """Return the force of a spring beyond a gap."""
    drift_m += change_m
    return CONTACT * (max(drift_m - GAP_M, 0.0) + min(drift_m + GAP_M, 0.0)), drift_m


def cubic(change_m: float, drift_m: float) -> tuple[float, float]:
    """Return the force of a cubic spring."""
    drift_m += change_m
    return CUBIC * drift_m**3, drift_m


YIELDS = f"yield_displacement_m: {YIELD_M}, hardening: {HARDENING}"
LAWS: dict[str, tuple[str, Callable[[float, float], tuple[float, float]], float]] = {  # with the share of the spring
    "bilinear": (f"{{kind: bilinear, {YIELDS}}}", bilinear, HARDENING),
    "Bouc-Wen": (f"{{kind: bouc_wen, {YIELDS}}}", bouc_wen, HARDENING),
    "gap": (f"{{kind: elastic_gap, gap_m: {GAP_M}, contact_n_per_m: {CONTACT}}}", gap, 1.0),
    "cubic": (f"{{kind: cubic, cubic_n_per_m3: {CUBIC}, largest_drift_m: 0.02}}", cubic, 1.0),
}


@dataclass(frozen=True)
class Building:
    """M, C and K at rest (n, n); the law replaces the spring of storey 1 but for `share` of it."""

    M: Array
    C: Array
    K: Array
    share: float = 1.0

    def restoring(self, law: Law | None) -> Callable[[Array], Array]:
        """Return the function of the displacements (n,) that gives the restoring forces (n,); no law: those of K."""
        if law is None:
            return lambda x: np.asarray(self.K @ x)
        rest = self.K.copy()
        rest[0, 0] -= (1.0 - self.share) * STIFFNESS

        def force(x: Array) -> Array:
            made = rest @ x
            made[0] += law(float(x[0]))
            return np.asarray(made)

        return force


def explicit_newmark(b: Building, restoring: Callable[[Array], Array], push: Array, dt: float) -> tuple[Array, Array]:
    """Return displacements and relative accelerations (n, count) for forces (n, count)."""
    solved = np.linalg.inv(b.M + 0.5 * dt * b.C)
    x, v = np.zeros(len(b.M)), np.zeros(len(b.M))
    a = np.linalg.solve(b.M, push[:, 0])
    rows = [(x, a)]
    for k in range(1, push.shape[1]):
        x = x + dt * v + 0.5 * dt**2 * a
        half = v + 0.5 * dt * a
        a = solved @ (push[:, k] - b.C @ half - restoring(x))
        v = half + 0.5 * dt * a
        rows.append((x, a))
    return _stacked(rows)


def kr_alpha(
    b: Building, restoring: Callable[[Array], Array], push: Array, dt: float, rho: float
) -> tuple[Array, Array]:
    """Return the same by KR-alpha. Its matrices are those of the building at rest."""
    am, af = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    gamma = 0.5 - am + af
    beta = 0.5 * (0.5 + gamma)
    inverse = np.linalg.inv(b.M + gamma * dt * b.C + beta * dt**2 * b.K)
    one = inverse @ b.M
    two = (0.5 + gamma) * one
    three = inverse @ (am * b.M + af * gamma * dt * b.C + af * beta * dt**2 * b.K)
    solved = np.linalg.inv(b.M @ (np.eye(len(b.M)) - three))
    kept = b.M @ three
    x, v = np.zeros(len(b.M)), np.zeros(len(b.M))
    a, held = np.linalg.solve(b.M, push[:, 0]), restoring(x)
    rows = [(x, a)]
    for k in range(1, push.shape[1]):
        x, before, was = x + dt * v + dt**2 * two @ a, v, held
        v = v + dt * one @ a
        held = restoring(x)
        load = (1.0 - af) * (push[:, k] - b.C @ v - held) + af * (push[:, k - 1] - b.C @ before - was)
        a = solved @ (load - kept @ a)
        rows.append((x, a))
    return _stacked(rows)


def chen_ricles(b: Building, restoring: Callable[[Array], Array], push: Array, dt: float) -> tuple[Array, Array]:
    """Return the same by CR. Its matrices are those of the building at rest."""
    alpha = 4.0 * np.linalg.solve(4.0 * b.M + 2.0 * dt * b.C + dt**2 * b.K, b.M)
    solved = np.linalg.inv(b.M)
    x, v = np.zeros(len(b.M)), np.zeros(len(b.M))
    a = solved @ push[:, 0]
    rows = [(x, a)]
    for k in range(1, push.shape[1]):
        x, v = x + dt * v + dt**2 * alpha @ a, v + dt * alpha @ a
        a = solved @ (push[:, k] - b.C @ v - restoring(x))
        rows.append((x, a))
    return _stacked(rows)


def splitting(b: Building, restoring: Callable[[Array], Array], push: Array, dt: float) -> tuple[Array, Array]:
    """Return the same by operator splitting: the building at rest moves by its matrix exponential under forces that are
    straight lines, the law's among them, which is evaluated at the displacement that its last two values predict."""
    n, solved = len(b.M), np.linalg.inv(b.M)
    chain = np.zeros((4 * n, 4 * n))
    chain[:n, n : 2 * n], chain[n : 2 * n, :n], chain[n : 2 * n, n : 2 * n] = np.eye(n), -solved @ b.K, -solved @ b.C
    chain[n : 2 * n, 2 * n : 3 * n], chain[2 * n : 3 * n, 3 * n :] = solved, np.eye(n)
    moved = expm(chain * dt)[: 2 * n]
    end = moved[:, 3 * n :] / dt
    start = moved[:, 2 * n : 3 * n] - end
    state, g, before = np.zeros(2 * n), np.zeros(n), np.zeros(n)  # g: restoring forces beside those of K
    rows = [(state[:n], solved @ push[:, 0])]
    for k in range(1, push.shape[1]):
        known = moved[:, : 2 * n] @ state + start @ (push[:, k - 1] - g) + end @ push[:, k]
        predicted = known - end @ (2.0 * g - before)
        g, before = restoring(predicted[:n]) - b.K @ predicted[:n], g
        state = known - end @ g
        x, v = state[:n], state[n:]
        rows.append((x, solved @ (push[:, k] - b.C @ v - b.K @ x - g)))
    return _stacked(rows)


def _stacked(rows: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    return np.array([x for x, _ in rows]).T, np.array([a for _, a in rows]).T


def integrate(
    name: str, b: Building, restoring: Callable[[Array], Array], push: Array, dt: float
) -> tuple[Array, Array]:
    """Return displacements and relative accelerations (n, count) by a scheme of SCHEMES."""
    if name.startswith("KR"):
        return kr_alpha(b, restoring, push, dt, float(name.split()[1]))
    return {"splitting": splitting, "CR": chen_ricles, "Newmark": explicit_newmark}[name](b, restoring, push, dt)


def errors(law: str, dt: float, seconds: float) -> dict[str, tuple[float, float]]:
    """Return the largest error of displacement and of absolute acceleration in a storey by scheme, RMS over RMS."""
    stated, force, share = LAWS[law]
    case = load_cases(["el_centro_low_ff_fb"], (f"structure.numerical.law=[{stated}]",))[0]
    setup = make_setup(case)
    every = round(dt / setup.rig.dt_s)
    ground = setup.motion.accel_m_s2[: round(seconds / setup.rig.dt_s) : every]
    whole = setup.building
    sim = reference_of(whole).sim(whole, dt, ground)
    building = Building(whole.M, whole.C, whole.K, share)
    push = -np.diag(whole.M)[:, None] * ground
    found = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for name in SCHEMES:
            x, a = integrate(name, building, building.restoring(Law(stated, force)), push, dt)
            found[name] = _off(x, sim.rel_disp_m), _off(a + ground, sim.abs_accel_m_s2)
    return found


def _off(found: Array, wanted: Array) -> float:
    return float(np.max(np.sqrt(np.mean((found - wanted) ** 2, axis=1) / np.mean(wanted**2, axis=1))))


def stable(name: str, factor: float, dt: float) -> bool:
    """Tell whether an undamped storey whose tangent is `factor` times the stiffness at rest does not grow."""
    b = Building(np.array([[MASS_KG]]), np.zeros((1, 1)), np.array([[STIFFNESS]]))
    push = np.zeros((1, 3000))
    push[0, :2] = 1.0

    with np.errstate(over="ignore", invalid="ignore"):
        x, _ = integrate(name, b, lambda x: factor * STIFFNESS * x, push, dt)
    early, late = np.abs(x[0, 10:800]).max(), np.abs(x[0, -800:]).max()
    return bool(late <= 1.5 * early)


def limit(name: str, dt: float, most: float = 1e7) -> float:
    """Return the largest tangent over the stiffness at rest at which a storey is stable, 0 if it never is."""
    if not stable(name, 1.0, dt):
        return 0.0
    low, high = 1.0, 2.0
    while stable(name, high, dt):
        low, high = high, 2.0 * high
        if high > most:
            return math.inf
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(name, middle, dt) else (low, middle)
    return low


def main() -> None:
    """Print the tables."""
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parsed(parser).seconds
    print(f"{'law':<10}{'step ms':>8}" + "".join(f"{name:>18}" for name in SCHEMES))
    for law in LAWS:
        for dt in STEPS_S:
            found = errors(law, dt, seconds)
            cells = (f"{found[name][0]:.1e} / {found[name][1]:.1e}" for name in SCHEMES)
            print(f"{law:<10}{1e3 * dt:>8g}" + "".join(f"{cell:>18}" for cell in cells), flush=True)
    print(f"\n{'stiffest':<10}{'step ms':>8}{'1 + 4 m / (k dt^2)':>20}" + "".join(f"{name:>12}" for name in SCHEMES))
    for dt in LIMIT_STEPS_S:
        analytic = 1.0 + 4.0 * MASS_KG / (STIFFNESS * dt**2)
        cells = "".join(f"{limit(name, dt):>12.5g}" for name in SCHEMES)
        print(f"{'':<10}{1e3 * dt:>8g}{analytic:>20.5g}{cells}", flush=True)
    print(
        "\nmultiplications per step of n storeys, beside one evaluation of each law: splitting 4 n^2 + 6 n q for q laws"
    )
    print("  (its matrices are made before the run), CR 4 n^2, KR-alpha 7 n^2, Newmark 3 n^2; C and K taken as full")


if __name__ == "__main__":
    main()
