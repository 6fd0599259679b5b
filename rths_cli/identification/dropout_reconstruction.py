"""Samples that a link lost, put back by what the rest of the record says of its channel.

Each channel is predicted from its own past and from the command (an ARX model, least squares over all rows that miss
nothing); lost samples are those that make the prediction errors around them smallest, in the sense of least squares
(Janssen, Veldhuis and Vries, IEEE Trans. ASSP 34(2), 1986, with the command as input).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

Mask = NDArray[np.bool_]
Places = NDArray[np.int_]
PAST_S = 0.04  # of channel and command that a prediction looks at
LEAST_PAST = 8
ROWS_EACH = 4  # at least so many complete rows for each coefficient
MOST_MISSING = 0.05  # of a record's samples


def filled(command_v: Array, channels: Array, missing: Mask, dt_s: float) -> Array:
    """Return channels (c, n) with the samples where `missing`, (n,) bool, is set put back; the command is whole.

    Raises InputError where so much is missing that the rest does not say what it was.
    """
    if not missing.any():
        return channels
    past = max(round(PAST_S / dt_s), LEAST_PAST)
    whole = ~_touched(missing, past)
    share = missing.mean()
    if share > MOST_MISSING or whole.sum() < ROWS_EACH * (2 * past + 1):
        raise InputError(
            f"{missing.sum()} of {missing.size} samples ({share:.1%}) were lost on the link, at most "
            f"{MOST_MISSING:.0%} may be; look at network and machine (rths doctor), or measure at a lower rate"
        )
    return np.array([_filled(command_v, channel, missing, whole, past) for channel in channels])


def _touched(missing: Mask, past: int) -> Mask:
    """Return which rows of a prediction, those of samples past, past + 1, ..., look at a missing sample."""
    return np.asarray(sliding_window_view(missing, past + 1).any(axis=1))


def _filled(command_v: Array, accel: Array, missing: Mask, whole: Mask, past: int) -> Array:
    """Return one channel (n,) with its missing samples put back."""
    own, inputs = sliding_window_view(accel, past + 1), sliding_window_view(command_v, past + 1)
    seen = np.column_stack([own[whole, :-1], inputs[whole]])
    factors = _least_squares(seen, own[whole, -1])
    errors_of, forced = np.append(-factors[:past], 1.0), inputs @ factors[past:]
    found = accel.copy()
    head = np.flatnonzero(missing[:past])  # of which nothing before tells: a straight line to what came first
    came = np.flatnonzero(~missing[: 4 * past])
    found[head] = np.interp(head, came, accel[came])
    for places in clusters(np.flatnonzero(missing[past:]) + past, past):
        found[places] = _put_back(found, places, errors_of, forced, past)
    return found


def clusters(places: Places, past: int) -> Iterator[Places]:
    """Yield places (m,) of missing samples in groups no prediction (of `past` samples) looks at two of."""
    yield from np.split(places, np.flatnonzero(np.diff(places) > past) + 1)


def _least_squares(seen: Array, wanted: Array) -> Array:
    """Return the factors of columns of like size; by normal equations, with what rounding leaves of them damped."""
    scale = np.sqrt((seen**2).mean(axis=0)) + np.finfo(float).tiny
    scaled = seen / scale
    square = scaled.T @ scaled
    square[np.diag_indices_from(square)] += 1e-12 * len(seen)
    return np.asarray(np.linalg.solve(square, scaled.T @ wanted) / scale)


def _put_back(accel: Array, places: Places, errors_of: Array, forced: Array, past: int) -> Array:
    """Return the samples at `places` (m,) that make the prediction errors which depend on them smallest."""
    rows = np.arange(places[0], min(places[-1] + past + 1, accel.size))
    lag = rows[:, None] - places[None, :]
    depends = np.where((lag >= 0) & (lag <= past), errors_of[past - np.clip(lag, 0, past)], 0.0)
    known = accel[rows[0] - past : rows[-1] + 1].copy()
    known[places - (rows[0] - past)] = 0.0
    rest = sliding_window_view(known, past + 1) @ errors_of - forced[rows - past]
    return np.asarray(np.linalg.lstsq(depends, -rest, rcond=None)[0])
