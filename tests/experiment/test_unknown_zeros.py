"""What zeros, noise and rounding of the samples add to the command of a hybrid test."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hybrid import open_limits
from portfolio import parametrize_first

from rths_cli.analysis.stability_check import SAFE, Strays, reach, strays
from rths_cli.case.load import load_cases
from rths_cli.experiment.check import Judged, judge
from rths_cli.experiment.design import design_blocks, loop_parts
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_series
from rths_cli.identification.results import Identification
from rths_cli.loop.identified_rig_run import Disturbed, play_identified, seen_by_model
from rths_cli.numerics.lti import Array

Play = Callable[[Array], Array]


def case_of(identified: Identification, corner_hz: float = 0.024) -> tuple[Setup, Judged, Play]:
    """Return a case with another AC coupling, its check, and its step on the identified rig without ground motion: the
    command (n,) in V by what is added to the samples (n, c) in V. That rig has no coupling, and none is corrected."""
    settings = ["controller={kind: FF+FB, reaction_feedforward: false}"]
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])
    coupled = tuple(replace(channel, high_pass_hz=corner_hz) for channel in setup.rig.channels)
    setup = replace(setup, rig=replace(setup.rig, channels=coupled))
    design = design_blocks(setup, identified)
    rig, _ = loop_parts(setup, identified)
    blocks = replace(seen_by_model(rig, design.blocks, setup.rig, setup.removes_sensors), shaping_step_v=0.0)

    def play(added_v: Array) -> Array:
        still = np.zeros((len(added_v), 3))
        played = play_identified(rig.plant, setup.rig, blocks, still, open_limits(setup.rig), Disturbed(added_v))
        return played.log.command_v[: played.steps]

    return setup, judge(setup, identified, design), play


@pytest.mark.campaign
@parametrize_first(1, "corner_hz", [0.05, 0.3])
def test_an_offset_moves_the_command_as_far_as_the_check_says(
    default_identification: Identification, corner_hz: float
) -> None:
    """Each channel is half a bit off from the start, of which the correction of its coupling makes a line."""
    setup, judged, play = case_of(default_identification, corner_hz)
    known, stability = judged.known, judged.preflight.stability
    assert known is not None
    rows, channels, bit = len(setup.motion.time_s), len(setup.rig.channels), setup.rig.converters.step_v
    line = 0.5 * bit * (1.0 + 2.0 * np.pi * corner_hz * setup.rig.dt_s * np.arange(rows))
    paths = [np.abs(play(np.outer(line, one))).max() for one in np.eye(channels)]
    silent = replace(known, noise_m_s2=np.zeros(channels), zero_m_s2=None)
    two_sigma = 2.0 / np.sqrt(3.0) * np.linalg.norm(paths)  # half a bit is sqrt(3) standard deviations
    found = strays(silent, stability)
    assert found.aside_v == pytest.approx(min(two_sigma, sum(paths)), rel=0.02)
    bits = bit / np.array([channel.sensitivity_v_per_unit for channel in setup.rig.channels])
    assert strays(replace(silent, noise_m_s2=bits), stability).aside_v < 1e-3 * found.aside_v


@pytest.mark.campaign
def test_noise_moves_the_command_as_fast_as_the_check_says(default_identification: Identification) -> None:
    """Normal noise in all channels; the peak of 100,000 differences is within a tenth of what independent ones have.
    Rounding errors are bounded: their peak is less."""
    setup, judged, play = case_of(default_identification)
    known, stability = judged.known, judged.preflight.stability
    assert known is not None
    rows, channels, bit = len(setup.motion.time_s), len(setup.rig.channels), setup.rig.converters.step_v
    sizes = np.array([channel.sensitivity_v_per_unit for channel in setup.rig.channels])
    random = np.random.default_rng(3)
    for channel, wanted in enumerate(stability.rate_by_noise):
        noise = np.zeros((rows, channels))
        noise[:, channel] = 1e-3 * random.standard_normal(rows)
        assert np.std(np.diff(play(noise))) / setup.rig.dt_s == pytest.approx(1e-3 * wanted, rel=0.03)
    white_v = 20.0 * bit
    rates = np.abs(np.diff(play(white_v * random.standard_normal((rows, channels))))) / setup.rig.dt_s
    noisy = replace(known, noise_m_s2=np.full(channels, white_v) / sizes)
    assert strays(noisy, stability).rate_v_s == pytest.approx(rates.max(), rel=0.1)
    rounded = play(bit * random.uniform(-0.5, 0.5, (rows, channels)))
    silent = replace(known, noise_m_s2=np.zeros(channels))
    steepest = np.abs(np.diff(rounded)).max() / setup.rig.dt_s
    assert steepest <= strays(silent, stability).rate_v_s <= 1.4 * steepest


def test_the_reach_contains_what_is_added(default_identification: Identification) -> None:
    setup, judged, _ = case_of(default_identification)
    known, prediction = judged.known, judged.preflight.prediction
    assert known is not None and prediction is not None
    masses, gain = np.ones(len(setup.rig.channels)), setup.rig.gain_m_per_v
    still, aside, fast = (
        reach(known, prediction, setup.rig, masses, each) for each in (Strays(), Strays(0.5), Strays(0.0, 2.0))
    )
    for moved, more in ((aside, [0.5 * gain, 0.0, 0.0, 0.0, 0.0, 0.5]), (fast, [None, 2.0 * gain, 0.0, 0.0, 0.0, 0.0])):
        for before, after, added in zip(still, moved, more, strict=True):
            if added is not None:  # the room to brake depends on where the table is
                assert after.peak - before.peak == pytest.approx(added, abs=1e-12)
                assert after.fixed - before.fixed == pytest.approx(added, abs=1e-12)
    assert still[0].peak < fast[0].peak


def with_offsets(case: dict[str, object], offsets_v: list[float], folder: Path, **table_keys: object) -> Setup:
    """Return a case on a virtual table with 12 bits whose channels have these offsets."""
    imperfections, converters = {"channels": {"offset_v": offsets_v}}, {"bits": 12, "latency_samples": 3}
    table = {"extends": "aps400_virtual", "converters": converters, "imperfections": imperfections, **table_keys}
    path = folder / "case.yaml"
    path.write_text(json.dumps({"record": "el_centro", "scaling": 0.2, "controller": "FF+FB", "table": table, **case}))
    return make_setup(load_cases([path])[0])


@pytest.mark.campaign
def test_a_record_in_motion_shows_what_the_zeros_at_rest_are_off_by(tmp_path: Path) -> None:
    """12 bits of 4.9 mV: the zeros at rest are 0, one and no bit, the channels' offsets 1.5, 3.2 and -0.7 mV."""
    offsets_v = [0.0015, 0.0032, -0.0007]
    setup = with_offsets({"structure": "three_storey", "damping": "low"}, offsets_v, tmp_path)
    found = Memory().identify(setup, lambda _: None)
    bit, sizes = setup.rig.converters.step_v, [channel.sensitivity_v_per_unit for channel in setup.rig.channels]
    wanted = [(v - bit * round(v / bit)) / size for v, size in zip(offsets_v, sizes, strict=True)]
    shown = [channel.zero_m_s2 for channel in found.channels]
    assert shown == pytest.approx(wanted, abs=0.03 * bit / sizes[0])
    known = judge(setup, found, design_blocks(setup, found)).known
    assert known is not None and known.zero_m_s2 == pytest.approx(shown)


