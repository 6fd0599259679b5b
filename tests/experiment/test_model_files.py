"""Model files: every bit comes back, another rig or specimen is refused, and the cache never changes a result."""

from __future__ import annotations

import os
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from datetime import datetime
from importlib.metadata import EntryPoint
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from declared_contents import model_faults
from portfolio import parametrize_first

from rths_cli.case import plugin_interface
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment import identify_on_rig, model_files
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.model_files import KEPT, Cache, from_groups, key, load, save, to_groups
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.model_file import read_model
from rths_cli.findings import Finding, stated
from rths_cli.identification.results import Identification, NonlinearSpecimen, Pitch

CASE = "el_centro_low_ff_fb"


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases([CASE], settings)[0])


def leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every number, text and array of nested dataclasses and tuples with type and bits."""
    if is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name), f"{where}.{field.name}")
    elif isinstance(value, tuple):
        yield f"{where}.length", len(value)
        for index, entry in enumerate(value):
            yield from leaves(entry, f"{where}[{index}]")
    elif isinstance(value, np.ndarray):
        yield where, (value.dtype.str, value.shape, value.tobytes())
    elif isinstance(value, complex):
        yield where, ("complex", struct.pack("dd", value.real, value.imag))
    elif isinstance(value, float):
        yield where, ("float", struct.pack("d", value))
    else:
        yield where, (type(value).__name__, value)


def bits(found: Identification) -> dict[str, Any]:
    return dict(leaves(found))


@pytest.fixture(scope="module")
def file(
    tmp_path_factory: pytest.TempPathFactory, default_setup: Setup, default_identification: Identification
) -> Path:
    path = tmp_path_factory.mktemp("model") / "models" / "m.h5"
    save(path, default_setup, default_identification, "made for this test", "0" * 64)
    return path


def test_a_specimen_that_is_not_linear_comes_back(
    tmp_path: Path, default_setup: Setup, default_identification: Identification
) -> None:
    random = np.random.default_rng(3)
    k, c, joints, bends = (random.uniform(1.0, 2.0, size) for size in ((2,), (2, 2), (2, 4), (2, 5)))
    found = replace(default_identification, nonlinear=NonlinearSpecimen(k, c, joints, 1e-3 * joints, -bends, bends))
    save(tmp_path / "m.h5", default_setup, found, "made for this test", "0" * 64)
    assert bits(load(tmp_path / "m.h5", default_setup).found) == bits(found)


def test_every_bit_of_an_identification_comes_back(
    file: Path, default_setup: Setup, default_identification: Identification
) -> None:
    stored = load(file, default_setup)
    wanted, got = bits(default_identification), bits(stored.found)
    assert len(wanted) > 200
    assert got == wanted
    assert stored.about["data_source"] == "made for this test" and len(stored.sha256) == 64


def test_a_model_keeps_the_pitch_of_the_base(
    tmp_path: Path, default_setup: Setup, default_identification: Identification
) -> None:
    found = replace(default_identification, pitch=Pitch(1e-6, 1e-7, np.array([1.005, 0.998])))
    save(tmp_path / "m.h5", default_setup, found, "made for this test", "0" * 64)
    assert model_faults(tmp_path / "m.h5") == []
    kept = load(tmp_path / "m.h5", default_setup).found.pitch
    assert kept is not None and kept.seen and (kept.flexibility_m_per_n, kept.error_m_per_n) == (1e-6, 1e-7)
    np.testing.assert_array_equal(kept.stiffness_ratio, [1.005, 0.998])


@pytest.mark.campaign
def test_a_model_of_a_rig_that_was_certain_drives_one_that_is_uncertain_by_default_and_not_the_other_way_round(
    file: Path, tmp_path: Path, memory: Memory, default_setup: Setup
) -> None:
    certain = setup_of("table.uncertainty={corner: 0, skew_s: 0}")
    save(tmp_path / "certain.h5", certain, memory.identify(certain, no_progress), "made for this test", "0" * 64)
    assert load(tmp_path / "certain.h5", default_setup).found.calibration is None
    for setup, path in ((certain, file), (setup_of("table.uncertainty.corner=0.2"), tmp_path / "certain.h5")):
        with pytest.raises(InputError, match="another one"):
            load(path, setup)


@pytest.mark.campaign
def test_what_a_loop_must_tolerate_is_no_part_of_what_a_model_is(file: Path, tmp_path: Path, memory: Memory) -> None:
    other = setup_of("table.uncertainty.table_gain=0.05")
    assert load(file, other).found.calibration is not None
    certain = setup_of("table.uncertainty={corner: 0, skew_s: 0, table_gain: 0.05}")
    save(tmp_path / "certain.h5", certain, memory.identify(certain, no_progress), "made for this test", "0" * 64)
    assert load(tmp_path / "certain.h5", other).found.calibration is None


def test_a_file_from_before_the_aliass_integral_was_known_has_none(default_identification: Identification) -> None:
    names = tuple(f"channel_{i}" for i in range(len(default_identification.frfs)))
    groups = {
        name: {key: item.data for key, item in group.items()}
        for name, group in to_groups(default_identification, names).items()
    }
    assert default_identification.best.coupling_hz == pytest.approx(0.024, rel=0.1)
    assert dict(leaves(from_groups(groups, names).best)) == dict(leaves(default_identification.best))
    del groups["table/best"]["coupling_hz"]
    assert from_groups(groups, names).best.coupling_hz == 0.0
    assert groups["calibration"].pop("gain_widening").size == 3
    del groups["calibration"]["further_gain"]
    older = from_groups(groups, names).calibration
    assert older is not None and older.gain_widening.size == older.further_gain.size == 0  # of rths 0.1
    del groups["table/best"]["gain"]
    with pytest.raises(TypeError):
        from_groups(groups, names)


def test_what_an_identification_may_lack_comes_back_too(
    tmp_path: Path, default_setup: Setup, default_identification: Identification
) -> None:
    refusals = (stated("größer: 1 %"), Finding("model.lag", {"lag_s": 0.6}).at("at.record", record=2))
    notes = (stated("a; b", "warns"), stated("", "notes"))
    verdict = replace(default_identification.verdict, accepted=False, refusals=refusals, notes=notes, lag_s=-0.0)
    poor = replace(
        default_identification,
        noise_floors=(None, *default_identification.noise_floors[1:]),
        specimen=None,
        free_vibration=None,
        candidates=(),
        levels=(),
        roots=tuple(replace(root, damping_ratio=float("nan")) for root in default_identification.roots),
        channels=tuple(replace(channel, rest_rms_m_s2=None) for channel in default_identification.channels),
        verdict=verdict,
    )
    save(tmp_path / "poor.h5", default_setup, poor, "", "")
    assert bits(load(tmp_path / "poor.h5", default_setup).found) == bits(poor)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("table.physics.coulomb_n=0.9",), ("rig", "another")),
        (("table.nominal.gain_m_per_v=0.008",), ("rig", "another")),
        (("table.sensors.sensitivity_mv_per_g=100",), ("rig", "another")),
        (("structure.experimental.masses_kg=[6.91, 7.5]",), ("specimen", "6.91 6.95", "6.91 7.5")),
        (("structure.experimental.natural_frequencies_hz=[3.3, 8.4]",), ("specimen", "differs")),
        (("structure.interface_experimental_mass_kg=1",), ("specimen", "differs")),
        (("sample_rate_hz=1000",), ("sampled at 2000.0 Hz", "1000.0 Hz")),
        (("identification.sensor_dynamics=kept",), ("sensor dynamics removed", "kept")),
    ],
)
def test_a_model_of_something_else_is_refused_with_what_differs(
    file: Path, settings: tuple[str, ...], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as refused:
        load(file, setup_of(*settings))
    (sentence,) = refused.value.faults
    assert sentence.startswith(f"{file}: ")
    assert [word for word in words if word not in sentence] == []
    assert refused.value.exit_code == 2


def test_every_difference_is_named(file: Path) -> None:
    other = setup_of(
        "table.converters.latency_samples=2", "structure.experimental.masses_kg=[6, 7]", "sample_rate_hz=4000",
        "identification.sensor_dynamics=kept",
    )  # fmt: skip
    with pytest.raises(InputError) as refused:
        load(file, other)
    faults = refused.value.faults
    assert len(faults) == 5
    for word in ("rig", "6 7 kg", "4000", "latency of 1 samples, the case's rig has 2", "kept"):
        assert sum(word in fault for fault in faults) >= 1, word


@pytest.mark.parametrize(
    "settings",
    [
        ("table.name=my_table",),
        ("table.limits.stroke_m=0.05", "limits.force_n=200"),
        ("table.after_identification.specimen_stiffness_factor=0.9",),
        ("scaling=0.1", "damping=high", "record=hachinohe", "seed=7"),
        ("identification.seed=3", "identification.duration_s=60"),
    ],
)
def test_what_does_not_make_another_rig_or_specimen_is_let_pass(file: Path, settings: tuple[str, ...]) -> None:
    assert load(file, setup_of(*settings)).found.accepted


def test_damaged_and_other_files_are_refused(file: Path, default_setup: Setup, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for position in (100, 513, len(whole) // 2, len(whole) - 1):
        damaged = bytearray(whole)
        damaged[position] ^= 0x10
        (tmp_path / "d.h5").write_bytes(damaged)
        with pytest.raises(InputError, match=r"d\.h5: .*(damaged|not a model file)"):
            load(tmp_path / "d.h5", default_setup)
    for content in (whole[:-1], whole[:700], whole[:10], b"", b"poles: [1]\n"):
        (tmp_path / "d.h5").write_bytes(content)
        with pytest.raises(InputError, match=r"d\.h5: "):
            load(tmp_path / "d.h5", default_setup)


def test_a_whole_file_that_lacks_a_part_is_refused(
    tmp_path: Path, default_setup: Setup, default_identification: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups = model_files.to_groups(default_identification, model_files.channel_names(default_setup))
    for lacking in ("table/best", "verdict", "frf/floor_3", "fit_error/paper"):
        fewer = {name: group for name, group in groups.items() if name != lacking}
        monkeypatch.setattr(model_files, "to_groups", lambda *_, fewer=fewer: fewer)
        save(tmp_path / "l.h5", default_setup, default_identification, "", "")
        with pytest.raises(InputError, match="lacks a part"):
            load(tmp_path / "l.h5", default_setup)


@pytest.mark.parametrize("made", ["x", "", 7])
def test_a_file_that_does_not_say_when_it_was_made_is_refused(
    file: Path, default_setup: Setup, monkeypatch: pytest.MonkeyPatch, made: str | int
) -> None:
    stored = read_model(file)
    changed = replace(stored, attributes=stored.attributes | {"created_utc": made})
    monkeypatch.setattr(model_files, "read_model", lambda _: changed)
    with pytest.raises(InputError, match="does not match format"):
        load(file, default_setup)


@pytest.mark.parametrize(
    ("made", "text"),
    [
        ("2030-01-02T03:04:05Z", "2030-01-02 03:04 UTC, 0 minutes ago"),
        ("2030-01-02T03:03:00Z", "2030-01-02 03:03 UTC, 1 minute ago"),
        ("2030-01-02T01:05:00Z", "2030-01-02 01:05 UTC, 119 minutes ago"),
        ("2030-01-01T03:04:05Z", "2030-01-01 03:04 UTC, 24 hours ago"),
        ("2029-12-26T03:04:05Z", "2029-12-26 03:04 UTC, 7 days ago"),
        ("2030-01-03T00:00:00Z", "2030-01-03 00:00 UTC, 0 minutes ago"),
    ],
)
def test_the_age_is_said_in_a_unit_that_suits_it(
    file: Path, default_setup: Setup, monkeypatch: pytest.MonkeyPatch, made: str, text: str
) -> None:
    stored = replace(load(file, default_setup), made=datetime.fromisoformat(made))

    class Clock(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Clock:
            return cls(2030, 1, 2, 3, 4, 5, tzinfo=tz)

    monkeypatch.setattr(model_files, "datetime", Clock)
    assert stored.age == text


# The cache. What fills it is the default identification, once.


def no_progress(_: str) -> None:
    """Show nothing."""


@pytest.fixture(scope="module")
def kept(
    tmp_path_factory: pytest.TempPathFactory, default_setup: Setup, default_identification: Identification
) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    Cache(folder=folder).keep(default_setup, default_identification, "0" * 64)
    return folder


@pytest.fixture
def cache_folder(tmp_path: Path, kept: Path) -> Path:
    return shutil.copytree(kept, tmp_path / "kept")


@pytest.fixture
def excited(monkeypatch: pytest.MonkeyPatch, default_identification: Identification) -> list[str]:
    """Return the list of what would have been excited; nothing is."""
    done: list[str] = []

    def measure(setup: Setup, *_: object) -> identify_on_rig.Measured:
        done.append(setup.case.name)
        return identify_on_rig.Measured((), None, "", ())

    monkeypatch.setattr("rths_cli.experiment.identify_on_rig.measure", measure)
    monkeypatch.setattr("rths_cli.experiment.identify_on_rig.evaluated", lambda *_: default_identification)
    return done


def datasets(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}

    def collect(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and "timing" not in name:
            found[name] = np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(collect)
    return found


@pytest.mark.campaign
def test_a_run_with_a_kept_model_excites_nothing_and_equals_a_fresh_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = setup_of("runs=[exp_rths]", "session_record=never")
    played: list[tuple[int, ...]] = []
    excite = identify_on_rig.excite

    def counted(*given: Any, **named: Any) -> Any:
        played.append(named.get("stream") or (1,))
        return excite(*given, **named)

    monkeypatch.setattr(identify_on_rig, "excite", counted)

    def run(name: str, fresh: bool) -> Path:
        path = tmp_path / name / "result.h5"
        path.parent.mkdir()
        memory = Memory(Cache(fresh, tmp_path / "kept"))
        assert run_case(setup, path, memory, "test", no_progress).exit_code == 0
        return path

    first = run("first", fresh=False)
    assert len(played) == 2  # probe and excitation
    second = run("second", fresh=False)
    assert len(played) == 2
    fresh, stored = datasets(first), datasets(second)
    assert len(fresh) > 60
    assert sorted(fresh) == sorted(stored)
    assert [name for name in fresh if fresh[name] != stored[name]] == []
    with h5py.File(first) as one, h5py.File(second) as other:
        assert one.attrs["model_source"] == "identified in this run"
        assert other.attrs["model_source"].startswith("cache, identified ")
        assert one.attrs["model_sha256"] == other.attrs["model_sha256"]
        assert one.attrs["warnings"] == other.attrs["warnings"]


def test_fresh_excites_and_keeps_what_it_found(cache_folder: Path, default_setup: Setup, excited: list[str]) -> None:
    (kept,) = cache_folder.glob("*.h5")
    before = kept.stat().st_ino
    known = Memory(Cache(True, cache_folder)).known(default_setup, no_progress)
    assert excited == [CASE] and known.source == "identified in this run"
    assert kept.stat().st_ino != before and load(kept, default_setup).found.accepted


@pytest.mark.campaign
@pytest.mark.parametrize(
    "setting",
    [
        "identification.seed=1",
        "identification.duration_s=121",
        "identification.estimator=h2",
        "identification.sensor_dynamics=kept",
        "identification.latency=kept",
        "table.physics.coulomb_n=0.31",
        "table.sensors.noise_rms_m_s2=4e-4",
        "table.limits.stroke_m=0.05",
        "structure.experimental.masses_kg=[6.91, 6.96]",
        "structure.experimental.damping_ratios=[0.043, 0.04]",
        "structure.interface_experimental_mass_kg=0.5",
        "structure.heights_m=[0.2, 0.2, 0.3]",
        "sample_rate_hz=4000",
        "test_band_hz=13",
    ],
)
def test_whatever_the_model_depends_on_misses_the_cache(cache_folder: Path, default_setup: Setup, setting: str) -> None:
    assert key(setup_of(setting)) != key(default_setup)  # by which cases of one process share a model too
    assert Cache(folder=cache_folder).find(setup_of(setting)) is None


@pytest.mark.parametrize(
    "setting", ["scaling=0.1", "seed=4", "record=hachinohe", "table.after_identification.coulomb_factor=2"]
)
def test_what_the_model_does_not_depend_on_finds_it(cache_folder: Path, setting: str) -> None:
    assert Cache(folder=cache_folder).find(setup_of(setting)) is not None


def test_other_software_misses_the_cache(
    cache_folder: Path, default_setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Cache(folder=cache_folder).find(default_setup) is not None
    monkeypatch.setattr(model_files, "software", lambda: "another version")
    assert Cache(folder=cache_folder).find(default_setup) is None


def test_a_processor_that_rounds_otherwise_misses_the_cache(
    cache_folder: Path, default_setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BLAS, numpy and the C library choose their instructions by these, and the last bits of a model with them."""
    assert Cache(folder=cache_folder).find(default_setup) is not None
    for name in model_files.ROUNDING:
        with monkeypatch.context() as patch:
            patch.setenv(name, "another")
            assert Cache(folder=cache_folder).find(default_setup) is None
    monkeypatch.setattr(model_files, "processor", lambda: "another one")
    assert Cache(folder=cache_folder).find(default_setup) is None


