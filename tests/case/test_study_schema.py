"""Study files: every fault at once with its place, and the JSON Schema accepts what the model does."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from schema_validators import validator

from rths_cli.case.load import load_cases, load_study
from rths_cli.errors import InputError

WHOLE = """\
name: all_kinds
case: {structure: three_storey, damping: low, record: el_centro, scaling: 0.3, controller: FF+FB}
axes:
  controller: [FF, {kind: FF+FB, max_sensitivity: 1.2}]
  scaling: {values: [0.2, 0.3]}
  delay_s: {start: 0.001, stop: 0.1, count: 3, spacing: log}
  record: {folder: suite}
  a: {distribution: normal, mean: 1, std: 2}
  b: {distribution: lognormal, median: 1.0, cov: 0.3}
  c: {distribution: uniform, low: -1, high: 2}
  d: {distribution: truncated_normal, mean: 1, std: 0.1, low: 0.8, high: 1.2}
  e: {distribution: empirical, values: [1, 2, x]}
  f: {distribution: empirical, file: measured.csv, column: k}
samples: {method: sobol, count: 64, seed: 7}
correlations: [{between: [a, b], rank: 0.5}, {between: [b, c], normal: -0.2}]
constraints: [{left: a, op: "<", right: b, times: 2}, {left: scaling, op: ">=", right: 0.1}]
seeds: {first: 3, last: 5}
metrics: [exp_rths.rms_error_m_s2]
notes: all
"""
WRONG = [
    ("axes: {x: 5}", "axes.x: must be a list of values, a range"),
    ("axes: {x: {}}", "axes.x: must be a list of values, a range"),
    ("axes: {x: []}", "axes.x: is empty"),
    ("axes: {x: [1, null]}", "axes.x[2]: is missing"),
    ("axes: {x: [1, 2, 1]}", "axes.x[3]: 1 is given twice"),
    ("axes: {x: {start: 1, stop: 1, count: 3}}", "axes.x.stop: must differ from start = 1"),
    ("axes: {x: {start: 0, stop: 1, count: 3, spacing: log}}", "axes.x.start: must be > 0 with spacing log, got 0"),
    ("axes: {x: {start: 0, stop: 1, count: 1}}", "axes.x.count: must be >= 2"),
    ("axes: {x: {folder: ./a}}", "axes.x: a folder gives the values of record alone"),
    ("axes: {x: {distribution: norml}}", "axes.x: no distribution is called 'norml'; did you mean normal"),
    ("axes: {x: {distribution: [1]}}", "axes.x: no distribution is called"),
    ("axes: {x: {distribution: normal, mean: 1, std: 0}}\nsamples: {count: 2}", "axes.x.std: must be > 0"),
    ("axes: {x: {distribution: normal, mean: 1, std: 1}}", "axes.x: an axis has a distribution; add samples"),
    (
        "axes: {x: {distribution: uniform, low: 2, high: 1}}\nsamples: {count: 2}",
        "axes.x.high: must be > low = 2, got 1",
    ),
    (
        "axes: {x: {distribution: empirical, values: [1], file: a.csv, column: b}}\nsamples: {count: 2}",
        "axes.x.file: give values or file, not both",
    ),
    ("axes: {x: {distribution: empirical, file: a.csv}}\nsamples: {count: 2}", "axes.x.file: a file needs a column"),
    ("axes: {x: [1]}\nsamples: {count: 2}", "samples: no axis has a distribution"),
    (
        "axes: {x: {distribution: normal, mean: 1, std: 1}}\nsamples: {method: sobol, count: 100}",
        "samples.count: must be a power of 2 with method sobol, such as 64 or 128, got 100",
    ),
    (
        "axes: {x: {distribution: normal, mean: 1, std: 1}}\nsamples: {method: sobol_indices, count: 8}\n"
        "constraints: [{left: x, op: <, right: 1}]",
        "constraints: Sobol indices need independent axes",
    ),
    ("correlations: [{between: [x, x], rank: 0.1}]\naxes: {x: [1]}", "correlations[1].between: must name two"),
    ("correlations: [{between: [x, y], rank: 0.1}]\naxes: {y: [1]}", "no axis is called 'x'; known: y"),
    ("correlations: [{between: [x, y], rank: 0.1}]\naxes: {x: [1], y: [1]}", "x has no distribution"),
    ("correlations: [{between: [x, y]}]\naxes: {x: [1], y: [1]}", "correlations[1]: give rank or normal"),
    ("constraints: [{left: x, op: <, right: 1}]\naxes: {y: [1]}", "constraints[1].left: no axis is called 'x'"),
    ("constraints: [{left: y, op: '=<', right: 1}]\naxes: {y: [1]}", "constraints[1].op: must be <, <=, >, >=, =="),
    ("constraints: [{left: y, op: <, right: [1]}]\naxes: {y: [1]}", "constraints[1].right: must be the key of an axis"),
    ("seeds: 0", "seeds: must be a number of seeds from 1"),
    ("seeds: {first: 3, last: 1}", "seeds.last: must be >= first = 3, got 1"),
    ("metrics: []", "metrics: is empty"),
    ("vary: {}\naxes: {}", "vary: unknown key; did you mean axes?"),
]


def faults_of(path: Path) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        load_study(path)
    return caught.value.faults


def test_every_kind_of_axis_is_read_and_the_schema_accepts_it(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(WHOLE)
    study, places = load_study(path)
    kinds = [type(axis).__name__ for axis in study.axes.values()]
    assert kinds[:4] == ["ListAxis", "ListAxis", "RangeAxis", "FolderAxis"]
    assert kinds[4:] == ["NormalAxis", "LognormalAxis", "UniformAxis", "TruncatedNormalAxis"] + 2 * ["EmpiricalAxis"]
    assert places["record"].endswith("s.yaml:7:3: axes.record")
    validator("study").validate(yaml.safe_load(WHOLE))


@pytest.mark.parametrize(("text", "fault"), WRONG)
def test_a_fault_has_its_place_and_one_sentence(text: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(f"case: el_centro_low_ff_fb\n{text}\n")
    found = [told for told in faults_of(path) if fault in told]
    assert found and all(":" in told and "s.yaml:" in told for told in found), faults_of(path)


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("axes: {x: 5}\nsamples: {count: 0}\nseeds: x\ncase: [1]\n")
    assert [fault.split(": ")[1] for fault in faults_of(path)] == [
        "axes.x",
        "samples",
        "samples.count",
        "seeds",
        "case",
    ]


def test_a_study_given_as_a_case_says_what_runs_it(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("case: el_centro_low_ff_fb\naxes: {scaling: [0.2]}\n")
    with pytest.raises(InputError, match=r"is a study, not a case; rths sweep .*s\.yaml runs it"):
        load_cases([path])
