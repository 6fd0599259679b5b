"""A made-up driver below the package nidaqmx: the functions of NI's C library that rths uses, and a card behind them.

The package itself runs unchanged: it calls these functions as it calls the library's, with ctypes values and numpy
arrays. The card keeps the rules of hardware-timed single point as NI documents them: at each edge of the sample clock
it samples its inputs and puts out what was written last; a rule that is broken is an error with a number, as there.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from nidaqmx._lib import DaqFunctionImporter, lib_importer

SINGLE_POINT, CONTINUOUS = 12522, 10123
INPUT, OUTPUT, LINE = "input", "output", "line"
TASK_NAME, RATE, NAMES = 0x1276, 0x1344, 0x193B
AI_MODES, AO_MODES, AI_RATE, AO_RATE, SIMULATED = 0x2FDC, 0x2FDD, 0x298D, 0x2997, 0x22CA
NO_DEVICE, NO_ATTRIBUTE, RESERVED, OUT_OF_RANGE, NOT_RUNNING, BAD_ORDER, MISSED, NO_CLOCK = (
    -200220, -200197, -50103, -200077, -200474, -89137, -209802, -200284,
)  # fmt: skip
TEXTS = {
    NO_DEVICE: "Device identifier is invalid.\n\nDevice Specified: DevX",
    NO_ATTRIBUTE: "Specified property is not supported by the device.",
    RESERVED: "The specified resource is reserved. The operation could not be completed as specified.",
    OUT_OF_RANGE: "Requested value is not a supported value for this property.",
    NOT_RUNNING: "Specified operation did not complete, because the specified timeout expired.",
    BAD_ORDER: "Specified route cannot be satisfied: its clock runs already.",
    MISSED: "DAQmx Wait for Next Sample Clock detected one or more missed sample clocks.",
    NO_CLOCK: "Some or all of the samples requested have not yet been acquired.",
}


class Function:
    """One function of the library, as ctypes would hold it."""

    def __init__(self, body: Callable[..., int]) -> None:
        self.body = body
        self.argtypes = self.restype = None

    def __call__(self, *args: Any) -> int:
        return self.body(*[plain(arg) for arg in args])


@dataclass
class FakeTask:
    """One task: what it is made of and whether it runs."""

    name: str
    kind: str = ""
    channels: list[str] = field(default_factory=list)
    span: tuple[float, float] = (0.0, 0.0)
    source: str = ""
    mode: int = 0
    rate_hz: float = 0.0
    runs: bool = False


@dataclass
class FakeCard:
    """A card with a table on it: `start` gives the first samples in V, `advance(v)` those an interval later.

    `late` holds the edges (1 is the first after the start) at which the loop is found too slow: an edge more has
    passed. `breaks_at` is the edge from which on the clock stands still. `done` lists the calls in their order.
    """

    start: Callable[[], Any]
    advance: Callable[[float], Any]
    device: str = "Dev1"
    ai_modes: tuple[int, ...] = (CONTINUOUS, SINGLE_POINT)
    ao_modes: tuple[int, ...] | None = (CONTINUOUS, SINGLE_POINT)
    ai_rate_hz: float = 1e6
    ao_rate_hz: float = 2e6
    divides_hz: float = 100e6
    late: frozenset[int] = frozenset()
    late_as: int = MISSED
    breaks_at: int = 10**9
    tasks: dict[int, FakeTask] = field(default_factory=dict)
    done: list[tuple[Any, ...]] = field(default_factory=list)
    edge: int = 0
    written_v: float = 0.0
    line_high: bool = False
    samples: Any = None
    unread: bool = False

    def of_kind(self, kind: str) -> FakeTask | None:
        return next((task for task in self.tasks.values() if task.kind == kind), None)

    def DAQmxCreateTask(self, name: Any, handle: ctypes.c_void_p) -> int:
        handle.value = 1 + max(self.tasks, default=0)
        self.tasks[handle.value] = FakeTask(text(name) or f"_unnamedTask<{handle.value}>")
        return 0

    def DAQmxClearTask(self, handle: int) -> int:
        self.done.append(("clear", self.tasks.pop(handle).kind))
        return 0

    def DAQmxGetTaskAttribute(self, handle: int, attribute: int, value: Any, size: int = 0) -> int:
        return give_text(self.tasks[handle].name if attribute == TASK_NAME else "", value, size)

    def DAQmxCreateAIVoltageChan(
        self, handle: int, channel: Any, name: Any, config: int, low: float, high: float, units: int, scale: Any
    ) -> int:
        self.done.append(("input", text(channel), config))
        return self._add(handle, INPUT, text(channel), (low, high))

    def DAQmxCreateAOVoltageChan(
        self, handle: int, channel: Any, name: Any, low: float, high: float, units: int, scale: Any
    ) -> int:
        return self._add(handle, OUTPUT, text(channel), (low, high))

    def DAQmxCreateDOChan(self, handle: int, lines: Any, name: Any, grouping: int) -> int:
        return self._add(handle, LINE, text(lines), (0.0, 1.0))

    def _add(self, handle: int, kind: str, channel: str, span: tuple[float, float]) -> int:
        if not channel.startswith(f"{self.device}/"):
            return NO_DEVICE
        if any(task.kind == kind for key, task in self.tasks.items() if key != handle):
            return RESERVED
        task = self.tasks[handle]
        task.kind, task.span = kind, span
        task.channels.append(channel)
        return 0

    def DAQmxCfgSampClkTiming(
        self, handle: int, source: Any, rate_hz: float, edge: int, mode: int, samples: int
    ) -> int:
        task = self.tasks[handle]
        task.source, task.mode = text(source), mode
        task.rate_hz = self.divides_hz / round(self.divides_hz / rate_hz)
        return 0

    def DAQmxGetTimingAttribute(self, handle: int, attribute: int, value: ctypes.c_double) -> int:
        assert attribute == RATE
        value.value = self.tasks[handle].rate_hz
        return 0

    def DAQmxStartTask(self, handle: int) -> int:
        task = self.tasks[handle]
        if task.kind == OUTPUT and (source := self.of_kind(INPUT)) and source.runs:
            return BAD_ORDER  # its first edge would be lost
        task.runs = True
        self.done.append(("start", task.kind))
        if task.kind == INPUT:
            self.edge, self.samples, self.unread = 0, None, False
        return 0

    def DAQmxStopTask(self, handle: int) -> int:
        self.tasks[handle].runs = False
        self.done.append(("stop", self.tasks[handle].kind))
        return 0

    def DAQmxWriteAnalogScalarF64(self, handle: int, auto: int, timeout: float, value: float, reserved: Any) -> int:
        task = self.tasks[handle]
        if not task.span[0] <= value <= task.span[1]:
            return OUT_OF_RANGE
        self.done.append(("write", value))
        self.written_v = value
        return 0

    def DAQmxWriteDigitalLines(
        self, handle: int, count: int, auto: int, timeout: float, layout: int, data: Any, written: Any, reserved: Any
    ) -> int:
        assert auto, "a line on demand is put out by the write itself"
        self.line_high = bool(np.asarray(data).ravel()[0])
        self.done.append(("line", self.line_high))
        return 0

    def DAQmxWaitForNextSampleClock(self, handle: int, timeout_s: float, late: ctypes.c_uint32) -> int:
        task, output = self.tasks[handle], self.of_kind(OUTPUT)
        timed = task.mode == SINGLE_POINT and output is not None and output.mode == SINGLE_POINT
        if not (timed and task.runs and output is not None and output.runs) or self.edge >= self.breaks_at:
            return NOT_RUNNING
        assert output.source == f"/{self.device}/ai/SampleClock" and output.rate_hz == task.rate_hz
        self._pass_edge()
        is_late = self.edge in self.late
        if is_late:
            self._pass_edge()
        late.value = int(is_late)
        return self.late_as if is_late else 0

    def _pass_edge(self) -> None:
        """Pass one edge: what was put out since the last one was written before it."""
        first = self.edge == 0
        volts = self.start() if first else self.advance(self.written_v)
        self.edge, self.samples, self.unread = self.edge + 1, np.array(volts, dtype=float), True

    def DAQmxReadAnalogF64(
        self, handle: int, count: int, timeout: float, fill: int, data: Any, size: int, read: Any, reserved: Any
    ) -> int:
        if not self.unread:
            return NO_CLOCK
        data[:] = self.samples
        read.value, self.unread = 1, False
        return 0

    def DAQmxGetSystemInfoAttribute(self, attribute: int, value: Any, size: int = 0) -> int:
        if attribute == NAMES:
            return give_text(self.device, value, size)
        value.value = 23  # a part of the driver's version
        return 0

    def DAQmxGetDeviceAttribute(self, device: Any, attribute: int, value: Any, size: int = 0) -> int:
        if text(device) != self.device:
            return NO_DEVICE
        if attribute in (AI_MODES, AO_MODES):
            modes = self.ai_modes if attribute == AI_MODES else self.ao_modes
            return NO_ATTRIBUTE if modes is None else give_numbers(modes, value, size)
        if attribute == AO_RATE and self.ao_modes is None:
            return NO_ATTRIBUTE
        value.value = {AI_RATE: self.ai_rate_hz, AO_RATE: self.ao_rate_hz, SIMULATED: 0}[attribute]
        return 0

    def DAQmxGetErrorString(self, code: int, value: Any, size: int) -> int:
        return give_text(TEXTS.get(code, "Warning."), value, size)

    def DAQmxGetExtendedErrorInfo(self, value: Any, size: int) -> int:
        return give_text(TEXTS[self.last], value, size)

    last = 0


class FakeLibrary:
    """The library as the package sees it; a function that is not here is one that the driver does not have."""

    def __init__(self, card: FakeCard, without: frozenset[str] = frozenset()) -> None:
        for name in dir(card):
            if name.startswith("DAQmx") and name not in without:
                setattr(self, name, Function(self._remembering(card, getattr(card, name))))

    @staticmethod
    def _remembering(card: FakeCard, body: Callable[..., int]) -> Callable[..., int]:
        def call(*args: Any) -> int:
            code = body(*args)
            card.last = code if code < 0 else card.last
            return code

        return call


def install(monkeypatch: Any, card: FakeCard, without: frozenset[str] = frozenset()) -> None:
    """Put the card's library in the place of the driver's."""
    functions = DaqFunctionImporter(FakeLibrary(card, without))
    for name, value in (("_windll", functions), ("_cdll", functions), ("_encoding", "utf-8")):
        monkeypatch.setattr(lib_importer, name, value)


def plain(arg: Any) -> Any:
    """Return what a C function would see: the target of byref, the number in a handle."""
    arg = getattr(arg, "_obj", arg)
    return arg.value if isinstance(arg, ctypes.c_void_p) and arg.value else arg


def text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value or "")


def give_text(value: str, buffer: Any, size: int) -> int:
    """Return the size that a text needs, or write it."""
    if size == 0:
        return len(value) + 1
    buffer.value = value.encode()
    return 0


def give_numbers(values: tuple[int, ...], buffer: Any, size: int) -> int:
    """Return how many numbers there are, or write them to the address."""
    if size == 0:
        return len(values)
    array = ctypes.cast(buffer, ctypes.POINTER(ctypes.c_int32))
    for i, value in enumerate(values):
        array[i] = value
    return 0
