"""The base shear from a load cell under the specimen: what it shows, and how it enters the estimator.

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

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.interface import Interface
from rths_cli.numerics.lti import Array, Block

if TYPE_CHECKING:
    from rths_cli.control.designed_blocks import Blocks
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
