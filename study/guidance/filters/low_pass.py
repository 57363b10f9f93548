"""The low-pass filter that figure 7 compares the fusion with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from study.errors import InputError


def low_pass(values: ArrayLike, sample_s: float = 0.02, corner_hz: float = 3.0, order: int = 1) -> np.ndarray:
    """Low-pass a signal as a controller would: each value from those before, nothing from the future.

    A Butterworth filter by the bilinear transform. The text prints the corner, 3 Hz, and no order; equation 7
    is of the first, which is therefore the default. A ramp comes out later by ``1 / (2 pi corner)``, 53 ms,
    with the first order, by the square root of 2 times that with the second.

    Parameters
    ----------
    values : (n,) or (n, k) array
        Samples, in steps of `sample_s`; the filter starts settled at the first.
    sample_s : float
    corner_hz : float
        Where 3 dB are lost; below half the sampling rate.
    order : int

    Returns
    -------
    (n,) or (n, k) array

    Raises
    ------
    InputError
        If a number is not finite, or the corner or the order has no meaning.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim not in (1, 2) or not len(values) or not np.isfinite(values).all():
        raise InputError(f"values: expected (n,) or (n, k) finite numbers, got shape {values.shape}")
    if not np.isfinite(sample_s) or sample_s <= 0:
        raise InputError(f"sample_s: expected more than 0 s, got {sample_s!r}")
    if not 0 < corner_hz < 0.5 / sample_s:
        raise InputError(
            f"corner_hz: expected more than 0 and less than {0.5 / sample_s:g} Hz, got {corner_hz!r}"
        )
    if isinstance(order, bool) or order != int(order) or order < 1:
        raise InputError(f"order: expected a whole number of at least 1, got {order!r}")
    b, a = signal.butter(int(order), corner_hz, fs=1.0 / sample_s)
    settled = signal.lfilter_zi(b, a)
    columns = values.reshape(len(values), -1)
    out, _ = signal.lfilter(b, a, columns, axis=0, zi=settled[:, None] * columns[0])
    return out.reshape(values.shape)
