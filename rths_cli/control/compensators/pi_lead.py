"""PI control of the displacement, behind a phase lead of the desired displacement.

    u = (k_p + k_i / s) (L(s) d - x),  L(s) = (b s + a) / (s + a),  both by Tustin's rule,

with desired displacement d and measured displacement x. The defaults are those of the 2020 benchmark's release, which
leads by (b - 1) / a = 5.81 ms at low frequency. What the lead and the loop leave of the plant's lag remains: 4.6 ms on
that benchmark. It needs a measured displacement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

SOURCE = (
    "C. E. Silva, D. Gomez, A. Maghareh, S. J. Dyke, B. F. Spencer: Benchmark control problem for real-time hybrid "
    "simulation. Mechanical Systems and Signal Processing 135 (2020) 106381"
)
OPTIONS = {
    "proportional": (2.0, 0.0, 1000.0, "k_p, command over displacement error"),
    "integral_per_s": (95.0, 0.0, 1e5, "k_i in 1/s"),
    "lead_b": (50.8316336, 0.0, 1e5, "b, gain of the lead at high frequency"),
    "lead_a_rad_s": (8570.39733944, 1.0, 1e6, "a, pole of the lead in rad/s"),
}
STATES = 4  # desired displacement, lead, error and command before


def design(plant: Plant, options: dict[str, float | None]) -> list[float]:
    """Return the coefficients of lead and PI in discrete time."""
    plant.needs_displacement("pi_lead")
    gain, integral, b, a = (float(options[name] or 0.0) for name in OPTIONS)
    rate, half = 2.0 / plant.dt_s, 0.5 * plant.dt_s * integral
    return [(b * rate + a) / (rate + a), (a - b * rate) / (rate + a), (a - rate) / (rate + a), gain + half, half - gain]


def command(p: Array, state: Array, next_state: Array, desired: Array, measured: Array, sent: float) -> float:
    """Return the command in m."""
    leading = p[0] * desired[2] + p[1] * state[0] - p[2] * state[1]
    error = leading - measured[0]
    made = state[3] + p[3] * error + p[4] * state[2]
    next_state[0], next_state[1], next_state[2], next_state[3] = desired[2], leading, error, made
    return made
