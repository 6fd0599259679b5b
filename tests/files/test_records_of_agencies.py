"""Records in the layouts of agencies and programs: the motion that the examples were written from, and contradictions.

Oracle: `make_record_examples` writes each layout from one invented motion and knows nothing of the readers.
"""

from __future__ import annotations

import struct
from pathlib import Path

import make_record_examples as examples
import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram, read_components, waveforms

FOLDER = Path(__file__).parent / "record_examples"
G = 9.80665
READ = [  # file, what the case states, components by their labels, half a unit of the last digit in m/s^2
    ("peer_1999.AT2", {}, {"": "NS"}, 1e-6),
    ("peer_2000.AT2", {}, {"": "NS"}, 1e-6),
    ("peer_2005.AT2", {}, {"": "NS"}, 1e-7),
    ("knet.EW", {}, {"EW": "EW"}, 4e-6),
    ("kiknet.NS2", {}, {"NS2": "NS"}, 4e-6),
    ("cosmos.V1c", {}, {"360": "NS", "90": "EW", "Up": "UD"}, 5e-6),
    ("cosmos.V2c", {}, {"90": "EW"}, 1e-6),
    ("cosmos_all.V2C", {}, {"360": "NS", "90": "EW", "Up": "UD"}, 1e-7),
    ("csmip.V1", {}, {"360": "NS", "90": "EW", "Up": "UD"}, 5e-6),
    ("csmip.V2", {}, {"360": "NS", "90": "EW", "Up": "UD"}, 1e-7),
    ("csmip_1983.V2", {}, {"Up": "UD"}, 5e-6),
    ("esm.HNE.ASC", {}, {"HNE": "EW"}, 1e-8),
    ("itaca_g.HNN.ASC", {}, {"HNN": "NS"}, 5e-6),
    ("opensees_8.txt", {}, {"": "NS"}, 1e-6),
    ("opensees_free.g3", {"unit": "g", "dt_s": 0.01}, {"": "NS"}, 1e-7),
    ("prose.txt", {}, {"": "NS"}, 1e-6),
    ("four_columns.txt", {}, {"": "NS"}, 1e-6),
    ("three_components.csv", {}, {"NS": "NS", "EW": "EW", "UD": "UD"}, 1e-7),
    ("tabelle.csv", {}, {"": "NS"}, 1e-6),
]


def refusal(path: Path, **stated: object) -> str:
    with pytest.raises(InputError) as caught:
        read_components(path, **stated)  # type: ignore[arg-type]
    (told,) = caught.value.faults
    return told.removeprefix(str(path))


def changed(folder: Path, name: str, old: str, new: str) -> Path:
    """Return a copy of an example with one text replaced, wherever it stands."""
    text = (FOLDER / name).read_text()
    assert old in text
    path = folder / name
    path.write_text(text.replace(old, new))
    return path


def test_the_examples_are_what_their_layouts_say() -> None:
    written = {name: data if isinstance(data, bytes) else data.encode() for name, data in examples.examples()}
    assert {path.name: path.read_bytes() for path in FOLDER.iterdir()} == written
    assert len(written) == 20


@pytest.mark.parametrize(("name", "stated", "components", "digit"), READ)
def test_every_component_is_the_motion_that_was_written(
    name: str, stated: dict[str, object], components: dict[str, str], digit: float
) -> None:
    found = read_components(FOLDER / name, **stated)  # type: ignore[arg-type]
    assert [one.component for one in found] == list(components)
    for one, written in zip(found, components.values(), strict=True):
        assert one.dt_s == pytest.approx(examples.DT_S, rel=1e-9)
        assert one.accel_m_s2 == pytest.approx(G * examples.motion_g(written), abs=1.01 * digit)


