"""The numbers of a designed step in C: the sizes of its arrays (rths_sizes.h) and their values (rths_data.c)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.errors import InputError
from rths_cli.experiment.designed_step import DesignedStep, checksum_number
from rths_cli.loop.fallback_commands import LONGEST_S
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.linear_parts import KalmanFilter, LinearFeedback, LinearFeedforward
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.loop.storey_forces import Modal, StoreysAndForces
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.tabulated_functions import BEGIN, BELL, LAST, SCALE, SHIFT
from rths_cli.numerics.tiled_products import tiled
from rths_cli.structure.storey_laws import OWN
from rths_cli.version import __version__

NUMBERS_PER_LINE = 4
CURVE_BEGIN, CURVE_SHIFT = 4, 5  # integers in the first row of a curve
Fields = dict[str, str]


class Storeys(NamedTuple):
    """The computed storeys as the C step takes them, with or without laws; m pairs of states, q storeys with laws."""

    turn: Array  # (4, m)
    push: Array  # (tiles, 2 + q, 4) of ground acceleration, laws' forces, base shear
    drifts: Array  # (tiles, 2 m + q + 2, 4)
    drift_rows: int
    interface: Array  # (1, 2 m + q + 2, 4)
    direct: float
    laws: StoreysAndForces | None


def refuse_other_parts(given: DesignedStep) -> None:
    """Raise InputError with the name of every part that C cannot have."""
    blocks, faults = given.blocks, []
    places = {
        "numerical": (blocks.numerical, (Block, StoreysWithLaws)),
        "controller": (blocks.feedforward, (Block, FrictionFeedforward)),
        "feedback": (blocks.feedback, (Block,)),
    }
    for place, (part, kinds) in places.items():
        if not isinstance(part, kinds):
            faults.append(f"{place}: {part.name} is a part of your own, which is not in C; write it there yourself")
    if isinstance(blocks.numerical, StoreysWithLaws):
        own = blocks.numerical.laws.storey[blocks.numerical.laws.code == OWN]
        faults += [
            f"structure.numerical.law[{storey + 1}]: is a law of your own, which is not in C; take another"
            for storey in own.tolist()
        ]
    interface = blocks.interface
    if len(interface.channels) != 1 or interface.actuators != 1 or interface.commanded != "acceleration":
        faults.append("interface: the C step has one degree of freedom, one command, and commands accelerations")
    if faults:
        raise InputError(*(f"{given.name}: {fault}" for fault in faults))


def sizes_text(given: DesignedStep) -> str:
    """Return rths_sizes.h."""
    lines = [f"#define RTHS_{name} {value if value >= 0 else f'({value})'}" for name, value in sizes(given).items()]
    head = f"/* The sizes of the step of case {_plain(given.name)}, written by rths {__version__}. */"
    return "\n".join([head, "", "#ifndef RTHS_SIZES_H", "#define RTHS_SIZES_H", "", *lines, "", "#endif", ""])


def data_text(given: DesignedStep) -> str:
    """Return rths_data.c; raises InputError for a part that C cannot have."""
    refuse_other_parts(given)
    step = assemble(given.blocks, NUMERICAL)
    parts = _about(given) | _blocks(given.blocks, step)
    body = ",\n".join(f"  .{name} = {value}" for name, value in parts.items())
    head = f"/* The numbers of the step of case {_plain(given.name)}, written by rths {__version__}. SI units; V. */"
    include = '#include "rths_step.h"\n\n#include <math.h>'
    return f"{head}\n\n{include}\n\nconst rths_numbers rths_data = {{\n{body}\n}};\n"


def sizes(given: DesignedStep) -> dict[str, int]:
    """Return the sizes by the names of the C step, without RTHS_; raises InputError for a part that C cannot have."""
    refuse_other_parts(given)
    step, blocks = assemble(given.blocks, NUMERICAL), given.blocks
    storeys = _storeys(step, blocks)
    laws, (observer, forward, back) = storeys.laws, (part.block for part in _linear(step))
    tables = laws is not None and bool(_degrades(laws).any())
    return {
        "ACCELEROMETERS": step.accelerometers,
        "FURTHER": step.samples.size - step.accelerometers,
        "MEASURED_BY": step.measured_by[0],
        "CELL": step.cell,
        "LEAD": blocks.lead_samples,
        "SENT": len(step.sent),
        "OBSERVER_STATES": observer.states,
        "OBSERVER_INPUTS": observer.matrix.shape[1] - observer.states,
        "ESTIMATES": step.estimated.size,
        "PAIRS": storeys.turn.shape[1],
        "LAWS": 0 if laws is None else len(laws.code),
        "LAW_STOREYS": 0 if laws is None else laws.logged.size,
        "DRIFT_ROWS": storeys.drift_rows,
        "CURVE_ROWS": 0 if laws is None else laws.curves.shape[1],
        "TABLE_ROWS": laws.tables.shape[1] if laws is not None and tables else 0,
        "BELL_ROWS": len(BELL) if tables else 0,
        "FORWARD_STATES": forward.states,
        "REACTION_INPUTS": forward.matrix.shape[1] - forward.states - 3,
        "BACK_STATES": back.states,
        "FLOOR_STATES": step.open_loop.states,
        "EXPECTED_FLOORS": step.open_loop.floors,
        "RECORD": len(given.drive),
    }


def _linear(step: Step) -> tuple[KalmanFilter, LinearFeedforward, LinearFeedback]:
    """Return the parts that `refuse_other_parts` leaves linear."""
    observer, forward, back = step.observer, step.feedforward, step.feedback
    assert isinstance(observer, KalmanFilter) and isinstance(forward, LinearFeedforward)
    assert isinstance(back, LinearFeedback)
    return observer, forward, back


def _storeys(step: Step, blocks: Blocks) -> Storeys:
    made = step.numerical
    if isinstance(made, StoreysAndForces):
        rows = (2 if made.drifts.shape[0] * 4 >= 2 * made.logged.size else 1) * made.logged.size
        return Storeys(made.turn, made.drive, made.drifts, rows, made.interface, float(made.direct[0, 0]), made)
    assert isinstance(made, Modal) and isinstance(blocks.numerical, Block)
    push = tiled(made.drive.reshape(2, -1).T)
    interface = np.concatenate([made.outputs[:1], tiled(made.through)], axis=1)
    return Storeys(made.turn, push, np.zeros((0, 0, 4)), 0, interface, float(made.direct[0, 0]), None)


def _about(given: DesignedStep) -> Fields:
    info, dt_s = given.info, given.info.dt_s
    counts = {
        "zero_steps": given.zero_steps,
        "still_steps": given.still_steps,
        "ramp_steps": given.ramp_steps,
        "record_steps": len(given.drive),
        "lost_samples": info.limits.lost_samples,
        "longest_return": round(LONGEST_S / dt_s),
    }
    numbers = {
        "case_number": checksum_number(given.case_sha256),
        "model_number": checksum_number(given.model_sha256),
        "dt_s": dt_s,
    }
    return {
        "case_name": _text(given.name, 127),
        "case_sha256": _text(given.case_sha256, 64),
        "model_sha256": _text(given.model_sha256, 64),
        "made_by": _text(f"rths {__version__}", 63),
        **{name: _number(value) for name, value in numbers.items()},
        **{name: str(value) for name, value in counts.items()},
        "signs": _array(np.array([one.sign for one in info.all_channels])),
        "limits": _limits(given),
    }


def _blocks(blocks: Blocks, step: Step) -> Fields:
    storeys, (observer, forward, back) = _storeys(step, blocks), _linear(step)
    back_matrix = back.block.matrix[:, : back.block.states + 1]  # without the shortfalls, which `shortfall` holds
    arrays: dict[str, Array] = {
        "correction": step.correction.matrix.reshape(len(step.correction.matrix), 16),
        "observer": observer.block.matrix.ravel(),
        "force_recent": step.force_recent.ravel(),
        "turn": storeys.turn,
        "push": storeys.push.ravel(),
        "drifts": storeys.drifts.ravel(),
        "interface_motion": storeys.interface.ravel(),
        "forward": forward.block.matrix.ravel(),
        "back": back_matrix.ravel(),
        "shortfall": back.shortfall.ravel(),
        "floors": step.open_loop.matrix.ravel(),
        "cell_reads": step.cell_reads,
        "bell": BELL.ravel() if storeys.laws is not None and _degrades(storeys.laws).any() else np.zeros(0),
    }
    numbers = {
        "ripple_m_s2_per_v": step.ripple_m_s2_per_v,
        "ripple_sum_m_s2_per_v": step.ripple_sum_m_s2_per_v,
        "force_returned": float(step.force_returned[0, 0]),
        "direct": storeys.direct,
        "friction_v": forward.friction_v,
        "per_scale": forward.per_scale,
        "linear_s_per_m": forward.linear_s_per_m,
        "lead_s": forward.lead_s,
        "command_limit_v": float(step.command_limit_v[0]),
        "feedback_limit_v": float(step.feedback_limit_v[0]),
        "bit_v": step.bit_v,
        "bits_per_v": step.bits_per_v,
    }
    laws = {} if storeys.laws is None else {"laws": _laws(storeys.laws)}
    return {name: _array(value) for name, value in arrays.items()} | {
        name: _number(value) for name, value in numbers.items()
    } | laws  # fmt: skip


def _degrades(laws: StoreysAndForces) -> Array:
    return np.asarray(laws.tables[:, 0, SCALE] > 0.0)


def _laws(laws: StoreysAndForces) -> str:
    tables = laws.tables if _degrades(laws).any() else np.zeros((len(laws.code), 0, 0))
    return "{\n" + ",\n".join(_law(laws, tables[i], i) for i in range(len(laws.code))) + "}"


def _law(laws: StoreysAndForces, table: Array, i: int) -> str:
    curve, table = laws.curves[i].copy(), table.copy()
    begin, shift = curve[0, [CURVE_BEGIN, CURVE_SHIFT]].view(np.int64).tolist()
    curve[0, [CURVE_BEGIN, CURVE_SHIFT]] = 0.0
    first = np.zeros(3, np.int64)
    if table.size:
        first = table[0, [BEGIN, SHIFT, LAST]].view(np.int64)
        table[0, [BEGIN, SHIFT, LAST]] = 0.0
    fields = {
        "code": int(laws.code[i]), "storey": int(laws.which[i]), "curve_begin": begin, "curve_shift": shift,
        "table_begin": int(first[0]), "table_shift": int(first[1]), "table_last": int(first[2]),
        "degrades": int(_degrades(laws)[i]),
    }  # fmt: skip
    texts = {name: str(value) for name, value in fields.items()}
    texts |= {"gives": _number(laws.gives[i]), "numbers": _array(laws.numbers[i])}
    texts |= {"curve": _array(curve.ravel()), "table": _array(table.ravel())}
    return _struct(texts)


def _limits(given: DesignedStep) -> str:
    limits, further = given.limits, given.limits.further
    zeros, noise = given.rest_limits_v
    alone = [name for name in GuardLimits._fields if isinstance(getattr(limits, name), float)]
    fields = {name: _number(getattr(limits, name)) for name in alone if name != "dt_s"}
    arrays = {
        "force_weights": limits.force_weights, "stuck": limits.stuck, "reads": further.reads,
        "saturation_v": np.concatenate([limits.saturation_v, further.saturation_v]),
        "abort": np.concatenate([limits.abort, further.abort]), "tolerated": further.tolerated,
        "zero_limit_v": zeros, "noise_limit_v": noise,
    }  # fmt: skip
    fields |= {name: _array(np.asarray(value, dtype=float)) for name, value in arrays.items()}
    fields["duty"] = "{" + (", ".join(map(str, further.duty.tolist())) or "0") + "}"
    return _struct(fields)


def _struct(fields: Mapping[str, str]) -> str:
    return "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}"


def _array(values: Array) -> str:
    """Return an array in braces, one pair for each row; one without elements has one zero."""
    if values.size == 0:
        return "{{0.0}}" if values.ndim > 1 else "{0.0}"
    if values.ndim > 1:
        return "{\n" + ",\n".join(map(_array, values)) + "}"
    texts = [_number(value) for value in values]
    lines = [", ".join(texts[i : i + NUMBERS_PER_LINE]) for i in range(0, len(texts), NUMBERS_PER_LINE)]
    return "{" + ",\n    ".join(lines) + "}"


def _number(value: Any) -> str:
    """Return a double with all its digits."""
    value = float(value)
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return "NAN" if math.isnan(value) else repr(value)


def numbers(values: Iterable[float]) -> str:
    """Return doubles with all their digits, between commas."""
    return ", ".join(map(_number, values))


def _plain(text: str) -> str:
    """Return a text without what ends a comment or a string of C."""
    kept = "".join(c if c.isascii() and c.isprintable() and c not in '"\\' else "?" for c in text)
    return kept.replace("*/", "* /").replace("??", "?")


def _text(text: str, most: int) -> str:
    return f'"{_plain(text)[:most]}"'
