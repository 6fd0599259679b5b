"""`rths check`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import click

from rths_cli.cli.command_group import cli
from rths_cli.cli.options import json_option, methods_option, overrides_option, quiet_option, settings_option
from rths_cli.cli.terminal import new_screen, show_page


@cli.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@methods_option("compare")
@overrides_option(["model"], "Use a model although its identification rejected it.")
@click.option("--resolved", is_flag=True, help="Print the cases with all defaults as YAML, and do nothing else.")
@click.option("--full", is_flag=True, help="Print margins, modes, latency, limits, errors by cause and guard, too.")
@quiet_option
@settings_option
@json_option
def check(
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    overrides: tuple[str, ...],
    resolved: bool,
    full: bool,
    quiet: bool,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Predict stability, table limits and error of a hybrid test: safe, unsafe or unstable. Nothing moves.

    CASE is a name, a file, a folder or a pattern. Exit code 0: all are safe; 1: one is not.

    Example: rths check el_centro_low_ff_fb
    """
    from rths_cli.case.load import load_all
    from rths_cli.case.named_files import case_files

    screen = new_screen(quiet, command="" if as_json else "check")
    with screen.reading("reading the cases"):
        loaded = load_all(case_files(cases), settings, tuple(dict.fromkeys(methods)))
    if resolved:
        screen.clear()
        _show_resolved(loaded, as_json)
        return 0
    screen.doing("starting")
    from rths_cli.experiment.check_command import check_cases
    from rths_cli.report.check_page import as_document, one_line, pages

    with screen.reading("starting"):
        checked = check_cases(loaded, tuple(dict.fromkeys(overrides)), screen.doing)
    screen.clear()
    if as_json:
        click.echo(json.dumps(as_document(checked), indent=2))
    elif quiet:
        click.echo("\n".join(map(one_line, checked)))
    else:
        show_page(lambda: pages(checked, full))
    return max(one.exit_code for one in checked)


def _show_resolved(cases: Sequence[Any], as_json: bool) -> None:
    """Print cases with everything filled in: YAML documents, or these as texts in one JSON document."""
    from rths_cli.case.load import resolved_yaml

    texts = [resolved_yaml(case) for case in cases]
    if as_json:
        named = [{"case": case.name, "resolved": text} for case, text in zip(cases, texts, strict=True)]
        click.echo(json.dumps({"cases": named}, indent=2))
    else:
        click.echo("---\n".join(texts), nl=False)