@pytest.mark.parametrize(
    ("name", "component", "written"),
    [("cosmos.V1c", "HNE", "EW"), ("cosmos.V1c", "ud", "UD"), ("csmip.V2", "channel 1", "NS"), ("csmip.V2", "NS", "NS"),
     ("csmip.V1", "up", "UD"), ("three_components.csv", "EW (gal)", "EW"), ("esm.HNE.ASC", "EW", "EW")],
)  # fmt: skip
def test_a_component_has_several_names(name: str, component: str, written: str) -> None:
    found = read_accelerogram(FOLDER / name, component=component)
    assert found.accel_m_s2 == pytest.approx(G * examples.motion_g(written), abs=1e-4)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("peer_2005.AT2", "NPTS=    300, DT=   .0100 SEC,", "DT= .01 SEC; Npts = 300"),
        ("peer_2005.AT2", "NPTS=    300,", "NUMBER OF POINTS= 300,"),
        ("peer_2005.AT2", "E-0", "D-0"),
        ("peer_2005.AT2", " -", "-"),  # grown together
        ("knet.EW", "Sampling Freq(Hz) 100Hz", "SAMPLING FREQ(HZ) 100"),
        ("knet.EW", "Scale Factor", "scale factor"),
        ("esm.HNE.ASC", "PGA_CM/S^2", "PGA_cm/s^2"),
        ("esm.HNE.ASC", "SAMPLING_INTERVAL_S:", "sampling_interval_s :"),
        ("cosmos.V1c", "units=cm/sec2(04),Format", "units=cm/sec2.     (04)Format"),  # of CESMD, 2018
    ],
)
def test_what_other_generations_write_changes_nothing(tmp_path: Path, name: str, old: str, new: str) -> None:
    found, wanted = read_components(changed(tmp_path, name, old, new)), read_components(FOLDER / name)
    assert all(np.array_equal(a.accel_m_s2, b.accel_m_s2) for a, b in zip(found, wanted, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "t [s];a [m s-2]\n{rows}", ",time (s),a (m·s⁻²)\n{index}", "Zeit (s)\tBeschl. (m/s²)\n0\t0\n{tabs}",
        "{double}",
    ],
)  # fmt: skip
def test_spreadsheets_of_others_are_read_from_their_first_row(tmp_path: Path, text: str) -> None:
    accel = np.round(G * examples.motion_g(), 5)
    pairs = list(zip(examples.TIME_S, accel, strict=True))
    first = 1 if "{tabs}" in text else 0
    whole = text.format(
        rows="\n".join(f"{t:.2f};{a:.5f}" for t, a in pairs).replace(".", ","),
        tabs="\n".join(f"{t:.2f}\t{a:.5f}" for t, a in pairs[1:]).replace(".", ","),
        index="\n".join(f"{k},{t:.2f},{a:.5f}" for k, (t, a) in enumerate(pairs)),
        double="\n".join(f"{t:.5E} {a:.9E}".replace("E", "D") for t, a in pairs),
    )
    (tmp_path / "a.csv").write_text(whole, encoding="utf-8")
    found = read_accelerogram(tmp_path / "a.csv", "m/s^2")
    assert found.accel_m_s2[first:] == pytest.approx(accel[first:], abs=1e-9) and found.dt_s == pytest.approx(0.01)
    assert found.accel_m_s2.size == accel.size


@pytest.mark.parametrize("head", ["300\n", "300\n0.01\n", "300 0.01\n"])
def test_a_count_above_the_figures_is_no_sample(tmp_path: Path, head: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(head + examples.rows(examples.gal(), 1 if " " not in head else 8, "12.5f"))
    assert "the first figure, 300, is the number of those that follow it" in refusal(path, unit="gal", dt_s=0.01)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x1f\x8b\x08" + bytes(99), "is compressed (gzip); unpack it"),
        (b"PK\x03\x04" + bytes(99), "is a zip archive or a workbook; unpack it, or save a workbook's sheet"),
        (b"*****\n   INSTITUTO DE INGENIERIA, UNAM\n", "is a file of UNAM (Mexico)"),
        (b"1 UNCORRECTED ACCELEROGRAM\r\n*\r\n 1 2 3\r\n" + bytes(9), "is an SMC file (USGS)"),
    ],
)
def test_other_files_are_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.dat").write_bytes(data)
    assert words in refusal(tmp_path / "a.dat")


