"""The NI rig through the package nidaqmx itself, over a made-up driver: no card is needed, none is tested here."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bench import rig_info, specimen
from hybrid import best_like, open_limits

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import RigError
from rths_cli.loop import guard as g
from rths_cli.loop.realtime_loop import OVERRUNS
from rths_cli.loop.realtime_run import Performance, perform, prepare
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import RECORD
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.rigs.description import Limits, RigInfo
from rths_cli.rigs.ni.daqmx import Wiring
from rths_cli.rigs.ni.ni_rig import NiRig, way_to_rest
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

pytest.importorskip("nidaqmx", reason="pip install 'rths-cli[ni]' to test the NI rig")
from fake_daqmx import CONTINUOUS, SINGLE_POINT, FakeCard, install

WIRING = Wiring("Dev1", "ao0", ("ai0", "ai1", "ai2"), "port0/line0", "differential", 10.0, 2000.0, 1.0)
MakeRig = Callable[..., tuple[NiRig, FakeCard]]


def behind(info: RigInfo) -> VirtualRig:
    """Return the table that hangs on the card; its own samples come one interval after what the card puts out."""
    return VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 0.0), (0,))


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> MakeRig:
    """Make an NI rig on a card with these properties, in front of a virtual table."""

    def made(info: RigInfo | None = None, wiring: Wiring = WIRING, **card: Any) -> tuple[NiRig, FakeCard]:
        info = info or replace(rig_info(), kind="ni", name="bench")
        without = card.pop("without", frozenset())
        table = behind(info)
        fake = FakeCard(table.arm, table.exchange, **card)
        install(monkeypatch, fake, without)
        return NiRig(info, wiring), fake

    return made


def test_a_session_gives_the_samples_of_the_table_behind_the_card(make: MakeRig) -> None:
    """The order write, wait, read: the command of t_k acts from t_k+1 on, as on the table itself with latency 1."""
    rig, _ = make()
    commands = 2.0 * np.sin(0.03 * np.arange(400))
    rig.open()
    samples = [rig.arm().copy(), *(rig.exchange(float(v)).copy() for v in commands)]
    alone = behind(rig_info())
    expected = [alone.arm().copy(), *(alone.exchange(float(v)).copy() for v in commands)]
    assert np.array_equal(samples, expected)
    assert np.ptp(samples, axis=0).min() > 0.05
    assert rig.info.driver_verified == "fake" and rig.missed == 0
    rig.rest()
    rig.close()
    rig.close()


def test_the_output_runs_before_the_input_and_motion_is_enabled_at_last(make: MakeRig) -> None:
    rig, card = make()
    rig.open()
    assert ("line", False) in card.done and not card.line_high
    inputs = [entry[1:] for entry in card.done if entry[0] == "input"]
    assert inputs == [("Dev1/ai0", 10106), ("Dev1/ai1", 10106), ("Dev1/ai2", 10106)]  # DAQmx_Val_Diff
    rig.arm()
    assert card.done[-4:] == [("write", 0.0), ("start", "output"), ("start", "input"), ("line", True)]
    rig.exchange(0.5)
    card.done.clear()
    rig.rest()
    assert not card.line_high
    assert [entry for entry in card.done if entry[0] != "write"] == [
        ("line", False), ("stop", "input"), ("stop", "output"),
    ]  # fmt: skip
    rig.close()
    assert not card.tasks


def test_rest_leads_the_command_to_zero_within_the_limits(make: MakeRig) -> None:
    rig, card = make()
    rig.open()
    rig.arm()
    outwards = np.linspace(0.0, 8.0, 1000)
    for command in outwards:
        rig.exchange(float(command))
    card.done.clear()
    rig.rest()
    path_m = 0.0079 * np.array([*outwards[-2:], *(entry[1] for entry in card.done if entry[0] == "write"), 0.0])
    speed = np.diff(path_m) / 5e-4
    assert path_m[-2] == 0.0 and len(path_m) * 5e-4 < 2.0
    assert np.abs(speed).max() < 0.5 * 1.0
    assert np.abs(np.diff(speed)).max() / 5e-4 < 0.5 * 45.0
    card.done.clear()
    rig.rest()
    assert card.done == []  # at rest already


TIGHT = [(0.02, 50.0, 1e3), (1.0, 0.05, 1e3), (1.0, 50.0, 2.0), (1.0, 45.0, 1e3)]  # m/s, m/s^2, V/s


@pytest.mark.parametrize("start_v", [10.0, -10.0, 0.5, 1e-6, 0.0])
@pytest.mark.parametrize(("velocity_m_s", "accel_m_s2", "rate_v_s"), TIGHT)
def test_the_way_to_rest_keeps_every_limit(
    start_v: float, velocity_m_s: float, accel_m_s2: float, rate_v_s: float
) -> None:
    limits = Limits(0.079, velocity_m_s, accel_m_s2, 445.0, command_rate_v_s=rate_v_s)
    info = replace(rig_info(), limits=limits)
    path_v = np.array([start_v, start_v, *way_to_rest(start_v, 0.0, info), 0.0])
    assert path_v[-2] == pytest.approx(0.0, abs=1e-15)
    speed = np.diff(path_v * info.gain_m_per_v) / info.dt_s
    assert np.abs(speed).max() <= velocity_m_s
    assert np.abs(np.diff(speed)).max() / info.dt_s <= accel_m_s2
    assert np.abs(np.diff(path_v)).max() / info.dt_s <= rate_v_s * (1 + 1e-9)
    assert np.abs(path_v).max() == abs(start_v)


@pytest.mark.parametrize(("start_v", "speed_m_s"), [(0.0, 0.5), (5.0, 0.4), (-3.0, -0.2), (5.0, -0.8), (-9.0, 0.1)])
def test_the_way_to_rest_out_of_full_motion_brakes_first(start_v: float, speed_m_s: float) -> None:
    """Constant deceleration of 0.45 a over v^2 / (2 0.45 a), as the guard brakes."""
    info = rig_info()
    rate_v_s = speed_m_s / info.gain_m_per_v
    path_v = np.array([start_v - rate_v_s * info.dt_s, start_v, *way_to_rest(start_v, rate_v_s, info), 0.0])
    accel = np.diff(path_v * info.gain_m_per_v, 2) / info.dt_s**2
    assert path_v[-2] == pytest.approx(0.0, abs=1e-15)
    assert np.abs(accel).max() < 0.5 * 45.0
    if start_v * speed_m_s >= 0.0:  # outwards: it turns where the braking ends
        farthest_v = start_v + math.copysign(speed_m_s**2, speed_m_s) / (2 * 0.45 * 45.0) / info.gain_m_per_v
        assert (path_v.max() if speed_m_s > 0 else path_v.min()) == pytest.approx(farthest_v, abs=0.04)


def test_a_step_of_the_command_is_no_motion_to_be_braked_beyond_the_stroke() -> None:
    info = rig_info()
    for start_v, rate_v_s in ((1.0, 2000.0), (9.99, 500.0), (-9.99, -500.0)):
        way_v = way_to_rest(start_v, rate_v_s, info)
        assert np.abs(way_v).max() <= 10.0 and way_v[-1] == pytest.approx(0.0, abs=1e-15)
    assert way_to_rest(1.0, 2000.0, info).max() == pytest.approx(1.0 + 1.0 / (2 * 0.45 * 45.0) / 0.0079, abs=0.05)
    tight = replace(info, limits=replace(info.limits, stroke_m=0.0395))
    assert way_to_rest(4.9, 100.0, tight).max() == pytest.approx(5.0)


@pytest.mark.parametrize("code", [209802, -209802, -209803, -201027, 0])
def test_missed_edges_are_counted_and_the_table_goes_on(make: MakeRig, code: int) -> None:
    info = replace(rig_info(), kind="ni", limits=replace(rig_info().limits, lost_samples=1))  # in a row
    rig, _ = make(info, late=frozenset({5, 20, 21}), late_as=code)
    rig.open()
    rig.arm()
    for _ in range(40):
        rig.exchange(0.1)
    assert rig.missed == 2  # edge 21 passed unseen behind edge 20
    rig.rest()
    rig.close()


def played(make: MakeRig, late: set[int], overrun: str = "hold", lost_samples: int = 5) -> tuple[Performance, str]:
    """Return a run at rest of 400 steps over a card that misses edges, and the rig's fault."""
    limits = replace(rig_info().limits, lost_samples=lost_samples)
    info = replace(rig_info(), kind="ni", overrun=overrun, limits=limits)
    rig, card = make(info, late=frozenset(late))
    run = prepare(info, best_like(info), RECORD, np.zeros((400, 3)), open_limits(info), ramp_s=0.01)
    rig.open()
    fault = perform(rig, run)
    rig.close()
    assert card.written_v == 0.0 and not card.line_high
    return run, fault


