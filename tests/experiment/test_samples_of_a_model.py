"""A check over samples of an identified model: the worst verdict, all reasons, figures with their range."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_check import LINEAR, OF_RUNS

import rths_cli
from rths_cli.analysis.references import REFERENCES
from rths_cli.analysis.sim import Response
from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE, Preflight
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment import check, check_command
from rths_cli.experiment.check import judge
from rths_cli.experiment.check_command import check_figures
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.model_files import save, to_groups
from rths_cli.experiment.setup import OwnSamples, Setup, make_setup
from rths_cli.findings import stated
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array
from rths_cli.quantities import Interval, intervals_of
from rths_cli.structure import Building

CASE = "el_centro_low_ff_fb"


def with_gain(found: Identification, factor: float) -> Identification:
    """Return an identification of a table with another gain, whose measured response has it too."""
    frfs = tuple(replace(frf, response=factor * frf.response) for frf in found.frfs[:1])
    best, paper = (replace(model, gain=factor * model.gain) for model in (found.best, found.paper))
    return replace(found, frfs=(*frfs, *found.frfs[1:]), best=best, paper=paper)


def stiffer(found: Identification, factor: float) -> Identification:
    """Return an identification of a specimen with other stiffnesses on the same table."""
    fit = found.specimen
    assert fit is not None
    changed = replace(
        fit,
        specimen=replace(fit.specimen, K=factor * fit.specimen.K),
        stiffness_n_per_m=factor * fit.stiffness_n_per_m,
        natural_frequency_hz=np.sqrt(factor) * fit.natural_frequency_hz,
    )
    return replace(found, specimen=changed)


def late(found: Identification, steps: int) -> Identification:
    """Return an identification of a table that is `steps` sample intervals later."""
    return replace(found, best=replace(found.best, delay_s=found.best.delay_s + steps * found.best.dt_s))


def with_samples(found: Identification, *samples: Identification) -> Identification:
    return replace(found, samples=samples)


@pytest.fixture(scope="module")
def certain() -> Setup:
    """Return the default case on a rig that is as declared: an uncertain one has a range of its own for true errors."""
    settings = ("table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0}",)
    return make_setup(load_cases([CASE], settings)[0])


@pytest.fixture(scope="module")
def identified(certain: Setup, memory: Memory) -> Identification:
    return memory.identify(certain, lambda _: None)


@pytest.fixture(scope="module")
def design(certain: Setup, identified: Identification) -> Design:
    return design_blocks(certain, identified)


@pytest.fixture(scope="module")
def several(identified: Identification) -> tuple[Identification, ...]:
    return (stiffer(with_gain(identified, 1.02), 0.99), stiffer(identified, 1.03))


@pytest.mark.campaign
def test_every_figure_is_the_nominal_one_with_the_range_over_all_members(
    certain: Setup, identified: Identification, design: Design, several: Sequence[Identification]
) -> None:
    """Each member is judged on its own with the same blocks; no figure of a member is outside its interval."""
    found = check_figures(judge(certain, with_samples(identified, *several), design))
    each = [check_figures(judge(certain, member, design)) for member in (identified, *several)]
    assert set(found) == set(each[0]) == LINEAR - OF_RUNS
    differ = set()
    for path in set(found) - {"check.largest_scaling"}:
        values = np.array([np.asarray(figures[path], dtype=float) for figures in each])
        assert np.asarray(found[path], dtype=float).tobytes() == values[0].tobytes(), path
        if not np.array_equal(values, np.broadcast_to(values[0], values.shape), equal_nan=True):
            differ.add(path)
            interval = found[path]
            assert isinstance(interval, Interval) and interval.probability == pytest.approx(1.0 / 3.0)
            np.testing.assert_array_equal(interval.low, values.min(axis=0), path)
            np.testing.assert_array_equal(interval.high, values.max(axis=0), path)
    assert set(intervals_of(found)) == differ
    assert {"check.rms_error_m_s2", "check.spectral_radius", "check.peak_command_v"} <= differ
    assert not [path for path in differ if path.startswith("check.limit_")]
    scalings = [float(np.asarray(figures["check.largest_scaling"])) for figures in each]
    assert found["check.largest_scaling"] == min(scalings) < scalings[0]


@pytest.mark.campaign
def test_a_model_without_other_samples_than_itself_is_judged_as_without_samples(
    certain: Setup, identified: Identification, design: Design
) -> None:
    alone = judge(certain, identified, design)
    doubled = judge(certain, with_samples(identified, identified), design)
    assert (doubled.preflight.verdict, doubled.preflight.reasons) == (alone.preflight.verdict, alone.preflight.reasons)
    figures, others = check_figures(alone), check_figures(doubled)
    assert list(figures) == list(others) and not intervals_of(others) and not intervals_of(figures)
    assert all(np.asarray(figures[path]).tobytes() == np.asarray(others[path]).tobytes() for path in figures)


@pytest.mark.campaign
def test_a_sample_with_an_unstable_loop_makes_the_verdict_unstable_and_says_how_many(
    identified: Identification,
) -> None:
    setup = make_setup(load_cases([CASE], ["controller=FF"])[0])
    design = design_blocks(setup, identified)
    bad = late(identified, 24)
    separate = [judge(setup, member, design).preflight for member in (identified, bad)]
    assert [one.verdict for one in separate] == [SAFE, UNSTABLE]
    found = judge(setup, with_samples(identified, stiffer(identified, 1.01), bad), design)
    assert found.preflight.verdict == UNSTABLE and found.known is not None  # the nominal loop has a budget
    assert found.preflight.reasons == (f"in 1 of 2 samples of the identified model: {separate[1].reasons[0]}",)
    figures = check_figures(found)
    error, limit = figures["check.rms_error_m_s2"], figures["check.limit_force_n"]
    assert isinstance(error, Interval) and np.isinf(error.high).all() and np.isfinite(error.low).all()
    assert not isinstance(limit, Interval) and figures["check.largest_scaling"] == 0.0


@pytest.mark.campaign
def test_a_record_too_large_for_some_samples_is_unsafe_in_the_words_of_the_worst(
    identified: Identification,
) -> None:
    """A softer specimen makes the table move farther."""
    members = (identified, stiffer(identified, 0.97), stiffer(identified, 0.94))
    design = design_blocks(make_setup(load_cases([CASE])[0]), identified)

    def at(scaling: float, found: Identification) -> Preflight:
        return judge(make_setup(load_cases([CASE], [f"scaling={scaling}"])[0]), found, design).preflight

    largest = [at(0.3, member).largest_scaling for member in members]
    assert largest[0] > 1.015 * largest[1] > 1.03 * largest[2]
    everyone = with_samples(*members)
    assert (at(0.99 * largest[2], everyone).verdict, at(0.99 * largest[2], everyone).reasons) == (SAFE, ())
    for number, share in ((2, "1 of 2"), (1, "2 of 2"), (0, "2 of 2")):
        scaling = 1.005 * largest[number]
        found, worst = at(scaling, everyone), at(scaling, members[2])
        quoted = " (the worst is told)" if share == "2 of 2" else ""
        said = tuple(f"in {share} samples of the identified model{quoted}: {reason}" for reason in worst.reasons)
        assert found.verdict == UNSAFE
        assert found.largest_scaling == worst.largest_scaling == pytest.approx(largest[2], rel=1e-3)
        assert found.reasons == (*at(scaling, members[0]).reasons, *said)
        assert bool(at(scaling, members[0]).reasons) == (number == 0)


@pytest.mark.campaign
def test_a_sample_whose_building_has_no_sim_is_named(
    certain: Setup, identified: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, odd = REFERENCES[0], stiffer(identified, 1.02)

    def unsolved(building: Building, dt_s: float, ground: Array) -> Response:
        if building.specimen is odd.specimen.specimen:
            raise InputError("SIM: its storeys are too unlike")
        return usual.sim(building, dt_s, ground)

    monkeypatch.setattr(check, "reference_of", lambda building: replace(usual, sim=unsolved))
    known = IdentifiedModel(with_samples(identified, stiffer(identified, 1.01), odd), "made up")
    verdict = check_command.verdict_on(certain, known)
    assert verdict.verdict == UNSAFE
    assert verdict.reasons == (
        "sample 2 of the identified model: the building as identified: SIM: its storeys are too unlike",
    )


def test_blocks_are_designed_from_the_nominal_model(
    certain: Setup, identified: Identification, several: Sequence[Identification], design: Design
) -> None:
    found = design_blocks(certain, with_samples(identified, *several))
    assert pickle.dumps(found) == pickle.dumps(design)


def test_what_cannot_be_judged_alike_is_no_sample(identified: Identification) -> None:
    found, fit = identified, identified.specimen
    nested = with_samples(found, found)
    fewer = replace(found, specimen=replace(fit, natural_frequency_hz=fit.natural_frequency_hz[:1]))
    for sample, word in (
        (nested, "samples itself"),
        (fewer, "has 1 floors, the nominal model has 2"),
        (1.02, "is float"),
    ):
        with pytest.raises(ValueError, match=word):
            with_samples(found, sample)
    with pytest.raises(ValueError, match="no samples"):
        to_groups(nested, ("table", "floor_2", "floor_3"))


def setup_with(samples: OwnSamples, *settings: str, overrides: tuple[str, ...] = ()) -> Setup:
    return make_setup(load_cases([CASE], settings)[0], overrides, samples=samples)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, certain: Setup, identified: Identification) -> dict[str, Path]:
    """Return model files: the nominal model, a sample, and a sample that its identification rejected."""
    folder = tmp_path_factory.mktemp("samples")
    sample = stiffer(identified, 1.02)
    verdict = replace(sample.verdict, accepted=False, refusals=(stated("made up to be bad"),))
    made = {"nominal": identified, "sample": sample, "rejected": replace(sample, verdict=verdict)}
    for name, found in made.items():
        save(folder / f"{name}.h5", certain, found, "made for this test", "0" * 64)
    return {name: folder / f"{name}.h5" for name in made}


@pytest.mark.campaign
def test_samples_come_from_model_files_or_a_function(identified: Identification, files: dict[str, Path]) -> None:
    named = f"identification.model={files['nominal']}"
    alone = Memory().at_rest(setup_with((), named), lambda _: None)
    read = Memory().at_rest(setup_with((files["sample"],), named), lambda _: None)
    made = Memory().at_rest(setup_with(lambda nominal: [stiffer(nominal, 1.02)] * 2, named), lambda _: None)
    assert alone.found.samples == () and alone.source in read.source
    assert read.source.endswith("; with 1 sample of it") and made.source.endswith("; with 2 samples of it")
    wanted = stiffer(identified, 1.02).specimen.specimen.K
    for known, count in ((read, 1), (made, 2)):
        assert [sample.specimen.specimen.K.tobytes() for sample in known.found.samples] == [wanted.tobytes()] * count


def test_files_that_are_no_samples_are_refused_before_anything_moves(files: dict[str, Path]) -> None:
    named = f"identification.model={files['nominal']}"
    for setup, word in (
        (setup_with((files["rejected"],), named), r"rejected\.h5 was rejected: made up to be bad; leave it out"),
        (setup_with((files["sample"].with_name("none.h5"),), named), r"none\.h5"),
        (setup_with((files["sample"],), "sample_rate_hz=1000"), r"sample\.h5: sampled at 2000"),
    ):
        with pytest.raises(InputError, match=word):
            Memory().prepare(setup)
    Memory().prepare(setup_with((files["rejected"],), named, overrides=("model",)))


@pytest.mark.campaign
def test_check_and_run_from_python_judge_every_sample(files: dict[str, Path], tmp_path: Path) -> None:
    settings = {"identification.model": files["nominal"], "runs": ["exp_rths"]}
    plain = rths_cli.check(CASE, settings=settings)
    found = rths_cli.check(CASE, settings=settings, samples=[files["sample"], str(files["sample"])])
    assert plain.safe and found.safe and plain.intervals == {}
    path = "check.building_frequency_hz"
    np.testing.assert_array_equal(found.metrics[path], plain.metrics[path])
    assert found.intervals[path].probability == pytest.approx(1.0 / 3.0)
    assert (found.intervals[path].high > found.metrics[path]).all() and type(found.metrics[path]) is np.ndarray

    def bad(nominal: Identification) -> list[Identification]:
        return [nominal, late(nominal, 24)]

    result = rths_cli.run(CASE, settings=settings, samples=bad, output=tmp_path)
    assert result.status == "refused" and result.attributes["check_verdict"] == UNSTABLE
    assert "in 1 of 2 samples of the identified model: the sampled closed loop is unstable" in result.status_reason
    assert str(result.attributes["model_source"]).endswith("; with 2 samples of it")
    assert np.isinf(result.intervals["check.rms_error_m_s2"].high).all()
    radius = result.intervals["check.spectral_radius"]
    assert radius.low == result.metrics["check.spectral_radius"] < 1.0 < radius.high
    with pytest.raises(InputError, match=r"samples: .* is one file; give a list"):
        rths_cli.check(CASE, samples=str(files["sample"]))
    with pytest.raises(InputError, match="samples: sample 1 is float"):
        rths_cli.check(CASE, settings=settings, samples=lambda _: [1.02])
