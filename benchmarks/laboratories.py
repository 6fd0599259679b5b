"""How right are a test in a laboratory and what is said of it? Random laboratories of aps400_laboratory, FF+FB.

    python benchmarks/laboratories.py FILE --count 30                 play laboratories 0 to 29, keep a line of each
    python benchmarks/laboratories.py FILE --count 30 --sensors all   with a displacement sensor and a load cell
    python benchmarks/laboratories.py FILE --count 300 --spread 2     true spreads twice the declared ones
    python benchmarks/laboratories.py FILE --set KEY=VALUE ...        with other settings of the case, a file for each
    python benchmarks/laboratories.py --summary FILE...               figures of the lines that are there

A laboratory that has its line is not played again. Each is identified, checked and played with method `best`; refused
ones are played all the same. Errors are those of the true accelerations of the worst storey in the test band against
SIM of the declared computed storeys below the specimen as it is, over the error of SIM-DELAY of the same building.
`floor` is that of a test which knows everything but the mean error of the accelerometers' gains and that of the masses:
its exact solution by scipy.signal.lsim.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from options import arguments, parsed
from scipy.signal import StateSpace, lsim
from scipy.stats import kstest

from rths_cli.analysis.grade import GOOD, POOR, USABLE, GradeLimits, grade_of
from rths_cli.analysis.metrics import rms, test_band
from rths_cli.analysis.references import reference_of
from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array
from rths_cli.rigs.from_case import true_values, true_values_of_run

SHORT = ("lines.jsonl", "--count", "1")

GAIN, MASS = 0.01, 0.003  # spreads of aps400_laboratory
FURTHER = (
    "table.channels=[{kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95, "
    "sensitivity_uncertainty: 0.002, use: guard}, {kind: force, position: table, unit: N, sensitivity_v_per_unit: "
    "0.02, range: 450, sensitivity_uncertainty: 0.005, plate_mass_kg: 1.5, use: [guard, shear]}]"
)
RUN = (1,)  # names the noise of the identification's run


def settings_of(number: int, sensors: str, spread: float, further: Sequence[str]) -> list[str]:
    """Return what a laboratory overrides in a case."""
    found = ["table=aps400_laboratory", f"seed={number}", "runs=[sim, sim_delay, exp_rths]", *further]
    if spread != 1.0:
        imperfections = "table.imperfections"
        found += [
            f"{imperfections}.channels.gain_error={{std: {GAIN * spread}}}",
            f"{imperfections}.masses.weighing_error={{std: {MASS * spread}}}",
        ]
    return [*found, FURTHER] if sensors == "all" else found


def played(case: str, number: int, sensors: str, spread: float, further: Sequence[str] = ()) -> dict[str, Any]:
    """Return the figures of one laboratory, or why it has none."""
    line: dict[str, Any] = {"case": case, "number": number, "sensors": sensors, "spread": spread}
    began = time.monotonic()
    try:
        setup = make_setup(load_cases([case], settings_of(number, sensors, spread, further))[0], ("check", "model"))
        with tempfile.TemporaryDirectory() as folder:
            path, memory = Path(folder) / "result.h5", Memory()
            ended = run_case(setup, path, memory, "laboratories.py", lambda _: None, series="none")
            result = read_result(path)
        line["deviations"] = deviations(setup, memory.identify(setup, lambda _: None))
    except RthsError as error:
        return {**line, "failed": str(error)}
    found = {name: np.asarray(value).tolist() for name, value in result.metrics.items() if name.startswith(KEPT)}
    line |= {"status": ended.status, "verdict": str(result.attributes.get("check_verdict", "")), "metrics": found}
    return {**line, "floor": floor(setup), "seconds": round(time.monotonic() - began, 1)}


KEPT = (
    "exp_rths.rms_error",
    "exp_rths.true_",
    "exp_rths.mass_over_declared",
    "exp_rths.stiffness_",
    "exp_rths.error_over",
    "sim_delay.",
    "sim.rms",
    "check.",
    "calibration.",
)


def deviations(setup: Setup, found: Identification) -> dict[str, list[float]]:
    """Return what was identified less the truth, in standard uncertainties; nothing of a rig whose sensors are as
    declared."""
    if found.calibration is None:
        return {}
    values = true_values(setup.case, setup.rig) | true_values_of_run(
        setup.case, setup.rig, (setup.case.identification.seed, *RUN)
    )
    if "channels.skew_s" not in values:
        return {}
    channels, calibration = setup.rig.channels, found.calibration
    c = len(channels)  # the values of further channels stand behind those of the accelerometers
    values = {key: value[:c] if key.startswith("channels.") else value for key, value in values.items()}
    lag_s = np.array([1.0 / (2.0 * np.pi * channel.low_pass_hz) for channel in channels])
    lags = -values["channels.skew_s"] + lag_s * (1.0 / (1.0 + values["channels.low_pass_error"]) - 1.0)
    gains = values["channels.gain_error"] + values["channels.gain_change_between_runs"]
    masses = values["masses.weighing_error"]
    truth = np.concatenate([np.log1p(gains), np.log1p(values["channels.high_pass_error"]), lags, np.log1p(masses)])
    logs = [np.log(calibration.gain), np.log(calibration.coupling), calibration.late_s, np.log(calibration.mass)]
    off, each = np.concatenate(logs) - truth, np.eye(len(truth))
    wanted = {
        "gain": each[:c],
        "gain over that of the table": each[1:c] - each[0],
        "AC corner": each[c : 2 * c],
        "AC corner over that of the table": each[c + 1 : 2 * c] - each[c],
        "lag after the table": each[2 * c + 1 : 3 * c] - each[2 * c],
        "mass": each[3 * c :],
        "mass over that of the first floor": each[3 * c + 1 :] - each[3 * c],
    }
    return {name: [float(row @ off) / calibration.error_of(row) for row in rows] for name, rows in wanted.items()}


def floor(setup: Setup) -> float:
    """Return the error of the exact solution with the laboratory's mean gain error and mean mass error."""
    building, dt, accel = setup.building, setup.rig.dt_s, setup.motion.accel_m_s2
    values = true_values(setup.case, setup.rig)
    gain, mass = (float(np.mean(values[key])) for key in ("channels.gain_error", "masses.weighing_error"))
    reference = reference_of(building)
    sim = reference.sim(building, dt, accel)
    late = reference.sim_delay(building, dt, accel, setup.case.delay_s, sim)
    right, wrong = _exact(building, dt, accel, 0.0, 0.0), _exact(building, dt, accel, gain, mass)
    delayed = rms(test_band(late.abs_accel_m_s2 - sim.abs_accel_m_s2, dt))
    return float(np.max(rms(test_band(wrong - right, dt)) / delayed))


