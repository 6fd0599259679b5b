"""The error of a hybrid test whose specimen is not quite the identified one, for which the control was designed."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.closed_loop_response import LoopResponse, Motion, hybrid
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import Known
from rths_cli.analysis.sim_fourier_lines import sim_lines
from rths_cli.numerics.lti import Array
from rths_cli.structure import Building


def error_if_changed(known: Known, nominal: Motion, changed: Building, loop: LoopResponse) -> Array:
    """Return the RMS error (n_storeys,) in m/s^2 that another specimen than the identified one causes.

    `nominal`: the undisturbed test with the identified specimen. `changed` and `loop`: building and loop with the other
    one, the control as designed. The reference is SIM of the building with the other specimen, as the true error's is.
    """
    of_test = hybrid(loop, known.ground, np.zeros_like(nominal.corrected)).storeys - nominal.storeys
    of_sim = sim_lines(changed, known.lines, known.ground[0]) - known.sim
    return rms(known.lines.evaluated(of_test - of_sim))
