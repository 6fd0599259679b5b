"""Write the example files of `tests/files/record_examples/` from the published layouts: one invented motion, in the
layout of each agency or program. `python tests/helpers/make_record_examples.py` writes them anew.

Nothing in them was measured: a burst of 0.12 g at 2 Hz, with numbers for the other components that follow from it.
Layouts: PEER .AT2 headers, NIED "K-NET ASCII format", COSMOS "Strong-motion data format" 1.20, CSMIP OSMS 85-03, ESM
"DYNA 1.2", OpenSees Path time series.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FOLDER = Path(__file__).parents[1] / "files" / "record_examples"
DT_S, SAMPLES = 0.01, 300
TIME_S = np.arange(SAMPLES) * DT_S
PARTS = {"NS": 1.0, "EW": -0.7, "UD": 0.4}  # of the motion: three components that cannot be taken for one another


def motion_g(component: str = "NS") -> Array:
    """Return the invented acceleration (n,) in g of a component, without a mean."""
    burst = 0.12 * np.sin(2.0 * np.pi * 2.0 * (TIME_S - 0.3)) * np.exp(-(((TIME_S - 1.2) / 0.5) ** 2))
    return np.asarray(PARTS[component] * (burst - burst.mean()))


def gal(component: str = "NS") -> Array:
    return 980.665 * motion_g(component)


def rows(values: Array, per_line: int, form: str) -> str:
    """Return numbers in lines of `per_line`, each in a field as a Fortran format has it; `form` is Python's."""
    lines = (values[k : k + per_line] for k in range(0, values.size, per_line))
    return "".join("".join(format(value, form) for value in line) + "\n" for line in lines)


def bare(values: Array, per_line: int, width: int, decimals: int) -> str:
    """Return numbers as old Fortran programs print them: without the zero before the point."""

    def cell(value: float) -> str:
        return f"{value:.{decimals}f}".replace("0.", ".", 1) if abs(value) < 1.0 else f"{value:.{decimals}f}"

    lines = (values[k : k + per_line] for k in range(0, values.size, per_line))
    return "".join("".join(cell(value).rjust(width) for value in line) + "\n" for line in lines)


def peak(values: Array) -> float:
    return float(values[np.argmax(np.abs(values))])


def at_s(values: Array) -> float:
    return float(TIME_S[np.argmax(np.abs(values))])


def peer(generation: str, quantity: str = "ACCELERATION") -> str:
    """Return a PEER file: `1999` counts before their names, `2000` the new counts below the old head, `2005` NGA."""
    unit = "G" if quantity == "ACCELERATION" else "CM/S"
    if generation == "2005":
        head = "PEER NGA STRONG MOTION DATABASE RECORD\nInvented-01, 2/3/2026, Station X, 270\n"
        head += f"{quantity} TIME SERIES IN UNITS OF {unit}\n"
        return head + f"NPTS= {SAMPLES:6d}, DT=   .0100 SEC,\n" + rows(motion_g(), 5, "15.7E")
    head = (
        "PACIFIC ENGINEERING AND ANALYSIS STRONG-MOTION DATA\n INVENTED 02/03/26 10:00, STATION X, 270\n"
        f" {quantity} TIME HISTORY IN UNITS OF {unit}. FILTER POINTS: HP=0.1 Hz LP=25.0 Hz\n"
    )
    counts = f"{SAMPLES:5d}    .0100    NPTS, DT\n" if generation == "1999" else f"NPTS= {SAMPLES}, DT= .01000 SEC\n"
    return head + counts + rows(motion_g(), 5, "15.6E")


def nied(direction: str, component: str, offset: int) -> str:
    """Return a K-NET or KiK-net file: counts with an offset."""
    numerator, denominator = 3920, 6182761
    counts = np.round(gal(component) * denominator / numerator).astype(int)
    about_mean = (counts - counts.mean()) * numerator / denominator
    head = {
        "Origin Time": "2026/02/03 10:00:00", "Lat.": "38.000", "Long.": "142.000", "Depth. (km)": "30", "Mag.": "6.0",
        "Station Code": "XXX001", "Station Lat.": "39.0000", "Station Long.": "141.0000", "Station Height(m)": "10",
        "Record Time": "2026/02/03 10:00:20", "Sampling Freq(Hz)": "100Hz", "Duration Time(s)": f"{SAMPLES * DT_S:g}",
        "Dir.": direction, "Scale Factor": f"{numerator}(gal)/{denominator}",
        "Max. Acc. (gal)": f"{np.abs(about_mean).max():.3f}", "Last Correction": "2026/02/03 10:00:05", "Memo.": "",
    }  # fmt: skip
    text = "".join(f"{key:<18}{value}\n" for key, value in head.items())
    return text + "".join(
        "".join(f"{count:9d}" for count in counts[k : k + 8] + offset) + " \n" for k in range(0, SAMPLES, 8)
    )


