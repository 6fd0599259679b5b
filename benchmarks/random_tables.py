"""Tables nobody has looked at: identify 30 random virtual rigs and judge each model by what it was not fitted to.

    python benchmarks/random_tables.py [--seed N] [--count N]

Per rig: the verdict, the fit error, the error against a second record (noise, other seed, 300 s), against the plant's
own linearisation without friction, and the specimen's errors in units of the stated uncertainty. Beside them what
others make of the same record: plain H1, and a rational fit of it by AAA and by vector fitting.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import numpy as np
from options import arguments, parsed

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.identify_on_rig import evaluated, measure
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.frequency_response import estimate, over_model
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import FitError, Identification
from rths_cli.identification.table_fit import rms, within
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.rigs.virtual.plant import accelerations, continuous
from rths_cli.structure import storey_matrix

SHORT = ("--count", "1")
PRINTS = "^accepted: 1 of 1"  # the short form at its end

RIGS, FIRST_SEED, OTHER_SEED, OTHER_DURATION_S = 30, 1000, 77, 300
BAND_HZ, MID_HZ = (0.7, 11.0), (2.0, 10.0)
PEER_BAND_HZ = (0.5, 30.0)


@dataclass(frozen=True)
class Drawn:
    """A random rig: what its loop, mass and friction are, and the floors on it."""

    loop_hz: float
    loop_ratio: float
    mass_kg: float
    coulomb_n: float
    masses_kg: Array
    stiffness_n_per_m: Array
    damping_ratios: Array
    frequencies_hz: Array


def draw(seed: int) -> Drawn:
    """Draw a rig: inner loop 8-25 Hz, damping 0.4-0.9, mass 4-12 kg, friction 0-1.5 N, 1-3 storeys of 0.5-5 %."""
    random = np.random.default_rng(seed)
    floors = int(random.integers(1, 4))
    masses = random.uniform(4.0, 7.0, floors)
    first_hz = random.uniform(2.5, 4.0)
    shape = random.uniform(0.8, 1.2, floors)
    omega = frequencies(masses, shape)
    stiffness = shape * (2.0 * np.pi * first_hz / omega[0]) ** 2
    return Drawn(
        loop_hz=random.uniform(8.0, 25.0),
        loop_ratio=random.uniform(0.4, 0.9),
        mass_kg=random.uniform(4.0, 12.0),
        coulomb_n=random.uniform(0.0, 1.5),
        masses_kg=masses,
        stiffness_n_per_m=stiffness,
        damping_ratios=random.uniform(0.005, 0.05, floors),
        frequencies_hz=frequencies(masses, stiffness) / (2.0 * np.pi),
    )


def frequencies(masses_kg: Array, stiffness_n_per_m: Array) -> Array:
    """Return natural frequencies in rad/s, ascending."""
    root = np.sqrt(masses_kg)
    return np.sqrt(np.linalg.eigvalsh(storey_matrix(stiffness_n_per_m) / np.outer(root, root)))


def setup_of(drawn: Drawn, *more: str) -> Setup:
    """Return the default case on a drawn rig."""

    def listed(values: Array) -> str:
        return "[" + ",".join(repr(float(value)) for value in values) + "]"

    physics = (
        f"table.physics={{loop_frequency_hz: {drawn.loop_hz}, loop_damping_ratio: {drawn.loop_ratio}, moving_mass_kg: "
        f"{drawn.mass_kg}, coulomb_n: {drawn.coulomb_n}, loop_specimen_mass_kg: {float(drawn.masses_kg.sum())}}}"
    )
    structure = (
        "structure={numerical: {masses_kg: [6.93], stiffness_n_per_m: [7354]}, experimental: {masses_kg: "
        f"{listed(drawn.masses_kg)}, stiffness_n_per_m: {listed(drawn.stiffness_n_per_m)}, damping_ratios: "
        f"{listed(drawn.damping_ratios)}}}, damping_levels: {{low: {{dashpots_n_s_per_m: [22]}}}}}}"
    )
    return make_setup(load_cases(["el_centro_low_ff_fb"], (physics, structure, *more))[0])


def linearised(setup: Setup, frequency_hz: Array) -> ComplexArray:
    """Return the response of the plant's equations without friction, declared delay included."""
    a, b_u, b_n, *_ = continuous(setup.case.table.physics, setup.building.specimen)
    rows, _ = accelerations(a, b_n, len(setup.floor_masses_kg))
    s = 2j * np.pi * frequency_hz
    states = np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b_u[:, None].astype(complex))
    delay = (setup.rig.latency_samples + 0.5) * setup.rig.dt_s
    return (rows[0] @ states)[:, 0] * np.exp(-s * delay)


def figures(error: ComplexArray, frequency_hz: Array) -> FitError:
    """Return rms and largest in 0.7-11 Hz and rms in 2-10 Hz of a relative error."""
    inside, mid = within(frequency_hz, BAND_HZ), within(frequency_hz, MID_HZ)
    return FitError(rms(error[inside]), float(np.abs(error[inside]).max()), rms(error[mid]))


