"""Identification from files (--data): the same model as from the rig, every fault of the data named on the page."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
import scipy.fft
import scipy.io
import scipy.signal
from nptdms import ChannelObject, TdmsWriter
from portfolio import parametrize_first

from rths_cli.case.load import load_cases
from rths_cli.cli import entry_point
from rths_cli.errors import InputError
from rths_cli.experiment.identify_command import Asked, DataRequest, make_model, read_measured, read_roles
from rths_cli.experiment.model_files import load
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.measured_data import Recording, read_recording, write_recording
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array

CASE = "el_centro_low_ff_fb"
SHORT = "identification.duration_s=40"
G = 9.80665
NAMES = ("command", "table", "floor_2", "floor_3")
EXCITED = slice(6000, 80000)  # samples surely inside the 40 s of excitation, which begin at 2 s
Change = Callable[[Array], Array]


class Shown(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, object]:
        found: dict[str, object] = json.loads(self.out)
        return found


Identify = Callable[..., Shown]


def no_progress(_: str) -> None:
    """Show nothing."""


@pytest.fixture(scope="module")
def setup() -> Setup:
    return make_setup(load_cases([CASE], (SHORT,))[0])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Identification, Recording]:
    """Return what the rig itself gave, and the record it was made from, as saved by --save-data."""
    folder = tmp_path_factory.mktemp("rig")
    asked = Asked(CASE, (SHORT,), output=folder / "m.h5", save_data=folder / "d.h5", draw=False)
    done = make_model(asked, no_progress)
    assert done.found is not None and done.found.accepted, done.found
    return done.found, read_recording(folder / "d.h5")


@pytest.fixture
def identify(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Identify:
    """Return the command, called in an empty folder; it leaves no figure."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> Shown:
        argv = ["rths", "identify", "--set", SHORT, "--no-figure", "--output", "m.h5", *words]
        monkeypatch.setattr("sys.argv", argv)
        code = entry_point.run_to_exit_code()
        return Shown(code, *capsys.readouterr())

    return call


def one_line(text: str) -> str:
    """Return a page without its line breaks."""
    return " ".join(text.split())


def written(made: tuple[Identification, Recording], path: Path, change: Change) -> None:
    """Write the rig's record, changed, in the project's own form."""
    recording = made[1]
    write_recording(path, replace(recording, samples=change(recording.samples.copy())))


def model(setup: Setup, path: Path = Path("m.h5")) -> Identification:
    return load(path, setup).found


def worst(found: Identification, wanted: Identification) -> float:
    """Return the largest relative difference of two models, at 300 frequencies, and of two specimens."""
    f = np.linspace(0.5, 60.0, 300)
    best = wanted.best.sampled_response(f)
    assert found.specimen is not None and wanted.specimen is not None
    pairs = (
        (found.best.sampled_response(f), best),
        (found.specimen.natural_frequency_hz, wanted.specimen.natural_frequency_hz),
        (found.specimen.damping_ratio, wanted.specimen.damping_ratio),
        (found.specimen.specimen.K, wanted.specimen.specimen.K),
    )
    return max(float(np.max(np.abs(one - other)) / np.max(np.abs(other))) for one, other in pairs)


def test_a_saved_record_gives_the_model_of_the_rig(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup
) -> None:
    written(made, Path("d.h5"), lambda x: x)
    shown = identify("--data", "d.h5", "--corrected")
    assert shown.code == 0, shown
    found = model(setup)
    assert worst(found, made[0]) < 1e-9
    assert len(found.best.poles) == len(made[0].best.poles)
    page = one_line(shown.out)
    assert "2.0 s of silence" in page and "taken as removed" in page and "d.h5 (SHA-256" in page
    assert page.count("warning") == 1 and "friction: not judged" in page and shown.err == ""
    assert sorted(path.name for path in Path().iterdir()) == ["d.h5", "m.h5"]


def later(values: Array, samples: float) -> Array:
    """Return a series (n,) that begins and ends at rest as it is sampled later, by the phases of its transform."""
    return np.asarray(
        scipy.fft.irfft(scipy.fft.rfft(values) * np.exp(2j * np.pi * scipy.fft.rfftfreq(values.size) * samples),
                        values.size)
    )  # fmt: skip