def _exact(building: Any, dt_s: float, accel: Array, gain: float, mass: float) -> Array:
    """Return true accelerations (n, samples) of a test with one computed storey whose sensors read 1 + gain of the
    truth and whose floors weigh 1 + mass of what is taken."""
    m, k, c = building.specimen.masses_kg, building.specimen.K, building.specimen.C
    computed, n = float(building.numerical.masses_kg[0]), len(m)
    share = np.full(n, (1.0 + gain) / (1.0 + mass))
    interface = (
        np.concatenate([[-float(building.K[0].sum())], share @ k, [-float(building.C[0].sum())], share @ c]) / computed
    )
    a, b = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 1))
    a[: n + 1, n + 1 :] = np.eye(n + 1)
    a[n + 1], b[n + 1] = interface, -1.0
    nothing = np.zeros((n, 1))
    floors = np.hstack([nothing, -k / m[:, None], nothing, -c / m[:, None]])
    a[n + 2 :] = floors - interface / (1.0 + gain)
    outputs = np.vstack([interface / (1.0 + gain), floors])
    time_s = np.arange(len(accel)) * dt_s
    return np.asarray(lsim(StateSpace(a, b, outputs, np.zeros((n + 1, 1))), accel, time_s)[1].T)


def told(lines: list[dict[str, Any]]) -> None:
    """Print the figures of lines of one kind."""
    good = [line for line in lines if line.get("status") == "complete"]
    print(f"{len(lines)} laboratories, {len(good)} complete; refused by the check: "
          f"{sum(line['verdict'] != 'safe' for line in good)}")  # fmt: skip
    for line in lines:
        if line not in good:
            print(f"  {line['case']} {line['number']}: {line.get('failed', line.get('status'))}"[:200])
    ratios = np.array([np.max(line["metrics"]["exp_rths.true_reference_ratio"]) for line in good])
    floors = np.array([line["floor"] for line in good])
    within = ratios <= 1.2 * np.hypot(floors, 0.04)
    print(f"error: median {np.median(ratios):.4f}, 90 % {np.quantile(ratios, 0.9):.4f}, largest {ratios.max():.4f}; "
          f"floor: median {np.median(floors):.4f}, 90 % {np.quantile(floors, 0.9):.4f}; "
          f"error <= 1.2 sqrt(floor^2 + 0.04^2): {within.sum()} of {len(good)}")  # fmt: skip
    _after_run(good)
    figures = [_bounded(line["metrics"]) for line in good if "check.true_error_bound_m_s2" in line["metrics"]]
    if figures:
        true, median, bound, measured, predicted = np.array(figures).T
        print(f"bound holds in {np.sum(true <= bound)} of {len(figures)}; median bound / median error "
              f"{np.median(bound) / np.median(true):.2f}; predicted median / median error "
              f"{np.median(median) / np.median(true):.2f}")  # fmt: skip
        over = measured / predicted
        print(f"measured within 1.5 of predicted: {np.mean(np.abs(np.log(over)) <= np.log(1.5)):.3f}; "
              f"10, 50, 90 % of measured / predicted {np.quantile(over, (0.1, 0.5, 0.9)).round(3)}")  # fmt: skip
    for name in good[0]["deviations"] if good else ():
        each = np.concatenate([line["deviations"][name] for line in good])
        print(f"{name}: {np.mean(np.abs(each) <= 2.0):.3f} within 2 standard uncertainties, rms {rms(each):.2f}")
    name = "exp_rths.true_error_rank"
    ranks = [float(np.mean(line["metrics"][name])) for line in good if name in line["metrics"]]
    if ranks:
        print(f"ranks of true errors: Kolmogorov-Smirnov p {kstest(ranks, 'uniform').pvalue:.3f}")


