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
    assert f"No such option '{typed}'" in told
    assert not any(f"'{option}'" in told for option in entry_point.LOWERS_SAFETY)


def test_another_near_option_is_still_suggested() -> None:
    fault = click.NoSuchOption("--overput", possibilities=["--override", "--output"])
    assert entry_point.usage_sentence(fault).startswith("No such option '--overput'. Did you mean '--output'?")