def second_record(drawn: Drawn, found: Identification) -> FitError:
    """Return the model's error against a record with another seed: its response over the model's, less one."""
    other = setup_of(drawn, f"identification.seed={OTHER_SEED}", f"identification.duration_s={OTHER_DURATION_S}")
    records = measure(other, lambda _: None).records
    over = over_model(found.best, records, (0.5, 60.0), 20.0)
    return figures(1.0 / over.response - 1.0, over.frequency_hz)


def against_truth(model: Model, setup: Setup) -> FitError:
    """Return the model's error against the linearised plant."""
    f = np.arange(0.5, 60.0, 0.05)
    return figures(model.response(f) / linearised(setup, f) - 1.0, f)


def peers(record: Record, setup: Setup) -> dict[str, FitError]:
    """Return what others make of the table's channel: plain H1 by Welch's method, AAA and vector fitting of it."""
    plain = estimate([record], setup.rig.dt_s, PEER_BAND_HZ, 20.0)[0]
    truth = linearised(setup, plain.frequency_hz)
    found = {"H1": plain.response}
    poles = 2 * len(setup.floor_masses_kg) + 3
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found |= {"AAA": by_aaa(plain, poles), "VF": by_vector_fitting(plain, poles)}
    return {name: figures(value / truth - 1.0, plain.frequency_hz) for name, value in found.items()}


def by_aaa(frf: Frf, poles: int) -> ComplexArray:
    """Fit the displacement response by scipy's AAA with conjugate data; NaN where scipy has none."""
    try:
        from scipy.interpolate import AAA
    except ImportError:
        return np.full(len(frf.response), np.nan, dtype=complex)
    s = 2j * np.pi * frf.frequency_hz
    over = frf.response / s**2
    fitted = AAA(np.concatenate([s, s.conj()]), np.concatenate([over, over.conj()]), max_terms=poles + 1)
    return fitted(s) * s**2


