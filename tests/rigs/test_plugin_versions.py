"""Rig packages of another version of the interface: what they lack or have too much is a sentence with its name; those
of rths 0.1, as they were written then, work with a warning or are refused with the reason."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from bench import rig_info
from slow_table import slow_table

from rths_cli.case import plugin_interface
from rths_cli.errors import InputError, RigError
from rths_cli.rigs.contract import contract
from rths_cli.rigs.interface import COUNTED_CLOCK, TRUTH, RigInfo, counts_time, truthful
from rths_cli.rigs.plugin_rigs import open_plugin

OLD = Path(__file__).parent / "written_for_0_1"
INFO = replace(rig_info(high_pass_hz=0.0, low_pass_hz=0.0), kind="shaker", name="lab")
Plug = Callable[..., ModuleType]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Install a package `shaker_package` with the text or the names that a test gives."""

    def install(text: str = "", **names: Any) -> ModuleType:
        module = ModuleType("shaker_package")
        monkeypatch.setitem(sys.modules, "shaker_package", module)
        vars(module).update(names)
        if text:
            path = OLD / text
            source = path.read_text(encoding="utf-8")

            class Loader:
                """Run the old text when it is imported."""

                def find_spec(self, name: str, *_: object) -> Any:
                    from importlib.machinery import ModuleSpec

                    return ModuleSpec(name, self) if name == "shaker_package" else None  # type: ignore[arg-type]

                def create_module(self, _: object) -> None:
                    return None

                def exec_module(self, made: ModuleType) -> None:
                    exec(compile(source, str(path), "exec"), vars(made))

            monkeypatch.delitem(sys.modules, "shaker_package")
            monkeypatch.setattr(sys, "meta_path", [Loader(), *sys.meta_path])
        points = [EntryPoint("shaker", "shaker_package:make", plugin_interface.GROUP)]
        monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points)
        monkeypatch.setattr(plugin_interface, "TOLD", set())
        monkeypatch.setattr(plugin_interface, "OLD_NAMES", plugin_interface.OLD_NAMES)
        plugin_interface.OLD_NAMES.clear()
        return module

    return install


class Shaker:
    """A rig that keeps to the interface."""

    def __init__(self, info: RigInfo) -> None:
        self.info = replace(info, driver_verified="fake")

    def open(self) -> None: ...
    def rest(self) -> None: ...
    def close(self) -> None: ...
    def arm(self) -> list[float]:
        return [0.0, 0.0, 0.0]

    def exchange(self, command_v: float) -> list[float]:
        return [command_v, 2.0, 3.0]


def test_the_package_of_rths_0_1_works_with_a_warning(plug: Plug, caplog: pytest.LogCaptureFixture) -> None:
    """Its text is that of its commit; its samples are those of the present example."""
    plug("slow_table_at_c8935ba.txt")
    rig = open_plugin(INFO, {"lag_s": 0.05})
    rig.open()
    rig.arm()
    samples = np.array([rig.exchange(float(volts)).copy() for volts in np.sin(0.05 * np.arange(200))])
    rig.rest()
    rig.close()
    rig.close()
    assert np.ptp(samples, axis=0).min() > 0.05
    assert [record.message for record in caplog.records] == [
        "warning: rig lab: plug-in shaker (shaker_package:make) was written for interface 1, which rths takes until "
        "version 0.3; state RTHS_INTERFACE = 2 in shaker_package once it uses the present names",
        "warning: rig lab: plug-in shaker (shaker_package:make) uses sensitivity_v_per_m_s2 of a channel, which is "
        "sensitivity_v_per_unit now; the old name ends with 0.3",
    ]
    assert not [kept for kept in contract(lambda: open_plugin(INFO, {})) if kept.fault]


def test_the_samples_of_the_old_package_are_those_of_the_present_one(
    plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_v = np.random.default_rng(1).uniform(-1.0, 1.0, 300)

    def samples(info: RigInfo) -> np.ndarray:
        rig = open_plugin(info, {"lag_s": 0.03})
        rig.open()
        rig.arm()
        return np.array([rig.exchange(float(volts)).copy() for volts in command_v])

    plug("slow_table_at_c8935ba.txt")
    old = samples(INFO)
    slow_table(monkeypatch)
    assert np.array_equal(old, samples(replace(INFO, kind="slow_table")))


def test_an_older_package_whose_modules_have_moved_is_refused_with_their_new_place(plug: Plug) -> None:
    plug("slow_table_at_2e74433.txt")
    with pytest.raises(InputError) as caught:
        open_plugin(INFO, {})
    assert caught.value.faults == (
        "rig lab: plug-in shaker (shaker_package:make) was written for an older rths: it imports rths_cli.lti, "
        "which is now rths_cli.numerics.lti; update its package",
    )


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (3, "was written for interface 3 of rths.rigs, this rths has 2; update rths, or take an older version"),
        ("2", "its RTHS_INTERFACE is '2', it must be a whole number, 2 now"),
        (0, "its RTHS_INTERFACE is '0', it must be a whole number, 2 now"),
        (True, "its RTHS_INTERFACE is 'True', it must be a whole number"),
    ],
)
def test_a_version_that_is_none_or_too_new_is_refused(plug: Plug, stated: Any, said: str) -> None:
    plug(make=lambda info, options: Shaker(info), RTHS_INTERFACE=stated)
    with pytest.raises(InputError) as caught:
        open_plugin(INFO, {})
    assert said in caught.value.faults[0] and caught.value.exit_code == 2


