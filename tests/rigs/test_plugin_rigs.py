"""Rigs of other packages: the example works, and whatever is wrong with one is a sentence."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bench import rig_info
from scipy.linalg import expm
from slow_table import EXAMPLE, slow_table

from rths_cli.case import plugin_interface
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.rigs.interface import Rig, RigInfo
from rths_cli.rigs.plugin_rigs import open_plugin

ROOT = EXAMPLE.parents[1]
Plug = Callable[[Any], None]
INFO = replace(rig_info(high_pass_hz=0.0, low_pass_hz=0.0), kind="shaker", name="lab")


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Install a package `shaker_package` whose `make` is what a test gives."""

    def install(make: Any) -> None:
        module = ModuleType("shaker_package")
        module.make = make  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "shaker_package", module)
        points = [EntryPoint("shaker", "shaker_package:make", plugin_interface.GROUP)]
        monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points)

    return install


class Shaker:
    """A rig that does what a test wants of it."""

    def __init__(self, info: RigInfo, **methods: Any) -> None:
        self.info = info
        self.asked: list[Any] = []
        for name in ("open", "rest", "close"):
            setattr(self, name, methods.get(name, lambda name=name: self.asked.append(name)))
        self.arm = methods.get("arm", lambda: [0.0, 0.0, 0.0])
        self.exchange = methods.get("exchange", lambda command_v: [command_v, 2.0, 3.0])


