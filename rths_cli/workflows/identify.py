"""Excite the rig of a case and identify table and specimen from its channels."""

from __future__ import annotations

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.control import feedback, feedforward, numerical, sensing
from rths_cli.control.realise import static
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.identification import excitation
from rths_cli.identification.evaluate import Identification
from rths_cli.identification.evaluate import identify as evaluate
from rths_cli.loop.blocks import EXCITATION, Blocks
from rths_cli.loop.drive import play
from rths_cli.lti import Array
from rths_cli.workflows.rigs import IDENTIFICATION, guard_limits, open_rig
from rths_cli.workflows.setup import Progress, Setup, make_setup


class Memory:
    """Identifications already made in this process: cases on the same rig and specimen share one."""

    def __init__(self) -> None:
        self._plans: dict[str, excitation.Excitation] = {}
        self._known: dict[str, Identification] = {}

    def plan(self, setup: Setup) -> excitation.Excitation:
        """Return the excitation of the setup's rig; raises InputError when its settings cannot be met."""
        key = self._key(setup)
        if key not in self._plans:
            self._plans[key] = plan(setup)
        return self._plans[key]

    def identify(self, setup: Setup, progress: Progress) -> Identification:
        """Return the identification of the setup's rig and specimen, made now or earlier in this process."""
        key = self._key(setup)
        if key not in self._known:
            self._known[key] = identify(setup, progress, self.plan(setup))
        return self._known[key]

    def _key(self, setup: Setup) -> str:
        """Return all that an identification depends on, as text."""
        case = setup.case
        table = case.table.model_dump_json(exclude={"after_identification"})
        specimen = case.structure.experimental.model_dump_json()
        mass = case.structure.interface_experimental_mass_kg
        return repr((table, specimen, mass, case.identification, case.sample_rate_hz))


def plan(setup: Setup) -> excitation.Excitation:
    """Return the excitation of the case's rig; raises InputError when its settings cannot be met."""
    options = setup.case.identification
    settings = excitation.ExcitationSettings(
        options.duration_s, options.accel_rms_m_s2, options.low_hz, options.high_hz
    )
    return excitation.plan(setup.rig, settings, options.seed)


def identify(setup: Setup, progress: Progress, planned: excitation.Excitation | None = None) -> Identification:
    """Excite the virtual rig and evaluate its channels.

    Raises LimitError or RigError when the excitation was stopped, RigError when the channels cannot be used.
    """
    planned = planned or plan(setup)
    seconds = planned.command_v.size * setup.rig.dt_s
    progress(f"identification, {seconds:.0f} s on the {setup.case.table.kind} table")
    command, corrected = excite(setup, planned.command_v)
    try:
        return evaluate(command, corrected, setup.rig, setup.floor_masses_kg, planned.parts)
    except InputError as error:
        raise RigError(f"identification of rig {setup.rig.name}: {'; '.join(error.faults)}") from error


def excite(setup: Setup, command_v: Array) -> tuple[Array, Array]:
    """Play a command (n,) through guard and rig; return it as it left and the corrected channels (c, n).

    Raises LimitError when a limit stopped the excitation, RigError when the rig did.
    """
    rig = open_rig(setup, IDENTIFICATION, setup.case.identification.seed)
    drive = np.column_stack([command_v, np.zeros((command_v.size, 2))])
    outcome = play(rig, setup.rig, _listening(setup), EXCITATION, drive, guard_limits(setup))
    where, advice = f"identification of rig {setup.rig.name}", "lower identification.accel_rms_m_s2"
    if outcome.rig_fault:
        raise RigError(f"{where}: {outcome.rig_fault}; {advice}")
    if outcome.stopped_by_limit:
        raise LimitError(f"{where}: {outcome.stopped_by_limit}; {advice}")
    return outcome.log.command_v, outcome.log.corrected


def _listening(setup: Setup) -> Blocks:
    """Return blocks that only correct the sensors; an excitation uses no others."""
    dt, channels = setup.rig.dt_s, len(setup.rig.channels)
    silent = static(np.zeros((1, channels)), dt, "kalman", (), ())
    return Blocks(
        correction=sensing.correction(setup.rig.channels, dt),
        estimator=silent,
        numerical=numerical.interface(setup.building.numerical, dt),
        feedforward=feedforward.direct(setup.rig.gain_m_per_v, dt),
        feedback=feedback.none(dt),
        shear_estimate=np.zeros(1),
        shear_recent=np.zeros(0),
        shear_measured=np.zeros(channels),
        shear_desired=0.0,
        latency_samples=setup.rig.latency_samples,
    )


def identify_case(path: str, settings: tuple[str, ...], progress: Progress) -> tuple[Identification, Setup]:
    """Load one case and identify its rig; raises InputError or RigError."""
    setup = make_setup(load_cases([path], settings)[0])
    return identify(setup, progress), setup
