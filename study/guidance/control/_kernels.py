"""Compiled PI control of a pose."""

from __future__ import annotations

from math import sqrt

from study._compiled import inner, kernel


@inner
def _limited(proportional, most, integral, rate, errors, cycle, out):
    """Write proportional plus integral, no longer than `most`: else it is cut, and the integral waits."""
    total = 0.0
    for i in range(3):
        out[i] = proportional * errors[i] + integral[i]
        total += out[i] * out[i]
    speed = sqrt(total)
    if speed > most:
        for i in range(3):
            out[i] *= most / speed
    else:
        for i in range(3):
            integral[i] += rate * errors[i] * cycle


@inner
def steer(error_p, error_q, gains, most, cycle, integral, out):
    """Write the twist to command, linear first, from the errors of position and orientation.

    ``error_q`` is the desired quaternion times the inverse of the actual one; it is taken the short way
    round, and used up: its vector part, half the angle, is doubled in place.
    """
    sign = 2.0 if error_q[0] >= 0.0 else -2.0
    for i in range(1, 4):
        error_q[i] *= sign
    _limited(gains[0], most[0], integral[:3], gains[1], error_p, cycle, out[:3])
    _limited(gains[2], most[1], integral[3:], gains[3], error_q[1:], cycle, out[3:])


@kernel
def steer_once(error_p, error_q, gains, most, cycle, integral, out):
    """`steer` for Python."""
    steer(error_p, error_q, gains, most, cycle, integral, out)
