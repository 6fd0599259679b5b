"""What every rig has to keep, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info, specimen
from plain_peer import OwnTarget
from slow_table import slow_table
from udp_peer import PlainTarget

from rths_cli.case.rig_schema import VirtualRigSpec
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import RigError
from rths_cli.rigs.contract import CLAUSES, contract, latency, played
from rths_cli.rigs.interface import (
    COMPILED_LINK,
    COMPILED_PLANT,
    MISSED_EDGES,
    Rig,
    RigInfo,
    linked,
    missed_intervals,
    simulated,
)
from rths_cli.rigs.ni.ni_rig import NiRig
from rths_cli.rigs.plugin_rigs import open_plugin
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant, virtual_rig

Maker = Callable[..., Rig]


@dataclass(frozen=True)
class Kind:
    """One kind of rig: how it is made, which latencies it can have, and whether a seed names its noise."""

    make: Maker
    latencies: tuple[int, ...]
    seeded: bool = True


def virtual(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1), bits: int = 16) -> VirtualRig:
    info = rig_info(latency_samples=latency_samples, bits=bits)
    return VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), seed)


def of_kind(kind: str, latency_samples: int = 1) -> RigInfo:
    return replace(rig_info(latency_samples=latency_samples), kind=kind)


@pytest.fixture
def virtual_kind() -> Kind:
    return Kind(virtual, (0, 1, 2, 4))


@pytest.fixture
def laboratory_kind() -> Kind:
    """Return a rig whose sensors have offsets and whose deck is on a flexible drive and pitches."""
    stated = {
        "channels": {"offset_v": [0.05, -0.2, 0.1]},
        "deck": {"frequency_hz": 30.0},
        "pitch": {"frequency_hz": 40.0},
        "friction": {"presliding_m": 3e-4},
    }
    spec = VirtualRigSpec.model_validate({"kind": "virtual", "imperfections": stated})

    def make(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1)) -> Rig:
        return virtual_rig(spec, rig_info(latency_samples=latency_samples), specimen(), 0.0, seed, True)

    return Kind(make, (0, 1, 2, 4))


@pytest.fixture
def plugin_kind(monkeypatch: pytest.MonkeyPatch) -> Kind:
    slow_table(monkeypatch)
    return Kind(lambda latency_samples=1: open_plugin(of_kind("slow_table"), {}), (1,), seeded=False)


@pytest.fixture
def ni_kind(monkeypatch: pytest.MonkeyPatch) -> Kind:
    """Return the NI rig on a made-up card in front of the virtual table."""
    pytest.importorskip("nidaqmx", reason="pip install 'rths-cli[ni]' to test the NI rig")
    from fake_daqmx import FakeCard, install

    from rths_cli.rigs.ni.daqmx import Wiring

    def make(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1)) -> Rig:
        table = virtual(seed=seed)
        install(monkeypatch, FakeCard(table.arm, table.exchange))
        wiring = Wiring("Dev1", "ao0", ("ai0", "ai1", "ai2"), "", "default", 10.0, 1.0 / table.info.dt_s, 1.0)
        return NiRig(of_kind("ni"), wiring)

    return Kind(make, (1,))


@pytest.fixture
def udp_kind(tmp_path: Path) -> Iterator[Kind]:
    """Return the rig behind UDP, its target in plain Python in front of the virtual table."""
    targets: list[PlainTarget] = []
    secret, key_file = bytes(range(16)), tmp_path / "key"
    key_file.write_text(secret.hex())
    key_file.chmod(0o600)

    def make(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1)) -> Rig:
        table = virtual(latency_samples - 1, seed)  # the first sample of latency is that of the wire

        def samples(command_v: float | None) -> list[float]:
            return (table.arm() if command_v is None else table.exchange(command_v)).tolist()

        targets.append(PlainTarget(secret, samples))
        patient = UdpTarget("127.0.0.1", targets[-1].port, key_file, timeout_s=5.0)
        return UdpRig(of_kind("udp", latency_samples), patient)

    yield Kind(make, (1, 2, 4))
    for target in targets:
        target.kill()


@pytest.fixture
def plain_kind() -> Iterator[Kind]:
    """Return the rig behind plain frames, its target in plain Python in front of the virtual table."""
    targets: list[OwnTarget] = []

    def make(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1)) -> Rig:
        table = virtual(latency_samples - 1, seed)  # the first sample of latency is that of the wire

        def samples(command_v: float | None) -> list[float]:
            return (table.arm() if command_v is None else table.exchange(command_v)).tolist()

        targets.append(OwnTarget(samples, 3, range_v=11.0, watchdog_s=5.0))
        return targets[-1].rig(of_kind("udp_plain", latency_samples))

    yield Kind(make, (1, 2, 4))
    for target in targets:
        target.kill()


@pytest.fixture(params=["virtual", "laboratory", "plugin", "ni", "udp", "plain"])
def kind(request: pytest.FixtureRequest) -> Kind:
    """Return each kind of rig; a further one adds its name here and a fixture above."""
    found: Kind = request.getfixturevalue(f"{request.param}_kind")
    return found


@pytest.mark.parametrize("clause", CLAUSES)
def test_every_kind_keeps_the_contract(kind: Kind, clause: str) -> None:
    assert CLAUSES[clause](kind.make) == ""


@pytest.mark.parametrize("latency_samples", [0, 1, 2, 4])
def test_the_declared_latency_is_true(kind: Kind, latency_samples: int) -> None:
    """A command of step k acts from t_(k + latency) on, so the first sample it changes is the next one."""
    if latency_samples not in kind.latencies:
        pytest.skip("a latency that this kind of rig cannot have")
    rig = kind.make(latency_samples=latency_samples)
    assert rig.info.latency_samples == latency_samples
    assert latency(lambda: kind.make(latency_samples=latency_samples)) == ""


@pytest.mark.campaign
def test_the_seed_decides_the_bytes(kind: Kind) -> None:
    if not kind.seeded:
        pytest.skip("a kind of rig without noise")
    command = 3.0 * np.sin(0.05 * np.arange(400))
    same, again, other = (played(kind.make(seed=seed), command) for seed in ((7, 1), (7, 1), (7, 2)))
    assert same.tobytes() == again.tobytes()
    different = same != other  # noise is a tenth of a bit
    assert 0.02 < different.mean() < 0.5
    assert np.abs(same - other).max() < 1.5 * kind.make().info.converters.step_v


def test_a_rig_says_what_is_behind_its_driver(kind: Kind) -> None:
    rig = kind.make()
    rig.open()
    assert rig.info.driver_verified == {
        "slow_table": "fake",
        "ni": "fake",
        "udp": "loopback",
        "udp_plain": "loopback",
    }.get(rig.info.kind, "")
    rig.close()


def test_a_rig_at_its_end_stop_says_so_in_one_sentence() -> None:
    info = replace(rig_info(), limits=replace(rig_info().limits, stroke_m=0.01))
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 0.0), (0,))
    rig.arm()
    with pytest.raises(RigError, match=r"bench: the table ran into its end stop \(0\.01 m\)"):
        for _ in range(2000):
            rig.exchange(2.0)
    assert abs(rig.state.state[0]) == pytest.approx(0.01, abs=1e-3)


def test_a_driver_offers_compiled_loops_only_what_its_class_says() -> None:
    """A plug-in's own attributes of these names mean something else."""

    class Own(VirtualRig):
        offers = ()  # type: ignore[assignment]
        link, missed = "left", 3

    info = rig_info()
    own = Own(info, build_plant(info, VirtualPhysics(), specimen(), 0.0), (1,))
    assert (simulated(own), linked(own), missed_intervals(own)) == (None, None, None)
    assert simulated(VirtualRig(own.info, own.plant, (1,))) is not None
    assert (VirtualRig.offers, UdpRig.offers, NiRig.offers) == ((COMPILED_PLANT,), (COMPILED_LINK,), (MISSED_EDGES,))


