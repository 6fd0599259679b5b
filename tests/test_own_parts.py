"""Parts of the step that the caller of the Python interface makes, and the page that tells how."""

from __future__ import annotations

import re
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest

import rths_cli
from rths_cli import InputError
from rths_cli.control.python_parts import PythonFeedforward
from rths_cli.numerics.lti import Array, Block

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
PAGE = ROOT / "docs" / "reference" / "parts.md"


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return what makes the default case short: the first 9 s of its record."""
    lines = (ROOT / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:450]
    record = tmp_path_factory.mktemp("own_parts") / "short.csv"
    record.write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    return {"record.file": record, "runs": ["sim", "exp_rths"]}


class Inverse:
    """The designed feedforward in numpy."""

    def __init__(self, block: Block) -> None:
        self.block, self.x = block, np.zeros(len(block.A))

    def command(self, motion: Array, corrected: Array, sent: Array) -> Array:
        command = self.block.C @ self.x + self.block.D @ motion[:, 0]
        self.x = self.block.A @ self.x + self.block.B @ motion[:, 0]
        return command


def in_numpy(designed: Block) -> PythonFeedforward:
    return PythonFeedforward("inverse in numpy", lambda: Inverse(designed))


def test_a_part_of_ones_own_runs_in_place_of_the_designed_one(settings: dict[str, object]) -> None:
    """Without a linear block it is refused, as any loop that cannot be judged; the file names its place."""
    parts = {"feedforward": in_numpy}
    refused = rths_cli.run(CASE, settings=settings, parts=parts)
    assert refused.status == "refused" and "inverse in numpy cannot be judged" in refused.status_reason
    ran = rths_cli.run(CASE, settings=settings, parts=parts, overrides=["check"])
    designed = rths_cli.run(CASE, settings=settings)
    assert (ran.status, designed.status) == ("complete", "complete")
    assert (ran.attributes["own_parts"], designed.attributes["own_parts"]) == ("feedforward", "")
    wanted = designed.exp_rths.command_v
    assert np.abs(ran.exp_rths.command_v - wanted).max() < 0.02 * np.abs(wanted).max()


def test_a_place_that_the_step_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="no place 'guard'"):
        rths_cli.check(CASE, parts={"guard": in_numpy})
    assert "no design of a part" in rths_cli.check(CASE, parts={"feedforward": lambda designed: None}).reasons[0]


def test_the_snippets_of_the_page_run(tmp_path: Path, settings: dict[str, object]) -> None:
    snippets = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(snippets) >= 2
    with chdir(tmp_path):
        exec("\n".join(snippets), {"SHORT": settings, "__name__": "parts"})
