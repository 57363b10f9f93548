"""Algorithm 1 beside the exact method at the same places.

The places are profiles in a plane, extruded along y, so that figures in two dimensions show what the
three-dimensional methods did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyvista as pv

from study.errors import InputError
from study.fixtures import MeshFixture
from study.fixtures.control import _kernels
from study.fixtures.control.published import published_planes
from study.fixtures.optimisation import nearest_motion

#: In the order in which tables show them: no constraints, every triangle's plane, Algorithm 1, ours.
METHODS = ("none", "all planes", "published", "exact")


@dataclass(frozen=True, eq=False)
class Place:
    """A profile, a tip in front of it and the motion that a hand asks for.

    Attributes
    ----------
    title : str
    profile : (n, 2) array
        Corners from left to right, x and z in mm; anatomy is below.
    position, desired : (2,) arrays
        Centre of the tip, and the motion of one cycle, mm.
    radius, max_step : float
        mm.
    turned : tuple of int
        Segments whose triangles face the wrong way.
    """

    title: str
    profile: np.ndarray
    position: np.ndarray
    desired: np.ndarray
    radius: float
    max_step: float
    turned: tuple[int, ...] = ()

    def mesh(self, width: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of the profile extruded along y, the plane of the profile well within."""
        count = len(self.profile)
        vertices = np.empty((2 * count, 3))
        vertices[:, [0, 2]] = np.repeat(self.profile, 2, axis=0)
        vertices[:, 1] = np.tile([-0.1 * width, 0.9 * width], count)
        faces = []
        for k in range(count - 1):
            a, b = 2 * k, 2 * k + 2
            pair = np.array([[a, b, b + 1], [a, b + 1, a + 1]])
            faces.append(pair[:, ::-1] if k in self.turned else pair)
        return vertices, np.concatenate(faces)


