"""Do the stated uncertainties of an identification hold the truth? Laboratories and rigs, identified and not played.

    python benchmarks/stated_uncertainties.py FILE --kind laboratory --count 60   identify, keep a line of each
    python benchmarks/stated_uncertainties.py --summary FILE...                   figures of the lines that are there

Kinds: `laboratory` is aps400_laboratory, another one for each seed, with another excitation: what friction adds to the
response follows the excitation, and would be the same in all laboratories with the same one; `rig` a random linear
table with dry friction and a random linear specimen (benchmarks/random_tables.py, from seed 1000); `virtual` is
aps400_virtual, another noise for each seed. A seed that has its line is not identified again.

The truth is the linear part of the rig's equations of motion: table in slip, joints in slip, storeys at small drift,
amplifier without cross-over (docs/background/identification.md). Its eigenvalues are made here by generalised
coordinates, independently of the rig's own code. Poles of the table are those of the whole rig, natural frequencies and
damping ratios of the specimen those with the deck held. Poles that were identified are matched to true ones.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from laboratories import deviations
from options import arguments, parsed
from random_tables import FIRST_SEED, draw, setup_of
from scipy.linalg import eigvals
from scipy.optimize import linear_sum_assignment

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.identify_on_rig import evaluated, measure
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.rigs.from_case import true_values

SHORT = ("lines.jsonl", "--kind", "virtual", "--count", "1")
PRINTS = "^virtual"  # the short form at its end

CASE, G = "el_centro_low_ff_fb", 9.80665


def setup_for(kind: str, number: int) -> Setup:
    """Return the case of a laboratory or rig."""
    if kind == "rig":
        return setup_of(draw(FIRST_SEED + number))
    laboratory = ["table=aps400_laboratory", f"identification.seed={number}"]
    table = {"laboratory": laboratory, "virtual": []}[kind]
    return make_setup(load_cases([CASE], [*table, f"seed={number}"])[0], ("model",))


def linear_part(setup: Setup, held: bool) -> ComplexArray:
    """Return the eigenvalues of the linear part: of the whole rig, or of specimen and pitch with the deck `held`.

    Coordinates: displacements of coil and deck, pitch, drifts of the floors; then the drive's force. `coupling` is what
    the weights on the pitched table add.
    """
    physics, specimen = setup.case.table.physics, setup.building.specimen
    values, stated = true_values(setup.case, setup.rig), setup.case.table.imperfections

    def value(key: str) -> float:
        return float(values[key][0]) if key in values else 0.0

    n = len(specimen.masses_kg)
    floors = specimen.masses_kg * (1.0 + values.get("masses.weighing_error", np.zeros(n)))
    deck_rate, pitch_rate = (2.0 * np.pi * value(f"{part}.frequency_hz") for part in ("deck", "pitch"))
    moving = physics.moving_mass_kg + setup.building.interface_experimental_mass_kg
    coil = stated.deck.coil_mass_kg if deck_rate > 0.0 else 0.0
    deck = moving - coil
    # displacements of the masses (coil, deck, floors) and the pitch by the coordinates x, x_d, th, u_1 ... u_n
    size, first = 3 + n, 3
    heights = np.cumsum(np.broadcast_to(values["pitch.storey_height_m"], (n,))) if pitch_rate > 0.0 else np.zeros(n)
    shapes = np.zeros((3 + n, size))
    shapes[:3, :3] = np.eye(3)
    shapes[3:, 1], shapes[3:, 2], shapes[3:, first:] = 1.0, heights, np.eye(n)
    inertia = stated.pitch.inertia_kg_m2 if pitch_rate > 0.0 else 1.0
    M = shapes.T @ np.diag([coil if coil > 0.0 else 1.0, deck, inertia, *floors]) @ shapes
    K, C = np.zeros((size, size)), np.zeros((size, size))
    K[first:, first:], C[first:, first:] = specimen.K, specimen.C
    K[1, 1], C[1, 1] = value("suspension.stiffness_n_per_m"), physics.viscous_n_s_per_m
    if pitch_rate > 0.0:
        rigid = inertia + float(floors @ heights**2)
        K[2, 2], C[2, 2] = rigid * pitch_rate**2, 2.0 * stated.pitch.damping_ratio * rigid * pitch_rate
        weights = np.array([coil, deck, 0.0, *floors])
        reached = shapes.copy()
        reached[:, 2] = 0.0  # the moment of a weight is that about the axis: its arm is its displacement
        tilted = G * weights @ reached
        K[2] -= tilted
        K[:, 2] -= tilted
    free = [i for i in range(size) if not (i == 2 and pitch_rate == 0.0) and not (i == 0 and coil == 0.0)]
    if coil > 0.0:
        bare = physics.moving_mass_kg - coil
        spring, dashpot = bare * deck_rate**2, 2.0 * stated.deck.damping_ratio * bare * deck_rate
        pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
        K[:2, :2] += spring * pair
        C[:2, :2] += dashpot * pair
    if held:
        free = [i for i in free if i > 1]
        return _eigenvalues(M[np.ix_(free, free)], C[np.ix_(free, free)], K[np.ix_(free, free)])
    return _with_drive(setup, M, C, K, free, 0 if coil > 0.0 else 1)


def _eigenvalues(M: Array, C: Array, K: Array) -> ComplexArray:
    """Return the eigenvalues of M x'' + C x' + K x = 0."""
    n, eye = len(M), np.eye(len(M))
    a = np.block([[np.zeros((n, n)), eye], [-K, -C]])
    b = np.block([[eye, np.zeros((n, n))], [np.zeros((n, n)), M]])
    return np.asarray(eigvals(a, b), dtype=complex)


