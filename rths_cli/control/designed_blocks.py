"""`Blocks`, the data class of one run's designed blocks, and how a load cell under the specimen enters them.

The cell carries the base plate (mass m_p), the part m_t of the interface floor that stands on the table, and the
floors m_i. At rest its zero is taken off; then, with the accelerations a_t of the table and a_i of the floors,

    F = (m_p + m_t) a_t + sum m_i a_i,

and the force of the specimen on the interface (Eq. 2.6) is f = -(F - m_p a_t). With weight w of the cell and 1 - w of
the accelerations:

- Method `paper`, and every force without prediction: f = (1 - w) (-m_t a_t - sum m_i ^a_i) - w (F - m_p a_t), with the
  estimated accelerations ^a_i.
- Method `best` keeps its prediction of f at k + n_p and corrects what that says of the present. The force which the
  identified specimen does not explain, r = -sum m_i (a_i - ^a_i), is replaced by (1 - w) r + w r_F with
  r_F = -(F - m_p a_t) + m_t a_t + sum m_i ^a_i, and goes through the same filter (kalman_filter.with_residual).

Both are what they were without the cell wherever F is what the accelerations demand. That is how a design with a cell
is analysed: `Blocks.estimator` and `Blocks.interface` are those of the accelerations, `Blocks.cell` is what the cell
changes.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.compensator import CompiledLaw
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.interface import Interface, Logged, PartDesign
from rths_cli.control.python_parts import PythonPart
from rths_cli.errors import InputError, RthsError
from rths_cli.numerics.lti import Array, Block
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from rths_cli.rigs.description import RigInfo


@dataclass(frozen=True)
class CellInput:
    """A load cell as one more input of estimator and interface force, in N."""

    channel: int  # which of the further channels
    reads: Array  # (c,) what it shows per m/s^2 of each accelerometer
    B: Array  # (n,) of the estimator, per N
    D: Array  # (e,) of the estimator, per N
    samples: Array  # (i,) weight in the interface force, N per N


def cell_reads(floor_masses_kg: Array, interface_mass_kg: float, plate_mass_kg: float) -> Array:
    """Return what a load cell under the specimen shows per m/s^2 of table and floors, (1 + n_floors,), in N."""
    return np.concatenate([[plate_mass_kg + interface_mass_kg], np.asarray(floor_masses_kg, dtype=float)])


def cell_weight(rig: RigInfo, floor_masses_kg: Array, interface_mass_kg: float, shear_from: str | None) -> float:
    """Return the weight w of the load cell in the base shear, 0 to 1.

    `both`, and None where there is a cell: w = u_a^2 / (u_a^2 + u_F^2) with the relative standard uncertainties of the
    cell, u_F, and of the sum of mass times acceleration, u_a^2 = sum (m_i)^2 (u_i^2 + u_m^2) / (sum m_i)^2, whose
    errors count as independent. Equal where both are declared perfect.
    """
    if rig.shear_cell is None or shear_from == "accelerations":
        return 0.0
    if shear_from == "load_cell":
        return 1.0
    masses = cell_reads(floor_masses_kg, interface_mass_kg, 0.0)
    weighed = (rig.uncertainty.mass, *rig.uncertainty.of_masses(len(rig.channels) - 1))
    squares = np.array([one.uncertainty**2 + mass**2 for one, mass in zip(rig.channels, weighed, strict=True)])
    of_accelerations = float(masses**2 @ squares / masses.sum() ** 2)
    of_cell = rig.further[rig.shear_cell].uncertainty ** 2
    total = of_accelerations + of_cell
    return of_accelerations / total if total > 0.0 else 0.5


def with_cell(blocks: Blocks, cell: CellInput) -> tuple[Block, Interface]:
    """Return estimator and interface whose inputs are accelerometers and further channels up to the load cell.

    The same outputs as without it wherever the cell shows what the accelerations demand.
    """
    block, force = blocks.estimator, blocks.interface.force
    inputs = len(cell.reads) + cell.channel + 1
    widened = replace(
        block,
        B=_widened(block.B, cell.B, cell.reads, inputs),
        D=_widened(block.D, cell.D, cell.reads, inputs),
        inputs=(*block.inputs, *(f"further_{i}" for i in range(cell.channel)), "load_cell_n"),
    )
    samples = _widened(force.samples, cell.samples, cell.reads, inputs)
    return widened, replace(blocks.interface, force=replace(force, samples=samples))


def _widened(of_accelerations: Array, of_cell: Array, reads: Array, inputs: int) -> Array:
    """Return columns for accelerometers, further channels and cell from those of accelerations alone."""
    made = np.zeros((len(of_accelerations), inputs))
    made[:, : reads.size] = of_accelerations - np.outer(of_cell, reads)
    made[:, -1] = of_cell
    return made


@dataclass(frozen=True)
class Blocks:
    """The blocks a run is made of, as designed: all that `assemble` needs to build a Step.

    `interface`: its force, and what is commanded; n_p = lead in samples. `ripple_*` as in loop.step_arrays.Step;
    `shaping_step_v` is the size of a bit of the command converter when its rounding errors are to be shaped, else 0.
    The feedback's part of the command is kept within +-`feedback_limit_v`, and the sum within +-`command_limit_v` as
    far as the feedback's part can. `specimen`: the identified one, by which the channels are compared after a stop;
    None where there is none. `open_loop`: the same from the table's acceleration to the floors' accelerations, by which
    the guard knows what a floor must show; no block of the control, None where no specimen is known. `further`: samples
    in V of the channels beside the accelerometers to their values; None where there are none. `cell`: the load cell of
    the base shear; estimator and interface are those without it (control.load_cell). `counters_reaction`: whether the
    feedforward counters a reaction of the specimen that was not identified (control.reaction).
    """

    correction: Block
    estimator: Block
    numerical: PartDesign
    feedforward: PartDesign
    feedback: PartDesign
    interface: Interface
    shaping_step_v: float = 0.0
    ripple_m_s2_per_v: float = 0.0
    latency_samples: int = 1
    command_limit_v: float = float("inf")
    feedback_limit_v: float = float("inf")
    ripple_sum_m_s2_per_v: float = 0.0
    specimen: Specimen | None = None
    open_loop: Block | None = None
    further: Block | None = None
    cell: CellInput | None = None
    counters_reaction: bool = False

    @property
    def lead_samples(self) -> int:
        """Return n_p, by how many samples the hybrid clock runs ahead of the table."""
        return self.interface.force.lead_samples

    def named(self) -> tuple[Block, ...]:
        """Return the discrete blocks that make the command, in the order in which the step runs them; without those of
        parts that cannot be judged."""
        parts = []
        for design in (self.numerical, self.feedforward, self.feedback):
            with suppress(InputError):
                parts.append(design.linearised())
        return (self.correction, self.estimator, *parts)

    def linear_parts(self) -> tuple[Block, Block, Block]:
        """Return numerical substructure, feedforward and feedback as linear blocks, those of the start of a run.

        Raises InputError if one of them cannot be judged.
        """
        return self.numerical.linearised(), self.feedforward.linearised(), self.feedback.linearised()

    def linearised(self) -> Blocks:
        """Return the same with the linear blocks in place of the parts; raises InputError as `linear_parts`."""
        numerical, feedforward, feedback = self.linear_parts()
        return replace(self, numerical=numerical, feedforward=feedforward, feedback=feedback)

    @property
    def judged(self) -> bool:
        """Return whether every part has a linear block, by which it can be judged."""
        return len(self.named()) == 5

    @property
    def linear(self) -> bool:
        """Return whether all parts are linear at all times."""
        return self.numerical.linear and self.feedforward.linear and self.feedback.linear

    @property
    def friction_compensation(self) -> FrictionFeedforward | None:
        """Return the feedforward that counters friction, None where nothing does."""
        return self.feedforward if isinstance(self.feedforward, FrictionFeedforward) else None

    def without_compensation(self) -> Blocks:
        """Return the blocks of a test on a table without the friction that they counter."""
        counters = self.friction_compensation
        return self if counters is None else replace(self, feedforward=counters.block)

    @property
    def in_python(self) -> tuple[PythonPart[Any], ...]:
        """Return the designs of the parts that are Python objects."""
        return tuple(one for one in (self.numerical, self.feedforward, self.feedback) if isinstance(one, PythonPart))

    @property
    def runs_own_code(self) -> bool:
        """Return whether a part runs code that rths does not know, in Python or compiled."""
        return bool(self.in_python) or isinstance(self.feedforward, CompiledLaw)

    def fault(self) -> str:
        """Return what a part that is a Python object raised in the last run, "" if none did."""
        faults = [(one.name, one.fault) for one in self.in_python if one.fault is not None]
        if not faults:
            return ""
        name, fault = faults[0]
        # a sentence of ours names what failed, and needs no class of Python
        return str(fault) if isinstance(fault, RthsError) else f"{name} failed: {type(fault).__name__}: {fault}"

    def finish(self) -> None:
        """End the processes of parts that have any; called after each run."""
        for one in self.in_python:
            end = getattr(one, "close", None)
            if end is not None:
                end()

    def raise_interruption(self) -> None:
        """Raise what came while a Python object was called and is no fault of it, such as KeyboardInterrupt."""
        for one in self.in_python:
            if one.fault is not None and not isinstance(one.fault, Exception):
                raise one.fault

    def without_watch(self) -> Blocks:
        """Return the blocks that make the same commands to the last bit, without those that only watch: no estimates
        beside the interface force, and no expected accelerations of the floors."""
        force, made = self.interface.force, self.estimator
        told = replace(
            made,
            C=force.estimates @ made.C,
            D=force.estimates @ made.D + force.samples,
            outputs=_names("interface_force_n", len(force.estimates)),
        )
        known = replace(force, estimates=np.eye(len(force.estimates)), samples=np.zeros_like(force.samples))
        return replace(self, estimator=told, interface=replace(self.interface, force=known), open_loop=None)

    @property
    def logs(self) -> tuple[Logged, ...]:
        """Return what the parts log, in the order of the log."""
        ahead = (one._replace(ahead=True) for one in self.numerical.logs)
        return (*ahead, *self.feedforward.logs, *self.feedback.logs)

    def base_shear(self) -> Block:
        """Return the base shear at k + n_p as a block without memory: estimates, desired and measured accelerations."""
        estimates, recent, samples, desired = self.interface.force.of_one()
        gain = np.concatenate([estimates, recent, samples, [desired]])[None, :]
        inputs = (
            *self.estimator.outputs,
            *_names("desired_accel_m_s2_at_k_plus", self.lead_samples),
            *self.correction.outputs,
            "desired_accel_m_s2_at_k_plus_lead",
        )
        empty, wide, tall = np.zeros((0, 0)), np.zeros((0, gain.shape[1])), np.zeros((1, 0))
        return Block("base_shear", empty, wide, tall, gain, self.correction.dt_s, inputs, ("base_shear_n",))

    def cell_block(self) -> Block | None:
        """Return the estimator with the load cell as an input, None without one; it stands in the place of that of the
        accelerations (control.load_cell)."""
        return None if self.cell is None else replace(with_cell(self, self.cell)[0], name="kalman_with_load_cell")

    def staircase(self) -> Block:
        """Return the part of a table sample that the hold's staircase makes, from the command (V)."""
        order = max(self.latency_samples, 1) + 1
        a, b, c = np.eye(order, k=-1), np.zeros((order, 1)), np.zeros((1, order))
        b[0, 0], c[0, -2:] = 1.0, self.ripple_sum_m_s2_per_v + np.array([1.0, -1.0]) * self.ripple_m_s2_per_v
        direct = np.zeros((1, 1))
        return Block("staircase", a, b, c, direct, self.correction.dt_s, ("command_v",), ("table_accel_m_s2",))


def _names(kind: str, count: int) -> tuple[str, ...]:
    """Return `kind_0`, `kind_1`, ..."""
    return tuple(f"{kind}_{i}" for i in range(count))
