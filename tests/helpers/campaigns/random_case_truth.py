"""What is true of a test on a virtual rig, from its hidden physics, and whether a sentence of the program agrees."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.sim import Response, simulate
from rths_cli.analysis.stability_check import Stability, stability
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.experiment.check_command import Verdict
from rths_cli.experiment.design import Design, required_delay_s
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import Identification
from rths_cli.identification.table_fit import within
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.rigs.from_case import true_building
from rths_cli.rigs.virtual.plant import accelerations, continuous
from rths_cli.structure import modes

GOOD = 0.1  # error over SIM's RMS, of the worst storey, below which a test is worth running
NEAR = 1.25  # a figure that is off by less than this factor counts as right
BAND_HZ, MOST_RMS = (0.7, 11.0), 0.01  # of a model that may drive a table
MID_HZ, MOST_RMS_MID = (2.0, 10.0), 0.004
MOST_FRICTION = 0.03  # change of the response by friction of known size
CHECKED_HZ = 40.0  # where the check stops looking
EXCITED_HZ = (0.3, 60.0)
NOMINAL_VELOCITY_M_S = 0.06  # rms of the table under the default excitation, where no level is known
POOR_BITS = 20.0  # rms of a channel over its bit: from there on rounding alone is several per cent of a sample
LEFT = r"displacement|velocity|acceleration beyond|force beyond|end stop|command beyond"
LINES_HZ = np.arange(0.1, 80.0, 0.05)


@dataclass(frozen=True)
class Played:
    """What an EXP-RTHS did: why it stopped ("": it did not), its true and its measured error over SIM's RMS, worst
    storey (NaN: it was stopped). The true one is that of the true accelerations against SIM of the declared numerical
    storeys below the specimen as it is."""

    stopped: str
    error: float
    measured: float


@dataclass(frozen=True)
class Truth:
    """A test with its hidden physics; `identified` and `design` are what the program made of it, `played` how it went
    when it was run whatever the verdict (None each where there was none)."""

    setup: Setup
    identified: Identification | None = None
    design: Design | None = None
    played: Played | None = None

    @cached_property
    def modes_hz(self) -> Array:
        """Return the specimen's natural frequencies on a fixed base."""
        specimen = self.setup.building.specimen
        return modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)[0]

    @cached_property
    def sim(self) -> Response:
        """Return the exact response of the whole building."""
        return simulate(self.setup.building, self.setup.rig.dt_s, self.setup.motion.accel_m_s2)

    @cached_property
    def sim_as_it_is(self) -> Response:
        """Return the exact response of the declared numerical storeys below the specimen as it is."""
        building = true_building(self.setup.case, self.setup.building) or self.setup.building
        return simulate(building, self.setup.rig.dt_s, self.setup.motion.accel_m_s2)

    @cached_property
    def shares(self) -> dict[str, float]:
        """Return the peaks of SIM at the interface as shares of the table's limits."""
        setup, sim, limits = self.setup, self.sim, self.setup.rig.limits
        floor = len(setup.building.numerical.masses_kg) - 1
        accel = sim.abs_accel_m_s2[floor:]
        moving = setup.rig.moving_mass_kg
        range_m_s2 = min(min(c.range, setup.rig.converters.range_v / c.sensitivity_v_per_unit)
                         for c in setup.rig.channels)  # fmt: skip
        place = sim.rel_disp_m[floor] + setup.motion.displacement_m
        speed = sim.rel_vel_m_s[floor] + setup.motion.velocity_m_s
        stroke = min(limits.stroke_m, setup.rig.gain_m_per_v * setup.rig.converters.range_v)
        force = np.concatenate([[moving], setup.floor_masses_kg]) @ accel
        braked = place + 0.5 * speed * np.abs(speed) / (0.45 * limits.acceleration_m_s2)
        return {
            "displacement": float(max(np.abs(place).max(), np.abs(braked).max())) / stroke,
            "velocity": float(np.abs(speed).max()) / limits.velocity_m_s,
            "acceleration": float(np.abs(accel).max()) / min(limits.acceleration_m_s2, range_m_s2),
            "force": float(np.abs(force).max()) / limits.force_n,
        }

    @cached_property
    def bits(self) -> float:
        """Return the least of the channels' rms in bits of their converter, in SIM."""
        floor = len(self.setup.building.numerical.masses_kg) - 1
        step = max(self.setup.rig.converters.step_v, 1e-12)
        bit = max(step / channel.sensitivity_v_per_unit for channel in self.setup.rig.channels)
        return float(rms(self.sim.abs_accel_m_s2[floor:]).min()) / bit

    def linear(self, velocity_m_s: float, frictionless: bool = False) -> ComplexArray:
        """Return the table's true response at LINES_HZ, friction as the dashpot of the same mean power at a velocity
        (rms): c = sqrt(2 / pi) F_c / velocity, Roberts and Spanos, section 5.3."""
        physics = self.setup.case.table.physics
        added = 0.0 if frictionless else np.sqrt(2.0 / np.pi) * physics.coulomb_n / velocity_m_s
        damped = physics.model_copy(update={"viscous_n_s_per_m": physics.viscous_n_s_per_m + added})
        building = self.setup.building
        a, b_u, b_n, *_ = continuous(damped, building.specimen, building.interface_experimental_mass_kg)
        rows, _ = accelerations(a, b_n, len(self.setup.floor_masses_kg))
        s = 2j * np.pi * LINES_HZ
        states = np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b_u[:, None].astype(complex))
        x = np.pi * LINES_HZ * self.setup.rig.dt_s
        delay = (self.setup.rig.latency_samples + 0.5) * self.setup.rig.dt_s
        return np.asarray((rows[0] @ states)[:, 0] * np.exp(-s * delay) * np.sin(x) / x)

    @cached_property
    def velocity_m_s(self) -> float:
        """Return the table's rms velocity under excitation."""
        friction = self.identified.friction if self.identified else None
        return friction.velocity_rms_m_s if friction else NOMINAL_VELOCITY_M_S

    @cached_property
    def friction_share(self) -> float:
        """Return by how much friction changes the table's response under excitation, rms over BAND_HZ."""
        inside = within(LINES_HZ, BAND_HZ)
        ratio = self.linear(self.velocity_m_s) / self.linear(self.velocity_m_s, frictionless=True)
        return float(np.sqrt(np.mean(np.abs(ratio[inside] - 1.0) ** 2)))

    def model_error(self, band_hz: tuple[float, float] = BAND_HZ) -> float:
        """Return the identified model's error against the true response, friction linearised, rms over a band."""
        assert self.identified is not None
        inside = within(LINES_HZ, band_hz)
        ratio = self._model.response(LINES_HZ) / self.linear(self.velocity_m_s)
        return float(np.sqrt(np.mean(np.abs(ratio[inside] - 1.0) ** 2)))

    @cached_property
    def paper_error(self) -> float:
        """Return the error of method `paper`'s own model against the true response, friction linearised, rms over
        BAND_HZ; 0 where nothing was identified."""
        inside = within(LINES_HZ, BAND_HZ)
        if self.identified is None:
            return 0.0
        ratio = self.identified.paper.response(LINES_HZ) / self.linear(self.velocity_m_s)
        return float(np.sqrt(np.mean(np.abs(ratio[inside] - 1.0) ** 2)))

    @property
    def _model(self) -> Model:
        assert self.identified is not None
        return self.identified.best

    @cached_property
    def stability(self) -> Stability | None:
        """Return the stability of the designed loop on the true table; None without a design."""
        identified, design, setup = self.identified, self.design, self.setup
        if identified is None or design is None or identified.specimen is None:
            return None
        rig = identified_rig(identified.best, identified.specimen.specimen, setup.rig, setup.removes_sensors)
        storeys = all_storeys(setup.building.numerical, setup.rig.dt_s, setup.case.integration)
        ones = np.ones(len(LINES_HZ))
        true = Frf(LINES_HZ, self.linear(self.velocity_m_s) + self._model.alias(LINES_HZ), ones, 1e-6 * ones, 100)
        samples = len(setup.motion.time_s)
        gain = setup.rig.uncertainty.table_gain
        return stability(
            rig, design.blocks, storeys, identified.best, true, samples, identified.levels, gain_uncertainty=gain
        )

    @property
    def failed(self) -> bool:
        """Tell whether the test, run whatever the verdict, was stopped or had an error that makes it worthless."""
        return self.played is not None and (bool(self.played.stopped) or not self.played.error < GOOD)


