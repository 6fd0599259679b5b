"""The exported step in C against the compiled step, on the same samples: blocks of the bench with what a case may have,
lost samples, and the guard's limits."""

from __future__ import annotations

import shutil
import socket
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import rig_info
from campaigns.exported_step import (
    EQUAL,
    FAST,
    RAMP,
    SANITIZED,
    STILL,
    STRICT,
    ZEROS,
    Session,
    bench_step,
    both,
    build,
    compiled,
    compiler,
    differences,
    recorded,
    write,
)
from further_channels import best_with_cell, cell, displacement, strain, with_channels
from hybrid import best_like, ground, open_limits, paper_like, reacting, storeys
from portfolio import parametrize_first
from repeated_laws import own

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.numerical_substructure import interface as storeys_of
from rths_cli.control.python_parts import PythonFeedforward
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.errors import InputError
from rths_cli.experiment.designed_step import DesignedStep, Rehearsal, checksum_number
from rths_cli.loop.guard import GuardLimits, further_limits
from rths_cli.loop.lost_samples import NO_ANSWER
from rths_cli.loop.realtime_run import perform, prepare
from rths_cli.loop.recorded_steps import Conducted, Recorded, conduct_over
from rths_cli.loop.run_log import column_names, signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.report.c_step.golden import golden_tests
from rths_cli.report.c_step.library import library_texts, readme, write_library
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.stepped_test import Designed
from rths_cli.rigs.udp.plain_rig import Cable
from rths_cli.rigs.udp.stepping_rig import SteppingRig
from rths_cli.structure import storey_matrix
from rths_cli.structure.storey_laws import (
    Bilinear,
    BoucWen,
    Clough,
    Cubic,
    ElasticGap,
    Friction,
    Law,
    Maxwell,
    Softening,
    ViscousPower,
    arranged,
)

SAME, SAME_LAWS = 1e-12, 1e-10
STEPS = 1200
LOST = (200, 300, 301, 302, 500, 501, 505)
SIMULINK = Path(__file__).parents[1] / "helpers" / "campaigns" / "simulink"
pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


def shown(info: RigInfo, drive: Array, scale: float = 1.0) -> Array:
    """Return samples (n, c + f) in V: the ground's acceleration, later at each floor, and noise."""
    rows, random = STILL + RAMP + len(drive), np.random.default_rng(3)
    samples = 1e-3 * random.standard_normal((rows, len(info.all_channels)))
    for c, one in enumerate(info.channels):
        late = 3 + 20 * c
        samples[STILL + RAMP + late :, c] += scale * one.sensitivity_v_per_unit * drive[: len(drive) - late, 0]
    return samples


def full(info: RigInfo) -> Blocks:
    """Return feedforward of reaction and friction, feedback, rounding."""
    blocks = reacting(info)
    assert not isinstance(blocks.feedforward, FrictionFeedforward)
    counters = FrictionFeedforward(blocks.feedforward, 0.05, 2e-3, 0.7, 1e-3, 0.1)  # type: ignore[arg-type]
    return replace(
        blocks, feedforward=counters, shaping_step_v=info.converters.step_v, command_limit_v=9.0, feedback_limit_v=1e-4
    )


LAWS: dict[str, tuple[tuple[Law, ...], ...]] = {
    "with rates": (
        (Bilinear(7000.0, 0.0002, 0.05), ViscousPower(8.0, 0.4), Maxwell(4000.0, 60.0)),
        (Clough(4000.0, 0.0002, 0.05, 0.3), Cubic(7000.0 / 0.004**2, 0.01), Softening(3000.0, 0.3, 0.001)),
        (ElasticGap(21000.0, 0.0002), BoucWen(5000.0, 0.0002, 0.05, exponent=2.0), Friction(3.0, 1e-4)),
    ),
    "that degrade": (
        (BoucWen(7000.0, 2e-4, 0.05, 1.0, 0.6, 0.4, 0.002, 0.02, 0.05, 0.7, 1.0, 0.1, 0.2, 0.01, 0.3),),
        (BoucWen(3000.0, 2e-4, 0.05, 1.5, 0.5, 0.5, 0.0, 0.05, 0.0, 0.8, 1.0, 0.1, 0.2, 0.0, 0.5),
         BoucWen(2000.0, 3e-4, 0.05, 2.0, delta_eta=0.1)),
        (BoucWen(5000.0, 2e-4, 0.05, exponent=1.0), BoucWen(2000.0, 1e-4, 0.1, exponent=6.0)),
    ),
}  # fmt: skip


