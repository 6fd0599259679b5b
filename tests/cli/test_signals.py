"""A signal's exception that a library swallows ends the batch at the next sign of progress, without a traceback."""

import signal
import subprocess
import sys

import pytest
from portfolio import parametrize_first

from rths_cli.cli.terminal import Screen
from rths_cli.interrupts import Signals, Terminated


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_what_was_swallowed_is_raised_again(number: int, kind: type[BaseException]) -> None:
    signals = Signals()
    screen = Screen(quiet=True, poll=signals.poll)
    screen.doing("nothing has arrived")
    with pytest.raises(kind):
        signals.take(number, None)
    for sign in (lambda: screen.doing("next"), lambda: screen.started(2, 3, "next")):
        with pytest.raises(kind):
            sign()


def test_a_swallowed_signal_shows_no_traceback_but_other_faults_do() -> None:
    code = (
        "import sys; from rths_cli.cli import SIGNALS; SIGNALS.install()\n"
        "class Loud:\n    def __init__(self, fault): self.fault = fault\n"
        "    def __del__(self): raise self.fault\n"
        "Loud(KeyboardInterrupt('quiet')); Loud(ValueError('lost'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert "lost" in done.stderr and "quiet" not in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_once_ignored_a_signal_changes_no_exit_code(number: int) -> None:
    code = (
        "import os, sys; from rths_cli.interrupts import Signals\n"
        "signals = Signals(); signals.install(); signals.ignore()\n"
        f"os.kill(os.getpid(), {int(number)})\n"
        "sys.exit(3 if signals.code == 0 else 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 3


EARLY = """
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "typing":
            sys.stderr.write("typing is imported before signals are taken")
        if name in ("rths_cli.cli", "click"):
            os.kill(os.getpid(), NUMBER)
sys.meta_path.insert(0, Finder())
sys.argv = ["rths", "--version"]
from rths_cli.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("number", "code", "sentence"),
    [(signal.SIGINT, 130, "rths: interrupted\n"), (signal.SIGTERM, 143, "rths: terminated\n")],
)
def test_a_signal_among_the_first_imports_ends_the_process_in_a_sentence(number: int, code: int, sentence: str) -> None:
    """The process sends it to itself when the command line is to be imported, before any other module is."""
    code_text = f"import sys; sys.path[:0] = {sys.path!r}\n" + EARLY.replace("NUMBER", str(int(number)))
    done = subprocess.run(
        [sys.executable, "-S", "-c", code_text],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr, done.stdout) == (code, sentence, "")


SAYING = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup, with which the tests may run, ignores it
sys.argv = ["rths", "run", "/no/such/case.yaml"]
from rths_cli.cli import entry_point
shown = entry_point.click.echo
def echo(*given, **named):
    for number in NUMBERS[:1]:
        NUMBERS.remove(number)
        os.kill(os.getpid(), number)
    shown(*given, **named)
entry_point.click.echo = echo
entry_point.main()
"""


@pytest.mark.campaign
@parametrize_first(
    2,
    ("numbers", "code", "sentence"),
    [
        ([signal.SIGINT], 130, "rths: interrupted\n"),
        ([signal.SIGTERM], 143, "rths: terminated\n"),
        ([signal.SIGTERM, signal.SIGINT], 130, ""),
        ([signal.SIGHUP], 143, "rths: terminated\n"),
        ([signal.SIGTERM, signal.SIGHUP], 143, ""),
    ],
)
def test_a_signal_while_a_refusal_is_being_said_ends_the_process_without_a_traceback(
    numbers: list[int], code: int, sentence: str
) -> None:
    """The process sends the first when it says why it refuses the case, the second when it says that it was ended."""
    text = f"NUMBERS = {[int(number) for number in numbers]}\n" + SAYING
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr, done.stdout) == (code, sentence, "")