def _margin(truth: Truth) -> bool:
    found = truth.stability
    return found is not None and (found.radius >= 1.0 or found.tolerates < NEAR * found.required)


def _delay_margin(truth: Truth) -> bool:
    found, identified, design = truth.stability, truth.identified, truth.design
    if found is None or identified is None or design is None:
        return False
    return found.measured.delay_margin_s < NEAR * required_delay_s(truth.setup, identified, design.blocks)


def _model_off(truth: Truth) -> bool:
    limits = ((BAND_HZ, MOST_RMS), (MID_HZ, MOST_RMS_MID))
    return truth.failed or (
        truth.identified is not None and any(truth.model_error(band) > most / NEAR for band, most in limits)
    )


def _outside(truth: Truth) -> bool:
    options = truth.setup.case.identification
    low, high = max(EXCITED_HZ[0], options.low_hz), min(EXCITED_HZ[1], options.high_hz)
    return bool(np.any((truth.modes_hz < 2.0 * low) | (truth.modes_hz > high / 1.5)))


def _reach(truth: Truth) -> bool:
    """The check speaks of the test's own motion: SIM's, and what an error of the controller adds to it. Where the test,
    run all the same, was stopped because it left a limit of the table, it was right as well."""
    stopped = truth.played is not None and re.search(LEFT, truth.played.stopped) is not None
    return stopped or max(truth.shares.values()) > 0.9 / NEAR


