"""Parts of the step that are Python objects: a model in another program, or a trial of a compensator.

They are called once per instant and hold the interpreter lock meanwhile. Offline that costs time only. On a rig the
rehearsal before the test measures it, and a rate that cannot be kept is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from rths_cli.control.interface import Logged, not_judged
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.user_functions import Callback
from rths_cli.structure import Building


class Substructure(Protocol):
    """What a numerical substructure in Python offers. Its acceleration is affine in the force of the same instant, by
    `direct` (i, i) in m/s^2 per N, which does not change."""

    direct: Array

    def free(self, ground: Array) -> Array:
        """Return the absolute accelerations (i,) of the interface at this instant without interface force."""

    def advance(self, ground: Array, force: Array) -> Array:
        """Return the interface's absolute motion (3, i) at this instant, and go to the next one.

        `ground` (3,): acceleration, velocity and displacement of the ground; `force` (i,) in N on the interface.
        """


class Compensator(Protocol):
    """What a feedforward in Python offers."""

    def command(self, motion: Array, corrected: Array, sent: Array) -> Array:
        """Return the commands (a,) in V for the desired motion (3, i) at k + n_p, from the accelerations (c,) measured
        at t_k and the commands (., a) that were sent, the latest first."""


Model = TypeVar("Model")


@dataclass(frozen=True)
class PythonPart(Generic[Model]):
    """The design of a part that is a Python object, which `make` makes anew for each run: its state is not in the step.

    `judged`: its linear block at the start, by which it is checked; None: it cannot be judged. `callbacks`: those of
    each step that was assembled from it; compiled code knows their addresses, so they live as long as the design.
    """

    name: str
    make: Callable[[], Model]
    judged: Block | None = None
    logs: tuple[Logged, ...] = ()
    affine: bool = True
    multiplications: int = 0
    callbacks: list[tuple[Callback, ...]] = field(default_factory=list, compare=False)

    @property
    def linear(self) -> bool:
        """Return False: what it will give cannot be foreseen from the state of the step."""
        return False

    def linearised(self, at: Array | None = None) -> Block:
        """Return the stated linear block; raises InputError where there is none."""
        if self.judged is None:
            raise not_judged(self.name)
        return self.judged

    @property
    def fault(self) -> BaseException | None:
        """Return what the object raised in the last run, None if it raised nothing."""
        last = self.callbacks[-1] if self.callbacks else ()
        return next((one.fault for one in last if one.fault is not None), None)


@dataclass(frozen=True)
class PythonSubstructure(PythonPart[Substructure]):
    """A numerical substructure in Python.

    `building`: the whole building that it and the specimen of the case make, for which SIM and SIM-DELAY are computed;
    None: it declares none.
    """

    building: Building | None = field(default=None, compare=False)


@dataclass(frozen=True)
class PythonFeedforward(PythonPart[Compensator]):
    """A feedforward in Python; it is given the last `remembers` commands that were sent, at most the rig's latency and
    one more."""

    remembers: int = 2
