"""`main` of `rths`: run a command, turn every error, signal or fault of ours into sentences and an exit code."""

from __future__ import annotations

import codecs
import errno
import gc
import json
import os
import re
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from io import TextIOWrapper
from typing import NoReturn

import click

from rths_cli.cli.command_group import SIGNALS, cli
from rths_cli.cli.logs import LOG, PRINTED, end_logs
from rths_cli.cli.options import FileOfKind
from rths_cli.errors import InputError, RthsError, crash_note, out_of_memory
from rths_cli.interrupts import INTERRUPTED, TERMINATED, Terminated, any_abandoned
from rths_cli.safe_text import OutputError, PrintedStream, shortened

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")  # read when numpy is imported

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
NEW_OBJECTS = 300_000  # between two searches for unreachable objects; the libraries of a run make 200,000 that stay
LOWERS_SAFETY = ("--override", "--yes", "--move")  # options that a person types in full, or not at all
LONGEST_SENTENCE = 1000  # characters of a fault: what is longer repeats an input


def main() -> NoReturn:
    """Run the command line and leave with its exit code (docs/decisions/commands.md)."""
    _open_streams()
    _one_blas_thread()
    gc.set_threshold(NEW_OBJECTS)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # pydantic would look for some in every package
    try:
        SIGNALS.install()
        code = run_to_exit_code()
        SIGNALS.ignore()
    except (KeyboardInterrupt, Terminated):  # before the command began, or while the outcome was being said
        SIGNALS.leave_at_once()
        code = _ended_by_signal()
        SIGNALS.ignore()
    if any_abandoned():  # a computation still uses libraries that a usual end unloads
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    gc.freeze()  # Python looks for unreachable objects on its way out: among all that libraries have made
    sys.exit(code)


def _open_streams() -> None:
    """Make what is printed visible, and give output a place to go where the caller closed it.

    A closed stdout takes tables without a word, but no document that --json asks for.
    """
    if sys.stdout is None:
        sys.stdout = open(os.open(os.devnull, os.O_RDONLY if _wants_json() else os.O_WRONLY), "w")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, TextIOWrapper):
            ascii_only = codecs.lookup(stream.encoding).name == "ascii"
            stream.reconfigure(encoding="utf-8" if ascii_only else None, errors="backslashreplace")
        setattr(sys, name, PrintedStream(stream, name, needed=name == "stdout"))


def _wants_json() -> bool:
    return "--json" in sys.argv


def _one_blas_thread() -> None:
    """Let linear algebra run in one thread, unless the user set their number.

    For matrices of some tens of rows the threads wait for each other longer than they work (a run took three times as
    long on two busy cores), and the last bits of a sum would depend on the number of cores.
    """
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")


def run_to_exit_code() -> int:
    """Run the command of sys.argv and return its exit code, which is logged, too."""
    try:
        code = _run_to_exit_code()
        LOG.info("exit code %d", code)
        return code
    finally:
        end_logs()


def _run_to_exit_code() -> int:
    """Return the exit code of the command; every way of failing becomes sentences and a code."""
    try:
        code = int(cli.main(standalone_mode=False) or 0)
        sys.stdout.flush()
        return SIGNALS.code or code  # one that came when everything was done ends the caller's loop all the same
    except click.ClickException as error:
        return _say([usage_sentence(error)], 2)
    except (click.Abort, KeyboardInterrupt, Terminated):
        return _ended_by_signal()
    except OutputError as error:
        return _without_stdout(error, SIGNALS.code)
    except InputError as error:
        return _say(error.faults, error.exit_code)
    except RthsError as error:
        return _say([str(error)], error.exit_code)
    except Exception as error:
        return _ended_by_signal() if SIGNALS.code else _fault_of_ours(error)


def usage_sentence(error: click.ClickException) -> str:
    """Return a fault of the command line in a sentence that says what to type."""
    said = " ".join(error.format_message().split()).rstrip(".")  # click lists choices on lines of their own
    if isinstance(error, click.MissingParameter) and error.param is not None:
        option, name = error.param, error.param.name or ""
        if isinstance(option.type, click.Choice):
            *some, last = map(str, option.type.choices)
            return f"{option.opts[0]} is missing; add {option.opts[0]} {', '.join(some)} or {last}"
        if isinstance(option.type, FileOfKind):
            return f"{name.upper().removesuffix('S')} is missing; rths list {option.type.kind} shows what can be named"
    if isinstance(error, click.NoSuchOption):  # versions of click word it differently
        said = f"No such option {error.option_name!r}"
        nearest = next(iter(error.possibilities or ()), "")
        said += f". Did you mean {nearest!r}?" if nearest and nearest not in LOWERS_SAFETY else ""
    if isinstance(error, click.NoSuchOption | click.MissingParameter) and error.ctx is not None:
        return f"{said}{'' if said.endswith('?') else ';'} rths {error.ctx.info_name} --help lists what it takes"
    if choice := re.search(r"'(.*)' is not one of (.*)", said):
        near = get_close_matches(choice[1], re.findall(r"'([^']*)'", choice[2]), 1)
        return f"{said}{f'; did you mean {near[0]}?' if near else ''}"
    if missed := re.match(r"No such command '(.*?)'", said):
        near = get_close_matches(missed[1], cli.commands, 1)
        advice = f". Did you mean {near[0]!r}?" if near else ";"
        return f"{missed[0]}{advice} rths --help lists the commands"
    if extra := re.match(r"Got unexpected extra arguments? \(([^ =]+=[^ )]*)", said):
        return f"{extra[1]} is no argument; a setting follows --set, each one its own: --set {extra[1]}"
    return said


def _ended_by_signal() -> int:
    code = SIGNALS.code or INTERRUPTED
    return _say(["rths: interrupted" if code == INTERRUPTED else "rths: terminated"], code)


def _fault_of_ours(error: Exception) -> int:
    """Report an unforeseen failure; a full disk is the user's, whichever file a library wrote (a cache, say)."""
    if "--debug" in sys.argv:
        raise error
    LOG.debug("internal error", exc_info=error)
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        where = f"{error.filename}: " if error.filename else ""
        return _say([f"rths: {where}{error.strerror}; free some space and start again"], 2)
    if told := out_of_memory(error):
        return _say([f"rths: {told}"], 2)
    return _say([f"rths: internal error ({type(error).__name__}); {crash_note()}"], 5)


def _say(sentences: Sequence[str], code: int) -> int:
    """Show sentences on stderr and, where JSON was asked for, as the document on stdout; return the code."""
    told = [shortened(sentence, LONGEST_SENTENCE) for sentence in sentences]
    LOG.error("%s", "; ".join(told), extra=PRINTED)
    click.echo("\n".join(told), err=True)
    if _wants_json() and code not in (INTERRUPTED, TERMINATED):
        try:
            click.echo(json.dumps({"exit_code": code, "faults": told}, indent=2))
        except OutputError as fault:
            return _without_stdout(fault, code)
    return code


def _without_stdout(fault: OutputError, code: int) -> int:
    """Say that stdout takes nothing more, and return the code; a reader of tables who left has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it once more on its way out
    if fault.reader_gone and not _wants_json():
        return code
    click.echo(str(fault), err=True)
    return code or fault.exit_code
