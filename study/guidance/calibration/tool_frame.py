"""The frame of a drill's tip in the frame of its marker."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.frames import rigid
from study.registration.sources import checked_vector

#: Cosine of the angle between bit and the marker's z axis above which the marker's x axis sets the turn.
_ALONG = np.cos(np.radians(30.0))


def T_tool_tcp_from(tip_tool: ArrayLike, axis_tool: ArrayLike) -> np.ndarray:
    """(4, 4) ``T_tool_tcp`` of a tip and the direction of its bit.

    The origin is the tip, z points along the bit from the body to the tip (section 4.3). How the frame is
    turned about the bit is free and must only be the same every time: x is the marker's z axis, where it
    faces, as nearly as it can be; where the bit is within 30 degrees of that, the marker's x axis.

    Parameters
    ----------
    tip_tool : (3,) array
        mm.
    axis_tool : (3,) array
        From the body to the tip, of any length but 0.

    Raises
    ------
    InputError
        If a number is not finite or the direction has no length.
    """
    tip = checked_vector("tip_tool", tip_tool, "mm")
    z = checked_vector("axis_tool", axis_tool, "any unit")
    length = np.linalg.norm(z)
    if length == 0:
        raise InputError("axis_tool: expected a direction, got a vector of length 0")
    z = z / length
    near = np.array([1.0, 0.0, 0.0]) if abs(z[2]) > _ALONG else np.array([0.0, 0.0, 1.0])
    x = near - (near @ z) * z
    x /= np.linalg.norm(x)
    return rigid(np.column_stack([x, np.cross(z, x), z]), tip)