def test_of_several_components_one_has_to_be_named() -> None:
    with pytest.raises(InputError, match=r"holds 3 components \(360, 90, Up\); state one .*component: 360"):
        read_accelerogram(FOLDER / "csmip.V2")
    with pytest.raises(InputError, match=r"record.component: .* has no component '45'; it holds 360, 90, Up"):
        read_accelerogram(FOLDER / "csmip.V2", component="45")
    with pytest.raises(InputError, match=r"no component 'NS'; it names no component"):
        read_accelerogram(FOLDER / "peer_2005.AT2", component="NS")


def test_station_and_correction_are_told() -> None:
    (esm,) = read_components(FOLDER / "esm.HNE.ASC")
    assert (esm.station, esm.corrected) == ("XX.S001", "baseline removed, butterworth filter 0.100 to 30.000 Hz")
    assert {one.corrected for one in read_components(FOLDER / "csmip.V1")} == {"nothing (uncorrected)"}
    assert "bandpass filtered" in read_components(FOLDER / "csmip.V2")[2].corrected
    assert "offset (mean of the record) removed" in read_components(FOLDER / "knet.EW")[0].corrected


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("peer_2005.VT2", "PEER NGA", "PEER", ":3: is a velocity record"),
        ("peer_1999.AT2", "  300    .0100", "  301    .0100", ":4: the header states 301 samples, the file holds 300"),
        ("knet.EW", "Max. Acc. (gal)   82.075", "Max. Acc. (gal)   84.075", ":15: the header states a peak of 84.075"),
        ("knet.EW", "Duration Time(s)  3", "Duration Time(s)  4", ":12: the header states 4 s, which are 400 samples"),
        ("knet.EW", "3920(gal)/6182761", "3920(gal)/0", ":14: the scale factor '3920(gal)/0' is not written as"),
        ("knet.EW", "100Hz", "0Hz", ":11: Sampling Freq(Hz): '0Hz' is no positive number"),
        ("knet.EW", "Scale Factor", "Scale", ": is a K-NET file without Scale Factor"),
        ("esm.HNE.ASC", "NDATA: 300", "NDATA: 299", ":30: the header states 299 samples, the file holds 300"),
        ("esm.HNE.ASC", "PGA_CM/S^2: 8", "PGA_CM/S^2: 9", ":40: the header states a peak of 92.07"),
        ("esm.HNE.ASC", "DATA_TYPE: ACCELERATION", "DATA_TYPE: VELOCITY", ": is a record of velocity"),
        ("esm.HNE.ASC", "DATA_TYPE: ACCELERATION", "DATA_TYPE: ACCELERATION SPECTRUM", "acceleration spectrum"),
        ("esm.HNE.ASC", "UNITS: cm/s^2", "UNITS: m/s^2", ":40: the header states a peak of 0.820754 m/s^2"),
        ("esm.HNE.ASC", "SAMPLING_INTERVAL_S: 0.010000", "SAMPLING_INTERVAL_S:", "that states no SAMPLING_INTERVAL_S"),
        ("esm.HNE.ASC", "DURATION_S: 3.000", "DURATION_S: 6.000", ":31: the header states 6 s, which are 600 samples"),
        ("cosmos.V2c", "     300 acceleration pts", "     299 acceleration pts", "more follow in line"),
        ("cosmos.V2c", "     300 acceleration pts", "     301 acceleration pts", "the header states 301 samples"),
        ("cosmos.V2c", "(04)", "(02)", "the unit cm/sec2 contradicts its code 02 (g)"),
        ("cosmos.V2c", "(04)", "(50)", "holds raw counts (V0)"),
        ("cosmos.V2c", "       2       1       4", "       2       1       2", "contradicts that of the header, 02"),
        ("cosmos.V2c", "Max =    82", "Max =    92", ":11: the header states a peak of 92.075 cm/s^2"),
        ("csmip.V2", "Peak acceleration =   -46.900    cm/sec/sec", "Peak acceleration =  .500 g", "peak of 490.332"),
        ("cosmos.V2c", "Max =    82.", "Max =    8.2E+02 cm/sec^2, once ", ":11: the header states a peak of 820"),
        ("esm.HNE.ASC", "PGA_CM/S^2: 82.075439", "PGA_CM/S^2: 9.98E+03", ":40: the header states a peak of 9980"),
        ("cosmos.V2c", "    10.000000     3.000000", "     5.000000     3.000000", "the header states 3 s (real 63)"),
        ("cosmos.V2c", "approx    3 secs", "approx    6 secs", ":45: 300 samples every 0.01 s (real 62"),
        ("csmip.V2", "   300 points of accel data", "   308 points of accel data", "the header states 308 samples"),
        ("csmip.V2", "(8f10.5)", "(8f12.5)", "is not a number of 8 a line in 12 characters each"),
        ("csmip.V2", "Peak acceleration =   -46.900", "Peak acceleration =   -49.900", "states a peak of 49.9 cm/s^2"),
        ("csmip.V1", "Record Length = 3.000 sec", "Record Length = 6.000 sec", ":11: states a length of 6.000 s, 300"),
        ("csmip.V2", "at  .010 sec, in cm/sec2", "at  .020 sec, in cm/sec2", ":17: states 300 points every 0.01 s"),
        ("three_components.csv", "0.0400000,", "0.0450000,", ":6: the time (first column) steps by 0.015 s here"),
    ],
)  # fmt: skip
def test_a_header_that_contradicts_the_samples_is_refused(
    tmp_path: Path, name: str, old: str, new: str, words: str
) -> None:
    assert words in refusal(changed(tmp_path, name, old, new))