def with_laws(blocks: Blocks, laws: tuple[tuple[Law, ...], ...], dt_s: float) -> Blocks:
    """Return blocks with computed storeys that have laws."""
    whole = storeys(len(laws))
    stiff, damped = (storey_matrix([sum(law.at_rest[i] for law in one) for one in laws]) for i in range(2))
    numerical = replace(whole, K=whole.K + stiff, C=whole.C + damped)
    return replace(blocks, numerical=StoreysWithLaws(numerical, arranged(laws), dt_s))


def agree(step: DesignedStep, given: Recorded, folder: Path, share: float = SAME, **options: object) -> Conducted:
    """Play samples by both, which must do the same; return what the compiled step did."""
    ours, theirs = both(step, given, folder, **options)  # type: ignore[arg-type]
    assert list(differences(ours, theirs, share)) == []
    return ours


def test_every_block_is_the_one_of_the_compiled_step(tmp_path: Path) -> None:
    info, drive = rig_info(), ground(STEPS)
    step = bench_step(info, full(info), open_limits(info), drive)
    ours = agree(step, recorded(step, shown(info, drive), LOST), tmp_path)
    assert ours.reason == 0 and set(ours.log.lost) == {0.0, 1.0, 3.0}
    free = replace(step, blocks=replace(step.blocks, feedback_limit_v=1.0, shaping_step_v=0.0))
    unlimited = agree(free, recorded(step, shown(info, drive), LOST), tmp_path, 1e-10, options=FAST)
    assert np.abs(unlimited.log.command_v - ours.log.command_v).max() > 1.5 * info.converters.step_v  # it was limited


def test_the_printed_method_is_the_one_of_the_compiled_step(tmp_path: Path) -> None:
    """Without lead lost samples are not substituted: the last ones are kept."""
    info, drive = rig_info(latency_samples=2), ground(STEPS)
    step = bench_step(info, paper_like(info), open_limits(info), drive)
    ours = agree(step, recorded(step, shown(info, drive), (300, 301), stop_at=1000), tmp_path)
    assert ours.reason == 15 and ours.log.command_v.any()


@pytest.mark.campaign
@parametrize_first(1, "laws", LAWS)
def test_every_storey_law_is_the_one_of_the_compiled_step(tmp_path: Path, laws: str) -> None:
    info, drive = rig_info(), 8.0 * ground(STEPS)
    step = bench_step(info, with_laws(best_like(info), LAWS[laws], info.dt_s), open_limits(info), drive)
    given = recorded(step, shown(info, drive, 0.3), LOST)
    plain = replace(step, blocks=replace(step.blocks, numerical=storeys_of(storeys(3), info.dt_s)))
    ours, without = agree(step, given, tmp_path, SAME_LAWS), agree(plain, given, tmp_path)
    assert np.abs(ours.log.desired[0] - without.log.desired[0]).max() > 0.05 * np.abs(without.log.desired[0]).max()


@pytest.mark.campaign
def test_further_channels_and_a_load_cell_are_those_of_the_compiled_step(tmp_path: Path) -> None:
    info = with_channels(rig_info(), (displacement(), cell(), strain()))
    limits = open_limits(info)._replace(further=further_limits(info, np.array([2.0, 6.91, 6.95])))
    limits.further.tolerated[:] = 1e6
    drive = ground(STEPS)
    step = bench_step(info, best_with_cell(info), limits, drive)
    agree(step, recorded(step, shown(info, drive), LOST), tmp_path)
    limits.further.tolerated[1] = 1e-6
    assert agree(step, recorded(step, shown(info, drive)), tmp_path).reason == 23


def bounded(info: RigInfo) -> GuardLimits:
    """Return limits that the samples of these tests keep."""
    return open_limits(info)._replace(
        stroke_m=0.079, velocity_m_s=1.0, acceleration_m_s2=45.0, command_v=10.0, energy_ratio=1e9, energy_floor_j=1e-5
    )


TIGHT = {
    "stroke_m": (1e-5, 1),
    "velocity_m_s": (1e-3, 2),
    "abort": (np.full(3, 0.3), 3),
    "force_n": (0.5, 4),
    "tracking_error": (0.2, 6),
    "saturation_v": (np.array([9.0, 0.05, 9.0]), 8),
    "stuck": (np.array([1e9, 1e9, 0.01]), 9),
    "command_rate_v_s": (0.1, 10),
    "energy_ratio": (1e-6, 11),
    "reach_m": (1e-5, 24),
    "deviation_m": (1e-6, 25),
}


