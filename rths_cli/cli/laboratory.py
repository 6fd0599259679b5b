"""`rths doctor`, `rths calibrate`, `rths serve`, `rths bridge`, `rths recover`, `rths plugin`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import FILE, Number, json_option, quiet_option, settings_option, yes_option
from rths_cli.cli.terminal import new_screen, show_page

if TYPE_CHECKING:
    from collections.abc import Callable

    from rths_cli.cli.terminal import Screen
    from rths_cli.experiment.setup import Setup
    from rths_cli.laboratory.calibrate import Question
    from rths_cli.laboratory.doctor_request import DoctorRequest
    from rths_cli.laboratory.recover import Recovered

PUSH = (
    "After your answer, push the top floor once in the positive direction, that of a positive command, and let go.",
)


@cli.command()
@click.argument("case")
@click.option("--output", required=True, type=FILE, metavar="FILE", help="File to write; one that exists is refused.")
@click.option(
    "--model", type=FILE, metavar="FILE", help="Model of this rig (rths identify), for the ratios of sensors."
)
@click.option(
    "--sensitivity",
    "sensitivities",
    multiple=True,
    metavar="NAME=V+-U",
    help="A sensor compared with a standard: table=1022mV/g+-0.2%, table=0.1042+-0.0002 (V per m/s^2, m, N or 1). "
    "Repeatable.",
)
@click.option(
    "--mass",
    "masses",
    multiple=True,
    metavar="NAME=M+-U",
    help="A floor weighed, in kg: floor_2=6.93+-0.007. Repeatable.",
)
@click.option("--by", default="", metavar="NAME", help="Who measured; kept in the file.")
@click.option("--yes", is_flag=True, help="Ask nothing: what is not given was not measured.")
@settings_option
@json_option
def calibrate(
    case: str,
    output: Path,
    model: Path | None,
    sensitivities: tuple[str, ...],
    masses: tuple[str, ...],
    by: str,
    yes: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Write the calibration file of a rig from comparisons of its sensors, weighed floors and an identified model.

    The rig file names it under `calibration`. On a terminal you are asked for what is not given. Before: rths doctor
    --channels --push --move tells zeros and signs.

    Example: rths calibrate el_centro_low_ff_fb --set table=aps400_laboratory --mass floor_2=6.91+-0.1% --output a.yaml
    """
    from rths_cli.laboratory.calibrate import CalibrateRequest, calibrate_rig
    from rths_cli.report.calibration_page import document, page

    asks = not (yes or as_json) and sys.stdin is not None and sys.stdin.isatty()
    asked = CalibrateRequest(case, output, model, sensitivities, masses, by, settings)
    made = calibrate_rig(asked, _ask if asks else None)
    if as_json:
        click.echo(json.dumps(document(made), indent=2))
    else:
        show_page(lambda: page(made))
    return 0


def _ask(question: Question) -> str:
    """Return what a person measured, as text; "" for nothing."""
    if question.refused:
        click.echo(question.refused, err=True)
    known = f"{question.declared} +- {100.0 * question.uncertainty:.2g} %"
    text = f"{question.what}, declared {known}; measured (VALUE+-U, Enter: not)"
    return str(click.prompt(text, default="", show_default=False, err=True))


