"""The printed tables: hand-made numbers must stand where a reader looks for them, and nothing may be dropped."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up import LOW, SUFFIXES, figures, paper_cases, result

from rths_cli.errors import InputError
from rths_cli.report.result_tables import tables, to_json


def block(text, title):
    """Return the lines of the table whose title starts so, without the title."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(title))
    start = next(i for i in range(start, len(lines)) if lines[i].startswith("---"))
    stop = next((i for i in range(start, len(lines)) if not lines[i]), len(lines))
    return lines[start:stop]


def row(text, title, label, after=""):
    """Return the cells of the row that starts with a label, below a heading that contains `after`."""
    lines = block(text, title)
    start = next(i for i, line in enumerate(lines) if after in line)
    line = next(line for line in lines[start:] if line.split("|")[0].strip() == label)
    return line.split("|", 1)[1].replace("|", " ").split()


def test_table_5_1_shows_published_paper_and_best_side_by_side():
    lines = block(
        tables(paper_cases()), "Table 5.1  Tracking error (m/s^2), test band, measured; virtual shake table aps400"
    )
    assert lines == [
        "--------------------------------------------------------------------------------------------------",
        "       |                        (1) Shake table test|                                    (2) RTHS|",
        "       |     published|         paper|          best|     published|         paper|          best|",
        "control|    max    RMS|    max    RMS|    max    RMS|    max    RMS|    max    RMS|    max    RMS|",
        "--------------------------------------------------------------------------------------------------",
        "30 % el_centro, damping low                                                                      |",
        "FF     | 0.0376 0.0030| 0.0100 0.0024| 0.0050 0.0012| 0.1007 0.0058| 0.0180 0.0026| 0.0090 0.0013|",
        "FF+FB  | 0.0086 0.0004| 0.0100 0.0012| 0.0050 0.0006| 0.1922 0.0027| 0.0190 0.0014| 0.0095 0.0007|",
        "30 % el_centro, damping high                                                                     |",
        "FF     |             -| 0.0100 0.0024| 0.0050 0.0012|             -| 0.0180 0.0026| 0.0090 0.0013|",
        "FF+FB  |             -| 0.0100 0.0012| 0.0050 0.0006|             -| 0.0190 0.0014| 0.0095 0.0007|",
        "--------------------------------------------------------------------------------------------------",
    ]


def test_true_and_full_band_tracking_errors_follow():
    text = tables(paper_cases())
    title, low = "Table 5.1, more  Tracking error (m/s^2), true and full band; virtual", "damping low"
    assert row(text, title, "FF, true", low)[:4] == ["0.0090", "0.0022", "0.0045", "0.0011"]
    assert row(text, title, "FF, full band, measured", low)[-2:] == ["0.0180", "0.0026"]
    assert row(text, title, "FF+FB, full band, true", low)[-2:] == ["0.0285", "0.0021"]


def test_table_5_2_shows_both_dampings_and_ff_after_ff_fb():
    text = tables(paper_cases())
    lines = block(text, "Table 5.2, FF+FB  RMS error to SIM (m/s^2), test band, measured; virtual shake table aps400")
    assert lines[1:4] == [
        "      |                              damping low|                             damping high|",
        "      |       SIM-DELAY|                EXP-RTHS|       SIM-DELAY|                EXP-RTHS|",
        "storey|   publ.    ours|   publ.   paper    best|   publ.    ours|   publ.   paper    best|",
    ]
    assert lines[5:-1] == [
        "30 % el_centro                                                                            |",
        "1     |  0.0236  0.0800|  0.0158  0.0016  0.0008|  0.0297  0.0500|  0.0023  0.0005  0.0003|",
        "2     |  0.1050  0.1200|  0.0466  0.0024  0.0012|  0.0759  0.1000|  0.0428  0.0010  0.0005|",
        "3     |  0.1228  0.1600|  0.0615  0.0032  0.0016|  0.0913  0.1000|  0.0500  0.0010  0.0005|",
    ]
    assert text.index("Table 5.2, FF+FB") < text.index("Table 5.2, FF ")
    ff = row(text, "Table 5.2, FF  RMS error to SIM (m/s^2), test band", "2")
    assert ff == ["-", "0.1200", "-", "0.0048", "0.0024", "-", "0.1000", "-", "0.0020", "0.0010"]


