"""A program that is an OpenSees model, built by the user's own script for OpenSeesPy or for the package `opensees`.

Displacements are prescribed at the masses that move in the interface's direction; all other degrees of freedom are in
static equilibrium. The restoring forces are the reactions there, with those of what is tied to them.
"""

from __future__ import annotations

import importlib
import math
import runpy
import sys
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.programs.process import Description

GRAVITY_STEPS = 10
PRESCRIBED, GROUND = 990_001, 990_002  # tags of our load patterns and time series
MATERIAL = 990_100  # first tag of the materials that we add
HALVINGS = 6  # of a step of displacements that does not converge
ITERATIONS = 30
BALANCED = 1e-9  # of the weight of all masses, up to which forces may be out of balance
BANDED = 600  # degrees of freedom, up to which a banded solver is the quicker one
OTHER_MASS = 1e-6  # of the whole, that may stand in other directions
SAME_HEIGHT = 1e-9
SAME_HZ = 1e-3  # largest relative difference of the first natural frequency
TIED = 1e-9  # of the largest force, above which a reaction is one of a tie
DAMPING = ("rayleigh", "modalDamping")  # calls that state damping
PROCEDURES = """
proc rths_converges {args} {
    if {[analyze {*}$args] == 0} { return 1 }
    test {*}$::rths_loose ;# stays: so stiff a model is never out of balance by so little
    if {[analyze {*}$args] == 0} { return 1 }
    foreach other {KrylovNewton {ModifiedNewton -initial}} {
        algorithm {*}$other
        set code [analyze {*}$args]
        algorithm Newton
        if {$code == 0} { return 1 }
    }
    return 0
}
proc rths_follow {samples steps interval nodes dof} {
    set found {}
    for {set k 0} {$k < $samples} {incr k} {
        if {![rths_converges $steps $interval]} { break }
        foreach read {nodeDisp nodeVel nodeAccel} { foreach node $nodes { lappend found [$read $node $dof] } }
    }
    return $found
}
"""  # what the package's interpreter is told: a call of one of its functions from Python takes a tenth of a millisecond
AT_ONCE = 1000  # samples that are read in one call