def test_missed_edges_are_overruns_of_the_loop_and_stand_in_its_log(make: MakeRig) -> None:
    run, fault = played(make, {50, 70, 71})
    assert (fault, int(run.course.marks[OVERRUNS]), int(run.guard.flags[1])) == ("", 2, g.END)
    late = signals(run.log, sizes_of(run.step)).late_ns
    assert np.nansum(late) == 1e6 and np.count_nonzero(late[: int(run.log.done[0])] > 0) == 2


def test_the_policy_stop_leads_the_table_to_rest_after_the_first_missed_edge(make: MakeRig) -> None:
    run, fault = played(make, {50}, overrun="stop")
    assert (fault, int(run.guard.flags[1]), int(run.guard.flags[0])) == ("", g.OVERRUN, g.STOPPED)
    assert run.guard.flags[3] < 60 and run.guard.seen[0] == 1
    assert "(1, overrun is stop; end other programs, lower sample_rate_hz" in reason_of(
        run.info, run.limits, run.guard, RECORD
    )


@pytest.mark.parametrize(("count", "stops"), [(2, False), (3, True)])
def test_more_missed_edges_in_a_row_than_may_be_lost_stop_a_run(make: MakeRig, count: int, stops: bool) -> None:
    run, _ = played(make, set(range(50, 50 + 2 * count, 2)), lost_samples=2)
    assert int(run.course.marks[OVERRUNS]) == count
    assert int(run.guard.flags[1]) == (g.OVERRUN if stops else g.END)
    assert np.isnan(run.guard.seen[0]) != stops and (not stops or run.guard.seen[0] == 3)