@pytest.mark.parametrize("name", ["csmip.V2", "cosmos_all.V2C", "knet.EW", "esm.HNE.ASC", "peer_2005.AT2", "csmip.V1"])
def test_a_file_that_was_cut_is_refused(tmp_path: Path, name: str) -> None:
    data = (FOLDER / name).read_bytes()
    path = tmp_path / name
    for share in (0.2, 0.5, 0.9):
        path.write_bytes(data[: round(share * len(data))])
        assert refusal(path)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("2 CORRECTED ACCELEROGRAM\n*\n", "is an SMC file (USGS); convert it to CSV"),
        ("Corrected accelerogram 20260203_100000_XXXX_20 GNS Science\nSite XXXX\n", "is a GeoNet file (New Zealand)"),
        ("Response and Fourier Amplitude Spectra\nCorrected accelerogram\n", "is a file of spectra (V3)"),
        ("Raw acceleration counts   (Format v01.20 with 13 text lines)\n"
         "       3 raw accel.   pts, approx    1 secs, units=counts (50),Format=(10I8)\n       1       2       3\n",
         "holds raw counts (V0)"),
        ("UNCORRECTED ACCELEROGRAM DATA\nX\nUNITS OF UNCOR ACCEL ARE SEC AND G/10.\n", "pairs of time"),
    ],
)  # fmt: skip
def test_formats_that_are_not_read_are_named(tmp_path: Path, head: str, words: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(head + "1 2 3\n")
    assert words in refusal(path)


def test_rows_are_a_series_only_where_they_are_no_table(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    series = examples.motion_g()
    path.write_text(examples.rows(series, 6, "13.7f"))
    assert read_accelerogram(path, "g", 0.01).accel_m_s2 == pytest.approx(G * series, abs=1e-6)
    beside = np.stack([examples.motion_g(c) for c in examples.PARTS], axis=1)
    path.write_text(examples.rows(beside.ravel(), 3, "13.7f"))
    assert ":1: 3 columns; give one" in refusal(path, unit="g", dt_s=0.01)
    path.write_text(examples.rows(np.column_stack([examples.TIME_S, beside]).ravel(), 4, "13.7f"))
    assert ":1: 4 columns; give one" in refusal(path, unit="g", dt_s=0.01)


@pytest.mark.parametrize(("factors", "offset"), [((1.0, 1.0), 0.001), ((1.0, 1.0, 1.0), 0.0), ((1.0, 0.95), 0.0)])
def test_columns_that_resemble_each_other_are_no_series(
    tmp_path: Path, factors: tuple[float, ...], offset: float
) -> None:
    path = tmp_path / "a.txt"
    beside = np.stack([factor * examples.motion_g() + offset * k for k, factor in enumerate(factors)], axis=1)
    path.write_text(examples.rows(beside.ravel(), len(factors), "13.7f"))
    assert "colum" in refusal(path, unit="g", dt_s=0.01)


def test_names_above_every_column_make_a_table_of_a_series(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("# a title\n" + examples.rows(examples.motion_g(), 2, "13.7f"))
    assert read_accelerogram(path, "g", 0.01).format == "rows of values"
    path.write_text("raw filtered\n" + examples.rows(examples.motion_g(), 2, "13.7f"))
    assert "colum" in refusal(path, unit="g", dt_s=0.01)


def test_numbers_of_a_stated_width_need_no_space_between_them(tmp_path: Path) -> None:
    path = tmp_path / "a.V2"
    lines = (FOLDER / "csmip.V2").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if "points of accel" in line) + 1
    lines[first] = "-100.00000" * 2 + "    -25000" + lines[first][30:]
    path.write_text("\n".join(lines))
    found = read_accelerogram(path, component="360").accel_m_s2
    assert found[:3] == pytest.approx([-1.0, -1.0, -0.0025])  # a field without a point has the format's decimals


def test_a_table_whose_column_contradicts_the_unit_above_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(f"{k / 100},{k % 7},0\n" for k in range(9))
    path.write_text("# units: g\ntime (s),acc NS (cm/s2),note\n" + rows)
    assert refusal(path).startswith(":1: the unit is stated as g, the column 'acc NS (cm/s2)' (line 2) states cm/s^2")
    path.write_text("# units: gal\ntime (s),acc NS (cm/s2),note\n" + rows)
    assert read_accelerogram(path).unit_read == "cm/s^2"


NO_TIME = ":3: two columns, and the first is no time (it falls 153 times); give one (acceleration), or name two"


@pytest.mark.parametrize(
    ("head", "form", "words"),
    [("", "{:.7f} {:.7f}", NO_TIME), ("raw filtered", "{:.7f} {:.7f}", NO_TIME.replace("3", "4", 1)),
     ("", "{:.0f},{:.0f}", "(it stands still); give one (acceleration), or name two accelerations with their units"),
     ("time (s),acc (g)", "0,{1:.7f}", ":5: the time (first column) does not increase here; give")],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_a_first_column_that_is_no_time_is_named(tmp_path: Path, head: str, form: str, words: str) -> None:
    path = tmp_path / "a.txt"
    scale = 1.0 if ".7f} {" in form else 9.0
    rows = "".join(form.format(value, scale * value) + "\n" for value in examples.motion_g())
    path.write_text(f"# a title\n# dt: 0.01\n{head}\n{rows}".replace("\n\n", "\n"))
    assert words in refusal(path, unit=None if head.startswith("time") else "g")


def test_two_named_accelerations_are_two_components(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        "# dt: 0.01\nacc_NS (g),acc_EW (gal)\n" + "".join(f"{a:.7f},{a:.7f}\n" for a in examples.motion_g())
    )
    north, east = read_components(path)
    assert (north.component, east.component, north.dt_s) == ("acc_NS", "acc_EW", 0.01)
    assert north.accel_m_s2 == pytest.approx(G * examples.motion_g(), abs=1e-6)
    assert east.accel_m_s2 == pytest.approx(0.01 * examples.motion_g(), abs=1e-8)


def test_a_missing_cell_and_a_gap_in_time_are_counted(tmp_path: Path) -> None:
    lines = (FOLDER / "three_components.csv").read_text().splitlines()
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*lines[:5], lines[5].rpartition(",")[0] + ",", *lines[6:]]))
    assert refusal(path).startswith(":6: 1 of 300 samples of 'UD (gal)' are missing")
    path.write_text("\n".join(lines[:100] + lines[103:]))
    assert "(3 samples missing at 1 place)" in refusal(path)


