"""Compiled step of the patient's filter (equations 7-9)."""

from __future__ import annotations

from math import atan2, sin, sqrt

from study._compiled import inner, kernel
from study.guidance._kernels import normalise


@inner
def filter_pose(p, q, z_p, z_q, weights, thresholds):
    """One step of the patient's filter, in place; whether the patient is taken to move.

    Parameters
    ----------
    p, q : (3,) and (4,) array
        Filtered position in mm and quaternion.
    z_p, z_q : (3,) and (4,) array
        Measured ones; finite, the quaternion of unit length and either sign.
    weights : (4,) array
        Of the new sample: position when static and moving, orientation when static and moving.
    thresholds : (2,) array
        Distances from the filtered pose above which the patient moves, mm and rad.
    """
    x = z_p[0] - p[0]
    y = z_p[1] - p[1]
    z = z_p[2] - p[2]
    cosine = 0.0
    for i in range(4):
        cosine += q[i] * z_q[i]
    sign = 1.0
    if cosine < 0.0:  # the same orientation, the short way round
        sign = -1.0
        cosine = -cosine
    across = 0.0
    for i in range(4):
        part = sign * z_q[i] - cosine * q[i]
        across += part * part
    sine = sqrt(across)
    half = atan2(sine, cosine)
    moving = x * x + y * y + z * z > thresholds[0] * thresholds[0] or 2.0 * half > thresholds[1]
    weight = weights[1] if moving else weights[0]
    p[0] += weight * x
    p[1] += weight * y
    p[2] += weight * z
    weight = weights[3] if moving else weights[2]
    if half < 1e-6:  # the arc is its chord
        old = 1.0 - weight
        new = weight
    else:
        old = sin((1.0 - weight) * half) / sin(half)
        new = sin(weight * half) / sin(half)
    for i in range(4):
        q[i] = old * q[i] + sign * new * z_q[i]
    normalise(q)
    return moving


@kernel
def filter_one(p, q, z_p, z_q, weights, thresholds):
    """`filter_pose`, for Python."""
    return filter_pose(p, q, z_p, z_q, weights, thresholds)
