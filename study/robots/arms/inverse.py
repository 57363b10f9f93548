"""Joint angles for a pose: damped least squares on Pinocchio's Jacobian, from every posture of the arm.

A wrist whose axes meet leaves eight postures for a pose: shoulder forward or backward, elbow up or down,
wrist turned over or not. They follow from the drawing's triangle of upper arm and forearm, and are where
the iteration starts. For an arm as drawn they are the solutions already; for one as built, off by its errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from study.errors import ReachError
from study.transforms import checked_transform, checked_transforms

if TYPE_CHECKING:
    from study.robots.arms.arm import SixAxisArm
    from study.robots.arms.serial import SerialArm

#: Least singular value of a Jacobian (lengths over the arm's reach) at which a pose still counts as regular.
REGULAR = 0.01
#: Distance of a pose (mm over the arm's reach, and rad) below which it counts as reached.
_REACHED = 1e-12
_STEPS = 50
#: Slack of a joint limit, rad: what rounding leaves.
_SLACK = 1e-9
#: How far the joints of an arm as built may be from those of its drawing at one pose, rad.
_NEAR = 0.05
#: Largest turn of a joint between neighbouring poses of a trajectory, rad.
_JUMP = 0.5
_TURN = 2.0 * math.pi


class _Found(NamedTuple):
    """A solution, the joint furthest past its limit (from 0) and by how many rad (negative: within)."""

    q: np.ndarray
    joint: int
    beyond: float


def inverse(arm: SixAxisArm, T_rob_ee: ArrayLike, start: np.ndarray) -> np.ndarray:
    """See `SixAxisArm.inverse`."""
    T = checked_transform("T_rob_ee", T_rob_ee)
    guesses = [_unwound(arm, q, start, _NEAR) for q in _postures(arm, T)]
    guesses.sort(key=lambda q: np.abs(q - start).max())
    outside: list[_Found] = []
    singular: list[tuple[float, np.ndarray]] = []
    nearest = math.inf
    for guess in guesses:
        q, rest = _descend(arm, T, guess)
        nearest = min(nearest, rest)
        if rest > _REACHED:
            continue
        q = _unwound(arm, q, start)
        beyond = _beyond(arm, q)
        joint = int(beyond.argmax())
        if beyond[joint] > _SLACK:
            outside.append(_Found(q, joint, float(beyond[joint])))
            continue
        regularity = arm.regularity(q)
        if regularity >= REGULAR:
            return np.clip(q, arm.limits[:, 0], arm.limits[:, 1])
        singular.append((regularity, q))
    if singular:
        regularity, q = max(singular, key=lambda one: one[0])
        why = (
            f"near a singularity, {_singularity(arm, q)}: "
            f"regularity {regularity:.2g}, expected {REGULAR} at least"
        )
    elif outside:
        least = min(outside, key=lambda one: one.beyond)
        angle, beyond = np.rad2deg([least.q[least.joint], least.beyond])
        low, high = np.rad2deg(arm.limits[least.joint])
        why = (
            f"joint limit: joint {least.joint + 1} would stand at {angle:.2f} degrees, "
            f"{beyond:.2f} beyond its range of {low:g} to {high:g}"
        )
    else:
        why = _out_of_reach(arm, T, nearest)
    raise ReachError(f"{arm.name}: {why}")


def nearest_inverse(arm: SerialArm, T_rob_ee: ArrayLike, start: np.ndarray) -> np.ndarray:
    """See `ChainArm.inverse`."""
    T = checked_transform("T_rob_ee", T_rob_ee)
    found, least, why = [], math.inf, []
    for flips in product((1.0, -1.0), repeat=3):
        q, rest = _descend(arm, T, _flipped(arm, T, start, *flips))
        least = min(least, rest)
        if rest > _REACHED:
            continue
        q = _unwound(arm, q, start)
        beyond, regularity = _beyond(arm, q).max(), arm.regularity(q)
        if beyond > _SLACK:
            why.append(
                f"joint {_beyond(arm, q).argmax() + 1} {np.rad2deg(beyond):.2f} degrees past its limit"
            )
        elif regularity < REGULAR:
            why.append(f"near a singularity: regularity {regularity:.2g}, expected {REGULAR} at least")
        else:
            found.append(np.clip(q, arm.limits[:, 0], arm.limits[:, 1]))
    if found:
        return min(found, key=lambda q: np.abs(q - start).max())
    raise ReachError(
        f"{arm.name}: {why[0] if why else f'the nearest solution stays {least * arm.reach_mm:.3g} mm away'}"
    )


def _flipped(
    arm: SerialArm, T: np.ndarray, start: np.ndarray, shoulder: float, elbow: float, wrist: float
) -> np.ndarray:
    """Joint angles to begin a search with: turned towards the pose, and as the signs say the other way."""
    here = arm.forward(start)
    q = start.copy()
    if math.hypot(*here[:2, 3]) > _REACHED:
        q[0] += math.remainder(math.atan2(T[1, 3], T[0, 3]) - math.atan2(here[1, 3], here[0, 3]), _TURN)
    if shoulder < 0:  # reaching backward over itself; the upper arm is upright at -90 degrees
        q[:2] += math.pi, 2.0 * (-0.5 * math.pi - q[1])
    q[2] *= elbow
    q[4] *= wrist
    return q


def follow(arm: SixAxisArm, T_rob_ee: ArrayLike, start: ArrayLike | None = None) -> np.ndarray:
    """Joint angles along a trajectory, in one posture.

    Parameters
    ----------
    arm : SixAxisArm
    T_rob_ee : (n, 4, 4) array
        Poses in order, mm; close enough together that no joint turns by more than 0.5 rad from one to the
        next.
    start : (6,) array, optional
        rad; the first pose is taken in the posture nearest to it, `SixAxisArm.ready` when None.

    Returns
    -------
    (n, 6) array
        rad.

    Raises
    ------
    ReachError
        If a pose cannot be taken, or only with a joint that jumps; the message tells which pose.
    InputError
        If the poses are not rigid or `start` not six finite numbers.
    """
    T = checked_transforms("T_rob_ee", T_rob_ee)
    angles = np.empty((len(T), 6))
    for row, pose in enumerate(T):
        try:
            angles[row] = arm.inverse(pose, angles[row - 1] if row else start)
        except ReachError as error:
            raise ReachError(f"pose {row} of {len(T)}: {error}") from None
        turns = np.abs(angles[row] - angles[max(row - 1, 0)])
        if turns.max() > _JUMP:
            raise ReachError(
                f"pose {row} of {len(T)}: {arm.name}: joint {turns.argmax() + 1} would jump by "
                f"{np.rad2deg(turns.max()):.1f} degrees, at most {np.rad2deg(_JUMP):.1f} between poses"
            )
    return angles


def _postures(arm: SixAxisArm, T: np.ndarray) -> Iterator[np.ndarray]:
    """Up to eight joint angles at or near the pose, by the drawing; the nearest when it is out of reach."""
    data, chain, senses = arm.data, arm.chain, arm.data.senses
    fore, bend = math.hypot(*arm.fore), math.atan2(*arm.fore)
    for first, out, up in _shoulders(arm, T):
        cosine = (out**2 + up**2 - data.upper_arm**2 - fore**2) / (2.0 * data.upper_arm * fore)
        inner = math.acos(min(1.0, max(-1.0, cosine)))
        for elbow in (inner, -inner) if inner > 0.0 else (0.0,):
            second = math.atan2(out, up) - math.atan2(
                fore * math.sin(elbow), data.upper_arm + fore * math.cos(elbow)
            )
            q = senses * (first, second, elbow - bend, 0.0, 0.0, 0.0)
            chain.pin.forwardKinematics(chain.model, chain.data, q)
            W = chain.data.oMi[3].rotation.T @ T[:3, :3]
            side = math.hypot(W[0, 2], W[1, 2])
            if side < _REACHED:  # axes 4 and 6 in line: only their sum is told
                fifth = 0.0 if W[2, 2] > 0 else math.pi
                yield np.concatenate([q[:3], senses[3:] * (0.0, fifth, math.atan2(W[1, 0], W[1, 1]))])
                continue
            for turn in (1.0, -1.0):
                fourth = math.atan2(turn * W[1, 2], turn * W[0, 2])
                fifth = math.atan2(turn * side, W[2, 2])
                sixth = math.atan2(turn * W[2, 1], -turn * W[2, 0])
                yield np.concatenate([q[:3], senses[3:] * (fourth, fifth, sixth)])


def _shoulders(arm: SixAxisArm, T: np.ndarray) -> Iterator[tuple[float, float, float]]:
    """Both turns of axis 1 towards the wrist, each with how far forward and up it then is from axis 2."""
    x, y, z = T[:3, 3]
    away, toward = math.hypot(x, y), math.atan2(y, x)
    up = z - arm.data.base_height
    yield toward, away - arm.data.shoulder_offset, up
    yield toward + math.pi, -away - arm.data.shoulder_offset, up


def _descend(arm: SerialArm, T: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, float]:
    """Joint angles nearer to the pose, and what is left: mm over the arm's reach and rad together.

    The damping is the distance squared (Levenberg and Marquardt with an early quadratic end).
    """
    log = arm.chain.pin.log3
    scale = np.repeat([1.0 / arm.reach_mm, 1.0], 3)
    best, least = q, math.inf
    for _ in range(_STEPS):
        here, J = arm.pose_and_jacobian(q)
        missing = np.concatenate([T[:3, 3] - here[:3, 3], log(T[:3, :3] @ here[:3, :3].T)]) * scale
        rest = math.sqrt(missing @ missing)
        if rest < least:
            best, least = q, rest
        if rest <= _REACHED:
            break
        J = J * scale[:, None]
        q = q + np.linalg.solve(J.T @ J + rest**2 * np.eye(6), J.T @ missing)
    return best, least


def _unwound(arm: SerialArm, q: np.ndarray, start: np.ndarray, slack: float = _SLACK) -> np.ndarray:
    """The same posture with every joint as near to the start as whole turns within its limits bring it."""
    low, high = arm.limits.T
    near = q + _TURN * np.round((start - q) / _TURN)
    turned = near + _TURN * np.ceil(np.maximum(low - slack - near, 0.0) / _TURN)
    turned -= _TURN * np.ceil(np.maximum(turned - high - slack, 0.0) / _TURN)
    # a range of less than a turn may hold neither: then the one that is less beyond
    return np.where(_beyond(arm, turned) < _beyond(arm, near), turned, near)


def _beyond(arm: SerialArm, q: np.ndarray) -> np.ndarray:
    """(6,) rad past the joints' limits, negative within them."""
    return np.maximum(arm.limits[:, 0] - q, q - arm.limits[:, 1])


