"""The latency budget as a user reads it, and the line of the identified delay on the identification page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from made_up_identification import identification

from rths_cli.experiment.identify_command import About
from rths_cli.experiment.model_files import from_groups, to_groups
from rths_cli.identification.results import DelayEstimate
from rths_cli.quantities import LATENCIES
from rths_cli.report.case_metric_tables import ITEMS, latency
from rths_cli.report.identification_page import as_document, page
from rths_cli.report.to_text import text as printed

FREQUENCY = np.array([1.0, 3.0, 5.0, 10.0, 20.0, 100.0])
ESTIMATE = DelayEstimate(7.53e-4, 1.2e-5, 7.5e-4)
NAMES = ("table", "floor_2", "floor_3")


def metrics(lead_s: float = 1e-3) -> dict[str, object]:
    """Return figures whose items are 0.1, 0.2, ... ms, a tenth of each left."""
    delays = {name: 1e-4 * (i + 1) * np.ones(6) for i, name in enumerate(ITEMS)}
    delays["coupling"] = -1e-3 / FREQUENCY
    found: dict[str, object] = {"latency.frequency_hz": FREQUENCY}
    for name, delay in delays.items():
        found[f"latency.{name}_s"], found[f"latency.{name}_left_s"] = delay, 0.1 * delay
    found["latency.total_s"] = sum(delays.values())
    found["latency.left_s"] = 0.1 * sum(delays.values())
    found["latency.compensated_s"] = 0.9 * sum(delays.values())
    return found | {"latency.predicted_s": lead_s, "latency.declared_s": 7.5e-4}


def row(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if line.split("|")[0].strip() == label]
    return line[len(label) :].replace("|", " ")


def test_every_item_of_the_budget_has_its_row() -> None:
    assert list(ITEMS) == list(LATENCIES)
    text = printed([latency(metrics())])
    assert max(len(line) for line in text.splitlines()) <= 100
    assert row(text, "converter").split() == ["0.100"] * 6 + ["prediction", "0.010", "0.010"]
    assert row(text, "Kalman filter").split() == ["0.800"] * 6 + ["prediction", "0.080", "0.080"]
    assert row(text, "AC coupling").split()[:3] == ["-1.000", "-0.333", "-0.200"]
    assert row(text, "AC coupling").split()[-2:] == ["-0.020", "-0.005"]
    assert "sensor correction" in row(text, "sensor low pass")
    assert row(text, "total").split()[0] == f"{0.1 * (1 + 2 + 3 + 4 + 5 + 6 + 8) - 1.0:.3f}"
    assert row(text, "left").split()[4] == f"{0.1 * (2.9 - 0.05):.3f}"


def test_what_takes_an_item_out_is_read_from_the_figures() -> None:
    text = printed([latency(metrics(lead_s=0.0))])
    assert "inverse" in row(text, "hold")
    figures = metrics()
    figures["latency.hold_left_s"] = figures["latency.hold_s"]
    figures["latency.sensor_left_s"] = np.zeros(6)
    text = printed([latency(figures)])
    assert row(text, "hold").split()[6] == "-"
    assert row(text, "sensor low pass").split()[6] == "inverse"


def test_the_identified_total_stands_beside_the_declared_one() -> None:
    assert "0.750 ms declared; none was identified" in printed([latency(metrics())])
    text = printed([latency(metrics() | {"latency.identified_s": 7.53e-4, "latency.identified_error_s": 1.2e-5})])
    assert "0.750 ms declared, 0.753 +- 0.024 ms" in text
    assert "Prediction: 1.000 ms" in text


def test_a_result_without_a_budget_has_no_text() -> None:
    assert latency({}) == []
    assert latency({"latency.converter_s": 5e-4, "latency.hold_s": 2.5e-4}) == []


def test_the_identification_page_and_document_state_the_delay() -> None:
    about = About("aps", "virtual", "made up")
    found = replace(identification(), latency=ESTIMATE)
    (line,) = [line for line in page(found, about).splitlines() if "delay as identified" in line]
    assert "0.753 +- 0.024 ms, 0.75 ms declared" in line
    assert "delay as identified" not in page(identification(), about)
    assert as_document(found, about)["latency"]["error_s"] == 1.2e-5
    assert as_document(identification(), about)["latency"] is None


def test_a_model_file_keeps_the_delay_and_an_older_one_has_none() -> None:
    groups = to_groups(replace(identification(), latency=ESTIMATE), NAMES)
    assert groups["latency"]["identified_s"].units == "s"
    read = {name: {key: item.data for key, item in group.items()} for name, group in groups.items()}
    read = {name: {k: v.item() if np.ndim(v) == 0 else v for k, v in group.items()} for name, group in read.items()}
    assert from_groups(read, NAMES).latency == ESTIMATE
    del read["latency"]
    assert from_groups(read, NAMES).latency is None
