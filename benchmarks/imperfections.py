"""What does each imperfection of a laboratory cost? FF+FB on the paper's building, one imperfection at a time.

    python benchmarks/imperfections.py                        all tables of docs/background/imperfections.md
    python benchmarks/imperfections.py NAME...                these imperfections alone
    python benchmarks/imperfections.py --laboratories 30      laboratories of aps400_laboratory, seeds 0 to 29
    python benchmarks/imperfections.py --case CASE ...        of other cases than the paper's four with FF+FB
    python benchmarks/imperfections.py --set KEY=VALUE ...    with other settings of the cases, as `rths run --set`

Printed as Markdown, each of the worst storey: error of EXP-RTHS over that of SIM-DELAY. First where rig file and
identification take sensors and masses as exact, then where the rig file states the uncertainties of
aps400_laboratory, so that the identification calibrates. `declared` is the true error against SIM of the building as
declared, `as it is` against SIM of the declared computed storeys below the specimen as it is (SIM-DELAY likewise);
`predicted` and `bound` are the check's error and its bound of the true error, with 95 %. Method `best`, seed 0 but for
laboratories; refused tests are run all the same.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from options import arguments, parsed

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.numerics.shared_values import SharedValues

SHORT = ("--case", "el_centro_low_ff_fb", "--laboratories", "1")

PITCH = "pitch.storey_height_m=0.2"
ALONE: dict[str, tuple[str, ...]] = {
    "none": (),
    "table sensor +1 %": ("channels.gain_error=[0.01, 0, 0]",),
    "floor sensors +1 %": ("channels.gain_error=[0, 0.01, 0.01]",),
    "top sensor +1 %": ("channels.gain_error=[0, 0, 0.01]",),
    "all sensors +1 %": ("channels.gain_error=0.01",),
    "floor masses +1 %": ("masses.weighing_error=0.01",),
    "top mass +0.3 %": ("masses.weighing_error=[0, 0.003]",),
    "AC corners +5 %": ("channels.high_pass_error=0.05",),
    "AC corners +20 %": ("channels.high_pass_error=0.2",),
    "low passes +20 %": ("channels.low_pass_error=0.2",),
    "deck 40 Hz": ("deck.frequency_hz=40",),
    "deck 60 Hz": ("deck.frequency_hz=60",),
    "deck 100 Hz": ("deck.frequency_hz=100",),
    "pitch 80 Hz": ("pitch.frequency_hz=80", PITCH),
    "pitch 30 Hz": ("pitch.frequency_hz=30", PITCH),
    "command 25 us late": ("converters.command_skew_s=25e-6",),
    "command 100 us late": ("converters.command_skew_s=1e-4",),
    "table channel 25 us late": ("channels.skew_s=[25e-6, 0, 0]",),
    "jitter 10 us": ("converters.command_jitter_s=1e-5", "converters.sample_jitter_s=1e-5"),
    "jitter 50 us": ("converters.command_jitter_s=5e-5", "converters.sample_jitter_s=5e-5"),
    "crossover 0.2 N": ("amplifier.crossover_n=0.2",),
    "crossover 1 N": ("amplifier.crossover_n=1",),
    "distortion 0.2 % at 3 V": ("amplifier.distortion=0.002",),
    "distortion 1 % at 3 V": ("amplifier.distortion=0.01",),
    "Dahl 0.3 N, 0.3 mm": ("friction.presliding_m=3e-4",),
    "Stribeck, static 2x": ("friction.stribeck_excess=1",),
    "suspension": ("suspension.stiffness_n_per_m=790", "suspension.cubic_n_per_m3=9.5e4"),
    "force factor 15 %": ("force_factor.drop=0.15",),
    "gain of the command +0.02 % a second": ("amplifier.gain_drift_per_s=2e-4",),
    "gains 0.05 % between runs": ("channels.gain_change_between_runs={std: 0.0005}",),
    "gains 0.3 % between runs": ("channels.gain_change_between_runs={std: 0.003}",),
    "hum 5 mm/s^2": ("channels.hum_v=5e-4",),
    "hum 30 mm/s^2": ("channels.hum_v=3e-3",),
    "transverse 3 %": (
        "channels.transverse_sensitivity=[0.03, -0.03, 0.03]", "guides.lateral_share=0.02", "pitch.frequency_hz=80",
    ),
    "softening 2 %": ("specimen.softening=0.02",),
    "softening 5 %": ("specimen.softening=0.05",),
    "joints 0.1 N": ("specimen.joint_friction_n=0.1",),
    "joints 0.5 N": ("specimen.joint_friction_n=0.5",),
    "offsets 2 mV": ("channels.offset_v=2e-3",),
    "offsets walk 0.02 mm/s^2 in 1 s": ("channels.offset_walk_v_per_sqrt_s=2e-6",),
}  # fmt: skip
CASES = ("el_centro_low_ff_fb", "el_centro_high_ff_fb", "hachinohe_low_ff_fb", "hachinohe_high_ff_fb")
LABORATORIES = 30
EXACT = ("table.sensors.sensitivity_uncertainty=0", "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0}")
STATED = (
    "table.sensors.sensitivity_uncertainty=0.01",
    "table.uncertainty={corner: 0.1, skew_s: 25e-6, mass: 0.003, drift: 0.0005}",
)
ERRORS = ("measured", "declared", "as it is")
WORST = (
    "check.rms_error_m_s2",
    "check.true_error_bound_m_s2",
    "exp_rths.rms_error_m_s2",
    "exp_rths.rms_error_m_s2_true",
)
HEAD = ("", "exact: predicted", *ERRORS, "check", "calibrated: predicted", "bound", *ERRORS, "check")


@dataclass(frozen=True)
class Found:
    """Errors of the worst storey over that of SIM-DELAY, NaN where there are none, and the check's verdict."""

    predicted: float = np.nan
    bound: float = np.nan
    measured: float = np.nan
    declared: float = np.nan
    as_it_is: float = np.nan
    verdict: str = ""

    def cells(self, bound: bool) -> list[str]:
        """Return the cells of a table's row."""
        values = [self.predicted, *([self.bound] if bound else []), self.measured, self.declared, self.as_it_is]
        return [*map(_text, values), self.verdict]


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4f}" if value < 0.1 else f"{value:.3f}"


