"""Compare SIM of storeys with laws with OpenSeesPy, whose difference must fall with its step.

    python benchmarks/opensees_laws.py [--seed N] [--count N]

First each law that OpenSees has in the first of two storeys, then COUNT random buildings (20) of two to four storeys,
of which all but the highest have such a law. Needs openseespy and openseespylinux 3.7.1.2 (research and internal use
only) in the Python that runs this.
"""

from __future__ import annotations

import ctypes
import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from options import arguments, parsed

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.structure import Building, Numerical, Specimen, assemble, storey_matrix
from rths_cli.structure.storey_laws import Bilinear, BoucWen, ElasticGap, Law, Maxwell, ViscousPower, arranged

MASS_KG, SPRING, DASHPOT = 6.0, 7e3, 5.0  # of both storeys
STEPS_S = 1e-3, 5e-4, 2.5e-4, 1.25e-4
EVERY_S = 0.01  # at which displacements are compared
COUNT = 20
KINDS = ("Steel01", "ElasticPPGap", "Viscous", "BoucWen", "Maxwell")
KNOTS_S = np.arange(0.0, 3.0, 0.05)


@dataclass(frozen=True)
class Storey:
    """A storey with a law by OpenSees' name, "" for none; `yields_m` is the law's yield drift or gap."""

    mass_kg: float = MASS_KG
    spring: float = SPRING
    dashpot: float = DASHPOT
    name: str = ""
    yields_m: float = 0.004
    hardening: float = 0.05

    @property
    def law(self) -> Law:
        """Return the law as SIM has it."""
        laws: dict[str, Law] = {
            "Steel01": Bilinear(self.spring, self.yields_m, self.hardening),
            "ElasticPPGap": ElasticGap(2 * self.spring, self.yields_m),
            "Viscous": ViscousPower(4.0, 0.5),
            "BoucWen": BoucWen(self.spring, self.yields_m, self.hardening),
            "Maxwell": Maxwell(0.7 * self.spring, 50.0),
        }
        return laws[self.name]


def drawn(seed: int) -> tuple[list[Storey], np.ndarray]:
    """Return a random building from the ground, and its ground acceleration at the knots in m/s^2."""
    random = np.random.default_rng((seed, 23))
    storeys = [
        Storey(
            float(random.uniform(3.0, 12.0)), float(random.uniform(3e3, 2e4)), float(random.uniform(2.0, 20.0)),
            str(random.choice(KINDS)), float(random.uniform(0.001, 0.006)), float(random.uniform(0.01, 0.3)),
        )
        for _ in range(int(random.integers(2, 5)))
    ]  # fmt: skip
    storeys[-1] = replace(storeys[-1], name="")
    return storeys, record(random)


def record(random: np.random.Generator) -> np.ndarray:
    """Return a random ground acceleration at the knots in m/s^2, from zero."""
    return 2.5 * random.normal(size=len(KNOTS_S)) * (KNOTS_S > 0.0)


def loaded() -> Any:
    """Return OpenSees with its own libraries loaded globally, without which its import fails."""
    spec = importlib.util.find_spec("openseespylinux")
    if spec is None or spec.origin is None:
        raise SystemExit("install openseespy==3.7.1.2 and openseespylinux==3.7.1.2 first")
    for name in ("libquadmath.so.0", "libgfortran.so.4", "libblas.so.3", "liblapack.so.3"):
        ctypes.CDLL(str(Path(spec.origin).parent / "lib" / name), mode=ctypes.RTLD_GLOBAL)
    return importlib.import_module("openseespylinux.opensees")


def materials(ops: Any, storey: Storey, tag: int) -> list[int]:
    """Define the materials of a storey, at most five from a tag on; return those that make its force."""
    k, limit = storey.spring, storey.yields_m
    spring, dashpot, own, other = tag, tag + 1, tag + 2, tag + 3
    ops.uniaxialMaterial("Elastic", spring, k)
    ops.uniaxialMaterial("Viscous", dashpot, storey.dashpot, 1.0)
    if storey.name == "":
        return [spring, dashpot]
    if storey.name == "Steel01":
        ops.uniaxialMaterial("Steel01", own, k * limit, k, storey.hardening)
        return [own, dashpot]
    if storey.name == "BoucWen":
        turns = 0.5 / limit
        ops.uniaxialMaterial("BoucWen", own, storey.hardening, k, 1.0, turns, turns, 1.0, 0.0, 0.0, 0.0)
        return [own, dashpot]
    if storey.name == "ElasticPPGap":
        ops.uniaxialMaterial("ElasticPPGap", own, 2 * k, 1e9, limit)
        ops.uniaxialMaterial("ElasticPPGap", other, 2 * k, -1e9, -limit)
        return [spring, own, other, dashpot]
    if storey.name == "Viscous":
        ops.uniaxialMaterial("Viscous", own, 4.0, 0.5)
    else:
        ops.uniaxialMaterial("Maxwell", own, 0.7 * k, 50.0, 1.0, 1.0)
    return [spring, own, dashpot]