@pytest.mark.campaign
def test_a_test_goes_aside_as_far_as_its_zeros_were_seen_to_be_off(tmp_path: Path) -> None:
    """The mean command of a run on the virtual table, whose sensor's offset is a fifth of a bit, against the check."""
    building = {
        "numerical": {"masses_kg": [14.8, 9.9], "stiffness_n_per_m": [12e4, 9e4]},
        "experimental": {
            "masses_kg": [8.71, 3.99], "stiffness_n_per_m": [35505.0, 55589.0], "damping_ratios": [0.058, 0.023]
        },
    }  # fmt: skip
    case = {"structure": building, "damping": {"first_mode_ratio": 0.03}, "runs": ["exp_rths"]}
    physics = {"force_limit_n": 174.0, "loop_specimen_mass_kg": 22.9, "moving_mass_kg": 8.94}
    setup, memory = with_offsets(case, [0.001, 0.0, 0.0], tmp_path, physics=physics), Memory()
    found = memory.identify(setup, lambda _: None)
    judged = judge(setup, found, design_blocks(setup, found))
    known, stability = judged.known, judged.preflight.stability
    assert known is not None and judged.preflight.verdict == SAFE
    seen, none = (
        strays(replace(known, zero_m_s2=zeros), stability).aside_v for zeros in (known.zero_m_s2, np.zeros(3))
    )
    (tmp_path / "ideal").mkdir()
    ideal = with_offsets(case, [0.0, 0.0, 0.0], tmp_path / "ideal", physics=physics)
    commands = []
    for name, of, its in (("r.h5", setup, memory), ("i.h5", ideal, Memory())):
        assert run_case(of, tmp_path / name, its, "test", lambda _: None).status == "complete"
        commands.append(read_series(tmp_path / name, "exp_rths/command_v"))
    assert seen > 2.0 * none
    span = round(0.5 / setup.rig.dt_s)
    aside = np.convolve(commands[0] - commands[1], np.full(span, 1.0 / span), "valid")
    assert np.abs(aside).max() == pytest.approx(seen - none, rel=0.05)
