"""Compiled steps of the fusion of a late, slow tracker with early encoder velocities (equations 10-12).

An axis has the states p_k, p_k-1, ..., p_k-lags, v: `lags` + 2 of them, newest position first. With diagonal
noise the axes of the printed filter do not meet, so three of these are its 12 states. `work` is what
`study.guidance.fusion.workspace` makes.
"""

from __future__ import annotations

from math import inf

from study._compiled import inner, kernel
from study.guidance._kernels import exponential, logarithm, multiply, multiply_inverse, normalise

# Rows of `work`: the corrections of three axes, then two for anything.
_ROW = 3
_QUATERNION = 4


@inner
def _predict_covariance(P, axis, sample_s, process, work):
    """P = A P A^T + Q of one axis, in place."""
    v = P.shape[1] - 1
    variance = P[axis, v, v]
    for i in range(1, v):
        work[_ROW, i] = P[axis, i - 1, 0] + sample_s * P[axis, i - 1, v]
    newest = P[axis, 0, 0] + sample_s * (2.0 * P[axis, 0, v] + sample_s * variance) + process[0]
    newest_and_v = P[axis, 0, v] + sample_s * variance
    for i in range(v - 1, 0, -1):
        for j in range(i, 0, -1):
            P[axis, i, j] = P[axis, i - 1, j - 1]
            P[axis, j, i] = P[axis, i - 1, j - 1]
        P[axis, i, v] = P[axis, i - 1, v]
        P[axis, v, i] = P[axis, i, v]
    for i in range(1, v):
        P[axis, i, 0] = work[_ROW, i]
        P[axis, 0, i] = work[_ROW, i]
    P[axis, 0, 0] = newest
    P[axis, 0, v] = newest_and_v
    P[axis, v, 0] = newest_and_v
    P[axis, v, v] = variance + process[1]


@inner
def _correct(P, axis, measured, variance, innovation, work):
    """One measured state of an axis: its corrections are added to `work`, P gets smaller.

    Both triangles get the same number, and the measured state's own row is scaled, not subtracted from:
    P stays symmetric and positive however often this runs.
    """
    n = P.shape[1]
    total = P[axis, measured, measured] + variance
    for i in range(n):
        work[_ROW, i] = P[axis, i, measured]
        work[axis, i] += work[_ROW, i] * innovation / total
    kept = variance / total
    for i in range(n):
        for j in range(i + 1):
            if i == measured:
                value = work[_ROW, j] * kept
            elif j == measured:
                value = work[_ROW, i] * kept
            else:
                value = P[axis, i, j] - work[_ROW, i] * work[_ROW, j] / total
            P[axis, i, j] = value
            P[axis, j, i] = value


@inner
def fuse_position(x, P, sample_s, process, r_position, r_velocity, z_position, z_velocity, fresh, gate, work):
    """One step for the position: predict, then correct; the innovation's NIS of 3 degrees of freedom.

    Parameters
    ----------
    x : (3, lags + 2) array
        States of each axis, mm and mm/s; in place.
    P : (3, lags + 2, lags + 2) array
        Their covariances; in place.
    sample_s : float
        T of equation 12.
    process : (2,) array
        Variances of a step, of position and velocity.
    r_position : (3,) array
        Variances of the measured position.
    r_velocity : float
        Of the measured velocity, along any axis.
    z_position, z_velocity : (3,) array
        Measured now; the position is one of `lags` steps ago, and is not looked at unless `fresh`.
    fresh : bool
        Whether the tracker delivered something new.
    gate : float
        Positions of a larger NIS are not used, nor any that are not finite; inf for none.
    work : array

    Returns
    -------
    float
        NIS of the position; -1 when not fresh, inf when not finite.
    """
    v = x.shape[1] - 1
    oldest = v - 1
    for axis in range(3):
        for i in range(oldest, 0, -1):
            x[axis, i] = x[axis, i - 1]
        x[axis, 0] += sample_s * x[axis, v]
        _predict_covariance(P, axis, sample_s, process, work)
    nis = -1.0
    if fresh:
        nis = 0.0
        for axis in range(3):
            innovation = z_position[axis] - x[axis, oldest]
            nis += innovation * innovation / (P[axis, oldest, oldest] + r_position[axis])
        if not nis < inf:
            nis = inf
    use = fresh and nis < inf and nis <= gate
    for axis in range(3):
        for i in range(v + 1):
            work[axis, i] = 0.0
        if use:
            _correct(P, axis, oldest, r_position[axis], z_position[axis] - x[axis, oldest], work)
        innovation = z_velocity[axis] - x[axis, v] - work[axis, v]
        _correct(P, axis, v, r_velocity, innovation, work)
        for i in range(v + 1):
            x[axis, i] += work[axis, i]
    return nis