def _with_drive(setup: Setup, M: Array, C: Array, K: Array, free: list[int], driven: int) -> ComplexArray:
    """Return the eigenvalues with the displacement loop closed around coordinate `driven` by a lagging force."""
    physics, n = setup.case.table.physics, len(free)
    loop_kg = physics.moving_mass_kg + setup.building.interface_experimental_mass_kg + physics.loop_specimen_mass_kg
    omega, place = 2.0 * np.pi * physics.loop_frequency_hz, free.index(driven)
    a, b = np.zeros((2 * n + 1, 2 * n + 1)), np.eye(2 * n + 1)
    a[:n, n : 2 * n], b[n : 2 * n, n : 2 * n] = np.eye(n), M[np.ix_(free, free)]
    a[n : 2 * n, :n], a[n : 2 * n, n : 2 * n] = -K[np.ix_(free, free)], -C[np.ix_(free, free)]
    a[n + place, -1] = 1.0
    a[-1, place], a[-1, n + place] = -loop_kg * omega**2, -2.0 * loop_kg * physics.loop_damping_ratio * omega
    a[-1, -1], b[-1, -1] = -1.0, physics.actuator_time_constant_s
    return np.asarray(eigvals(a, b), dtype=complex)


def compared(setup: Setup, found: Identification) -> dict[str, list[list[float]]]:
    """Return identified value, truth and stated standard uncertainty of each thing that was identified, by quantity."""
    rows: dict[str, list[list[float]]] = {}
    for name, value, truth, error in _poles(found, linear_part(setup, held=False)):
        rows.setdefault(name, []).append([value, truth, error])
    held = linear_part(setup, held=True)
    held = held[held.imag > 0.0]
    held = held[np.argsort(np.abs(held))]
    for name, fitted in (("specimen", found.specimen), ("free vibration", found.free_vibration)):
        for mode in range(len(fitted.natural_frequency_hz) if fitted else 0):
            assert fitted is not None
            hz, damping_ratio = float(np.abs(held[mode]) / (2.0 * np.pi)), float(-held[mode].real / np.abs(held[mode]))
            rows.setdefault(f"{name} Hz", []).append(
                [float(fitted.natural_frequency_hz[mode]), hz, float(fitted.frequency_error_hz[mode])]
            )
            rows.setdefault(f"{name} damping", []).append(
                [float(fitted.damping_ratio[mode]), damping_ratio, float(fitted.damping_error[mode])]
            )
    if found.friction is not None:
        rows["friction in slip V"] = [
            [found.friction.sliding_v or np.nan, sliding_friction_v(setup), found.friction.sliding_error_v or np.nan]
        ]
    return rows


