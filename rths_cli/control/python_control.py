"""Convert blocks, models and frequency responses to and from python-control's `control.StateSpace` and `control.FRD`.

Importing python-control takes more than a second and loads pyplot, so only these functions do. Responses are evaluated
here: `control.frequency_response` reads a list of two frequencies as a range.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.control.feedback import sampled_table
from rths_cli.control.state_space import from_roots
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model, StateSpace

if TYPE_CHECKING:
    import control

System = StateSpace | Block | Model | Frf


def to_control(
    system: System, frequency_hz: Array | None = None, dt_s: float | None = None
) -> control.StateSpace | control.FRD:
    """Return a system as python-control has it.

    With `frequency_hz` (n,) a `control.FRD` of its response there; an Frf is one at its own lines. Otherwise a
    `control.StateSpace`: continuous for a StateSpace, discrete with the names of its signals for a Block. A Model has
    one without delay, hold and alias; with `dt_s` in s it is the one on which a feedback is designed: sampled behind a
    hold, delayed by whole samples. Raises InputError for a Model with a delay and neither of the two.
    """
    import control

    if isinstance(system, Frf):
        if frequency_hz is not None:
            raise InputError("frequency_hz: a measured response is known at its own lines only; leave it out")
        return control.FRD(system.response[None, None], 2.0 * np.pi * system.frequency_hz)
    if frequency_hz is not None:
        frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        response = system.response(frequency)
        return control.FRD(response.reshape(*np.shape(response)[:-1] or (1, 1), -1), 2.0 * np.pi * frequency)
    if isinstance(system, Block):
        names = {"inputs": list(system.inputs) or None, "outputs": list(system.outputs) or None, "name": system.name}
        return control.ss(system.A, system.B, system.C, system.D, system.dt_s, **names)
    if isinstance(system, StateSpace):
        return control.ss(system.A, system.B, system.C, system.D)
    if dt_s is not None:
        sampled = sampled_table(system, dt_s)
        return control.ss(sampled.A, sampled.B, sampled.C, sampled.D, dt_s)
    if system.delay_s > 0.0:
        raise InputError(
            f"the model's delay of {1e3 * system.delay_s:.4g} ms has no state space in continuous time; give dt_s for "
            "its samples, or frequency_hz for its response"
        )
    return to_control(from_roots(system.zeros, system.poles, system.gain))


def from_control(system: control.StateSpace | control.TransferFunction | control.FRD) -> StateSpace | Block | Frf:
    """Return a system of python-control as ours: StateSpace in continuous time, Block in discrete time, Frf of an FRD.

    A transfer function of one input and output is realised from its roots, not in python-control's companion form,
    which loses the digits of a table with specimen. Of an FRD nothing is known but the response: coherence 1, error 0,
    one average. Raises InputError for what has no such form.
    """
    import control

    if isinstance(system, control.FRD):
        _check_single(system)
        frequency = np.asarray(system.omega, dtype=float) / (2.0 * np.pi)
        response = np.asarray(system.frdata[0, 0], dtype=complex)
        return Frf(frequency, response, np.ones(len(frequency)), np.zeros(len(frequency)), 1)
    if isinstance(system, control.TransferFunction):
        _check_single(system)
        found = from_roots(*_roots(system))
    elif isinstance(system, control.StateSpace):
        found = StateSpace(*(np.array(matrix, dtype=float) for matrix in (system.A, system.B, system.C, system.D)))
    else:
        raise InputError(f"got a {type(system).__name__}; give a control.StateSpace, TransferFunction or FRD")
    if not system.isdtime(strict=True):
        return found
    if system.dt is True:
        raise InputError("the system is discrete without a sample time; set its dt in s")
    signals = tuple(system.input_labels), tuple(system.output_labels)
    return Block(system.name, found.A, found.B, found.C, found.D, float(system.dt), *signals)


def model_from_control(
    system: control.StateSpace | control.TransferFunction, band_hz: tuple[float, float], delay_s: float = 0.0
) -> Model:
    """Return a table model from a continuous system of one input (V) and output (m/s^2), followed by a delay in s.

    `band_hz`: where the model holds. Raises InputError for a discrete system, and for one with more signals.
    """
    _check_single(system)
    if system.isdtime(strict=True):
        raise InputError("a table model is continuous; got a discrete system")
    return Model(*_roots(system), delay_s, band_hz)


def _check_single(system: Any) -> None:
    """Raise InputError for a system of several inputs or outputs."""
    if (system.ninputs, system.noutputs) != (1, 1):
        raise InputError(f"got {system.ninputs} inputs and {system.noutputs} outputs; give a system of one of each")


def _roots(system: Any) -> tuple[ComplexArray, ComplexArray, float]:
    """Return zeros, poles and gain of a proper system of one input and output; the gain is that at a point far off."""
    zeros, poles = (np.asarray(roots, dtype=complex) for roots in (system.zeros(), system.poles()))
    if len(zeros) > len(poles):
        raise InputError(f"got {len(zeros)} zeros and {len(poles)} poles; a system has at most as many zeros as poles")
    size = np.abs(np.concatenate([zeros, poles])).max(initial=1.0)
    point = 2.0 * size * np.exp(1j)
    shape = np.prod((point - zeros) / (point - poles[: len(zeros)])) / np.prod(point - poles[len(zeros) :])
    return zeros, poles, float(np.real(system(point) / shape))