WORDS = (POOR, USABLE, GOOD)


def _after_run(good: Sequence[Mapping[str, Any]]) -> None:
    """Print how often true errors are above the bound and below the median that are stated after a run, of its worst
    storey, and how often the word is better than they deserve."""
    name, limits = "exp_rths.true_error_{}_percent", GradeLimits()
    above = below = better = stated = 0
    for line in good:
        metrics = line["metrics"]
        found = grade_of(metrics, limits)
        if found is None or "exp_rths.true_reference_nrmse_percent" not in metrics:
            continue
        true = np.asarray(metrics["exp_rths.true_reference_nrmse_percent"])
        worst = found.storey - 1
        stated += 1
        above += bool(np.any(true > np.asarray(metrics[name.format("bound")])))
        below += bool(true[worst] < found.median)
        known = grade_of({name.format(kind): true for kind in ("bound", "median")}, limits)
        better += known is not None and WORDS.index(found.grade) > WORDS.index(known.grade)
    if stated:
        print(f"after the run: true error above the bound in {above} of {stated}, below the median in {below}; word "
              f"better than the true error deserves in {better}")  # fmt: skip


def _bounded(metrics: Mapping[str, Any]) -> tuple[float, ...]:
    """Return true error, its predicted median and bound, measured error and what was predicted of it, of one storey:
    that with the largest bound over SIM-DELAY."""
    late = np.asarray(metrics["sim_delay.true_reference_rms_error_m_s2"])
    place = int(np.argmax(np.asarray(metrics["check.true_error_bound_m_s2"]) / late))
    names = (
        "exp_rths.true_reference_rms_error_m_s2", "check.true_error_m_s2", "check.true_error_bound_m_s2",
        "exp_rths.rms_error_m_s2", "check.expected_error_m_s2",
    )  # fmt: skip
    return tuple(float(np.asarray(metrics.get(name, np.full(late.shape, np.nan)))[place]) for name in names)


def _kind(line: Mapping[str, Any]) -> tuple[str, str, float]:
    return line["case"], line["sensors"], line["spread"]


def main() -> int:
    """Play or tell; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--summary", action="store_true")
    parser.add_argument("--case", default="el_centro_low_ff_fb")
    parser.add_argument("--seed", "--first", dest="first", type=int, default=0)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--sensors", choices=("accelerometers", "all"), default="accelerometers")
    parser.add_argument("--spread", type=float, default=1.0)
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE")
    asked = parsed(parser, SHORT)
    kept = [json.loads(text) for path in asked.files if path.exists() for text in path.read_text().splitlines()]
    if not asked.summary:
        done = {(line["case"], line["number"], line["sensors"], line["spread"]) for line in kept}
        for number in range(asked.first, asked.first + asked.count):
            if (asked.case, number, asked.sensors, asked.spread) not in done:
                kept.append(played(asked.case, number, asked.sensors, asked.spread, asked.set))
                with asked.files[0].open("a") as file:
                    file.write(json.dumps(kept[-1]) + "\n")
    for kind in sorted({_kind(line) for line in kept}):
        print(f"{kind[0]}; sensors: {kind[1]}; true spread over declared: {kind[2]:g}")
        told([line for line in kept if _kind(line) == kind])
    return 0


if __name__ == "__main__":
    sys.exit(main())