def test_the_software_is_known_by_its_sources_and_what_it_computes_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "package" / "experiment" / "model_files.py"
    source.parent.mkdir(parents=True)
    source.write_text("a = 1\n")
    monkeypatch.setattr(model_files, "__file__", str(source))
    before = model_files.software.__wrapped__()
    (tmp_path / "package" / "deep.py").write_text("b = 1\n")
    after = model_files.software.__wrapped__()
    assert after != before
    monkeypatch.setattr(model_files, "package_version", lambda name: f"{name} 99")
    assert model_files.software.__wrapped__() != after


def of_another_rig(path: Path, found: Identification) -> None:
    save(path, setup_of("table.physics.coulomb_n=0.9"), found, "", "")


@parametrize_first(
    1,
    "spoil",
    [
        lambda path, _: path.write_bytes(path.read_bytes()[:-100]),
        lambda path, _: path.write_bytes(b""),
        lambda path, _: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(1000)),
        of_another_rig,
    ],
)
def test_a_spoilt_file_in_the_cache_is_replaced(
    cache_folder: Path,
    default_identification: Identification,
    excited: list[str],
    spoil: Callable[[Path, Identification], object],
) -> None:
    (kept,) = cache_folder.glob("*.h5")
    spoil(kept, default_identification)
    setup = setup_of("session_record=never")
    known = Memory(Cache(folder=cache_folder)).known(setup, no_progress)
    assert excited == [CASE] and known.found is default_identification
    again = Memory(Cache(folder=cache_folder)).known(setup, no_progress)
    assert excited == [CASE] and again.source.startswith("cache")


