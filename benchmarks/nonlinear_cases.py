"""How accurate is a hybrid test whose computed storey has a law? Twelve cases: every law, both records.

    python benchmarks/nonlinear_cases.py [NAME | KEY=VALUE]...

Printed: ductility of the computed storey in SIM, error of EXP-RTHS over that of SIM-DELAY (5 ms) in the worst storey,
as measured and as true, and error in percent of SIM. The specimen is linear. Exit code 1 where a ratio is beyond its
demand. Controller FF+FB, method `best`, `aps400_virtual`, damping low, 30 % of the record, default seeds; KEY=VALUE are
further settings, as of `--set`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from options import arguments, parsed

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result

SHORT = ("bilinear",)
PRINTS = "^bilinear .*el_centro"  # the short form at its end

YIELDS = {"yield_displacement_m": 0.002, "hardening": 0.05}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "bilinear": ("el_centro", {"kind": "bilinear", **YIELDS}),
    "Bouc-Wen": ("el_centro", {"kind": "bouc_wen", **YIELDS}),
    "Clough": ("el_centro", {"kind": "clough", **YIELDS, "unloading_exponent": 0.4}),
    "gap": ("el_centro", {"kind": "elastic_gap", "gap_m": 0.003, "contact_n_per_m": 3500.0}),
    "cubic": ("el_centro", {"kind": "cubic", "cubic_n_per_m3": 5e7, "largest_drift_m": 0.02}),
    "viscous": ("el_centro", {"kind": "viscous_power", "coefficient": 5.0, "exponent": 0.4}),
    "bilinear-h": ("hachinohe", {"kind": "bilinear", **YIELDS}),
    "pinched": (
        "hachinohe",
        {"kind": "bouc_wen", **YIELDS, "exponent": 2.0, "delta_nu": 0.02, "delta_eta": 0.02, "zeta_s": 0.7},
    ),
    "Clough-h": ("hachinohe", {"kind": "clough", **YIELDS}),
    "maxwell": ("hachinohe", {"kind": "maxwell", "spring_n_per_m": 2200.0, "dashpot_n_s_per_m": 100.0}),
    "friction": ("el_centro", {"kind": "friction", "force_n": 4.0}),
    "pendulum": ("hachinohe", {"kind": "friction", "coefficient": 0.02, "radius_m": 0.1}),
}
DEMAND, FRICTION_DEMAND = 0.05, 0.10


def settings(law: dict[str, Any]) -> tuple[str, ...]:
    """Return the settings that give the computed storey a law."""
    stated = ", ".join(f"{key}: {value}" for key, value in law.items())
    return f"structure.numerical.law=[{{{stated}}}]", "runs=[sim, sim_delay, exp_rths]"


def main() -> int:
    """Run the cases and print their table; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("words", nargs="*", metavar="NAME|KEY=VALUE")
    words = parsed(parser, SHORT).words
    memory, failed = Memory(), 0
    further = tuple(word for word in words if "=" in word)
    names = [word for word in words if "=" not in word]
    print(f"{'case':<12}{'record':<11}{'ductility':>9}{'measured':>10}{'true':>8}{'% of SIM':>10}", flush=True)
    for name in names or list(CASES):
        record, law = CASES[name]
        setup = make_setup(load_cases([f"{record}_low_ff_fb"], (*settings(law), *further))[0])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.h5"
            ended = run_case(setup, path, memory, "nonlinear_cases.py", lambda _: None, series="none")
            found = read_result(path).metrics
        if ended.status != "complete":
            print(f"{name:<12}{record:<11}{ended.reason}", flush=True)
            failed += 1
            continue
        late = np.asarray(found["sim_delay.rms_error_m_s2"])
        ratios = [float(np.max(np.asarray(found[f"exp_rths.rms_error_m_s2{kind}"]) / late)) for kind in ("", "_true")]
        percent = float(np.max(np.asarray(found["exp_rths.nrmse_percent_true"])))
        ductility = float(np.asarray(found["sim.ductility"])[0])
        failed += not max(ratios) <= (FRICTION_DEMAND if law["kind"] == "friction" else DEMAND)
        print(f"{name:<12}{record:<11}{ductility:>9.1f}{ratios[0]:>10.4f}{ratios[1]:>8.4f}{percent:>10.2f}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
