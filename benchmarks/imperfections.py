"""What does each imperfection of a laboratory cost? FF+FB on the paper's building, one imperfection at a time.

    python benchmarks/imperfections.py [NAME]...              one imperfection at a time
    python benchmarks/imperfections.py --laboratories 30      laboratories of aps400_laboratory, seeds 0 to 29

Printed, each of the worst storey: error of EXP-RTHS over that of SIM-DELAY, as the check predicts it, as measured, as
true against SIM of the building as declared, and as true against SIM of the declared computed storeys below the
specimen as it is (SIM-DELAY likewise); the verdict of the check. Case `--case`, by default `el_centro_low_ff_fb`;
method `best`; refused tests are run all the same. The numbers are those of docs/background/imperfections.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result

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
}  # fmt: skip
HEAD = f"{'':<28}{'predicted':>10}{'measured':>10}{'declared':>10}{'as it is':>10}  check"


def figures(case: str, settings: Sequence[str]) -> tuple[str, float]:
    """Return the row of a case after its name, and the error against the specimen as it is (NaN: none)."""
    chosen = (*settings, "runs=[sim, sim_delay, exp_rths]")
    try:
        setup = make_setup(load_cases([case], chosen)[0], ("check", "model"))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.h5"
            ended = run_case(setup, path, Memory(), "imperfections.py", lambda _: None, series="none")
            result = read_result(path)
    except RthsError as error:
        return str(error), np.nan
    if ended.status != "complete":
        return ended.reason, np.nan
    found, late = result.metrics, np.asarray(result.metrics["sim_delay.rms_error_m_s2"])
    shown = [
        np.max(np.asarray(found[f"exp_rths.{name}"]) / scale)
        for name, scale in (("rms_error_m_s2", late), ("rms_error_m_s2_true", late), ("true_reference_ratio", 1.0))
    ]
    predicted = np.max(np.asarray(found.get("check.rms_error_m_s2", np.nan)) / late)
    told = "".join(f"{value:>10.4f}" for value in (predicted, *shown))
    return f"{told}  {result.attributes.get('check_verdict', '')}", float(shown[-1])


def main() -> int:
    """Run the cases and print their table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--case", default="el_centro_low_ff_fb")
    parser.add_argument("--laboratories", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    print(HEAD, flush=True)
    errors = []
    if asked.laboratories:
        for number in range(asked.first, asked.first + asked.laboratories):
            row, error = figures(asked.case, ("table=aps400_laboratory", f"seed={number}"))
            errors.append(error)
            print(f"{f'laboratory {number}':<28}{row}", flush=True)
        levels = np.nanquantile(errors, (0.5, 0.9))
        print(f"as it is: median {levels[0]:.3f}, 90 % {levels[1]:.3f}, largest {np.nanmax(errors):.3f}")
        return 0
    for name in asked.names or list(ALONE):
        row, _ = figures(asked.case, [f"table.imperfections.{one}" for one in ALONE[name]])
        print(f"{name:<28}{row}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
