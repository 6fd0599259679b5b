"""SIM against programs that solve the same building under the same record."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from rths_cli.analysis.sim import simulate, state_equation
from rths_cli.experiment.setup import Setup
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building
from speed.rows import RATIO, Row, difference, lowest_s

BUNDLED = ("libquadmath.so.0", "libgfortran.so.4", "libgomp.so.1", "libblas.so.3", "liblapack.so.3")


def sim_rows(setup: Setup) -> list[Row]:
    """Time SIM, scipy's lsim and OpenSees, and compare the absolute accelerations."""
    building, dt, ground = setup.building, setup.rig.dt_s, setup.motion.accel_m_s2
    ours_s = lowest_s(lambda: simulate(building, dt, ground), 7)
    exact = simulate(building, dt, ground).abs_accel_m_s2
    programs: dict[str, Callable[[], Array] | None] = {
        "scipy.signal.lsim": lambda: by_lsim(building, dt, ground),
        "OpenSeesPy, Newmark": by_opensees(building, dt, ground),
    }
    return [_row(name, work, exact, ours_s) for name, work in programs.items()]


def _row(name: str, work: Callable[[], Array] | None, exact: Array, ours_s: float) -> Row:
    if work is None:
        return Row(f"{name} / SIM: not installed", None, RATIO)
    made = work()
    taken_s, apart = lowest_s(work, 2), difference(exact[:, : made.shape[1]], made)
    behind = f"{taken_s:.3g} s, SIM {ours_s:.3g} s; {exact.shape[1]:,} samples, accelerations differ by {apart:.0e}"
    return Row(f"{name} / SIM", taken_s / ours_s, RATIO, None, behind)


def by_lsim(building: Building, dt_s: float, ground: Array) -> Array:
    """Return the absolute accelerations (n_storeys, n) by scipy, exact for a record linear between samples."""
    from scipy.signal import lsim

    a, b = state_equation(building.M, building.C, building.K)
    rows = a[len(building.M) :]
    made = lsim((a, b, rows, np.zeros((len(rows), 1))), ground, dt_s * np.arange(len(ground)))
    return np.asarray(made[1].T)


def opensees() -> ModuleType | None:
    """Return OpenSeesPy, None when it is not installed; the libraries that come with it are loaded first."""
    found = find_spec("openseespylinux")
    folders = (found.submodule_search_locations if found else None) or []
    for library in (Path(folder) / "lib" / name for folder in folders for name in BUNDLED):
        if library.exists():
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    try:
        return import_module("openseespy.opensees")
    except ImportError:
        return None


def by_opensees(building: Building, dt_s: float, ground: Array) -> Callable[[], Array] | None:
    """Return a function that gives the absolute accelerations (n_storeys, n) by OpenSees, None without it."""
    module = opensees()
    if module is None:
        return None

    def run() -> Array:
        shear_building(module, building)
        for i in range(len(building.M)):
            module.setNodeAccel(i + 1, 1, -float(ground[0]), "-commit")  # at rest, the ground begins with a jump
        newmark(module, dt_s, ground)
        made = np.zeros((len(building.M), len(ground)))
        for k in range(1, len(ground)):
            module.analyze(1, dt_s)
            made[:, k] = [module.nodeAccel(i + 1, 1) for i in range(len(made))]
        made[:, 0] = -ground[0]
        return made + ground

    return run


def shear_building(module: ModuleType, building: Building) -> None:
    """Make nodes for the ground and the storeys, and an element between any two that carries their K and C."""
    module.wipe()
    module.model("basic", "-ndm", 1, "-ndf", 1)
    count = len(building.M)
    for i in range(count + 1):
        module.node(i, 0.0)
    module.fix(0, 1)
    for i in range(count):
        module.mass(i + 1, building.M[i, i])
    tag = 1
    for i in range(count):
        for j in range(-1, i):
            stiffness, dashpot = (_between(matrix, i, j) for matrix in (building.K, building.C))
            module.uniaxialMaterial("Elastic", tag, stiffness, dashpot)
            module.element("zeroLength", tag, j + 1, i + 1, "-mat", tag, "-dir", 1)
            tag += 1


def _between(matrix: Array, one: int, two: int) -> float:
    """Return the spring between two storeys, or a storey and the ground (two = -1), of a symmetric matrix."""
    return float(matrix[one].sum() if two < 0 else -matrix[one, two])


def newmark(module: ModuleType, dt_s: float, ground: Array) -> None:
    """Prepare a linear analysis by Newmark's average acceleration under a ground acceleration."""
    module.timeSeries("Path", 1, "-dt", dt_s, "-values", *ground.tolist(), float(ground[-1]))  # the end is rounded
    module.pattern("UniformExcitation", 1, 1, "-accel", 1)
    module.constraints("Plain")
    module.numberer("Plain")
    module.system("FullGeneral")
    module.algorithm("Linear")
    module.integrator("Newmark", 0.5, 0.25)
    module.analysis("Transient")