def cosmos_channel(component: str, form: str, channel: int, volume: int, quantity: str = "acceleration") -> str:
    """Return one channel of a COSMOS file; velocity and displacement are the acceleration's own numbers, scaled."""
    azimuth, code = {"NS": ("360 deg", "HNN"), "EW": (" 90 deg", "HNE"), "UD": ("Up", "HNZ")}[component]
    values = gal(component) * {"acceleration": 1.0, "velocity": 0.1, "displacement": 0.01}[quantity]
    unit, unit_code, kind = {
        "acceleration": ("cm/sec2", 4, 1), "velocity": ("cm/sec", 5, 2), "displacement": ("cm", 6, 3)
    }[quantity]  # fmt: skip
    did = "Corrected" if volume == 2 else "Uncorrected"
    filtered = (
        "Record filtered below 0.10 Hz (periods over  10.0 secs)  and above 25.0 Hz" if volume == 2 else "No filtering"
    )
    text = [
        f"{did} {quantity}    (Format v01.20 with 13 text lines)", "Invented earthquake of February 3, 2026",
        "Hypocenter: 34.0000  -117.0000  H= 12km M=6.0", "Origin: 02/03/2026, 10:00:00.0 UTC",
        "Statn No: 05-12345  Code:XX-S001  XX Invented - Main Street", "Coords: 34.0000 -117.0000  Site geology: rock",
        "Recorder: Any  s/n 1 ( 3 Chns of  3 at Sta) Sensor:Any  s/n 2",
        "Rcrd start time:02/03/2026, 10:00:20.000 UTC (Q=0) RcrdId: X0001",
        f"Sta Chan  {channel:2d}: {azimuth} (Rcrdr Chan  {channel}) Location: free field",
        f"Raw record length =  {SAMPLES * DT_S:.3f} sec, Uncor max =  0.120 g  at  1.000 sec",
        f"Processed: 02/04/2026, 12:00 PST  Max = {peak(values):9.3f} {unit}  at {at_s(values):8.3f} sec", filtered,
        "Values used when parameter or data value is unknown/unspecified:   -999, -999.0",
    ]  # fmt: skip
    integers = np.full(100, -999)
    integers[:4] = volume, kind, unit_code, 120
    reals = np.full(100, -999.0)
    reals[[0, 1, 33, 61, 62, 63, 64]] = 34.0, -117.0, 0.005, 1e3 * DT_S, SAMPLES * DT_S, peak(values), at_s(values)
    per_line, width, rest = int(form[0]), *form[2:].split(".")
    data = rows(values, per_line, f"{width}.{rest}{'E' if 'E' in form else 'f'}")
    return (
        "".join(f"{line:<80}\n" for line in text)
        + " 100 Integer-header values follow on  10 lines, Format= (10I8)\n" + rows(integers, 10, "8d")
        + " 100 Real-header values follow on  17 lines, Format= (6F13.6)\n" + rows(reals, 6, "13.6f")
        + '   1 Comment line(s) follow, each starting with a "|":\n| invented\n'
        + f"{SAMPLES:8d} {quantity} pts, approx {SAMPLES * DT_S:4.0f} secs, units={unit}({unit_code:02d}),"
        f"Format=({form})\n"
        + data + f"End-of-data for Chan{code} {quantity}\n"
    )  # fmt: skip