def _unseen(truth: Truth) -> bool:
    floor = len(truth.setup.building.numerical.masses_kg) - 1
    accel, dt = truth.sim.abs_accel_m_s2[floor], truth.setup.rig.dt_s
    lines = np.fft.rfft(accel)
    lines[np.fft.rfftfreq(len(accel), dt) > CHECKED_HZ] = 0.0
    return float(np.abs(np.fft.irfft(lines, len(accel))).max()) < (1.0 - 0.1 / NEAR) * float(np.abs(accel).max())


RULES: tuple[tuple[str, str, Callable[[Truth], bool]], ...] = (
    ("paper's model", r"method paper: its model", lambda truth: truth.paper_error > MOST_RMS / NEAR),
    ("controller", r"no feedback|Riccati", lambda truth: truth.identified is not None and not _model_off(truth)),
    ("scheme", r"is unstable at dt = ", lambda truth: True),
    ("unstable", r"closed loop is unstable", lambda truth: truth.failed or _margin(truth)),
    ("margin", r"tolerates only .* error of the table", _margin),
    ("delay margin", r"of further delay", _delay_margin),
    ("apart", r"differs so much from its model", _model_off),
    ("reach", r"is predicted, the limit is", _reach),
    ("unseen", r"peak acceleration lies above", _unseen),
    ("band", r"(lies|lie|mode).*(below|above|outside)", _outside),
    ("resolution", r"resol|converter", lambda truth: truth.failed or truth.bits < POOR_BITS),
    ("friction", r"friction:|dry friction|one of friction", lambda truth: truth.friction_share > MOST_FRICTION / NEAR),
    ("fit", r"table model", _model_off),
    ("noise", r"nothing but noise|coherence", lambda truth: truth.bits < POOR_BITS),
    ("channels", r"sign|swapped|reads|chain|dead|clipped|sensitivit|out of step|moves .* mm/V", lambda truth: False),
)  # fmt: skip


def judge(sentence: str, truth: Truth) -> tuple[str, bool]:
    """Return the kind of a reason and whether it is true of the test; one that no rule knows counts as false."""
    for kind, pattern, holds in RULES:
        if re.search(pattern, sentence):
            return kind, bool(holds(truth))
    return "unknown", False


def loop_figures(truth: Truth, found: Identification, checked: Verdict) -> dict[str, float]:
    """Return the margins of the designed loop as checked and as they truly are, and how well the model is known where
    the loop is the most sensitive; nothing without a design."""
    if checked.design is None or truth.stability is None:
        return {}
    figures = {name: float(np.asarray(checked.figures[f"check.{name}"])) for name in (
        "spectral_radius", "tolerated_table_error", "required_table_error", "table_error_hz", "delay_margin_s",
        "tolerated_table_error_in_band", "table_error_in_band_hz")}  # fmt: skip
    true, frf, model = truth.stability, found.frfs[0], found.best
    at = figures["table_error_hz"]
    lines = within(frf.frequency_hz, (at - 0.25, at + 0.25))
    level = [abs(band.ratio - 1.0) for band in found.levels if band.low_hz <= at <= band.high_hz]
    response = model.response(LINES_HZ) / truth.linear(truth.velocity_m_s) - 1.0
    return figures | {
        "true_radius": true.radius,
        "true_tolerates": true.tolerates,
        "true_required": true.required,
        "true_hz": true.at_hz,
        "true_delay_margin_s": true.measured.delay_margin_s,
        "true_model_error": float(np.interp(at, LINES_HZ, np.abs(response))),
        "line_error": float(np.mean(frf.relative_error[lines])) if lines.any() else float("nan"),
        "lines": float(lines.sum()),
        "fit_error": found.best_error.rms,
        "fit_largest": found.best_error.largest,
        "delay_error_s": found.latency.error_s if found.latency else float("nan"),
        "delay_off_s": found.latency.identified_s - found.latency.declared_s if found.latency else float("nan"),
        "level": max(level, default=float("nan")),
        "band_hz": model.band_hz[1],
        "accepted": float(found.accepted),
    }
