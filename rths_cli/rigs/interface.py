"""The interface of every rig: open, arm, exchange, rest, close; and optional ones for compiled loops and links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from rths_cli.errors import RigError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array, Integers
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo
from rths_cli.rigs.stepped_test import Answer, Designed

if TYPE_CHECKING:
    from rths_cli.case.storey_law_schema import StoreyLaws
    from rths_cli.rigs.udp.link import Link
    from rths_cli.structure import Specimen

__all__ = [
    "COMPILED_LINK",
    "COMPILED_PLANT",
    "COUNTED_CLOCK",
    "MISSED_EDGES",
    "OF_PLUGINS",
    "SESSIONS",
    "SESSION_NAMES",
    "SPECIMEN",
    "STANDARD_GRAVITY_M_S2",
    "STEPS_ITSELF",
    "TRUTH",
    "Channel",
    "Commands",
    "Converters",
    "CountingRig",
    "Limits",
    "LinkedRig",
    "Rig",
    "RigInfo",
    "SessionRig",
    "SimulatedRig",
    "SpecimenRig",
    "SteppedRig",
    "TruthfulRig",
    "as_commands",
    "counts_time",
    "linked",
    "missed_intervals",
    "name_session",
    "one_actuator",
    "only_command",
    "simulated",
    "specimen_known",
    "stepped",
    "truthful",
]


Commands = float | Array
"""Commands in V: a number for a rig with one actuator, an array (a,) for a rig with several."""
COMPILED_PLANT, COMPILED_LINK, MISSED_EDGES = "compiled plant", "compiled link", "missed edges"
COUNTED_CLOCK, TRUTH, SPECIMEN, SESSIONS = "counted clock", "truth", "specimen", "sessions"
STEPS_ITSELF = "steps itself"
"""What a driver's class may say in `offers` that its rigs have beside `exchange`; a class without it offers nothing."""
OF_PLUGINS = (MISSED_EDGES, COUNTED_CLOCK, TRUTH, SPECIMEN, SESSIONS)
"""What a rig of a package may offer."""


class Rig(Protocol):
    """A rig in the hands of one process. Between `arm` and `rest` each `exchange` takes one sample interval."""

    info: RigInfo

    def open(self) -> None:
        """Take hold of the rig; raise RigError when it cannot be had."""

    def arm(self) -> Array:
        """Enable motion and return the first samples in V, shape (n_channels,)."""

    def exchange(self, command_v: Commands) -> Array:
        """Send the commands, wait for the next sample instant, return its samples in V, shape (n_channels,).

        Samples are as the converter gives them: the loop takes zero offsets and signs out. The array belongs to the
        rig and is overwritten by the next call. Raises RigError on a fault of the rig.
        """

    def rest(self) -> None:
        """Bring the table to rest at zero and disable motion."""

    def close(self) -> None:
        """Let go of the rig; safe to call twice."""


class SimulatedState(Protocol):
    """What compiled code reads of a simulated table's state."""

    @property
    def state(self) -> Array:
        """Return an array that begins with the table's displacement in m at the last sampling instant."""

    @property
    def middle_velocity(self) -> Array:
        """Return the true absolute velocities of table and floors in the middle of the last interval."""

    @property
    def fault(self) -> Integers:
        """Return an array (1,): 0, or plant_kernel.END_STOP."""


class SimulatedPlant(Protocol):
    """Equations of motion in compiled code, with methods of a `part_class`; `state` is of the plant's own kind."""

    def hold_command(self, s: Any, command_v: float) -> None:
        """Queue a command and advance by a sample interval."""

    def read_channels(self, s: Any, noise: Array, samples: Array) -> None:
        """Write the converted samples in V, (n_channels,), for one row of standard normal noise."""


class SimulatedRig(Rig, Protocol):
    """A rig whose equations of motion compiled code can advance: a whole run needs no `exchange`."""

    plant: SimulatedPlant
    state: SimulatedState

    def restart(self) -> None:
        """Put the table at rest and start the noise anew."""

    def noise(self, rows: int) -> Array:
        """Return the next rows of standard normal noise, (rows, normals): the plant says how many it takes."""

    def noise_at_rest(self, rows: int) -> Array | None:
        """Return noise of a rest before the run, (rows, normals); None: its channels have no zero to be taken."""


class LinkedRig(Rig, Protocol):
    """A rig behind a link that compiled code can use itself, at the instants of this machine's clock.

    `peer` names the other end; `at_rest` tells after `rest` whether that confirmed it.
    """

    peer: str
    at_rest: bool

    @property
    def link(self) -> Link:
        """Return the open link; raises RigError when there is none."""

    @property
    def counts(self) -> dict[str, int]:
        """Return how many packets were sent, answered, lost, ... in this session."""

    def fault(self) -> str:
        """Return what is wrong with target or link, empty when nothing is."""