@pytest.mark.parametrize("command_v", [math.nan, math.inf, -10.001])
def test_a_command_that_is_none_is_not_sent(make: MakeRig, command_v: float) -> None:
    rig, card = make()
    rig.open()
    rig.arm()
    rig.exchange(1.0)
    with pytest.raises(RigError, match=r"is outside \+-10 V and was not sent"):
        rig.exchange(command_v)
    assert card.written_v == 1.0
    rig.rest()
    assert card.written_v == 0.0


def test_a_clock_that_stands_still_is_one_sentence_and_motion_is_disabled(make: MakeRig) -> None:
    rig, card = make(breaks_at=10)
    rig.open()
    rig.arm()
    with pytest.raises(RigError, match=r"^rig bench: NI-DAQmx says: Specified operation did not complete.*\(-200474\)"):
        for _ in range(20):
            rig.exchange(3.0)
    with pytest.raises(RigError, match=r"could not be led to rest: use the emergency stop$"):
        rig.rest()
    assert not card.line_high
    rig.close()
    assert not card.tasks


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"ai_modes": (CONTINUOUS,)}, "the analogue inputs of Dev1 have no hardware-timed single point"),
        ({"ao_modes": (CONTINUOUS,)}, "the analogue outputs of Dev1 have no hardware-timed single point"),
        ({"ao_modes": None}, "the analogue outputs of Dev1 have no hardware-timed single point"),
        ({"ai_modes": (CONTINUOUS,), "ao_modes": ()}, "the analogue inputs and outputs of Dev1 have no hardware-timed"),
        ({"device": "Dev2"}, "there is no device Dev1, the driver knows Dev2; correct ni.device or look into NI MAX"),
        ({"device": ""}, "there is no device Dev1, the driver knows none;"),
        ({"ai_rate_hz": 3000.0}, "Dev1 samples at most at 1000 Hz; lower sample_rate_hz"),
        ({"ao_rate_hz": 1500.0}, "Dev1 samples at most at 1500 Hz; lower sample_rate_hz"),
        ({"divides_hz": 3000.0}, "the card samples at 1500.000000 Hz in place of 2000 Hz; choose a"),
        ({"without": frozenset({"DAQmxWaitForNextSampleClock"})}, "this NI-DAQmx cannot wait for a sample clock"),
        ({"without": frozenset({"DAQmxCreateTask"})}, "this NI-DAQmx lacks a function that is needed"),
    ],
)  # fmt: skip
def test_a_card_that_does_not_do_is_refused_in_one_sentence(make: MakeRig, changes: Any, sentence: str) -> None:
    rig, card = make(**changes)
    with pytest.raises(RigError) as caught:
        rig.open()
    assert str(caught.value).startswith(f"rig bench: {sentence}") and "\n" not in str(caught.value)
    assert not card.tasks  # nothing stays reserved
    with pytest.raises(RigError, match="is not open"):
        rig.exchange(0.0)
    rig.rest()
    rig.close()