def _poles(found: Identification, true: ComplexArray) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, identified value, truth and standard uncertainty of each pole that has a true one of its kind.

    A pair may be two real poles: it is compared with complex and with two real ones. A rig may have more poles than its
    model, and a model a lag that stands for several.
    """
    slow = -true[true.imag == 0.0].real
    both = [(float(np.sqrt(a * b)), float((a + b) / (2.0 * np.sqrt(a * b)))) for a, b in combinations(slow, 2)]
    pairs = np.array([*((abs(root), -root.real / abs(root)) for root in true[true.imag > 0.0]), *both])
    mine = [root for root in found.roots if root.kind == "pole"]
    mine_pairs = [root for root in mine if not np.isnan(root.damping_ratio)]
    lags = [root for root in mine if np.isnan(root.damping_ratio)]
    cost = [
        [abs(np.log(2.0 * np.pi * root.frequency_hz / pair[0])) + abs(root.damping_ratio - pair[1]) for pair in pairs]
        for root in mine_pairs
    ]
    for i, j in zip(*linear_sum_assignment(np.array(cost)), strict=True):
        root, (omega, ratio) = mine_pairs[i], pairs[j]
        yield "table pole Hz", root.frequency_hz, float(omega / (2.0 * np.pi)), root.frequency_error_hz
        yield "table pole damping", root.damping_ratio, float(ratio), root.damping_error
    if lags and len(slow):
        far = np.abs(np.log(np.divide.outer([2.0 * np.pi * root.frequency_hz for root in lags], slow)))
        for i, j in zip(*linear_sum_assignment(far), strict=True):
            yield "table real pole Hz", lags[i].frequency_hz, float(slow[j] / (2.0 * np.pi)), lags[i].frequency_error_hz


def sliding_friction_v(setup: Setup) -> float:
    """Return the dry friction of the table in slip as an equivalent change of the command in V."""
    physics = setup.case.table.physics
    loop_kg = physics.moving_mass_kg + setup.building.interface_experimental_mass_kg + physics.loop_specimen_mass_kg
    stiffness = loop_kg * (2.0 * np.pi * physics.loop_frequency_hz) ** 2
    return float(physics.coulomb_n / (stiffness * abs(physics.gain_m_per_v)))


def identified(kind: str, number: int) -> dict[str, Any]:
    """Return the figures of one laboratory or rig, or why it has none."""
    line: dict[str, Any] = {"kind": kind, "number": number}
    try:
        setup = setup_for(kind, number)
        found = evaluated(setup, measure(setup, lambda _: None))
    except RthsError as error:
        return {**line, "failed": str(error)}
    return {
        **line, "accepted": found.accepted, "rows": compared(setup, found), "deviations": deviations(setup, found),
    }  # fmt: skip


def told(lines: list[dict[str, Any]]) -> None:
    """Print coverage, rms and median size of deviations of each quantity."""
    good = [line for line in lines if "rows" in line]
    print(
        f"{len(lines)} identified, {sum(line['accepted'] for line in good)} accepted, {len(lines) - len(good)} failed"
    )
    print(f"{'':<32}{'count':>6}{'2 sigma':>9}{'rms z':>8}{'median |error|':>16}{'median uncertainty':>20}")
    for name in sorted({name for line in good for name in line["rows"]}):
        value, truth, error = np.array([row for line in good for row in line["rows"].get(name, [])]).T
        z = (value - truth) / error
        off, stated = np.median(np.abs(value / truth - 1.0)), np.median(error / truth)
        print(f"{name:<32}{len(z):>6}{np.mean(np.abs(z) <= 2.0):>9.3f}{np.sqrt(np.mean(z**2)):>8.2f}"
              f"{100 * off:>14.4f} %{100 * stated:>18.4f} %")  # fmt: skip
    for name in sorted({name for line in good for name in line["deviations"]}):
        z = np.concatenate([line["deviations"].get(name, []) for line in good])
        print(f"{name:<32}{len(z):>6}{np.mean(np.abs(z) <= 2.0):>9.3f}{np.sqrt(np.mean(z**2)):>8.2f}")


def main() -> int:
    """Identify or tell; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--summary", action="store_true")
    parser.add_argument("--kind", choices=("laboratory", "rig", "virtual"), default="laboratory")
    parser.add_argument("--seed", "--first", dest="first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    asked = parsed(parser, SHORT)
    kept = [json.loads(text) for path in asked.files if path.exists() for text in path.read_text().splitlines()]
    if not asked.summary:
        done = {(line["kind"], line["number"]) for line in kept}
        for number in range(asked.first, asked.first + asked.count):
            if (asked.kind, number) not in done:
                kept.append(identified(asked.kind, number))
                with asked.files[0].open("a") as file:
                    file.write(json.dumps(kept[-1]) + "\n")
    for kind in sorted({line["kind"] for line in kept}):
        print(kind)
        told([line for line in kept if line["kind"] == kind])
    return 0


if __name__ == "__main__":
    sys.exit(main())