class Broken:
    """The virtual rig with one thing wrong."""

    def __init__(self, wrong: str) -> None:
        self._rig, self._wrong, self.info = virtual(), wrong, virtual().info
        self._before = np.zeros(3)

    def open(self) -> None:
        self._rig.open()
        self._opened = True

    def arm(self) -> np.ndarray:
        if self._wrong == "remembers":
            self.__dict__.setdefault("_armed", 0)
            self._armed += 1
            return self._rig.arm() + 0.01 * self._armed
        if self._wrong == "jumps":
            return self._rig.arm() + 0.5
        return self._rig.arm()

    def exchange(self, command_v: float) -> np.ndarray:
        samples = self._rig.exchange(command_v).copy()
        if self._wrong == "late":
            samples, self._before = self._before, samples
        if self._wrong == "dead":
            samples[1] = 0.0
        if self._wrong == "nan":
            samples[2] = np.nan
        if self._wrong == "unrounded":
            samples *= 1.0001
        if self._wrong == "beyond":
            samples *= 3.0
        return samples

    def rest(self) -> None:
        if self._wrong == "rests once" and not getattr(self, "_opened", False):
            raise RigError("bench: was never opened")
        self._rig.rest()

    def close(self) -> None:
        self._rig.close()

    @property
    def told(self) -> str:
        return self._wrong


@pytest.mark.parametrize(
    ("wrong", "clause", "said"),
    [
        ("late", "latency", "shows a latency of 2, not 1"),
        ("dead", "session", "channel channel_1 shows 0 V of a motion that should show"),
        ("nan", "session", "no finite numbers"),
        ("remembers", "arming", "gave other samples than before"),
        ("jumps", "arming", "V off the table at rest"),
        ("unrounded", "codes", "no multiples of a bit"),
        ("beyond", "codes", "is beyond the converter's range"),
        ("rests once", "any_time", "was never opened"),
        ("unknown driver", "driver", "states driver_verified 'maybe'"),
    ],
)
def test_each_clause_finds_what_breaks_it(wrong: str, clause: str, said: str) -> None:
    def make() -> Rig:
        rig = Broken(wrong)
        if wrong == "unknown driver":
            rig.info = replace(rig.info, driver_verified="maybe")
        return rig

    broken = [(kept.clause, kept.fault) for kept in contract(make) if kept.fault]
    named = {holds.__name__: name for name, holds in CLAUSES.items()}
    assert named[clause] in dict(broken) and said in dict(broken)[named[clause]], broken
