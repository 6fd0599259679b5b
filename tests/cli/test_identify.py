"""`rths identify` and `rths run --fresh` as a user meets them: options, what is written, exit codes."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.cli import cli, entry_point
from rths_cli.cli.terminal import Screen
from rths_cli.experiment import identify_command
from rths_cli.experiment import identify_on_rig as workflow
from rths_cli.experiment.identify_on_rig import Measured, UnfitRig
from rths_cli.files.measured_data import read_recording
from rths_cli.files.model_file import read_model
from rths_cli.findings import stated
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.results import Identification

SHORT = ("--set", "identification.duration_s=40", "--set", "session_record=never")


class Shown(NamedTuple):
    code: int
    out: str
    err: str


Rths = Callable[..., Shown]


@pytest.fixture
def rths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Rths:
    """Return the command line, called in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> Shown:
        monkeypatch.setattr("sys.argv", ["rths", *words])
        code = entry_point.run_to_exit_code()
        return Shown(code, *capsys.readouterr())

    return call


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch, default_identification: Identification) -> list[str]:
    """Return the list of what was measured; a made-up record stands for it, whatever comes of it is the default."""
    done: list[str] = []
    samples = np.random.default_rng(1).standard_normal((4, 100))

    def measure(setup: object, progress: Callable[[str], None], *_: object) -> Measured:
        done.append("rig")
        progress("probe")
        return Measured((Record(samples[0], samples[1:], Parts(slice(0, 100))),), None, "made up", (("level", "2"),))

    monkeypatch.setattr(identify_command, "measure", measure)
    monkeypatch.setattr(identify_command, "evaluated", lambda *_: default_identification)
    return done


def tree() -> list[str]:
    """Return every file below the current folder."""
    return sorted(str(path) for path in Path().rglob("*") if path.is_file())


def test_a_whole_identification_of_the_default_rig(rths: Rths) -> None:
    shown = rths("identify", *SHORT)
    assert shown.code == 0
    assert shown.out.endswith(
        f'\nidentification: {{model: "{Path("models/aps400_virtual_three_storey.h5").absolute()}"}}\n'
    )
    assert shown.out.startswith("verdict                 accepted: fit for feedforward")
    assert "Identification of the virtual table aps400_virtual" in shown.out
    assert tree() == ["models/aps400_virtual_three_storey.h5", "models/aps400_virtual_three_storey.png"]
    assert Path("models/aps400_virtual_three_storey.png").read_bytes().startswith(b"\x89PNG")
    stated = read_model(Path("models/aps400_virtual_three_storey.h5")).attributes
    assert stated["rig"] == "aps400_virtual" and stated["seed"] == 0 and len(str(stated["data_sha256"])) == 64
    hashed = read_model(Path("models/aps400_virtual_three_storey.h5")).sha256[:16]
    assert f"SHA-256 {hashed}" in " ".join(shown.out.split())


def test_quiet_prints_the_verdict_with_the_model_and_nothing_else(rths: Rths, measured: list[str]) -> None:
    shown = rths("identify", "--no-figure", "--quiet")
    (line,) = shown.out.splitlines()
    assert line.startswith("accepted: fit for feedforward from ") and shown.err == ""
    assert line.endswith("; models/aps400_virtual_three_storey.h5")


def test_a_change_of_the_case_reaches_the_model_file(rths: Rths, measured: list[str]) -> None:
    assert rths("identify", "hachinohe_low_ff", "--set", "identification.seed=3", "--no-figure").code == 0
    assert tree() == ["models/aps400_virtual_three_storey.h5"]
    stated = read_model(Path(tree()[0])).attributes
    assert stated["seed"] == 3 and '"seed":3' in str(stated["settings"])


def test_json_is_one_document_and_nothing_else(rths: Rths, measured: list[str]) -> None:
    shown = rths("identify", "--json", "--no-figure")
    assert shown.code == 0 and shown.err == ""
    document = json.loads(shown.out)
    assert document["accepted"] is True and document["rig"] == "aps400_virtual"
    assert len(document["best"]["poles"]) == 7
    assert {"label": "level", "text": "2"} in document["about"]