def test_table_5_2_true_and_full_and_the_ratio():
    text = tables(paper_cases())
    more = row(text, "Table 5.2, FF+FB  RMS error to SIM (m/s^2), true and full band; virtual", "3")
    assert more[:6] == ["0.0029", "0.0064", "0.0096", "0.0014", "0.0032", "0.0048"]
    ratio = row(text, "Table 5.2, FF+FB  EXP-RTHS / SIM-DELAY", "1")
    assert ratio == ["0.6695", "0.0200", "0.0180", "0.0100", "0.0090", "0.0774", "0.0100", "0.0090", "0.0050", "0.0045"]


def table_blocks(text):
    """Return the lines of every table, of one in parts those of each part."""
    blocks, inside = [], False
    for line in text.replace("-\n-", "-\n\n-").splitlines():
        if line.startswith("---") and not inside:
            blocks.append([])
            inside = True
        if inside and not line:
            inside = False
        if inside:
            blocks[-1].append(line)
    return blocks


def mixed_cases():
    """Return cases in every kind of trouble."""
    cases = paper_cases()
    aborted, diverged, failed = cases[1], cases[4], cases[7]
    for key in [key for key in aborted.metrics if key.startswith("exp_rths.")]:
        del aborted.metrics[key]
    aborted.attributes.update(status="aborted", status_reason="displacement 0.081 m is above 0.079 m at 3.2 s")
    for one in (cases[0], diverged):
        one.metrics.update({"sim_delay.rms_error_m_s2": np.full(3, np.nan), "sim_delay.diverged_at_s": 3.25})
    failed.metrics.clear()
    failed.attributes.update(status="failed", status_reason="the link broke")
    del cases[6]
    return cases


def test_what_did_not_end_well_is_shown_as_such():
    text = tables(mixed_cases())
    tracking = "Table 5.1  "
    assert row(text, tracking, "FF+FB", "damping low") == [
        *("0.0086", "0.0004", "0.0100*", "0.0012*", "0.0050", "0.0006"),
        *("0.1922", "0.0027", "aborted", "0.0095", "0.0007"),
    ]
    assert row(text, tracking, "FF+FB", "damping high")[3:4] == ["failed"]
    assert row(text, tracking, "FF", "damping high") == [
        *("-", "0.0100", "0.0024", "-", "-", "0.0180", "0.0026", "-"),
    ]
    ff = "Table 5.2, FF  "
    assert row(text, ff + "RMS error to SIM (m/s^2), test band", "1")[:5] == ["-", "diverged", "-", "0.0032", "0.0016"]
    assert row(text, ff + "EXP-RTHS / SIM-DELAY", "1")[:3] == ["-", "diverged", "diverged"]
    both = row(text, "Table 5.2, FF+FB  RMS error to SIM (m/s^2), test band", "1")
    assert both == ["0.0236", "0.0800", "0.0158", "aborted", "0.0008", "0.0297", "0.0500", "0.0023", "0.0005", "failed"]
    assert "el_centro_low_ff_fb (paper): aborted: displacement 0.081 m is above 0.079 m at 3.2 s" in text
    assert "el_centro_high_ff_fb (best): failed: the link broke" in text
    assert "el_centro_low_ff (best): sim_delay diverged at 3.25 s" in text


def test_a_case_that_no_method_ran_has_its_row_and_column():
    text = tables([case for k, case in enumerate(paper_cases()) if k not in (3, 7)])  # high, FF+FB
    assert row(text, "Table 5.1  ", "FF+FB", "damping high") == ["-"] * 6
    assert len(row(text, "Table 5.2, FF  RMS error to SIM (m/s^2), test band", "1")) == 10
    only_low = [case for k, case in enumerate(paper_cases()) if k in (1, 3, 5)]  # best, high was not run
    assert row(tables(only_low), "Table 5.2, FF+FB  EXP-RTHS / SIM-DELAY", "2")[-1] == "-"


@pytest.mark.parametrize("made", [paper_cases, mixed_cases, lambda: paper_cases()[:1], lambda: paper_cases()[1::4]])
def test_lines_of_a_table_have_one_width_of_at_most_100_and_are_ascii(made):
    text = tables(made())
    blocks = table_blocks(text)
    assert blocks
    for lines in blocks:
        assert len({len(line) for line in lines}) == 1, lines
    assert max(len(line) for line in text.splitlines()) <= 100
    assert text.isascii()


