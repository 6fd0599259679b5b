"""Damaged record files: each is read with finite values or refused in one sentence, and a file whose header says
otherwise is never read.

The examples of `helpers/make_record_examples.py` are cut, joined, and given other characters, lines and numbers, from
fixed seeds.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from make_record_examples import FOLDER

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_components

FILES = sorted(path for path in FOLDER.iterdir() if path.is_file())
COUNTED = {
    "cosmos.V1c", "cosmos.V2c", "cosmos_all.V2C", "csmip.V1", "csmip.V2", "csmip_1983.V2", "esm.HNE.ASC",
    "itaca_g.HNN.ASC", "kiknet.NS2", "knet.EW", "peer_1999.AT2", "peer_2000.AT2", "peer_2005.AT2",
}  # fmt: skip
"""Files whose header states the number of samples, or a duration."""


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Return a file with one to four things changed."""
    for _ in range(random.integers(1, 5)):
        lines = data.splitlines(keepends=True) or [b""]
        place, other = (int(k) for k in random.integers(0, len(lines), 2))
        at = int(random.integers(0, max(len(data), 1)))
        kind = random.integers(0, 10)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data = data[:at] + bytes([random.integers(0, 256)]) + data[at + 1 :]
        elif kind == 2:
            data = b"".join(lines[:place] + lines[place + 1 :])
        elif kind == 3:
            data = b"".join([*lines[:place], lines[other], *lines[place:]])
        elif kind == 4:
            data = data[:at] + random.choice([b" ", b",", b"-", b".", b"e9", b"nan", b"1_0", b"\t"]) + data[at:]
        elif kind == 5:
            data = data[:at] + random.choice([b"999999999999", b"1e308", b"-0", b"0"]) + data[at + 4 :]
        elif kind == 6:
            data = b"".join(lines[place:])
        elif kind == 7 and (digits := re.search(rb"\d+", data[at:])):
            number = str(random.integers(0, 10 ** int(random.integers(1, 13)))).encode()
            data = data[: at + digits.start()] + number + data[at + digits.end() :]
        elif kind == 8:
            lines[place], lines[other] = lines[other], lines[place]
            data = b"".join(lines)
        else:
            data = data.replace(b"\n", random.choice([b"\r\n", b" \n", b"\r", b"\n\n"]))
    return data


def check_read(path: Path) -> bool:
    """Return whether a file is read; what it holds is finite, and what refuses it one line each."""
    try:
        found = read_components(path, *(("g", 0.01) if path.suffix == ".g3" else ()))
    except InputError as error:
        for fault in error.faults:
            assert "\n" not in fault and len(fault) < 1000 and fault.count(path.name) >= 1, fault
        return False
    for each in found:
        assert np.isfinite(each.accel_m_s2).all() and each.accel_m_s2.size >= 3 and 0.0 < each.dt_s <= 10.0
        assert 0.0 < np.abs(each.accel_m_s2).max() <= 100.0
    return True


def fuzz(folder: Path, seed: int, count: int) -> int:
    """Return how many of `count` damaged files are read."""
    random, read = np.random.default_rng(seed), 0
    for _ in range(count):
        source = FILES[random.integers(0, len(FILES))]
        path = folder / source.name
        path.write_bytes(damaged(source.read_bytes(), random))
        read += check_read(path)
    return read


def test_damaged_files_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    assert 5 < fuzz(tmp_path, 1, 120) < 115  # neither all nor none: what is damaged matters


@pytest.mark.campaign
def test_two_thousand_damaged_files_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    assert 100 < fuzz(tmp_path, 50, 2000) < 1900


@pytest.mark.parametrize("name", [path.name for path in FILES if path.suffix not in (".VT2", ".g3")])
def test_ends_of_lines_blanks_and_an_end_of_dos_change_nothing(tmp_path: Path, name: str) -> None:
    data, path = (FOLDER / name).read_bytes(), tmp_path / name
    wanted = read_components(FOLDER / name)
    if data.startswith(b"\xff\xfe"):
        return  # of UTF-16, whose bytes are no characters
    unix = data.replace(b"\r\n", b"\n")
    for other in (
        unix.replace(b"\n", b"\r\n"), unix.replace(b"\n", b"\r"), unix.replace(b"\n", b"   \n"), b"\n" + unix,
        unix + b"\n\n \n", unix.rstrip(b"\n"), unix + b"\x1a\n", b"\xef\xbb\xbf" + unix,
    ):  # fmt: skip
        path.write_bytes(other)
        for one, same in zip(read_components(path), wanted, strict=True):
            assert (one.dt_s, one.component, one.station) == (same.dt_s, same.component, same.station)
            assert np.array_equal(one.accel_m_s2, same.accel_m_s2)


@pytest.mark.parametrize("name", sorted(COUNTED))
def test_a_file_with_fewer_or_more_figures_than_its_header_states_is_refused(tmp_path: Path, name: str) -> None:
    lines = (FOLDER / name).read_bytes().splitlines(keepends=True)
    path, random = tmp_path / name, np.random.default_rng(7)
    last = max(k for k, line in enumerate(lines) if (b"." in line and line[:10].strip()[:1].isdigit()) or b" -" in line)
    for place in last - 1 - random.integers(0, 25, 4):
        for changed in ([*lines[:place], *lines[place + 1 :]], [*lines[:place], lines[place], *lines[place:]]):
            path.write_bytes(b"".join(changed))
            assert not check_read(path), (name, int(place))
