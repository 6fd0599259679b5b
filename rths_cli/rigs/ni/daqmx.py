"""Calls of NI-DAQmx: tasks, voltage ranges and sample clock of a card; every fault as one sentence.

Input and output run on one sample clock in the mode hardware-timed single point: at each edge the card samples its
inputs and puts out what was written last. The package has no name for the wait for that edge
(DAQmxWaitForNextSampleClock), so it is called in the driver's library, which the package has loaded.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from rths_cli.errors import RigError
from rths_cli.numerics.lti import Array

MISSED = frozenset((209802, -209802, -209803, -201027))  # one clock missed, or three and more
RATE_ERROR = 2e-5  # of the sample rate that a card may divide from its time base: 1.2 ms in a minute
WIRINGS = {
    "default": "DEFAULT",
    "rse": "RSE",
    "nrse": "NRSE",
    "differential": "DIFF",
    "pseudodifferential": "PSEUDO_DIFF",
}
INSTALL = "pip install 'rths-cli[ni]'"


@dataclass(frozen=True)
class Wiring:
    """What is connected where: names of the card's terminals, all voltages within +-range_v."""

    device: str
    command_channel: str
    terminals: tuple[str, ...]
    enable_line: str
    kind: str
    range_v: float
    rate_hz: float
    timeout_s: float


class Card:
    """The tasks of one rig on a card; every method raises RigError, `who` begins its sentence."""

    def __init__(self, wiring: Wiring, who: str) -> None:
        self._who = who
        self._timeout_s = wiring.timeout_s
        self._tasks: list[Any] = []
        with self._told():
            self._nidaqmx = _package(who)
            _check_device(self._nidaqmx, wiring, who)
            self.is_hardware = _is_hardware(self._nidaqmx, wiring.device)
            try:
                self._make_tasks(wiring)
            except BaseException:
                self.close()
                raise

    def start(self) -> None:
        """Put out 0 V, start output and input, enable motion."""
        with self._told():
            self._writer.write_one_sample(0.0, self._timeout_s)
            self._output.start()  # waits for the clock of the input
            self._input.start()
            if self._enable is not None:
                self._enable.write_one_sample_one_line(True, self._timeout_s)

    def wait(self) -> bool:
        """Wait for the next edge of the sample clock; tell whether one was missed."""
        code = self._wait(self._input._handle, self._timeout_s, ctypes.byref(self._late))
        if code in MISSED:
            return True
        if code < 0:
            with self._told():
                self._input._interpreter.check_for_error(code)
        return bool(self._late.value)

    def read(self, samples: Array) -> None:
        """Read what was sampled at the last edge in V, (n_channels,)."""
        with self._told():
            self._reader.read_one_sample(samples, self._timeout_s)

    def write(self, command_v: float) -> None:
        """Hand over what the card puts out from the next edge on, in V."""
        with self._told():
            self._writer.write_one_sample(command_v, self._timeout_s)

    def stop(self) -> None:
        """Disable motion and stop the tasks; the output keeps its last voltage."""
        with self._told():
            try:
                if self._enable is not None:
                    self._enable.write_one_sample_one_line(False, self._timeout_s)
            finally:
                self._input.stop()
                self._output.stop()

    def close(self) -> None:
        """Let go of the card; safe to call twice."""
        while self._tasks:
            with self._told():
                self._tasks.pop().close()

    def _make_tasks(self, wiring: Wiring) -> None:
        n, device = self._nidaqmx, wiring.device
        span = {"min_val": -wiring.range_v, "max_val": wiring.range_v}
        single = n.constants.AcquisitionType.HW_TIMED_SINGLE_POINT
        self._input, self._output = self._task(), self._task()
        config = n.constants.TerminalConfiguration[WIRINGS[wiring.kind]]
        for terminal in wiring.terminals:
            self._input.ai_channels.add_ai_voltage_chan(f"{device}/{terminal}", terminal_config=config, **span)
        self._output.ao_channels.add_ao_voltage_chan(f"{device}/{wiring.command_channel}", **span)
        self._input.timing.cfg_samp_clk_timing(wiring.rate_hz, sample_mode=single)
        self._output.timing.cfg_samp_clk_timing(wiring.rate_hz, f"/{device}/ai/SampleClock", sample_mode=single)
        self._enable = self._enabling(wiring)
        _check_rate(float(self._input.timing.samp_clk_rate), wiring.rate_hz, self._who)
        self._reader = n.stream_readers.AnalogMultiChannelReader(self._input.in_stream)
        self._reader.verify_array_shape = False  # it asks the driver at every call
        self._writer = n.stream_writers.AnalogSingleChannelWriter(self._output.out_stream, auto_start=False)
        self._wait, self._late = _wait_function(self._who), ctypes.c_uint32(0)

    def _task(self) -> Any:
        self._tasks.append(self._nidaqmx.Task())
        return self._tasks[-1]

    def _enabling(self, wiring: Wiring) -> Any:
        """Return the writer of the line that enables motion, low from now on; None where none is wired."""
        if not wiring.enable_line:
            return None
        task = self._task()
        task.do_channels.add_do_chan(f"{wiring.device}/{wiring.enable_line}")
        writer = self._nidaqmx.stream_writers.DigitalSingleChannelWriter(task.out_stream)
        writer.write_one_sample_one_line(False, self._timeout_s)
        return writer

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn faults of package and driver into RigError."""
        try:
            yield
        except RigError:
            raise
        except Exception as error:
            raise RigError(f"{self._who}: {_sentence(error)}") from error


def _package(who: str) -> Any:
    """Return the package nidaqmx with what is used of it; raises RigError when it is not installed."""
    try:
        import nidaqmx
        import nidaqmx.constants
        import nidaqmx.stream_readers
        import nidaqmx.stream_writers
        import nidaqmx.system
    except ImportError as error:
        raise RigError(f"{who}: needs the package nidaqmx ({error}); install it: {INSTALL}") from error
    return nidaqmx


def _is_hardware(nidaqmx: Any, device: str) -> bool:
    """Tell whether the driver's library is a real one, and the card no simulated one."""
    from nidaqmx._lib import lib_importer

    library = getattr(lib_importer.windll, "_library", None)
    return isinstance(library, ctypes.CDLL) and not nidaqmx.system.Device(device).is_simulated


