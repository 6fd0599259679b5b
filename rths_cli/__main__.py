"""The process `rths`, which is also `python -m rths_cli`: signals are taken before anything heavy is imported."""

import os
import signal
from types import FrameType

CODES = {"SIGINT": (130, b"rths: interrupted\n"), "SIGTERM": (143, b"rths: terminated\n")}


def main() -> None:
    """Run the command line and leave with its exit code."""
    for name in CODES:
        signal.signal(getattr(signal, name), _leave)
    from rths_cli.cli import main as run

    run()


def _leave(number: int, frame: FrameType | None) -> None:
    """End the process while it still imports: nothing is open, and a module half imported may swallow an exception."""
    code, sentence = CODES[signal.Signals(number).name]
    os.write(2, sentence)
    os._exit(code)


if __name__ == "__main__":
    main()
