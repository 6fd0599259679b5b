"""Run the command line, and turn every way of ending into sentences and an exit code."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from rths_cli.cli.group import SIGNALS, cli
from rths_cli.errors import InputError, RthsError, write_crash_file
from rths_cli.process import INTERRUPTED, TERMINATED, Terminated

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")  # read when numpy is imported


def main() -> NoReturn:
    """Run the command line and leave with the exit code of DESIGN.md section 2."""
    _open_streams()
    SIGNALS.install()
    _one_blas_thread()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # pydantic would look for some in every package
    code = _guarded()
    SIGNALS.ignore()
    sys.exit(code)


def _open_streams() -> None:
    """Give output a place to go where the caller closed it."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115


def _one_blas_thread() -> None:
    """Let linear algebra run in one thread, unless the user set their number.

    For matrices of some tens of rows the threads wait for each other longer than they work (a run took three times as
    long on two busy cores), and the last bits of a sum would depend on the number of cores.
    """
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")


def _guarded() -> int:
    """Run the command; turn every way of failing into sentences and a code."""
    try:
        code = int(cli.main(standalone_mode=False) or 0)
        sys.stdout.flush()
        return SIGNALS.code or code  # one that came when everything was done ends the caller's loop all the same
    except click.ClickException as error:
        return _say([error.format_message()], 2)
    except (click.Abort, KeyboardInterrupt, Terminated):
        return _ended_by_signal()
    except InputError as error:
        return _say(error.faults, error.exit_code)
    except RthsError as error:
        return _say([str(error)], error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except Exception as error:
        return _ended_by_signal() if SIGNALS.code else _fault_of_ours(error)


def _ended_by_signal() -> int:
    code = SIGNALS.code or INTERRUPTED
    return _say(["rths: interrupted" if code == INTERRUPTED else "rths: terminated"], code)


def _fault_of_ours(error: Exception) -> int:
    """Report an unforeseen failure: a full disk behind stdout is the user's, the rest is ours."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EIO):
        return _say([f"rths: cannot write the output: {error.strerror}"], 2)
    if "--debug" in sys.argv:
        raise error
    return _say([f"rths: internal error ({type(error).__name__}); details in {write_crash_file()}"], 5)


def _say(sentences: Sequence[str], code: int) -> int:
    """Show sentences on stderr and, where JSON was asked for, as the document on stdout; return the code."""
    click.echo("\n".join(sentences), err=True)
    if "--json" in sys.argv and code not in (INTERRUPTED, TERMINATED):
        click.echo(json.dumps({"exit_code": code, "faults": list(sentences)}, indent=2))
    return code