@cli.command()
@click.argument("case", required=False)
@click.option(
    "--rig", metavar="FILE", help="Measure the exchange with this rig too: its table is armed, and held at zero."
)
@click.option(
    "--rate",
    "rates_hz",
    type=Number(min=10, max=20_000),
    multiple=True,
    metavar="HZ",
    help="Rate that must be held [default: the case's; without one 500, 1000, 2000 and 4000 are tried]. Repeatable.",
)
@click.option(
    "--seconds",
    type=Number(min=0.1, max=3600),
    default=3.0,
    show_default=True,
    help="Duration of each measurement.",
)
@click.option("--channels", is_flag=True, help="Instead: zeros, noise and range of every channel of the rig, at rest.")
@click.option("--move", is_flag=True, help="With --channels: compare channels that must agree in a slow, small motion.")
@click.option("--push", is_flag=True, help="With --channels: tell the signs by a push, for which you are asked.")
@click.option(
    "--watchdog",
    is_flag=True,
    help="Instead: prove that the watchdog of a udp_plain rig acts; its table is moved a little, then nothing is sent.",
)
@quiet_option
@yes_option
@settings_option
@json_option
def doctor(
    case: str | None,
    rig: str | None,
    rates_hz: tuple[float, ...],
    seconds: float,
    channels: bool,
    move: bool,
    push: bool,
    watchdog: bool,
    quiet: bool,
    yes: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Measure which sample rates this machine holds in real time, and say what would make it more punctual.

    Exit code 1: the rate of the case, or one given by --rate, is not held. The figures are kept for rths run.

    Example: rths doctor --seconds 1
    """
    from rths_cli.laboratory.doctor_request import DoctorRequest, examine_request
    from rths_cli.report.doctor_page import document, page, verdict

    screen = new_screen(quiet)
    request = DoctorRequest(case, rig, rates_hz, seconds, settings)

    def permit(setup: Setup) -> None:
        from rths_cli.experiment.real_rig_readiness import ask_to_move
        from rths_cli.experiment.unit_plausibility import OF_RIG

        # without a case the structure is a lent one
        ask_to_move([setup], yes, screen.confirm, played=("",) if case else OF_RIG, proven=move)

    if watchdog:
        return _of_watchdog(request, channels or move or push, screen, permit, (as_json, quiet))
    if channels or move or push:
        return _of_channels(request, (channels, move, push), screen, permit, (as_json, quiet))
    found = examine_request(request, screen.doing, permit)
    screen.clear()
    if as_json:
        click.echo(json.dumps(document(found), indent=2))
    elif quiet:
        click.echo(verdict(found))
    else:
        show_page(lambda: page(found))
    return found.exit_code


def _of_watchdog(
    request: DoctorRequest, more: bool, screen: Screen, permit: Callable[[Setup], None], form: tuple[bool, bool]
) -> int:
    """Show what a target's watchdog did; return the exit code."""
    from rths_cli.errors import InputError
    from rths_cli.laboratory.doctor_request import watchdog_request
    from rths_cli.report.doctor_page import watchdog_document, watchdog_page, watchdog_verdict

    if more:
        raise InputError("--watchdog is a trial of its own; leave --channels, --move and --push out")
    found = watchdog_request(request, screen.doing, permit)
    screen.clear()
    if form[0]:
        click.echo(json.dumps(watchdog_document(found), indent=2))
    elif form[1]:
        click.echo(watchdog_verdict(found))
    else:
        show_page(lambda: watchdog_page(found))
    return found.exit_code


def _of_channels(
    request: DoctorRequest,
    asked: tuple[bool, bool, bool],
    screen: Screen,
    permit: Callable[[Setup], None],
    form: tuple[bool, bool],
) -> int:
    """Show the channels of a rig; return the exit code."""
    from rths_cli.errors import InputError
    from rths_cli.laboratory.doctor_request import channels_request
    from rths_cli.report.doctor_page import channels_document, channels_page, channels_verdict

    (channels, move, push), (as_json, quiet) = asked, form
    if not channels:
        raise InputError("--move and --push belong to --channels; add it")

    def ask() -> None:
        if not screen.confirm(PUSH):
            raise InputError("nobody pushed; leave --push out")

    found = channels_request(request, move, ask if push else None, screen.doing, permit)
    screen.clear()
    if as_json:
        click.echo(json.dumps(channels_document(found), indent=2))
    elif quiet:
        click.echo(channels_verdict(found))
    else:
        show_page(lambda: channels_page(found))
    return found.exit_code


@cli.command()
@click.argument("action", type=click.Choice(["test"]), metavar="test")
@click.argument("package", metavar="PACKAGE|FILE")
@click.option("--rig", metavar="FILE", help="Rig file whose channels, limits and options are tried [default: made up].")
@quiet_option
@json_option
def plugin(action: str, package: str, rig: str | None, quiet: bool, as_json: bool) -> int:
    """Hold what an installed package brings, or a compensator in a Python file, to its contract.

    PACKAGE is its name, or the kind of a rig that it brings; FILE is a compensator of your own, whose code is run. Each
    rig is opened, armed and moved to its limits; one that states hardware behind it is refused. Exit code 1: the
    contract is broken.

    Example: rths plugin test rths-slow-table
    """
    from rths_cli.laboratory.plugin import try_package
    from rths_cli.report.plugin_page import document, page, verdict

    screen = new_screen(as_json or quiet)
    found = try_package(package, rig, screen.doing)
    screen.clear()
    code = 0 if all(one.kept for one in found) else 1
    if as_json:
        click.echo(json.dumps(document(package, found) | {"exit_code": code}, indent=2))
    elif quiet:
        click.echo(verdict(package, found))
    else:
        show_page(lambda: page(package, found))
    return code


@cli.command()
@click.argument("logs", nargs=-1, required=True, type=FILE, metavar="LOG...")
@json_option
def recover(logs: tuple[Path, ...], as_json: bool) -> int:
    """Make the results of runs whose process was killed from the raw logs (NAME.RUN.rthslog) beside them.

    Each result says `interrupted` (or how else its run failed) and holds every sample that was on the disk. Complete
    results are left alone, logs stay.

    Example: rths recover results/*.rthslog
    """
    from rths_cli.laboratory.recover import recover as recover_logs

    found = recover_logs(tuple(dict.fromkeys(logs)))
    if as_json:
        click.echo(json.dumps({"recovered": [_document(one) for one in found], "exit_code": 0}, indent=2))
        return 0
    for one in found:
        known = "held it already and is left as it is; " if one.known else ""
        click.echo(f"{one.result}: {known}{one.status}, {one.note}")
    return 0


def _document(one: Recovered) -> dict[str, object]:
    return {
        "log": str(one.log),
        "result": str(one.result),
        "status": one.status,
        "note": one.note,
        "run": one.run,
        "samples": one.samples,
        "steps": one.steps,
        "dt_s": one.dt_s,
        "already_there": one.known,
    }


@cli.command()
@click.argument("rig", default="aps400_virtual")
@click.option("--structure", default="three_storey", show_default=True, help="Whose experimental storeys stand on it.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="Port to listen at; 0: a free one [default: 47800, on a plain link 47810].",
)
@click.option(
    "--link",
    type=click.Choice(["keyed", "plain"]),
    default="keyed",
    show_default=True,
    help="Packets with a key (rigs of kind udp), or frames without one for a private cable (udp_plain).",
)
@click.option(
    "--clock",
    type=click.Choice(["runner", "target"]),
    help="On a plain link: who has the sample clock, as in the rig file [default: target].",
)
@click.option(
    "--peer", metavar="ADDRESS:PORT", help="On a plain link: the runner's end of the cable [default: 127.0.0.1:47811]."
)
@click.option(
    "--key-file",
    type=FILE,
    metavar="FILE",
    help="Secret shared with the runner, 32 hexadecimal digits [default: one made in your cache].",
)
@click.option(
    "--watchdog",
    "watchdog_s",
    type=Number(min=0.001, max=10),
    default=0.15,
    show_default=True,
    metavar="S",
    help="Rest the table after so long without a command.",
)
@click.option("--seconds", type=Number(min=0, min_open=True), metavar="S", help="End after so long.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the sensors' noise.")
@click.option(
    "--as",
    "served_as",
    type=click.Choice(["table", "target"]),
    default="table",
    show_default=True,
    help="What is served: a table that takes commands, or a computer that steps --case itself (rigs of kind target).",
)
@click.option("--case", metavar="CASE", help="With --as target: the case whose step it runs.")
@settings_option
@json_option
def serve(
    rig: str,
    structure: str,
    host: str,
    port: int | None,
    link: str,
    clock: str | None,
    peer: str | None,
    key_file: Path | None,
    watchdog_s: float,
    seconds: float | None,
    seed: int,
    served_as: str,
    case: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Serve a virtual table with a specimen in real time over UDP, to rehearse without a laboratory.

    Ends, with the table at rest, after --seconds or by Ctrl-C.

    Example: rths serve aps400_virtual --structure three_storey
    """
    from dataclasses import asdict

    from rths_cli.errors import InputError
    from rths_cli.laboratory.serve import ServeRequest, serve

    if (served_as == "target") != (case is not None):
        raise InputError("--as target and --case CASE belong together; give both, or leave both out")
    if case is not None:
        if clock or key_file or link == "plain":
            raise InputError("--as target has the clock and its own link; leave --clock, --link and --key-file out")
        from rths_cli.laboratory.serve_step import StepRequest, serve_step

        ends = host, 47810 if port is None else port, peer or "127.0.0.1:47811"
        wanted = StepRequest(case, rig, structure, max(watchdog_s, 0.5), seed, settings, *ends, seconds)
        number = serve_step(wanted, new_screen(False).message if as_json else click.echo)
        if as_json:
            click.echo(json.dumps({"sessions": number}, indent=2))
        return 0
    if link == "keyed" and (clock or peer):
        raise InputError("--clock and --peer belong to --link plain; add it, or leave them out")
    plain = (peer or "127.0.0.1:47811", clock != "runner") if link == "plain" else ("", False)
    default_port = 47810 if link == "plain" else 47800
    screen = new_screen(False)
    request = ServeRequest(
        rig, structure, host, default_port if port is None else port, key_file, watchdog_s, seconds, seed, settings,
        *plain,
    )  # fmt: skip
    ended = serve(request, screen.message if as_json else click.echo)
    if as_json:
        click.echo(json.dumps({"sessions": [asdict(one) for one in ended]}, indent=2))
    return 0


@cli.command()
@click.argument("program", type=click.Choice(["opensees"]), metavar="opensees")
@click.argument("case")
@click.option("--length", type=click.Choice(["m", "cm", "mm", "in", "ft"]), required=True, help="The script's unit.")
@click.option("--force", type=click.Choice(["N", "kN", "MN", "lbf", "kip"]), required=True, help="The script's unit.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Private address to listen at.")
@click.option("--port", type=click.IntRange(0, 65535), default=8090, show_default=True, help="0: a free one.")
@click.option(
    "--rate",
    type=Number(min=1e-6, max=10),
    default=0.01,
    show_default=True,
    metavar="M/S",
    help="Largest velocity of the actuator.",
)
@click.option(
    "--hold",
    type=Number(min=0.01, max=100),
    default=0.2,
    show_default=True,
    metavar="S",
    help="Time at each displacement; displacement and force are averaged over its second half.",
)
@click.option(
    "--tolerance",
    type=Number(min=1e-9, max=1e-2),
    metavar="M",
    help="By how much the measured displacement may miss [default: by the sensor's noise and bits].",
)
@click.option(
    "--silent",
    type=Number(min=0.1, max=86_400),
    default=600.0,
    show_default=True,
    metavar="S",
    help="End when the client says nothing for so long.",
)
@click.option(
    "--output", type=FILE, metavar="FILE", help="One that exists is refused [default: NAME-bridge.csv, a free name]."
)
@settings_option
@json_option
def bridge(
    program: str,
    case: str,
    length: str,
    force: str,
    host: str,
    port: int,
    rate: float,
    hold: float,
    tolerance: float | None,
    silent: float,
    output: Path | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Move a displacement rig for an OpenSees script with an element genericClient: a pseudo-dynamic test.

    CASE names rig and specimen. One client is served; then, however it ends, the actuator returns to zero.

    Example: rths bridge opensees el_centro_actuator --length mm --force N
    """
    from dataclasses import asdict

    from rths_cli.laboratory.bridge import BridgeRequest, bridge_opensees

    screen = new_screen(as_json)
    request = BridgeRequest(case, settings, length, force, host, port, rate, hold, tolerance, silent, output)
    made = bridge_opensees(request, screen.message if as_json else click.echo, screen.doing)
    screen.clear()
    if as_json:
        click.echo(json.dumps(asdict(made) | {"file": str(made.file), "notes": made.notes, "exit_code": 0}, indent=2))
        return 0
    click.echo(f"complete: {made.steps} steps, {made.moves} moves in {made.rig_time_s:.0f} s of the rig, {made.file}")
    click.echo(
        f"largest displacement {1e3 * made.largest_displacement_m:.4g} mm, missed by at most "
        f"{1e6 * made.largest_miss_m:.3g} um of {1e6 * made.tolerance_m:.3g} um; largest force "
        f"{made.largest_force_n:.4g} N, standard error of a force at most {made.force_error_n:.2g} N"
    )
    for note in made.notes:
        click.echo(f"note: {note}")
    return 0
