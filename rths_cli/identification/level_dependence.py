"""Why table or specimen respond differently at another level: friction, hardening spring, gain.

Each cause acts like a change of the command that depends on the motion. The response at low level over that at full
level, minus 1, therefore has a shape over frequency that follows from the table's model G, times a real factor:

- dry friction is an equivalent dashpot that weakens as the motion grows: -a G exp(s T) / s, a > 0;
- a hardening suspension is an equivalent spring that stiffens as the motion grows: b G exp(s T) / s^2, b > 0; for a
  softening one, or for friction that sticks and yields like a spring, b < 0;
- an amplifier or actuator whose gain falls as the level grows gives a positive constant, one with a dead band a
  negative constant.

The model's delay T is removed, because the motion acts without delay (J. B. Roberts and P. D. Spanos, Random Vibration
and Statistical Linearization). Yielding storeys show in the storeys' own equations, whatever the table does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.findings import Finding
from rths_cli.identification.chain_residual import explained, grouped
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import LevelCauses
from rths_cli.identification.table_fit import within
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.rigs.description import RigInfo

FRICTION, HARDENING, SOFTENING, COMPRESSION, DEAD_BAND, DRAG, SPECIMEN = (
    "friction", "hardening", "softening", "compression", "dead band", "drag", "specimen",
)  # fmt: skip
HIGHEST_HZ = 40.0  # of the usual compared band: end of the lines in which a cause is searched
CLEAR = 4.0  # least significance of a cause, in standard errors
SHARE, ALIKE = 0.5, 0.9  # least explained fraction of the difference beyond scatter; fraction of the best cause's
YIELDS = 0.005  # least relative change of a storey's stiffness


def causes_of(causes: LevelCauses) -> tuple[Finding, ...]:
    """Return the causes, the table's first; () if the data show none."""
    found = [Finding(f"cause.{cause.replace(' ', '_')}") for cause in causes.table]
    found += [Finding("cause.specimen", {"storeys": causes.storeys})] if causes.storeys else []
    return tuple(found)


def of_table(low: Frf, full: Frf, model: Model, compared: ComparedBand = USUAL) -> tuple[str, ...]:
    """Return the causes that explain how the table's response differs between low and full level, the likeliest first.

    Both responses are divided by the model's. () is returned if they do not differ, or if no cause explains it.
    """
    highest_hz = min(compared.with_high(HIGHEST_HZ), full.frequency_hz[-1])
    inside = within(low.frequency_hz, (compared.low_hz, highest_hz))
    f = low.frequency_hz[inside]
    over = np.interp(f, full.frequency_hz, full.response)
    error = np.hypot(low.relative_error[inside], np.interp(f, full.frequency_hz, full.relative_error))
    differs = low.response[inside] / over - 1.0
    power = float(np.sum(np.abs(differs / error) ** 2))
    beyond = power - 2.0 * len(f)
    found: dict[str, float] = {}
    for shape, (positive, negative) in _shapes(model, f):
        weighted = shape / error
        size = float(np.linalg.norm(weighted))
        along = float(np.real(np.vdot(weighted, differs / error))) / size
        if abs(along) > CLEAR * np.sqrt(low.bandwidth_lines) and along**2 > SHARE * beyond:
            found[positive if along > 0.0 else negative] = along**2
    most = max(found.values(), default=0.0)
    return tuple(sorted((kind for kind in found if found[kind] >= ALIKE * most), key=lambda kind: -found[kind]))


def _shapes(model: Model, frequency_hz: Array) -> list[tuple[ComplexArray, tuple[str, str]]]:
    """Return the shapes (m,) over frequency, each with the cause for a positive and for a negative factor."""
    s = 2j * np.pi * frequency_hz
    accel = np.sign(model.low_frequency_gain_m_per_v) * model.response(frequency_hz) * np.exp(s * model.delay_s)
    return [
        (-accel / s, (FRICTION, DRAG)),
        (accel / s**2, (HARDENING, SOFTENING)),
        (np.ones(len(s), dtype=complex), (COMPRESSION, DEAD_BAND)),
    ]


def of_specimen(
    records: Sequence[Record], quiet: Record | None, info: RigInfo, masses_kg: Array, band_hz: tuple[float, float]
) -> tuple[int, ...]:
    """Return the storeys (from 1) whose stiffness at low level differs significantly from that at full level."""
    if quiet is None or len(masses_kg) == 0:
        return ()
    low, full = (explained(grouped(each, info, masses_kg, band_hz)) for each in ((quiet,), records))
    known = np.isfinite(low.stiffness_n_per_m * full.stiffness_n_per_m) & (low.stiffness_n_per_m > 0.0)
    known &= full.stiffness_n_per_m > 0.0
    change = np.zeros(len(known))
    change[known] = np.log(low.stiffness_n_per_m[known] / full.stiffness_n_per_m[known])
    error = np.hypot(low.relative_error, full.relative_error)
    return tuple(int(storey) + 1 for storey in np.flatnonzero(np.abs(change) > np.maximum(CLEAR * error, YIELDS)))
