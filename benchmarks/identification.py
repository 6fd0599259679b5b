"""Compare the default identification's models with a second record, other seed: python benchmarks/identification.py."""

from __future__ import annotations

from options import arguments, parsed

from rths_cli.case.load import load_cases
from rths_cli.experiment.excitation_plan import plan
from rths_cli.experiment.identify_on_rig import excite, identify
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.record_parts import Record
from rths_cli.identification.table_fit import fit_error

SEEDS, OTHER_SEED, OTHER_DURATION_S, SEGMENTS_S = (0, 1, 2), 77, 300, (20.0, 40.0)


def setup_with(*settings: str) -> Setup:
    """Return the default case with other identification settings."""
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


def main() -> None:
    """Print |model / FRF - 1| against plain Hann H1 of the second record, leakage of that estimate included."""
    parsed(arguments(__doc__))
    other = setup_with(f"identification.seed={OTHER_SEED}", f"identification.duration_s={OTHER_DURATION_S}")
    planned = plan(other)
    record = Record(*excite(other, planned.command_v), planned.parts)
    print("segments s  seed  model   RMS 0.7-11 Hz  largest  RMS 2-10 Hz")
    for seed in SEEDS:
        found = identify(setup_with(f"identification.seed={seed}"), lambda _: None)
        for segment in SEGMENTS_S:
            frf = estimate([record], other.rig.dt_s, (0.5, 60.0), segment)[0]
            for name, model in (("best", found.best), ("paper", found.paper)):
                error = fit_error(model, frf)
                print(
                    f"{segment:>10g}{seed:>6}  {name:<8}{error.rms:>13.2%}{error.largest:>9.2%}{error.rms_mid:>13.2%}"
                )


if __name__ == "__main__":
    main()
