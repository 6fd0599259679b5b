"""A made-up identification: each of its numbers differs from all others, so that each can be found on the page."""

import numpy as np

from rths_cli.experiment.identify_command import About
from rths_cli.findings import stated
from rths_cli.identification.results import (
    Band,
    Candidate,
    ChannelReport,
    FitError,
    Identification,
    LevelBand,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.numerics.lti import Frf, Model
from rths_cli.structure import Specimen, storey_matrix

NAN = float("nan")
ABOUT = About(
    "aps400_virtual",
    "virtual",
    "60 s of noise, 12 s of free vibration, played on the virtual table (seed 3)",
    (("excitation", "noise, 0.3-55 Hz, 2 m/s^2 rms"), ("model file", "table.h5, 3 days old")),
)
MASSES = np.array([6.91, 6.95])
MODEL = Model(
    zeros=np.array([0.0, 0.0, -0.87 + 20.1j, -0.87 - 20.1j]),
    poles=np.array([-0.9 + 19.8j, -0.9 - 19.8j, -60.0 + 70.0j, -60.0 - 70.0j, -103.0 + 0.0j]),
    gain=6.7e3,
    delay_s=0.00075,
    band_hz=(0.5, 58.7),
    ripple_m_s2_per_v=4.0,
    latency_samples=1,
    dt_s=0.0005,
)
PAPER = Model(np.append(MODEL.zeros, -900.0), np.append(MODEL.poles, -2000.0), -1.3e7, 0.0, (0.5, 12.0))


def specimen(frequency_hz=(3.2, 8.4), sigma=1.0, scatter=(0.00031, 0.00047)):
    """Return a specimen of two floors whose numbers are told by frequencies and `sigma`, its uncertainties' factor."""
    stiffness = np.array([7331.57, 7376.42])
    K = storey_matrix(stiffness)
    C = np.array([[23.89, -7.4], [-7.4, 16.6]])
    return SpecimenFit(
        specimen=Specimen(MASSES, K, C),
        stiffness_n_per_m=stiffness,
        dashpots_n_s_per_m=np.array([43.98, -1.799]),
        natural_frequency_hz=np.array(frequency_hz),
        damping_ratio=np.array([0.0431, 0.0392]),
        mode_shapes=np.array([[0.6191, 1.0], [1.0, -0.6155]]),
        stiffness_error_n_per_m=sigma * np.array([0.61, 131.0]),
        frequency_error_hz=sigma * np.array([0.000065, 0.00017]),
        damping_error=sigma * np.array([0.00011, 0.00023]),
        frequency_scatter_hz=np.array(scatter),
        damping_scatter=np.array([0.00052, 0.00074]),
        residual=0.00213,
    )


def response(f, error, scale=1.0):
    """Return what a table with the model's response would show, `error` wrong, in waves."""
    wave = 1.0 + error * np.exp(1j * 3.0 * f)
    return Frf(f, scale * MODEL.sampled_response(f) * wave, 1.0 - 1e-4 * f, 1e-5 * f**1.5, 11)


def identification(reasons=(), warnings=(), **changes):
    """Return an accepted identification, or a rejected one where there are reasons."""
    f = np.arange(10, 1100, 6) / 20.0
    parts = {
        "frfs": (response(f, 0.004), response(f, 0.02, 0.7), response(f, 0.03, 0.4)),
        "noise_floors": (1e-3 * f, None, None),
        "best": MODEL,
        "paper": PAPER,
        "best_error": FitError(0.00412, 0.0163, 0.00231),
        "paper_error": FitError(0.00587, 0.0284, 0.00349),
        "specimen": specimen(),
        "free_vibration": specimen((3.2011, 8.5123), 2.0, (0.0022, 0.0035)),
        "channels": (
            ChannelReport("table", 2.113, 7.643, 0.0, 0.99987),
            ChannelReport("floor_2", 2.884, 10.73, 0.00308, 0.99761, 0.0217, 50.0),
            ChannelReport("floor_3", 3.624, 13.49, None, 0.99834),
        ),
        "candidates": (Candidate("no lag", 6, 4, 10.979), Candidate("one lag", 7, 4, 0.935, chosen=True)),
        "roots": (
            Root("pole", 3.14936, 0.0448, 0.00025, 0.000078),
            Root("pole", 16.388, NAN, 0.0062, NAN),
            Root("zero", 3.20015, 0.0430, NAN, NAN),
        ),
        "residuals": (
            Band(0.7, 2.0, 0.00171, 0.00486, 0.00042, 0.99999),
            Band(2.0, 5.0, 0.00162, 0.00312, 0.00094, 0.99991),
        ),
        "levels": (
            LevelBand(0.7, 2.0, 0.966 * np.exp(-1j * 0.0213), 0.0017),
            LevelBand(2.0, 5.0, 0.988 * np.exp(-1j * 0.0105), 0.0023),
        ),
        "verdict": Verdict(
            not reasons, (0.7, 58.7), 0.00075, 0.0145, tuple(map(stated, reasons)), tuple(map(stated, warnings))
        ),
    }
    return Identification(**(parts | changes))
