"""Every entry of the package, compiled."""

from __future__ import annotations

import importlib
import pkgutil
import socket
from dataclasses import replace

import numpy as np
from bench import DT_S, rig_info, specimen
from hybrid import best_like, ground, open_limits

import rths_cli
from rths_cli.analysis.metrics import figures_of_pairs
from rths_cli.analysis.nonlinear_sim_delay import simulate_delayed_with_laws
from rths_cli.analysis.sim_delay import simulate_delayed
from rths_cli.benchmark.campaign import BenchmarkRequest, benchmark_of
from rths_cli.benchmark.displacement import CaseRuns
from rths_cli.case.load import load_cases
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.laboratory.serve import describe, make_table
from rths_cli.loop import plain_target, realtime_loop, realtime_run, simulated_time_run, udp_target
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.fallback_commands import foresight_of
from rths_cli.loop.identified_rig_run import Disturbed, perfect_table, play_identified
from rths_cli.loop.scheduling import wait_periodically
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.compiled import Entry
from rths_cli.rigs.udp import handshake, link, packets
from rths_cli.rigs.udp.packets import siphash_into
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant
from rths_cli.structure import build

YIELDS = "{kind: bilinear, yield_displacement_m: 0.004, hardening: 0.05}"


def entries() -> dict[str, Entry]:
    """Return the entries of all modules, by name."""
    modules = [one.name for one in pkgutil.walk_packages(rths_cli.__path__, "rths_cli.") if "__main__" not in one.name]
    values = [value for name in modules for value in vars(importlib.import_module(name)).values()]
    return {value.name: value for value in values if isinstance(value, Entry)}


def compile_the_loops() -> None:
    """Compile what plays a record: in simulated time, in real time over UDP, through a rig's `exchange`."""
    info, drive, scratch = rig_info(), ground(50), np.zeros(2, np.int64)
    blocks = best_like(info)
    run = realtime_run.prepare(info, blocks, NUMERICAL, drive, open_limits(info), ramp_s=0.0)
    step = run.step, run.limits, run.guard
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (1, 3))
    samples, noise = np.zeros(len(info.channels)), rig.noise(51)
    simulated_time_run.run_virtual.bind(
        rig.plant, rig.state, *step, run.drive, 50, noise, run.log, np.zeros((0, samples.size)), samples, scratch
    )
    simulated_time_run.watch_virtual.bind(rig.plant, rig.state, noise, noise.copy())
    simulated_time_run.think_once.bind(*step, run.drive, 50, run.log, scratch)
    plant_kernel.hold_interval.bind(rig.plant, rig.state, np.zeros(1))
    plant_kernel.read_samples.bind(rig.plant, rig.state, samples, samples.copy())
    realtime_loop.conduct_once.bind(run.course, *step, run.drive, run.log, samples)
    counters = FrictionFeedforward(blocks.feedforward.linearised(), 0.02, 0.004, 25.0, 0.003, left=0.0)
    other = realtime_run.prepare(info, replace(blocks, feedforward=counters), NUMERICAL, drive, open_limits(info))
    realtime_loop.conduct_once.bind(
        other.course, other.step, other.limits, other.guard, other.drive, other.log, samples
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nowhere:
        there = link.fresh_link(nowhere, np.zeros(2, np.uint64), samples.size)
        realtime_loop.run_udp.bind(there, run.course, *step, run.drive, run.log, True)
    wait_periodically.bind(1, 1, scratch, scratch)
    foresight_of(blocks, NUMERICAL, DT_S)
    still = Disturbed(np.zeros((len(drive), samples.size)))
    play_identified(perfect_table(specimen(), info, 1), info, blocks, drive, open_limits(info), still)
    run_block(blocks.feedback, np.zeros((len(blocks.feedback.B[0]), 5)))


def compile_the_exchange() -> None:
    """Compile both ends of the exchange over UDP."""
    key, packet, number = np.zeros(2, np.uint64), np.zeros(packets.MOST_BYTES, np.uint8), np.zeros(1, np.int64)
    greeter = handshake.open_greeter(key, 3, 1, 10**9)
    handshake.answer_hello_at.bind(greeter, packet, 0, 0, 0, False, packet)
    handshake.opens_session_at.bind(greeter, packet, 0, 0, packet)
    handshake.make_session_key.bind(packet, key, packet, key)
    packets.seal_packet.bind(packet, packets.HELLO, 0, 0, key)
    packets.judge_packet.bind(packet, 0, key)
    siphash_into.bind(packet, 0, key, key)
    link.prepare(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nowhere:
        table = make_table(describe("aps400_virtual", "three_storey", ("sample_rate_hz=200",), 0), 5_000_000)
        door = udp_target.open_door(nowhere, greeter, key, 5_000_000, 300_000_000, number)
        udp_target.serve_packets.bind(door, table)
        plain_target.serve_frames.bind(door, plain_target.open_side(True), table)


def compile_the_analysis() -> None:
    """Compile SIM-DELAY, both solutions of a building with laws, and the errors of a run."""
    record = np.sin(np.arange(400.0))
    case = load_cases(["el_centro_low_ff_fb"])[0]
    simulate_delayed(build(case.structure, case.damping), DT_S, record, 0.001)
    (yielding,) = load_cases(["el_centro_low_ff_fb"], (f"structure.numerical.law=[[{YIELDS}]]",))
    simulate_delayed_with_laws(build(yielding.structure, yielding.damping), DT_S, record[:20], 0.001)
    bench = benchmark_of(BenchmarkRequest("silva2020", cases=("1",), compensators=("none",)))
    runs = CaseRuns(bench, bench.spec.cases[0], bench.storeys(bench.spec.cases[0]), np.zeros((3, 1)),
                    bench.designed(bench.spec.compensators[0]))  # fmt: skip
    runs.radius(bench.plant(0, 0))
    figures_of_pairs([(record, 0.9 * record)], DT_S, high_pass_hz=5.0)
