"""Make the test benches of rigs and loop importable here."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / room) for room in ("rigs", "loop")]
