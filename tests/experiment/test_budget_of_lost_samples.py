"""The error by cause of a run whose samples did not all come: a virtual run with forged losses tells the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.predicted_error import PredictionInputs
from rths_cli.analysis.sim import Response, simulate
from rths_cli.case.load import load_cases
from rths_cli.experiment import run_metrics
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run
from rths_cli.experiment.run_signals import Series, on_record_clock, whole_building
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.loop.realtime_loop import IN_RAMP_DOWN, IN_RUN
from rths_cli.quantities import Values
from rths_cli.report.case_metric_tables import budget
from rths_cli.report.to_text import text as printed

FLOORS = 2
FIGURES = {
    "table_gain_error": "table_gain_error_uncertainty",
    "table_delay_error_s": "table_delay_error_uncertainty_s",
    "friction_v": "friction_uncertainty_v",
}


@dataclass(frozen=True)
class Ran:
    """A virtual run, and what its budget is made of."""

    setup: Setup
    known: PredictionInputs
    series: Series
    sim: Response

    def figures(self, lost: np.ndarray, measured: np.ndarray | None = None, **live: np.ndarray) -> Values:
        """Return the budget of the run as one in real time: lost as in its file, `measured` in place of its samples."""
        kept, n = self.series, lost.size
        told = {"late_s": np.zeros(n), "exchange_s": np.zeros(n), "state": np.full(n, float(IN_RUN)), "lost": lost}
        series = replace(kept, measured=kept.measured if measured is None else measured, live=told | live)
        return run_metrics.of_exp_rths(self.known, series, self.reported(series), self.sim)[0]

    def reported(self, series: Series) -> np.ndarray:
        case, motion = self.setup.case, self.setup.motion
        return whole_building(self.setup.building, series, motion.accel_m_s2, motion.dt_s, case.integration)[2]


def played(memory: Memory, case: str, *settings: str) -> Ran:
    setup = make_setup(load_cases([case], settings)[0], ("check",))
    found = memory.identify(setup, lambda _: None)
    design, dt = design_blocks(setup, found), setup.rig.dt_s
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    series = on_record_clock(outcome, design.blocks.lead_samples, dt, len(setup.motion.time_s))
    known = judge(setup, found, design).known
    assert known is not None
    return Ran(setup, known, series, simulate(setup.building, dt, setup.motion.accel_m_s2))


@pytest.fixture(scope="module")
def ran(memory: Memory) -> Ran:
    return played(memory, "el_centro_low_ff_fb", "table.after_identification.coulomb_factor=2")


@pytest.fixture(scope="module")
def short(memory: Memory, tmp_path_factory: pytest.TempPathFactory) -> Ran:
    folder = tmp_path_factory.mktemp("short")
    time_s = np.arange(0.0, 3.0, 0.01)
    accel = 2.0 * np.sin(6 * np.pi * time_s) * np.sin(np.pi * time_s / 3.0) ** 2
    (folder / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{x:.6g}" for x in accel) + "\n")
    (folder / "a.yaml").write_text("structure: three_storey\ndamping: low\nrecord: ./short.csv\ncontroller: FF+FB\n")
    return played(memory, str(folder / "a.yaml"), "scaling=0.3", "record_filter={corner_hz: 0}")


def losses(n: int, count: int, longest: int, seed: int = 0) -> np.ndarray:
    random, lost = np.random.default_rng(seed), np.zeros(n)
    for first in random.integers(10, n - longest, count):
        lost[first : first + random.integers(1, longest + 1)] = 1.0
    return lost


def bridged(ran: Ran, lost: np.ndarray) -> np.ndarray:
    """Return the samples with what the loop puts in the place of lost ones: desired, and floors in a straight line."""
    measured, floors = ran.series.measured.copy(), ran.series.estimated[2 * FLOORS : 3 * FLOORS]
    measured[0, lost > 0] = ran.series.desired[0, lost > 0]
    for k in np.flatnonzero(lost):
        measured[1:, k] = 2.0 * floors[:, k - 1] - floors[:, k - 2]
    return measured


def value(figures: Values, name: str) -> float:
    return float(np.max(np.asarray(figures[f"budget.{name}"])))


def assert_alike(clean: Values, lossy: Values) -> None:
    """The figures agree within three of their standard uncertainties, and those are no excuse."""
    for name, off in FIGURES.items():
        sure = np.hypot(value(clean, off), value(lossy, off))
        assert abs(value(lossy, name) - value(clean, name)) < 3.0 * sure, name
        assert value(lossy, off) < {"friction_v": 2e-5, "table_delay_error_s": 2e-5}.get(name, 1e-3)


@pytest.mark.campaign
@parametrize_first(1, ("count", "longest"), [(60, 1), (60, 5), (10, 40)])
def test_forged_losses_leave_the_figures_what_they_are(ran: Ran, count: int, longest: int) -> None:
    n = ran.series.command_v.size
    clean, lost = ran.figures(np.zeros(n)), losses(n, count, longest)
    lossy = ran.figures(lost, bridged(ran, lost))
    assert_alike(clean, lossy)
    for cause in ("model", "friction", "coupling", "latency", "declared"):
        assert value(lossy, f"rms_error_{cause}_m_s2") == pytest.approx(
            value(clean, f"rms_error_{cause}_m_s2"), rel=0.1, abs=1e-4
        )
    assert "budget.rms_error_lost_m_s2" not in clean
    assert value(lossy, "rms_error_lost_m_s2") > 0.0
    assert value(lossy, "unexplained_rms_m_s2") < 1e-4


@pytest.mark.campaign
def test_late_samples_and_ramps_are_left_out_like_lost_ones(ran: Ran) -> None:
    n, dt_s = ran.series.command_v.size, ran.setup.rig.dt_s
    lost = losses(n, 40, 5)
    nowhere, wrong = np.zeros(n), bridged(ran, lost) + 3.0 * lost
    by_loss = ran.figures(lost, wrong)
    late = ran.figures(nowhere, wrong, late_s=np.where(lost > 0, 0.6 * dt_s, 0.4 * dt_s))
    ramp = ran.figures(nowhere, wrong, state=np.where(lost > 0, float(IN_RAMP_DOWN), float(IN_RUN)))
    unmarked = ran.figures(nowhere, wrong)
    for name in FIGURES:
        assert value(late, name) == value(by_loss, name) == value(ramp, name) != value(unmarked, name)


def test_a_short_record_is_not_told_a_delay_by_its_end(short: Ran) -> None:
    """Fitted to its end, where the series break off, the same run is a millisecond early; the table is as it was."""
    n = short.series.command_v.size
    found = short.figures(np.zeros(n))
    assert abs(value(found, "table_delay_error_s")) < 4e-5
    assert abs(value(found, "table_gain_error")) < 1e-3
    assert value(found, "table_delay_error_uncertainty_s") < 2e-5
    lost = losses(n, 15, 2)
    lossy = short.figures(lost, bridged(short, lost))
    assert abs(value(lossy, "table_delay_error_s")) < 4e-5 + 3.0 * value(lossy, "table_delay_error_uncertainty_s")


def test_a_record_of_which_little_is_left_names_no_figure_that_it_does_not_know(short: Ran) -> None:
    n = short.series.command_v.size
    lost = np.ones(n)
    lost[::50] = 0.0
    found = short.figures(lost, bridged(short, lost))
    text = printed([budget(dict(found))])
    assert "not significant (within" in text and "not enough of the record is left" in " ".join(text.split())
    assert f"{1e6 * value(found, 'table_delay_error_s'):+.1f}" not in text
