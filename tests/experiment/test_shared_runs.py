"""What cases of a batch share changes no byte of their results, and is made once."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from watched_references import watch_references

from rths_cli.case.load import load_cases
from rths_cli.experiment import check, design, run_case, run_command
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.setup import make_setups
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.rigs.description import capabilities_of

CASE = "el_centro_low_ff_fb"


def play(path: Path, settings: tuple[str, ...], memory: Memory, shared: SharedValues | None) -> dict[str, bytes]:
    """Return every dataset of a run but the case's text and the time it took."""
    setup = make_setups(load_cases([CASE], settings), shared=shared)[0]
    assert run_case.run_case(setup, path, memory, "test", lambda _: None, shared).exit_code == 0
    found: dict[str, bytes] = {}

    def collect(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and "timing" not in name and not name.startswith("case"):
            found[name] = np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(collect)
    return found


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("of", "varied"),
    [
        (
            "sim,sim_delay",
            (
                "scaling=0.2",
                "damping=high",
                "record=hachinohe",
                "record_filter.corner_hz=0.5",
                "sample_rate_hz=1000",
                "delay_s=0.004",
                "structure.interface_experimental_mass_kg=0.5",
            ),
        ),
        ("exp_rths", ("controller.command_weight=0.1", "damping=high", "record=hachinohe")),
    ],
)
def test_a_case_has_the_same_bytes_beside_those_that_differ_in_one_key(
    of: str, varied: tuple[str, ...], tmp_path: Path, memory: Memory
) -> None:
    shared, asked, path = SharedValues(), (f"runs=[{of}]",), tmp_path / "a.h5"
    first = play(path, asked, memory, shared)
    for one in varied:
        beside = play(path, (*asked, one), memory, shared)
        assert beside == play(path, (*asked, one), memory, None), one
        assert beside != first, one
    assert first == play(path, asked, memory, shared)


STABILITIES = ["stability"] * 3  # of the specimen as identified, and at both ends of its stiffness


@pytest.mark.campaign
def test_what_two_cases_have_in_common_is_made_once(
    tmp_path: Path, memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []

    def count(module: object, name: str) -> None:
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, **k: (made.append(name), function(*a, **k))[1])

    watch_references(monkeypatch, run_case, made.append)
    watch_references(monkeypatch, check, made.append)
    count(design.preflight, "stability")
    count(design.feedback, "design")
    shared = SharedValues()
    for number, seed in enumerate(("seed=0", "seed=1")):
        play(tmp_path / f"{number}.h5", ("runs=[sim,sim_delay,exp_rths]", seed), memory, shared)
    assert sorted(made) == ["design", "simulate", "simulate", "simulate_delayed", *STABILITIES]


def jobs(samples: int, *kinds: str) -> list[tuple[Any, Path]]:
    """Return jobs of records of so many samples on rigs of these kinds."""
    motion, case = SimpleNamespace(time_s=np.empty(samples)), SimpleNamespace(n_storeys=3)
    return [
        (
            SimpleNamespace(
                motion=motion,
                case=case,
                building=SimpleNamespace(storeys=3),
                rig=SimpleNamespace(kind=kind, can=capabilities_of(kind)),
                moves_hardware=capabilities_of(kind).moves_hardware,
            ),
            Path("a.h5"),
        )
        for kind in kinds
    ]


def test_as_much_is_kept_as_fits() -> None:
    per_sample = 8 * (4 + 3 * 10)
    assert run_command.most_kept(jobs(1000, "virtual")) == run_command.KEPT
    assert run_command.most_kept(jobs(run_command.KEPT_BYTES // (3 * per_sample), "virtual")) == 3
    assert run_command.most_kept(jobs(run_command.KEPT_BYTES, "virtual")) == 1


def test_two_cases_are_worked_on_unless_one_is_real_or_very_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_command, "cores", lambda: 4)
    assert run_command.cases_at_once(jobs(1000, "virtual", "virtual", "virtual")) == 2
    assert run_command.cases_at_once(jobs(1000, "virtual")) == 1
    assert run_command.cases_at_once(jobs(1000, "virtual", "udp")) == 1
    assert run_command.cases_at_once(jobs(run_command.KEPT_BYTES, "virtual", "virtual")) == 1
    monkeypatch.setattr(run_command, "cores", lambda: 1)
    assert run_command.cases_at_once(jobs(1000, "virtual", "virtual")) == 1