@parametrize_first(4, "limit", TIGHT)
def test_the_guard_stops_at_the_same_sample_for_the_same_reason(tmp_path: Path, limit: str) -> None:
    info, drive = rig_info(), np.vstack([ground(2400), np.zeros((6000, 3))])
    value, reason = TIGHT[limit]
    step = bench_step(info, full(info), bounded(info)._replace(**{limit: value}), drive)
    samples = shown(info, drive)
    samples[900:, 2] = samples[900, 2]  # a channel that sticks
    ours = agree(step, recorded(step, samples), tmp_path)
    assert ours.reason == reason
    assert ours.log.state[-1] == 5.0


@pytest.mark.campaign
@pytest.mark.parametrize(("lost", "reason"), [((400, 401, 402, 403, 404), 0), ((400, 401, 402, 403, 404, 405), 12)])
def test_too_many_lost_samples_end_the_test(tmp_path: Path, lost: tuple[int, ...], reason: int) -> None:
    info, drive = rig_info(), ground(STEPS)
    step = bench_step(info, best_like(info), bounded(info), drive)
    assert agree(step, recorded(step, shown(info, drive), lost), tmp_path).reason == reason


def test_a_sample_that_is_no_number_ends_the_test(tmp_path: Path) -> None:
    info, drive = rig_info(), ground(STEPS)
    step = bench_step(info, best_like(info), bounded(info), drive)
    samples = shown(info, drive)
    samples[700, 1] = np.nan
    ours = agree(step, recorded(step, samples), tmp_path)
    assert (ours.reason, ours.channel) == (7, 1) and np.isfinite(ours.log.command_v).all()


def small() -> DesignedStep:
    """Return a step of the bench with everything, and samples of a run."""
    info, drive = rig_info(), ground(1100)
    blocks = with_laws(full(info), LAWS["that degrade"], info.dt_s)
    one = Rehearsal(drive[:1000], shown(info, drive)[STILL + RAMP :][:1000])
    limits = bounded(info)._replace(saturation_v=np.full(3, 9.99))
    return replace(bench_step(info, blocks, limits, drive), rehearsals=(one, one))


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    step = small()
    return library_texts(step, golden_tests(step))


def golden(folder: Path, texts: dict[str, str], options: tuple[str, ...], **changed: tuple[str, str]) -> int:
    """Build the golden program from these texts and return its exit code."""
    folder.mkdir()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, (old, new) in changed.items():
        source = texts[f"{name}.c"]
        assert source.count(old) == 1, old
        (folder / f"{name}.c").write_text(source.replace(old, new), encoding="utf-8")
    sources = ("rths_step.c", "rths_data.c", "golden.c")
    build(folder, (*STRICT, *options, *sources, "-lm", "-o", "golden"))
    return subprocess.run([folder / "golden"], capture_output=True, check=False).returncode


@pytest.mark.campaign
def test_the_golden_program_agrees_also_under_sanitizers(tmp_path: Path, texts: dict[str, str]) -> None:
    assert golden(tmp_path / "sanitized", texts, SANITIZED) == 0
    assert golden(tmp_path / "fast", texts, FAST) == 0


CORTEX_M7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard")


