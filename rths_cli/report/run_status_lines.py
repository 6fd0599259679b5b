"""The live view of a run on a real rig as text: several lines for a terminal, or one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rths_cli.loop.live_view import View

BAR = 30  # characters of the progress bar


def live_lines(label: str, view: View) -> list[str]:
    """Return the lines that a terminal shows during a run."""
    done = min(max(view.time_s / view.total_s, 0.0), 1.0)
    filled = round(BAR * done)
    used = "  ".join(f"{name} {100.0 * share:.0f} %" for name, share in view.used.items())
    return [
        f"{label}: {view.state}  [{'#' * filled}{'.' * (BAR - filled)}] {max(view.time_s, 0.0):6.1f} of "
        f"{view.total_s:.1f} s, {max(view.total_s - view.time_s, 0.0):.0f} s left",
        f"  peak acceleration  desired {view.desired_m_s2:.3f}  measured {view.measured_m_s2:.3f} m/s^2, "
        f"tracking error {view.error_rms_m_s2:.4f} rms",
        f"  of the limits      {used}",
        f"  loop               overruns {view.overruns}  lost {view.lost}  latest wake-up {view.late_us:.0f} us  "
        f"longest step {view.compute_us:.0f} us",
        "  s, space or Ctrl-C leads the table to rest",
    ]


def one_line(label: str, view: View) -> str:
    """Return the state of a run in one line."""
    nearest = max(view.used, key=view.used.__getitem__, default="")
    of_limits = f", {nearest} at {100.0 * view.used[nearest]:.0f} % of its limit" if nearest else ""
    return (
        f"{label} {view.state}, {max(view.time_s, 0.0):.1f} of {view.total_s:.1f} s, tracking error "
        f"{view.error_rms_m_s2:.4f} m/s^2 rms{of_limits}, {view.overruns} overruns, {view.lost} lost"
    )
