"""Whatever stands in a file, only InputError comes out, each fault one line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.shipped_files import shipped
from rths_cli.errors import InputError

INLINE = """\
structure:
  extends: three_storey
  numerical: {masses_kg: [6.9, 7.1], stiffness_n_per_m: [7000, 7100.5]}
  damping_levels: {mid: {dashpots_n_s_per_m: [20, 21]}}
damping: mid
record: {file: el_centro, unit: g, dt_s: 0.01}
scaling: 3e-1
controller: {kind: FF, max_sensitivity: 1.4}
table: {extends: aps400_virtual, physics: {coulomb_n: 0.9}, converters: {bits: 0}}
runs: [sim, exp-rths]
limits: {stroke_m: 0.05}
accept:
  exp_rths.rms_error_m_s2[3]: 0.06
identification: {seed: 3, high_hz: 50}
"""
REAL = """\
structure: three_storey
damping: low
record: el_centro
scaling: 3e-1
controller: FF+FB
table:
  extends: udp_example
  limits: {energy_ratio: 0.05, lost_samples: 3}
"""
SEEDS = [INLINE, REAL, (shipped("cases") / "el_centro_low_ff_fb.yaml").read_text(encoding="utf-8")]
PIECES = [
    *("~", "[]", "{}", "-1", "1e9", ".nan", "true", "yes", "*a", "&a ", "!!x ", "extends: x", "\n", "  ", ": ", "\x00"),
    *("{a: {b: [1]}}", "/", "..", "'", '"', "#", "é", "[[1], 2]", "9" * 20, "? ", "- ", "--- ", "%Y", "|"),
]
KEYS = [
    "table.physics",
    "table.channels",
    "table.kind",
    "table.udp.key_file",
    "table.model",
    "structure.experimental.masses_kg",
    "accept",
    "runs",
    "damping",
    "record",
    "table.extends",
]
WORDS = sorted({word for seed in SEEDS for word in seed.replace(":", " ").replace(",", " ").split()})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Enter one folder with a record for all examples."""
    place = tmp_path_factory.mktemp("fuzz")
    (place / "el_centro.csv").write_text("0\n")
    before = Path.cwd()
    os.chdir(place)
    yield place
    os.chdir(before)


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """Return a valid case with one to three stretches of it replaced."""
    text = draw(st.sampled_from(SEEDS))
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.sampled_from([0, 1, 3, 10, 40])))
        text = text[:start] + draw(st.sampled_from(PIECES) | st.sampled_from(WORDS)) + text[end:]
    return text


def check(data: bytes, settings_given: tuple[str, ...] = ()) -> None:
    """Load a file of these bytes: a case that survives its resolved form, or sentences."""
    Path("a.yaml").write_bytes(data)
    try:
        (case,) = load_cases(["a.yaml"], settings_given)
    except InputError as error:
        assert error.faults and all(fault and fault.isprintable() for fault in error.faults)
        return
    Path("b.yaml").write_text(resolved_yaml(case), encoding="utf-8")
    (again,) = load_cases(["b.yaml"])
    hidden = {"path", "yaml_text"}
    assert again.model_dump(exclude=hidden) == case.model_dump(exclude=hidden)


def test_the_seeds_are_cases(folder: Path) -> None:
    for seed in SEEDS:
        Path("a.yaml").write_text(seed)
        assert len(load_cases(["a.yaml"])) == 1


@settings(max_examples=100, deadline=None, derandomize=True)
@given(text=mutated())
def test_mutated_cases(folder: Path, text: str) -> None:
    check(text.encode("utf-8", "surrogatepass"))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_random_bytes(folder: Path, data: bytes) -> None:
    check(data)


@pytest.mark.campaign
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    key=st.sampled_from(KEYS) | st.text(max_size=20),
    value=st.sampled_from(PIECES) | st.text(max_size=20),
)
def test_random_settings(folder: Path, key: str, value: str) -> None:
    check(INLINE.encode(), (f"{key}={value}",))
