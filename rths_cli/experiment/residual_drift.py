"""How certain the residual drift of computed storeys with laws is.

A storey that yields keeps a drift that depends on small differences: 1 % of base shear may move it by 10 %. The base
shear of a hybrid test is masses times measured accelerations, and it is that of the table as it moved. Both errors are
taken for one of its size: SIM of the building whose specimen pulls 1 % more, or less, says what that does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.metrics import rms
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.structural_response import inter_storey_drift_m
from rths_cli.structure import Building, Specimen, assemble

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values

CHANGE = 0.01  # of the base shear, for which the change of the residual drift is computed


def with_base_shear(building: Building, factor: float) -> Building:
    """Return a building whose specimen moves as before and pulls `factor` times as strongly: mass, stiffness and
    damping of all that stands on the table are multiplied."""
    stated = building.specimen
    specimen = Specimen(factor * stated.masses_kg, factor * stated.K, factor * stated.C)
    mass = factor * building.interface_experimental_mass_kg
    M, C, K = assemble(building.numerical, specimen, mass)
    return replace(building, specimen=specimen, interface_experimental_mass_kg=mass, M=M, C=C, K=K)


def change_by_base_shear_m(setup: Setup, sim: Response) -> Array:
    """Return the larger change (n_storeys,) in m of SIM's drift at the record's last sample by a base shear that is 1 %
    larger or smaller. Raises InputError where such a building has no SIM."""
    building, ends = setup.building, []
    for factor in (1.0 - CHANGE, 1.0 + CHANGE):
        changed = with_base_shear(building, factor)
        found = reference_of(changed).sim(changed, setup.rig.dt_s, setup.motion.accel_m_s2)
        ends.append(inter_storey_drift_m(found.rel_disp_m)[:, -1] - inter_storey_drift_m(sim.rel_disp_m)[:, -1])
    return np.asarray(np.abs(ends).max(axis=0))


def metrics_of(setup: Setup, sim: Response, change_m: Array, found: Values) -> dict[str, ArrayLike]:
    """Return the metrics of the residual drift's uncertainty by path.

    `change_m` (n_storeys,): that of `change_by_base_shear_m`. `found`: the metrics of EXP-RTHS, of which its tracking
    error counts. Storeys on the table are NaN.
    """
    computed = len(setup.building.numerical.masses_kg)
    change = np.where(np.arange(len(change_m)) < computed, change_m, np.nan)
    tracking = float(np.asarray(found["exp_rths.tracking_rms_m_s2"])) / float(rms(sim.abs_accel_m_s2[computed - 1]))
    shear = float(np.hypot(setup.case.base_shear_uncertainty, tracking))
    return {
        "exp_rths.residual_drift_change_m": change,
        "exp_rths.base_shear_uncertainty": shear,
        "exp_rths.residual_drift_uncertainty_m": change * shear / CHANGE,
    }
