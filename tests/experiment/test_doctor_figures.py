"""Figures, verdict and advice of `rths doctor` on delays that are known."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.machine_rates import RateMeasured, delay_summary, held_rate
from rths_cli.laboratory import doctor
from rths_cli.laboratory import doctor as machine_module
from rths_cli.laboratory.doctor import Examined, Machine, RigRates, advice, examine, preemption, this_machine
from rths_cli.laboratory.doctor_request import DoctorRequest, examine_request
from rths_cli.loop.scheduling import Granted
from rths_cli.report.doctor_page import document, page, verdict

PUNCTUAL = Machine("6.1.0", "PREEMPT_RT", False, 8, (7,), "performance", "tsc", 99, -1, -1, 1_000_000)
GRANTED = Granted(True, 80, 7, True, ())
US = 1000


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def summary(rate_hz: float, late_ns: np.ndarray, share: float = 0.5) -> RateMeasured:
    return delay_summary(rate_hz, late_ns, share)


def delays(*late_us: int, steps: int = 1000) -> np.ndarray:
    made = np.full(steps, 10 * US, dtype=np.int64)
    made[: len(late_us)] = np.array(late_us) * US
    return made


def examined(*rates_hz: float, late: int = 0, wanted: tuple[float, ...] = (), rig: RigRates | None = None) -> Examined:
    rates = tuple(summary(hz, delays(*[5000] * late)) for hz in rates_hz)
    return Examined(PUNCTUAL, GRANTED, rates, rig, wanted, advice(PUNCTUAL, GRANTED, rates))


def test_figures_are_percentiles_late_steps_and_missed_intervals() -> None:
    found = summary(1000.0, np.concatenate([np.arange(1000) * US // 10, [999_999, 1_000_000, 3_700_000]]))
    assert (found.steps, found.late, found.missed) == (1003, 2, 1 + 3)
    assert found.p50_us == pytest.approx(50.1) and found.max_us == 3700.0
    assert found.p99_us == pytest.approx(99.198, abs=0.1) and found.p99_9_us == pytest.approx(
        999.999 + 2 * 0.0, abs=1.0
    )


def test_the_highest_rate_held_is_recommended_and_a_wanted_one_decides_the_exit_code() -> None:
    held, not_held = examined(500.0, 1000.0), examined(500.0, 1000.0, late=6)
    assert (held.recommended_hz, held.exit_code) == (1000.0, 0)
    assert (not_held.recommended_hz, not_held.exit_code) == (None, 1)
    mixed = replace(held, rates=(held.rates[0], not_held.rates[1]))
    assert (mixed.recommended_hz, mixed.exit_code) == (500.0, 0)
    assert replace(mixed, wanted_hz=(500.0,)).exit_code == 0
    assert (replace(mixed, wanted_hz=(500.0, 1000.0)).not_held_hz, replace(mixed, wanted_hz=(1000.0,)).exit_code) == (
        (1000.0,),
        1,
    )


@pytest.mark.campaign
@pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
def test_a_machine_has_an_eighth_of_an_interval_to_wake_up_a_rig_half_of_one_to_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Later than an eighth no command leaves (loop.realtime.PUNCTUAL)."""
    monkeypatch.setattr(doctor, "wake_up_delays", lambda hz, seconds: delays(*[130] * 20))
    found = examine((500.0, 1000.0), (), 0.1, lambda _: None, "lab", lambda hz, seconds: delays(*[400] * 20))
    assert [rate.held for rate in found.rates] == [True, False]
    assert found.rig is not None and [rate.held for rate in found.rig.rates] == [True, True]
    assert (found.recommended_hz, found.exit_code) == (500.0, 0)
    assert held_rate(1000.0, "lab") == found.rig.rates[1]
    patient = examine((1000.0,), (), 0.1, lambda _: None, "lab", lambda hz, seconds: delays(), 0.5)
    assert patient.rates[0].held


def test_a_rig_that_answers_late_counts_too() -> None:
    slow = RigRates("lab", (summary(500.0, delays()), summary(1000.0, delays(*[900] * 20))))
    found = examined(500.0, 1000.0, wanted=(1000.0,), rig=slow)
    assert (found.recommended_hz, found.not_held_hz, found.exit_code) == (500.0, (1000.0,), 1)
    jittery = examined(500.0, 1000.0, late=6, rig=RigRates("lab", (summary(500.0, delays()),)))
    assert (jittery.recommended_hz, jittery.exit_code) == (None, 1)  # a rig cannot be better than its machine
    assert "lab" in page(found) and document(found)["rig"]["rates"][1]["held"] is False


def test_a_punctual_machine_is_told_nothing_and_every_fault_has_its_sentence() -> None:
    rates = (summary(1000.0, delays()),)
    assert advice(PUNCTUAL, GRANTED, rates) == ()
    stock = replace(PUNCTUAL, preemption="PREEMPT_DYNAMIC", virtual=True, governor="powersave", isolated_cpus=())
    told = advice(stock, replace(GRANTED, refused=("memory is not locked",)), (summary(1000.0, delays(4200)),))
    assert len(told) == 6
    for word in ("memory is not locked", "PREEMPT_RT", "virtual machine", "powersave", "isolcpus=7", "4 samples"):
        assert sum(word in sentence for sentence in told) == 1, word


