"""Compiled quaternions: scalar part first, [q0, qx, qy, qz], as printed; out-arrays come last."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from study._compiled import inner


@inner
def multiply(a, b, out):
    """Write a * b: first the turn b, then a. `out` may be a or b."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    out[0] = w
    out[1] = x
    out[2] = y
    out[3] = z


@inner
def multiply_inverse(a, b, out):
    """Write a * b^-1, b of unit length: the turn that leads from b to a. `out` may be a or b."""
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = -a[0] * b[1] + a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = -a[0] * b[2] + a[1] * b[3] + a[2] * b[0] - a[3] * b[1]
    z = -a[0] * b[3] - a[1] * b[2] + a[2] * b[1] + a[3] * b[0]
    out[0] = w
    out[1] = x
    out[2] = y
    out[3] = z


@inner
def inverse_multiply(a, b, out):
    """Write a^-1 * b, a of unit length: b as a sees it. `out` may be a or b."""
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    out[0] = w
    out[1] = x
    out[2] = y
    out[3] = z


@inner
def turn(q, v, out):
    """Write the vector v turned by q. `out` may be v."""
    x = v[0]
    y = v[1]
    z = v[2]
    tx = 2.0 * (q[2] * z - q[3] * y)
    ty = 2.0 * (q[3] * x - q[1] * z)
    tz = 2.0 * (q[1] * y - q[2] * x)
    out[0] = x + q[0] * tx + q[2] * tz - q[3] * ty
    out[1] = y + q[0] * ty + q[3] * tx - q[1] * tz
    out[2] = z + q[0] * tz + q[1] * ty - q[2] * tx


@inner
def turn_back(q, v, out):
    """Write the vector v turned by the inverse of q. `out` may be v."""
    x = v[0]
    y = v[1]
    z = v[2]
    tx = -2.0 * (q[2] * z - q[3] * y)
    ty = -2.0 * (q[3] * x - q[1] * z)
    tz = -2.0 * (q[1] * y - q[2] * x)
    out[0] = x + q[0] * tx - q[2] * tz + q[3] * ty
    out[1] = y + q[0] * ty - q[3] * tx + q[1] * tz
    out[2] = z + q[0] * tz - q[1] * ty + q[2] * tx


@inner
def exponential(x, y, z, out):
    """Write the quaternion of a rotation vector in rad."""
    angle = sqrt(x * x + y * y + z * z)
    # The series is exact to round-off there, and the quotient is not.
    share = 0.5 - angle * angle / 48.0 if angle < 1e-3 else sin(0.5 * angle) / angle
    out[0] = cos(0.5 * angle)
    out[1] = share * x
    out[2] = share * y
    out[3] = share * z


@inner
def logarithm(q, out):
    """Write the rotation vector of q, the short way round, rad."""
    sine = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    w = q[0] if q[0] >= 0.0 else -q[0]
    share = 2.0 / w if sine < 1e-9 else 2.0 * atan2(sine, w) / sine
    if q[0] < 0.0:
        share = -share
    out[0] = share * q[1]
    out[1] = share * q[2]
    out[2] = share * q[3]


@inner
def normalise(q):
    """Scale q to unit length in place."""
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale
