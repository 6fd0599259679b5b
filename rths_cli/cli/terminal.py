"""Progress on a terminal (`Screen`): status line, live view of a run as text, stop keys, confirmation; all on
stderr."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

import click

from rths_cli.cli.command_group import SIGNALS
from rths_cli.cli.logs import LOG, PRINTED
from rths_cli.cli.progress import Estimate, learn, part_of, usual
from rths_cli.numerics.compiler_messages import announce, watch
from rths_cli.safe_text import visible

if TYPE_CHECKING:
    from rich.live import Live

    from rths_cli.experiment.run_case import Ended
    from rths_cli.loop.live_view import View

PLAIN_S = 10.0  # between two lines where output is no terminal
STAGE_S = 1.0  # shortest time between them, where a stage begins
BEAT_S = 0.5  # between two looks at the status

COLOURS = {
    "green": (
        "GOOD",
        "good",
        "safe",
        "accepted",
        "yes",
        "HELD",
        "AS DECLARED",
        "COMPLETE",
        "CALIBRATED",
        "readable",
        "FRAGILITY",
    ),
    "yellow": (
        "USABLE",
        "usable",
        "unsafe",
        "NOT ACCEPTED",
        "BUT",
        "NOT COMPLETE",
        "NOTHING MEASURED",
        "doubtful",
        "NO FRAGILITY",
    ),
    "red": (
        "POOR",
        "poor",
        "REFUSED",
        "ABORTED",
        "FAILED",
        "INTERRUPTED",
        "unstable",
        "rejected",
        "no",
        "NOT HELD",
        "NOT AS DECLARED",
    ),
}
"""Verdicts by colour."""
BAR = 30  # characters of the progress bar
COMPILING = "compiling the real-time code"
SHORT_BAR = 10  # the same in the status line
LEAST_TOLD_S, LEAST_SPENT_S = 2.0, 0.5  # no share and remaining time where all takes less, or what has passed


def page_width() -> int:
    """Return the columns of a page: those of COLUMNS, else of the terminal, 60 to 100; 100 where there is none."""
    return min(100, max(60, shutil.get_terminal_size((100, 24)).columns))


def show_page(make: Callable[[], str]) -> None:
    """Print a page that is made now, as wide as the terminal, its verdicts in colour."""
    from rths_cli.report.to_text import laid_out_in

    in_colour = coloured(sys.stdout)
    with laid_out_in(page_width(), marked=in_colour):
        text = make()
    if in_colour:
        write_coloured(sys.stdout, text)
    else:
        click.echo(text, nl=False)


def coloured(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that shows colours, and NO_COLOR (no-color.org) does not forbid them."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def write_coloured(stream: TextIO, text: str) -> None:
    """Write a text with its marked verdicts in colour; control characters of the text itself become visible."""
    from rths_cli.report.to_text import MARKS

    colours = {word: colour for colour, words in COLOURS.items() for word in words}
    first, *others = text.split(MARKS[0])
    terminal = getattr(stream, "unfiltered", stream)
    terminal.write(visible(first))
    for other in others:
        verdict, _, rest = other.partition(MARKS[1])
        colour, shown = colours.get(verdict), visible(verdict)
        terminal.write((click.style(shown, fg=colour) if colour else shown) + visible(rest))
    terminal.flush()


def _nothing() -> None:
    """Do nothing."""


def _is_in_background(terminal: int) -> bool:
    """Tell whether another job has the terminal: to change it would stop this process, and the loop with it."""
    try:
        return os.tcgetpgrp(terminal) != os.getpgrp()
    except OSError:  # a terminal that does not control this process
        return False


class Keys:
    """The operator's keyboard, read key by key while a table moves, where there is one."""

    def __init__(self) -> None:
        self._before: Any = None

    def stop_pressed(self) -> bool:
        """Tell whether s, space or escape was pressed."""
        if not self._taken():
            return False
        import select

        pressed = b""
        while select.select([sys.stdin], [], [], 0.0)[0] and (key := os.read(sys.stdin.fileno(), 32)):
            pressed += key
        return any(key in b"sS \x1b" for key in pressed)

    def _taken(self) -> bool:
        """Take the keyboard, unless it is taken; tell whether there is one."""
        if self._before is None:
            if os.name != "posix" or sys.stdin is None or not sys.stdin.isatty():
                return False
            if _is_in_background(sys.stdin.fileno()):
                return False
            import termios
            import tty

            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return True

    def release(self) -> None:
        """Give the keyboard back as it was."""
        if self._before is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)
            self._before = None


class Screen:
    """Show the progress of a batch; `quiet` shows only what went wrong.

    `answered`: results and their notes are printed afterwards; only a case without a result has its reason here.
    `poll` is called at every sign of progress: it may raise to end the batch. `command`: whose usual durations tell
    how long it still takes. On a terminal the status stands in the last line; elsewhere a line is printed where a stage
    begins and every PLAIN_S.
    """

    def __init__(
        self, quiet: bool = False, stream: TextIO | None = None, poll: Callable[[], None] = _nothing,
        answered: bool = False, command: str = "",
    ) -> None:  # fmt: skip
        self._poll, self._answered, self._command = poll, answered, command
        self._stream = stream or sys.stderr
        self._terminal = getattr(self._stream, "unfiltered", self._stream)  # takes control sequences
        self._quiet = quiet
        self._live = not quiet and self._stream.isatty()
        self._label = ""
        self._said: set[str] = set()
        self._drawn: Live | None = None
        self._shown_s = -PLAIN_S if command else time.monotonic()  # what is usually short begins without a line
        self._moved_s, self._compiles, self._share = -PLAIN_S, False, 0.0
        self._part, self._place, self._started_s = "", (1, 1), time.monotonic()
        self._keys = Keys()
        self._doing = ""
        self._estimate: Estimate | None = None
        self._lock, self._beat = threading.RLock(), threading.Event()

    def started(self, number: int, count: int, name: str) -> None:
        """Show that a case starts."""
        self._poll()
        self._label = f"[{number:>{len(str(count))}}/{count}] {name}"
        self._place, self._share = (number, count), (number - 1) / count
        if number > 1:  # the first case begins with the start of the command
            self._estimate = Estimate(usual(self._command)) if self._command else None

    @contextmanager
    def reading(self, what: str) -> Iterator[None]:
        """Show on a terminal that files are read; elsewhere their faults are the first that is said."""
        if self._live:
            with self._lock:
                self._doing = what
                self._show_status(0.0)
        try:
            yield
        except BaseException:
            self.clear()
            raise

    def doing(self, what: str) -> None:
        """Show what is being done."""
        self._poll()
        LOG.info("%s", what)
        with self._lock:
            if not what:
                return
            before, self._doing, self._part = self._part, what, part_of(what)
            if self._command and self._estimate is None:
                self._estimate = Estimate(usual(self._command))
            if self._estimate is not None:
                self._estimate.begin(self._part, time.monotonic())
            self._show_status(STAGE_S if self._command and self._part != before else PLAIN_S)
        self._keep_beating()

    def compiling(self, function: str, begins: bool) -> None:
        """Show that a function is compiled."""
        from rths_cli.numerics.compiled import nothing_compiled

        with self._lock:
            if self._estimate is not None:
                self._estimate.compiling(function, begins, nothing_compiled(), time.monotonic())
                self._compiles = begins
                self._show_status(PLAIN_S)

    def _keep_beating(self) -> None:
        """Show the status from now on without a sign of progress, too, until it is cleared."""
        if self._quiet or self._beat.is_set():
            return
        self._beat.set()

        def beat() -> None:
            while self._beat.is_set():
                time.sleep(BEAT_S)
                with self._lock, suppress(OSError, ValueError):  # nobody reads any more; the command itself will say so
                    if self._doing:
                        self._show_status(PLAIN_S)

        threading.Thread(target=beat, name="rths-progress", daemon=True).start()

    def _show_status(self, every_s: float) -> None:
        """Draw the status line; without a terminal print it, unless the last one is younger than `every_s`."""
        if self._live:
            self._status(self._told())
        elif not self._quiet and time.monotonic() - self._shown_s >= every_s:
            print(self._told(), file=self._stream, flush=True)
            self._shown_s = time.monotonic()

    def _told(self) -> str:
        """Return what is being done, how far it is and how long it still takes."""
        left, spent = self._left_and_spent_s(time.monotonic())
        doing = COMPILING if self._compiles else self._doing
        if left is None or spent + left < LEAST_TOLD_S or spent < LEAST_SPENT_S:
            return "  ".join(filter(None, (self._label, doing)))
        self._share = share = max(self._share, spent / (spent + left))
        drawn = f"[{'#' * round(SHORT_BAR * share):.<{SHORT_BAR}}] " if self._live else ""
        return f"{self._label}  {drawn}{100.0 * share:.0f} %, about {left:.0f} s left: {doing}".lstrip()

    def _left_and_spent_s(self, now: float) -> tuple[float | None, float]:
        """Return the seconds that are left, None where they are not known, and those that have passed."""
        number, count = self._place
        if number > 1:  # the cases that have ended tell how long the others take
            passed = now - self._started_s
            return passed / (number - 1) * (count - number + 1), passed
        left = self._estimate.left_s(now) if self._estimate else None
        spent = self._estimate.spent_s() if self._estimate else 0.0
        return (None if left is None else left + (count - 1) * (left + spent)), spent

    def ended(self, ended: Ended, seconds: float) -> None:
        """Show how a case ended."""
        self._clear()
        if self._estimate is not None:
            if ended.exit_code == 0 and self._place == (1, 1):
                learn(self._command, self._estimate.ended(time.monotonic()))
            self._estimate = None
        good, answered = ended.exit_code == 0, self._answered and ended.path is not None
        LOG.info("%s: %s, %.1f s %s", ended.path or ended.name, ended.status, seconds, ended.reason, extra=PRINTED)
        where = f"{ended.path}{' (replaced)' if ended.replaced else ''}" if ended.path else "no result"
        line = f"{self._label}: {ended.status}, {where}, {seconds:.1f} s"
        if not good and not answered:
            line = f"{self._label}: {ended.status}{f', {where}' if ended.path else ''}: {ended.reason}"
        if not (self._quiet and (good or answered)):
            print(line, file=self._stream, flush=True)
        for warning in () if answered else ended.warnings:
            if warning not in self._said and not self._quiet:
                print(f"  note: {warning}", file=self._stream, flush=True)
            self._said.add(warning)

    def moving(self, label: str, view: View) -> bool:
        """Show how a run stands on a real rig: a few lines on a terminal, a line every PLAIN_S elsewhere.

        Return whether the operator pressed the stop key.
        """

        if self._live:
            self._panel(live_lines(label, view))
        elif not self._quiet and time.monotonic() - self._moved_s >= PLAIN_S:
            print(f"{self._label}: {one_line(label, view)}", file=self._stream, flush=True)
            self._moved_s = time.monotonic()
        return self._keys.stop_pressed()

    def _panel(self, lines: list[str]) -> None:
        """Draw lines in the place of those drawn before."""
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        if self._drawn is None:
            self._clear()
            self._drawn = Live(console=Console(file=self._terminal), transient=True, auto_refresh=False)
            self._drawn.start()
        self._drawn.update(Text(visible("\n".join(lines))), refresh=True)

    def confirm(self, lines: Sequence[str]) -> bool:
        """Show a checklist and ask whether a real table may move."""
        self._clear()
        print("\n".join([lines[0], *(f"  {line}" for line in lines[1:])]), file=self._stream, flush=True)
        print("Type yes to move the table: ", end="", file=self._stream, flush=True)
        return sys.stdin.readline().strip().lower() == "yes"

    def message(self, text: str) -> None:
        """Show a line, for instance a warning."""
        LOG.info("%s", text, extra=PRINTED)
        with self._lock:
            self._wipe()
            print(text, file=self._stream, flush=True)

    def warning(self, text: str) -> None:
        """Show a warning at once, and not again where a case ends."""
        LOG.warning("%s", text, extra=PRINTED)
        if text not in self._said and not self._quiet:
            self.message(f"note: {text}")
        self._said.add(text)

    def clear(self) -> None:
        """Take the status line away; what has been said stays."""
        self._clear()
        if self._estimate is not None:
            learn(self._command, self._estimate.ended(time.monotonic()))
            self._estimate = None
        self._beat.clear()
        if self._live:
            self._stream.flush()

    def _status(self, text: str) -> None:
        self._wipe()
        self._stream.write(text[: page_width() - 1])
        self._stream.flush()

    def _clear(self) -> None:
        """Take the status away: nothing is being done."""
        with self._lock:
            self._doing = ""
            self._wipe()

    def _wipe(self) -> None:
        if self._drawn is not None:
            self._drawn.stop()
            self._drawn = None
        self._keys.release()
        if self._live:
            self._terminal.write("\r\x1b[K")


def new_screen(quiet: bool, answered: bool = False, command: str = "") -> Screen:
    """Return the screen of a command that may move a table; `answered`: it prints results at its end."""
    screen = Screen(quiet, poll=SIGNALS.poll, answered=answered, command="" if quiet else command)

    if not quiet:
        announce(screen.message)
        watch(screen.compiling)
    return screen


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
