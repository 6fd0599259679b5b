"""Compare SIM of storeys with laws with OpenSeesPy, whose difference must fall with its step.

Needs openseespy and openseespylinux 3.7.1.2 (research and internal use only) in the Python that runs this.
"""

from __future__ import annotations

import ctypes
import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.analysis.nonlinear_sim import simulate_with_laws
from rths_cli.structure import Building, Numerical, Specimen, assemble
from rths_cli.structure.storey_laws import Bilinear, BoucWen, ElasticGap, Law, Maxwell, ViscousPower, arranged

MASS_KG, SPRING, DASHPOT = 6.0, 7e3, 5.0  # of both storeys
LAWS: dict[str, Law] = {
    "Steel01": Bilinear(SPRING, 0.004, 0.05),
    "ElasticPPGap": ElasticGap(2 * SPRING, 0.004),
    "Viscous": ViscousPower(4.0, 0.5),
    "BoucWen": BoucWen(SPRING, 0.004, 0.05),
    "Maxwell": Maxwell(5e3, 50.0),
}
KNOTS_S = np.arange(0.0, 3.0, 0.05)
GROUND = 2.5 * np.random.default_rng(5).normal(size=len(KNOTS_S)) * (KNOTS_S > 0.0)


def loaded() -> Any:
    """Return OpenSees with its own libraries loaded globally, without which its import fails."""
    spec = importlib.util.find_spec("openseespylinux")
    if spec is None or spec.origin is None:
        raise SystemExit("install openseespy==3.7.1.2 and openseespylinux==3.7.1.2 first")
    for name in ("libquadmath.so.0", "libgfortran.so.4", "libblas.so.3", "liblapack.so.3"):
        ctypes.CDLL(str(Path(spec.origin).parent / "lib" / name), mode=ctypes.RTLD_GLOBAL)
    return importlib.import_module("openseespylinux.opensees")


def materials(ops: Any, name: str) -> list[int]:
    """Define the material of a law; return those that make the force of the first storey."""
    if name == "Steel01":
        ops.uniaxialMaterial(name, 9, SPRING * 0.004, SPRING, 0.05)
        return [9]
    if name == "BoucWen":
        ops.uniaxialMaterial(name, 9, 0.05, SPRING, 1.0, 0.5 / 0.004, 0.5 / 0.004, 1.0, 0.0, 0.0, 0.0)
        return [9]
    if name == "ElasticPPGap":
        ops.uniaxialMaterial(name, 9, 2 * SPRING, 1e9, 0.004)
        ops.uniaxialMaterial(name, 10, 2 * SPRING, -1e9, -0.004)
        return [1, 9, 10]
    ops.uniaxialMaterial(name, 9, *((4.0, 0.5) if name == "Viscous" else (5e3, 50.0, 1.0, 1.0)))
    return [1, 9]


def by_opensees(ops: Any, name: str, dt_s: float) -> np.ndarray:
    """Return the first floor's displacement every 10 ms, by Newmark's average acceleration."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for node in range(3):
        ops.node(node, 0.0)
    ops.fix(0, 1)
    for node in (1, 2):
        ops.mass(node, MASS_KG)
    ops.uniaxialMaterial("Elastic", 1, SPRING)
    ops.uniaxialMaterial("Viscous", 2, DASHPOT, 1.0)
    below = [(0, 1, one) for one in [*materials(ops, name), 2]]
    for tag, (low, high, material) in enumerate([*below, (1, 2, 1), (1, 2, 2)]):
        ops.element("zeroLength", tag + 1, low, high, "-mat", material, "-dir", 1)
    ops.timeSeries("Path", 1, "-time", *KNOTS_S.tolist(), "-values", *GROUND.tolist())
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    for command, words in (("constraints", ["Plain"]), ("numberer", ["Plain"]), ("system", ["FullGeneral"])):
        getattr(ops, command)(*words)
    ops.test("NormDispIncr", 1e-14, 200)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    found = [0.0]
    for step in range(1, round(KNOTS_S[-1] / dt_s) + 1):
        if ops.analyze(1, dt_s) != 0:
            raise SystemExit(f"{name}: OpenSees does not converge at {step * dt_s:g} s")
        if step % round(0.01 / dt_s) == 0:
            found.append(ops.nodeDisp(1, 1))
    return np.array(found)


def by_sim(law: Law) -> np.ndarray:
    """Return the same displacement by SIM at 1 kHz."""
    one = np.ones((1, 1))
    numerical = Numerical(MASS_KG * one[0], SPRING * one, DASHPOT * one)
    specimen = Specimen(MASS_KG * one[0], SPRING * one, DASHPOT * one)
    building = Building(numerical, specimen, 0.0, *assemble(numerical, specimen, 0.0))
    times = np.arange(round(KNOTS_S[-1] / 1e-3) + 1) * 1e-3
    with_law = replace(building, laws=arranged(((law,), ())))
    return simulate_with_laws(with_law, 1e-3, np.interp(times, KNOTS_S, GROUND)).rel_disp_m[0, ::10]


def main() -> None:
    """Print the largest difference of the displacement, of its peak, by law and step of OpenSees."""
    ops, steps_s = loaded(), (1e-3, 5e-4, 2.5e-4, 1.25e-4)
    print("step in s   ", *(f"{step:8g}" for step in steps_s))
    for name, law in LAWS.items():
        sim = by_sim(law)
        told = [np.abs(by_opensees(ops, name, step) - sim).max() / np.abs(sim).max() for step in steps_s]
        print(f"{name:12}", *(f"{one:8.1e}" for one in told), flush=True)


if __name__ == "__main__":
    main()
