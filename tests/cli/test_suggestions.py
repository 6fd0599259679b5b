"""What is suggested after a typing error: another option, but none that lowers safety."""

from __future__ import annotations

import click
import pytest

from rths_cli.cli import entry_point

CASE = "el_centro_low_ff_fb"


@pytest.mark.parametrize("typed", ["--overwrite", "--overide", "--yess", "--y", "--ye", "--overrides"])
def test_a_typing_error_is_not_answered_with_an_option_that_lowers_safety(
    typed: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["rths", "run", CASE, typed])
    assert entry_point.run_to_exit_code() == 2
    told = capsys.readouterr().err
    assert told.startswith(f"No such option '{typed}'; rths run --help lists what it takes")  # nothing farther either


def test_the_nearest_option_is_suggested_where_it_lowers_no_safety() -> None:
    fault = click.NoSuchOption("--outpute", possibilities=["--output", "--override"])
    assert entry_point.usage_sentence(fault).startswith("No such option '--outpute'. Did you mean '--output'?")
