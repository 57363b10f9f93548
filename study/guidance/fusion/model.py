"""The printed model of the fusion: equations 10 to 12, for any whole number of lags."""

from __future__ import annotations

import numpy as np

from study.errors import InputError


def checked_lags(lags: int) -> int:
    """A whole number of steps, 0 or more.

    Raises
    ------
    InputError
        If it is anything else.
    """
    if isinstance(lags, bool) or not isinstance(lags, int | np.integer) or lags < 0:
        raise InputError(f"lags: expected a whole number of steps, 0 or more, got {lags!r}")
    return int(lags)


def lags_of(delay_s: float, sample_s: float = 0.02) -> int:
    """How many steps a delay is.

    The state holds the positions of past steps and nothing between them: a delay that is not a whole number
    of steps has no row in C, and is refused instead of rounded.

    Parameters
    ----------
    delay_s : float
        Of the optical tracker; 0.04 s are 2 steps of 0.02 s (5.3), 0.08 s are 4.
    sample_s : float
        Of the filter.

    Raises
    ------
    InputError
        If either is not a time, or the delay is more than a thousandth of a step from whole; the message
        has the two nearest.
    """
    if not np.isfinite(sample_s) or sample_s <= 0:
        raise InputError(f"sample_s: expected more than 0 s, got {sample_s!r}")
    if not np.isfinite(delay_s) or delay_s < 0:
        raise InputError(f"delay_s: expected 0 s or more, got {delay_s!r}")
    steps = delay_s / sample_s
    if abs(steps - round(steps)) > 1e-3:
        low = int(steps)
        raise InputError(
            f"delay_s: expected a whole number of steps of {sample_s:g} s, such as {low * sample_s:g} or "
            f"{(low + 1) * sample_s:g} s, got {delay_s:g} s"
        )
    return round(steps)


def system_matrices(sample_s: float = 0.02, lags: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A and C of equation 12; the state is p_k, p_k-1, ..., p_k-lags, v_k, of three axes each.

    With diagonal noise the axes do not meet: these are three filters of `lags` + 2 states, which is how
    `PoseFusion` computes.

    Parameters
    ----------
    sample_s : float
        T, s.
    lags : int
        Steps by which the tracker is late; 2 as printed.

    Returns
    -------
    (12, 12) array, (6, 12) array
        For other lags, 3 (lags + 2) states. C's first three rows are the tracker's, the others the encoders'.

    Raises
    ------
    InputError
        If T is not a time or the lags are not a whole number.
    """
    lags_of(0.0, sample_s)
    n = checked_lags(lags) + 2
    A = np.eye(n, k=-1)
    A[-1] = 0.0
    A[0, 0] = A[-1, -1] = 1.0
    A[0, -1] = sample_s
    C = np.zeros((2, n))
    C[0, n - 2] = C[1, n - 1] = 1.0
    return np.kron(A, np.eye(3)), np.kron(C, np.eye(3))


def printed_order(covariances: np.ndarray) -> np.ndarray:
    """(3 n, 3 n) covariance of the printed state, of those (3, n, n) of each axis."""
    n = covariances.shape[1]
    out = np.zeros((n, 3, n, 3))
    for axis in range(3):
        out[:, axis, :, axis] = covariances[axis]
    return out.reshape(3 * n, 3 * n)


def workspace(lags: int) -> np.ndarray:
    """(5, max(lags + 2, 4)) array that the compiled steps work in; its content does not matter."""
    return np.zeros((5, max(lags + 2, 4)))