@pytest.mark.campaign
@parametrize_first(1, "samples", [0.2, 3.0, 50.0])
def test_channels_that_state_later_starts_give_the_same_delay(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup, samples: float
) -> None:
    recording = made[1]
    start = {"wf_increment": recording.dt_s, "wf_start_time": np.datetime64("2026-02-03T10:00:00")}
    objects = [
        ChannelObject("daq", name, later(values, late), properties={
            **start, "unit_string": "V" if name == "command" else "m/s^2", "wf_start_offset": late * recording.dt_s,
        })
        for name, values in zip(NAMES, recording.samples, strict=True)
        for late in [0.0 if name == "command" else samples]
    ]  # fmt: skip
    with TdmsWriter("d.tdms") as writer:
        writer.write_segment(objects)
    shown = identify("--data", "d.tdms", "--corrected")
    assert shown.code == 0, shown
    assert "start at different times" in one_line(shown.out)
    assert model(setup).best.delay_s == pytest.approx(made[0].best.delay_s, abs=2e-5)
    assert worst(model(setup), made[0]) < 2e-3


def as_csv(recording: Recording) -> list[str]:
    samples = recording.samples / np.array([[1.0], [G], [G], [G]])
    time = np.arange(samples.shape[1]) * recording.dt_s
    header = "Time (s),Drive (V),Table accel (g),Floor 2 accel (g),Floor 3 accel (g),Spare (V)"
    table = np.vstack([time, samples, 0.0 * time]).T
    np.savetxt("d.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    return ["--data", "d.csv"]


def as_mat(recording: Recording) -> list[str]:
    names = ("command_v", "table_g", "floor_2_g", "floor_3_g")
    samples = recording.samples / np.array([[1.0], [G], [G], [G]])
    scipy.io.savemat("d.mat", {"Fs": 1.0 / recording.dt_s, **dict(zip(names, samples, strict=True))})
    return ["--data", "d.mat"]


def as_hdf5(recording: Recording) -> list[str]:
    with h5py.File("d.hdf5", "w") as file:
        for name, series, unit in zip(("ao0", "ai0", "ai1", "ai2"), recording.samples, ("V", "", "", ""), strict=True):
            file[name] = series * (1.0 if unit else 1e3)
            if unit:
                file[name].attrs["units"] = unit
    roles = ("command=ao0", "table=ai0:mm/s^2", "floor_2=ai1:mm/s^2", "floor_3=ai2:mm/s^2")
    return ["--data", "d.hdf5", "--rate", "2000", *(word for role in roles for word in ("--channel", role))]


@pytest.mark.campaign
@parametrize_first(1, "writer", [as_csv, as_mat, as_hdf5])
def test_other_forms_and_units_give_the_model_of_the_rig(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup, writer: Callable[[Recording], list[str]]
) -> None:
    shown = identify(*writer(made[1]), "--corrected")
    assert shown.code == 0, shown
    assert worst(model(setup), made[0]) < 1e-6


@pytest.mark.campaign
def test_voltages_of_sensors_are_corrected_for_their_dynamics(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup
) -> None:
    recording, rate = made[1], 2000.0
    high, low = 2 * np.pi * 0.024, 2 * np.pi * 1549.0
    f = np.fft.rfftfreq(2 * recording.samples.shape[1], 1.0 / rate)  # as long again, for what rings on
    sensor = 2j * np.pi * f / (2j * np.pi * f + high) * low / (2j * np.pi * f + low)
    n = recording.samples.shape[1]
    volts = np.fft.irfft(np.fft.rfft(recording.samples[1:], 2 * n) * sensor)[:, :n] / G
    samples = np.vstack([recording.samples[:1], volts])
    write_recording(Path("v.h5"), replace(recording, samples=samples, units=("V",) * 4, notes=()))
    assert identify("--data", "v.h5").code == 0
    f = np.linspace(0.7, 11.0, 100)
    wanted = made[0].best.sampled_response(f)
    assert np.abs(model(setup).best.sampled_response(f) / wanted - 1.0).max() < 5e-4
    assert identify("--data", "v.h5", "--corrected", "--output", "raw.h5").code in (0, 1)
    raw = model(setup, Path("raw.h5")).best.sampled_response(f)
    assert np.abs(raw / wanted - 1.0).max() > 5e-3  # 11 Hz through a corner at 1549 Hz


@pytest.mark.campaign
def test_two_files_are_averaged(identify: Identify, made: tuple[Identification, Recording], setup: Setup) -> None:
    random = np.random.default_rng(5)
    for name in ("one.h5", "two.h5"):
        written(made, Path(name), lambda x: x + np.r_[0.0, [0.02] * 3][:, None] * random.standard_normal(x.shape))
    scatter = {}
    for files in (("one.h5",), ("one.h5", "two.h5")):
        shown = identify(*(word for name in files for word in ("--data", name)), "--corrected")
        assert shown.code == 0, shown
        assert shown.out.count("40.0 s of excitation") == len(files)
        frf = model(setup).frfs[1]
        inside = (frf.frequency_hz > 2.0) & (frf.frequency_hz < 11.0)
        scatter[len(files)] = float(np.median(frf.relative_error[inside]))
    assert scatter[2] / scatter[1] == pytest.approx(np.sqrt(0.5), rel=0.15)


# Faults. Each is named with its channel, exit code 1, verdict rejected, and no model file.


def lost(x: Array) -> Array:
    x[:, np.random.default_rng(2).random(x.shape[1]) < 0.05] = np.nan
    return x


def dead(x: Array) -> Array:
    x[2] = 1e-3 * np.random.default_rng(3).standard_normal(x.shape[1])
    return x


def swapped(x: Array) -> Array:
    return x[[0, 1, 3, 2]]


def table_swapped(x: Array) -> Array:
    return x[[0, 2, 1, 3]]


def reversed_floor(x: Array) -> Array:
    x[3] *= -1.0
    return x


def reversed_command(x: Array) -> Array:
    x[0] *= -1.0
    return x


def clipped(x: Array) -> Array:
    x[1] = np.clip(x[1], -0.7 * x[1].max(), 0.7 * x[1].max())
    return x


def incoherent(x: Array) -> Array:
    """Return samples with noise in floor 2 that makes its coherence 1 / (1 + 2 / 3) = 0.6 at every frequency."""
    random = np.random.default_rng(4)
    spectrum = np.fft.rfft(x[2, EXCITED])
    turned = spectrum * np.exp(2j * np.pi * random.random(spectrum.size))
    x[2, EXCITED] += np.sqrt(2.0 / 3.0) * np.fft.irfft(turned, EXCITED.stop - EXCITED.start)
    return x


@parametrize_first(
    1,
    ("change", "words"),
    [
        (lost, ("5 % of the record", "floor_3: ", "samples are missing")),
        (dead, ("channel floor_2: dead",)),
        (swapped, ("channels floor_2 and floor_3: they look swapped",)),
        (table_swapped, ("channels table and floor_2: they look swapped",)),
        (reversed_floor, ("channel floor_3: wrong sign",)),
        (reversed_command, ("command: every channel moves against it",)),
        (clipped, ("channel table: clipped",)),
        (incoherent, ("channel floor_2: median coherence 0.6",)),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_fault_of_the_data_is_named_and_gives_no_model(
    identify: Identify, made: tuple[Identification, Recording], change: Change, words: tuple[str, ...]
) -> None:
    written(made, Path("d.h5"), change)
    shown = identify("--data", "d.h5", "--corrected")
    assert shown.code == 1
    page = one_line(shown.out)
    assert "rejected: " in page and "accepted" not in page
    assert [word for word in words if word not in page] == []
    others = {"channel table", "channel floor_2", "channel floor_3"} - {word.partition(":")[0] for word in words}
    assert [name for name in others if f"{name}: " in page] == []
    assert [path.name for path in Path().iterdir()] == ["d.h5"]
    document = identify("--data", "d.h5", "--corrected", "--json").document
    assert document["accepted"] is False
    assert all(word in " ".join(map(str, document["reasons"])) for word in words)  # type: ignore[call-overload]


@pytest.mark.campaign
def test_hum_is_named_and_harms_no_model(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup
) -> None:
    def humming(x: Array) -> Array:
        x[1] += 0.05 * np.sin(2 * np.pi * 50.0 * 5e-4 * np.arange(x.shape[1]))
        return x

    written(made, Path("d.h5"), humming)
    shown = identify("--data", "d.h5", "--corrected")
    assert shown.code == 0
    assert "channel table: 50 Hz hum of 0.05 m/s^2 amplitude" in one_line(shown.out)
    f = np.linspace(0.7, 11.0, 100)
    error = model(setup).best.sampled_response(f) / made[0].best.sampled_response(f) - 1.0
    assert np.abs(error).max() < 2e-3


@pytest.mark.campaign
def test_isolated_missing_samples_are_bridged_with_a_note(
    identify: Identify, made: tuple[Identification, Recording], setup: Setup
) -> None:
    def holed(x: Array) -> Array:
        x[1, [5000, 60000]] = np.nan
        x[3, 30000:30003] = np.nan
        return x

    written(made, Path("d.h5"), holed)
    shown = identify("--data", "d.h5", "--corrected")
    assert shown.code == 0
    page = one_line(shown.out)
    assert "d.h5: table: 2 missing samples bridged" in page and "d.h5: floor_3: 3 missing samples bridged" in page
    assert 0.0 < worst(model(setup), made[0]) < 1e-3


# Files that cannot be used at all: exit code 2, one sentence per fault, nothing written.


def csv(*names: str, rate: float = 2000.0) -> Path:
    """Write a few samples under a header, and return the file."""
    rows = np.column_stack([np.arange(50) / rate, *[np.ones(50)] * len(names)])
    np.savetxt("w.csv", rows, delimiter=",", header=",".join(("time (s)", *names)), comments="", fmt="%.9g")
    return Path("w.csv")


GOOD = ("command (V)", "table (g)", "floor_2 (g)", "floor_3 (g)")


@pytest.mark.parametrize(
    ("names", "rate", "words", "sentences"),
    [
        (GOOD, 1000.0, ("sampled at 1000 Hz, the case runs at 2000 Hz", "--set sample_rate_hz=1000"), 1),
        (GOOD[:3], 2000.0, ("floor_3: no channel has such a name", "--channel floor_3=NAME"), 1),
        (("command (V)", "acc 1 (g)"), 2000.0, ("table: no channel", "floor_2: no channel", "floor_3: no"), 3),
        ((GOOD[0], "table (furlong)", *GOOD[2:]), 2000.0, ("table: channel 'table (furlong)'", "--channel"), 1),
        ((GOOD[0], "table", *GOOD[2:]), 2000.0, ("table: channel 'table': its unit is missing",), 1),
        (("command (g)", *GOOD[1:]), 2000.0, ("a command is in V or mV",), 1),
        (GOOD, 2000.0, ("command does not move for 10 s",), 1),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(
    identify: Identify, names: tuple[str, ...], rate: float, words: tuple[str, ...], sentences: int
) -> None:
    csv(*names, rate=rate)
    shown = identify("--data", "w.csv")
    assert shown.code == 2 and shown.out == ""
    assert [word for word in words if word not in shown.err] == []
    assert len(shown.err.splitlines()) == sentences
    assert [path.name for path in Path().iterdir()] == ["w.csv"]


def test_every_file_is_looked_at_before_any_is_refused(identify: Identify) -> None:
    csv(*GOOD, rate=1000.0)
    shown = identify("--data", "w.csv", "--data", "nowhere.csv", "--data", ".", "--json")
    assert shown.code == 2
    assert [fault.partition(":")[0] for fault in shown.document["faults"]] == ["nowhere.csv", ".", "w.csv"]  # type: ignore[attr-defined]


@pytest.mark.parametrize("rate", ["0", "-2000", "fast"])
def test_a_rate_that_is_none_is_bad_usage(identify: Identify, rate: str) -> None:
    csv(*GOOD)
    shown = identify("--data", "w.csv", "--rate", rate)
    assert shown.code == 2 and "--rate" in shown.err


def test_a_rate_that_contradicts_the_file_is_named(identify: Identify) -> None:
    csv(*GOOD)
    shown = identify("--data", "w.csv", "--rate", "1000")
    assert shown.code == 2 and "time column says 2000 Hz" in shown.err and "--rate says 1000 Hz" in shown.err


def test_roles_are_read_with_name_and_unit() -> None:
    roles = read_roles(["table=ai0:g", "command = AO 0 ", "floor_2=a:b:mV"])
    assert roles == {"table": ("ai0", "g"), "command": ("AO 0", ""), "floor_2": ("a:b", "mV")}


def test_every_fault_of_the_roles_is_named() -> None:
    with pytest.raises(InputError) as refused:
        read_roles(["table", "=x", "floor_2=", "command=a", "command=b"])
    assert len(refused.value.faults) == 4
    assert "command was named before" in refused.value.faults[3]


def test_an_offset_is_taken_out_by_the_silence(
    tmp_path: Path, made: tuple[Identification, Recording], setup: Setup
) -> None:
    def offset(x: Array) -> Array:
        x[1:] += np.array([[0.3], [-0.2], [0.1]])
        return x

    written(made, tmp_path / "0.h5", lambda x: x)
    written(made, tmp_path / "1.h5", offset)
    read = [
        read_measured(DataRequest((tmp_path / f"{k}.h5",), {}, None, True), setup).records[0].accel_m_s2 for k in (0, 1)
    ]
    assert np.abs(read[1] - read[0]).max() < 1e-9