def csmip_channel(component: str, channel: int, style: str) -> str:
    """Return one channel of a CSMIP file: `v1`, `v2`, or `v2 1983` (capitals, no format stated)."""
    label = {"NS": "360 Deg", "EW": " 90 Deg", "UD": "Up"}[component]
    values = gal(component)
    zeros_16i5 = "".join("    0" * 16 + "\n" for _ in range(6)) + "    0" * 4 + "\n"
    if style == "v1":
        head = [
            "Uncorrected Accelerogram Data             Processed: 02/03/26, XXX", "Invented earthquake", "", "X0001",
            "Station No. 12345   34.000N, 117.000W    Any    s/n 1  (3 Chns of  3 at Sta)", "Invented - Main Street",
            f"Chan  {channel}: {label}", "", "", "Instr Period =  .0100 sec,  Damping =  .640",
            f"No. of Points =  {SAMPLES}  Record Length = 3.000 sec   at 100 Samples/sec",
            f"Units of uncor data are sec and g .        Max  =  {peak(values) / 980.665:.3f} g , "
            f"at {at_s(values):.3f} sec.",
            "",
        ]  # fmt: skip
        data = f"{SAMPLES:6d} Accelerogram points at 100 pts/sec in units of g .      Format: (8f9.6)\n"
        reals = "".join("      .000" * 8 + "\n" for _ in range(7))
        body = zeros_16i5 + reals + data + bare(values / 980.665, 8, 9, 6)
    else:
        old = style == "v2 1983"
        did = "CORRECTED ACCELEROGRAM" if old else "Corrected accelerogram"
        head = [
            f"{did}   12345-X0001-26034.01       Chan  {channel}: {label}     from",
            "Uncorrected Accelerogram Data             Processed: 02/03/26, XXX", "Invented earthquake", "", "X0001",
            "Station No. 12345   34.000N, 117.000W    Any    s/n 1  (3 Chns of  3 at Sta)", "Invented - Main Street",
            f"Chan  {channel}: {label}", "", "", "Instr Period =  .0100 sec,  Damping =  .640",
            "                        Record length =  3.000 sec.",
            "                                     Uncor Max  =   .128 g , at   1.000 sec.", "",
            "Accelerogram bandpass filtered with 3 dB pts at   .10 and 25.00 cyc/sec",
            f"{SAMPLES:6d} points of instrument- and baseline-corrected accel, veloc and displ data",
            "At equally-spaced intervals of    .010  sec.",
            f"Peak acceleration = {peak(values):9.3f}    cm/sec/sec  at {at_s(values):8.3f}   sec.",
            "Peak   velocity   =     1.000      cm/sec    at    1.000   sec.",
            "Peak displacement =     1.000        cm      at    1.000   sec.",
            "Initial velocity  =     .000   cm/sec;   Initial displacement =     .000   cm", "", "", "", "",
        ]  # fmt: skip
        reals = "".join("      .000" * 8 + "\n" for _ in range(12)) + "      .000" * 4 + "\n"
        units = {"accel": ("cm/sec2", "CM/SEC/SEC"), "veloc": ("cm/sec", "CM/SEC"), "displ": ("cm", "CM")}
        body = zeros_16i5 + reals
        for part, (kind, (new, former)) in enumerate(units.items()):
            start = f"{SAMPLES:6d} points of {kind} data equally spaced at  .010 sec"
            body += f"{start.upper()}.  (UNITS: {former})\n" if old else f"{start}, in {new}. (8f10.5)\n"
            body += bare(values * 0.1**part, 8, 10, 3 if old else 5)
    end = f"/&  ----------  End of Data for Channel  {channel}  ----------\n"
    return "".join(f"{line:<80}\n" for line in head) + body + end


def dyna(component: str, unit: str = "cm/s^2") -> str:
    """Return a DYNA 1.2 file: 64 lines of header, one number a line."""
    values, stream = gal(component), {"NS": "HNN", "EW": "HNE", "UD": "HNZ"}[component]
    stated = {
        "EVENT_NAME": "INVENTED", "EVENT_ID": "X-20260203_0000001", "EVENT_DATE_YYYYMMDD": "20260203", "NETWORK": "XX",
        "EVENT_TIME_HHMMSS": "100000", "STATION_CODE": "S001", "STATION_NAME": "Invented: Main Street",
        "STREAM": stream,
        "SAMPLING_INTERVAL_S": f"{DT_S:.6f}", "NDATA": str(SAMPLES), "DURATION_S": f"{SAMPLES * DT_S:.3f}",
        "UNITS": unit, "PGA_CM/S^2": f"{peak(values):.6f}", "TIME_PGA_S": f"{at_s(values):.6f}",
        "BASELINE_CORRECTION": "BASELINE REMOVED", "FILTER_TYPE": "BUTTERWORTH", "FILTER_ORDER": "2",
        "LOW_CUT_FREQUENCY_HZ": "0.100", "HIGH_CUT_FREQUENCY_HZ": "30.000", "DATABASE_VERSION": "DYNA 1.0",
        "HEADER_FORMAT": "DYNA 1.2", "DATA_TYPE": "ACCELERATION",
    }  # fmt: skip
    keys = [
        "EVENT_NAME", "EVENT_ID", "EVENT_DATE_YYYYMMDD", "EVENT_TIME_HHMMSS", "EVENT_LATITUDE_DEGREE",
        "EVENT_LONGITUDE_DEGREE", "EVENT_DEPTH_KM", "HYPOCENTER_REFERENCE", "MAGNITUDE_W",
        "MAGNITUDE_W_REFERENCE", "MAGNITUDE_L", "MAGNITUDE_L_REFERENCE", "FOCAL_MECHANISM", "NETWORK",
        "STATION_CODE", "STATION_NAME", "STATION_LATITUDE_DEGREE", "STATION_LONGITUDE_DEGREE",
        "STATION_ELEVATION_M", "LOCATION", "SENSOR_DEPTH_M", "VS30_M/S", "SITE_CLASSIFICATION_EC8",
        "MORPHOLOGIC_CLASSIFICATION", "EPICENTRAL_DISTANCE_KM", "EARTHQUAKE_BACKAZIMUTH_DEGREE",
        "DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS", "DATE_TIME_FIRST_SAMPLE_PRECISION",
        "SAMPLING_INTERVAL_S", "NDATA", "DURATION_S", "STREAM", "UNITS", "INSTRUMENT",
        "INSTRUMENT_ANALOG/DIGITAL", "INSTRUMENTAL_FREQUENCY_HZ", "INSTRUMENTAL_DAMPING",
        "FULL_SCALE_G", "N_BIT_DIGITAL_CONVERTER", "PGA_CM/S^2", "TIME_PGA_S", "BASELINE_CORRECTION",
        "FILTER_TYPE", "FILTER_ORDER", "LOW_CUT_FREQUENCY_HZ", "HIGH_CUT_FREQUENCY_HZ",
        "LATE/NORMAL_TRIGGERED", "DATABASE_VERSION", "HEADER_FORMAT", "DATA_TYPE", "PROCESSING",
        "DATA_TIMESTAMP_YYYYMMDD_HHMMSS", "DATA_LICENSE", "DATA_CITATION", "DATA_CREATOR",
        "ORIGINAL_DATA_MEDIATOR_CITATION", "ORIGINAL_DATA_MEDIATOR",
        "ORIGINAL_DATA_CREATOR_CITATION", "ORIGINAL_DATA_CREATOR", "USER1", "USER2", "USER3", "USER4",
        "USER5",
    ]  # fmt: skip
    head = "".join(f"{key}: {stated.get(key, '')}\n" for key in keys)
    return head + "".join(f"{value / (980.665 if unit == 'g' else 1.0):.6f}\n" for value in values)


