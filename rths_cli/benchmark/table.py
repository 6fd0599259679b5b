"""A benchmark of cases on virtual tables: each compensator takes the place of the case's controller, and `rths run`'s
sequence plays it: identify, design, check, EXP-RTHS. A row per run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.benchmark.ran import Ran
from rths_cli.case.benchmark_schema import BenchmarkCompensator, TableBenchmarkSpec, TableCase
from rths_cli.case.compensator_schema import OWN, STATE_SPACE
from rths_cli.case.load import PlacedSettings, WrittenCase, load_written, read_case
from rths_cli.control.compensator import definition_of
from rths_cli.errors import InputError, RthsError
from rths_cli.experiment import run_metrics
from rths_cli.experiment.one_table_run import play_run, run_of, true_accelerations
from rths_cli.studies.sweep_runs import Shared

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.numerics.lti import Array
    from rths_cli.studies.sweep_runs import Ready

PLAIN = ("none", "FF", "FF+FB")
"""Controllers of every case, which are no compensators of the registry."""
ROW = ("error_percent", "peak_percent", "tracking_percent", "sim_percent", "radius")
"""The numbers of a run. True motion of the worst storey against SIM with the specimen as it is: RMS and peak of the
difference over those of SIM, in the test band (the error of the test); the table's true tracking error over the desired
motion; the error as measured, against SIM as declared; spectral radius of the loop by the check (NaN: not judged)."""
COMMON = ("runs=[sim, exp_rths]", "reference=null", "accept={}")


@dataclass(frozen=True)
class TableCompensator:
    """A compensator of the table: its label, the value of the key `controller`, and whether its parameters move."""

    label: str
    controller: str
    adapts: bool


@dataclass(frozen=True)
class TableBenchmark:
    """A benchmark of cases on virtual tables; `settings` hold for every case."""

    spec: TableBenchmarkSpec
    settings: tuple[str, ...] = ()

    figures = ROW
    tracked = "tracking_percent"

    def designed(self, stated: BenchmarkCompensator) -> TableCompensator:
        """Return a compensator of the table, its options checked; raises InputError. Each case designs it anew."""
        for key in ("predict_force", "frozen"):
            if getattr(stated, key):
                raise InputError(f"{key}: belongs to the loop displacement; remove it")
        if stated.kind in PLAIN:
            return TableCompensator(stated.label, stated.kind, adapts=False)
        keys: dict[str, Any] = {"kind": stated.kind, "lead_samples": stated.lead_samples, **stated.options}
        if stated.file is not None:
            keys |= {"file": str(stated.file.absolute())} | ({"sha256": stated.sha256} if stated.sha256 else {})
        adapts = False
        if stated.kind != STATE_SPACE:
            definition = definition_of(stated.kind, stated.file if stated.kind == OWN else None, stated.sha256)
            definition.values(stated.options)
            adapts = bool(definition.adapts)
        return TableCompensator(stated.label, json.dumps(keys), adapts)

    def facts(self) -> dict[str, Any]:
        """Return what decides the rows beside the benchmark's file; raises InputError for a case that cannot be
        played."""
        found, faults = {}, []
        for case in self.spec.cases:
            try:
                setup = self._shared.setup(self._case(case.name, "none", 0))
                content = repr((self._shared.keys(setup).content, setup.record_sha256))
                found[case.name] = sha256(content.encode()).hexdigest()
            except InputError as error:
                faults += [f"case {case.name}: {fault}" for fault in error.faults]
        if faults:
            raise InputError(*faults)
        return {"settings": self.settings, "cases_sha256": found}

    def tasks(self, designed: Sequence[TableCompensator]) -> Iterator[tuple[TableCompensator, str, int]]:
        """Yield the runs in their order: neighbours share table, model and SIM."""
        for case in self.spec.cases:
            for index in range(self.spec.plants):
                yield from ((one, case.name, index) for one in designed)

    def played(self, designed: TableCompensator, case: str, index: int, seed: int) -> Ran:
        """Return how a run went, that of plant `index` of a seed: what cannot be played says why."""
        nothing = dict.fromkeys(ROW, math.nan)
        try:
            with self._lock:
                ready = self._shared.ready(self._case(case, designed.controller, seed + index))
        except RthsError as error:
            return Ran(nothing, f"refused: {_without_option(str(error))}")
        radius = float(np.asarray(ready.figures.get("check.spectral_radius", math.nan)))
        figures = nothing | {"radius": radius}
        if ready.plan is None or ready.sim is None:
            return Ran(figures, f"refused: {_without_option(ready.refused)}")
        return _played(ready, seed + index, figures)

    def _case(self, name: str, controller: str, seed: int) -> Case:
        written, case = self._written[name]
        stated = (*case.settings, *COMMON, *self.settings, f"seed={seed}", f"controller={controller}")
        return load_written(written, PlacedSettings(stated, Path.cwd()))

    @cached_property
    def _written(self) -> dict[str, tuple[WrittenCase, TableCase]]:
        return {case.name: (read_case(case.case), case) for case in self.spec.cases}

    @cached_property
    def _shared(self) -> Shared:
        return Shared((), lambda _: None)

    @cached_property
    def _lock(self) -> Lock:
        return Lock()


def _played(ready: Ready, seed: int, figures: dict[str, float]) -> Ran:
    """Play a run that is ready and return its numbers."""
    plan, sim, setup = ready.plan, ready.sim, ready.setup
    assert plan is not None and sim is not None
    outcome = play_run(plan, seed)
    run = run_of(outcome, setup, plan.kind, plan.design.blocks.lead_samples, plan.expected)
    true, measured = true_accelerations(run, setup), run.abs_accel_m_s2
    if run.stopped is not None or true is None or measured is None:
        return Ran(figures, f"stopped: {run.stopped.reason if run.stopped else 'no true motion is known'}")
    reference = sim.abs_accel_m_s2 if ready.truth is None else ready.truth.sim_accel
    assert run.series.true_accel is not None
    error, peak = _relative(ready, reference, true)
    tracking, _ = _relative(ready, run.series.desired[:1], run.series.true_accel[:1])
    declared, _ = _relative(ready, sim.abs_accel_m_s2, measured)
    return Ran({
        "error_percent": error, "peak_percent": peak, "tracking_percent": tracking, "sim_percent": declared,
        "radius": figures["radius"],
    })  # fmt: skip


def _relative(ready: Ready, reference: Array, motion: Array) -> tuple[float, float]:
    """Return RMS and peak of the difference between accelerations (n_storeys, n), of the worst storey in percent of the
    reference, in the test band."""
    setup = ready.setup
    place = setup.rig.dt_s, run_metrics.lowest_reliable_hz(setup), None, setup.case.test_band_hz
    errors = run_metrics.errors("exp_rths", None, (reference, motion, None), *place)
    dt_s, lowest_hz, _, band_hz = place
    percent = run_metrics.relative_errors("exp_rths", errors, reference, dt_s, lowest_hz, band_hz)
    return float(np.max(percent["exp_rths.nrmse_percent"])), float(np.max(percent["exp_rths.peak_error_percent"]))


def _without_option(reason: str) -> str:
    """Return a refusal without the option by which the compensator was put into the case."""
    return reason.replace("--set controller: ", "").replace("--set controller", "controller")
