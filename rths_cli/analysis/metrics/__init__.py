"""The metrics of a run: errors, tracking fidelity, the 2020 benchmark's criteria, energy.

Time is the last axis of every array. docs/background/metrics.md states formula, source and sign of each metric.
"""

from rths_cli.analysis.metrics.benchmark2020 import (
    ResponseCriteria,
    TrackingCriteria,
    best_lag_s,
    response_criteria,
    tracking_criteria,
    tracking_ratios,
)
from rths_cli.analysis.metrics.energy import error_energy_j, input_energy_j, velocity_error_m_s
from rths_cli.analysis.metrics.fidelity import (
    FrequencyEvaluation,
    frequency_evaluation,
    frequency_evaluations,
    low_lines,
    tracking_indicator,
)
from rths_cli.analysis.metrics.response_errors import (
    BAND_ORDER,
    SLOW_ORDER,
    ErrorFigures,
    error_figures,
    figures_of_pairs,
    fitted_delay_s,
    fitted_delays_s,
    high_passed,
    peak,
    rms,
    room_for_pairs,
    test_band,
)

__all__ = [
    "BAND_ORDER",
    "SLOW_ORDER",
    "ErrorFigures",
    "FrequencyEvaluation",
    "ResponseCriteria",
    "TrackingCriteria",
    "best_lag_s",
    "error_energy_j",
    "error_figures",
    "figures_of_pairs",
    "fitted_delay_s",
    "fitted_delays_s",
    "frequency_evaluation",
    "frequency_evaluations",
    "high_passed",
    "input_energy_j",
    "low_lines",
    "peak",
    "response_criteria",
    "rms",
    "room_for_pairs",
    "test_band",
    "tracking_criteria",
    "tracking_indicator",
    "tracking_ratios",
    "velocity_error_m_s",
]