def test_virtual_stands_in_every_title_and_only_there():
    def titles(text):
        return [line for line in text.splitlines() if line.startswith(("Table", "30 % el", "The paper's claims"))]

    found = [title for title in titles(tables(paper_cases())) if not title.endswith("|")]
    found = [title for title in found if ";" in title]
    assert len(found) == 9 and all("virtual shake table aps400" in title for title in found)
    real = paper_cases()
    for one in real:
        one.attributes["rig_kind"] = "udp"
    text = tables(real)
    assert "virtual" not in text and "true" not in text.lower()
    assert row(text, "Table 5.2, FF+FB  RMS error to SIM (m/s^2), full band", "1")[:2] == ["0.0032", "0.0016"]


def test_virtual_and_hardware_results_never_share_a_table():
    virtual, real = paper_cases()[:4], paper_cases()[:4]
    for one in real:
        one.attributes["rig_kind"] = "udp"
    text = tables([*virtual, *real])
    assert text.count("Table 5.1  ") == 2 and text.count("test band, measured; virtual shake table") == 3
    assert text.count("The paper's claims") == 2


def test_one_case_alone_is_printed_whole():
    case = paper_cases()[5]
    case.metrics["exp_rths.max_error_m_s2"] = [0.011, 0.012, 0.013]
    for path, value, unit in (("identification.fit_error", 0.0042, "1"), ("loop.delay_s", -0.0021, "s")):
        case.metrics[path], case.units[path], case.definitions[path] = value, unit, "made up"
    lines = tables([case]).splitlines()
    assert lines[:10] == [
        "30 % el_centro, damping low, controller FF+FB: errors (m/s^2, test band unless full); virtual shake",
        "table aps400",
        "----------------------------------------------------------------",
        "                     |        |                            best|",
        "                     |   publ.|   meas.    true    full  full-t|",
        "----------------------------------------------------------------",
        "Tracking error of the table: desired - measured acceleration   |",
        "shake table test, max|  0.0086|  0.0050  0.0045  0.0100  0.0150|",
        "shake table test, RMS|  0.0004|  0.0006  0.0005  0.0012  0.0018|",
        "RTHS, max            |  0.1922|  0.0095  0.0086  0.0190  0.0285|",
    ]
    assert "SIM-DELAY, storey 3  |  0.1228|  0.1600       -  0.3200       -|" in lines
    assert "EXP-RTHS, storey 3   |  0.0615|  0.0016  0.0014  0.0032  0.0048|" in lines
    assert "storey 3             |  0.5008|  0.0100  0.0090  0.0100  0.0150|" in lines
    assert "EXP-RTHS, storey 1   |       -|  0.0110       -       -       -|" in lines
    squeezed = [" ".join(line.split()) for line in lines]
    assert "identification.fit_error 1 0.0042" in squeezed
    assert "loop.delay_s ms -2.100" in squeezed


def test_a_case_of_one_s_own_has_no_column_of_published_figures():
    """Nor the words that explain it; what was run stands as it does beside published figures."""
    case = paper_cases()[5]
    own = replace(case, attributes={**case.attributes, "reference_json": "{}"})
    beside, alone = tables([case], brief=True).splitlines(), tables([own], brief=True).splitlines()
    assert [line.replace("|", " ").split() for line in alone[3:5]] == [["best"], ["meas.", "true", "full", "full-t"]]
    cut = [line[:21] + line[30:] for line in beside if line.startswith(("EXP-RTHS, storey", "storey"))]
    assert len(cut) >= 6 and [line for line in alone if line.startswith(("EXP-RTHS, storey", "storey"))] == cut
    assert not any("publ." in line for line in alone) and any("Published (publ.)" in line for line in beside)


@pytest.mark.parametrize("count", [1, 5])
def test_any_number_of_storeys(count):
    delayed = [0.1 + k / 100 for k in range(count)]
    cases = [result(figures((0.1, 0.1, 0.1, 0.1), delayed, delayed), controller=name) for name in ("FF", "FF+FB")]
    cases[0].metrics["sim_delay.rms_error_m_s2"] = delayed if count > 1 else delayed[0]
    text = tables(cases)
    for storey in range(count):
        cells = row(text, "Table 5.2, FF  RMS error to SIM (m/s^2), test band", str(storey + 1))
        assert cells[1] == f"{delayed[storey]:.4f}"
    labels = [line.split("|")[0].strip() for line in block(text, "Table 5.2, FF  EXP")]
    assert str(count) in labels and str(count + 1) not in labels


