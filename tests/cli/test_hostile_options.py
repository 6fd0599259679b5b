"""A sample of `benchmarks/hostile_options.py`: a value that nobody means is a sentence, whatever option it is for."""

from __future__ import annotations

import math
import random
from pathlib import Path

import click
import pytest
from campaigns.option_trials import Trial, trials, tried
from campaigns.valid_files import SHORT_RECORD

from rths_cli.cli import cli

QUICK = ("check", "records", "new", "schema", "list", "structure")
VALUES = ("", "nan", "\x1b[2Jred", "circle")  # of each option
KEYS = 6  # of a case, with one value each


@pytest.mark.campaign
def test_a_value_that_nobody_means_is_refused_by_a_sentence(tmp_path: Path) -> None:
    record = tmp_path / "short.csv"
    record.write_text(SHORT_RECORD)
    for one in chosen(random.Random(16)):
        _, fault, said = tried(tmp_path / "work", {record.name: record}, one, math.inf)
        assert not fault, f"{one.line}: {fault}: {said}"


def chosen(rng: random.Random) -> list[Trial]:
    """Return some values of every option of the quick commands, and some keys of a case with any value."""
    quick = [one for one in trials() if one.command in QUICK]
    keys = [one for one in quick if " " in one.option]
    found = rng.sample(keys, KEYS)
    for option in dict.fromkeys((one.command, one.option) for one in quick if one not in keys):
        found += [next(one for one in quick if (one.command, one.option) == option and value in one.line[-1])
                  for value in VALUES]  # fmt: skip
    return found


def test_every_option_with_a_value_is_tried() -> None:
    on_trial = {(one.command, one.option) for one in trials()}
    with_value = {
        (name, parameter.opts[0])
        for name, command in cli.commands.items()
        for parameter in command.params
        if not (isinstance(parameter, click.Option) and parameter.is_flag)
    }
    assert with_value <= on_trial
    assert {("check", "--set scaling"), ("check", "--set identification.duration_s")} <= on_trial
