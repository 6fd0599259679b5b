"""A step and a sweep of computed storeys with laws, over those of the same linear storeys."""

from __future__ import annotations

import resource
import statistics
from dataclasses import replace

import numpy as np
from campaigns import step_run

from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.experiment.setup import Setup
from rths_cli.structure import Numerical
from rths_cli.structure.storey_laws import (
    Bilinear,
    BoucWen,
    Clough,
    Cubic,
    ElasticGap,
    Friction,
    Law,
    Maxwell,
    ViscousPower,
    arranged,
)
from speed.growth import tall
from speed.process import rths
from speed.rows import RATIO, Row, alternating_s, seconds_of

STOREYS, PAIRS = 3, 15
YIELD_M = 4e-4  # passed by the storeys of `tall`
STEP_DEMAND, SWEEP_DEMAND = 1.5, 1.6
SEEDS, SWEEP_PAIRS = 250, 3
CASE = "el_centro_low_ff_fb"
LAW = "structure.numerical.law=[{kind: bilinear, yield_displacement_m: 0.002, hardening: 0.05}]"


def laws_rows(setup: Setup, given: step_run.Inputs) -> list[Row]:
    """Compare steps, law by law, then a sweep."""
    return [*step_rows(setup, given), sweep_row()]


def kinds(stiffness_n_per_m: float) -> dict[str, tuple[Law, ...]]:
    """Return a law for each of the computed storeys, by what they are."""
    k = stiffness_n_per_m
    alike: dict[str, Law] = {
        "bilinear": Bilinear(k, YIELD_M, 0.05),
        "Bouc-Wen": BoucWen(k, YIELD_M, 0.05),
        "Clough": Clough(k, YIELD_M, 0.05, 0.4),
        "gap": ElasticGap(k, YIELD_M),
        "friction": Friction(0.2, 1e-4),
        "cubic": Cubic(0.2 * k / YIELD_M**2, 0.01),
        "maxwell": Maxwell(0.3 * k, 50.0),
        **{f"viscous, exponent {p:g}": ViscousPower(4.0, p) for p in (0.3, 0.5, 0.7, 1.5)},
    }
    mixed = {"mixed": (alike["bilinear"], alike["Bouc-Wen"], alike["Clough"])}
    return {name: (law,) * STOREYS for name, law in alike.items()} | mixed


def step_rows(setup: Setup, given: step_run.Inputs) -> list[Row]:
    """Compare the step of three storeys with laws, by turns, with that of the same storeys without."""
    own, linear = setup.building.numerical, tall(setup, given, STOREYS + len(setup.floor_masses_kg))
    differences = np.eye(STOREYS) - np.eye(STOREYS, k=-1)
    chain = differences.T @ differences
    storeys = Numerical(np.full(STOREYS, own.masses_kg[-1]), own.K[-1, -1] * chain, own.C[-1, -1] * chain)
    rows = []
    for name, laws in kinds(float(own.K[-1, -1])).items():
        design = StoreysWithLaws(storeys, arranged(tuple((law,) for law in laws)), setup.rig.dt_s)
        yielding = replace(linear, blocks=replace(linear.blocks, numerical=design))
        for one in (linear, yielding):
            if step_run.bound(one, step_run.fresh(one))() != len(one.drive):
                raise RuntimeError(f"{name}: the run stopped before its end")
        ours, theirs = alternating_s(
            lambda one=yielding: seconds_of(one, step_run.bound),  # type: ignore[misc]
            lambda: seconds_of(linear, step_run.bound),
            PAIRS,
        )
        ratio = statistics.median(one / two for one, two in zip(ours, theirs, strict=True))
        behind = (
            f"shortest {1e9 * min(ours) / len(linear.drive):.0f} against {1e9 * min(theirs) / len(linear.drive):.0f} ns"
        )
        rows.append(Row(f"a step with 3 storeys with laws / linear: {name}", ratio, RATIO, STEP_DEMAND, behind))
    return rows


def sweep_row() -> Row:
    """Compare sweeps of seeds, which share SIM and check, in one process, by turns, by the processor time of all."""
    for settings in ((), ("--set", LAW)):
        rths("sweep", CASE, "--seeds", "2", "--jobs", "1", "--quiet", *settings)
    yielding, linear = alternating_s(
        lambda: _sweep_s("--set", LAW),
        lambda: _sweep_s(),
        SWEEP_PAIRS,
    )
    ratio = statistics.median(one / two for one, two in zip(yielding, linear, strict=True))
    behind = f"{SEEDS} seeds more, {1e3 * min(yielding) / SEEDS:.1f} against {1e3 * min(linear) / SEEDS:.1f} ms a run"
    return Row("a run of a sweep, storey with a law / linear", ratio, RATIO, SWEEP_DEMAND, behind)


def _sweep_s(*settings: str) -> float:
    """Return the processor time of the runs of a sweep: what the command takes beyond two runs."""
    few, many = (
        _processor_s("sweep", CASE, "--seeds", str(n), "--jobs", "1", "--quiet", *settings) for n in (2, SEEDS)
    )
    return many - few


def _processor_s(*words: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    rths(*words)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
