"""Poses of a patch that lies on a surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from study.registration.alignment.planes import TangentPlanes


def farthest_points(points: np.ndarray, radius: float, first: int) -> np.ndarray:
    """Indices of points that no other is further from than a radius, each far from those before."""
    chosen = [first]
    distance = np.linalg.norm(points - points[first], axis=1)
    while distance.max() > radius:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def sites(planes: TangentPlanes, spacing: float, size: float, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Places for a swab's mean and normals there, (s, 3) each.

    Both are means over the surface within a swab's size: a patch's mean lies below the surface it bulges
    with, and its normal is not that of the vertex in its middle.
    """
    places, normals = [], []
    for site in farthest_points(planes.points, spacing, first):
        around = planes.tree.query_ball_point(planes.points[site], size)
        own = planes.normals[around]
        along = own @ planes.normals[site]
        facing = np.abs(along) > 0.3  # leaves out what is behind or beside
        normal = (own[facing] * np.sign(along[facing])[:, None]).sum(axis=0)
        places.append(planes.points[around][facing].mean(axis=0))
        normals.append(normal / np.linalg.norm(normal))
    return np.array(places), np.array(normals)


def patch_axes(swab: np.ndarray) -> np.ndarray:
    """(3, 3) rotation whose rows are a centred swab's axes, the last one the normal of its plane."""
    axes = np.linalg.svd(swab, full_matrices=False)[2]
    return axes * np.array([[1.0], [1.0], [np.sign(np.linalg.det(axes))]])


def poses(
    swab: np.ndarray, places: np.ndarray, normals: np.ndarray, angle_step_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, 3, 3) and places (n, 3) of the swab's mean: every site, either side up, all turns.

    The two axes of a patch have no sign of their own. With both sides and an even number of turns the set
    of poses is the same for either, so that it moves with the swab.
    """
    count = 2 * int(np.ceil(180 / angle_step_deg))
    about = Rotation.from_rotvec(np.outer(np.arange(count) * 2 * np.pi / count, [0, 0, 1])).as_matrix()
    over = np.diag([1.0, -1.0, -1.0])
    flat = np.concatenate([about, about @ over]) @ patch_axes(swab)  # the patch in the plane z = 0
    beside = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    frames = np.stack([beside, np.cross(normals, beside), normals], axis=2)
    turns = frames[:, None] @ flat[None]
    return turns.reshape(-1, 3, 3), np.repeat(places, len(flat), axis=0)


def apart(
    swab: np.ndarray, turns: np.ndarray, places: np.ndarray, turn: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """(n,) root mean square distances between the centred swab in n poses and in one, mm."""
    spread = swab.T @ swab / len(swab)
    rest = turns - turn
    return np.sqrt(np.einsum("nij,jk,nik->n", rest, spread, rest) + ((places - place) ** 2).sum(axis=1))


def different(
    swab: np.ndarray, turns: np.ndarray, places: np.ndarray, rms: np.ndarray, least: float, most: int
) -> np.ndarray:
    """Indices of the best poses, best first, without those nearer than `least` mm to a better one."""
    waiting = np.argsort(rms, kind="stable")
    chosen = []
    while len(waiting) and len(chosen) < most:
        best, waiting = waiting[0], waiting[1:]
        chosen.append(best)
        waiting = waiting[apart(swab, turns[waiting], places[waiting], turns[best], places[best]) > least]
    return np.array(chosen)