def test_the_example_follows_its_command_with_its_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the exact solution for held commands, each held from the sample after the one it came from."""
    slow_table(monkeypatch)
    info = replace(INFO, kind="slow_table", converters=replace(INFO.converters, bits=0))
    rig = open_plugin(info, {"lag_s": 0.05})
    command_v = np.random.default_rng(3).uniform(-0.5, 0.5, 400)
    rig.open()
    rig.arm()
    samples = np.array([rig.exchange(float(volts)).copy() for volts in command_v])
    rig.rest()
    rig.close()
    rate, held_m = 1.0 / 0.05, info.gain_m_per_v * np.array([0.0, *command_v[:-1]])
    stiff = np.array([[0.0, 1.0, 0.0], [-(rate**2), -2.0 * rate, rate**2], [0.0, 0.0, 0.0]])  # place, velocity, held
    after, state, accel_m_s2 = expm(stiff * info.dt_s), np.zeros(3), []
    for held in held_m:
        state = after @ np.array([*state[:2], held])
        accel_m_s2.append(stiff[1] @ state)
    assert np.abs(samples[:, 0] * 9.80665 - accel_m_s2).max() < 2e-3 * np.abs(accel_m_s2).max()
    assert np.array_equal(samples[:, 0], samples[:, 2])
    assert rig.info.driver_verified == "fake"


def test_the_page_on_rig_packages_shows_the_example_s_entry_point() -> None:
    page = (ROOT / "docs" / "howto" / "rig_package.md").read_text()
    shown = re.findall(r"^```toml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert [block in (EXAMPLE / "pyproject.toml").read_text() for block in shown] == [True]


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"lag_s": 5}, "options.lag_s: must be >= 0.001 and <= 1, got 5"),
        ({"lag_s": "x"}, "options.lag_s: must be >= 0.001 and <= 1, got 'x'"),
        ({"lag": 0.1}, "options.lag: unknown key; known: lag_s"),
    ],
)
def test_options_are_the_plug_in_s_to_refuse(monkeypatch: pytest.MonkeyPatch, options: Any, fault: str) -> None:
    slow_table(monkeypatch)
    with pytest.raises(InputError) as caught:
        open_plugin(replace(INFO, kind="slow_table"), options)
    assert caught.value.faults == (f"rig lab: plug-in slow_table (rths_slow_table:make): {fault}",)


def test_a_rig_is_asked_what_the_loop_asks_and_keeps_one_array(plug: Plug) -> None:
    made: list[Shaker] = []

    def make(info: RigInfo, options: Any) -> Rig:
        assert info is INFO and options == {"gain": 2}
        made.append(Shaker(replace(info, driver_verified="fake")))
        return made[-1]

    plug(make)
    rig = open_plugin(INFO, {"gain": 2})
    rig.open()
    first = rig.arm()
    assert first.tolist() == [0.0, 0.0, 0.0]
    assert rig.exchange(1.5) is first and first.tolist() == [1.5, 2.0, 3.0]
    rig.rest()
    rig.close()
    assert made[0].asked == ["open", "rest", "close"] and rig.info.driver_verified == "fake"


def test_a_rig_that_states_nothing_is_hardware_once_it_is_open(plug: Plug) -> None:
    plug(lambda info, options: Shaker(info))
    rig = open_plugin(INFO, {})
    assert rig.info.driver_verified == ""
    rig.open()
    assert rig.info.driver_verified == "hardware"


def test_a_rig_may_find_out_when_it_is_opened_what_is_behind_it_and_nothing_else(plug: Plug) -> None:
    made: list[Shaker] = []
    plug(lambda info, options: made.append(Shaker(info)) or made[-1])
    for stated, fault in (("fake", ""), ("hard\x1bware", "states driver_verified 'hard\\x1bware'"), ("x", "known: ")):
        rig = open_plugin(INFO, {})
        made[-1].open = lambda stated=stated: setattr(made[-1], "info", replace(INFO, driver_verified=stated))
        if fault:
            with pytest.raises(RigError, match=re.escape(fault)):
                rig.open()
        else:
            rig.open()
            assert rig.info.driver_verified == stated


def raising(error: Exception) -> Callable[..., Any]:
    def fail(*_: Any) -> Any:
        raise error

    return fail


WHO = "rig lab: plug-in shaker (shaker_package:make)"


@pytest.mark.parametrize(
    ("make", "kind", "sentence"),
    [
        (5, InputError, f"{WHO} names no function that makes a rig; its package needs one in the group rths.rigs"),
        (raising(InputError("a: no", "b: no")), InputError, f"{WHO}: a: no\n{WHO}: b: no"),
        (raising(RigError("the box is off")), RigError, "the box is off"),
        (raising(KeyError("x\ny")), RigError, f"{WHO} could not make its rig: KeyError: 'x\\ny'"),
        (lambda info: None, RigError, f"{WHO} could not make its rig: TypeError: "),
        (lambda info, options: SimpleNamespace(info=info, open=print, rest=1, arm=print), RigError,
         f"{WHO} made a SimpleNamespace without exchange, rest, close; that is no rig"),
        (lambda info, options: Shaker(replace(info, latency_samples=3)), RigError,
         f"{WHO} must keep the info it was given; only driver_verified is its own to state"),
        (lambda info, options: Shaker(None), RigError, f"{WHO} must keep the info it was given"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_a_bad_factory_is_one_sentence(plug: Plug, make: Any, kind: type[Exception], sentence: str) -> None:
    plug(make)
    with pytest.raises(kind) as caught:
        open_plugin(INFO, {})
    assert type(caught.value) is kind and str(caught.value).startswith(sentence)


def test_a_package_that_cannot_be_imported_is_one_sentence(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    plug(print)
    monkeypatch.setitem(sys.modules, "shaker_package", None)
    with pytest.raises(
        InputError, match=r"cannot be loaded: ModuleNotFoundError: .*; repair or reinstall its package$"
    ):
        open_plugin(INFO, {})
    with pytest.raises(
        InputError, match=r"^kind: 0 installed packages bring rigs of kind 'hydraulic', it must be one$"
    ):
        open_plugin(replace(INFO, kind="hydraulic"), {})


@pytest.mark.parametrize("method", ["open", "arm", "exchange", "rest", "close"])
def test_an_error_in_a_method_is_a_rig_fault(plug: Plug, method: str) -> None:
    plug(lambda info, options: Shaker(info, **{method: raising(OSError(5, "cable\noff"))}))
    rig = open_plugin(INFO, {})
    with pytest.raises(RigError) as caught:
        getattr(rig, method)(*([0.0] if method == "exchange" else []))
    assert str(caught.value) == f"rig lab: {method} of plug-in shaker failed: OSError: [Errno 5] cable off"


def test_the_plug_in_s_own_sentences_and_ctrl_c_pass(plug: Plug) -> None:
    for error in (RigError("oil is cold"), LimitError("stroke"), KeyboardInterrupt("^C")):
        plug(lambda info, options, error=error: Shaker(info, exchange=raising(error)))  # type: ignore[arg-type]
        with pytest.raises(type(error), match=re.escape(str(error))):
            open_plugin(INFO, {}).exchange(0.0)


@pytest.mark.parametrize(
    ("samples", "told"),
    [([1.0, 2.0], "list of shape (2,)"), (None, "NoneType of shape ()"), ([1, "x", 2], "list of shape (0,)"),
     (np.zeros((3, 1)), "ndarray of shape (3, 1)"), ([[1], [2, 3]], "list of shape (0,)"), (1.0, "float of shape ()")],
)  # fmt: skip
def test_samples_of_another_shape_are_a_rig_fault(plug: Plug, samples: Any, told: str) -> None:
    plug(lambda info, options: Shaker(info, exchange=lambda command_v: samples))
    with pytest.raises(RigError) as caught:
        open_plugin(INFO, {}).exchange(0.0)
    assert str(caught.value) == (
        f"rig lab: exchange of plug-in shaker must return 3 samples in V, one per channel, got {told}"
    )


def test_a_sample_that_is_no_number_is_left_to_the_guard(plug: Plug) -> None:
    plug(lambda info, options: Shaker(info, exchange=lambda command_v: [np.nan, 1, None]))
    assert np.array_equal(open_plugin(INFO, {}).exchange(0.0), [np.nan, 1.0, np.nan], equal_nan=True)
