"""What `rths new` writes: each file is valid as it is, and a wrong name is refused with what to type."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.case.load import load_cases
from rths_cli.case.template import new_files
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram

CASE = "el_centro_low_ff_fb"


@pytest.mark.parametrize(
    ("kind", "name", "like", "settings"),
    [
        ("case", "own.yaml", None, ()),
        ("case", "own.yaml", "hachinohe_low_ff", ()),
        ("rig", "own.yaml", None, ("table=own.yaml",)),
        ("rig", "own.yaml", "udp_example", ("table=own.yaml", "sample_rate_hz=1000")),
        ("structure", "own.yaml", None, ("structure=own.yaml", "damping=design")),
        ("structure", "own.yaml", "base_isolated", ("structure=own.yaml",)),
        ("record", "own.csv", None, ("record=own.csv",)),
    ],
)
def test_a_new_file_is_valid_as_it_is(
    kind: str, name: str, like: str | None, settings: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ((path, text),) = new_files(kind, Path(name), like).items()
    path.write_text(text)
    case = load_cases([name if kind == "case" else CASE], settings)[0]
    assert case.scaling > 0.0 and "yaml-language-server" not in text and len(text.splitlines()) > 4


def test_a_new_record_is_the_pulse_that_it_says(tmp_path: Path) -> None:
    ((_, text),) = new_files("record", Path("r.csv")).items()
    (tmp_path / "r.csv").write_text(text)
    record = read_accelerogram(tmp_path / "r.csv")
    assert record.dt_s == 0.01 and len(record.accel_m_s2) == 201
    assert abs(record.accel_m_s2[0]) < 1e-6 and 0.9 < abs(record.accel_m_s2).max() < 1.0


@pytest.mark.parametrize(
    ("kind", "name", "like", "said"),
    [
        ("rig", "own", None, "a rig is a .yaml file; name it own.yaml"),
        ("record", "r.yaml", None, "a record is a .csv file; name it r.csv"),
        ("structure", "s.yaml", "nope", "no structure of this name is shipped; known: actuator_frame"),
        ("record", "r.csv", "el_centro", "is for a case, a rig or a structure"),
    ],
)
def test_what_cannot_be_written_is_told_with_what_to_type(kind: str, name: str, like: str | None, said: str) -> None:
    with pytest.raises(InputError) as refused:
        new_files(kind, Path(name), like)
    assert said in refused.value.faults[0]