def _singularity(arm: SixAxisArm, q: np.ndarray) -> str:
    """Which of the arm's three singularities is the nearest."""
    fore, bend = math.hypot(*arm.fore), math.atan2(*arm.fore)
    second, elbow, fifth = arm.data.senses[[1, 2, 4]] * q[[1, 2, 4]] + (0.0, bend, 0.0)
    out = arm.data.shoulder_offset + arm.data.upper_arm * math.sin(second) + fore * math.sin(second + elbow)
    near = {
        "axes 4 and 6 nearly in line": abs(math.sin(fifth)),
        "arm nearly stretched or folded": abs(math.sin(elbow)),
        "wrist nearly on axis 1": abs(out) / arm.reach_mm,
    }
    return min(near, key=near.get)


def _out_of_reach(arm: SixAxisArm, T: np.ndarray, rest: float) -> str:
    """By how much a pose that no posture comes to is too far."""
    longest = arm.data.upper_arm + math.hypot(*arm.fore)
    span = min(math.hypot(out, up) for _, out, up in _shoulders(arm, T))
    if span > longest:
        return (
            f"outside reach by {span - longest:.3f} mm: "
            f"wrist {span:.3f} mm from axis 2, at most {longest:.3f}"
        )
    return f"outside reach as built: the nearest solution stays {rest * arm.reach_mm:.3g} mm away"
