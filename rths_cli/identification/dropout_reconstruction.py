"""Reconstruct samples that were lost in a record, from an ARX model of the rest.

Each channel is predicted from its own past and from the command, by an ARX model fitted by least squares to all rows
without a missing sample. The reconstructed samples are those that minimise the squared prediction errors around them
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
PAST_S = 0.04  # past of channel and command that a prediction uses
LEAST_PAST = 8  # samples
ROWS_EACH = 4  # least number of complete rows per coefficient
MOST_MISSING = 0.05  # largest fraction of a record's samples


def filled(command_v: Array, channels: Array, missing: Mask, dt_s: float) -> Array:
    """Return the channels (c, n) with their samples reconstructed where `missing` (n,) is set.

    `command_v` (n,) is complete; the channels may be in any unit. Raises InputError if too many samples are missing.
    """
    if not missing.any():
        return channels
    past = max(round(PAST_S / dt_s), LEAST_PAST)
    whole = ~_touched(missing, past)
    share = missing.mean()
    if share > MOST_MISSING or whole.sum() < ROWS_EACH * (2 * past + 1):
        raise InputError(
            f"{missing.sum()} of {missing.size} samples ({100.0 * share:.1f} %) were lost on the link, at most "
            f"{100.0 * MOST_MISSING:.0f} % may be; look at network and machine (rths doctor), or measure at a lower "
            "rate"
        )
    return np.array([_filled(command_v, channel, missing, whole, past) for channel in channels])


def _touched(missing: Mask, past: int) -> Mask:
    """Return which rows of the prediction, for samples past, past + 1, ..., use a missing sample."""
    return np.asarray(sliding_window_view(missing, past + 1).any(axis=1))


def _filled(command_v: Array, accel: Array, missing: Mask, whole: Mask, past: int) -> Array:
    """Return one channel (n,) with its missing samples reconstructed."""
    own, inputs = sliding_window_view(accel, past + 1), sliding_window_view(command_v, past + 1)
    seen = np.column_stack([own[whole, :-1], inputs[whole]])
    factors = _least_squares(seen, own[whole, -1])
    errors_of, forced = np.append(-factors[:past], 1.0), inputs @ factors[past:]
    found = accel.copy()
    head = np.flatnonzero(missing[:past])  # has no past to predict from: interpolated linearly
    came = np.flatnonzero(~missing[: 4 * past])
    found[head] = np.interp(head, came, accel[came])
    for places in clusters(np.flatnonzero(missing[past:]) + past, past):
        found[places] = _put_back(found, places, errors_of, forced, past)
    return found


def clusters(places: Places, past: int) -> Iterator[Places]:
    """Yield the indices (m,) of missing samples in groups; no prediction, of `past` samples, uses two groups."""
    yield from np.split(places, np.flatnonzero(np.diff(places) > past) + 1)


def _least_squares(seen: Array, wanted: Array) -> Array:
    """Return the coefficients by normal equations with scaled columns, slightly damped against rounding errors."""
    scale = np.sqrt((seen**2).mean(axis=0)) + np.finfo(float).tiny
    scaled = seen / scale
    square = scaled.T @ scaled
    square[np.diag_indices_from(square)] += 1e-12 * len(seen)
    return np.asarray(np.linalg.solve(square, scaled.T @ wanted) / scale)


def _put_back(accel: Array, places: Places, errors_of: Array, forced: Array, past: int) -> Array:
    """Return the samples at the indices `places` (m,) that minimise all prediction errors that depend on them."""
    rows = np.arange(places[0], min(places[-1] + past + 1, accel.size))
    lag = rows[:, None] - places[None, :]
    depends = np.where((lag >= 0) & (lag <= past), errors_of[past - np.clip(lag, 0, past)], 0.0)
    known = accel[rows[0] - past : rows[-1] + 1].copy()
    known[places - (rows[0] - past)] = 0.0
    rest = sliding_window_view(known, past + 1) @ errors_of - forced[rows - past]
    return np.asarray(np.linalg.lstsq(depends, -rest, rcond=None)[0])
