"""The proof that the watchdog of a target without a key acts, and what is refused without it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from plain_peer import AT_REST, BEGIN, RESTING, RUNNING, OwnTarget
from portfolio import parametrize_first

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.experiment.real_rig_readiness import ask_to_move, check_watchdog
from rths_cli.experiment.setup import make_setup
from rths_cli.files import watchdog_proofs
from rths_cli.files.watchdog_proofs import kept_proof
from rths_cli.laboratory import watchdog_proof
from rths_cli.laboratory.doctor_request import DoctorRequest, watchdog_request
from rths_cli.laboratory.watchdog_proof import WatchdogTrial
from rths_cli.report.doctor_page import watchdog_document, watchdog_page

pytestmark = pytest.mark.real_time
CASE, RATE = "el_centro_low_ff_fb", "sample_rate_hz=500"
WATCHDOG_S = 0.4
Trial = Callable[..., WatchdogTrial]


class Watchless(OwnTarget):
    """A target whose watchdog never acts."""

    def watch(self) -> None:
        if self.state == RESTING:
            super().watch()


class Holding(OwnTarget):
    """A target that says it rests, and holds its output."""

    def watch(self) -> None:
        if self.state == RUNNING and time.monotonic() - self.fed_s > self.watchdog_s:
            self.state, self.faults = AT_REST, 1


class FedByQuestions(OwnTarget):
    """A target whose watchdog starts again with every frame."""

    def count(self, session: int, number: int, order: int, command_v: float) -> None:
        super().count(session, number, order, command_v)
        self.fed_s = time.monotonic()


class Obedient(OwnTarget):
    """A target that obeys again once it is at rest."""

    def count(self, session: int, number: int, order: int, command_v: float) -> None:
        if self.state == AT_REST and order != BEGIN and session == self.session > 0:
            self.state = RUNNING
        super().count(session, number, order, command_v)


class Mute(OwnTarget):
    """A target that does not state why it went to rest."""

    def rest(self, fault: int) -> None:
        super().rest(0)


@pytest.fixture
def trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Trial]:
    """Return what tries the watchdog of a kind of target."""
    monkeypatch.setattr(watchdog_proofs, "proofs_path", lambda: tmp_path / "proofs.json")
    monkeypatch.setattr(watchdog_proof, "RESTS_S", 0.8)  # the own target needs 0.3 s
    monkeypatch.setattr(watchdog_proof, "SETTLES_S", 0.3)
    monkeypatch.setattr(watchdog_proof, "MOVING_S", 0.3)
    monkeypatch.chdir(tmp_path)
    targets: list[OwnTarget] = []

    def tried(
        kind: type[OwnTarget] = OwnTarget, clock: str = "runner", acts_s: float = WATCHDOG_S - 0.03
    ) -> WatchdogTrial:
        clock_s = 2e-3 if clock == "target" else None
        target = kind(lambda volts: [0.0] * 3, 3, clock_s, watchdog_s=acts_s, range_v=10.0)
        targets.append(target)
        write_rig(clock=clock, link={"own_port": target.start(), "port": target.port})
        return watchdog_request(DoctorRequest(None, "own.yaml", (), 1.0, (RATE,)), lambda told: None)

    yield tried
    for target in targets:
        target.kill()


def write_rig(**changes: Any) -> None:
    """Write the rig file of an own target on this machine."""
    link = {"interface": "127.0.0.1", "own_port": 47811, "host": "127.0.0.1", "port": 47810, **changes.pop("link", {})}
    limits = {"lost_samples": 100, **changes.pop("limits", {})}
    keys = {"extends": "plain_loopback", "watchdog_s": WATCHDOG_S, "link": link, "limits": limits, **changes}
    Path("own.yaml").write_text(yaml.safe_dump(keys))


def setup_of(*settings: str) -> Any:
    from rths_cli.case.load import load_cases

    return make_setup(load_cases([CASE], ("table=own.yaml", RATE, *settings))[0])


@pytest.mark.campaign
@pytest.mark.parametrize("clock", ["runner", "target"])
def test_a_watchdog_that_acts_is_proven_for_this_rig_file(trial: Trial, clock: str) -> None:
    found = trial(clock=clock)
    assert found.faults == () and found.exit_code == 0, found.faults
    assert found.moved_v == pytest.approx(0.05 * 0.079 / 0.0079)
    assert found.left_s is not None and 0.3 < found.left_s < 0.55
    assert found.rested_s is not None and 0.6 < found.rested_s < 1.0
    page, document = watchdog_page(found), watchdog_document(found)
    assert page.startswith("PROVEN: the watchdog of own leads its table to rest") and document["exit_code"] == 0
    json.dumps(document, allow_nan=False)
    check_watchdog(setup_of().case)
    check_watchdog(setup_of("limits.force_n=300").case)  # stricter limits of a case are no other rig
    proof = kept_proof("own")
    assert proof is not None and proof.proven_utc in page
    text = Path("own.yaml").read_text()
    Path("own.yaml").write_text(text.replace("0.4", "0.45"))
    with pytest.raises(InputError, match=rf"was proven on {proof.proven_utc[:10]}.* for another content of the rig"):
        check_watchdog(setup_of().case)


@pytest.mark.campaign
@parametrize_first(
    4,
    ("kind", "clock", "acts_s", "said"),
    [
        (Watchless, "runner", 0.3, "the target still obeyed .* s after the last command: its watchdog does not act"),
        (Holding, "runner", 0.3, r"its output was 0\.5 V at the end, and"),
        (FedByQuestions, "runner", 0.3, "the target still obeyed"),
        (Obedient, "runner", 0.3, "it obeyed a command of the session that its watchdog had ended"),
        (Mute, "target", 0.3, "it does not state fault 1"),
        (OwnTarget, "target", 0.6, r"it acted 0\.6\d* s after the last command, watchdog_s is 0\.4"),
        (OwnTarget, "target", 0.1, r"it acted 0\.1\d* s .*, limits\.lost_samples bears 0\.202 s"),
    ],
)
def test_a_watchdog_that_does_not_act_as_the_page_says_is_not_proven(
    trial: Trial, kind: type[OwnTarget], clock: str, acts_s: float, said: str
) -> None:
    found = trial(kind, clock, acts_s)
    assert found.exit_code == 1 and found.proof is None
    with pytest.raises(AssertionError, match=said):
        assert not found.faults, found.faults[0]
    assert watchdog_page(found).startswith("NOT PROVEN: the watchdog of own: ")
    with pytest.raises(InputError, match="nothing shows that its target leads the table to rest by itself; run rths"):
        check_watchdog(setup_of().case)


def test_no_run_moves_a_table_without_the_proof(trial: Trial) -> None:
    write_rig()
    for yes in (True, False):
        with pytest.raises(InputError, match="nothing shows that its target leads the table to rest by itself"):
            ask_to_move([setup_of()], yes, lambda lines: pytest.fail("nobody is asked"))
    for words in (
        ["identify", CASE, "--set", "table=own.yaml"],
        ["doctor", "--rig", "own.yaml", "--channels", "--move"],
    ):
        shown = CliRunner().invoke(cli, [*words, "--set", RATE], standalone_mode=False)
        assert "rths doctor with --rig own --watchdog" in f"{shown.output}{shown.exception}", words


def test_the_proof_is_of_a_plain_link_only(trial: Trial) -> None:
    with pytest.raises(InputError, match="rig udp_loopback is of kind udp; only a udp_plain link needs it"):
        watchdog_request(DoctorRequest(None, "udp_loopback", (), 1.0, (RATE,)), lambda told: None)