@inner
def fuse_orientation(
    q, w, P, sample_s, process, r_rotation, r_velocity, z_quaternion, z_velocity, fresh, gate, work
):
    """One step for the orientation, the same filter of small rotations; the innovation's NIS.

    The errors of the orientations are small rotation vectors in the axes of the frame that the pose leads
    to (on the left of the quaternion), as the angular velocity is. How far those axes turn in a step is
    left out of the covariance, a product of an error with the turn of a step: so three axes do not meet
    here either.

    Parameters
    ----------
    q : (lags + 1, 4) array
        Orientations, newest first; in place.
    w : (3,) array
        Angular velocity, rad/s; in place.
    P : (3, lags + 2, lags + 2) array
        Covariances of the errors of each axis, rad and rad/s; in place.
    sample_s, process, r_rotation, r_velocity, fresh, gate, work
        As in `fuse_position`, with rad for mm.
    z_quaternion : (4,) array
        Measured orientation of `lags` steps ago, of unit length and either sign.
    z_velocity : (3,) array
        Measured angular velocity, rad/s.

    Returns
    -------
    float
        NIS of the orientation; -1 when not fresh, inf when not finite.
    """
    v = P.shape[1] - 1
    oldest = v - 1
    small = work[_QUATERNION]
    for i in range(oldest, 0, -1):
        for part in range(4):
            q[i, part] = q[i - 1, part]
    exponential(sample_s * w[0], sample_s * w[1], sample_s * w[2], small)
    multiply(small, q[0], q[0])
    for axis in range(3):
        _predict_covariance(P, axis, sample_s, process, work)
        for i in range(v + 1):
            work[axis, i] = 0.0
    nis = -1.0
    if fresh:
        multiply_inverse(z_quaternion, q[oldest], small)
        logarithm(small, small)
        nis = 0.0
        for axis in range(3):
            nis += small[axis] * small[axis] / (P[axis, oldest, oldest] + r_rotation[axis])
        if not nis < inf:
            nis = inf
        if nis < inf and nis <= gate:
            for axis in range(3):
                _correct(P, axis, oldest, r_rotation[axis], small[axis], work)
    for axis in range(3):
        _correct(P, axis, v, r_velocity, z_velocity[axis] - w[axis] - work[axis, v], work)
        w[axis] += work[axis, v]
    for i in range(oldest + 1):
        exponential(work[0, i], work[1, i], work[2, i], small)
        multiply(small, q[i], q[i])
        normalise(q[i])
    return nis


@kernel
def fuse_positions(
    x, P, sample_s, process, r_position, r_velocity, z_positions, z_velocities, fresh, gate, work, nis, out
):
    """`fuse_position` for each row of a record: writes `nis` (n,) and the newest positions, `out` (n, 3)."""
    for k in range(len(fresh)):
        nis[k] = fuse_position(
            x, P, sample_s, process, r_position, r_velocity, z_positions[k], z_velocities[k], fresh[k],
            gate, work,
        )  # fmt: skip
        for axis in range(3):
            out[k, axis] = x[axis, 0]


@kernel
def fuse_orientations(
    q, w, P, sample_s, process, r_rotation, r_velocity, z_quaternions, z_velocities, fresh, gate, work,
    nis, out,
):  # fmt: skip
    """`fuse_orientation` for each row of a record: writes `nis` (n,) and the newest ones, `out` (n, 4)."""
    for k in range(len(fresh)):
        nis[k] = fuse_orientation(
            q, w, P, sample_s, process, r_rotation, r_velocity, z_quaternions[k], z_velocities[k], fresh[k],
            gate, work,
        )  # fmt: skip
        for part in range(4):
            out[k, part] = q[0, part]