@pytest.mark.parametrize("words", [("clang", "-O2"), ("arm-none-eabi-gcc", "-O2", *CORTEX_M7)], ids=lambda one: one[0])
def test_other_compilers_take_the_sources(tmp_path: Path, texts: dict[str, str], words: tuple[str, ...]) -> None:
    """Clang's program agrees too; a Cortex-M7 computes doubles in hardware and calls math.h alone."""
    if shutil.which(words[0]) is None:
        pytest.skip(f"no {words[0]} here")
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")

    def run(*more: str) -> str:
        return subprocess.run(more, cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    if words[0] == "clang":
        run(*words, *STRICT, "rths_step.c", "rths_data.c", "golden.c", "-lm", "-o", "golden")
        run("./golden")
        return
    for source in ("rths_step.c", "rths_data.c"):
        run(*words, *STRICT, "-c", source)
    called = {line.split()[-1] for line in run("arm-none-eabi-nm", "-u", "rths_step.o").splitlines()}
    assert called <= {"__aeabi_l2d", "exp", "memcpy", "memset", "pow", "rths_data", "sqrt", "tanh", "floor"}


BROKEN = {
    "rounding carried over": ("command + s->carried", "command"),
    "substituted samples": ("    s->gap_now++;\n    bridge(s);", "    s->gap_now++;"),
    "end by the operator": ("if (in->stop) take_over(s, RTHS_OPERATOR, (double)NAN);", ""),
    "saturation": ("if (fabs(samples[c]) >= s->saturation_v[c]) return beyond(s, fabs(samples[c]), RTHS_SATURATED);\n"
                   "    if (fabs(values[c]) > limits->abort[c]) return beyond(s, fabs(values[c]), RTHS_ACCEL",
                   "if (fabs(values[c]) > limits->abort[c]) return beyond(s, fabs(values[c]), RTHS_ACCEL"),
}  # fmt: skip


@parametrize_first(1, "term", BROKEN)
def test_the_golden_program_sees_a_missing_term(tmp_path: Path, texts: dict[str, str], term: str) -> None:
    assert golden(tmp_path / "broken", texts, EQUAL, rths_step=BROKEN[term]) == 1


@pytest.mark.campaign
def test_cmake_builds_the_library_and_its_test_passes(tmp_path: Path, texts: dict[str, str]) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("no cmake here")
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    for words in (["cmake", "-B", "build"], ["cmake", "--build", "build"], ["ctest", "--test-dir", "build"]):
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


ALLOWED = {"copysign", "exp", "floor", "memcpy", "memset", "pow", "rths_data", "sqrt", "tanh"}


def test_the_step_has_no_heap_and_nothing_global_that_is_written(tmp_path: Path) -> None:
    write(small(), tmp_path)
    build(tmp_path, (*STRICT, "-O2", "-c", "rths_step.c"))
    lines = subprocess.run(["nm", tmp_path / "rths_step.o"], capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in lines.splitlines()]
    assert {kind for kind, _ in symbols} <= set("UTtr") and {name for kind, name in symbols if kind == "U"} <= ALLOWED


def test_the_states_of_a_test_follow_one_another(tmp_path: Path) -> None:
    """Idle, armed, ramp-up, running, ramp-down, stopped: 0 to 5."""
    info = rig_info()
    test = Session(compiled(bench_step(info, best_like(info), bounded(info), ground(200)), tmp_path), 3)
    rest = (1e-3, 2e-3, -1e-3)
    assert [test.step(rest)[1] for _ in range(3)] == [0, 0, 0]
    assert test.step(rest, start=True)[1] == 1
    assert {test.step(rest)[1] for _ in range(3 * ZEROS)} == {1}  # until it is told to begin
    assert test.step(rest, start=True)[1] == 2
    ramp = [test.step(rest) for _ in range(STILL + RAMP)]
    assert {one[1] for one in ramp} == {2} and [one[4] for one in ramp] == [-1] * (STILL + RAMP - 1) + [0]
    assert test.step(rest)[1:] == (3, 0, -1, 1)
    assert test.step(rest, stop=True)[1:4] == (4, 15, -1)
    down = [test.step((9.0, 9.0, 9.0)) for _ in range(20000)]
    assert down[-1][:4] == (0.0, 5, 15, -1)
    assert test.step(rest, start=True)[1] == 5


AT_REST = {
    "a zero that is too large": ([0.0, 2.5, 0.0], [0.0, 2.5, 0.0], True, (0.0, 5, 100, 1)),
    "a channel that does not rest": ([0.0, 0.0, 0.7], [0.0, 0.0, -0.7], True, (0.0, 5, 101, 2)),
    "no number": ([0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], True, (0.0, 5, 7, 0)),
    "no samples": ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], False, (0.0, 5, 12, -1)),
    "well": ([0.0, 0.0, 0.01], [0.0, 0.0, -0.01], True, (0.0, 1, 0, -1)),
}


@pytest.mark.campaign
@parametrize_first(2, "what", AT_REST)
def test_channels_that_do_not_rest_stop_the_test_before_it_moves(tmp_path: Path, what: str) -> None:
    info = rig_info()
    even, odd, came, ends = AT_REST[what]
    test = Session(compiled(bench_step(info, best_like(info), bounded(info), ground(200)), tmp_path), 3)
    test.step(even, start=True)
    for k in range(ZEROS):
        found = test.step(odd if k % 2 else even, came=came)
    assert found[:4] == ends