def test_a_package_of_the_present_interface_is_not_told(plug: Plug, caplog: pytest.LogCaptureFixture) -> None:
    plug(make=lambda info, options: Shaker(info), RTHS_INTERFACE=2)
    rig = open_plugin(INFO, {})
    rig.open()
    rig.close()
    assert not caplog.records


@pytest.mark.parametrize(
    ("asks", "said"),
    [
        (
            lambda info: info.channels[0].sensitivity,
            "asks for Channel.sensitivity, which interface 2 of rths.rigs",
        ),
        (lambda info: info.floors, "asks for RigInfo.floors, which interface 2 of rths.rigs does not have"),
        (lambda info: info.limits.jerk_m_s3, "asks for Limits.jerk_m_s3, which interface 2 of rths.rigs does not have"),
    ],
)
def test_a_name_that_no_interface_had_is_a_sentence_with_it(
    plug: Plug, asks: Callable[[RigInfo], Any], said: str
) -> None:
    class Asking(Shaker):
        def exchange(self, command_v: float) -> list[float]:
            return [float(asks(self.info))] * 3

    plug(make=lambda info, options: Asking(info), RTHS_INTERFACE=2)
    rig = open_plugin(INFO, {})
    with pytest.raises(RigError) as caught:
        rig.exchange(0.0)
    assert str(caught.value).startswith("rig lab: exchange of plug-in shaker ") and said in str(caught.value)
    plug(make=lambda info, options: asks(info), RTHS_INTERFACE=2)
    with pytest.raises(RigError) as caught:
        open_plugin(INFO, {})
    assert said in str(caught.value)


@pytest.mark.parametrize("old", sorted(plugin_interface.RENAMED))
def test_every_renamed_field_has_its_value(old: str) -> None:
    channel = replace(INFO.channels[0], warning=7.0, abort=9.0)
    assert getattr(channel, old) == getattr(channel, plugin_interface.RENAMED[old])
    with pytest.raises(AttributeError, match=r"a channel has no sensitivity$"):
        _ = channel.sensitivity  # type: ignore[attr-defined]


def test_what_a_rig_offers_by_itself_is_honoured(plug: Plug) -> None:
    def make(info: RigInfo, options: Any) -> Shaker:
        rig = Shaker(info)
        rig.offers = (COUNTED_CLOCK, TRUTH)  # type: ignore[attr-defined]
        rig.truth = lambda: (np.zeros(3), 0.0)  # type: ignore[attr-defined]
        return rig

    plug(make=make, RTHS_INTERFACE=2)
    rig = open_plugin(INFO, {})
    assert counts_time(rig) and truthful(rig) is not None


@pytest.mark.parametrize(
    ("offers", "said"),
    [
        ("counted clock", "states offers 'counted clock'; it must be a tuple of missed edges, counted clock, truth"),
        (3, "states offers '3'; it must be a tuple of"),
        (("compiled plant",), "offers 'compiled plant'; a package's rig may offer missed edges, counted clock"),
        ((TRUTH,), "made a Shaker without truth, which it offers"),
    ],
)
def test_offers_that_cannot_be_honoured_are_refused_by_name(plug: Plug, offers: Any, said: str) -> None:
    def make(info: RigInfo, options: Any) -> Shaker:
        rig = Shaker(info)
        rig.offers = offers  # type: ignore[attr-defined]
        return rig

    plug(make=make, RTHS_INTERFACE=2)
    with pytest.raises(RigError) as caught:
        open_plugin(INFO, {})
    assert said in str(caught.value)


def test_offers_that_change_when_a_rig_is_opened_are_refused(plug: Plug) -> None:
    class Late(Shaker):
        def open(self) -> None:
            self.offers = (COUNTED_CLOCK,)

    plug(make=lambda info, options: Late(info), RTHS_INTERFACE=2)
    rig = open_plugin(INFO, {})
    with pytest.raises(RigError, match="offers something else once it is open"):
        rig.open()