def test_the_page_is_at_most_100_columns_wide_and_says_rule_and_verdict() -> None:
    text = page(examined(500.0, 1000.0, late=6, wanted=(1000.0,)))
    assert max(map(len, text.splitlines())) <= 100
    assert text.splitlines()[0] == "NOT HELD: 1000 Hz; no rate is held here"
    assert text.splitlines()[1].startswith("rule ") and "99 % of the steps" in text


def test_the_verdict_names_what_was_asked_and_the_highest_rate_that_is_held() -> None:
    assert verdict(examined(500.0, 1000.0, wanted=(500.0,))) == "HELD: 500 Hz; at most 1000 Hz is held here"
    assert verdict(examined(500.0, 1000.0)) == "HELD: at most 1000 Hz is held here"
    assert verdict(examined(1000.0, late=6)) == "NOT HELD: no rate is held here"


def test_the_preemption_model_is_read_where_the_kernel_tells_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine_module, "SYS", tmp_path)
    monkeypatch.setattr(machine_module, "PROC", tmp_path)
    monkeypatch.setattr(machine_module.platform, "version", lambda: "#1 SMP PREEMPT_DYNAMIC Debian")
    assert preemption() == "PREEMPT_DYNAMIC"
    (tmp_path / "cmdline").write_text("ro quiet preempt=full\n")
    assert preemption() == "PREEMPT_DYNAMIC, full"
    (tmp_path / "kernel/debug/sched").mkdir(parents=True)
    (tmp_path / "kernel/debug/sched/preempt").write_text("none (voluntary) full\n")
    assert preemption() == "PREEMPT_DYNAMIC, voluntary"
    (tmp_path / "kernel/realtime").write_text("1\n")
    assert preemption() == "PREEMPT_RT"


@pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
def test_a_real_examination_measures_keeps_and_prints() -> None:
    found = examine((1000.0,), (200.0,), 0.2, lambda _: None)
    assert [(rate.rate_hz, rate.steps) for rate in found.rates] == [(200.0, 40), (1000.0, 200)]
    assert all(0 <= r.p50_us <= r.p99_us <= r.p99_9_us <= r.max_us for r in found.rates)
    assert held_rate(1000.0) == found.rates[1]
    assert document(found)["machine"]["cpus"] == len(__import__("os").sched_getaffinity(0))
    assert this_machine().kernel in page(found)
    assert held_rate(400.0) in (found.rates[1], None)


@pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
def test_what_a_rig_answered_is_kept_under_its_name() -> None:
    asked: list[tuple[float, float]] = []

    def exchange(rate_hz: float, seconds: float) -> np.ndarray:
        asked.append((rate_hz, seconds))
        return delays(700)

    found = examine((), (500.0,), 0.1, lambda _: None, "lab", exchange)
    assert asked == [(500.0, 0.1)]
    assert found.rig is not None and found.rig.rates[0].max_us == 700.0
    assert held_rate(500.0, "lab") == found.rig.rates[0]


@pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")
def test_the_rate_of_a_case_is_wanted_and_a_virtual_rig_is_refused() -> None:
    request = DoctorRequest("el_centro_low_ff_fb", None, (), 0.1, ("sample_rate_hz=1500",))
    found = examine_request(request, lambda _: None)
    assert (found.wanted_hz, [rate.rate_hz for rate in found.rates]) == ((1500.0,), [1500.0])
    with pytest.raises(InputError, match="rths serve aps400_virtual"):
        examine_request(DoctorRequest(None, "aps400_virtual", (), 0.1, ()), lambda _: None)
    with pytest.raises(InputError, match="--set"):
        examine_request(DoctorRequest(None, None, (), 0.1, ("scaling=1",)), lambda _: None)


def test_a_virtual_machine_that_stalls_is_told_which_rate_held() -> None:
    guest = replace(PUNCTUAL, virtual=True)
    rates = (summary(500.0, delays()), summary(1000.0, delays(*[5000] * 200)))
    told = next(text for text in advice(guest, GRANTED, rates) if "virtual machine" in text)
    assert "200 steps were late by an interval; use a real one, or stay at 500 Hz or below, which was held" in told
    (alone,) = (text for text in advice(guest, GRANTED, rates[1:]) if "virtual machine" in text)
    assert alone.endswith("late by an interval; use a real one")
    (calm,) = (text for text in advice(guest, GRANTED, rates[:1]) if "virtual machine" in text)
    assert "no steps were late" in calm and "use a real one" not in calm  # nothing is advised against what was not seen
    of_rig = (summary(500.0, delays(*[5000] * 200)),)
    (missed,) = (text for text in advice(guest, GRANTED, rates, of_rig) if "virtual machine" in text)
    assert missed.endswith("late by an interval; use a real one")


@pytest.mark.parametrize(("limit", "words"), [(0, "rtprio 0 (does not bind this user), "), (99, "rtprio 99, ")])
def test_a_limit_of_priorities_that_does_not_bind_is_called_so(limit: int, words: str) -> None:
    found = examined(1000.0)
    text = page(
        replace(found, machine=replace(PUNCTUAL, rtprio_limit=limit), granted=replace(GRANTED, fifo_priority=80))
    )
    assert words in " ".join(text.split())