def by_vector_fitting(frf: Frf, poles: int) -> ComplexArray:
    """Fit the displacement response by scikit-rf's vector fitting; NaN where it is not installed."""
    try:
        import skrf
        from skrf.vectorFitting import VectorFitting
    except ImportError:
        return np.full(len(frf.response), np.nan, dtype=complex)
    s = 2j * np.pi * frf.frequency_hz
    over = frf.response / s**2
    network = skrf.Network(f=frf.frequency_hz, f_unit="hz", s=(over / np.abs(over).max())[:, None, None])
    fit = VectorFitting(network)
    fit.vector_fit(n_poles_real=1, n_poles_cmplx=(poles - 1) // 2, fit_constant=True, fit_proportional=False)
    return fit.get_model_response(0, 0, frf.frequency_hz) * np.abs(over).max() * s**2


@dataclass(frozen=True)
class Row:
    """What came of one rig."""

    drawn: Drawn
    found: Identification | None
    fault: str
    second: FitError | None
    truth: FitError | None
    peers: dict[str, FitError]
    ratios: Array  # (modes, 4): frequency and damping, error over value, error over stated standard uncertainty
    poles: Array  # error of each pole's frequency over its stated standard uncertainty


def judged(seed: int) -> Row:
    """Identify one rig and judge what was found."""
    drawn = draw(seed)
    setup = setup_of(drawn)
    try:
        measured = measure(setup, lambda _: None)
        found = evaluated(setup, measured)
    except RthsError as error:
        return Row(drawn, None, str(error), None, None, {}, np.zeros((0, 4)), np.zeros(0))
    second, truth = second_record(drawn, found), against_truth(found.best, setup)
    specimen = found.specimen
    assert specimen is not None
    hz = specimen.natural_frequency_hz - drawn.frequencies_hz
    ratio = specimen.damping_ratio - drawn.damping_ratios
    ratios = np.column_stack(
        [hz / drawn.frequencies_hz, ratio / drawn.damping_ratios, hz / specimen.frequency_error_hz,
         ratio / specimen.damping_error]
    )  # fmt: skip
    return Row(drawn, found, "", second, truth, peers(measured.records[0], setup), ratios, pole_errors(found, setup))


def pole_errors(found: Identification, setup: Setup) -> Array:
    """Return (identified - true frequency) / standard uncertainty of each pole, matched to the linearised plant's."""
    from scipy.optimize import linear_sum_assignment

    a, *_ = continuous(setup.case.table.physics, setup.building.specimen)
    values = np.linalg.eigvals(a)
    values = values[values.imag >= 0.0]
    true_hz, true_ratio = np.abs(values) / (2.0 * np.pi), -values.real / np.abs(values)
    mine = [root for root in found.roots if root.kind == "pole"]
    ratio = [1.0 if np.isnan(root.damping_ratio) else root.damping_ratio for root in mine]
    cost = np.abs(np.log(np.divide.outer([root.frequency_hz for root in mine], true_hz)))
    rows, columns = linear_sum_assignment(cost + np.abs(np.subtract.outer(ratio, true_ratio)))
    return np.array(
        [(mine[i].frequency_hz - true_hz[j]) / mine[i].frequency_error_hz for i, j in zip(rows, columns, strict=True)]
    )


def cell(error: FitError | None) -> str:
    """Return rms and largest in per cent."""
    return (
        f"{'-':>13}" if error is None or np.isnan(error.rms) else f"{100 * error.rms:6.2f} {100 * error.largest:6.2f}"
    )


def line(number: int, row: Row) -> str:
    """Return the table's line of one rig."""
    d = row.drawn
    rig = f"{number:>3} {d.loop_hz:5.1f} {d.loop_ratio:5.2f} {d.mass_kg:5.1f} {d.coulomb_n:5.2f} {len(d.masses_kg):>3}"
    if row.found is None:
        return f"{rig}  {row.fault}"
    verdict = f"{row.found.verdict.feedforward_hz[1]:5.1f}" if row.found.accepted else "  no "
    others = " ".join(cell(row.peers.get(name)) for name in ("H1", "AAA", "VF"))
    return f"{rig} {verdict} {cell(row.found.best_error)} {cell(row.second)} {cell(row.truth)}  {others}"


def summary(rows: list[Row]) -> list[str]:
    """Return how many were accepted, the worst of those, and how often the truth lay within the uncertainty."""
    accepted = [row for row in rows if row.found is not None and row.found.accepted]
    ratios, poles = np.vstack([row.ratios for row in rows]), np.concatenate([row.poles for row in rows])
    inside = np.mean(np.abs(ratios[:, 2:]) <= 2.0, axis=0)
    rounded = [f"{100 * np.abs(ratios[:, i]).max():.4f} %" for i in range(2)]
    worst = {name: max((getattr(row, name) for row in accepted), key=lambda e: e.rms) for name in ("second", "truth")}
    largest = {name: max(getattr(row, name).largest for row in accepted) for name in ("second", "truth")}
    stable = all(
        row.found.best.poles.real.max() < 0 and row.found.best.zeros[2:].real.max() < 0
        for row in rows
        if row.found is not None
    )
    return [
        f"accepted: {len(accepted)} of {len(rows)}; model and inverse stable in all: {'yes' if stable else 'NO'}",
        *(
            f"accepted models against the {text}: worst rms {100 * worst[name].rms:.2f} %, largest "
            f"{100 * largest[name]:.2f} % (limits {100 * LIMITS.rms:g} and {100 * LIMITS.largest:g})"
            for name, text in (("second", "second record"), ("truth", "linearised plant"))
        ),
        f"specimen: frequency within {rounded[0]}, damping ratio within {rounded[1]} of the true values;",
        f"  the true value lies within 2 stated standard uncertainties in {inside[0]:.0%} (frequency) and "
        f"{inside[1]:.0%} (damping) of {len(ratios)} modes",
        f"table: the true frequency of a pole lies within 2 stated standard uncertainties for "
        f"{np.mean(np.abs(poles) <= 2.0):.0%} of {len(poles)} poles",
    ]


def refused(rows: list[Row]) -> list[str]:
    """Return for each rejected rig whether a fit that starts at the true roots misses the same limit."""
    lines = []
    for number, row in enumerate(rows, 1):
        if row.found is not None and not row.found.accepted:
            setup = setup_of(row.drawn)
            f = row.found.frfs[0].frequency_hz
            alias = row.found.best.sampled_response(f) - row.found.best.response(f)
            ideal = figures((linearised(setup, f) + alias) / row.found.frfs[0].response - 1.0, f)
            reasons = "; ".join(row.found.reasons)
            lines.append(f"rig {number} rejected: {reasons}; the true structure misses by {cell(ideal).strip()} %")
    return lines


def main() -> None:
    """Print the table."""
    start = time.monotonic()
    asked = parsed(arguments(__doc__, FIRST_SEED, RIGS), SHORT)
    print(
        "error |model / response - 1| in 0.7-11 Hz in %, rms and largest; H1, AAA and VF (vector fitting) on the same"
    )
    print("record, against the true linear table")
    print("     loop  loop  mass frict flo-   fit    fit to FRF second record  true, linear ", end="")
    print("            H1           AAA            VF")
    print("  #    Hz ratio    kg     N ors  to Hz    rms    max    rms    max    rms    max", end="")
    print("     rms    max    rms    max    rms    max")
    rows = []
    for number in range(asked.count):
        rows.append(judged(asked.seed + number))
        print(line(number + 1, rows[-1]), flush=True)
    print("\n".join([*refused(rows), *summary(rows)]))
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
