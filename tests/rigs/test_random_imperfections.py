"""Random imperfections have their stated statistics: measured at the rig's samples, over many seeds or in long runs.

Nothing of what draws them is used here but the rig itself. Distributions are compared by Kolmogorov and Smirnov's test,
spreads by the chi-square distribution, correlations by their normal limit; each may fail by chance once in 1e4.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bench import DT_S, LINEAR, ideal_info, specimen
from further_channels import cell, displacement, strain, with_channels
from portfolio import parametrize_first
from scipy.linalg import toeplitz
from scipy.stats import chi2, kstest, norm, truncnorm

from rths_cli.case.rig_schema import VirtualRigSpec
from rths_cli.case.virtual_imperfections_schema import VirtualImperfections
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.interface import as_commands
from rths_cli.rigs.virtual.laboratory import laboratory_of
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, virtual_rig

CHANCE = 1e-4
LABORATORY = Path(__file__).parents[2] / "configs" / "rigs" / "aps400_laboratory.yaml"
EARLY = {"command_skew_s": -1e-4}
"""Commands act between the instants of samples, whose neighbourhood is smooth then."""


def rig_of(
    stated: dict[str, Any], info: RigInfo, run: int = 0, noise: float = 0.0, session: int | None = None
) -> VirtualRig:
    spec = VirtualRigSpec.model_validate(
        {
            "kind": "virtual",
            "imperfections": stated,
            "sensors": {"noise_rms_m_s2": noise},
            "physics": LINEAR.model_dump(),
        }
    )
    named = None if session is None else (4, session)
    return virtual_rig(spec, info, specimen(), 0.0, (4, run), True, 4, named)


def played(rig: VirtualRig, command_v: Array) -> Array:
    """Return samples in V (c, n), the first before any command."""
    found = [rig.arm().copy()]
    found += [rig.exchange(as_commands(np.array([one]))).copy() for one in command_v[:-1]]
    return np.array(found).T


def is_normal(values: Array, std: float, largest: float = np.inf) -> None:
    """Assert that independent values are normal with this spread, cut at `largest` spreads."""
    values = np.ravel(values) / std
    assert kstest(values, truncnorm(-largest, largest).cdf).pvalue > CHANCE
    low, high = chi2.ppf([CHANCE / 2, 1.0 - CHANCE / 2], values.size) / values.size
    assert low < np.mean(values**2) < high


def are_independent(rows: Array) -> None:
    """Assert that rows (m, n) of independent values are uncorrelated, with each other and with their own neighbours."""
    m, n = rows.shape
    found = np.corrcoef(rows)[np.triu_indices(m, 1)]
    own = [np.corrcoef(row[1:], row[:-1])[0, 1] for row in rows]
    each = np.concatenate([np.atleast_1d(found), own])
    assert np.abs(each).max() < norm.isf(CHANCE / 2 / each.size) / np.sqrt(n)


def with_floats(given: Any) -> Any:
    """Return what YAML reads, "25e-6" as the number it is."""
    if isinstance(given, dict):
        return {key: with_floats(value) for key, value in given.items()}
    return float(given) if isinstance(given, str) else given


@pytest.mark.campaign
def test_each_draw_of_the_laboratory_is_that_of_its_file() -> None:
    """Over 2000 laboratories each drawn value is normal with mean and spread of the file, cut at four spreads, and
    independent of every other; what the file states as a number is that number."""
    stated = with_floats(yaml.safe_load(LABORATORY.read_text())["imperfections"])
    made = VirtualImperfections.model_validate(stated)
    drawn = [laboratory_of(made, seed, 3, 2).values for seed in range(2000)]
    rows, names = [], {f"{part}.{name}": one for part, keys in stated.items() for name, one in keys.items()}
    for name, one in names.items():
        if name not in drawn[0]:
            continue
        values = np.array([each[name] for each in drawn]).T
        if isinstance(one, dict):
            for place in values:
                is_normal(place - one.get("mean", 0.0), one["std"], 4.0)
                rows.append(place)
        else:
            assert np.all(values == one), name
    per_run = {"channels.gain_change_between_runs"}
    assert {n for n, one in names.items() if isinstance(one, dict)} - per_run <= set(drawn[0])
    assert len(rows) == 38  # seven of each channel, three of each floor or storey, eleven of which there is one
    are_independent(np.array(rows))


@pytest.mark.campaign
def test_gains_change_from_session_to_session_as_stated() -> None:
    info, command = ideal_info(), np.sin(np.arange(40.0))
    stated = {"channels": {"gain_change_between_runs": {"std": 0.003}}}
    true = played(rig_of({"channels": {"offset_v": 1e-30}}, info), command)
    change = np.array([played(rig_of(stated, info, run), command)[:, -1] / true[:, -1] - 1.0 for run in range(500)])
    is_normal(change, 0.003, 4.0)
    are_independent(change.T)
    first, again = (played(rig_of(stated, info, run, session=7), command) for run in (1, 2))
    assert np.array_equal(first, again)


@pytest.mark.campaign
def test_the_hum_has_its_size_and_any_phase() -> None:
    """By the Fourier coefficient of two whole periods of each of 500 runs."""
    info, count = ideal_info(), round(2.0 / 50.0 / DT_S)
    stated = {"channels": {"hum_v": [0.003, 0.001, 0.002]}}
    rest = np.array([played(rig_of(stated, info, run), np.zeros(count + 1))[:, 1:] for run in range(500)])
    found = np.fft.rfft(rest)[..., 2] / (count / 2)
    assert np.allclose(np.abs(found), [0.003, 0.001, 0.002], rtol=1e-9)
    phase = np.mod(np.angle(found), 2.0 * np.pi)
    assert kstest(phase.ravel() / (2.0 * np.pi), "uniform").pvalue > CHANCE
    are_independent(np.vstack([np.cos(phase.T), np.sin(phase.T)]))


FURTHER = (displacement(noise_rms=2e-5), cell(noise_rms=0.05), strain())
QUIET: dict[str, Any] = {"channels": {"offset_v": 1e-30}}


@parametrize_first(1, "stated", [{}, QUIET], ids=["as declared", "with imperfections"])
def test_each_channel_has_its_noise(stated: dict[str, Any]) -> None:
    """White, of the stated size, independent between channels and runs, and of that in the rest before a run."""
    info, count = with_channels(ideal_info(), FURTHER), 10000
    rigs = [rig_of(stated, info, run, 0.003) for run in (1, 2)]
    samples = np.vstack([played(rig, np.zeros(count)) for rig in rigs])
    sizes = [info.channels[0].sensitivity_v_per_unit * 0.003] * 3 + [100.0 * 2e-5, 0.02 * 0.05]
    noisy = np.vstack([samples[:5], samples[6:11]])
    for row, size in zip(noisy, sizes * 2, strict=True):
        is_normal(row, size)
    assert np.abs(samples[[5, 11]]).max() < 1e-25
    are_independent(noisy)
    if stated:
        rest, own = rigs[0].noise_at_rest(4096), rig_of(stated, info, 1).noise(4096)
        assert rest is not None
        is_normal(rest, 1.0)
        are_independent(np.vstack([rest.T, own.T]))


@pytest.mark.campaign
def test_the_zero_walks_beside_the_noise() -> None:
    """In 0.5 s steps of variance walk^2 dt: the walk grows with the square root of time. Differences of successive
    samples have the covariance -noise^2 of white noise: it is not the noise that walks."""
    info, walk, noise_v, count = ideal_info(), 0.02, 4e-4, 40000
    walked = played(rig_of({"channels": {"offset_walk_v_per_sqrt_s": [walk, 2 * walk, 0.0]}}, info), np.zeros(count))
    for row, size in zip(walked[:2], (walk, 2 * walk), strict=True):
        is_normal(np.diff(row), size * np.sqrt(DT_S))
    are_independent(np.diff(walked[:2]))
    rms = noise_v / info.channels[0].sensitivity_v_per_unit
    both = played(rig_of({"channels": {"offset_walk_v_per_sqrt_s": walk}}, info, noise=rms), np.zeros(count))
    for steps in np.diff(both):
        spread = np.var(steps)
        assert spread == pytest.approx(walk**2 * DT_S + 2 * noise_v**2, rel=norm.isf(CHANCE) * 2 / np.sqrt(count))
        beside = np.mean(steps[1:] * steps[:-1])
        assert beside == pytest.approx(-(noise_v**2), abs=norm.isf(CHANCE) * 2 * spread / np.sqrt(count))


def moving(samples: int) -> Array:
    time = DT_S * np.arange(samples)
    return np.sin(2.0 * np.pi * 5.0 * time) + 0.5 * np.sin(2.0 * np.pi * 31.0 * time)


@pytest.mark.campaign
def test_samples_jitter_as_stated() -> None:
    """What a sample misses over the rate at which the acceleration changes there: all channels share the instant."""
    info, command, h = ideal_info(high_pass_hz=0.0), moving(4000), 2e-5

    def at(skew_s: float, jitter_s: float = 0.0) -> Array:
        converters = {**EARLY, "sample_jitter_s": jitter_s}
        return played(rig_of({"converters": converters, "channels": {"skew_s": skew_s}}, info), command)

    before, true, after, late = at(-h), at(0.0), at(h), at(0.0, 1e-5)
    rate, curve, missed = (after - before) / (2.0 * h), (after - 2.0 * true + before) / h**2, late - true
    steep = np.abs(rate) > 10.0 * h * np.abs(curve)
    late = np.divide(missed, rate, out=np.zeros_like(rate), where=steep)
    for _ in range(3):
        late = np.divide(missed, rate + 0.5 * curve * late, out=np.zeros_like(rate), where=steep)
    assert np.all(np.count_nonzero(steep, axis=1) > 1000)
    for row, chosen in zip(late, steep, strict=True):
        is_normal(row[chosen], 1e-5)
    for one, other in pairwise(range(3)):
        assert np.abs(late[one] - late[other])[steep[one] & steep[other]].max() < 1e-6
    after_another = steep[0, 1:] & steep[0, :-1]
    found = np.corrcoef(late[0, 1:][after_another], late[0, :-1][after_another])[0, 1]
    assert np.abs(found) < norm.isf(CHANCE / 2) / np.sqrt(np.count_nonzero(after_another))


def test_commands_jitter_as_stated() -> None:
    """The table is linear here: the answer to one late edge, found with a skew, deconvolves what many edges miss."""
    info, command, h = ideal_info(high_pass_hz=0.0), moving(1200), 2e-5
    step = np.zeros_like(command)
    step[1:] = 1.0

    def at(given: Array, skew_s: float = 0.0, jitter_s: float = 0.0) -> Array:
        converters = {"command_skew_s": EARLY["command_skew_s"] + skew_s, "command_jitter_s": jitter_s}
        return played(rig_of({"converters": converters}, info), given)[0]

    answer = (at(step, h) - at(step, -h)) / (2.0 * h)
    begun = int(np.argmax(np.abs(answer) > 0.0))
    edges = np.diff(command)
    missed = (at(command, jitter_s=1e-5) - at(command))[begun:]
    response = toeplitz(answer[begun : begun + missed.size], np.zeros(missed.size))
    late = np.linalg.solve(response, missed)
    late = late[: edges.size][: missed.size] / edges[: missed.size]
    steep = np.abs(edges[: late.size]) > 0.01
    assert np.count_nonzero(steep) > 800
    is_normal(late[steep], 1e-5)
    assert np.abs(np.corrcoef(late[1:], late[:-1])[0, 1]) < norm.isf(CHANCE / 2) / np.sqrt(800)