class CountingRig(Rig, Protocol):
    """A rig on a sample clock of its own that counts the edges which passed unseen since it was armed."""

    missed: int


class TruthfulRig(Rig, Protocol):
    """A simulated rig that tells the true motion of its table and floors."""

    def truth(self) -> tuple[Array, float]:
        """Return the true absolute velocities in m/s of table and floors, (1 + n_floors,), in the middle of the
        interval that the last exchange took, and the table's true displacement in m at its samples; zeros after arm."""


class SpecimenRig(Rig, Protocol):
    """A simulated rig that tells its specimen as it is."""

    def specimen(self) -> tuple[Specimen, StoreyLaws]:
        """Return the specimen as it is in this session, without what laws add at rest, and the laws of its storeys."""


class SessionRig(Rig, Protocol):
    """A rig that is told what each of its sessions is for."""

    def session(self, name: str) -> None:
        """Take the name of the session that `open` begins next, one of SESSION_NAMES."""


class SteppedRig(Rig, Protocol):
    """A rig whose own computer steps a designed test; see `rigs/udp/stepping_rig.py`."""

    watchdog_s: float

    def agree(self, designed: Designed) -> None:
        """Raise RigError unless it holds the step of this case and model."""

    def begin(self, record: Array) -> None:
        """Send the record (n, 3) and start the test."""

    def fetch(self, first: int, stop: bool) -> Answer:
        """Return where the test stands, with rows of its log from `first` on."""


SESSION_NAMES = ("doctor", "listening", "probe", "identification", "verification", "shake_table", "exp_rths")


def counts_time(rig: Rig) -> bool:
    """Return whether a rig's clock is counted in exchanges: each returns at once, whenever it is called."""
    return _offers(rig, COUNTED_CLOCK) or _offers(rig, COMPILED_PLANT)


def truthful(rig: Rig) -> TruthfulRig | None:
    """Return a rig that tells the truth of its table, None for one that does not."""
    return cast("TruthfulRig", rig) if _offers(rig, TRUTH) else None


def specimen_known(rig: Rig) -> SpecimenRig | None:
    """Return a rig that tells its specimen as it is, None for one that does not."""
    return cast("SpecimenRig", rig) if _offers(rig, SPECIMEN) else None


def name_session(rig: Rig, name: str) -> None:
    """Tell a rig that wants to know what its next session is for, one of SESSION_NAMES."""
    if _offers(rig, SESSIONS):
        cast("SessionRig", rig).session(name)


def as_commands(command_v: Array) -> Commands:
    """Return commands (a,) in V as `exchange` takes them, in an array that is the rig's to keep."""
    return float(command_v[0]) if command_v.size == 1 else command_v.copy()


def one_actuator(info: RigInfo) -> None:
    """Raise RigError for a description with several actuators, of a kind of rig that has one."""
    if info.actuators != 1:
        raise RigError(f"rig {info.name}: {info.actuators} actuators, but a rig of kind {info.kind} has one")


def only_command(info: RigInfo, command_v: Commands) -> float:
    """Return the command in V of a rig with one actuator; raises RigError for several commands."""
    given = np.ravel(command_v)
    if given.size != 1:
        raise RigError(f"rig {info.name}: {given.size} commands for one actuator")
    return float(given[0])


def simulated(rig: Rig) -> SimulatedRig | None:
    """Return a rig that compiled code can advance, None for one that must be exchanged with."""
    return cast("SimulatedRig", rig) if _offers(rig, COMPILED_PLANT) else None


def linked(rig: Rig) -> LinkedRig | None:
    """Return a rig whose link compiled code can use, None for one that is exchanged with from Python."""
    return cast("LinkedRig", rig) if _offers(rig, COMPILED_LINK) else None


def stepped(rig: Rig) -> SteppedRig | None:
    """Return a rig whose own computer steps the test, None for one that takes commands."""
    return cast("SteppedRig", rig) if _offers(rig, STEPS_ITSELF) else None


def missed_intervals(rig: Rig) -> int | None:
    """Return how many edges of a rig's own sample clock passed unseen since it was armed; None where it counts none."""
    return cast("CountingRig", rig).missed if _offers(rig, MISSED_EDGES) else None


def _offers(rig: Rig, what: str) -> bool:
    return what in getattr(rig, "offers", ())