def table(names: Sequence[str], columns: Sequence[Array], mark: str, comma: bool = False) -> str:
    """Return named columns, with decimal commas where asked."""
    lines = (mark.join(f"{value:.7f}" for value in row) for row in zip(*columns, strict=True))
    body = "\n".join(lines) + "\n"
    return mark.join(names) + "\n" + (body.replace(".", ",") if comma else body)


def examples() -> Iterator[tuple[str, str | bytes]]:
    """Yield the name and the content of each example."""
    yield "peer_1999.AT2", peer("1999")
    yield "peer_2000.AT2", peer("2000")
    yield "peer_2005.AT2", peer("2005")
    yield "peer_2005.VT2", peer("2005", "VELOCITY")
    yield "knet.EW", nied("E-W", "EW", 4220)
    yield "kiknet.NS2", nied("4", "NS", -10190)
    three = list(enumerate(("NS", "EW", "UD"), 1))
    yield "cosmos.V1c", "".join(cosmos_channel(c, "8F10.3", k, 1) for k, c in three)
    yield "cosmos.V2c", cosmos_channel("EW", "1E15.6", 2, 2)
    kinds = ("acceleration", "velocity", "displacement")
    yield "cosmos_all.V2C", "".join(cosmos_channel(c, "8F10.5", k, 2, q) for k, c in three for q in kinds)
    yield "csmip.V1", "".join(csmip_channel(c, k, "v1") for k, c in three)
    yield "csmip.V2", "".join(csmip_channel(c, k, "v2") for k, c in three)
    yield "csmip_1983.V2", csmip_channel("UD", 3, "v2 1983").replace("\n", "\r\n") + "\x1a" * 8
    yield "esm.HNE.ASC", dyna("EW")
    yield "itaca_g.HNN.ASC", dyna("NS", "g")
    yield "opensees_8.txt", f"# units: g\n# dt: {DT_S}\n" + rows(motion_g(), 8, "11.7f")
    yield (
        "opensees_free.g3",
        "".join(rows(part, part.size, "15.7E") for part in np.split(motion_g(), [1, 4, 11, 40, 100, 290])),
    )
    yield (
        "prose.txt",
        "Acceleration Time-History\nRecord: invented\n\n"
        + table(("Time [sec]", "Acceleration [g]"), (TIME_S, motion_g()), "\t"),
    )
    yield "four_columns.txt", table(
        ("Velocity (cm/sec)", "Time (sec)", "Displacement (cm)", "Acceleration (g)"),
        (0.1 * gal(), TIME_S, 0.01 * gal(), motion_g()), "   ",
    )  # fmt: skip
    yield (
        "three_components.csv",
        table(("time_s", "NS (gal)", "EW (gal)", "UD (gal)"), (TIME_S, *(gal(c) for _, c in three)), ","),
    )
    yield (
        "tabelle.csv",
        ("\ufeff" + table(("Zeit [s]", "Beschleunigung [m/s²]"), (TIME_S, 0.01 * gal()), ";", True)).encode(
            "utf-16-le"
        ),
    )


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, content in examples():
        data = content if isinstance(content, bytes) else content.encode()
        (FOLDER / name).write_bytes(data)