def by_opensees(ops: Any, storeys: list[Storey], ground: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the floors' displacements (n_storeys, n) every 10 ms, by Newmark's average acceleration."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(0, 0.0)
    ops.fix(0, 1)
    element = 0
    for floor, storey in enumerate(storeys, 1):
        ops.node(floor, 0.0)
        ops.mass(floor, storey.mass_kg)
        for material in materials(ops, storey, 10 * floor):
            element += 1
            ops.element("zeroLength", element, floor - 1, floor, "-mat", material, "-dir", 1)
    ops.timeSeries("Path", 1, "-time", *KNOTS_S.tolist(), "-values", *ground.tolist())
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    for command, words in (("constraints", ["Plain"]), ("numberer", ["Plain"]), ("system", ["FullGeneral"])):
        getattr(ops, command)(*words)
    ops.test("NormDispIncr", 1e-14, 200)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    floors = range(1, len(storeys) + 1)
    found = [[0.0] * len(storeys)]
    for step in range(1, round(KNOTS_S[-1] / dt_s) + 1):
        if ops.analyze(1, dt_s) != 0:
            return np.full((len(storeys), 1), np.nan)
        if step % round(EVERY_S / dt_s) == 0:
            found.append([ops.nodeDisp(floor, 1) for floor in floors])
    return np.array(found).T


def by_sim(storeys: list[Storey], ground: np.ndarray) -> np.ndarray:
    """Return the same displacements by SIM at 1 kHz."""
    mass, spring, dashpot = (
        np.array([getattr(one, name) for one in storeys]) for name in ("mass_kg", "spring", "dashpot")
    )
    below = Numerical(mass[:-1], storey_matrix(spring[:-1]), storey_matrix(dashpot[:-1]))
    above = Specimen(mass[-1:], storey_matrix(spring[-1:]), storey_matrix(dashpot[-1:]))
    laws = tuple((one.law,) if one.name else () for one in storeys)
    building = Building(below, above, 0.0, *assemble(below, above, 0.0), laws=arranged(laws))
    times = np.arange(round(KNOTS_S[-1] / 1e-3) + 1) * 1e-3
    return simulate_with_laws(building, 1e-3, np.interp(times, KNOTS_S, ground)).rel_disp_m[:, ::10]


def differences(ops: Any, storeys: list[Storey], ground: np.ndarray) -> list[float]:
    """Return the largest difference of a floor's displacement over its peak by step of OpenSees, NaN where OpenSees
    does not converge."""
    sim = by_sim(storeys, ground)
    peaks = np.abs(sim).max(axis=1)
    theirs = [by_opensees(ops, storeys, ground, step) for step in STEPS_S]
    return [float((np.abs(one - sim).max(axis=1) / peaks).max()) for one in theirs]


def main() -> None:
    """Print the largest difference of a displacement, of its peak, by building and step of OpenSees."""
    asked = parsed(arguments(__doc__, seed=0, count=COUNT))
    ops = loaded()
    print("step in s   ", *(f"{step:8g}" for step in STEPS_S))
    ground = record(np.random.default_rng(5))
    for name in KINDS:
        told = differences(ops, [Storey(name=name), Storey()], ground)
        print(f"{name:12}", *(f"{one:8.1e}" for one in told), flush=True)
    for seed in range(asked.seed, asked.seed + asked.count):
        storeys, ground = drawn(seed)
        told = differences(ops, storeys, ground)
        names = " + ".join(one.name for one in storeys[:-1])
        print(f"{seed:<12}", *(f"{one:8.1e}" for one in told), f"{told[0] / told[-1]:6.0f}  {names}", flush=True)


if __name__ == "__main__":
    main()