def found(case: str, settings: Sequence[str], shared: SharedValues) -> Found:
    """Return the errors of a case."""
    chosen = (*settings, "runs=[sim, sim_delay, exp_rths]")
    try:
        setup = make_setup(load_cases([case], chosen)[0], ("check", "model"), shared)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.h5"
            ended = run_case(setup, path, Memory(), "imperfections.py", lambda _: None, shared, series="none")
            result = read_result(path)
    except RthsError as error:
        print(error, file=sys.stderr)
        return Found(verdict="refused")
    if ended.status != "complete":
        print(ended.reason, file=sys.stderr)
        return Found(verdict=ended.status)
    late = np.asarray(result.metrics["sim_delay.rms_error_m_s2"])
    worst = {path: float(np.max(np.asarray(value) / late)) for path, value in result.metrics.items() if path in WORST}
    return Found(
        *(worst.get(path, np.nan) for path in WORST),
        float(np.max(np.asarray(result.metrics["exp_rths.true_reference_ratio"]))),
        str(result.attributes.get("check_verdict", "")),
    )


def row(name: str, exact: Found, calibrated: Found) -> str:
    """Return a row of the table."""
    return f"| {' | '.join([name, *exact.cells(False), *calibrated.cells(True)])} |"


def both(case: str, settings: Sequence[str], shared: SharedValues) -> tuple[Found, Found]:
    """Return the errors with an identification that takes sensors and masses as exact, and with one that calibrates."""
    return found(case, (*settings, *EXACT), shared), found(case, (*settings, *STATED), shared)


def alone(case: str, names: Sequence[str], further: Sequence[str]) -> None:
    """Print the table of single imperfections."""
    shared = SharedValues()
    for name in names:
        settings = [*(f"table.imperfections.{one}" for one in ALONE[name]), *further]
        print(row(name, *both(case, settings, shared)), flush=True)


def laboratories(case: str, count: int, further: Sequence[str]) -> None:
    """Print the table of laboratories, with quantiles over those that ran to the end."""
    shared, every = SharedValues(), []
    for number in range(count):
        every.append(both(case, ("table=aps400_laboratory", f"seed={number}", *further), shared))
        print(row(f"laboratory {number}", *every[-1]), flush=True)
    for name, level in (("median", 0.5), ("90 %", 0.9), ("largest", 1.0)):
        print(row(name, *(_quantile(column, level) for column in zip(*every, strict=True))), flush=True)


def _quantile(column: Sequence[Found], level: float) -> Found:
    values = np.array([[getattr(one, field.name) for field in fields(one)[:-1]] for one in column])
    safe = sum(one.verdict == "safe" for one in column)
    return Found(*np.nanquantile(values, level, axis=0).tolist(), verdict=f"{safe} of {len(column)} safe")


def main() -> int:
    """Run the cases and print their tables; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--case", nargs="+", default=CASES)
    parser.add_argument("--laboratories", type=int)
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE")
    asked = parsed(parser, SHORT)
    whole = not asked.names and asked.laboratories is None
    for case in asked.case:
        print(f"\n{case}\n\n| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}", flush=True)
        if asked.names or whole:
            alone(case, asked.names or list(ALONE), asked.set)
        if asked.laboratories or whole:
            laboratories(case, asked.laboratories or LABORATORIES, asked.set)
    return 0


if __name__ == "__main__":
    sys.exit(main())