def test_a_terminal_that_is_not_there_is_the_driver_s_own_sentence(make: MakeRig) -> None:
    rig, _ = make(wiring=replace(WIRING, device="Dev1"))
    rig.open()
    other = NiRig(rig.info, WIRING)
    with pytest.raises(RigError, match=r"NI-DAQmx says: The specified resource is reserved\..*\(-50103\)$"):
        other.open()
    rig.close()


def test_a_start_that_fails_leaves_motion_disabled(make: MakeRig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, card = make()
    rig.open()
    started = card.of_kind("input")
    assert started is not None
    started.runs = True  # its clock runs before the output waits for it
    with pytest.raises(RigError, match=r"NI-DAQmx says: Specified route cannot be satisfied.*\(-89137\)$"):
        rig.arm()
    assert not card.line_high and ("stop", "input") in card.done
    rig.rest()
    rig.close()


def test_a_card_has_one_sample_of_latency(make: MakeRig) -> None:
    rig, _ = make(replace(rig_info(latency_samples=2), kind="ni"))
    with pytest.raises(RigError, match=r"a card's latency is 1 sample, not 2; correct latency_samples"):
        rig.open()


def test_without_the_driver_the_package_itself_says_so() -> None:
    """Run apart from the made-up library: here the package looks for NI's own, which this machine lacks or has."""
    from ctypes.util import find_library

    if find_library("nidaqmx") or sys.platform == "win32":
        pytest.skip("this machine may have the driver")
    with pytest.raises(RigError) as caught:
        NiRig(replace(rig_info(), kind="ni"), WIRING).open()
    assert str(caught.value) == (
        "rig bench: the driver NI-DAQmx is not installed on this machine; install it from ni.com "
        "(nidaqmx installdriver)"
    )


def test_without_the_package_a_sentence_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(RigError, match=r"needs the package nidaqmx .*; install it: pip install 'rths-cli\[ni\]'$"):
        NiRig(replace(rig_info(), kind="ni"), WIRING).open()


@pytest.mark.campaign
def test_the_package_is_imported_only_when_a_card_is_opened() -> None:
    code = (
        "import sys, rths_cli.rigs.ni.ni_rig, rths_cli.experiment.real_rig_readiness; print('nidaqmx' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_mode_s_number_is_the_package_s() -> None:
    from nidaqmx.constants import AcquisitionType

    assert AcquisitionType.HW_TIMED_SINGLE_POINT.value == SINGLE_POINT