def test_without_obspy_its_formats_are_named_with_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waveforms, "find_spec", lambda _: None)
    path = tmp_path / "a.bin"
    sac = bytearray(632 + 40)
    for order in (">", "<"):
        struct.pack_into(order + "i", sac, 304, 6)
        path.write_bytes(sac)
        assert refusal(path).startswith(": is a SAC file; install obspy to read it (pip install 'rths-cli[obspy]')")
    path.write_bytes(b"000001D S001 " + bytes(500))
    assert refusal(path).startswith(": is a miniSEED file; install obspy to read it")
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(50) + b"AuxiliaryData Waveforms ASDF")
    assert refusal(path).startswith(": is an ASDF file; write the wanted trace as CSV")


def test_obspy_reads_sac_and_miniseed_with_the_unit_that_the_case_states(tmp_path: Path) -> None:
    obspy = pytest.importorskip("obspy")
    about = {"delta": 0.01, "network": "XX", "station": "S001"}
    codes = {"HNN": "NS", "HNE": "EW"}
    traces = [obspy.Trace(examples.gal(part), {**about, "channel": code}) for code, part in codes.items()]
    path = tmp_path / "a.mseed"
    obspy.Stream(traces).write(str(path), format="MSEED")
    assert "states no unit of acceleration" in refusal(path)
    path.write_bytes(path.read_bytes()[:-100])
    assert "cannot be read as miniSEED; it is cut or damaged" in refusal(path, unit="gal")
    obspy.Stream(traces).write(str(path), format="MSEED")
    assert read_accelerogram(path, "gal", component="EW").accel_m_s2 == pytest.approx(G * examples.motion_g("EW"))
    obspy.Stream([traces[0].slice(endtime=traces[0].stats.starttime + 1), traces[0].slice(
        starttime=traces[0].stats.starttime + 2)]).write(str(path), format="MSEED")  # fmt: skip
    assert "has gaps of 99 samples" in refusal(path, unit="gal")
    other, faster = traces[0].copy(), traces[0].copy()
    other.stats.starttime += 2.5
    obspy.Stream([traces[0], other]).write(str(path), format="MSEED")
    assert "has pieces that overlap and differ" in refusal(path, unit="gal")
    faster.stats.starttime, faster.stats.sampling_rate = other.stats.starttime + 9.0, 200.0
    obspy.Stream([traces[0], faster]).write(str(path), format="MSEED")
    assert "XX.S001..HNN has pieces at 100 and 200 Hz" in refusal(path, unit="gal")
    traces[0].write(str(tmp_path / "a.SAC"), format="SAC")
    data = bytearray((tmp_path / "a.SAC").read_bytes())
    traces[0].write(str(tmp_path / "a.txt"), format="SACXY")
    assert read_accelerogram(tmp_path / "a.txt", "gal").accel_m_s2 == pytest.approx(G * examples.motion_g(), abs=1e-6)
    (found,) = read_components(tmp_path / "a.SAC", "gal")
    assert (found.component, found.station) == ("HNN", "XX.S001")
    assert found.accel_m_s2 == pytest.approx(G * examples.motion_g(), abs=1e-6)
    (tmp_path / "cut.SAC").write_bytes(data[:1200])
    assert refusal(tmp_path / "cut.SAC", unit="gal").startswith(": cannot be read as SAC; it is cut or damaged")
    for code, word in ((6, "displacement"), (7, "velocity")):
        struct.pack_into("<i", data, 4 * (70 + 16), code)  # IDEP
        (tmp_path / "a.SAC").write_bytes(data)
        assert f"is a record of {word} (idep)" in refusal(tmp_path / "a.SAC", unit="gal")
    struct.pack_into("<i", data, 4 * (70 + 16), 8)  # acceleration
    struct.pack_into("<f", data, 4, -500.0)  # the least value that the header states
    (tmp_path / "a.SAC").write_bytes(data)
    assert "the header states a peak of 500 gal" in refusal(tmp_path / "a.SAC", unit="gal")