def test_the_s_function_is_the_step(tmp_path: Path) -> None:
    """With a stub of Simulink's header: ports and sample time, then a test that a sample without number ends."""
    write(bench_step(rig_info(), best_like(rig_info()), bounded(rig_info()), ground(200)), tmp_path)
    build(tmp_path, (*STRICT, f"-I{SIMULINK}", "-c", "rths_sfunction.c"))
    build(tmp_path, ("-std=c99", "rths_sfunction.o", "rths_step.c", "rths_data.c", "-lm", "-o", "block"))
    words = [tmp_path / "block", str(2 + ZEROS + STILL + RAMP + 100)]
    done = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    assert done[0] == "3 3 6 3 0.0005"
    states = [float(line.split()[0]) for line in done[1:]]
    assert states == sorted(states) and set(states) == {1.0, 2.0, 3.0, 4.0}
    assert done[-1].split()[:2] == ["4", "7"]


def test_what_c_cannot_have_is_refused_by_its_name(tmp_path: Path) -> None:
    info = rig_info()
    law = with_laws(best_like(info), ((own(1, 4e8, 0.02, 0.0),),), info.dt_s)
    called = PythonFeedforward("adaptive", lambda: None)  # type: ignore[arg-type, return-value]
    step = bench_step(info, replace(law, feedforward=called), bounded(info), ground(50))
    with pytest.raises(InputError) as refused:
        write_library(step, tmp_path / "out", True, lambda _: None)
    told = "\n".join(refused.value.faults)
    assert "bench: controller: adaptive is a part of your own" in told
    assert "bench: structure.numerical.law[1]: is a law of your own" in told
    assert not (tmp_path / "out").exists()


def test_the_page_counts_operations_and_names_every_channel() -> None:
    step = small()
    page = readme(step)
    assert all(one.name in page for one in step.info.all_channels) and "@" not in page
    assert "| feedforward | 292 | 16 | 1 |" in page  # 16 rows of 12 states, 3 motions, 3 channels; 4 against friction


@pytest.mark.real_time
def test_the_target_that_steps_in_c_is_followed_over_its_link(tmp_path: Path, texts: dict[str, str]) -> None:
    """Its log, replayed by the compiled step on the samples that it took: the same commands, states and end."""
    step, folder = small(), tmp_path
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    build(
        folder,
        (
            *STRICT,
            "-O1",
            "-DCOUNTED_CLOCK=1",
            "-DWATCHDOG_S=10.0",
            "udp_target.c",
            "rths_step.c",
            "rths_data.c",
            "-lm",
            "-o",
            "udp_target",
        ),
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        own_port = free.getsockname()[1]
    words = [str(folder / "udp_target"), "127.0.0.1:0", f"127.0.0.1:{own_port}"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().split()[-1])
            info = replace(step.info, kind="target")
            rig = SteppingRig(info, Cable("127.0.0.1", own_port, "127.0.0.1", port, True), 0.5)
            rig.open()
            times_s = RAMP * info.dt_s, (STILL * info.dt_s, 3.0)
            run = prepare(info, step.blocks, NUMERICAL, step.drive, step.limits, ramp_s=times_s[0], still_s=times_s[1])
            numbers = checksum_number(step.case_sha256), checksum_number(step.model_sha256)
            rig.agree(Designed(*numbers, len(column_names(sizes_of(run.step)))))
            assert perform(rig, run) == ""
            rig.close()
        finally:
            process.kill()
    done, log = int(run.log.done[0]), signals(run.log, sizes_of(run.step))
    came, stop = log.lost[:done] != NO_ANSWER, np.zeros(done, dtype=bool)
    zeros_v = np.zeros(len(info.all_channels))  # the simulated table is silent at rest
    given = Recorded(log.samples_v[:, :done].T, came, stop, step.drive, STILL, RAMP, zeros_v)
    again = conduct_over(info, step.blocks, step.limits, given)
    assert (again.reason, again.channel) == tuple(run.guard.flags[1:3])
    moving = log.state[:done] < 5
    assert np.array_equal(again.log.state[:done][moving], log.state[:done][moving]) and moving.sum() > STILL + RAMP
    size = np.abs(again.log.command_v).max()
    assert size > 1e-3 and np.abs(again.log.command_v - log.command_v[:done])[moving].max() < SAME_LAWS * size