def _check_device(nidaqmx: Any, wiring: Wiring, who: str) -> None:
    """Raise RigError unless the card is there, can do hardware-timed single point, and is fast enough."""
    known = nidaqmx.system.System.local().devices.device_names
    if wiring.device not in known:
        listed = f"the driver knows {', '.join(known)}" if known else "the driver knows none"
        raise RigError(f"{who}: there is no device {wiring.device}, {listed}; correct ni.device or look into NI MAX")
    device = nidaqmx.system.Device(wiring.device)
    single = nidaqmx.constants.AcquisitionType.HW_TIMED_SINGLE_POINT
    lacking = [what for what, modes in (("inputs", _modes(device, "ai")), ("outputs", _modes(device, "ao")))
               if single not in modes]  # fmt: skip
    if lacking:
        raise RigError(
            f"{who}: the analogue {' and '.join(lacking)} of {wiring.device} have no hardware-timed single point, "
            "which a control loop needs; use a card that has it (most PCIe and PXIe multifunction cards, no USB device)"
        )
    fastest = min(device.ai_max_multi_chan_rate / len(wiring.terminals), device.ao_max_rate)
    if wiring.rate_hz > fastest:
        raise RigError(f"{who}: {wiring.device} samples at most at {fastest:g} Hz; lower sample_rate_hz")


def _modes(device: Any, part: str) -> list[Any]:
    """Return the sample modes of the inputs or outputs, none where the device has no such part."""
    with suppress(Exception):
        return list(getattr(device, f"{part}_samp_modes"))
    return []


def _check_rate(actual_hz: float, wanted_hz: float, who: str) -> None:
    if not math.isclose(actual_hz, wanted_hz, rel_tol=RATE_ERROR):
        raise RigError(
            f"{who}: the card samples at {actual_hz:.6f} Hz in place of {wanted_hz:g} Hz; "
            "choose a sample_rate_hz that divides its time base"
        )


def _wait_function(who: str) -> Any:
    """Return DAQmxWaitForNextSampleClock(task, timeout in s, late) of the library that the package has loaded."""
    from nidaqmx._lib import lib_importer

    try:
        function = lib_importer.windll.DAQmxWaitForNextSampleClock
    except Exception as error:
        raise RigError(f"{who}: this NI-DAQmx cannot wait for a sample clock; update the driver") from error
    function.argtypes = [lib_importer.task_handle, ctypes.c_double, ctypes.POINTER(ctypes.c_uint32)]
    return function


def _sentence(error: Exception) -> str:
    """Return a fault of the package as the end of one sentence."""
    if type(error).__name__ in ("DaqNotFoundError", "DaqNotSupportedError"):
        return "the driver NI-DAQmx is not installed on this machine; install it from ni.com (nidaqmx installdriver)"
    if type(error).__name__ == "DaqFunctionNotSupportedError":
        return "this NI-DAQmx lacks a function that is needed; update the driver"
    text = " ".join(str(error).split("\n\n")[0].split())
    code = getattr(error, "error_code", None)
    return f"NI-DAQmx says: {text[:300]}{f' ({code})' if code is not None else ''}"
