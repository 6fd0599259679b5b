"""The error of a hybrid test whose specimen is not quite the identified one, for which the control was designed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rths_cli.analysis.closed_loop_response import hybrid
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import Known
from rths_cli.analysis.sim_fourier_lines import sim_lines
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.structure import Building, assemble


def error_if_changed(known: Known, building: Building, nominal: ComplexArray, change: float) -> Array:
    """Return the RMS error (n_storeys,) in m/s^2 that a relative change of the specimen's stiffness causes, the same in
    all storeys, to first order.

    `building`: as identified. `nominal` (m,): the table's acceleration in the undisturbed test. The reference is SIM of
    the building with the changed specimen, as the true error's is.
    """
    numerical, mass = building.numerical, building.interface_experimental_mass_kg
    changed = replace(building.specimen, K=building.specimen.K * (1.0 + change))
    whole = Building(numerical, changed, mass, *assemble(numerical, changed, mass), ())
    moved = specimen_state_space(changed).response(known.lines.frequency_hz)[:, 0] - known.floors[1:]
    samples = np.vstack([np.zeros_like(nominal), moved * nominal])
    of_test = hybrid(known.loop, np.zeros_like(known.ground), samples).storeys
    of_sim = sim_lines(whole, known.lines, known.ground[0]) - known.sim
    return rms(known.lines.evaluated(of_test - of_sim))