@pytest.mark.campaign
def test_a_cache_that_cannot_be_written_does_no_harm(tmp_path: Path, default_setup: Setup, excited: list[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "kept").mkdir()
    folder_as_file = tmp_path / "kept" / Cache(folder=tmp_path / "kept").path(default_setup).name
    folder_as_file.mkdir()
    for folder in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none"), tmp_path / "kept"):
        known: IdentifiedModel = Memory(Cache(folder=folder)).known(default_setup, no_progress)
        assert known.source == "identified in this run"
    assert len(excited) == 4
    assert (tmp_path / "file").read_text() == "in the way"


def test_the_cache_keeps_a_limited_number_and_drops_the_longest_unused(
    cache_folder: Path, default_setup: Setup, default_identification: Identification
) -> None:
    (used,) = cache_folder.glob("*.h5")
    os.utime(used, (1, 1))
    for number in range(KEPT + 3):
        path = cache_folder / f"{number}.h5"
        path.write_bytes(b"")
        os.utime(path, (1000 + number, 1000 + number))
    assert Cache(folder=cache_folder).find(default_setup) is not None  # use makes it young
    other = setup_of("identification.seed=1")
    Cache(folder=cache_folder).keep(other, default_identification, "")
    left = {path.name for path in cache_folder.iterdir()}
    assert len(left) == KEPT
    assert used.name in left and f"{KEPT + 2}.h5" in left
    assert {f"{number}.h5" for number in range(5)} & left == set()
    assert Cache(folder=cache_folder).find(other) is not None


def keep_and_find(folder: Path, setup: Setup, found: Identification) -> None:
    """Write and read the same entry again and again; leave with 1 if it is ever missing or spoilt."""
    wanted = bits(found)
    cache = Cache(folder=folder)
    for _ in range(5):
        cache.keep(setup, found, "")
        stored = cache.find(setup)
        if stored is None or bits(stored.found) != wanted:
            os._exit(1)


@pytest.mark.campaign
def test_two_processes_at_once_do_no_harm(
    tmp_path: Path, default_setup: Setup, default_identification: Identification
) -> None:
    context = get_context("fork")
    given = (tmp_path, default_setup, default_identification)
    processes = [context.Process(target=keep_and_find, args=given) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(30)
    assert [process.exitcode for process in processes] == [0, 0]
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.campaign
def test_changed_options_of_a_plug_in_make_another_rig(
    default_identification: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nested ones too: only the plug-in knows which of them act on the table."""
    points = [EntryPoint("slow_table", "rths_slow_table:make", plugin_interface.GROUP)]
    monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points)
    shipped = (Path(__file__).parents[2] / "configs" / "rigs" / "plugin_example.yaml").read_text()

    def with_options(options: str) -> Setup:
        (tmp_path / "lab.yaml").write_text(re.sub(r"options:.*\n  lag_s.*", f"options: {options}", shipped))
        return setup_of(f"table={tmp_path / 'lab.yaml'}")

    before = with_options("{lag_s: 0.02, box: {port: 1}}")
    save(tmp_path / "m.h5", before, default_identification, "measured", "")
    assert load(tmp_path / "m.h5", with_options("{lag_s: 0.02, box: {port: 1}}")).found
    for other in ("{lag_s: 0.03, box: {port: 1}}", "{lag_s: 0.02, box: {port: 2}}", "{lag_s: 0.02}"):
        with pytest.raises(InputError, match="its file or calibration has changed"):
            load(tmp_path / "m.h5", with_options(other))