@pytest.mark.campaign
@parametrize_first(1, ("suffix", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF"), ("PNG", b"\x89PNG")])
def test_the_figure_goes_where_it_is_wanted(rths: Rths, measured: list[str], suffix: str, start: bytes) -> None:
    name = f"figures/table.{suffix}"
    assert rths("identify", "--figure", name, "--output", "models/deep/m.h5").code == 0
    assert tree() == [name, "models/deep/m.h5"]
    assert Path(name).read_bytes().startswith(start)


def test_what_was_measured_is_saved_as_it_was(rths: Rths, measured: list[str]) -> None:
    assert rths("identify", "--no-figure", "--save-data", "raw/d.h5", "--output", "m.h5").code == 0
    recording = read_recording(Path("raw/d.h5"))
    assert recording.units == ("V", "m/s^2", "m/s^2", "m/s^2") and recording.dt_s == 0.0005
    assert recording.names == ("command_v", "table_accel_m_s2", "floor_2_accel_m_s2", "floor_3_accel_m_s2")
    assert np.array_equal(recording.samples, np.random.default_rng(1).standard_normal((4, 100)))


def test_a_model_is_judged_instead_of_fitted(
    rths: Rths, measured: list[str], monkeypatch: pytest.MonkeyPatch, default_identification: Identification
) -> None:
    given: list[object] = []
    monkeypatch.setattr(identify_command, "evaluated", lambda *w: given.append(w[2]) or default_identification)
    assert rths("identify", "--no-figure", "--output", "m.h5").code == 0
    Path("given.yaml").write_text(
        "zeros: [0, 0]\npoles: [[-60, 60], [-60, -60], -600]\ngain: 5\ndelay_s: 0.001\nnotes: from the maker\n"
    )
    shown = rths("identify", "--no-figure", "--model", "given.yaml", "--output", "n.h5")
    assert shown.code == 0
    page = " ".join(shown.out.split())
    assert "from the maker" in page and "2 zeros and 3 poles" in page
    assert rths("identify", "--no-figure", "--model", "m.h5", "--output", "n.h5").code == 0
    assert given[0] is None
    assert given[1].gain == 5.0 and given[1].delay_s == 0.001  # type: ignore[attr-defined]
    assert given[2].gain == default_identification.best.gain  # type: ignore[attr-defined]


def test_a_case_that_names_a_model_can_have_it_made(rths: Rths, measured: list[str]) -> None:
    Path("c.yaml").write_text(
        "structure: three_storey\ndamping: low\nrecord: el_centro\nscaling: 0.3\ncontroller: FF\n"
        "identification: {model: mine.h5}\n"
    )
    assert rths("identify", "c.yaml", "--no-figure", "--output", "mine.h5").code == 0
    again = rths("identify", "c.yaml", "--no-figure", "--output", "mine.h5", "--set", "table.physics.coulomb_n=1")
    assert again.code == 0 and "mine.h5 (replaced)" in " ".join(again.out.split())


@pytest.mark.campaign
def test_a_rejected_model_is_written_and_says_so(
    rths: Rths, measured: list[str], monkeypatch: pytest.MonkeyPatch, default_identification: Identification
) -> None:
    verdict = replace(default_identification.verdict, accepted=False, refusals=(stated("too much friction"),))
    rejected = replace(default_identification, verdict=verdict)
    monkeypatch.setattr(identify_command, "evaluated", lambda *_: rejected)
    shown = rths("identify", "--no-figure", "--output", "m.h5")
    assert shown.code == 1
    assert "verdict                 rejected: too much friction" in shown.out
    assert tree() == ["m.h5"]
    run = rths("run", "el_centro_low_ff", "--set", 'identification.model="m.h5"', "--set", "runs=[exp_rths]")
    assert run.code == 1 and "too much friction" in run.out


def test_a_rig_with_a_dead_channel_gives_a_page_but_no_model(
    rths: Rths, measured: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unfit(*_: object) -> None:
        raise UnfitRig("aps400_virtual", UnfitRecord([stated("channel floor_2: dead")]))

    monkeypatch.setattr(identify_command, "evaluated", unfit)
    shown = rths("identify", "--output", "m.h5", "--save-data", "d.h5")
    assert shown.code == 4 and "rejected: channel floor_2: dead" in shown.out
    assert tree() == ["d.h5"]  # asked for, and wanted most now
    document = json.loads(rths("identify", "--output", "m.h5", "--json").out)
    assert document["accepted"] is False and document["reasons"] == ["channel floor_2: dead"]


BEFORE = {"folder/x": "", "file": "in the way", "c.yaml": "notes: mine\n", "d.csv": "1,2\n", "d.h5": "1,2\n"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--figure", "x.gif"), "--figure x.gif: must end in .png, .svg or .pdf"),
        (("--figure", "x"), "--figure x: must end in .png, .svg or .pdf"),
        (("--save-data", "x.csv"), "--save-data x.csv: is written as HDF5; give a name that ends in .h5"),
        (("--figure", "file/x.png"), "file: "),
        (("--output", "folder"), "--output folder: is a folder"),
        (("--save-data", "folder"), "--save-data folder: is a folder"),
        (("--figure", "folder"), "--figure folder: is a folder"),
        (("--output", "file/m.h5"), "file: "),
        (("--output", "/proc/none/m.h5"), "/proc/none: "),
        (("--save-data", "/proc/none/d.h5"), "/proc/none: "),
        (("--output", "c.yaml"), "c.yaml: exists and is no model file"),
        (("--output", "m.h5", "--save-data", "./m.h5"), "--save-data m.h5: is the file of --output too"),
        (("--output", "m.png"), "--figure m.png: is the file of --output too"),
        (("--data", "d.h5", "--save-data", "d.h5"), "--save-data d.h5: is the file of --data too"),
        (("--data", "d.csv", "--output", "folder/../d.csv"), "--output folder/../d.csv: is the file of --data too"),
        (("--model", "nowhere.yaml"), "nowhere.yaml"),
        (("--channel", "table=ai0:g"), "--data FILE"),
        (("--rate", "2000"), "--data FILE"),
        (("--corrected",), "--data FILE"),
        (("--rate", "0", "--data", "d.csv"), "--rate"),
        (("--channel", "table", "--data", "d.csv"), "--channel table: must be ROLE=NAME"),
        (("--set", "identification.duration_s=1"), "identification.duration_s"),
        (("--set", "sample_rate_hz=100"), "high_hz"),
        (("nowhere",), "no case is called 'nowhere'"),
        (("el_centro_low_ff", "--set", "seed=1", "scaling=1"), "a setting follows --set, each one its own"),
        (("el_centro_low_ff", "hachinohe_low_ff"), "hachinohe_low_ff"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_measured(
    rths: Rths, measured: list[str], words: tuple[str, ...], sentence: str
) -> None:
    for name, text in BEFORE.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    shown = rths("identify", *words)
    assert (shown.code, shown.out, measured) == (2, "", [])
    assert sentence in shown.err, shown.err
    assert len(shown.err.strip().splitlines()) == 1
    assert {name: Path(name).read_text() for name in tree()} == BEFORE
    document = json.loads(rths("identify", *words, "--json").out)
    assert document["exit_code"] == 2 and sentence in document["faults"][0]


def test_all_faults_of_the_outputs_are_named_at_once(rths: Rths, measured: list[str]) -> None:
    Path("folder").mkdir()
    shown = rths("identify", "--output", "folder", "--figure", "x.gif", "--save-data", "x.gif")
    assert shown.code == 2 and len(shown.err.splitlines()) == 3


def test_only_model_files_are_replaced_and_damaged_ones_too(rths: Rths, measured: list[str]) -> None:
    assert rths("identify", "--no-figure", "--output", "m.h5").code == 0
    whole = Path("m.h5").read_bytes()
    for content in (whole[:2000], b""):
        Path("m.h5").write_bytes(content)
        shown = rths("identify", "--no-figure", "--output", "m.h5")
        assert shown.code == 0 and "m.h5 (replaced)" in " ".join(shown.out.split())
        assert read_model(Path("m.h5")).groups


@pytest.mark.campaign
@pytest.mark.parametrize("where", ["rths_cli.experiment.identify_command.measure", "os.fsync", "os.link"])
@pytest.mark.parametrize("number", [KeyboardInterrupt, OSError])
def test_what_is_interrupted_leaves_nothing_behind(
    rths: Rths, measured: list[str], monkeypatch: pytest.MonkeyPatch, where: str, number: type[BaseException]
) -> None:
    def end(*_: object, **__: object) -> None:
        raise number(28, "No space left on device")

    monkeypatch.setattr(where, end)
    shown = rths("identify", "--output", "m.h5", "--figure", "m.png")
    assert shown.code == (130 if number is KeyboardInterrupt else 2)
    assert tree() == [] and shown.out == ""
    said = [line for line in shown.err.splitlines() if line and "probe" not in line]
    assert "Traceback" not in shown.err and len(said) == 1


def test_help_lists_every_option_with_its_purpose(rths: Rths) -> None:
    shown = rths("identify", "--help")
    words = " ".join(shown.out.split())
    options = [
        option
        for option in cli.commands["identify"].params
        if hasattr(option, "help") and option.opts[0].startswith("--")
    ]
    assert len(options) == 15
    for option in options:
        assert option.opts[0] in words and option.help in words, option.name  # type: ignore[attr-defined]
    assert "--fresh" in rths("run", "--help").out


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_status_line_is_cleared_without_a_line_of_its_own() -> None:
    terminal, plain = Terminal(), io.StringIO()
    for stream in (terminal, plain):
        screen = Screen(stream=stream)
        screen.doing("probe of 20 s")
        screen.clear()
    assert terminal.getvalue().endswith("probe of 20 s\r\x1b[K") and "\n" not in terminal.getvalue()
    assert plain.getvalue() == ""


@pytest.mark.campaign
def test_a_kept_model_spares_the_excitation_and_fresh_asks_for_it(
    rths: Rths, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from rths_cli.numerics.compiled import cache_folder

    cache_folder()  # compiled code stays where it is; models go to an empty folder
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    played: list[int] = []
    excite = workflow.excite

    def counted(setup: object, command_v: np.ndarray, **how: object) -> object:
        played.append(command_v.size)
        return excite(setup, command_v, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(workflow, "excite", counted)
    words = ("run", "el_centro_low_ff", "--set", "runs=[exp_rths]", *SHORT, "--quiet")
    outputs = []
    for expected, more in ((2, ()), (2, ()), (4, ("--fresh",))):
        shown = rths(*words, *more)
        assert shown.code == 0, shown.err
        outputs.append(shown.out)
        assert len(played) == expected
    assert outputs[0] == outputs[1] == outputs[2]
    assert len(list((tmp_path / "cache" / "rths" / "models").glob("*.h5"))) == 1


def test_a_run_with_a_model_of_another_rig_and_specimen_names_every_difference(rths: Rths, measured: list[str]) -> None:
    assert rths("identify", "--no-figure", "--output", "m.h5").code == 0
    other = ("table.physics.coulomb_n=1", "structure.experimental.masses_kg=[6, 7]", "sample_rate_hz=1000")
    settings = [word for setting in ('identification.model="m.h5"', *other) for word in ("--set", setting)]
    shown = rths("run", "el_centro_low_ff", *settings)
    assert shown.code == 2 and shown.out == ""
    first, *others = shown.err.splitlines()
    assert first == "starting" and len(others) == 3 and all(line.startswith("m.h5: ") for line in others)
    assert tree() == ["m.h5"]
    Path("m.h5").write_bytes(Path("m.h5").read_bytes()[: os.path.getsize("m.h5") // 2])
    damaged = rths("run", "el_centro_low_ff", "--set", 'identification.model="m.h5"')
    assert damaged.code == 2 and "m.h5: is truncated" in damaged.err


def test_a_refusal_leaves_no_folder_behind(rths: Rths) -> None:
    shown = rths("identify", "--set", "table=udp_loopback", "--set", "sample_rate_hz=1000", "--output", "a/b/m.h5")
    assert shown.code == 2 and "nobody can be asked here" in shown.err
    assert not Path("a").exists()