def _raised(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Three coordinates of points in the plane of a profile."""
    points = np.asarray(points, dtype=np.float64)
    return np.stack([points[..., 0], np.zeros(points.shape[:-1]), points[..., 1]], axis=-1)


VALLEY = np.array([[-3.2, 2.7], [-1.9, 0.95], [-0.7, 0.1], [0.6, 0.0], [1.8, 0.75], [3.2, 2.6]])
HILL = np.array([[-3.2, -2.4], [-2.0, -0.75], [-0.75, 0.0], [0.65, 0.05], [1.9, -0.8], [3.2, -2.6]])
HOLE = np.array(
    [[-3.2, 1.9], [-1.1, 0.0], [-0.7, 0.0], [-0.7, -2.4], [0.7, -2.4], [0.7, 0.0], [1.1, 0.0], [3.2, 1.9]]
)


def places() -> list[Place]:
    """Two places where both methods do the same, one where Algorithm 1 bars a way, one where it lets in."""
    step = 0.8
    return [
        Place("concave", VALLEY, np.array([0.25, 0.95]), np.array([0.62, -0.45]), 0.6, step),
        Place("convex", HILL, np.array([-0.25, 0.72]), np.array([0.6, -0.5]), 0.6, step),
        Place("a hole that the tip fits into", HOLE, np.array([0.0, -0.4]), np.array([0.3, -0.6]), 0.6, step),
        Place("a face turned round", HILL, np.array([0.0, 0.72]), np.array([0.1, -0.7]), 0.6, step, (2,)),
    ]


@dataclass(frozen=True, eq=False)
class Decision:
    """What a method makes of a place: planes as normal and the point on them, in the plane of the profile.

    Attributes
    ----------
    method : str
    normals, points : (k, 2) arrays
        The tip's centre is to keep its radius from each plane; mm.
    motion : (2,) array
        mm; zeros where it stops.
    stopped : bool
    distance : float
        From the surface to the centre after the motion, less the radius, mm.
    """

    method: str
    normals: np.ndarray
    points: np.ndarray
    motion: np.ndarray
    stopped: bool
    distance: float


def all_planes(fixture: MeshFixture, x: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle's own plane, within reach: figures 2b and 2d; unit normals and points (k, 3)."""
    found = fixture.index.within(x, reach)
    return fixture.mesh.normals[found.faces], found.points


def needed_planes(
    fixture: MeshFixture, x: np.ndarray, radius: float, desired: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The exact method as it reads: planes of what is met, one after the other, until nothing is.

    Parameters
    ----------
    fixture : MeshFixture
    x, desired : (3,) arrays
        mm.
    radius : float
        mm.

    Returns
    -------
    normals, points, motion : (k, 3), (k, 3) and (3,) arrays
        In the order in which they were met.

    Raises
    ------
    InputError
        If the tip is nearer than its radius.
    """
    if fixture.distances(x[None])[0] < radius:
        raise InputError("position: expected a tip that is outside, got one nearer than its radius")
    corners = fixture.mesh.vertices[fixture.mesh.faces].reshape(-1, 9)
    normals, points, motion = np.zeros((0, 3)), np.zeros((0, 3)), desired.astype(np.float64)
    plane = np.empty(4)
    while True:
        first = np.inf, None, None
        near = fixture.index.within(x, radius + float(np.linalg.norm(desired)) + 1e-3)
        for face in near.faces:
            when = _kernels.impact_of(corners[face][None], x, motion, radius, plane)
            if when < first[0]:
                first = when, plane[:3].copy(), plane[3]
        if first[1] is None:
            return normals, points, motion
        normals = np.vstack([normals, first[1]])
        points = np.vstack([points, x + (first[2] - first[1] @ x) * first[1]])
        least = np.minimum(radius + _kernels.RESERVE - (normals * (x - points)).sum(axis=1), 0.0)
        motion = nearest_motion(normals, least, desired)


def decide(place: Place, method: str) -> Decision:
    """One cycle at a place by one of `METHODS`, with the planes that it took."""
    fixture = MeshFixture(place.mesh(), place.title)
    x, desired = _raised(place.position), _raised(place.desired)
    length = np.linalg.norm(desired)
    desired = desired * min(1.0, place.max_step / length)
    reach = place.radius + place.max_step
    if method == "exact":
        normals, points, motion = needed_planes(fixture, x, place.radius, desired)
    else:
        if method == "published":
            planes = published_planes(fixture.index, x, reach)
            normals, points = planes.normals, planes.points
        elif method == "all planes":
            normals, points = all_planes(fixture, x, reach)
        else:
            normals, points = np.zeros((0, 3)), np.zeros((0, 3))
        motion = planned_motion(normals, points, x, place.radius, desired, place.max_step)
    stopped = motion is None
    motion = np.zeros(3) if stopped else motion
    left = float(fixture.distances((x + motion)[None])[0]) - place.radius
    return Decision(method, normals[:, [0, 2]], points[:, [0, 2]], motion[[0, 2]], stopped, left)


def planned_motion(normals, points, x, radius, desired, max_step) -> np.ndarray | None:
    """The nearest motion by feature 1's rows, None where there is none that a cycle allows."""
    motion = nearest_motion(normals, radius - (normals * (x - points)).sum(axis=1), desired)
    return None if motion is None or np.linalg.norm(motion) > max_step * (1 + 1e-9) else motion


@dataclass(frozen=True, eq=False)
class Cycle:
    """A cycle on a surface in three dimensions, by both methods.

    Attributes
    ----------
    title : str
    fixture : MeshFixture
    position, desired : (3,) arrays
        mm.
    radius, reach : float
        Of the tip, and of the sphere that Algorithm 1 intersects triangles with, mm.
    planes : dict
        Of "published" and "exact": normals (k, 3), points (k, 3) and motion (3,).
    """

    title: str
    fixture: MeshFixture
    position: np.ndarray
    desired: np.ndarray
    radius: float
    reach: float
    planes: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]


def cycles_in_space() -> list[Cycle]:
    """A tip in a bowl, of which the front is cut off, and on a dome; both of large triangles."""
    ball = pv.Icosphere(radius=5.0, nsub=2)
    vertices, faces = np.asarray(ball.points, dtype=np.float64), ball.regular_faces
    middles = vertices[faces].mean(axis=1)
    radius, step = 1.0, 0.4
    desired = step * np.array([0.75, 0.1, -0.65])
    made = []
    for title, chosen, height in (
        ("concave: in a bowl", faces[(middles[:, 2] < -1.0) & (middles[:, 1] > -1.6)][:, ::-1], -3.7),
        ("convex: on a dome", faces[middles[:, 2] > 1.0], 6.05),
    ):
        fixture = MeshFixture((vertices, chosen), title)
        x = np.array([0.3, 0.2, height])
        planes = published_planes(fixture.index, x, radius + step)
        motion = planned_motion(planes.normals, planes.points, x, radius, desired, step)
        published = planes.normals, planes.points, np.zeros(3) if motion is None else motion
        both = {"published": published, "exact": needed_planes(fixture, x, radius, desired)}
        made.append(Cycle(title, fixture, x, desired, radius, radius + step, both))
    return made