class OpenSeesModel:
    """The model of a script: p floors, the interface last."""

    def __init__(self, description: Description) -> None:
        self._description = description
        self._length, self._force = description.length_m, description.force_n
        self._build()
        self._tcl(PROCEDURES)
        self._ops.wipeAnalysis()
        self._refuse_turned_links()
        self._nodes = self._floors()
        self.floors = tuple(f"node {node}" for node in self._nodes)
        self._apply_gravity()
        self._at_rest = self._displacements()
        self._prescribe(("Lagrange",))
        self._tied, self._ties, self._forces_at_rest = self._find_ties()

    def _build(self) -> None:
        """Run the script, and its function that builds the model."""
        package = _package()
        self.version = f"OpenSees, opensees {_version()}"
        stated: list[str] = []
        for name in DAMPING:
            _note_calls(package, name, stated)
        package.wipe()
        names = runpy.run_path(str(self._description.file), run_name="rths_program")
        function = names.get(self._description.function)
        if not callable(function):
            raise LookupError(f"{self._description.file} has no function {self._description.function!r}")
        made = function()
        self._ops: Any = made if hasattr(made, "getNodeTags") else package
        self._eval = self._ops.eval
        if stated:
            raise ValueError(
                f"calls {stated[0]}: damping belongs to the linear part and is stated by damping of the case; take the "
                "call out"
            )

    def _refuse_turned_links(self) -> None:
        """Raise ValueError for a zero-length element between nodes apart: its directions are taken along the line
        between them, whatever the script means, and OpenSees only warns. Along the first axis this changes nothing."""
        links = "if {[string match ZeroLength* [eleType $e]]} { lappend rths_links $e [eleNodes $e] }"
        words = self._tcl(f"set rths_links {{}}; foreach e [getEleTags] {{ {links} }}; join $rths_links").split()
        for element, one, other in zip(*[iter(words)] * 3, strict=True):
            apart = np.array(self._place(int(other))) - np.array(self._place(int(one)))
            if np.abs(apart[1:]).max(initial=0.0) > SAME_HEIGHT * (np.abs(apart).max() + 1.0):
                raise ValueError(
                    f"element {element} (zeroLength) joins nodes {one} and {other}, which are "
                    f"{float(np.linalg.norm(apart)):.4g} apart: OpenSees then takes its directions along the line "
                    "between them, after a warning only; put both nodes at one place, or use twoNodeLink"
                )

    def _floors(self) -> tuple[int, ...]:
        """Return the nodes (p,) with mass in the interface's direction, upwards; keep their masses."""
        ops, dof = self._ops, self._description.dof
        tags = tuple(int(tag) for tag in ops.getNodeTags())
        if self._description.node not in tags:
            raise LookupError(f"has no node {self._description.node}, which interface.node names; it has {_few(tags)}")
        if dof > int(ops.getNDM()):
            raise LookupError(f"interface.dof {dof} is no translation of a model with ndm {int(ops.getNDM())}")
        unit = self._force / self._length  # kg, with seconds
        mass = {tag: unit * float(ops.nodeMass(tag, dof)) for tag in tags}
        moved = [tag for tag in tags if mass[tag] > OTHER_MASS * max(mass.values())]
        if self._description.node not in moved:
            raise ValueError(
                f"node {self._description.node} has no mass in degree of freedom {dof}, which interface names; give it "
                "the mass of the interface floor that is computed"
            )
        for tag in tags:
            for other in range(1, int(ops.getNDM()) + 1):
                beside = unit * float(ops.nodeMass(tag, other))
                if other != dof and beside > OTHER_MASS * sum(mass.values()):
                    raise ValueError(
                        f"node {tag} has {beside:.4g} kg in degree of freedom {other}; only masses in the interface's "
                        f"direction, {dof}, are moved: take that mass out"
                    )
        height = {tag: self._height(tag) for tag in moved}
        ordered = sorted(moved, key=lambda tag: height[tag])
        for low, high in pairwise(ordered):
            if height[high] - height[low] <= SAME_HEIGHT * (abs(height[high]) + 1.0):
                raise ValueError(
                    f"nodes {low} and {high} have mass at the same height; give a floor's mass to one node, and tie "
                    "the others to it (equalDOF, rigidDiaphragm)"
                )
        if ordered[-1] != self._description.node:
            raise ValueError(
                f"node {ordered[-1]} with mass is above the interface, node {self._description.node}; the specimen "
                "stands on the highest floor that is computed"
            )
        self.masses_kg = np.array([mass[tag] for tag in ordered])
        self._weight = 9.81 * float(self.masses_kg.sum()) / self._force
        return tuple(ordered)

    def _height(self, tag: int) -> float:
        """Return the coordinate of a node upwards, the last one; along the line in a model of one dimension."""
        return float(self._place(tag)[-1])

    def _apply_gravity(self) -> None:
        """Apply the loads that the script left to be applied, and hold them constant."""
        ops = self._ops
        if float(ops.getTime()) == 0.0:
            self._analysis(("Transformation",), ("LoadControl", 1.0 / GRAVITY_STEPS), "Static")
            if not self._converges(GRAVITY_STEPS):
                raise ValueError("does not converge under its own loads (gravity); check loads, units and supports")
        ops.loadConst("-time", 0.0)
        ops.wipeAnalysis()

    def _analysis(self, constraints: tuple[Any, ...], integrator: tuple[Any, ...], kind: str) -> None:
        ops = self._ops
        ops.wipeAnalysis()
        ops.constraints(*constraints)
        ops.numberer("RCM")
        ops.system(self._system())
        ops.test("NormUnbalance", BALANCED * self._weight, ITERATIONS)  # one solution for a linear step
        self._tcl(f"set ::rths_loose {{NormDispIncr {1e-10 / self._length!r} {ITERATIONS}}}")
        ops.algorithm("Newton")
        ops.integrator(*integrator)
        ops.analysis(kind)

    def _system(self) -> str:
        size = int(self._ops.getNDF()) * len(self._ops.getNodeTags())
        return "BandGeneral" if size <= BANDED else "UmfPack"

    def _tcl(self, script: str) -> str:
        """Return what a script gives in the interpreter of the package."""
        return str(self._eval(script))

    def _converges(self, steps: int) -> bool:
        """Return whether some steps converge, with one of the algorithms that are tried."""
        return self._tcl(f"rths_converges {steps}") == "1"

    def _displacements(self) -> Array:
        return np.array([float(self._ops.nodeDisp(node, self._description.dof)) for node in self._nodes])

    def _prescribe(self, constraints: tuple[Any, ...]) -> None:
        """Set up the static analysis under prescribed displacements."""
        self._analysis(constraints, ("LoadControl", 0.0), "Static")
        self._ops.timeSeries("Constant", PRESCRIBED)
        self._prescribed = False
        self._now = self._at_rest.copy()

    def _find_ties(self) -> tuple[tuple[tuple[int, int], ...], Array, Array]:
        """Return the degrees of freedom (t,) at which reactions belong to prescribed ones, by how much each moves with
        these (t, p), and the forces (p,) at rest: by virtual work, the force on a floor is the sum of these reactions
        times these motions. A free degree of freedom has none, a support does not move."""
        ops, size = self._ops, int(self._ops.getNDF())
        places = [(int(tag), dof) for tag in ops.getNodeTags() for dof in range(1, size + 1)]
        step = 1e-7 / self._length
        motions, forces = np.zeros((len(places), len(self._nodes))), np.zeros(len(places))
        for i in range(len(self._nodes)):
            moved = np.zeros((2, len(places)))
            for sign, row in ((1.0, 0), (-1.0, 1)):
                there = self._at_rest.copy()
                there[i] += sign * step
                self._move_to(there)
                ops.reactions()
                moved[row] = [float(ops.nodeDisp(*place)) for place in places]
                forces = np.maximum(forces, np.abs([float(ops.nodeReaction(*place)) for place in places]))
            motions[:, i] = (moved[0] - moved[1]) / (2.0 * step)
        pulls = (forces > TIED * forces.max()) & (np.abs(motions).max(axis=1) > TIED)
        kept = [place for place, one in zip(places, pulls, strict=True) if one]
        ties = motions[pulls]
        self._move_to(self._at_rest)
        return tuple(kept), ties, self._reactions(tuple(kept), ties)

    def _reactions(self, places: tuple[tuple[int, int], ...], ties: Array) -> Array:
        read = " ".join(f"[nodeReaction {node} {dof}]" for node, dof in places)
        return np.array(self._tcl(f"reactions; list {read}").split(), dtype=float) @ ties

    def _move_to(self, target: Array) -> None:
        """Bring the prescribed displacements (p,), in the model's units, to a target, in as many parts as it takes."""
        start, reached, share = self._now.copy(), 0.0, 1.0
        while reached < 1.0:
            goal = min(1.0, reached + share)
            if self._solved(start + goal * (target - start)):
                reached = goal
                continue
            share *= 0.5
            if share < 0.5**HALVINGS:
                place = (target - self._at_rest) * self._length
                raise ArithmeticError(f"does not converge at displacements of {np.array2string(place, precision=4)} m")
        self._now = np.array(target, dtype=float)

    def _solved(self, displacements: Array) -> bool:
        """Return whether there is an equilibrium at displacements (p,) in the model's units, and take it."""
        dof, values = self._description.dof, displacements.tolist()
        supports = "; ".join(f"sp {node} {dof} {value!r}" for node, value in zip(self._nodes, values, strict=True))
        last = f"remove loadPattern {PRESCRIBED}; " if self._prescribed else ""
        self._prescribed = True
        return self._tcl(f"{last}pattern Plain {PRESCRIBED} {PRESCRIBED} {{ {supports} }}; rths_converges 1") == "1"

    def force(self, displacement_m: Array) -> Array:
        """Return the restoring forces (p,) in N at displacements (p,) in m from the state under gravity."""
        self._move_to(self._at_rest + displacement_m / self._length)
        return np.asarray((self._reactions(self._tied, self._ties) - self._forces_at_rest) * self._force)

    def first_hz(self) -> float:
        """Return the first natural frequency of the model by OpenSees's eigenvalue analysis at rest, as it stands."""
        model = OpenSeesModel.__new__(OpenSeesModel)
        model._description, model._length, model._force = self._description, self._length, self._force
        model._weight = self._weight
        model._build()
        model._apply_gravity()
        found = model._ops.eigen("-fullGenLapack", 1)
        value = float(found[0] if isinstance(found, list | tuple) else found)
        return math.sqrt(max(value, 0.0)) / (2.0 * math.pi)

    def response(
        self, added_masses_kg: Array, stiffness: Array, damping: Array, dt_s: float, steps: int, ground: Array
    ) -> Array:
        """Return the response of the whole structure to a ground acceleration (n,) in m/s^2, linear between samples
        `dt_s` apart: displacements, velocities and accelerations relative to the ground (3, q, n) in m.

        The model stands alone first: floors 1 to p are its own, those above are added as nodes, so that q floors have
        `added_masses_kg` (q,) more mass, and springs and dashpots by `stiffness` and `damping` (q, q) between them
        (zero-length elements). Newmark's constant acceleration, `steps` to a sample. The model is no longer at rest.
        """
        nodes = self._added(added_masses_kg)
        self._connect(nodes, stiffness, damping)
        self._ops.timeSeries("Path", GROUND, "-dt", dt_s, "-values", *np.append(ground, ground[-1]).tolist())
        self._ops.pattern(
            "UniformExcitation", GROUND, self._description.dof, "-accel", GROUND, "-factor", 1.0 / self._length
        )
        self._analysis(("Transformation",), ("Newmark", 0.5, 0.25), "Transient")
        return self._followed(nodes, dt_s / steps, steps, len(ground)) * self._length

    def _added(self, masses_kg: Array) -> tuple[int, ...]:
        """Return all nodes (q,) after adding masses in kg to the model's own, and the floors above as new nodes."""
        ops, dof, size = self._ops, self._description.dof, int(self._ops.getNDF())
        if self._prescribed:
            ops.remove("loadPattern", PRESCRIBED)
            self._prescribed = False
        place = self._place(self._nodes[-1])
        first = max(int(tag) for tag in ops.getNodeTags()) + 1
        nodes = [*self._nodes, *(first + i for i in range(len(masses_kg) - len(self._nodes)))]
        for node, mass in zip(nodes, masses_kg.tolist(), strict=True):
            if node >= first:
                ops.node(node, *place)
                ops.fix(node, *(0 if i == dof else 1 for i in range(1, size + 1)))
            own = [float(ops.nodeMass(node, i)) for i in range(1, size + 1)] if node < first else [0.0] * size
            own[dof - 1] += mass * self._length / self._force
            ops.mass(node, *own)
        return tuple(nodes)

    def _connect(self, nodes: tuple[int, ...], stiffness: Array, damping: Array) -> None:
        """Connect nodes (q,) with each other and with the ground by springs and dashpots that add up to matrices.

        A zero-length element between nodes apart is turned along their line, after a warning: all nodes stand at the
        interface while these elements are made. Those of the model have taken their lengths before.
        """
        ops, dof, size = self._ops, self._description.dof, int(self._ops.getNDF())
        ground = max(int(tag) for tag in ops.getNodeTags()) + 1
        element = max((int(tag) for tag in ops.getEleTags()), default=0) + 1
        unit, count = self._length / self._force, 0
        places = {node: self._place(node) for node in nodes}
        ops.node(ground, *places[nodes[-1]])
        ops.fix(ground, *[1] * size)
        for node in nodes:
            self._put(node, places[nodes[-1]])
        least = [1e-12 * np.abs(matrix).max(initial=0.0) for matrix in (stiffness, damping)]
        for i, one in enumerate(nodes):
            for j, other in [(None, ground), *((j, nodes[j]) for j in range(i))]:
                spring, dashpot = (
                    float(matrix[i].sum() if j is None else -matrix[i, j]) for matrix in (stiffness, damping)
                )
                if abs(spring) <= least[0] and abs(dashpot) <= least[1]:
                    continue
                ops.uniaxialMaterial("Elastic", MATERIAL + count, spring * unit, dashpot * unit)
                ops.element("zeroLength", element + count, other, one, "-mat", MATERIAL + count, "-dir", dof)
                count += 1
        for node, place in places.items():
            self._put(node, place)

    def _place(self, node: int) -> list[float]:
        """Return the coordinates of a node (ndm,)."""
        place = self._ops.nodeCoord(node)
        return list(place) if isinstance(place, list | tuple) else [place]

    def _put(self, node: int, place: list[float]) -> None:
        """Give a node other coordinates (ndm,)."""
        self._tcl("; ".join(f"setNodeCoord {node} {i} {value!r}" for i, value in enumerate(place, 1)))

    def _followed(self, nodes: tuple[int, ...], step_s: float, steps: int, samples: int) -> Array:
        """Return displacements, velocities and accelerations (3, q, n) relative to the state at the start."""
        named, dof = " ".join(map(str, nodes)), self._description.dof
        start = np.array([float(self._ops.nodeDisp(node, dof)) for node in nodes])
        read = [np.concatenate([start, np.zeros(2 * len(nodes))])]  # at rest under gravity
        while len(read) < samples:
            count = min(AT_ONCE, samples - len(read))
            told = self._tcl(f"rths_follow {count} {steps} {step_s!r} {{{named}}} {dof}")
            rows = np.array(told.split(), dtype=float).reshape(-1, 3 * len(nodes))
            read += list(rows)
            if len(rows) < count:
                raise ArithmeticError(f"the response does not converge after {len(read) * steps * step_s:.3f} s")
        found = np.array(read).reshape(samples, 3, len(nodes)).transpose(1, 2, 0).copy()
        found[0] -= start[:, None]
        return found


def _package() -> ModuleType:
    """Return OpenSees's functions, also under the name that scripts for OpenSeesPy import."""
    try:
        functions = importlib.import_module("opensees.openseespy")
    except ImportError as error:
        raise ModuleNotFoundError(f"{error}; install it: pip install 'rths-cli[opensees]'") from error
    alias = ModuleType("openseespy")
    alias.opensees = functions  # type: ignore[attr-defined]
    sys.modules["openseespy"], sys.modules["openseespy.opensees"] = alias, functions
    return functions


def _version() -> str:
    from importlib.metadata import version

    return version("opensees")


def _note_calls(package: ModuleType, name: str, noted: list[str]) -> None:
    """Have calls of a function of the package, and of its models, noted in a list."""

    def note(*unused: object, **also: object) -> None:
        noted.append(name)

    setattr(package, name, note)
    setattr(package.Model, name, note)


def _few(tags: tuple[int, ...]) -> str:
    told = ", ".join(map(str, tags[:10]))
    return told + (", ..." if len(tags) > 10 else "") if tags else "none"


def make(description: Description) -> OpenSeesModel:
    """Return the model of a description, under gravity and at rest."""
    return OpenSeesModel(description)
