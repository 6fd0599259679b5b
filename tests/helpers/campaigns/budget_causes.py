"""Runs of EXP-RTHS with one cause of errors switched on, and the causes that the budget names.

Most causes begin after the identification: the model is that of the rig as declared, the run is played on another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.analysis.error_attribution import Cause
from rths_cli.analysis.references import reference_of
from rths_cli.case.load import load_cases
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, evaluated, plan_run, play_run, run_of
from rths_cli.experiment.run_case import sim_of
from rths_cli.experiment.run_metrics import errors
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.numerics.shared_values import SharedValues

CASE = "el_centro_low_ff_fb"
CHANGED, HIDDEN, PHYSICS = "table.after_identification.", "table.imperfections.", "table.physics."
PITCH = f"{HIDDEN}pitch.storey_height_m=0.2"


@dataclass(frozen=True)
class Switched:
    """Settings KEY=VALUE of one cause, whether it is there at the identification too, and what it must be called."""

    settings: tuple[str, ...]
    name: str  # part of the first cause's text
    before: bool = False


CAUSES: dict[str, Switched] = {
    "Coulomb friction x10": Switched((f"{CHANGED}coulomb_factor=10",), "friction"),
    "specimen's stiffness -1 %": Switched((f"{CHANGED}specimen_stiffness_factor=0.99",), "specimen's stiffness"),
    "specimen's masses +1 %": Switched((f"{CHANGED}payload_factor=1.01",), "specimen's stiffness, masses"),
    "gain of the table +0.5 %": Switched((f"{PHYSICS}gain_m_per_v=0.0079395",), "gain of the table, or of all"),
    "command 100 us late": Switched((f"{HIDDEN}converters.command_skew_s=1e-4",), "instants of the converters"),
    "gain of table sensor +0.5 %": Switched((f"{HIDDEN}channels.gain_error=[0.005, 0, 0]",), "gain of table ("),
    "gain of floor_2 +0.5 %": Switched((f"{HIDDEN}channels.gain_error=[0, 0.005, 0]",), "gain of floor_2"),
    "gain of floor_3 +0.5 %": Switched((f"{HIDDEN}channels.gain_error=[0, 0, 0.005]",), "gain of floor_3"),
    "gain of all sensors +0.5 %": Switched((f"{HIDDEN}channels.gain_error=0.005",), "gain of the table, or of all"),
    "gains drift, 0.5 %": Switched(
        (f"{HIDDEN}channels.gain_change_between_runs={{std: 0.005}}",), "gains of several channels", before=True
    ),
    "AC corners +20 %": Switched(  # declared certain: the identification would find and correct them
        (f"{HIDDEN}channels.high_pass_error=0.2", "table.uncertainty.corner=0"), "AC corners of all", before=True
    ),
    "AC corner of table +20 %": Switched((f"{HIDDEN}channels.high_pass_error=[0.2, 0, 0]",), "AC corner of table"),
    "low passes -45 %": Switched((f"{HIDDEN}channels.low_pass_error=-0.45",), "table's channel"),
    "floor_3 200 us late": Switched((f"{HIDDEN}channels.skew_s=[0, 0, 2e-4]",), "instant or low pass of floor_3"),
    "noise of 20 mm/s^2": Switched(("table.sensors.noise_rms_m_s2=2e-2",), "sensor noise", before=True),
    "13 bits": Switched(("table.converters.bits=13",), "rounded samples", before=True),
    "method paper": Switched(("method=paper",), "coupling", before=True),
    "1 kHz, CR": Switched(("sample_rate_hz=1000", "integration=cr"), "coupling", before=True),
    "amplifier's distortion 1 %": Switched((f"{HIDDEN}amplifier.distortion=0.01",), "distortion"),
    "amplifier's dead band 2 N": Switched((f"{HIDDEN}amplifier.crossover_n=2",), "dead band"),
    "actuator slower by a half": Switched((f"{PHYSICS}actuator_time_constant_s=0.00225",), "lag of the actuator"),
    "softening 2 %": Switched((f"{HIDDEN}specimen.softening=0.02",), "softening"),
    "friction of joints 0.1 N": Switched((f"{HIDDEN}specimen.joint_friction_n=0.1",), "joints"),
    "pitch 40 Hz": Switched((f"{HIDDEN}pitch.frequency_hz=40", PITCH), "pitch"),
}


@dataclass(frozen=True)
class Named:
    """The error over that of SIM-DELAY in the worst storey, and the named causes with theirs, the largest first."""

    error: float
    causes: tuple[Cause, ...]


def named_causes(switched: Switched, memory: Memory, *always: str) -> Named:
    """Play the run and return what the budget names; raises InputError where the case cannot be run.

    `always`: further settings, of the identification too.
    """
    identified, played = (_setup((*always, *(switched.settings if on else ()))) for on in (switched.before, True))
    known = memory.known(identified, lambda _: None)
    identified = identified.calibrated(known.found)
    checked = verdict_on(identified, known)
    assert checked.design is not None
    plan = plan_run(identified, checked.design, HYBRID_TEST, known.found)
    outcome = play_run(plan if switched.before else plan_run(played, checked.design, HYBRID_TEST), 0)
    run = run_of(outcome, identified, HYBRID_TEST, checked.design.blocks.lead_samples, plan.expected)
    sim = sim_of(identified, SharedValues())
    run = evaluated(run, identified, sim, checked.loop)
    dt, ground = identified.rig.dt_s, identified.motion.accel_m_s2
    building = identified.building
    delayed = reference_of(building).sim_delay(building, dt, ground, identified.case.delay_s, sim)
    late = errors("late", None, (sim.abs_accel_m_s2, delayed.abs_accel_m_s2, None), dt)["late.rms_error_m_s2"]
    return Named(float(np.max(np.asarray(run.metrics["exp_rths.rms_error_m_s2"]) / np.asarray(late))), run.causes)


def _setup(settings: tuple[str, ...]) -> Setup:
    return make_setup(load_cases([CASE], (*settings, "runs=[sim, exp_rths]"))[0], ("check", "model"))
