"""What `rths structure` finds of a building, against eigenvalues computed here and the paper's frequencies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from golden import golden
from scipy.linalg import eig, eigh

from rths_cli.errors import InputError
from rths_cli.laboratory.describe import Inspected, inspect_structure
from rths_cli.numerics.lti import Array
from rths_cli.report.structure_page import document, page, shown_floors

OWN = """\
numerical: {masses_kg: [8, 8, 8], stiffness_n_per_m: [8000, 8000, 7000]}
experimental: {masses_kg: [7, 6], stiffness_n_per_m: [7000, 6000], dashpots_n_s_per_m: [3, 2]}
interface_experimental_mass_kg: 2
heights_m: [0.5, 0.3, 0.3, 0.3, 0.3]
damping_levels:
  little: {dashpots_n_s_per_m: [10, 20, 30]}
  much: {dashpots_n_s_per_m: [2000, 2000, 2000]}
  none_such: {first_mode_ratio: 1e-4}
"""
MASSES, SPRINGS = np.array([8.0, 8.0, 8.0, 7.0, 6.0]), np.array([8e3, 8e3, 7e3, 7e3, 6e3])
Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a structure file own.yaml into a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def write_file(text: str) -> Path:
        (tmp_path / "own.yaml").write_text(text)
        return tmp_path / "own.yaml"

    return write_file


def chain(values: Array) -> Array:
    """Return the matrix of a chain, storey by storey."""
    matrix = np.zeros((len(values), len(values)))
    for i, value in enumerate(values):
        matrix[i, i] += value
        if i:
            matrix[i - 1, i - 1] += value
            matrix[i, i - 1] = matrix[i - 1, i] = -value
    return matrix


def test_modes_shapes_and_masses_are_those_of_the_chain(write: Write) -> None:
    write(OWN)
    found = inspect_structure("own")
    squared, shapes = eigh(chain(SPRINGS), np.diag(MASSES))
    assert found.natural_frequency_hz == pytest.approx(np.sqrt(squared) / (2.0 * np.pi), rel=1e-9)
    weights = shapes.T @ MASSES
    assert found.effective_mass_ratio == pytest.approx(weights**2 / MASSES.sum(), rel=1e-8)
    assert found.effective_mass_ratio.sum() == pytest.approx(1.0, rel=1e-12)
    for mode, shape in enumerate(shapes.T):
        largest = shape[np.argmax(np.abs(shape))]
        assert found.mode_shapes[:, mode] == pytest.approx(shape / largest, abs=1e-9)
    assert (found.name, found.file, found.numerical_storeys) == ("own", "own.yaml", 3)
    assert (found.floor_mass_kg.tolist(), found.stiffness_n_per_m) == (MASSES.tolist(), pytest.approx(SPRINGS))
    assert found.experimental_mass_kg == 15.0 and found.heights_m is not None and found.heights_m[0] == 0.5


def test_each_level_has_the_damped_modes_of_its_dashpots(write: Write) -> None:
    """The eigenvalues of M s^2 + C s + K; two real ones are a mode that does not oscillate."""
    write(OWN)
    little, much, none_such = inspect_structure("own").levels
    M, K, zero, one = np.diag(MASSES), chain(SPRINGS), np.zeros((5, 5)), np.eye(5)
    for level, numerical in ((little, [10.0, 20.0, 30.0]), (much, [2000.0] * 3)):
        C = chain(np.array([*numerical, 3.0, 2.0]))
        s = eig(np.block([[zero, one], [-K, -C]]), np.block([[one, zero], [zero, M]]), right=False)
        oscillating = sorted(s[s.imag > 1e-6], key=abs)
        mine = level.damping_ratio < 1.0
        assert level.natural_frequency_hz[mine] == pytest.approx(np.abs(oscillating) / (2.0 * np.pi), rel=1e-8)
        assert level.damping_ratio[mine] == pytest.approx([-root.real / abs(root) for root in oscillating], rel=1e-8)
        assert level.dashpots_n_s_per_m.tolist() == pytest.approx(numerical)
    assert np.any(much.damping_ratio >= 1.0) and not np.any(little.damping_ratio >= 1.0)
    assert "cannot give 0.0001, only" in none_such.fault and len(none_such.damping_ratio) == 0


def test_the_papers_building_has_its_frequencies_and_two_sets_of_stiffnesses() -> None:
    found = inspect_structure("three_storey")
    assert found.natural_frequency_hz == pytest.approx([2.3, 6.5, 9.2], rel=0.02)  # the paper's, of two digits
    assert found.specimen_frequency_hz == pytest.approx([3.2, 8.4], rel=1e-9)
    assert [level.damping_ratio[0] for level in found.levels] == pytest.approx([0.026, 0.036], rel=1e-8)
    used, other = found.stiffness_sets
    assert used.stiffness_n_per_m == pytest.approx([7331.56, 7376.40], abs=0.01)
    assert other.stiffness_n_per_m == pytest.approx([14710.35, 3676.36], abs=0.01)
    for one in (used, other):
        k = np.array([one.stiffness_n_per_m.mean(), *one.stiffness_n_per_m])
        expected = np.sqrt(eigh(chain(k), np.diag([6.93, 6.91, 6.95]), eigvals_only=True)) / (2.0 * np.pi)
        assert one.natural_frequency_hz == pytest.approx(expected, rel=1e-6)
    assert used.natural_frequency_hz == pytest.approx(found.natural_frequency_hz) and found.exit_code == 0


def test_a_case_shows_its_building_with_its_own_damping() -> None:
    found = inspect_structure("el_centro_high_ff")
    assert (found.name, found.file) == ("three_storey", "") and [level.name for level in found.levels] == ["high"]


def test_without_levels_the_numerical_storeys_have_no_dashpots(write: Write) -> None:
    write(OWN.partition("damping_levels")[0])
    (level,) = inspect_structure("own").levels
    assert (level.name, level.dashpots_n_s_per_m.tolist()) == ("without dashpots", [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("numerical: {masses_kg: [8]}\n", "own.yaml:1:1: experimental: is missing; add experimental: masses_kg"),
        (OWN.replace("[7, 6]", "[7, -6]"), r"own.yaml:2:31: experimental.masses_kg\[2\]: must be > 0"),
        ("{kind: virtual}\n", "own.yaml: is a rig, not a structure; rths list structures"),
        ("numerical: [\n", "own.yaml:2:1: not valid YAML"),
        (OWN.replace("stiffness_n_per_m: [7000, 60", "natural_frequencies_hz: [3, 3.1"), "^own.yaml: .*no positive"),
    ],
)  # fmt: skip
def test_a_file_with_faults_is_refused_with_their_places(write: Write, text: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        inspect_structure(str(write(text)))


def test_an_unknown_name_is_told_from_the_known_ones(write: Write) -> None:
    write(OWN)
    with pytest.raises(InputError, match="no structure is called 'owm'; did you mean own"):
        inspect_structure("owm")


@pytest.mark.parametrize(("name", "width"), [("three_storey", 100), ("own", 100), ("own", 60)])
def test_the_page_is_as_kept_and_within_its_width(name: str, width: int, write: Write) -> None:
    write(OWN)
    printed = page(inspect_structure(name), width)
    assert max(map(len, printed.splitlines())) <= width
    assert printed == golden(f"structure_{name}_{width}.txt", printed)


def test_a_tall_building_fits_a_page(write: Write) -> None:
    own = inspect_structure(str(write(_tall(60))))
    printed = page(own, 80)
    assert len(printed.splitlines()) < 80 and "  2 to 58" in printed and "52 more modes in --json" in printed
    assert shown_floors(62, 60) == [62, 60, 56, 50, 44, 38, 32, 25, 19, 13, 7, 1][: len(shown_floors(62, 60))]
    assert len(document(own)["mode_shapes"]) == len(document(own)["mode_shapes"][0]) == 62


def test_a_doubt_on_units_stands_first(write: Write) -> None:
    found = inspect_structure(str(write(OWN.replace("8000, 8000, 7000", "8, 8, 7"))))
    (line,) = (line for line in page(found).splitlines() if line.startswith("warning"))
    assert "own.yaml: numerical.stiffness_n_per_m: mode 1 0.0" in line and page(found).splitlines()[1] == line
    assert document(found)["warnings"] == list(found.warnings) != []


def test_the_document_holds_every_figure_of_the_page(write: Write) -> None:
    write(OWN)
    found: Inspected = inspect_structure("own")
    told = document(found)
    assert told["period_s"] == pytest.approx(1.0 / found.natural_frequency_hz)
    assert np.transpose(told["mode_shapes"]) == pytest.approx(found.mode_shapes)
    assert [level["name"] for level in told["damping_levels"]] == ["little", "much", "none_such"]
    assert told["damping_levels"][2]["fault"] and told["exit_code"] == 1 and told["heights_m"][0] == 0.5


def _tall(storeys: int) -> str:
    masses, springs = [9.0, *[8.0] * (storeys - 3), 7.0, 7.5], [8e3] * storeys
    experimental = "experimental: {masses_kg: [7, 6], stiffness_n_per_m: [7e3, 6e3], damping_ratios: [0.02, 0.03]}\n"
    return f"numerical: {{masses_kg: {masses}, stiffness_n_per_m: {springs}}}\n{experimental}"


def test_a_case_with_a_scale_shows_its_prototype(write: Write, tmp_path: Path) -> None:
    write(OWN)
    (tmp_path / "scaled.yaml").write_text(
        "structure: own\ndamping: little\nrecord: el_centro\nscaling: 1.0\ncontroller: FF\n"
        "scale: {length: 4, acceleration: 0.64, mass: 30}\n"
    )
    found = inspect_structure("scaled")
    whole = document(found)["prototype"]
    squared = eigh(chain(4.8 * SPRINGS), np.diag(30.0 * MASSES), eigvals_only=True)
    assert whole["natural_frequency_hz"] == pytest.approx(np.sqrt(squared) / (2.0 * np.pi), rel=1e-9)
    assert whole["floor_mass_kg"] == pytest.approx(30.0 * MASSES)
    assert whole["stiffness_n_per_m"] == pytest.approx(4.8 * SPRINGS)
    assert whole["heights_m"] == pytest.approx([2.0, 1.2, 1.2, 1.2, 1.2])
    text = " ".join(page(found).split())
    assert "prototype over model: length 4, time 2.5," in text
    assert document(inspect_structure("own"))["prototype"] is None and "prototype" not in page(inspect_structure("own"))
