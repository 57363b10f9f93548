"""What the tests of the arms share: an own product of matrices, angles to try, how far poses are apart."""

from functools import reduce

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.robots.arms import arm_table
from study.robots.arms.inverse import REGULAR

NAMES = ("KR3", "RV-3S")
both = pytest.mark.parametrize("name", NAMES)


def turned(axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(axis, dtype=float) * angle).as_matrix()
    return T


def shifted(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def by_hand(name, q):
    """The pose as a product of matrices, from the table alone."""
    value = arm_table(name).set_index(["quantity", "joint"])["value"]
    length = {key: value[key].iloc[0] for key in ("base_height", "shoulder_offset", "upper_arm", "forearm")}
    elbow = value["elbow_offset"].iloc[0]
    s = [value["sense", joint] * q[joint - 1] for joint in range(1, 7)]
    z, y = (0, 0, 1), (0, 1, 0)
    steps = [
        turned(z, s[0]),
        shifted(length["shoulder_offset"], 0, length["base_height"]),
        turned(y, s[1]),
        shifted(0, 0, length["upper_arm"]),
        turned(y, s[2]),
        shifted(elbow, 0, length["forearm"]),
        turned(z, s[3]),
        turned(y, s[4]),
        turned(z, s[5]),
    ]
    return reduce(np.matmul, steps)


def postures(one, number, rng):
    """Joint angles within the limits, clear of singularities and of the limits themselves."""
    low, high = one.limits.T
    found = []
    while len(found) < number:
        q = rng.uniform(low + 0.02, high - 0.02)
        if one.regularity(q) > 3 * REGULAR:
            found.append(q)
    return found


def pose_error(T, U):
    """Mm and rad between two poses; the angle from the sine, exact where it is small."""
    R = T[:3, :3].T @ U[:3, :3]
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    assert np.trace(R) > 2.9
    return np.linalg.norm(T[:3, 3] - U[:3, 3]), np.linalg.norm(sine)
