"""`Blocks`, the data class of one run's designed blocks; experiment/design.py fills it, loop/step_arrays.py compiles
it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.interface import Interface
from rths_cli.control.load_cell import CellInput, with_cell
from rths_cli.control.part_designs import Logged, PartDesign
from rths_cli.control.python_parts import PythonPart
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Block
from rths_cli.structure import Specimen


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

    def fault(self) -> str:
        """Return what a part that is a Python object raised in the last run, "" if none did."""
        faults = [(one.name, one.fault) for one in self.in_python if one.fault is not None]
        return f"{faults[0][0]} failed: {type(faults[0][1]).__name__}: {faults[0][1]}" if faults else ""

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