def test_more_than_two_dampings_go_on_in_a_further_table():
    names = [("a", 0.01), ("b", 0.03), ("c", 0.02)]
    cases = [
        result(figures((0.1,) * 4, LOW, LOW), damping=name, damping_first_mode_ratio=ratio) for name, ratio in names
    ]
    text = tables(cases)
    heads = [line for line in text.splitlines() if line.lstrip().startswith("|") and "damping" in line]
    assert [head.replace("|", " ").split() for head in heads] == [
        *[["damping", "a", "damping", "c"]] * 3,
        *[["damping", "b"]] * 3,
    ]


def test_a_sim_delay_that_differs_between_methods_is_told():
    cases = [
        result(figures((0.1,) * 4, delayed, LOW), method=method)
        for method, delayed in (("paper", (0.0777, 0.12, 0.16)), ("best", LOW))
    ]
    assert "(paper): SIM-DELAY is 0.0777, 0.1200, 0.1600" in tables(cases)


def test_references_by_case_name_go_before_stored_ones():
    text = tables(paper_cases(), {"el_centro_low_ff": {"shake_table.tracking_max_m_s2": 0.0444}})
    assert row(text, "Table 5.1  ", "FF")[:2] == ["0.0444", "0.0030"]


def test_no_results_is_an_input_error():
    with pytest.raises(InputError, match="no results"):
        tables([])


def test_json_has_every_metric_by_its_path_and_null_for_nan():
    case = result({"exp_rths.rms_error_m_s2": np.array([0.1, np.nan, np.inf]), "shake_table.tracking_max_m_s2": 0.5})
    document = json.loads(json.dumps(to_json([case]), allow_nan=False))
    (one,) = document["results"]
    assert one["metrics"] == {"exp_rths.rms_error_m_s2": [0.1, None, None], "shake_table.tracking_max_m_s2": 0.5}
    assert (one["case_name"], one["method"], one["status"]) == ("el_centro_low_ff_fb", "best", "complete")


PLACES = st.fixed_dictionaries(
    {
        "method": st.sampled_from(["paper", "best"]),
        "record": st.sampled_from(["el_centro", "a_path/to/quite_a_long_name_of_a_record_that_somebody_used.AT2"]),
        "damping": st.sampled_from(["low", "high", "other"]),
        "controller": st.sampled_from(["FF", "FF+FB", "none", "a long name of a controller"]),
        "rig": st.sampled_from(["one", "two"]),
        "scaling": st.sampled_from([0.3, 1.0]),
        "case_name": st.sampled_from(["x", "y"]),
        "status": st.sampled_from(["complete", "complete", "aborted", "interrupted", "failed", "refused"]),
    }
)


@settings(max_examples=60, deadline=None)
@given(st.lists(PLACES, min_size=1, max_size=7), st.integers(1, 4))
def test_no_figure_of_any_result_is_dropped(places, storeys):
    count, cases, expected = 0, [], []

    def fresh():
        nonlocal count
        count += 1
        expected.append(f"{count / 10000:.4f}")
        return count / 10000

    for place in places:
        metrics = {"sim_delay.rms_error_m_s2": [fresh() for _ in range(storeys)]}
        for suffix in SUFFIXES:
            for name in ("shake_table.tracking_max", "shake_table.tracking_rms", "exp_rths.tracking_rms"):
                metrics[f"{name}_m_s2{suffix}"] = fresh()
            metrics[f"exp_rths.rms_error_m_s2{suffix}"] = [fresh() for _ in range(storeys)]
        cases.append(result(metrics, **place))
    text = tables(cases)
    shown = text.replace("|", " ").replace("*", " ").replace(",", " ").split()
    assert not set(expected) - set(shown)
    ends = [f"{p['case_name']} ({p['method']}): {p['status']}:" for p in places if p["status"] != "complete"]
    for end in set(ends):
        assert text.count(end) == ends.count(end)
    assert max(len(line) for line in text.splitlines()) <= 100
    for lines in table_blocks(text):
        assert len({len(line) for line in lines}) == 1
