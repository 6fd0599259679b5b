"""Faults in a target with a table and a specimen of its own, in counted time (benchmarks/udp_fault_reasons.py)."""

from __future__ import annotations

import shutil

import pytest
from campaigns.own_laboratory import KINDS, Laboratory, instant

from rths_cli.loop.guard import END

pytestmark = [
    pytest.mark.campaign,
    pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here"),
    pytest.mark.real_time,
]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    """Return the laboratory, identified from its own records."""
    return Laboratory(tmp_path_factory.mktemp("own"))


def test_nothing_stops_a_healthy_run(laboratory: Laboratory) -> None:
    reason, told, _ = laboratory.counted(KINDS["nothing"], 0, True)
    assert (reason, told) == (END, "")


@pytest.mark.parametrize(
    ("kind", "number", "said"),
    [
        ("all sensors dead", 0, "all channels kept their values for"),
        ("first floor reversed", 0, "channel floor_2 does not fit the others: its sensor, or the specimen"),
        ("one sample not a number", 0, "a sample or the command is not a number (channel floor_3"),
        ("table stops", 0, "the table does not follow, or the sensor of channel table is wrong"),
        ("amplifier offset", 3, "the motion asked for is too fast for the table, or the table does not follow"),
        (
            "table sensor stuck",
            10,
            "channel table does not show the motion that the floors show: its sensor (its value does not change)",
        ),
    ],
)
def test_the_part_that_fails_is_among_those_named_first(
    laboratory: Laboratory, kind: str, number: int, said: str
) -> None:
    _, told, _ = laboratory.counted(KINDS[kind], instant(kind, number), number % 2 == 0)
    assert told.startswith(said), told
