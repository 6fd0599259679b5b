"""Does the error budget name the cause that was switched on?

    python benchmarks/budget_causes.py [NAME]...

Each row: the cause, the error of EXP-RTHS over that of SIM-DELAY in the worst storey, whether the budget names it first
or in the group of those that cannot be told apart, and what it names. Case `el_centro_low_ff_fb`, seed 0; causes as in
`tests/helpers/campaigns/budget_causes.py`. Exit code 1 where a cause is not named. The numbers are those of
docs/background/error_budget.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.budget_causes import CAUSES, named_causes
from options import arguments, parsed

from rths_cli.experiment.model_choice import Memory

SHORT = ("13 bits",)
PRINTS = "of 1 not named"  # the short form at its end


def main() -> int:
    """Play the runs and print their table; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("names", nargs="*", help="of causes; default: all")
    names = parsed(parser, SHORT).names
    memory, wrong = Memory(), 0
    print(f"{'switched on':<30}{'error':>7}  named  by the budget", flush=True)
    for name in names or list(CAUSES):
        found = named_causes(CAUSES[name], memory)
        right = bool(found.causes) and CAUSES[name].name in found.causes[0].told
        wrong += not right
        told = found.causes[0].told if found.causes else "nothing"
        print(f"{name:<30}{found.error:>7.3f}  {'yes' if right else 'NO':<5}  {told}", flush=True)
    print(f"{wrong} of {len(names or CAUSES)} not named")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
